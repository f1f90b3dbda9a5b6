"""Scores of runs that were made by hand, computed by hand."""

from __future__ import annotations

import json
from math import inf, isnan, nan
from pathlib import Path
from typing import Any

import pytest

from imuarray.errors import ConfigError
from imuarray.validation.case import Case
from imuarray.validation.score_answers import read_run
from imuarray.validation.score_rows import ScoreRow, extra_of, is_place_right
from imuarray.validation.scoring import Figures, as_json, format_text, score_folder
from tests.validation.run_folder import FROZEN, NO_GAP, THERE_OR_NOT, RunFolder, cause, gap_diagnosis, put

RIPPLE = gap_diagnosis(cause("tone"))


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    return RunFolder(tmp_path / "run")


def figures(run: RunFolder, **more: Any) -> Figures:
    return score_folder(run.folder, **more)


def shares(row: ScoreRow) -> Any:
    return row.value, row.cases


def cells(row: ScoreRow, group: str) -> Any:
    return {cell.name: shares(cell) for cell in row.cells if cell.group == group}


@pytest.mark.slow
def test_false_alarms_of_each_plan_are_compared_with_their_bar(run: RunFolder) -> None:
    """1 of 20, 2 of 10, 30 of 30: within the bar, outside by chance (Wilson: 0.057 on), outside for sure."""
    for plan, alarms, cases in (("full", 1, 20), ("static", 2, 10), ("heat", 30, 30)):
        for number in range(cases):
            run.both("none", RIPPLE if number < alarms else NO_GAP, plan=plan)
    score = figures(run)
    rows = [score.row(f"false alarms, plan {plan}") for plan in ("full", "static", "heat")]
    assert [shares(row) for row in rows] == [(0.05, 20), (0.2, 10), (1.0, 30)]
    assert [row.mark for row in rows] == ["ok", "FAIL", "FAIL"]
    assert [row.is_refuted for row in rows] == [False, False, True]
    assert set(score.failed) >= {*rows[1:]} and rows[0] not in score.failed


@pytest.mark.slow
def test_detection_is_counted_by_severity_plan_and_mechanism(run: RunFolder) -> None:
    for detected, limits in ((False, 0.5), (True, 2.0), (True, 2.0), (False, 2.0), (True, 5.0)):
        run.both("single", RIPPLE if detected else NO_GAP, put("mains_ripple", limits))
    run.both("single", RIPPLE, put("single_trap", 2.0))
    run.both("single", NO_GAP, put("mains_ripple", 2.0), plan="static")
    run.both("single", RIPPLE, put("crossed_wiring", THERE_OR_NOT))
    score = figures(run)
    twice = score.row("detection at 2x the limit")
    assert shares(twice) == (0.75, 4) and twice.mark == "FAIL"
    assert cells(twice, "plan") == {"full": (0.75, 4), "static": (0.0, 1)}
    assert cells(twice, "mechanism") == {"mains_ripple": (pytest.approx(2 / 3), 3), "single_trap": (1.0, 1)}
    assert [cell.name for cell in twice.failing()] == ["mains_ripple"]
    assert shares(score.row("detection at 5x the limit")) == (1.0, 1)
    curves = {
        curve.plan: [(limits, *shares_of) for limits, (*shares_of, _, _, _) in curve.points] for curve in score.curves
    }
    assert list(curves) == ["all", "full", "static"]
    assert curves["all"] == [(0.5, 0.0), (2.0, 0.6), (5.0, 1.0)]
    assert curves["static"] == [(2.0, 0.0)]
    assert score.power.severities == ("0.5x the limit", "2x the limit", "5x the limit", "there or not")
    assert dict(zip(score.power.mechanisms, score.power.counts, strict=True)) == {
        "mains_ripple": ((0, 1), (2, 3), (1, 1), (0, 0)),
        "single_trap": ((0, 0), (1, 1), (0, 0), (0, 0)),
        "crossed_wiring": ((0, 0), (0, 0), (0, 0), (1, 1)),
    }


