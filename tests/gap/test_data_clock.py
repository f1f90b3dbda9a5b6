"""The rate of a chip's data clock from the polls that return no new reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.model.data_clock import _readings_between_polls, _readings_per_s, clock_errors
from imuarray.gap.statistics.campaign import Campaign, Layout, LogSummary, PhaseSummary
from imuarray.gap.statistics.intervals import IntervalMoments, Intervals
from imuarray.gap.statistics.summary import Grid, Summary, Tally
from imuarray.log import Block
from imuarray.log.format import Phase, SensorHeader

POLLS = 400_000


def repeats_of(times: np.ndarray, error: float) -> tuple[Intervals, float]:
    """Intervals of polls at `times`, in units of the nominal period of 10 ms, and the share of them without a new
    reading of a clock that is faster by `error`.
    """
    newest = np.floor(np.maximum.accumulate(times) * (1 + error) + 0.3)
    moments = IntervalMoments(period_s=0.01)
    moments.update(np.rint(times * 1e7).astype(np.int64))
    return moments.result(), float((np.diff(newest) == 0).mean())


@pytest.mark.parametrize("error", [-0.02, -0.001, 0.0, 0.001, 0.003])
def test_a_clock_near_the_rate_of_polls(error: float) -> None:
    """A slow clock repeats as many readings as it lacks; a fast clock repeats some too, since polls jitter. The share
    of repeats is known to a few percent, which is a tenth of the jitter at most.
    """
    jitter = 0.003
    times = np.arange(POLLS) + np.random.default_rng(3).normal(0, jitter / np.sqrt(2), POLLS)
    assert _readings_per_s(*repeats_of(times, error)) / 100 - 1 == pytest.approx(error, abs=0.1 * jitter)


@pytest.mark.parametrize("error", [-0.03, -0.01, -0.004])
def test_occasional_late_polls_do_not_hide_a_slow_clock(error: float) -> None:
    """One poll in two hundred is half a period late, the others are even to 0.6 %: the standard deviation of all
    intervals is ten times that of the even ones.
    """
    rng = np.random.default_rng(4)
    late = rng.exponential(0.5, POLLS) * (rng.random(POLLS) < 0.005)
    times = np.sort(np.arange(POLLS) + rng.normal(0, 0.006, POLLS) + late)
    assert _readings_per_s(*repeats_of(times, error)) / 100 - 1 == pytest.approx(error, abs=3e-4)


def test_even_polls_repeat_the_lacking_readings() -> None:
    even = repeats_of(np.arange(10_000.0), 0.0)[0]
    assert _readings_per_s(even, 0.01) == pytest.approx(99.0)
    assert _readings_per_s(even, 0.0) == pytest.approx(100.0)


@pytest.mark.parametrize("error", [-0.03, 0.0, 0.025])
def test_a_clock_slower_than_the_polls(error: float) -> None:
    """Polls of a 200 Hz clock are 2.7 and 5.3 ms apart, in pairs or not: readings missed in the longer intervals have
    no influence. The share of repeats of 400,000 polls is known to a thousandth.
    """
    rng = np.random.default_rng(5)
    intervals_s = np.where(rng.random(POLLS) < 0.6, 2.7e-3, 5.3e-3) + rng.normal(0, 5e-5, POLLS)
    newest = np.floor(np.cumsum(intervals_s) * 200 * (1 + error))
    repeated = float((np.diff(newest) == 0).mean())
    moments = IntervalMoments(period_s=1 / 200)
    moments.update(np.rint(np.cumsum(intervals_s) * 1e9).astype(np.int64))
    assert _readings_between_polls(moments.result(), repeated) / 200 - 1 == pytest.approx(error, abs=3e-3)


def test_more_repeats_than_short_intervals_give_no_clock() -> None:
    intervals = Intervals(100, 5e-3, 0.0, 0, 5e-3, shorter=50, shorter_s=4e-3)
    assert np.isnan(_readings_between_polls(intervals, 0.6))


def polled(header: SensorHeader, phase: Phase, rows: int, slow: float, noise_counts: float, moves: bool) -> Summary:
    """Summary of rows at 100 Hz of a clock that is slower than the polls by `slow`, from 0.3 of a period on."""
    latest = np.floor(np.arange(rows) * (1 - slow) + 0.3).astype(int)
    readings = np.random.default_rng(rows).normal(0, noise_counts, (rows, 3))
    readings += 3000 * moves * np.sin(np.arange(rows)[:, None] / np.array([40.0, 55.0, 70.0]))
    counts = np.rint(readings).astype(np.int16)[latest]
    tally = Tally(header, phase, Grid.of(rows))
    tally.update(Block(phase.start_ns + np.arange(rows) * 10_000_000, counts, np.zeros(rows, np.uint16)))
    return tally.result(lambda time_ns: np.full(len(time_ns), 25.0))


@pytest.mark.parametrize("chips", [("mpu9150", "mpu9150"), ("mpu6050_acc", "mpu6050_gyro")])
def test_a_clock_is_estimated_from_motion_if_the_rest_is_short(chips: tuple[str, str]) -> None:
    """Three seconds at rest have one repeat, a minute of motion has 24. The gyroscope of the chip, whose readings are
    often equal by chance, has the same clock; a gyroscope in another chip does not.
    """
    accelerometer = SensorHeader("U1_acc", chips[0], "specific_force", "g", 2.0, 16384.0, rate_hz=100.0)
    gyroscope = SensorHeader("U1_gyro", chips[1], "angular_rate", "dps", 2000.0, 16.4, rate_hz=100.0)
    headers = {header.name: header for header in (accelerometer, gyroscope, replace(gyroscope, name="U2_gyro"))}
    noise_counts = {"U1_acc": 6.0, "U1_gyro": 0.6, "U2_gyro": 0.6}
    rest, motion = Phase(0, 3 * 10**9, "static", "+Z"), Phase(3 * 10**9, 63 * 10**9, "motion")
    phases = []
    for number, (phase, rows) in enumerate(((rest, 300), (motion, 6000))):
        sensors = {
            name: polled(header, phase, rows, 0.004, noise_counts[name], phase is motion)
            for name, header in headers.items()
        }
        phases.append(PhaseSummary(phase, number, Layout({}, 50_000_000), sensors, None))
    noises = {name: np.full(3, counts) for name, counts in noise_counts.items()}
    errors = clock_errors(Campaign((LogSummary("motion", tuple(phases)),)), headers, noises)
    assert errors["U1_acc"] == pytest.approx(-0.004, abs=3e-4)
    assert errors["U1_gyro"] == errors["U1_acc"]
    assert np.isnan(errors["U2_gyro"])
    at_rest = clock_errors(Campaign((LogSummary("static", (phases[0],)),)), headers, noises)
    assert np.isnan(list(at_rest.values())).all()
