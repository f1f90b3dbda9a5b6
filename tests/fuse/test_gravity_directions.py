"""Accelerometers whose forces contradict each other are named before they are averaged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imuarray as ia
from imuarray.calibrate import Calibration
from imuarray.cli import main
from imuarray.fuse.gravity_directions import contradictions
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SATURATED, SensorHeader
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


def test_saturated_rows_are_not_compared(tmp_path: Path) -> None:
    path = log_of(tmp_path / "a.h5", {"A": tilted(0), "B": tilted(180)}, flags={"B": SATURATED})
    assert sentences(path) == []


def test_only_the_first_ten_seconds_are_compared(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    header = SensorHeader("A", "unknown", "specific_force", "g", 16.0, LSB_PER_G, 20.0, 0.0, "+X+Y+Z")
    with LogWriter(path, [header, replace(header, name="B")], source="imported", epoch="2024-05-06T12:00:00Z") as log:
        time = np.arange(400) * 50_000_000  # 20 s
        up = np.tile([0, 0, 1000], (400, 1)).astype(np.int16)
        turned = up.copy()
        turned[200:] *= -3  # from 10 s; the mean of all rows points down
        log.append("A", Block(time, up, np.zeros(400, np.uint16)))
        log.append("B", Block(time, turned, np.zeros(400, np.uint16)))
    assert sentences(path) == []


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