@pytest.mark.slow
def test_right_first_causes_and_classes_are_counted(run: RunFolder) -> None:
    """Of seven that are detected three are right; two more have the right name in their class. 5x and above: 2 of 3."""
    large, small = put("mains_ripple", 5.0), put("mains_ripple", 2.0)
    run.both("single", gap_diagnosis(cause("tone"), cause("scale", 0.8)), large)
    run.both("single", gap_diagnosis(cause("odr_error")), put("slow_oscillator", 20.0))
    run.both("single", gap_diagnosis(cause("scale", confusable_with=["tone"]), cause("tone", 0.3)), large)
    run.both("single", RIPPLE, small)
    run.both("single", gap_diagnosis(cause("scale", confusable_with=["tone"])), small)
    run.both("single", gap_diagnosis(cause("tone", action="remove")), small)
    run.both("single", gap_diagnosis(verdict="unexplained"), small)
    run.both("single", NO_GAP, small)
    run.both("single", gap_diagnosis(cause("scale")), large, plan="static")
    score = figures(run)
    first = score.row("right cause first")
    assert shares(first) == (pytest.approx(3 / 7), 7)
    assert cells(first, "severity") == {"2x the limit": (0.25, 4), "5x the limit": (0.5, 2), "20x the limit": (1.0, 1)}
    assert cells(first, "plan")["static"] == (0.0, 1)
    assert shares(score.row("right cause first, 5x and above")) == (pytest.approx(2 / 3), 3)
    assert shares(score.row("right within the reported class")) == (pytest.approx(5 / 7), 7)
    confusion = score.confusion
    assert confusion.said == ("odr_error", "tone", "scale", "nothing named", "no gap")
    assert dict(zip(confusion.truths, confusion.counts, strict=True)) == {
        "slow_oscillator": (1, 0, 0, 0, 0),
        "mains_ripple": (0, 3, 2, 1, 1),
    }
    assert confusion.right == ((True, False, False, False, False), (False, True, False, False, False))


@pytest.mark.parametrize(
    ("truth", "causes", "axes", "right"),
    [
        (["Gyro1"], [cause("tone")], (), True),
        (["Gyro1"], [cause("tone", 0.9, "Gyro2")], (), False),
        (["Gyro1"], [cause("tone", 0.9, "Gyro1", "Gyro2")], (), False),
        (["Gyro1"], [cause("tone", 0.9, "Gyro1", "Baro")], (), True),
        (["Gyro1", "BMA1"], [cause("tone")], (), False),
        (["Gyro1", "BMA1"], [cause("tone"), cause("scale", 0.9, "Gyro2"), cause("tone", 0.6, "BMA1")], (), True),
        (["Gyro1", "BMA1"], [cause("tone"), cause("tone", 0.4, "BMA1")], (), False),
        (["BMA1", "Gyro1", "Gyro2"], [cause("tone", sensors=[])], (), True),
        (["Gyro1"], [cause("tone", axes=["x"])], (), True),
        (["Gyro1"], [cause("tone", axes=["x"])], ("x",), True),
        (["Gyro1"], [cause("tone", axes=["y"])], ("x",), False),
        (["Gyro1"], [cause("tone")], ("x",), False),
    ],
)
def test_the_place_of_a_right_cause_is_scored(
    run: RunFolder, truth: list[str], causes: list[dict[str, Any]], axes: tuple[str, ...], right: bool
) -> None:
    """Sensors on which no mechanism can be put are not counted; an axis is counted where the truth names it."""
    case = run.both("single", gap_diagnosis(*causes), put("mains_ripple", 5.0, *truth))
    if axes:
        path = run.folder / "sealed" / f"{case.name}.json"
        table = json.loads(path.read_text())
        table["truth"]["mechanisms"][0]["parameters"] = {"axes": list(axes)}
        path.write_text(json.dumps(table))
    (answer,) = read_run(run.folder).answers
    assert is_place_right(answer, ("Gyro1", "Gyro2", "BMA1")) is right


