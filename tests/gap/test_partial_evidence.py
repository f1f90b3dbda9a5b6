"""Effects in one rate, one log, a part of the time or some units only, in synthetic logs: each is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from imuarray.gap.diagnose import compare, explain, library
from imuarray.gap.inference.effects import Candidate, Hypothesis
from imuarray.gap.inference.evidence import in_logs
from imuarray.gap.inference.forward_selection import guesses_of
from imuarray.gap.inference.refinement import distinct
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.conversion import Quantisation
from imuarray.simulate.effects.noise import Tone
from tests.gap import multirate_logs
from tests.gap.effects.evidence_of import evidence_of
from tests.gap.small_bench import Run

REPLICATES = 40

CASES: Mapping[str, tuple[str, tuple[str, ...], Mapping[str, multirate_logs.Change], Mapping[str, float]]] = {
    # expected effect and sensors; changes by sensor; parameters to a tenth
    "rows of one rate are correlated": (
        "bandwidth",
        ("G1",),
        {"G1": multirate_logs.low_pass(30.0)},
        {"cutoff_hz": 30.0},
    ),
    "a line that the slower rows alias": (
        "tone",
        ("G2",),
        {"G2": multirate_logs.line(71.3, 0.018)},
        {"frequency_hz": 71.3},
    ),
    "rows of one rate repeat": ("odr_error", ("G1",), {"G1": multirate_logs.held(160.0)}, {"rate_hz": 160.0}),
    "a line in one log": ("tone", ("G2",), {"G2": multirate_logs.line(11.0, 0.03, logs=(1,))}, {"frequency_hz": 11.0}),
    "a line since a moment": (
        "tone",
        ("G2",),
        {"G2": multirate_logs.line(31.0, 0.04, since_s=33.0, logs=(0,))},
        {"frequency_hz": 31.0},
    ),
    "even codes for a part of the time": (
        "quantisation",
        ("G3",),
        {"G3": multirate_logs.even_codes(20.0, 41.0)},
        {"step_lsb": 2.0},
    ),
    "noise in one log": ("white_noise", ("G1",), {"G1": multirate_logs.more_noise(1.25, (0,))}, {}),
    "noise for a part of the time": (
        "white_noise",
        ("G1",),
        {"G1": multirate_logs.more_noise(1.3, (0,), 15.0, 40.0)},
        {},
    ),
    "noise that two of three units share": (
        "common_mode",
        ("G1", "G3"),
        {name: multirate_logs.shared_noise(0.035) for name in ("G1", "G3")},
        {},
    ),
    "noise that two of three units share since a moment": (
        "common_mode",
        ("G1", "G3"),
        {name: multirate_logs.shared_noise(0.06, since_s=33.0, logs=(0,)) for name in ("G1", "G3")},
        {},
    ),
    "a low-pass since a moment": ("bandwidth", ("G2",), {"G2": multirate_logs.low_pass_since(25.0, 31.0)}, {}),
    "codes of one axis come in fours in one log": (
        "quantisation",
        ("G2",),
        {"G2": multirate_logs.in_fours(1, (0,))},
        {},
    ),
    "another level for a part of the time": ("bias", ("G1",), {"G1": multirate_logs.shifted(0.06, 17.3, 29.0)}, {}),
    "another level since a moment": ("bias", ("G3",), {"G3": multirate_logs.shifted(-0.1, 33.1, axis=2)}, {}),
    "four rows are lost": ("dropped_samples", ("G2",), {"G2": multirate_logs.lost([7.31, 15.02, 40.4, 51.9])}, {}),
    "four rows are lost, and no flag says so": (
        "dropped_samples",
        ("G2",),
        {"G2": multirate_logs.lost([7.31, 15.02, 40.4, 51.9], flagged=False)},
        {},
    ),
    "three readings are off": ("glitches", ("G2",), {"G2": multirate_logs.off([7.31, 40.4, 51.9], 70)}, {}),
}


@pytest.mark.parametrize(
    ("case", "names"),
    [
        pytest.param("rows of one rate are correlated", ("G1",), marks=pytest.mark.slow),
        *(pytest.param(case, ("G1", "G2", "G3"), marks=pytest.mark.campaign) for case in CASES),
    ],
)
def test_the_effect_is_the_first_cause(case: str, names: tuple[str, ...], tmp_path: Path) -> None:
    effect, sensors, changes, told = CASES[case]
    recordings = multirate_logs.recorded(tmp_path, changes, names=names)
    found = explain(compare(recordings, Run, seed=1, replicates=REPLICATES), library(()), briefly=True)
    cause = found.causes[0]
    assert (cause.effect, cause.sensors) == (effect, sensors)
    assert cause.action in ("add", "replace")  # the configured filter may be fitted already
    for name, value in told.items():
        assert cause.parameters[name] == pytest.approx(value, rel=0.1)
    assert found.verdict == "explained"


@pytest.mark.campaign
def test_common_noise_of_two_chips_is_named(tmp_path: Path) -> None:
    """Noise of a supply in both: it is common along their own axes, for any orientation."""
    changes = {name: multirate_logs.shared_noise(0.003) for name in ("A1", "D1")}
    recordings = multirate_logs.recorded(tmp_path, changes, names=("A1", "A2", "D1"))
    found = explain(compare(recordings, Run, seed=1, replicates=REPLICATES), library(()), briefly=True)
    assert (found.causes[0].effect, found.causes[0].sensors) == ("common_mode", ("A1", "D1"))


@pytest.mark.slow
def test_trials_of_single_rates_are_added() -> None:
    """A trial suggested by one log is added to those of all logs, and none is repeated."""
    heard: list[int] = []

    def guesses(evidence: Any) -> list[Hypothesis]:
        logs = sorted({one.log for one in evidence.phases})
        heard.append(len(logs))
        return [Hypothesis((Bandwidth(10.0 if len(logs) > 1 else 40.0),), ("cutoff_hz",))]

    line = {"G1": (Tone((0.0, 0.04, 0.0), 17.0),)}
    evidence = evidence_of(("static", "tumble"), "G1", line)
    numbered = {probe: (0,) * len(rows) for probe, rows in evidence.scores.items()}
    found = guesses_of(_with_rows(evidence, numbered), {"bandwidth": Candidate("bandwidth", guesses)})
    assert heard == [2, 1]
    assert [effect for trial in found for effect in trial.effects] == [Bandwidth(10.0), Bandwidth(40.0)]


def _with_rows(evidence: Any, numbered: Mapping[str, tuple[int, ...]]) -> Any:
    """All rows are of the first log; those of the other log are unknown."""
    return replace(evidence, rows_of=numbered)


def test_trials_that_converge_to_the_same_place_are_tried_once() -> None:
    """Refined numbers may differ by a fifth, others by a hundredth; time and sensor must be equal."""
    amplitudes, free = [(0.0, size, 0.0) for size in (0.1, 0.11, 0.2)], ("amplitude",)
    lines = [Hypothesis((Tone(one, 17.0),), free) for one in amplitudes]
    assert distinct(lines) == [lines[0], lines[2]]
    others = [lines[0], Hypothesis((Tone(amplitudes[0], 17.1),), free), Hypothesis((Tone(amplitudes[0], 18.0),), free)]
    assert distinct(others) == [others[0], others[2]]
    assert len(distinct([lines[0], lines[0].at(in_logs([1])), lines[0].at(in_logs([2]))])) == 3
    assert len(distinct([Hypothesis((Quantisation(2.0),), whole=whole) for whole in (True, False)])) == 2
