"""A ratio of rms errors and its standard error, against closed forms and a bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.errors import FusionError
from imuarray.fuse import Gain, errors_of, fuse, gains
from imuarray.log import Block, LogWriter, Stimulus, open_log
from imuarray.log.format import Phase, SensorHeader

G = 9.80665
LOW = SensorHeader("A_LOW", "bma180", "specific_force", "g", 1.5, 16384.0)
HIGH = SensorHeader("HIGH", "bma180", "specific_force", "g", 16.0, 2048.0)
SIGMA = {"A_LOW": 0.010, "HIGH": 0.020}
"""g."""


def still(seconds: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.tile([0.0, 0.0, 1.0], (len(seconds), 1))


def write(
    folder: Path,
    rows: int,
    *,
    seed: int = 1,
    force: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]] = still,
    high_lost: tuple[float, float] = (0.0, 0.0),
    drift_g: float = 0.0,
) -> Path:
    """100 Hz; both sensors have an error of `drift_g` at first and twice that at the end."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(rows) / 100
    time = np.arange(rows, dtype=np.int64) * 10_000_000
    path = folder / f"run{seed}.h5"
    with LogWriter(path, [LOW, HIGH], source="simulated", epoch="2024-01-01T00:00:00Z") as writer:
        for header in (LOW, HIGH):
            units = (
                force(seconds)
                + rng.normal(0, SIGMA[header.name], (rows, 3))
                + drift_g * (1 + seconds[:, None] / seconds[-1])
            )
            counts = np.rint(units * header.sensitivity).astype(np.int16)
            kept = (seconds < high_lost[0]) | (seconds >= high_lost[1]) | (header is LOW)
            writer.append(header.name, Block(time[kept], counts[kept], np.zeros(kept.sum(), np.uint16)))
        writer.stimulus("truth", Stimulus(time, force(seconds) * G, np.zeros((rows, 3)), np.full(rows, 25.0)))
        writer.phase(Phase(0, int(time[-1] // 2), "static", "+Z"))
    return path


def known() -> Calibration:
    return Calibration(
        {
            header.name: SensorCalibration(
                header.name,
                "specific_force",
                "g",
                np.zeros(3),
                header.sensitivity * np.eye(3),
                noise_lsb=np.full(3, SIGMA[header.name] * header.sensitivity),
            )
            for header in (LOW, HIGH)
        }
    )


def found(path: Path, **options: object) -> list[Gain]:
    with open_log(path) as log:
        phases = [phase for phase in log.phases if options.pop("static", False)]
        return gains(log, known(), "ranges", phases=phases, **options)  # type: ignore[arg-type]


def root(gain: Gain) -> float:
    """Ratio of the rms length of a vector to one of three equal components."""
    return float(np.sqrt(len(gain.box_axis)))


def test_ratio_of_inverse_variance_weights_to_equal_ones(tmp_path: Path) -> None:
    """0.01 and 0.02 g: sqrt(1 / (1e4 + 2.5e3)) over sqrt(1e-4 + 4e-4) / 2 is 0.8; lengths have errors sqrt(3) times
    that.
    """
    rows = found(write(tmp_path, 6000))
    assert [(gain.technique, gain.quantity, gain.box_axis) for gain in rows] == [
        ("ranges", "specific_force", axis) for axis in ("X", "Y", "Z", "XYZ")
    ]
    for gain in rows:
        assert gain.ratio == pytest.approx(0.8, abs=4 * gain.ratio_se)
        assert gain.average / G == pytest.approx(root(gain) * np.sqrt(5e-4) / 2, rel=5 / np.sqrt(12000))
        assert gain.ratio == pytest.approx(gain.technique_error / gain.average)


@pytest.mark.slow
def test_the_standard_error_equals_that_of_a_bootstrap(tmp_path: Path) -> None:
    """Rows are resampled 2000 times; the jackknife's twenty blocks determine a standard error to 16 %, three axes to 9
    %.
    """
    path = write(tmp_path, 4000, seed=2)
    with open_log(path) as log:
        before, after = (errors_of(log, fuse(log, known(), name))["specific_force"][1] for name in ("mean", "ranges"))
    draws = np.random.default_rng(3).integers(0, 4000, (2000, 4000))
    ratios = []
    for axis in range(3):
        counts = np.array([np.bincount(draw, minlength=4000) for draw in draws])
        ratios.append(np.sqrt((counts @ after[:, axis] ** 2) / (counts @ before[:, axis] ** 2)).std())
    stated = [gain.ratio_se for gain in found(path) if len(gain.box_axis) == 1]
    assert np.mean(stated) == pytest.approx(np.mean(ratios), rel=0.35)


@pytest.mark.slow
def test_slow_gains_compare_drift_without_noise(tmp_path: Path) -> None:
    """Both sensors drift from 0.1 to 0.2 g in 400 s: ten-second means minus the first, the same for every technique."""
    rows = found(write(tmp_path, 40000, drift_g=0.1), slow=True)
    steps = np.arange(40) * 0.1 * 10 / 400
    for gain in rows:
        assert gain.average / G == pytest.approx(root(gain) * np.sqrt(np.mean(steps**2)), rel=0.02)
        assert gain.ratio == pytest.approx(1.0, abs=0.02)


def test_gains_are_limited_to_phases_and_named_sensors(tmp_path: Path) -> None:
    path = write(tmp_path, 6000)
    alone = found(path, only=["HIGH"], static=True)
    for gain in alone:
        assert gain.ratio == pytest.approx(1.0)
        assert gain.average / G == pytest.approx(root(gain) * 0.02, rel=5 / np.sqrt(6000))


def test_too_few_frames_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FusionError, match="9 values with a truth, too few"):
        found(write(tmp_path, 9))


@pytest.mark.slow
def test_techniques_are_compared_on_the_same_frames(tmp_path: Path) -> None:
    """At 1.45 g the low range has no weight; while rows of the high range are lost, only the average has a value."""

    def lifted(seconds: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.outer(np.where((seconds > 1) & (seconds < 8), 1.45, 1.0), [0, 0, 1])

    path = write(tmp_path, 2000, force=lifted, high_lost=(2.0, 7.0))
    with open_log(path) as log:
        rows = [errors_of(log, fuse(log, known(), name))["specific_force"] for name in ("mean", "ranges")]
    (time, before), (other, after) = rows
    assert len(other) < len(time)
    common = np.isin(time, other)
    expected = np.sqrt((after**2).sum(axis=0) / (before[common] ** 2).sum(axis=0))
    assert [gain.ratio for gain in found(path)[:3]] == pytest.approx(list(expected))
