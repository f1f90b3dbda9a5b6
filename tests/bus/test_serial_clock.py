"""Counters that start over, and the host's time from deliveries that are late as often as not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from imuarray.bus.serial_clock import SLEW_NS, ClockFit, line_under, nearest
from tests.selection import some

S = 1_000_000_000


@settings(deadline=None)
@given(st.integers(0, 2**40), st.integers(-(2**31), 2**31 - 1), st.sampled_from([1 << 16, 1 << 32]))
def test_a_counter_is_extended_to_the_value_nearest_to_the_expected(true: int, off: int, modulus: int) -> None:
    expected = true - off % (modulus // 2) if off > 0 else true + (-off) % (modulus // 2)
    assert nearest(np.array([true % modulus]), modulus, expected).tolist() == [true]


def test_counters_are_extended_across_their_wraps() -> None:
    assert nearest(np.array([1, 65_534]), 1 << 16, 65_535).tolist() == [65_537, 65_534]
    assert nearest(np.array([65_535]), 1 << 16, 65_537).tolist() == [65_535]
    assert nearest(np.array([5, (1 << 32) - 5]), 1 << 32, 0).tolist() == [5, -5]
    assert nearest(np.arange(4), 4, 10).tolist() == [8, 9, 10, 11]


def test_the_latest_possible_counter_of_a_sent_frame_follows_the_fit() -> None:
    fit = ClockFit()
    assert fit.latest_sent_ns(7) is None
    fit.add(1_000 * S, 3 * S)  # delivered in no time
    fit.add(1_001 * S, 4 * S + S // 2)  # half a second late
    assert fit.newest_arrival_ns == 4 * S + S // 2
    assert fit.latest_sent_ns(5 * S) == 1_002 * S
    for second in range(2, 9):
        fit.add((1_000 + second) * S, (3 + second) * S + second * 5_000_000)  # there it runs fast by half a percent
    fit.host_ns(np.array([1_008 * S]))
    assert fit.latest_sent_ns(round(20 * 1.005 * S) + 3 * S) == pytest.approx(1_020 * S, abs=S / 1000)


def deliveries(
    seconds: float, rate_hz: float, drift: float, seed: int, late: float = 0.3
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(true, counter, arrived) in ns: 80 us of scatter, and `late` of them late by up to half a second more."""
    draw = np.random.default_rng(seed)
    true = np.arange(0, seconds * S, S / rate_hz)
    delay = 50_000 + draw.exponential(80_000, len(true))
    delay += np.where(draw.random(len(true)) < late, draw.uniform(0, S / 2, len(true)), 0)
    arrived = np.maximum.accumulate(true + delay) + 7 * S
    return true + 7 * S, np.round(true * (1 + drift)).astype(np.int64) + 123 * S, arrived.astype(np.int64)


@pytest.mark.parametrize("drift", [0.0, 5e-3, -5e-3, 40e-6])
def test_offset_and_drift_of_a_resonator_are_fitted(drift: float) -> None:
    true, counter, arrived = deliveries(60, 50, drift, 1)
    fit = ClockFit(latency_ns=50_000)
    for sent_ns, arrived_ns in zip(counter.tolist(), arrived.tolist(), strict=True):
        fit.add(sent_ns, arrived_ns)
    error_ns = fit.host_ns(counter) - true
    assert np.abs(error_ns).max() < 60_000
    assert fit.rate * (1 + drift) == pytest.approx(1, abs=2e-6)
    assert (arrived - true).mean() > 30_000_000  # the error of a mean, or of least squares


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_times_increase_while_the_fit_converges(seed: int) -> None:
    true, counter, arrived = deliveries(8, 50, 4e-3, seed, late=0.5)
    fit, given_ns = ClockFit(), []
    for start in range(0, len(counter), 5):
        piece = slice(start, start + 5)
        fit.add(int(counter[piece][-1]), int(arrived[piece][-1]))
        given_ns += fit.host_ns(counter[piece]).tolist()
    assert (np.diff(given_ns) > 0).all()
    assert abs(given_ns[-1] - true[-1]) < S / 2


def test_a_better_fit_is_approached_without_a_step() -> None:
    fit = ClockFit()
    fit.add(0, 5_000_000)  # 5 ms late
    before = fit.host_ns(np.array([0, 1000]))
    assert before.tolist() == [5_000_000, 5_001_000]
    fit.add(50_000_000, 50_000_000)  # in time: so the first was late
    times = np.arange(2000, 2 * SLEW_NS, 1_000_000)
    after = fit.host_ns(times)
    assert after[0] == pytest.approx(5_002_000, abs=10)
    assert (np.diff(after) > 990_000).all()
    assert after[-1] == times[-1]


def test_the_drift_of_warming_up_is_followed() -> None:
    # The rate changes by 20 parts in a million in five minutes: a line over all of it would be 0.75 ms off.
    draw = np.random.default_rng(3)
    seconds = np.arange(0, 300, 0.05)
    true = np.round(seconds * S).astype(np.int64)
    counter = np.round((seconds + 20e-6 * seconds**2 / 600) * S).astype(np.int64)
    arrived = true + draw.exponential(80_000, len(true)).astype(np.int64)
    fit, error_ns = ClockFit(), []
    for at in range(len(true)):
        fit.add(int(counter[at]), int(arrived[at]))
        if at % 20 == 19:
            error_ns.append(int(fit.host_ns(counter[at : at + 1])[0] - true[at]))
    assert np.abs(error_ns[10:]).max() < 150_000


@pytest.mark.parametrize("seed", some(range(5), 1))
@pytest.mark.parametrize("drift", [5e-3, -40e-6])
def test_the_stated_uncertainty_bounds_the_error(drift: float, seed: int) -> None:
    """The quickest delivery takes 50 us, of which between nothing and twice as much is taken off."""
    true, counter, arrived = deliveries(20, 50, drift, seed, late=0.01)
    for latency_ns in (30_000, 50_000, 90_000):
        fit = ClockFit(latency_ns)
        for start in range(0, len(counter), 5):
            piece = slice(start, start + 5)
            for sent_ns, arrived_ns in zip(counter[piece].tolist(), arrived[piece].tolist(), strict=True):
                fit.add(sent_ns, arrived_ns)
            error_ns = np.abs(fit.host_ns(counter[piece]) - true[piece]).max()
            assert error_ns <= fit.uncertainty_ns or start < 50, start
        assert fit.uncertainty_ns < latency_ns + 100_000


def test_a_fit_without_data_is_refused() -> None:
    with pytest.raises(ValueError, match="without data"):
        ClockFit().host_ns(np.array([1]))


@settings(deadline=None)
@given(st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_the_line_is_the_closest_below_all_points(count: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    sent = np.cumsum(draw.uniform(1e7, 1e8, count)) - 1e7
    sent -= sent[0]
    arrived = sent * (1 + 3e-3) + draw.exponential(2e5, count)
    slope, start = line_under(sent, arrived)
    gap = arrived - start - slope * sent
    assert gap.min() >= -1e-3
    if sent[-1] >= 2e8 and abs(slope - 1) < 0.0099:
        # The same as a linear programme: maximise the sum under the line, in units of seconds.
        best = linprog(
            [-sent.sum() / 1e9, -count],
            A_ub=np.stack([sent / 1e9, np.ones(count)], axis=1),
            b_ub=(arrived - sent) / 1e9,
            bounds=[(None, None)] * 2,
        )
        assert gap.sum() / 1e9 == pytest.approx(
            float(((arrived - sent) / 1e9).sum() + best.fun), abs=5e-6
        )  # its tolerance is 1e-7 a point
