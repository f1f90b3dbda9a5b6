"""Times of queued samples: against a chip whose true sampling instants are known because the test makes them."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.drivers.fifo_clock import FifoClock
from tests.selection import some


def drained(
    rate_hz: float, error: float, poll_s: float, jitter_s: float, polls: int, seed: int
) -> list[tuple[int, float]]:
    """(estimated, true) ns of every sample of a chip that runs `error` fast and is drained about every `poll_s`."""
    randomness = random.Random(seed)
    true_period_ns = 1e9 / rate_hz / (1 + error)
    phase_ns = randomness.random() * true_period_ns
    clock, pairs, taken, at_ns = FifoClock(rate_hz), [], 0, 0.0
    for _ in range(polls):
        at_ns += (poll_s + randomness.random() * jitter_s) * 1e9
        have = math.floor((at_ns - phase_ns) / true_period_ns) + 1
        level = have - taken
        times = clock.times(level, round(at_ns))
        true = [phase_ns + index * true_period_ns for index in range(taken, have)]
        pairs += list(zip(times, true, strict=True))
        taken = have
    return pairs


@given(
    rate_hz=st.sampled_from([100.0, 400.0, 800.0]),
    error=st.floats(-0.1, 0.1),
    poll_s=st.floats(0.005, 0.03),
    seed=st.integers(0, 1000),
)
def test_times_are_ordered_and_within_1_3_periods(rate_hz: float, error: float, poll_s: float, seed: int) -> None:
    pairs = drained(rate_hz, error, poll_s, 0.002, 200, seed)
    period_ns = 1e9 / rate_hz / (1 + error)
    estimated = [estimate for estimate, _ in pairs]
    assert all(after > before for before, after in pairwise(estimated))
    settled = pairs[len(pairs) // 4 :]
    assert max(abs(estimate - true) for estimate, true in settled) <= 1.3 * period_ns


@pytest.mark.parametrize("error", [-0.08, 0.0, 0.08])
def test_spacing_converges_to_the_chips_own_period(error: float) -> None:
    """Not to the nominal period: 8 % off would shift a second of samples by 80 ms."""
    pairs = drained(800.0, error, 0.02, 0.001, 500, seed=1)
    estimated = [estimate for estimate, _ in pairs[-4000:]]
    spacing_ns = (estimated[-1] - estimated[0]) / (len(estimated) - 1)
    assert spacing_ns == pytest.approx(1e9 / 800 / (1 + error), rel=2e-3)


def test_the_first_drain_ends_half_a_period_before_the_count() -> None:
    assert FifoClock(100.0).times(3, 1_000_000_000) == [975_000_000, 985_000_000, 995_000_000]


def test_an_empty_queue_has_no_times() -> None:
    assert FifoClock(100.0).times(0, 5) == []


def test_after_an_overrun_times_jump_and_stay_ordered() -> None:
    clock = FifoClock(100.0)
    first = clock.times(4, 100_000_000)
    after = clock.times(32, 5_000_000_000, overrun=True)
    assert after[-1] == 4_995_000_000
    assert after[0] == 4_995_000_000 - 31 * 10_000_000
    assert after[0] > first[-1]


@pytest.mark.parametrize("seed", some(range(12), 4))
@pytest.mark.parametrize("error", [-0.01, -0.0037, 0.0, 0.01])
def test_the_uncertainty_bounds_the_error_of_every_time(error: float, seed: int) -> None:
    """None of the samples of any seed, the first ones included: the uncertainty is a bound, not a standard deviation.

    The host is late by up to 3 ms after the count, and counts up to 200 us before the chip does.
    """
    randomness = random.Random(seed)
    rate_hz = 500.0
    period_ns = 1e9 / rate_hz / (1 + error)
    phase_ns, clock, taken, at_ns = randomness.random() * period_ns, FifoClock(rate_hz), 0, 0.0
    stated: list[float] = []
    for count in range(400):
        at_ns += (0.02 + 0.01 * randomness.random()) * 1e9
        have = math.floor((at_ns - phase_ns) / period_ns) + 1
        unread_rows = randomness.choice([0, 0, 3])  # newer samples that stay in the queue
        before, after = randomness.random() * 200e3, randomness.expovariate(1 / 500e3) % 3e6
        is_lost = count == 200
        times = clock.times(
            have - taken - unread_rows,
            math.floor(at_ns - before),
            is_lost,
            until_ns=math.ceil(at_ns + after),
            unread=unread_rows,
        )
        for number, (time_ns, uncertainty_ns) in enumerate(zip(times, clock.uncertainties_ns, strict=True), taken):
            assert abs(time_ns - phase_ns - number * period_ns) <= uncertainty_ns + 1  # times are whole ns
        stated.append(clock.uncertainty_ns)
        taken = have - unread_rows
    assert sorted(stated)[len(stated) // 2] < 0.2 * period_ns  # and the bound is narrow
