"""Accelerometers whose forces contradict each other are named before they are averaged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imuarray as ia
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import nominal
from imuarray.cli import main
from imuarray.fuse.gravity_directions import contradictions
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SATURATED, SUSPECT, SensorHeader
from imuarray.log.import_report import ImportReport, store_import_report

LSB_PER_G = 1000.0


def log_of(path: Path, forces_g: dict[str, list[float]], rows: int = 40, flags: dict[str, int] | None = None) -> Path:
    """Accelerometers at rest, which read these forces in the box frame at 20 Hz."""
    headers = [
        SensorHeader(name, "unknown", "specific_force", "g", 16.0, LSB_PER_G, 20.0, 0.0, "+X+Y+Z") for name in forces_g
    ]
    with LogWriter(path, headers, source="imported", epoch="2024-05-06T12:00:00.000000Z") as log:
        for name, force in forces_g.items():
            counts = np.tile(np.rint(np.array(force) * LSB_PER_G), (rows, 1)).astype(np.int16)
            status = np.full(rows, (flags or {}).get(name, 0), np.uint16)
            log.append(name, Block(np.arange(rows) * 50_000_000, counts, status))
    return path


def series_of(path: Path, series: dict[str, tuple[np.ndarray, np.ndarray]]) -> Path:
    """Accelerometers with these times (n,) in ns and counts (n, 3)."""
    header = SensorHeader("A", "unknown", "specific_force", "g", 16.0, LSB_PER_G, 20.0, 0.0, "+X+Y+Z")
    headers = [replace(header, name=name) for name in series]
    with LogWriter(path, headers, source="imported", epoch="2024-05-06T12:00:00Z") as log:
        for name, (time_ns, counts) in series.items():
            if len(time_ns):
                log.append(name, Block(time_ns, counts, np.zeros(len(time_ns), np.uint16)))
    return path


def tilted(angle_deg: float, length_g: float = 1.0) -> list[float]:
    """A force in the plane of y and z, at this angle from z."""
    angle = np.radians(angle_deg)
    return [0.0, length_g * float(np.sin(angle)), length_g * float(np.cos(angle))]


def sentences(path: Path) -> list[str]:
    with open_log(path) as log:
        return list(contradictions(log.of("specific_force"), Calibration()))


@pytest.mark.parametrize(("angle_deg", "count"), [(0.0, 0), (28.0, 0), (44.0, 0), (46.0, 1), (90.0, 1), (180.0, 1)])
def test_directions_that_biases_do_not_explain_are_named(tmp_path: Path, angle_deg: float, count: int) -> None:
    listed = sentences(log_of(tmp_path / "a.h5", {"A": tilted(0), "B": tilted(angle_deg)}))
    expected = f"B: its specific force points {angle_deg:.0f} degrees from that of A: axes are wrong"
    assert [text[: len(expected)] for text in listed] == [expected] * count


def test_the_majority_is_the_reference(tmp_path: Path) -> None:
    path = log_of(tmp_path / "a.h5", {"A": tilted(180), "B": tilted(5), "C": tilted(-5)})
    (text,) = sentences(path)
    assert text.startswith("A: its specific force points 175 degrees from that of B, C: ")


@pytest.mark.parametrize(("length_g", "count"), [(0.45, 0), (0.55, 1)])
def test_a_small_force_has_no_direction(tmp_path: Path, length_g: float, count: int) -> None:
    path = log_of(tmp_path / "a.h5", {"A": tilted(0), "B": tilted(180, length_g)})
    assert len(sentences(path)) == count


@pytest.mark.parametrize("flag", [SATURATED, SUSPECT])
def test_flagged_rows_are_not_compared(tmp_path: Path, flag: int) -> None:
    path = log_of(tmp_path / "a.h5", {"A": tilted(0), "B": tilted(180)}, flags={"B": flag})
    assert sentences(path) == []


@pytest.mark.parametrize(("turned_s", "count"), [(10.0, 0), (4.0, 1)])
def test_only_the_first_ten_seconds_are_compared(tmp_path: Path, turned_s: float, count: int) -> None:
    """B reads 3 g downwards from then on, so that the mean of 20 s points down: -1 g and -2.2 g. That of the first 10 s
    is 1 g if B is turned at 10 s, and 0.4 g - 0.6 * 3 g = -1.4 g if it is turned at 4 s.
    """
    time_ns = np.arange(400) * 50_000_000
    up = np.tile([0, 0, 1000], (400, 1)).astype(np.int16)
    turned = np.where(time_ns[:, None] < turned_s * 1e9, up, -3 * up).astype(np.int16)
    path = series_of(tmp_path / "a.h5", {"A": (time_ns, up), "B": (time_ns, turned)})
    assert [text[:2] for text in sentences(path)] == ["B:"] * count


def test_the_comparison_begins_when_all_have_begun(tmp_path: Path) -> None:
    """B points down from its beginning, 12 s after that of A; C has no rows at all."""
    time_ns = np.arange(400) * 50_000_000
    up = np.tile([0, 0, 1000], (400, 1)).astype(np.int16)
    series = {"A": (time_ns, up), "B": (time_ns[240:], -up[240:]), "C": (time_ns[:0], up[:0])}
    (text,) = sentences(series_of(tmp_path / "a.h5", series))
    assert text.startswith("B: its specific force points 180 degrees from that of A: ")


def test_forces_are_calibrated_before_they_are_compared(tmp_path: Path) -> None:
    """Without its bias of 1 g along y, B points where A does; with it, 45 degrees and 135 degrees away from A and C."""
    forces_g = {"A": tilted(0), "B": [0.0, 1.0, 1.0], "C": tilted(-60)}
    with open_log(log_of(tmp_path / "a.h5", forces_g)) as log:
        sensors = log.of("specific_force")
        bias = {name: np.array([0.0, lsb, 0.0]) for name, lsb in (("B", LSB_PER_G), ("C", -866.0))}
        known = {name: replace(nominal(log[name]), bias_lsb=bias_lsb) for name, bias_lsb in bias.items()}
        assert len(list(contradictions(sensors, Calibration()))) > 0
        assert list(contradictions(sensors, Calibration(known))) == []


def test_fuse_states_contradictions_and_doubts_of_the_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = log_of(tmp_path / "a.h5", {"A": tilted(0), "B": tilted(180)})
    store_import_report(path, ImportReport(doubts=("A: a doubt", "B: another doubt")))
    doubts = f"{path}: its import raised 2 doubts: `imuarray info {path}` lists them"
    fused = ia.fuse(path)
    assert fused.remarks[0] == doubts
    assert fused.remarks[1].startswith("B: its specific force points 180 degrees from that of A")
    assert main(["fuse", str(path), "-o", str(tmp_path / "f.h5"), "--json"]) == 0
    output = capsys.readouterr()
    assert json.loads(output.out)["remarks"] == list(fused.remarks)
    assert output.err.splitlines()[:2] == [f"imuarray: {text}" for text in fused.remarks]


@pytest.mark.parametrize(
    "command",
    [
        ["characterise"],
        ["calibrate", "noise", "-o", "cal.toml"],
        ["export", "-o", "a.csv"],
        pytest.param(["simulate", "--like", "-o", "b.h5"], marks=pytest.mark.slow),
        pytest.param(["gap", "diagnose", "--replicates", "40"], marks=pytest.mark.slow),
    ],
)
def test_commands_that_derive_figures_state_the_doubts_of_the_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    store_import_report(log_of(Path("a.h5"), {"A": tilted(0)}, 400), ImportReport(doubts=("A: a doubt",)))
    place = command.index("-o") if "-o" in command else 2
    main([*command[:place], "a.h5", *command[place:]])
    assert "imuarray: a.h5: its import raised 1 doubt: `imuarray info a.h5` lists them" in capsys.readouterr().err