@pytest.mark.slow
def test_the_place_is_scored_for_right_causes_only(run: RunFolder) -> None:
    """Gyro2 is counted, since the truth of another case names it."""
    run.both("single", RIPPLE, put("mains_ripple", 5.0, "Gyro1"))
    run.both("single", gap_diagnosis(cause("tone", 0.9, "Gyro1", "Gyro2")), put("mains_ripple", 5.0, "Gyro1"))
    run.both("single", gap_diagnosis(cause("scale", 0.9, "Gyro1")), put("mains_ripple", 5.0, "Gyro2"))
    assert shares(figures(run).row("right sensor and axis")) == (0.5, 2)
    assert shares(figures(run, sensors=("Gyro1",)).row("right sensor and axis")) == (1.0, 2)


@pytest.mark.slow
def test_recognition_of_unknown_mechanisms_is_scored(run: RunFolder) -> None:
    """Known at 5x: 0.0, 0.1 ... 0.9, so that the limit is 0.8; of 4 unknown ones 0.95 and 0.85 are above. Of 40 pairs
    10 + 9 + 8 + 0 are in order, one is tied.
    """
    for number in range(10):
        verdict = "unexplained" if number == 9 else "partly explained" if number == 8 else "explained"
        run.both("single", gap_diagnosis(cause("tone"), verdict=verdict, unknown=number / 10), put("mains_ripple", 5.0))
    run.both("single", gap_diagnosis(cause("tone"), unknown=1.0), put("mains_ripple", 20.0))
    for kind, verdict, unknown in (
        ("unnamed", "unexplained", 0.95),
        ("unnamed", "partly explained", 0.85),
        ("withheld", "explained", 0.75),
        ("withheld", "explained", 0.0),
    ):
        run.both(kind, gap_diagnosis(cause("scale"), verdict=verdict, unknown=unknown), put("single_trap"))  # type: ignore[arg-type]
    run.both("unnamed", NO_GAP, put("single_trap"))
    score = figures(run)
    called = score.row("unknown called unexplained or partly")
    assert shares(called) == (0.5, 4) and cells(called, "kind") == {"unnamed": (1.0, 2), "withheld": (0.0, 2)}
    assert shares(score.row("known at 5x called unexplained")) == (0.1, 10)
    assert score.row("known at 5x called unexplained").mark == "ok"
    assert shares(score.row("known at 5x called unexplained or partly")) == (0.2, 10)
    assert shares(score.row("unknown at 5x recognised, 10 % false ones")) == (0.5, 4)
    area = score.row("unknown against known at 5x, AUROC")
    assert shares(area) == (pytest.approx((10 + 9 + 8 + 0.5) / 40), 4)
    assert area.low < area.value < area.high
    assert shares(area.cells[0]) == (pytest.approx((10 + 9 + 8 + 0.5) / 44), 4)


@pytest.mark.parametrize(
    ("causes", "named"),
    [
        ([cause("tone", 0.5), cause("scale", 0.9, "BMA1")], True),
        ([cause("tone", 0.49), cause("scale", 0.9, "BMA1")], False),
        ([cause("tone"), cause("scale", 0.9, "Gyro1")], False),
        ([cause("tone"), cause("scale", 0.9, "BMA1", action="remove")], False),
        ([cause("tone")], False),
        ([], False),
    ],
)
def test_two_mechanisms_on_different_sensors_are_both_named(
    run: RunFolder, causes: list[dict[str, Any]], named: bool
) -> None:
    run.both("pair", gap_diagnosis(*causes), put("mains_ripple", 5.0, "Gyro1"), put("reference_voltage", 5.0, "BMA1"))
    score = figures(run)
    assert shares(score.row("two on different units, both named")) == (float(named), 1)
    assert score.row("two on one sensor, both named").mark == "n.a."


