"""Axes of a gyroscope that contradict those of the accelerometer: the report of the import names
the consistent axes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imuarray.importers.plausibility import report_of
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.selection import some

ROWS, RATE_HZ = 3000, 100.0


def record(path: Path, axes: str, mounted: np.ndarray) -> None:
    """A box that turns about all axes; `mounted` (3, 3) transforms vectors of the box into the gyroscope's frame."""
    time_s, rng = np.arange(ROWS) / RATE_HZ, np.random.default_rng(8)
    rate = np.stack([np.sin(2 * np.pi * f * time_s) for f in (0.31, 0.23, 0.17)], axis=1) * [1.6, 1.2, 2.0]
    attitude, up = Rotation.identity(), np.empty((ROWS, 3))
    for row in range(ROWS):
        up[row] = attitude.inv().apply([0, 0, 1])
        attitude = attitude * Rotation.from_rotvec(rate[row] / RATE_HZ)
    headers = [
        SensorHeader("A", "any", "specific_force", "g", 8.0, 4096.0),
        SensorHeader("G", "any", "angular_rate", "dps", 250.0, 131.0, axes=axes),
    ]
    readings = {"A": 4096 * (up + rng.normal(0, 0.01, up.shape))}
    readings["G"] = 131 * (np.degrees(rate) @ mounted.T + rng.normal(0.3, 0.1, up.shape))
    with LogWriter(path, headers, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for name, counts in readings.items():
            time_ns = np.round(time_s * 1e9).astype(np.int64)
            log.append(name, Block(time_ns, np.rint(counts).astype(np.int16), np.zeros(ROWS, np.uint16)))


def doubts(path: Path) -> tuple[str, ...]:
    with open_log(path) as log:
        return report_of(log).doubts


QUARTER = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
"""x points along box -Y, y along box X."""


@pytest.mark.slow
def test_the_consistent_axes_are_named_and_right(tmp_path: Path) -> None:
    record(tmp_path / "wrong.h5", "+X+Y+Z", QUARTER)
    (text,) = doubts(tmp_path / "wrong.h5")
    assert text.startswith("G: its rotations do not fit those of the accelerometers, but would with axes = '-Y+X+Z'")
    record(tmp_path / "right.h5", "-Y+X+Z", QUARTER)
    assert doubts(tmp_path / "right.h5") == ()


@pytest.mark.parametrize("mirrored", some([np.diag([1.0, 1.0, -1.0]), np.eye(3)[[1, 0, 2]]], 1))
def test_a_mirrored_gyroscope_is_doubted(tmp_path: Path, mirrored: np.ndarray) -> None:
    record(tmp_path / "run.h5", "+X+Y+Z", mirrored)
    (text,) = doubts(tmp_path / "run.h5")
    assert text.startswith("G: its rotations fit those of the accelerometers only with a mirrored axis")


def at_rest(path: Path, sign: int, field: np.ndarray | None = None, up: str = "") -> tuple[str, ...]:
    """The doubts on a box at rest with +Z up, with an accelerometer of this sign and a magnetometer; `up` is noted."""
    headers = [SensorHeader("A", "any", "specific_force", "g", 8.0, 4096.0)]
    rng = np.random.default_rng(9)
    readings = {"A": sign * 4096 * (np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.003, (ROWS, 3)))}
    if field is not None:
        headers.append(SensorHeader("M", "any", "magnetic_field", "gauss", 4.0, 1000.0))
        readings["M"] = 1000 * (field + rng.normal(0, 0.003, (ROWS, 3)))
    time_ns = np.arange(ROWS, dtype=np.int64) * 10_000_000
    with LogWriter(path, headers, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        for name, counts in readings.items():
            log.append(name, Block(time_ns, np.rint(counts).astype(np.int16), np.zeros(ROWS, np.uint16)))
        if up:
            log.phase(Phase(0, int(time_ns[-1]), "z_down", up))
    with open_log(path) as log:
        return report_of(log).quirks


@pytest.mark.slow
def test_gravity_along_a_negative_axis_has_three_explanations(tmp_path: Path) -> None:
    """The field in Central Europe: 0.2 gauss to the north and 0.43 down, 65 degrees below the horizon (IGRF)."""
    assert at_rest(tmp_path / "up.h5", 1) == ()
    assert at_rest(tmp_path / "noted.h5", -1, up="-Z") == ()
    (text,) = at_rest(tmp_path / "down.h5", -1)
    assert text.startswith(
        "A: reads -1 g along box Z whenever it rests: the box is upside down, or this axis points down"
    )
    assert "signs = '---'" in text
    (text,) = at_rest(tmp_path / "dip.h5", -1, np.array([0.2, 0.0, -0.43]))
    assert text.endswith(
        "; by this sign the magnetic field points 65 degrees up, as it does in the southern hemisphere"
    )
    (text,) = at_rest(tmp_path / "turned.h5", -1, np.array([0.2, 0.0, 0.43]))
    assert text.endswith(
        "; by this sign the magnetic field points 65 degrees down, as it does in the northern hemisphere"
    )
