"""Folders of cases: their truth is read as a case, and an invalid truth is refused in one line."""

from __future__ import annotations

import json
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.errors import ConfigError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from imuarray.validation import injections
from imuarray.validation.case_folder import cases_in, read_case, write_truth
from imuarray.validation.injections import INJECTIONS, Injection, Rows, inject, write_cases

HEADERS = (
    SensorHeader("A", "bma180", "specific_force", "g", 4.0, 2048.0, has_temperature=True),
    SensorHeader("G", "l3g4200d", "angular_rate", "dps", 250.0, 114.0),
)
ROWS = 3200


def written(path: Path, seed: int = 0) -> Path:
    """At rest at 100 Hz: noise of 20 counts on 500, -300 and 2000."""
    path.parent.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(seed)
    time = np.arange(ROWS, dtype=np.int64) * 10_000_000
    with LogWriter(path, HEADERS, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for header in HEADERS:
            counts = np.round(20 * random.standard_normal((ROWS, 3)) + (500, -300, 2000)).astype(np.int16)
            warm = np.zeros(ROWS, np.int16) if header.has_temperature else None
            log.append(header.name, Block(time, counts, np.zeros(ROWS, np.uint16), warm))
    return path


def truth(*effects: Any, kind: str = "effect", **more: Any) -> dict[str, Any]:
    return {"kind": kind, "effects": list(effects), **more}


def effect(name: str | None, severity: float | None = 5.0, axes: str = "x", **more: Any) -> dict[str, Any]:
    return {
        "effect": "its maker's",
        "design_name": name,
        "sensors": ["A"],
        "axes": list(axes),
        "severity": severity,
        **more,
    }


def test_a_truth_is_read_as_a_case(tmp_path: Path) -> None:
    """By the names of its effects: one, none, two, no effect; an offset of a thermometer is within the tolerance of
    parts.
    """
    truths = [
        truth(effect("tone", also_called=["common_mode"]), experiments=["static", "heating"], sensors={"A": "bma180"}),
        truth(effect(None, None, "xyz"), kind="unknown", world="real", strata={"busy_board": True}),
        truth(effect("tone"), effect("scale", None), kind="pair", control="003"),
        truth(kind="control"),
        truth(effect("thermometer")),
    ]
    for number, written_truth in enumerate(truths):
        written(tmp_path / f"{number:03d}" / "log.h5")
        write_truth(tmp_path, f"{number:03d}", written_truth)
    (tmp_path / "999").mkdir()  # an unfinished case
    planned = cases_in([tmp_path], "sealed", 10)
    assert [case.name for case in planned] == [f"sealed-{number:05d}" for number in range(10, 15)]
    assert all(case.kind == "none" and not case.puts for case in planned)  # no part of the truth
    named, unnamed, pair, control, part = (read_case(case) for case in planned)
    case, logs, sealed = named
    assert (case.kind, case.plan, case.world, case.chips) == ("single", "heating+static", "foreign", {"A": "bma180"})
    assert case.resembles == (("tone", "common_mode"),)
    assert (case.puts[0].limits, case.puts[0].sensors) == (5.0, ("A",))
    assert [path.name for path in logs] == ["log.h5"]
    assert sealed["mechanisms"][0]["parameters"] == {"axes": ["x"]}
    assert (unnamed[0].kind, unnamed[0].world, unnamed[0].strata) == ("unnamed", "real", {"busy_board": "True"})
    assert isnan(unnamed[0].puts[0].limits)
    assert unnamed[2]["mechanisms"][0]["parameters"] == {}
    assert (pair[0].kind, pair[0].control) == ("pair", "sealed-00013")
    assert control[0].kind == part[0].kind == "none"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "odd", "effects": []}, "kind is missing or none of control, effect, unknown, pair"),
        ({"kind": "effect"}, "effects is not a list"),
        (truth({"effect": "a"}), "an effect has an effect, a design_name and sensors"),
        (truth(effect("ghost")), "effect 'ghost': allowed are"),
    ],
)
def test_an_invalid_truth_is_refused(tmp_path: Path, table: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        write_truth(tmp_path, "000", table)
    written(tmp_path / "000" / "log.h5")
    (tmp_path / "sealed").mkdir(exist_ok=True)
    (tmp_path / "sealed" / "000.json").write_text(json.dumps(table))
    with pytest.raises(ConfigError, match=message):
        read_case(cases_in([tmp_path], "sealed", 0)[0])


def test_a_folder_without_cases_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no cases: NAME/\*\.h5 and sealed/NAME\.json are required"):
        cases_in([tmp_path], "sealed", 0)


def injected(tmp_path: Path, name: str, size: float) -> tuple[Any, Any, Any, Any]:
    """Times and counts of A before and after; G and the thermometer stay in step."""
    path = written(tmp_path / "log.h5")
    with open_log(path) as log:
        before = log["A"].time[:], log["A"].counts[:].astype(float)
    inject(path, INJECTIONS[name], "A", 1, size, seed=3)
    with open_log(path) as log:
        after = log["A"].time[:], log["A"].counts[:].astype(float)
        assert log["A"].temperature_counts is not None
        assert len(log["A"].temperature_counts) == len(log["A"].status) == len(after[0])
        assert len(log["G"].time) == ROWS
    return *before, *after


@pytest.mark.slow
def test_effects_put_into_a_recording(tmp_path: Path) -> None:
    """A line of 100 counts has a variance of 100^2 / 2, on one axis; a wander of 100 rms is slow; a tenth of the rows
    is missing; codes are even; a clock is 2 % fast; an axis has the readings of another.
    """
    _, before, _, after = injected(tmp_path / "line", "line", 100.0)
    added = after - before
    assert np.array_equal(added[:, 0], 0 * added[:, 0])
    assert added[:, 1].var() == pytest.approx(5000, rel=0.05)
    _, before, _, after = injected(tmp_path / "wander", "wandering_offset", 100.0)
    added = (after - before)[:, 1]
    assert np.diff(added).std() == pytest.approx(100 * np.sqrt(2 * 0.01 / 30), rel=0.1)
    _, before, _, after = injected(tmp_path / "drop", "dropped_rows", 0.1)
    assert len(after) / len(before) == pytest.approx(0.9, abs=0.02)
    _, before, _, after = injected(tmp_path / "even", "even_codes", 1.0)
    assert (after % 2 == 0).all()
    assert np.abs(after - before).max() == 1
    old, _, new, _ = injected(tmp_path / "clock", "clock_off", 0.02)
    assert (new[-1] - new[0]) / (old[-1] - old[0]) == pytest.approx(1.02)
    _, before, _, after = injected(tmp_path / "swap", "swapped_axis", 1.0)
    assert np.array_equal(after[:, 1], before[:, 2])
    assert np.array_equal(after[:, 2], -before[:, 1])


def test_a_small_effect_changes_few_coarse_codes(tmp_path: Path) -> None:
    """Codes in steps of 8: a share of |e| / 8 of them changes, all by 8, and their mean by e; e = 0.4 sin, whose mean
    size is 0.4 * 2 / pi.
    """
    path = written(tmp_path / "log.h5")
    inject(path, Injection(_coarse, (), 0.0), "A", 0, 1.0, seed=1)
    with open_log(path) as log:
        before = log["A"].counts[:].astype(int)
    inject(path, INJECTIONS["line"], "A", 1, 0.4, seed=2)
    with open_log(path) as log:
        added = log["A"].counts[:].astype(int) - before
    assert set(np.unique(added)) == {-8, 0, 8}
    assert not added[:, [0, 2]].any()
    share = 0.4 * 2 / np.pi / 8
    assert np.mean(added[:, 1] != 0) == pytest.approx(share, abs=4 * np.sqrt(share / ROWS))


def _coarse(rows: Rows, axis: int, size: float, random: Any) -> Rows:
    return rows._replace(counts=np.round(rows.counts / 8) * 8)


def test_only_observable_effects_are_put_into_a_recording(tmp_path: Path) -> None:
    """At rest neither a swapped axis nor a wrong clock is observable; doubled steps only in the sensor
    with all codes.
    """
    path = written(tmp_path / "run.h5")
    inject(path, INJECTIONS["even_codes"], "A", 0, 1.0, seed=1)
    names = ("swapped_axis", "clock_off", "even_codes")
    assert write_cases([path], tmp_path / "cases", 1, names=names) == ["000", "001"]
    told = json.loads((tmp_path / "cases" / "sealed" / "001.json").read_text())
    assert [(effect["effect"], effect["sensors"]) for effect in told["effects"]] == [("even_codes", ["G"])]


@pytest.mark.slow
def test_a_recording_gives_a_control_and_cases(tmp_path: Path) -> None:
    """Cases of the requested size; the control is the unchanged log, and the cases of a second recording follow."""
    path = written(tmp_path / "run.h5")
    folder = tmp_path / "cases"
    numbers = write_cases([path], folder, 1, names=("line", "even_codes"), limits=5.0)
    assert numbers == ["000", "001", "002"]
    assert (folder / "000" / "run.h5").read_bytes() == path.read_bytes()
    control, line, even = (read_case(case) for case in cases_in([folder], "development", 0))
    assert control[0].kind == "none"
    assert line[0].world == even[0].world == "real"
    assert line[0].control == even[0].control == "development-00000"
    assert line[0].puts[0].limits == 5.0
    measured = line[2]["told"]["effects"][0]["measured"]
    assert 4.0 <= measured <= 6.25
    assert write_cases([path], folder, 2, names=("even_codes",)) == ["003", "004"]
    assert injections.LIMITS == 5.0