@pytest.mark.slow
def test_two_mechanisms_on_one_sensor_or_of_one_name(run: RunFolder) -> None:
    """Two mechanisms that have the same name on two sensors of a chip may be reported as one cause."""
    run.both("pair", gap_diagnosis(cause("tone"), cause("scale")), put("mains_ripple"), put("reference_voltage"))
    run.both("pair", gap_diagnosis(cause("tone")), put("mains_ripple"), put("reference_voltage"))
    both = put("torn_reads", 5.0, "Gyro1"), put("cable_bit_errors", 5.0, "Gyro2")
    run.both("pair", gap_diagnosis(cause("glitches", 0.9, "Gyro1", "Gyro2")), *both)
    run.both("pair", gap_diagnosis(cause("glitches", 0.9, "Gyro1")), *both)
    score = figures(run)
    assert shares(score.row("two on one sensor, both named")) == (0.5, 2)
    assert shares(score.row("two on different units, both named")) == (0.5, 2)


@pytest.mark.parametrize(
    ("extra", "said_cause", "right"),
    [
        ({"effect": "tone", "sensors": ["Gyro1"]}, cause("tone", action="remove"), True),
        ({"effect": "tone", "sensors": ["Gyro1"]}, cause("tone", action="replace"), True),
        ({"effect": "tone", "sensors": ["Gyro1"]}, cause("tone", action="add"), False),
        ({"effect": "tone", "sensors": ["Gyro1"]}, cause("tone", 0.4, action="remove"), False),
        ({"effect": "tone", "sensors": ["Gyro1"]}, cause("tone", 0.9, "Gyro2", action="remove"), False),
        ({"sensor": "Gyro1", "tone": {"frequency_hz": 7.0}}, cause("tone", action="remove"), True),
        ({"sensor": "Gyro1", "tone": {"frequency_hz": 7.0}}, cause("scale", action="remove"), False),
    ],
)
def test_a_removed_effect_of_the_base_model_is_named(
    run: RunFolder, extra: dict[str, Any], said_cause: dict[str, Any], right: bool
) -> None:
    run.both("removal", gap_diagnosis(said_cause), extra=extra, resembles=[])
    assert shares(figures(run).row("removed base effect named")) == (float(right), 1)


def test_an_unnamed_extra_effect_has_the_names_that_it_resembles() -> None:
    assert extra_of({"frequency_hz": 7.0}, [["tone"]]) == ({"tone"}, set())


@pytest.mark.slow
def test_closure_is_compared_with_the_oracle(run: RunFolder) -> None:
    """An error of 0.05, of 0.06 (and outside its interval), no statement, and a pair; cases without oracle or gap are
    not counted.
    """
    for claimed, interval, oracle in (
        (0.85, (0.8, 1.0), 0.9),
        (0.64, (0.6, 0.68), 0.7),
        (None, None, 0.9),
        (0.9, (0.8, 0.95), None),
    ):
        run.both(
            "single", gap_diagnosis(cause("tone"), closed=claimed, ci95=interval), put("mains_ripple"), oracle=oracle
        )
    run.both("single", NO_GAP, put("mains_ripple"), oracle=0.9)
    run.both(
        "pair",
        gap_diagnosis(cause("tone"), closed=0.7, ci95=(0.65, 0.75)),
        put("mains_ripple"),
        put("single_trap"),
        oracle=0.7,
    )
    score = figures(run)
    near, covers = score.row("closure near the oracle's"), score.row("closure's interval covers the oracle's")
    assert shares(near) == (0.5, 4) and shares(covers) == (0.5, 4)
    assert cells(near, "kind") == {"single": (pytest.approx(1 / 3), 3), "pair": (1.0, 1)}
    assert [(closure.claimed, closure.oracle, closure.is_right) for closure in score.closures[:2]] == [
        (0.85, 0.9, True),
        (0.64, 0.7, True),
    ]
    assert isnan(score.closures[2].claimed)


@pytest.mark.slow
def test_closure_claimed_by_wrong_causes_is_scored(run: RunFolder) -> None:
    """0.1 and 0.6 for wrong causes; a right cause, and a cause without closure, are not counted."""
    for effect, closed in (("scale", 0.1), ("scale", 0.6), ("tone", 0.9), ("scale", None)):
        run.both("single", gap_diagnosis(cause(effect, closed=closed)), put("mains_ripple"))
    run.both("none", NO_GAP)
    run.both("none", gap_diagnosis(cause("tone"), closed=0.2, ci95=(-0.1, 0.4)))
    run.both("none", gap_diagnosis(cause("tone"), closed=0.3, ci95=(0.1, 0.4)))
    run.both("none", gap_diagnosis(verdict="unexplained", closed=None, ci95=None))
    score = figures(run)
    wrong = score.row("closure claimed for a wrong cause")
    assert shares(wrong) == (pytest.approx(0.35), 2) and wrong.mark == "FAIL"
    assert [wrong.low, wrong.high] == pytest.approx([0.1, 0.6])
    assert shares(score.row("without a gap, closure may be 0")) == (0.75, 4)


