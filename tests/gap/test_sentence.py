"""The summary sentence of a diagnosis made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imuarray.gap.findings.diagnosis import Cause, Gap, Pull, Unobservable, Verdict, Where
from imuarray.gap.findings.verdict import Judgement, sentence_of, with_limits
from imuarray.gap.model.use import IntervalEstimate, Use
from imuarray.simulate.effects import EFFECTS, meaning

GAP = Gap(9.0, 1.5, 0.9, 0.97, (0.92, 0.99))


def written(verdict: Verdict, gap: Gap, causes: Sequence[Cause], *rest: Any, **more: Any) -> str:
    return sentence_of(Judgement(verdict, gap, tuple(causes), 0.0), *rest, **more)


def where(**changes: Any) -> Where:
    facts: dict[str, Any] = {"log": "a.h5", "sensor": "G1", "axis": "y", "domain": "run_to_run", "phase": "run 1"}
    rest = ("mean", "mean of the run", 1.0, 0.0, "dps", 9.0, 0.01, 4.0, 0.25, "material")
    return Where(**{**facts, **changes}, **dict(zip(list(Where.__dataclass_fields__)[5:], rest, strict=True)))


def cause(effect: str = "tone", probability: float = 0.9, **changes: Any) -> Cause:
    facts: dict[str, Any] = {
        "action": "add",
        "sensors": ("G1",),
        "axes": ("y",),
        "parameters": {"frequency_hz": 17.0},
        "closed": 0.9,
        "closed_ci95": (0.8, 1.0),
        "confusable_with": (),
    }
    return Cause(effect, probability=probability, **{**facts, **changes})


def use(sensor: str, real: float, before: float, after: float) -> Use:
    figures = [IntervalEstimate(value, value / 2, value * 2) for value in (real, before, after)]
    return Use("heading error after coasting 5 s", sensor, "deg", *figures)


def test_the_sentence_without_a_gap() -> None:
    said = written("no gap", Gap(1, 1, 1, None, None), (), (), (), (use("G1", 1.0, 2.0, 1.0),))
    assert said == "The recordings agree with the simulator: no statistic is beyond chance."


def test_the_sentence_without_a_gap_states_how_many_effects_cannot_be_observed() -> None:
    hidden = [Unobservable("scale", ("A1",), "z_down"), Unobservable("differences of spread", ("A1",), "4 minutes")]
    assert with_limits("They agree.", "no gap", hidden) == (
        "They agree. Only what could be compared agrees; "
        f"1 of {len(EFFECTS)} known effects cannot be observed with every"
        " sensor; the recordings are too short to exclude differences of noise."
    )
    assert with_limits("They differ.", "unexplained", hidden) == "They differ."
    assert with_limits("They agree.", "no gap", []) == "They agree."


def test_parts_out_of_specification_are_reported_with_and_without_a_gap() -> None:
    pulls = [
        Pull("scale", "A1", axis, 0.03 * pull, "", 0.03, pull, "BMA-20") for axis, pull in (("x", 0.7), ("y", -1.4))
    ]
    said = "A1 y: scale -4.2 %, 1.4 times its tolerance of 3 % (BMA-20): this part is out of specification."
    same = written("no gap", Gap(1, 1, 1, None, None), (), (), (), (), pulls)
    assert same == f"The recordings agree with the simulator: no statistic is beyond chance. {said}"
    assert written("explained", GAP, [cause()], [where()], [], [], pulls).endswith(f"on held-out data. {said}")


def test_a_cause_may_have_misled_the_fit_of_a_part() -> None:
    """An exchange of sensors looks like a g-sensitivity: it is reported once, and not as a part out of
    specification.
    """
    pulls = [Pull("g-sensitivity", "G1", "xy", 0.1, "dps/g", 0.03, 3.3, "usual", ("channel_swap",))]
    swapped = written("explained", GAP, [cause("channel_swap")], [where()], [], [], pulls)
    assert swapped.endswith(
        "Beyond tolerance as fitted without channel_swap, which may be the reason: G1 xy (g-sensitivity)."
    )
    assert "out of specification" not in swapped


def test_of_many_parts_out_of_specification_three_are_named() -> None:
    pulls = [Pull("bias", "A1", "x", 0.2 * pull, "g", 0.2, pull, "BMA-20") for pull in (2.0, 5.0, 4.0, 3.0, 1.5)]
    said = written("no gap", Gap(1, 1, 1, None, None), (), (), (), (), pulls)
    assert [said.count("this part is"), said.index("bias 1 g") < said.index("bias 0.8 g")] == [3, True]
    assert said.endswith("2 more quantities are out of specification.")


def test_the_sentence_of_one_cause() -> None:
    said = written("explained", GAP, [cause()], [where()], [], [])
    assert said == (
        "The recordings differ from the simulator, most in the change from run to run of G1 y. G1 (y): tone (a sine"
        " wave in the signal: frequency 17 Hz), probability 90 %. With it 97 % (92 to 99) of the gap is closed on"
        " held-out data."
    )


def test_a_cause_that_needs_both_parts_is_not_reported_as_held_out() -> None:
    said = written("explained", GAP, [cause(needs_both=True)], [where()], [], [])
    assert "of the gap is closed on the data that showed it." in said
    mixed = written("explained", GAP, [cause(needs_both=True), cause("bias")], [where()], [], [])
    assert "of the gap is closed on held-out data." in mixed


def test_the_sentence_of_several_causes_and_their_alternatives() -> None:
    causes = [
        cause(confusable_with=("glitches", "jitter")),
        cause("scale", 0.6, action="remove", axes=(), parameters={}),
        cause("quantisation", 0.55, action="replace", parameters={}),
        cause("bias", 0.3),
    ]
    said = written("explained", GAP, causes, [where(axis="")], [], [])
    assert "most in the change from run to run of G1." in said
    assert "probability 90 %; it may also be glitches or jitter." in said
    assert "G1: no scale (the simulator has it), probability 60 %." in said
    assert "quantisation other than the simulator's, probability 55 %." in said
    assert "bias" not in said  # less probable than not
    assert "With all accepted causes 97 %" in said  # the bias is in the simulator as well
    assert "With them 97 %" in written("explained", GAP, causes[:3], [where()], [], [])


def test_no_more_than_four_causes_are_named() -> None:
    causes = [cause(sensors=(f"G{number}",)) for number in range(6)]
    said = written("explained", GAP, causes, [where()], [], [])
    assert "G3 (y): tone" in said
    assert "G4 (y): tone" not in said


def test_the_unexplained_part_is_reported() -> None:
    left = [where(sensor="G2", axis="z", phase="static"), where()]
    said = written("partly explained", GAP, [cause()], [where()], left, [])
    assert said.endswith("Not explained: mean of the run, G2 z in static.")


def test_an_unknown_effect_is_described_by_its_places() -> None:
    """By domain, axis, deviation, phase and log; each axis and domain once."""
    left = [
        where(sensor="G2", axis="z", phase="static"),
        where(sensor="G2", axis="z"),
        where(domain="spread", phase=""),
    ]
    said = written("unexplained", GAP, [], [where()], left, [])
    assert said == (
        "The recordings differ from the simulator, most in the change from run to run of G1 y. Unexplained: something"
        " outside the library. It shows in the change from run to run of G2 z (mean of the run: 9.0 standard deviations"
        " too high in static of a.h5); the noise of G1 y (mean of the run: 9.0 standard deviations too high in a.h5)."
    )
    nearest = written("unexplained", GAP, [cause(probability=0.4)], [where()], left[1:], [])
    assert (
        "No known effect makes these recordings likely; a possible cause of differences elsewhere than in G2 z is"
        in nearest
    )
    nearest = written("unexplained", GAP, [cause(probability=0.4)], [where()], left[2:], [])
    assert "No known effect makes these recordings likely; the nearest is G1 (y): tone (a sine" in nearest
    assert "probability 40 %" in nearest


def test_a_comparison_with_an_earlier_recording_names_it() -> None:
    differs = written("explained", GAP, [cause()], [where()], [], [], against=["before.h5"])
    assert differs.startswith("The recordings differ from before.h5, most in the change from run to run of G1 y.")
    same = written("no gap", Gap(1, 1, 1, None, None), (), (), (), (), against=["before.h5"])
    assert same == "The recordings agree with before.h5: nothing has changed beyond chance."


def test_the_most_changed_figure_of_use_is_reported() -> None:
    """For the sensors concerned: a change by 60 % of the recorded figure, not by 50 %."""
    uses = [use("G1", 1.0, 0.5, 0.9), use("G1", 2.0, 0.8, 1.7), use("G2", 1.0, 0.1, 0.9), use("G1", 0.0, 9.0, 1.0)]
    said = written("explained", GAP, [cause()], [where()], [], uses)
    assert said.endswith(
        "G1, heading error after coasting 5 s: recorded 2 deg, simulated 0.8 deg before and 1.7 deg after."
    )
    assert "recorded" not in written("unexplained", GAP, [], [where()], [], uses)


def test_the_likeliest_cause_is_named_if_none_is_probable() -> None:
    said = written("explained", GAP, [cause(probability=0.4), cause("glitches", 0.3)], [where()], [], [])
    assert "probability 40 %. With all accepted causes 97 %" in said
    assert "glitches" not in said


def test_every_effect_has_a_meaning() -> None:
    for effect in EFFECTS:
        words = meaning(effect)
        assert words, effect
        assert words == words.strip(" ."), effect


def test_an_unknown_effect_has_no_meaning() -> None:
    assert meaning("ghosts") == ""
