"""Logs of a moving box with known truth in closed form, computed with numpy alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.fuse import FusedBlock
from imuarray.log import Block, LogWriter, Stimulus
from imuarray.log.format import Phase, SensorHeader

Floats = npt.NDArray[np.float64]
Motion = Callable[[Floats], Floats]
"""Seconds (n,) to g or dps (n, 3), box frame."""

EPOCH = "2024-01-01T00:00:00Z"
G = 9.80665
DPS = np.pi / 180


def still(seconds: Floats) -> Floats:
    """At rest, box Z up (accelerometers), or not turning at all (times zero, gyroscopes)."""
    return np.tile([0.0, 0.0, 1.0], (len(seconds), 1))


def nothing(seconds: Floats) -> Floats:
    return np.zeros((len(seconds), 3))


def pointing(axes: str) -> Floats:
    """(3, 3): row k is the box axis along which the sensor's axis k points."""
    rows = np.zeros((3, 3))
    for index in range(3):
        rows[index, "XYZ".index(axes[2 * index + 1])] = 1.0 if axes[2 * index] == "+" else -1.0
    return rows


class Part(NamedTuple):
    """One sensor: its errors, in its own unit along its own axes, and its delay within the frame."""

    name: str
    axes: str = "+X+Y+Z"
    quantity: str = "specific_force"
    chip: str = "bma180"
    range: float = 16.0
    sensitivity: float = 2048.0
    sigma: Sequence[float] | float = 0.0
    error: Callable[[Floats], Floats] = nothing
    late_s: float = 0.0
    lost: Callable[[Floats], npt.NDArray[np.bool_]] = lambda seconds: np.zeros(len(seconds), bool)
    suspect: Callable[[Floats], npt.NDArray[np.bool_]] = lambda seconds: np.zeros(len(seconds), bool)

    @property
    def header(self) -> SensorHeader:
        unit = "g" if self.quantity == "specific_force" else "dps"
        return SensorHeader(
            self.name,
            self.chip,
            self.quantity,
            unit,
            self.range,
            self.sensitivity,
            axes=self.axes,  # type: ignore[arg-type]
        )

    def block(self, frames_s: Floats, motion: Motion, rng: np.random.Generator) -> Block:
        """Its rows: rounded to counts, clipped and flagged at the ends of the range."""
        seconds = frames_s + self.late_s
        units = motion(seconds) @ pointing(self.axes).T + self.error(seconds)
        units = units + rng.normal(0.0, 1.0, units.shape) * np.asarray(self.sigma)
        end = min(32767, round(self.range * self.sensitivity))
        counts = np.clip(np.rint(units * self.sensitivity), -end, end).astype(np.int16)
        status = np.where((np.abs(counts.astype(int)) >= end).any(axis=1), 4, 0) | np.where(
            self.suspect(seconds), 32, 0
        )
        kept = ~self.lost(seconds)
        time = np.round(seconds * 1e9).astype(np.int64)
        return Block(time[kept], counts[kept], status[kept].astype(np.uint16))


class WriteRun:
    """Writes a log of `frames` frames of a motion, with a truth on the frames' times."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(
        self,
        parts: Sequence[Part],
        *,
        force: Motion = still,
        rate: Motion = nothing,
        frames: int = 1000,
        rate_hz: float = 100.0,
        truth: str = "truth",
        phases: Sequence[Phase] = (),
        seed: int = 1,
        name: str = "run.h5",
        jitter_s: float = 0.0,
    ) -> Path:
        rng = np.random.default_rng(seed)
        seconds = np.arange(frames) / rate_hz + rng.uniform(-jitter_s, jitter_s, frames) + jitter_s
        path = self.folder / name
        with LogWriter(path, [part.header for part in parts], source="simulated", epoch=EPOCH) as writer:
            for part in parts:
                writer.append(part.name, part.block(seconds, force if part.quantity == "specific_force" else rate, rng))
            if truth:
                time = np.round(seconds * 1e9).astype(np.int64)
                felt = (force(seconds) * G, rate(seconds) * DPS)
                writer.stimulus(truth, Stimulus(time, *felt, np.full(frames, 25.0)))
            for phase in phases:
                writer.phase(phase)
        return path


def calibration(parts: Sequence[Part], noise: bool = True) -> Calibration:
    """A perfect calibration of these parts: no bias, the nominal response, their noise."""
    sensors = {}
    for part in parts:
        sensors[part.name] = SensorCalibration(
            name=part.name,
            quantity=part.quantity,
            unit=part.header.unit,
            bias_lsb=np.zeros(3),
            response_lsb_per_unit=part.sensitivity * pointing(part.axes),
            noise_lsb=np.broadcast_to(part.sigma, 3) * part.sensitivity if noise else None,
        )
    return Calibration(sensors)


def joined(blocks: Sequence[FusedBlock], quantity: str = "specific_force") -> tuple[npt.NDArray[np.int64], Floats]:
    """Time and triads of all blocks, concatenated."""
    blocks = list(blocks)
    return np.concatenate([b.time for b in blocks]), np.concatenate([b.triads[quantity] for b in blocks])


@pytest.fixture
def write_run(tmp_path: Path) -> WriteRun:
    """Writes runs into this test's folder."""
    return WriteRun(tmp_path)