def test_closure_of_withheld_mechanisms_is_scored(run: RunFolder) -> None:
    """0.6, no statement, and a negative closure: 0.2 on average. Only detected cases with withheld
    effects are counted.
    """
    for closed in (0.6, None, -0.1):
        run.both("withheld", gap_diagnosis(cause("scale", closed=0.9), closed=closed), put("mains_ripple"))
    run.both("withheld", NO_GAP, put("mains_ripple"))
    run.both("single", gap_diagnosis(cause("tone"), closed=0.9), put("mains_ripple"))
    assert shares(figures(run).row("closure claimed without the right cause")) == (pytest.approx(0.2), 3)


@pytest.mark.slow
def test_probabilities_of_all_reported_causes_are_scored(run: RunFolder) -> None:
    """0.9 right, 0.9 at another sensor and therefore wrong, 0.2 wrong: ECE (2 * 0.4 + 0.2) / 3, Brier 0.86 / 3. Unknown
    mechanisms and removals have no right name, and are not counted.
    """
    run.both("single", gap_diagnosis(cause("tone"), cause("scale", 0.2)), put("mains_ripple"))
    run.both("single", gap_diagnosis(cause("tone", 0.9, "BMA1")), put("mains_ripple"))
    run.both("none", NO_GAP)
    run.both("unnamed", gap_diagnosis(cause("tone", 0.7)), put("single_trap"), resembles=[()])
    score = figures(run)
    assert shares(score.row("calibration error (ECE)")) == (pytest.approx(1 / 3), 3)
    assert shares(score.row("Brier score of causes")) == (pytest.approx(0.86 / 3), 3)
    assert [(bin_.cases, bin_.right) for bin_ in score.reliability if bin_.cases] == [(1, 0.0), (2, 0.5)]


def test_mechanisms_that_a_plan_cannot_show_are_reported_so(run: RunFolder) -> None:
    """The case is not counted as undetected; the diagnosis must report it at that sensor, with a recording to make."""
    entry = {"effect": "scale", "sensors": ["Gyro1"], "record": "motion: turns"}
    for unshown in (
        [entry],
        [{**entry, "record": ""}],
        [{**entry, "sensors": ["BMA1"]}],
        [{**entry, "effect": "tone"}],
        [],
    ):
        diagnosis = {**NO_GAP, "unshown": unshown}
        run.both("single", diagnosis, put("reference_voltage", 2.0), plan="static")
    run.both("single", {**NO_GAP, "cannot_tell": [entry], "unshown": None}, put("reference_voltage"), plan="static")
    run.both("single", RIPPLE, put("mains_ripple", 2.0), plan="static")
    score = figures(run, hidden={"static": {"scale", "misalignment"}})
    row = score.row("effects that a plan can't show, reported so")
    assert shares(row) == (pytest.approx(2 / 6), 6) and row.mark == "FAIL"
    assert cells(row, "plan") == {"static": (pytest.approx(2 / 6), 6)}
    assert [(curve.plan, curve.points[0][1].cases) for curve in score.curves] == [("all", 1), ("static", 1)]
    assert figures(run).row("effects that a plan can't show, reported so").mark == "n.a."


