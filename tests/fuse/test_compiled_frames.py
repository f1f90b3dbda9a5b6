"""Compiled passes over frames against NumPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import SensorCalibration
from imuarray.fuse import compiled_frames, fuse
from imuarray.fuse.alignment import AlignedSensor, _delay_noise, align, between_gaps, derivatives
from imuarray.fuse.frames import Axis, CalibrationErrors
from imuarray.fuse.least_squares import TOLERATED_SI, ConstantGain, SlowErrors, consensus
from imuarray.log import Block, open_log
from imuarray.log.format import STALE, SUSPECT
from tests.fuse.conftest import Floats, Part, WriteRun, calibration, pointing
from tests.selection import some

pytestmark = pytest.mark.skipif(not compiled_frames.COMPILED, reason="installed without a C compiler")

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z", "+X-Y-Z")
FORCE = "specific_force"


def leave_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_frames, "COMPILED", False)


def swinging(seconds: Floats) -> Floats:
    return np.asarray(0.4 * np.sin(np.outer(seconds, [3.0, 2.0, 1.0])) + [0.0, 0.0, 1.0])


def fused(path: Path, parts: list[Part], technique: str) -> list[Floats]:
    """All columns of the result: triads, covariances and axes in use, of every block."""
    with open_log(path) as log:
        blocks = list(fuse(log, calibration([part._replace(sigma=0.01) for part in parts]), technique, block=700))
    columns = [np.concatenate([getattr(block, name)[FORCE] for block in blocks]) for name in ("triads", "covariances")]
    return [*columns, np.concatenate([block.used[FORCE] for block in blocks])]


@pytest.mark.parametrize("technique", some(["mean", "planes", "ranges"], 1))
@pytest.mark.parametrize("case", some(["sound", "suspect", "lost", "clipped"], 1))
def test_a_compiled_fusion_equals_numpy(
    write_run: WriteRun, monkeypatch: pytest.MonkeyPatch, technique: str, case: str
) -> None:
    """Sensors that are read one after the other, one of them with a large error."""
    parts = [Part(f"A{number}", axes, late_s=0.001 * number, sigma=0.004) for number, axes in enumerate(AXES)]
    parts[2] = parts[2]._replace(error=lambda seconds: np.full((len(seconds), 3), 0.6))
    if case == "suspect":
        parts[1] = parts[1]._replace(suspect=lambda seconds: seconds > 8.0)
    if case == "lost":
        parts[3] = parts[3]._replace(lost=lambda seconds: np.sin(40 * seconds) > 0.9)
    if case == "clipped":
        parts[4] = parts[4]._replace(range=1.2)
    path = write_run(parts, force=swinging)
    compiled = fused(path, parts, technique)
    leave_out(monkeypatch)
    for result, wanted in zip(compiled, fused(path, parts, technique), strict=True):
        np.testing.assert_allclose(result, wanted, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("sensors", [1, 2, 3, 4, 6, 9, 12, 33])
@pytest.mark.parametrize("frames", [1, 31, 32, 100])
def test_a_compiled_consensus_equals_numpy(sensors: int, frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sensors that agree in some frames and not in others; NumPy handles more sensors than the compiled
    code accepts.
    """
    rng = np.random.default_rng(sensors)
    rows = np.concatenate([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(sensors)])
    spread = rng.choice([0.05, 3.0], (frames, 1)) * TOLERATED_SI[FORCE]
    values = rng.normal(0, 5, (frames, 3)) @ rows.T + spread * rng.normal(size=(frames, 3 * sensors))
    valid = np.ones(values.shape, bool)
    valid[::7, 0] = False
    result = consensus(values, valid, rows, FORCE)
    leave_out(monkeypatch)
    np.testing.assert_allclose(result, consensus(values, valid, rows, FORCE), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("sensors", [1, 3])
@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 100])
def test_the_compiled_noise_of_delays_equals_numpy(
    sensors: int, complete: bool, frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At irregular frames with a pause, some without a known slope, some without a reading."""
    rng = np.random.default_rng(frames)
    grid = np.cumsum(rng.integers(8_000_000, 12_000_000, frames)) + 200_000_000 * (np.arange(frames) > 60)
    slope, late_s = rng.normal(size=(frames, 3)), rng.uniform(0, 0.005, (sensors, frames))
    slope[frames // 3] = 0.0
    valid = np.ones(late_s.shape, bool) if complete else rng.random(late_s.shape) < 0.7
    result = _delay_noise(grid, slope, valid, late_s * valid, 1e7)
    leave_out(monkeypatch)
    wanted = _delay_noise(grid, slope, valid, late_s * valid, 1e7)
    assert result.shape == wanted.shape == (frames, 2 * sensors)
    np.testing.assert_allclose(result, wanted, rtol=2e-7)


@pytest.mark.parametrize("jitter_ns", [0, 3_000_000])
def test_compiled_nearest_readings_equal_numpy(jitter_ns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Irregular frames, two of which may be near the same reading; one sensor has no rows."""
    rng = np.random.default_rng(5)
    grid = 10_000_000 * np.arange(1, 400) + rng.integers(0, jitter_ns + 1, 399)
    units = [AlignedSensor(SensorCalibration("A", FORCE, "g", np.ones(3), 1000 * np.eye(3)), 8191.0)] * 3
    blocks: list[Block | None] = [None]
    for _ in range(2):
        time = 10_000_000 * np.arange(1, 400) + rng.integers(0, jitter_ns + 1, 399)
        kept = np.flatnonzero(rng.random(399) < 0.8)
        flags = rng.choice(np.array([0, 0, 0, STALE, SUSPECT], np.uint16), len(kept))
        counts = rng.integers(-2000, 2000, (len(kept), 3)).astype(np.int16)
        blocks.append(Block(time[kept], counts, flags))
    rows = np.tile(np.eye(3), (3, 1))
    result = align(units, blocks, grid, 1e7, rows)
    leave_out(monkeypatch)
    wanted = align(units, blocks, grid, 1e7, rows)
    assert result.stale is not None
    assert wanted.stale is not None
    np.testing.assert_array_equal(result.valid, wanted.valid)
    np.testing.assert_array_equal(result.stale, wanted.stale)
    np.testing.assert_allclose(result.values, wanted.values, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("frames", [0, 1, 32, 77])
@pytest.mark.parametrize("widths", [(3,), (3, 3, 3), (4, 1, 7)])
def test_a_constant_gain_is_that_of_numpy(
    widths: tuple[int, ...], frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of counts to the ends of their range; those of another type are NumPy's."""
    rng = np.random.default_rng(frames)
    counts = [rng.integers(-32768, 32768, (frames, width)).astype(np.int16) for width in widths]
    gain = ConstantGain(rng.normal(size=(3, sum(widths))), rng.normal(0, 50, sum(widths)))
    result, wide = gain(counts), gain([part.astype(np.int32) for part in counts])
    leave_out(monkeypatch)
    wanted = gain(counts)
    np.testing.assert_array_equal(wide, wanted)
    np.testing.assert_allclose(result, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max(initial=0.0))


def test_a_constant_gain_of_whole_numbers_is_exact() -> None:
    """2 x - y + 3 z - 5 and x - 1, of sums that no rounding changes."""
    counts = np.array([[-32768, 32767, 5], [1, 2, 3], [0, 0, 32767]], np.int16)
    gain = np.array([[2.0, -1.0, 3.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    triads = ConstantGain(gain, np.array([1.0, 0.0, 1.0]))([counts[:, :1], counts[:, 1:]])
    x, y, z = counts.astype(int).T
    np.testing.assert_array_equal(triads, np.stack([2 * x - y + 3 * z - 5, x - 1, 0 * x], axis=1))


@pytest.mark.parametrize("rows", [4, 5, 200])
def test_a_compiled_spline_equals_scipy(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(rows)
    known = np.cumsum(rng.integers(5_000_000, 15_000_000, rows))
    at = np.sort(rng.integers(known[0], known[-1] + 1, 300))
    values = rng.normal(size=(rows, 3))
    results = between_gaps(known, values, at, 1e9), *derivatives(known, values, 1e9)
    leave_out(monkeypatch)
    for result, wanted in zip(
        results, (between_gaps(known, values, at, 1e9), *derivatives(known, values, 1e9)), strict=True
    ):
        np.testing.assert_allclose(result, wanted, rtol=1e-11, atol=1e-11 * np.abs(wanted).max())


def test_compiled_covariances_of_slow_errors_equal_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    axes = []
    for sensor in range(3):
        bias, response = rng.normal(size=(3, 3)), rng.normal(size=(9, 9))
        errors = CalibrationErrors(bias @ bias.T, (response @ response.T).reshape(3, 3, 3, 3))
        for index, direction in enumerate(pointing(AXES[sensor])):
            axes.append(Axis(f"A{sensor}", "chip", index, tuple(direction), 10.0, 0.1, errors=errors))
    slow, gain, triads = SlowErrors(axes), rng.normal(size=(1, 3, 9)), rng.normal(size=(70, 3))
    result = slow.covariance(gain, triads)
    each = slow.covariance(np.repeat(gain, 70, axis=0), triads)  # for each frame, with the matrices by their definition
    np.testing.assert_allclose(result, each, rtol=1e-12, atol=1e-11)
    leave_out(monkeypatch)
    np.testing.assert_allclose(result, slow.covariance(gain, triads), rtol=1e-12, atol=1e-11)


def test_arrays_of_other_sizes_are_refused() -> None:
    from imuarray.fuse import _frames

    numbers = np.zeros(12)
    with pytest.raises(ValueError, match="sizes"):
        _frames.triads((numbers,) * 4, (), 2)
    with pytest.raises(ValueError, match="sizes"):
        _frames.triads((numbers,) * 4, (0,), 2)
    with pytest.raises(ValueError, match="number of arrays"):
        _frames.triads((numbers,) * 3, (3,), 2)
    with pytest.raises(ValueError, match="array 0: 12 bytes"):
        _frames.triads((numbers,) * 4, (3,), 2)
    with pytest.raises(ValueError, match="number of arrays"):
        _frames.consensus((numbers,), (3, 4), 1.0)
    with pytest.raises(ValueError, match="array 1: 72 bytes"):
        _frames.consensus((numbers, numbers, numbers, numbers, numbers), (3, 4), 1.0)
    with pytest.raises(ValueError, match="sizes"):
        _frames.consensus((numbers, numbers, numbers, numbers, numbers), (4, 3), 1.0)
    with pytest.raises(ValueError, match="sizes"):
        _frames.slopes((numbers, numbers, numbers, numbers), (1, 3))
    with pytest.raises(ValueError, match="sizes"):
        _frames.curvatures((numbers, numbers, numbers, numbers), (1, 1))
    with pytest.raises(ValueError, match="sizes"):
        _frames.at((numbers,) * 6, (1, 2, -1))
    with pytest.raises(ValueError, match="sizes"):
        _frames.readings((numbers,) * 10, (0, 3), 5, 0.0, (1, 2, 4))
    with pytest.raises(ValueError, match="sizes"):
        _frames.motion((numbers,) * 6, (0, 3), 0.5)
    with pytest.raises(ValueError, match="sizes"):
        _frames.delay_noise((numbers,) * 6, (0, 3), 1e7, 5e7)
    with pytest.raises(ValueError, match="array 0: 480 bytes"):
        _frames.covariances((numbers, numbers, numbers), (1,))
