"""The fast path from counts to triads equals the full path, and is taken where its conditions are met."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.calibrate import Calibration
from imuarray.fuse import Estimate, Frames, fuse
from imuarray.fuse import stream as short
from imuarray.fuse.least_squares import BLOCK_BYTES, ConstantGain, FixedWeights
from imuarray.log import Block, open_log
from tests.fuse.conftest import DPS, Floats, G, Part, WriteRun, calibration, joined, pointing
from tests.selection import examples, some

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z")


@given(seed=st.integers(0, 1 << 32), sensors=st.integers(1, 9), rows=st.integers(1, 3000))
@settings(max_examples=examples(25), deadline=None)
def test_triads_are_the_gain_times_counts_minus_bias(seed: int, sensors: int, rows: int) -> None:
    """Compared for a few rows with plain Python numbers; the whole span of int16, blocks of any length."""
    rng = np.random.default_rng(seed)
    counts = [rng.integers(-32768, 32768, (rows, 3)).astype(np.int16) for _ in range(sensors)]
    gain, bias = rng.normal(size=(3, 3 * sensors)), rng.normal(0, 100, 3 * sensors)
    triads = ConstantGain(gain, bias)(counts)
    for row in {0, rows // 2, rows - 1}:
        raw = [float(count) for part in counts for count in part[row]]
        terms = [[g * (c - b) for g, c, b in zip(line, raw, bias, strict=True)] for line in gain]
        largest = max(abs(term) for line in terms for term in line) + 100 * np.abs(gain).max()
        assert triads[row] == pytest.approx([sum(line) for line in terms], abs=1e-12 * largest * sensors)


def test_blocks_of_rows_are_contiguous() -> None:
    """Three blocks and a part of another: the sum of the columns, exactly."""
    rows = 3 * BLOCK_BYTES // (4 * 8) + 5
    counts = np.arange(3 * rows, dtype=np.int64).reshape(rows, 3) % 30_000
    triads = ConstantGain(np.ones((3, 3)), np.zeros(3))([counts.astype(np.int16)])
    assert (triads == counts.sum(axis=1)[:, None]).all()


def at_once() -> list[Part]:
    """Three accelerometers and a gyroscope, read at the same time, noise and bias on all."""
    bias = lambda seconds: np.full((len(seconds), 3), 0.3)  # noqa: E731
    units = [Part(f"A{i}", AXES[i], sigma=0.01, error=bias) for i in range(3)]
    return [*units, Part("G", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 114.0, sigma=0.1)]


def shaken(seconds: Floats) -> Floats:
    return np.asarray(np.sin(2 * np.pi * np.outer(seconds, [1.0, 0.7, 1.3])) * [0.9, 0.3, 0.6] + [0, 0, 1])


def ways(run: Path, known: Calibration, monkeypatch: pytest.MonkeyPatch) -> tuple[list[Floats], list[Floats], int]:
    """Both triads with and without the fast path; the number of blocks of frames on the full path."""
    seen = 0
    whole = FixedWeights.__call__

    def counting(self: FixedWeights, frames: Frames) -> Estimate:
        nonlocal seen
        seen += len(frames.time) > 1
        return whole(self, frames)

    with open_log(run) as log, monkeypatch.context() as patch:
        patch.setattr(FixedWeights, "__call__", counting)
        first = list(fuse(log, known, "mean", block=200))
        long = seen
        patch.setattr("imuarray.fuse.stream.plain_counts", lambda blocks, grid: None)
        second = list(fuse(log, known, "mean", block=200))
    for one, other in zip(first, second, strict=True):
        for quantity in one.triads:
            assert (one.used[quantity] == other.used[quantity]).all()
            np.testing.assert_allclose(one.covariances[quantity], other.covariances[quantity])
    quantities = ("specific_force", "angular_rate")
    return [joined(first, name)[1] for name in quantities], [joined(second, name)[1] for name in quantities], long


@pytest.mark.slow
def test_fast_and_full_paths_agree(write_run: WriteRun, monkeypatch: pytest.MonkeyPatch) -> None:
    run = write_run(at_once(), force=shaken, rate=shaken)
    first, second, long = ways(run, calibration(at_once()), monkeypatch)
    assert long == 0
    for one, other in zip(first, second, strict=True):
        assert np.abs(one - other).max() < 1e-12 * np.abs(one).max()
    # Both equal the mean of the rounded counts, computed for each sensor.
    with open_log(run) as log:
        sensors = [np.asarray(log[f"A{i}"].counts[:], float) @ pointing(AXES[i]) / 2048 * G for i in range(3)]
        turning = np.asarray(log["G"].counts[:], float) / 114 * DPS
    assert first[0] == pytest.approx(np.mean(sensors, axis=0), rel=1e-12)
    assert first[1] == pytest.approx(turning, rel=1e-12)


@pytest.mark.parametrize("what", some(["late", "lost", "suspect", "saturated"], 2))
def test_the_full_path_is_taken_for_late_lost_or_flagged_readings(
    what: str, write_run: WriteRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = at_once()
    between = lambda seconds: (seconds > 4.0) & (seconds < 4.3)  # noqa: E731
    if what == "late":
        parts[1] = parts[1]._replace(late_s=1e-6)
    elif what == "lost":
        parts[1] = parts[1]._replace(lost=between)
    elif what == "suspect":
        parts[1] = parts[1]._replace(suspect=between)
    else:
        parts[1] = parts[1]._replace(error=lambda seconds: 20.0 * between(seconds)[:, None] * np.ones(3))
    run = write_run(parts, force=shaken, rate=shaken)
    first, second, long = ways(run, calibration(parts), monkeypatch)
    assert long > 0
    assert all(np.abs(one - other).max() < 1e-12 * np.abs(one).max() for one, other in zip(first, second, strict=True))


def test_readings_at_different_times_take_the_full_path() -> None:
    time = np.arange(10) * 1000
    block = Block(time, np.zeros((10, 3), np.int16), np.zeros(10, np.uint16))
    assert short.plain_counts([block], time[3:6]) is not None
    assert short.plain_counts([block], time[3:6] + 1) is None
    assert short.plain_counts([block], np.array([7000, 8000, 9000, 10000])) is None
    assert short.plain_counts([block, None], time[3:6]) is None
