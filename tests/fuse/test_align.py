"""One time grid for all sensors: skew is corrected, suspect and late readings are excluded, blocks do not matter."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.errors import FusionError
from imuarray.fuse import TECHNIQUES, fuse
from imuarray.log import open_log
from tests.fuse.conftest import Floats, G, Motion, Part, WriteRun, calibration, joined
from tests.selection import some

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z")
LSB = 1 / 16384
"""In g; rounding is half of it."""


def precise(late_s: tuple[float, ...]) -> list[Part]:
    """Noiseless sensors of +-2 g, one after the other within a frame of 10 ms."""
    return [Part(f"A{i}", AXES[i % 4], range=2.0, sensitivity=1 / LSB, late_s=late) for i, late in enumerate(late_s)]


def run(path: Path, parts: list[Part], technique: str = "mean", block: int = 1 << 14) -> tuple[Floats, Floats]:
    """Seconds (n,) and fused specific force (n, 3) in g."""
    noisy = [part._replace(sigma=0.01) for part in parts]
    with open_log(path) as log:
        time, triad = joined(list(fuse(log, calibration(noisy), technique, block=block)))
    return time * 1e-9, triad / G


def test_skew_is_corrected_in_a_linear_motion(write_run: WriteRun) -> None:
    """The slope of straight lines is exact except for rounding: half a count of the value, and 0.4 of a
    frame of slope.
    """
    motion: Motion = lambda seconds: np.outer(seconds - 5, [0.2, -0.1, 0.15])  # noqa: E731
    parts = precise((0.0, 0.002, 0.003, 0.004))
    seconds, fused = run(write_run(parts, force=motion), parts)
    assert np.abs(fused - motion(seconds)).max() < 1.5 * LSB
    # Without the correction the error is the mean delay of 2.25 ms times 0.2 g/s: 7 counts.
    assert 4 * 1.5 * LSB < 0.00225 * 0.2


def test_skew_is_corrected_in_a_shaking(write_run: WriteRun) -> None:
    """A sin(w t) read late by d: with the slope of the mean, the remainder of the Taylor series of every axis is

    (mean(d^2) / 2 - mean(d)^2) A w^2 + A w^3 (mean|d|^3 / 6 + |mean d| mean(d^2) / 2), and a count of rounding.
    """
    amplitude, omega = 0.5, 2 * np.pi * 1.5

    def motion(seconds: Floats) -> Floats:
        return np.asarray(amplitude * np.sin(omega * (seconds[:, None] + [0.0, 0.1, 0.2])))

    late = np.array([0.0, 0.002, 0.004, 0.003])
    parts = precise(tuple(late))
    seconds, fused = run(write_run(parts, force=motion), parts)
    second = abs((late**2).mean() / 2 - late.mean() ** 2) * amplitude * omega**2
    third = amplitude * omega**3 * ((late**3).mean() / 6 + late.mean() * (late**2).mean() / 2)
    error = np.abs(fused - motion(seconds))[10:-10].max()
    assert error < second + third + 1.5 * LSB
    assert late.mean() * amplitude * omega > 20 * (second + third + 1.5 * LSB)  # the error without the correction


def test_a_reading_late_in_a_frame_belongs_to_the_next_frame(write_run: WriteRun) -> None:
    """8 ms late is 2 ms early for the next frame; the correction is of that sign."""
    motion: Motion = lambda seconds: np.outer(seconds - 5, [0.2, -0.1, 0.15])  # noqa: E731
    parts = precise((0.0, 0.008))
    seconds, fused = run(write_run(parts, force=motion), parts)
    assert np.abs(fused - motion(seconds))[5:-5].max() < 1.5 * LSB


def test_the_grid_follows_the_sensor_in_the_middle_of_the_frame(write_run: WriteRun) -> None:
    parts = precise((0.0, 0.001, 0.002, 0.003, 0.004))
    seconds, _ = run(write_run(parts), parts)
    assert seconds == pytest.approx(np.arange(1000) / 100 + 0.002)


def test_the_grid_follows_the_first_of_simultaneous_sensors(write_run: WriteRun) -> None:
    parts = [part._replace(lost=lambda seconds: seconds < 0.05) for part in precise((0.0, 0.0, 0.0))]
    parts[0] = parts[0]._replace(lost=lambda seconds: seconds < 0.0)
    seconds, _ = run(write_run(parts), parts)
    assert seconds == pytest.approx(np.arange(1000) / 100)


def test_another_sensor_gives_the_grid_while_the_first_is_lost(write_run: WriteRun) -> None:
    """While the first sensor has no rows, the times of the second are used, except within a period of rows of the
    first.
    """
    parts = precise((0.0, 0.002))
    parts[0] = parts[0]._replace(lost=lambda seconds: (seconds > 3.0) & (seconds < 4.0))
    seconds, fused = run(write_run(parts), parts)
    frames = np.arange(1000) / 100
    lost = (frames > 3.0) & (frames < 4.0)
    assert seconds == pytest.approx(np.sort([*frames[~lost], *(frames[lost][:-1] + 0.002)]))
    assert fused == pytest.approx(np.tile([0.0, 0.0, 1.0], (999, 1)), abs=1e-12)


def test_a_sensor_lost_for_long_is_removed_from_the_mean(write_run: WriteRun) -> None:
    """While one of two sensors has no readings, the mean keeps its level for 32 frames; then it equals the value of the
    other.
    """
    parts = precise((0.0, 0.0))
    parts[1] = parts[1]._replace(
        error=lambda seconds: np.full((len(seconds), 3), 0.5), lost=lambda seconds: (seconds >= 3.0) & (seconds < 4.0)
    )
    seconds, fused = run(write_run(parts), parts)
    alone = (seconds >= 3.315) & (seconds < 4.0)
    assert fused[alone] == pytest.approx(np.tile([0.0, 0.0, 1.0], (68, 1)), abs=1e-12)
    # "-Y-X-Z" and an error of 0.5 g along its axes: (-0.5, -0.5, -0.5) in the box frame, half of it in the mean.
    assert fused[~alone] == pytest.approx(np.tile([-0.25, -0.25, 0.75], (932, 1)), abs=1e-9)


@pytest.mark.parametrize("technique", some(TECHNIQUES, 2))
def test_frames_without_a_valid_reading_are_nan(write_run: WriteRun, technique: str) -> None:
    doubt: Callable[[Floats], npt.NDArray[np.bool_]] = lambda seconds: (seconds > 2.995) & (seconds < 3.995)  # noqa: E731
    parts = [part._replace(suspect=doubt) for part in precise((0.0, 0.0))]
    seconds, fused = run(write_run(parts), parts, technique)
    unknown = np.isnan(fused).all(axis=1)
    assert (unknown == doubt(seconds)).all()
    assert np.isfinite(fused[~unknown]).all()


def noisy(count: int = 4) -> list[Part]:
    """Two ranges, noise, 2 ms from sensor to sensor."""
    return [
        Part(
            f"A{i}",
            AXES[i],
            sigma=0.01,
            late_s=0.002 * i,
            range=(16.0, 16.0, 1.5, 1.5)[i],
            sensitivity=(2048.0, 2048.0, 16384.0, 16384.0)[i],
        )
        for i in range(count)
    ]


def shaken(seconds: Floats) -> Floats:
    phase = 2 * np.pi * np.outer(seconds, [1.0, 0.7, 1.3])
    return np.asarray(np.sin(phase) * [0.9, 0.3, 0.6] + [0, 0, 1])


def missing(kind: str) -> list[Part]:
    parts = noisy()
    if kind == "one sensor":
        parts[1] = parts[1]._replace(lost=lambda seconds: (seconds > 9.7) & (seconds < 10.3))
    elif kind == "every seventh row":
        parts[2] = parts[2]._replace(lost=lambda seconds: np.round(seconds * 100) % 7 == 0)
    elif kind == "frames":
        parts = [part._replace(lost=lambda seconds: (seconds > 9.95) & (seconds < 12.0)) for part in parts]
    elif kind == "all in doubt":
        parts = [part._replace(suspect=lambda seconds: (seconds > 9.5) & (seconds < 10.3)) for part in parts]
    return parts


@pytest.mark.parametrize("technique", some(TECHNIQUES, 1))
@pytest.mark.parametrize("kind", some(["one sensor", "nothing", "every seventh row", "all in doubt", "frames"], 1, 2))
@pytest.mark.parametrize("jitter_s", some([0.001, 0.0], 1))
def test_results_do_not_depend_on_blocks(write_run: WriteRun, technique: str, kind: str, jitter_s: float) -> None:
    """The missing rows cross the end of the first block of 1000."""
    parts = missing(kind)
    path = write_run(parts, force=shaken, frames=1500, jitter_s=jitter_s)
    results = []
    for block in (1000, 1 << 14):
        with open_log(path) as log:
            results.append(joined(list(fuse(log, calibration(parts), technique, block=block)))[1])
    assert np.isfinite(results[0]).mean() > 0.9
    assert (np.isnan(results[0]) == np.isnan(results[1])).all()
    assert np.nanmax(np.abs(results[0] - results[1])) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("step_s", some([0.0005, 0.0012], 1))
def test_correcting_the_skew_adds_no_noise(write_run: WriteRun, step_s: float) -> None:
    """Eight sensors spread over 40 % of a frame and over all of it: the noise of their mean, sigma / sqrt(8), within 2
    %. Three axes of 10000 frames determine it to 0.7 % each.
    """
    parts = [Part(f"A{i}", sigma=0.01, late_s=step_s * i) for i in range(8)]
    _, fused = run(write_run(parts, frames=10000), parts)
    assert np.sqrt((fused.std(axis=0) ** 2).mean()) == pytest.approx(0.01 / np.sqrt(8), rel=0.02)


@pytest.mark.slow
def test_correcting_the_skew_of_two_quantities_adds_no_noise(write_run: WriteRun) -> None:
    """Accelerometers in its first half, gyroscopes in the second: each a quarter of a frame off its middle, where the
    slope alone would add 1 - sqrt(1 + 9 (2 / sqrt 3 - 1) / 16), 4.3 %.
    """
    turning = Part("G", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 114.0, sigma=0.1)
    parts = [Part(f"A{i}", sigma=0.01, late_s=0.0012 * i) for i in range(4)]
    parts += [turning._replace(name=f"G{i}", late_s=0.0012 * i) for i in range(4, 8)]
    with open_log(write_run(parts, frames=10000)) as log:
        blocks = list(fuse(log, calibration(parts), "mean"))
    for quantity, sigma in (("specific_force", 0.01 * G), ("angular_rate", np.radians(0.1))):
        _, triad = joined(blocks, quantity)
        assert np.sqrt((triad.std(axis=0) ** 2).mean()) == pytest.approx(sigma / 2, rel=0.02)


def test_too_few_rows_are_refused(write_run: WriteRun) -> None:
    parts = precise((0.0,))
    with open_log(write_run(parts, frames=2)) as log, pytest.raises(FusionError, match="sensor A0: 2 rows"):
        list(fuse(log, calibration(parts), "mean"))


def test_only_the_named_sensors_are_fused(write_run: WriteRun) -> None:
    parts = precise((0.0, 0.0))
    parts[1] = parts[1]._replace(error=lambda seconds: np.full((len(seconds), 3), 0.5))
    with open_log(write_run(parts)) as log:
        _, fused = joined(list(fuse(log, calibration(parts), "mean", only=["A0"])))
        assert fused / G == pytest.approx(np.tile([0.0, 0.0, 1.0], (1000, 1)), abs=1e-12)
        with pytest.raises(FusionError, match=r"no inertial sensor among B7$"):
            list(fuse(log, calibration(parts), "mean", only=["B7"]))


def test_an_unknown_technique_is_refused_with_the_list_of_techniques(write_run: WriteRun) -> None:
    parts = precise((0.0,))
    with open_log(write_run(parts)) as log, pytest.raises(FusionError, match="'best': allowed are mean, opposed"):
        list(fuse(log, calibration(parts), "best"))


def test_both_quantities_have_one_grid(write_run: WriteRun) -> None:
    rate: Motion = lambda seconds: np.outer(seconds - 5, [20.0, -10.0, 15.0])  # noqa: E731
    gyro = Part("G", "+X+Y+Z", "angular_rate", "l3g4200d", 250.0, 100.0, late_s=0.003)
    parts = [*precise((0.0,)), gyro]
    with open_log(write_run(parts, rate=rate)) as log:
        blocks = list(fuse(log, calibration(parts), "mean"))
    time, turned = joined(blocks, "angular_rate")
    assert (time == joined(blocks)[0]).all()
    # The slope from the rounded values of one sensor: a count, and 0.3 of a frame of a slope with an error of two.
    assert np.abs(np.degrees(turned) - rate(time * 1e-9)).max() < 2 / 100


def test_a_slower_sensor_does_not_remove_frames_of_the_others(
    write_run: WriteRun,
) -> None:
    parts = [part._replace(sigma=0.01) for part in precise((0.0, 0.001, 0.002, 0.003))]
    seldom: Callable[[Floats], npt.NDArray[np.bool_]] = lambda seconds: np.round(seconds * 100) % 2 == 1  # noqa: E731
    parts[1:3] = [part._replace(lost=seldom) for part in parts[1:3]]
    with open_log(write_run(parts, frames=400)) as log:
        used = np.concatenate([block.used["specific_force"] for block in fuse(log, calibration(parts), "mean")])
    assert (used > 0).sum(axis=0).tolist() == [400, 200, 200, 400]
