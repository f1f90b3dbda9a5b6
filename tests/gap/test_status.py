"""Times, flags and words, counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.recording.source import DOUBTFUL
from imuarray.gap.statistics.intervals import IntervalMoments, StatusTally
from imuarray.gap.statistics.probes import PROBES, CampaignProbe, PhaseProbe
from imuarray.gap.statistics.summary import Grid, Tally
from imuarray.log.format import LOST_BEFORE, OVERRUN, SATURATED, STALE, Phase, SensorHeader
from imuarray.log.writer import Block
from tests.gap.small_campaign import block, summary

HEADER = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 114.3, rate_hz=100.0)


def times(intervals_ns: list[int]) -> np.ndarray:
    return np.cumsum([1000, *intervals_ns])


@given(st.lists(st.integers(900, 1100), min_size=3, max_size=60), st.integers(1, 59))
def test_intervals_equal_numpy(intervals_ns: list[int], cut: int) -> None:
    moments = IntervalMoments()
    stamps = times(intervals_ns)
    for part in (stamps[:cut], stamps[cut:]):
        if len(part):
            moments.update(part)
    found = moments.result()
    np.testing.assert_allclose(found.mean_s, np.mean(intervals_ns) * 1e-9, rtol=1e-12)
    np.testing.assert_allclose(found.std_s, np.std(intervals_ns) * 1e-9, atol=1e-14)
    assert (found.count, found.gaps) == (len(intervals_ns), 0)
    assert round(found.longest_s * 1e9) == max(intervals_ns)


def test_gaps_are_excluded_from_mean_and_spread() -> None:
    moments = IntervalMoments()
    moments.update(times([1000, 1000, 1000, 2000, 1000, 7000, 1000, 1000, 1000]))
    found = moments.result()
    assert (found.count, found.gaps) == (7, 2)
    np.testing.assert_allclose([found.mean_s, found.std_s, found.longest_s], [1e-6, 0.0, 7e-6])


def test_too_few_rows_have_no_interval_statistics() -> None:
    moments = IntervalMoments()
    moments.update(times([]))
    found = moments.result()
    assert found.count == 0
    assert np.isnan([found.mean_s, found.std_s, found.longest_s]).all()


def test_flags_and_bus_words_are_counted() -> None:
    tally = StatusTally()
    counts = np.array([[-1, -1, -1], [0, 0, 0], [5, 5, 5], [-1, -1, 0], [0, 0, 0]], np.int16)
    tally.update(np.array([STALE, STALE | SATURATED, 0, LOST_BEFORE, 0], np.uint16), counts)
    tally.update(np.zeros(5, np.uint16), counts + np.int16(3))
    assert tally.flags["stale"] == 2
    assert (tally.flags["saturated"], tally.flags["lost_before"], tally.flags["suspect"]) == (1, 1, 0)
    assert tally.words == 3


def test_slips_over_several_rows_and_blocks_are_counted() -> None:
    """Rows 3, 5 and 6 are one slip, rows 30 and 33 another, in which a new reading is flagged as a repeat."""
    status = np.zeros(40, np.uint16)
    status[[3, 5, 6, 30]] = STALE
    status[33] = DOUBTFUL
    tally, counts = StatusTally(), np.arange(120, dtype=np.int16).reshape(40, 3)
    for part in (slice(5), slice(5, 31), slice(31, 40)):
        tally.update(status[part], counts[part])
    assert tally.slips == 2
    assert (tally.flags["stale"], tally.flags["doubtful"]) == (4, 1)


@pytest.mark.parametrize(("doubtful", "is_told"), [(0, True), (1, True), (2, False)])
def test_repeats_are_not_compared_for_overruns_during_a_read(doubtful: int, is_told: bool) -> None:
    """One of ten rows that are flagged as no new reading may be a new reading."""
    status = np.zeros(100, np.uint16)
    status[10:20] = STALE
    status[10 : 10 + doubtful] = DOUBTFUL
    counts = np.random.default_rng(1).normal(0, 30, (100, 3)).astype(np.int16)
    rows = Block(np.arange(100) * 10_000_000, counts, status)
    tally = Tally(HEADER, Phase(0, 10**9, "static", "+Z"), Grid.of(100))
    tally.update(rows)
    summary = tally.result(lambda time_ns: np.full(len(time_ns), 25.0))
    for name in ("repeats", "stale"):
        probe = PROBES[name]
        assert isinstance(probe, PhaseProbe)
        assert np.isfinite(probe.statistic(summary)).all() == is_told
        assert np.shape(probe.statistic(summary)) == ()  # the same in phases with and without a value


@pytest.mark.parametrize(("missed", "is_known"), [(0, True), (1, True), (2, False), (30, False), (100, True)])
def test_repeats_of_uneven_polls_are_not_compared(missed: int, is_known: bool) -> None:
    """Ten rows are not a new reading. Where about as many report a missed reading, polls are uneven; where nearly all
    do, the chip is faster than the polls.
    """
    status = np.zeros(100, np.uint16)
    status[10:20] = STALE
    status[100 - missed :] |= OVERRUN
    counts = np.random.default_rng(1).normal(0, 30, (100, 3)).astype(np.int16)
    tally = Tally(HEADER, Phase(0, 10**9, "static", "+Z"), Grid.of(100))
    tally.update(Block(np.arange(100) * 10_000_000, counts, status))
    summary = tally.result(lambda time_ns: np.full(len(time_ns), 25.0))
    for name in ("repeats", "stale"):
        probe = PROBES[name]
        assert isinstance(probe, PhaseProbe)
        assert np.isfinite(probe.statistic(summary)).all() == is_known


@pytest.mark.parametrize(("rate_hz", "is_known"), [(100.0, True), (199.0, True), (200.0, False), (2400.0, False)])
def test_repeat_flags_of_a_chip_faster_than_the_polls_are_not_compared(rate_hz: float, is_known: bool) -> None:
    """Polled at 100 Hz, one of 200 Hz has a new reading each time: a recorder flags rows that are equal by chance."""
    status = np.zeros(100, np.uint16)
    status[10:20:3] = STALE
    counts = np.random.default_rng(1).normal(0, 30, (100, 3)).astype(np.int16)
    tally = Tally(replace(HEADER, rate_hz=rate_hz), Phase(0, 10**9, "static", "+Z"), Grid.of(100))
    tally.update(Block(np.arange(100) * 10_000_000, counts, status))
    probe = PROBES["stale"]
    assert isinstance(probe, PhaseProbe)
    value = probe.statistic(tally.result(lambda time_ns: np.full(len(time_ns), 25.0)))
    assert np.isfinite(value).all() == is_known


def test_the_probe_of_repeats_over_all_phases() -> None:
    """Three of 350 rows repeat the previous row; a single phase has no value beyond its own statistic."""
    probe = PROBES["repeats_in_all"]
    assert isinstance(probe, CampaignProbe)
    ramps = [np.arange(rows) for rows in (101, 201, 51)]
    for ramp, row in ((ramps[0], 7), (ramps[0], 50), (ramps[2], 1)):
        ramp[row] = ramp[row - 1]
    phases = [summary(block(ramp)) for ramp in ramps]
    assert probe.statistic(phases) == pytest.approx(np.arcsin(np.sqrt(3 / 350)))
    assert probe.resolution(phases) == pytest.approx(np.hypot(0.5, 0.25 * np.sqrt(3) / 2) / np.sqrt(350))
    assert np.isnan(probe.statistic(phases[:1]))
    assert np.isnan(probe.statistic([]))
