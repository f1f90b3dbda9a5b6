"""In-run drift: a Gauss-Markov process in white noise is estimated with valid intervals; white noise alone has none."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import binom

from imuarray.calibrate import Calibration, calibrate_noise, nominal
from imuarray.calibrate.model import BIAS, Drift, Thermal
from imuarray.calibrate.noise import _likelihood, fit_drift
from imuarray.calibrate.segments import SegmentMeans
from imuarray.cli import main
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import Phase
from tests.calibrate.conftest import EPOCH, Floats, gyroscope

WIDTH_S = 2.0
FINE = 10


def wander(rng: np.random.Generator, segments: int, rms: tuple[float, ...], time_constant_s: float) -> Floats:
    """Means over segments of a process sampled ten times a segment, (segments, 3)."""
    kept = np.exp(-WIDTH_S / FINE / time_constant_s)
    steps = rng.normal(0, 1, (segments * FINE, len(rms)))
    state, rows = steps[0], np.empty_like(steps)
    for i, step in enumerate(steps):
        rows[i] = state
        state = kept * state + np.sqrt(1 - kept**2) * step
    return np.asarray(rows.reshape(segments, FINE, -1).mean(axis=1) * rms)


def stretch(
    rng: np.random.Generator, segments: int, rms: tuple[float, ...], time_constant_s: float, level: float = 50.0
) -> SegmentMeans:
    noise = rng.normal(0, 1.0, (segments, 3))
    time_s = np.asarray(WIDTH_S * (0.5 + np.arange(segments)), float)
    return SegmentMeans(time_s, level + wander(rng, segments, rms, time_constant_s) + noise)


def fitted(*stretches: SegmentMeans) -> Drift:
    drift = fit_drift(stretches, WIDTH_S)
    assert drift is not None and drift.rms_upper_lsb is not None and drift.time_constant_interval_s is not None
    return drift


def test_the_filter_likelihood_is_that_of_the_dense_covariance() -> None:
    """Means of a process, integrated numerically, and a free level, by Cholesky: differences between grid points."""
    rng = np.random.default_rng(1)
    part = stretch(rng, 40, (2.0, 1.0, 0.5), 12.0)
    kept = np.r_[0:20, 28:40]
    part = SegmentMeans(part.time_s[kept], part.mean[kept] - part.mean[kept].mean(axis=0))
    times, ratios = np.array([4.0, 12.0, 50.0]), np.array([0.3, 2.0])
    grid = _likelihood([part], WIDTH_S, times, np.repeat(ratios[:, None], 3, axis=1))
    inside = (np.arange(200) + 0.5) / 200 * WIDTH_S - WIDTH_S / 2
    apart = np.abs(np.subtract.outer(inside, inside))
    dense = np.empty((3, 2, 3))
    for i, time in enumerate(times):
        shift = np.abs(np.subtract.outer(part.time_s, part.time_s))
        shape = np.where(shift > 0, np.mean(np.exp(inside / time)) ** 2 * np.exp(-shift / time), 1.0)
        np.fill_diagonal(shape, np.exp(-apart / time).mean())
        for j, ratio in enumerate(ratios):
            factor = cho_factor(np.eye(len(shift)) + ratio**2 * shape)
            ones = cho_solve(factor, np.ones(len(shift)))
            for k in range(3):
                y = part.mean[:, k]
                square = y @ cho_solve(factor, y) - (ones @ y) ** 2 / ones.sum()
                logs = 2 * np.log(np.diag(factor[0])).sum() + np.log(ones.sum())
                dense[i, j, k] = -((len(y) - 1) * np.log(square / (len(y) - 1)) + logs) / 2
    assert grid.log_likelihood == pytest.approx(dense, abs=2e-3)  # 200 points a mean


@pytest.mark.slow
def test_a_drift_is_estimated_within_its_errors() -> None:
    """48 axes of 1 and 3 counts rms, 40 s, in 1000 s: 95 % within two errors; fewer than 41 once in 400 seeds."""
    assert binom.cdf(40, 48, 0.95) < 1 / 400
    rng = np.random.default_rng(2)
    result = [fitted(stretch(rng, 500, (1.0, 1.0, 3.0), 40.0)) for _ in range(16)]
    off = np.array([(drift.rms_lsb - [1.0, 1.0, 3.0]) / drift.rms_sem_lsb for drift in result])
    assert (np.abs(off) < 2).sum() >= 41
    held = [drift.time_constant_interval_s[0] <= 40 <= drift.time_constant_interval_s[1] for drift in result]  # type: ignore[index]
    assert sum(held) >= 12  # of 16; of 95 % once in 1000 seeds
    assert np.exp(np.mean([np.log(drift.time_constant_s) for drift in result])) == pytest.approx(40.0, rel=0.3)


@pytest.mark.slow
def test_white_noise_without_drift_gives_a_small_estimate() -> None:
    """White noise of 1 count: hardly an axis seems to drift (two errors), and none more than the noise of a mean."""
    rng = np.random.default_rng(3)
    result = [fitted(stretch(rng, 400, (0.0, 0.0, 0.0), 40.0)) for _ in range(8)]
    assert sum(int((drift.rms_lsb < 2 * drift.rms_sem_lsb).sum()) for drift in result) >= 19  # of 24
    assert max(drift.rms_upper_lsb.max() for drift in result if drift.rms_upper_lsb is not None) < 1.0


def test_segments_of_different_levels_are_pooled() -> None:
    rng = np.random.default_rng(4)
    parts = [stretch(rng, 200, (2.0, 2.0, 2.0), 20.0, level) for level in (-4000.0, 0.0, 4000.0)]
    drift = fitted(*parts)
    assert drift.rms_lsb == pytest.approx([2.0] * 3, rel=0.4)
    assert drift.span_s == pytest.approx(400.0)


def test_a_drift_slower_than_the_segment_has_no_upper_limit() -> None:
    """A process of 20000 s in 400 s: the interval of the time constant is open, its lower end far above the noise."""
    drift = fitted(stretch(np.random.default_rng(5), 200, (60.0, 60.0, 60.0), 20000.0))
    low, high = drift.time_constant_interval_s  # type: ignore[misc]
    assert np.isnan(high) and low > 40.0


def test_short_or_constant_segments_give_no_estimate() -> None:
    rng = np.random.default_rng(6)
    assert fit_drift([stretch(rng, 12, (1.0, 1.0, 1.0), 20.0)] * 20, WIDTH_S) is None
    assert fit_drift([SegmentMeans(np.arange(0.0, 200.0, WIDTH_S), np.full((100, 3), 7.0))], WIDTH_S) is None


def test_a_stuck_axis_has_no_drift() -> None:
    part = stretch(np.random.default_rng(7), 200, (2.0, 2.0, 2.0), 20.0)
    drift = fitted(SegmentMeans(part.time_s, part.mean * [1.0, 1.0, 0.0] + [0.0, 0.0, 3.0]))
    assert (drift.rms_lsb[2], drift.rms_sem_lsb[2]) == (0, 0)
    assert drift.rms_lsb[:2] == pytest.approx([2.0] * 2, rel=0.5)


SLOPE = np.array([10.0, -20.0, 40.0])


def heated(path: Path) -> Path:
    """10000 rows at 10 Hz: noise of 5 counts and a warming by 30 degrees, on slopes of 10, -20 and 40 counts."""
    rows = 10000
    degc = 20 + 30 * np.linspace(0, 1, rows) ** 2
    counts = np.random.default_rng(8).normal(0, 5, (rows, 3)) + (degc - 20)[:, None] * SLOPE
    time = np.arange(rows, dtype=np.int64) * 100_000_000
    with LogWriter(path, [gyroscope("G")], source="simulated", epoch=EPOCH) as writer:
        writer.append("G", Block(time, np.rint(counts).astype(np.int16), np.zeros(rows, np.uint16)))
        writer.phase(Phase(0, 10**12, "static", "+Z"))
        at_rest = np.zeros((rows, 3))
        writer.stimulus("reference", Stimulus(time, at_rest, at_rest, degc))
    return path


def test_known_thermal_slopes_are_removed_before_the_drift(tmp_path: Path) -> None:
    with open_log(heated(tmp_path / "run.h5")) as log:
        raw = calibrate_noise(log).sensors["G"].drift
        slopes = Thermal(SLOPE, np.ones(3), 25.0, (BIAS,) * 3, "reference")
        known = Calibration({"G": replace(nominal(log["G"]), thermal=slopes)})
        corrected = calibrate_noise(log, known=known).sensors["G"].drift
    assert raw is not None and corrected is not None and corrected.rms_upper_lsb is not None
    assert (raw.rms_lsb > 20).all()
    assert (corrected.rms_upper_lsb < 1.0).all()  # the noise of a mean of 128 rows is 0.44


def test_an_open_interval_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The temperature rises until the end: the time constant has no upper limit, which is null in JSON."""
    path = heated(tmp_path / "run.h5")
    given = ["calibrate", "noise", str(path), "-o", str(tmp_path / "cal.toml"), "--force"]
    assert main(given) == 0
    assert re.search(r"G z .* s \(>= [\d.]+\)$", capsys.readouterr().out, re.MULTILINE)
    assert main([*given, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["sensors"]
    assert row["drift"]["time_constant_interval_s"][1] is None