@pytest.mark.parametrize(
    ("parameters", "axes", "is_new"),
    [({"frequency_hz": 20.2}, [], False), ({"frequency_hz": 31.0}, [], True), ({"frequency_hz": 20.0}, ["z"], True)],
)
def test_a_line_of_the_control_is_not_a_line_of_the_case(
    run: RunFolder, parameters: dict[str, float], axes: list[str], is_new: bool
) -> None:
    """Another frequency or another axis is another line; the control has 20 Hz on x."""
    control = run.both("none", gap_diagnosis(cause("tone", axes=["x"], parameters={"frequency_hz": 20.0})))
    reported = cause("tone", axes=axes or ["x"], parameters=parameters)
    run.both("single", gap_diagnosis(reported), put("mains_ripple", 5.0), control=control.name)
    answer = read_run(run.folder).answers[1]
    assert bool(answer.causes) == is_new


def test_an_effect_of_the_recording_itself_is_not_counted(run: RunFolder) -> None:
    """Whether or not it is named in the case; on another axis it is counted."""
    control = run.both("none", gap_diagnosis(cause("popcorn_noise", axes=["x"])))
    for axis in "xy":
        case = run.case("single", put("single_trap", 5.0), control=control.name)
        path = run.folder / "sealed" / f"{case.name}.json"
        table = json.loads(path.read_text())
        table["truth"]["mechanisms"][0]["parameters"] = {"axes": [axis]}
        path.write_text(json.dumps(table))
        run.answer(case, gap_diagnosis(cause("popcorn_noise", axes=[axis])))
    run = read_run(run.folder)
    assert [answer.case.number for answer in run.answers] == [1, 3]
    assert run.answers[1].first is not None
    assert any("In 1 cases the recording itself has the effect" in note for note in run.notes)


def test_lost_cases_are_reported(run: RunFolder) -> None:
    """Without an outcome, with an error, with an unreadable outcome, without truth, and not begun."""
    run.both("none", NO_GAP)
    run.case("none")
    run.answer(run.case("none"), {}, error="Traceback\nMemoryError: too large", seconds=0.0)
    half = run.case("pair", put("mains_ripple"), put("single_trap"))
    (run.folder / "outcomes" / f"{half.name}.json").write_text('{"name": ')
    dead = Case(90, "sealed", "single", "heat", (), 1)
    run.answer(dead, {}, error="its worker died twice")
    stranger = Case(91, "sealed", "single", "heat", (), 1)
    run.answer(stranger, NO_GAP)
    never = Case(92, "sealed", "none", "static", (), 1)
    score = figures(run, planned=[dead, never])
    assert [(case.kind, case.plan, case.why) for case in score.lost] == [
        ("none", "full", "no outcome"),
        ("none", "full", "MemoryError: too large"),
        ("pair", "full", "no outcome"),
        ("single", "heat", "its worker died twice"),
        ("unknown", "unknown", "no truth"),
        ("none", "static", "never begun"),
    ]
    assert score.cases == 7 and shares(score.row("cases lost")) == (pytest.approx(6 / 7), 7)
    assert shares(score.row("false alarms, plan full")) == (0.0, 1)
    text = format_text(score)
    assert "lost: 1 of none, plan full, MemoryError: too large" in text
    assert "lost: 1 of never begun" in text


@pytest.mark.slow
def test_shuffled_labels_are_right_by_chance_only(run: RunFolder) -> None:
    """40 cases of 4 effects, every one right: 0.25 on average once shuffled, with a deviation of sqrt(0.25 * 0.75 / 39)
    = 0.069, of which three are allowed.
    """
    names = {
        "mains_ripple": "tone",
        "single_trap": "popcorn_noise",
        "reference_voltage": "scale",
        "torn_reads": "glitches",
    }
    for mechanism, effect in 10 * list(names.items()):
        run.both("single", gap_diagnosis(cause(effect)), put(mechanism))
    score = figures(run)
    control = score.row("right cause first, labels shuffled")
    assert score.row("right cause first").value == 1.0
    assert control.bar[1] == pytest.approx(0.25 + 3 * (0.25 * 0.75 / 39) ** 0.5)
    assert control.mark == "ok" and control.cases == 40
    assert figures(run, seed=3).row("right cause first, labels shuffled").value != control.value


def test_seconds_of_a_case_are_those_of_the_full_plan(run: RunFolder) -> None:
    for seconds in range(1, 12):
        run.answer(run.case("none"), NO_GAP, seconds=float(seconds))
    run.answer(run.case("none", plan="static"), NO_GAP, seconds=1000.0)
    score = figures(run)
    assert shares(score.row("seconds a case, median")) == (6.0, 11)
    assert shares(score.row("seconds a case, 90 % quantile")) == (10.0, 11)
    assert score.row("seconds a case, median").mark == ""


def test_random_faults_that_did_not_occur_are_not_counted(run: RunFolder) -> None:
    """The fault occurs in one of the logs, in none, and the last case has no random fault."""
    for touched in ([{"torn_reads": []}, {"torn_reads": ["Gyro1"]}], [{"torn_reads": []}] * 2, [{}, {}]):
        run.both("single", NO_GAP, put("torn_reads"), touched=touched)
    score = figures(run)
    assert shares(score.row("detection at 5x the limit")) == (0.0, 2)
    assert score.notes == (
        "In 1 cases the fault, which occurs by chance, did not occur while logs were recorded: they are not counted.",
    )


def test_names_that_differ_from_the_generators_are_noted(run: RunFolder) -> None:
    case = run.both("single", RIPPLE, put("mains_ripple"))
    assert figures(run).notes == ()
    path = run.folder / "sealed" / f"{case.name}.json"
    table = json.loads(path.read_text())
    table["truth"]["mechanisms"][0]["resembles"] = ["scale"]
    path.write_text(json.dumps(table))
    assert len(figures(run).notes) == 1


def test_an_empty_run_has_no_counted_cases(run: RunFolder) -> None:
    score = figures(run)
    assert {row.mark for row in score.rows} == {"n.a.", ""}
    assert score.failed == () and score.half == "sealed" and score.frozen == FROZEN
    with pytest.raises(KeyError):
        score.row("anything else")
    json.dumps(as_json(score), allow_nan=False)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"plan\.json"):
        score_folder(tmp_path)


@pytest.mark.slow
def test_scores_are_written_as_json_and_text(run: RunFolder) -> None:
    """No number that JSON cannot represent; no line over 120 columns; two calls give the same."""
    for number in range(12):
        effect = "tone" if number else "scale" * 40
        run.both("single", gap_diagnosis(cause(effect)), put("mains_ripple", 5.0), oracle=0.9)
    run.both("none", NO_GAP)
    run.both("single", RIPPLE, put("crossed_wiring", THERE_OR_NOT))
    score = figures(run)
    table = json.loads(json.dumps(as_json(score), allow_nan=False))
    assert table["half"] == "sealed" and table["plan"]["frozen"] == FROZEN
    first = next(row for row in table["figures"] if row["name"] == "right cause first")
    assert (first["cases"], first["bar"], first["passes"]) == (13, [0.9, None], False)
    assert first["value"] == pytest.approx(11 / 13)
    lines = format_text(score).splitlines()
    assert max(map(len, lines)) <= 120
    assert lines[0] == "sealed half: 14 cases, 0 lost"
    (line,) = (line for line in lines if line[5:].startswith("right cause first "))
    assert line.split() == [
        "FAIL",
        "right",
        "cause",
        "first",
        "0.846",
        "0.578",
        "to",
        "0.957",
        "13",
        "at",
        "least",
        "0.9",
    ]
    assert as_json(figures(run)) == as_json(score)


def test_bars_include_their_limits() -> None:
    inside, outside = ScoreRow("a", 0.3, 0.1, 0.5, 9, (0.1 + 0.2, None)), ScoreRow("b", 0.29, 0.2, 0.31, 9, (0.3, None))
    assert inside.passes is True and outside.passes is False and not outside.is_refuted
    assert ScoreRow("c", 0.29, 0.2, 0.295, 9, (0.3, None)).is_refuted
    assert ScoreRow("d", 0.7, 0.65, 0.8, 9, (None, 0.6)).is_refuted
    assert not ScoreRow("one case", 0.1, nan, nan, 1, (0.3, None)).is_refuted
    assert ScoreRow("e", inf, 0, 0, 0, (0.3, None)).passes is None
