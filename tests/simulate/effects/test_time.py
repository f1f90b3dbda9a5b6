"""Times of rows: clock_error, skew, jitter, dropped_samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.simulate.effects.timing import ClockError, DroppedSamples, Jitter, Skew
from imuarray.simulate.signal import Instants
from imuarray.simulate.streams import CHUNK
from tests.selection import some

DAY_NS = 86_400 * 10**9
ROWS = 200_000


def stamped(*stamps_ns: int) -> Instants:
    stamps = np.array(stamps_ns, np.int64)
    return Instants(0, stamps, stamps, np.ones(len(stamps), bool), 2400.0)


def kept(place, instants, first: int, stop: int, probability: float, burst_rows: float = 1.0, **changes):
    effect = DroppedSamples(probability, burst_rows)
    return effect.sampled(instants(first, stop), place(**changes)).kept


def bursts(lost):
    """Lengths of the bursts that begin and end within these rows."""
    begins, ends = (np.flatnonzero(np.diff(lost.astype(int)) == step) for step in (1, -1))
    return ends[ends > begins[0]] - begins[: (ends > begins[0]).sum()]


class TestClockError:
    def test_fifty_millionths_are_four_seconds_a_day(self, place) -> None:
        after = ClockError(50.0).sampled(stamped(0, 1, DAY_NS), place())
        assert after.instant_ns.tolist() == [0, 1, DAY_NS + 4_320_000_000]
        assert after.stamp_ns.tolist() == [0, 1, DAY_NS]

    @given(st.integers(0, 10**18), st.floats(-5e5, 5e5))
    def test_the_instant_is_the_stamp_times_the_ratio(self, stamp_ns: int, error_ppm: float) -> None:
        after = ClockError(error_ppm).sampled(stamped(stamp_ns), None)
        assert int(after.instant_ns[0]) == pytest.approx(stamp_ns * (1 + error_ppm / 1e6), rel=1e-12, abs=1.0)

    def test_the_error_adds_to_an_earlier_delay(self, place) -> None:
        late = Skew(-1.0).sampled(stamped(DAY_NS), place())
        assert ClockError(1000.0).sampled(late, place()).instant_ns.tolist() == [DAY_NS + 10**9 + DAY_NS // 1000]

    def test_a_warm_up_error_starts_at_zero(self, place) -> None:
        """The integral of -1e-3 (1 - exp(-t / 30 s)): -5e-7 t^2 / 30 s at first, at last -1e-3 (t - 30 s)."""
        after = ClockError(-1000.0, 1000.0, 30.0).sampled(stamped(0, 10**8, DAY_NS), place()).instant_ns
        assert after.tolist() == [0, 10**8 - 166, DAY_NS - DAY_NS // 1000 + 30_000_000]

    def test_a_warm_up_error_alone_adds_up_to_a_constant(self, place) -> None:
        """1e-4 exp(-t / 10 s) adds up to 1 ms."""
        after = ClockError(warm_up_ppm=100.0, warm_up_s=10.0).sampled(stamped(DAY_NS), place())
        assert after.instant_ns.tolist() == [DAY_NS + 1_000_000]


class TestSkew:
    def test_a_skewed_reading_is_older_than_its_stamp(self, place) -> None:
        assert Skew(0.0025).sampled(stamped(0, DAY_NS), place()).instant_ns.tolist() == [-2_500_000, DAY_NS - 2_500_000]

    def test_a_skewed_reading_shows_the_earlier_value(self, place, constant) -> None:
        """A ramp of 3 degC/s read half a second late shows 1.5 degC less."""
        motion = constant(temperature_degc=lambda seconds: 3.0 * seconds)
        after = Skew(0.5).sampled(stamped(10 * 10**9), place())
        assert motion.stimulus(after.instant_ns).temperature_degc[0] == pytest.approx(28.5)


class TestJitter:
    """Bounds of 5 standard errors: one in 1.7 million draws of the seed would fail each."""

    def test_jitter_is_normal_and_white_with_its_rms(self, place, instants) -> None:
        before = instants(0, ROWS)
        off_s = (Jitter(2e-3).sampled(before, place()).instant_ns - before.stamp_ns) * 1e-9
        assert abs(off_s.mean()) < 5 * 2e-3 / math.sqrt(ROWS)
        assert abs(off_s.std() / 2e-3 - 1) < 5 / math.sqrt(2 * ROWS)
        assert abs(np.corrcoef(off_s[1:], off_s[:-1])[0, 1]) < 5 / math.sqrt(ROWS)
        assert abs((np.abs(off_s) < 2e-3).mean() - 0.682689) < 5 * math.sqrt(0.683 * 0.317 / ROWS)

    @pytest.mark.parametrize("share", [0.02, 0.3])
    def test_a_share_of_rows_is_late(self, place, instants, share: float) -> None:
        """1 ms of 10 ms between rows: exponential, of mean 1 / sqrt(2) ms; e^(-12.7) of them would be cut off."""
        before = instants(0, ROWS)
        late_s = (Jitter(1e-3, share).sampled(before, place()).instant_ns - before.stamp_ns) * 1e-9
        assert abs((late_s > 0).mean() - share) < 5 * math.sqrt(share * (1 - share) / ROWS)
        mean, count = 1e-3 / math.sqrt(2), share * ROWS
        assert abs(late_s[late_s > 0].mean() / mean - 1) < 5 / math.sqrt(count)
        assert abs((late_s > mean).sum() / count - math.exp(-1)) < 5 * math.sqrt(0.37 / count)

    def test_a_row_is_read_before_the_next_is_due(self, place, instants) -> None:
        before = instants(0, ROWS)
        late_s = (Jitter(1.0, 0.5).sampled(before, place()).instant_ns - before.stamp_ns) * 1e-9
        assert late_s.min() == 0
        assert 0.008 < late_s.max() < 0.009 + 1e-9

    @pytest.mark.parametrize("wait_share", [1.0, -0.5])
    def test_waits_of_a_log_are_reproduced(self, place, instants, wait_share: float) -> None:
        """Row 12 was read 2 ms later or 1 ms earlier than stamped, row 15 not at all; else waits are random."""

        def waits(first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
            rows = np.arange(first, stop)
            return np.where(rows == 12, 2_000_000, 0), rows == 15

        before = instants(10, 20)
        after = Jitter(1e-3, 0.5, wait_share).sampled(before, replace(place(), waits=waits))
        assert (after.instant_ns - before.instant_ns).tolist() == [0, 0, int(wait_share * 2_000_000), *[0] * 7]
        assert np.flatnonzero(~after.kept).tolist() == [5]
        drawn, known = (Jitter(1e-3, 0.5, own).sampled(before, place()).instant_ns for own in (wait_share, 0.0))
        assert (drawn == known).all()

    def test_jitter_adds_noise_in_proportion_to_the_slope(self, place, instants) -> None:
        """sin(w t) read sigma off has an error of w sigma / sqrt(2) rms (to first order: 1e-4 of it left out)."""
        before, omega = instants(0, ROWS), 2 * math.pi * 1.7
        after = Jitter(1e-3).sampled(before, place())
        error = np.sin(omega * after.instant_ns * 1e-9) - np.sin(omega * before.instant_ns * 1e-9)
        assert error.std() == pytest.approx(omega * 1e-3 / math.sqrt(2), rel=0.01)  # 4 standard errors


class TestDroppedSamples:
    """Bounds of 5 standard errors: one in 1.7 million draws of the seed would fail each."""

    @pytest.mark.parametrize(("share", "burst"), [(0.01, 1), (0.45, 1), (0.2, 3), (0.05, 20), (0.5, 2), (0.3, 1 / 0.7)])
    def test_losses_have_their_share_and_burst_length(self, place, instants, share: float, burst: float) -> None:
        lost = ~kept(place, instants, 0, ROWS, share, burst)
        memory = 1 - 1 / burst - share / (1 - share) / burst  # the chain's second eigenvalue
        spread = math.sqrt(share * (1 - share) * (1 + memory) / (1 - memory) / ROWS)
        assert abs(lost.mean() - share) < 5 * spread

        lengths = bursts(lost)
        assert abs(lengths.mean() - burst) <= 5 * math.sqrt(burst * (burst - 1) / len(lengths))
        single = (lengths == 1).mean()
        assert abs(single - 1 / burst) <= 5 * math.sqrt((1 / burst) * (1 - 1 / burst) / len(lengths))

    def test_lengths_are_geometric(self, place, instants) -> None:
        """A burst that has lasted 5 rows lasts as many more as a new one does: mean 10."""
        lengths = bursts(~kept(place, instants, 0, ROWS, 0.2, 10.0))
        more = lengths[lengths > 5] - 5
        assert len(more) > 1000
        assert abs(more.mean() - 10) < 5 * math.sqrt(90 / len(more))

    def test_the_first_row_is_lost_with_the_same_probability(self, place, instants) -> None:
        boots = 400
        lost = sum(not kept(place, instants, 0, 1, 0.3, 4.0, boot=boot)[0] for boot in range(boots))
        assert abs(lost / boots - 0.3) < 5 * math.sqrt(0.3 * 0.7 / boots)

    @pytest.mark.parametrize(("share", "burst"), some([(0.49, 1), (0.3, 3), (0.6, 200)], 2))
    def test_any_block_alone_equals_that_of_the_whole(self, place, instants, share: float, burst: float) -> None:
        whole = kept(place, instants, 0, 2 * CHUNK, share, burst)
        rng = np.random.default_rng(1)
        for first in (*rng.integers(0, 2 * CHUNK - 50, 500).tolist(), CHUNK - 1, CHUNK):
            assert (kept(place, instants, first, first + 50, share, burst) == whole[first : first + 50]).all()

    def test_losses_of_a_very_late_row_do_not_depend_on_the_block(self, place, instants) -> None:
        far = 10**9
        long = kept(place, instants, far - 500, far + 500, 0.2, 30.0)
        assert (kept(place, instants, far, far + 500, 0.2, 30.0) == long[500:]).all()
        assert 0 < long.sum() < 1000

    def test_rare_losses_in_single_precision_are_the_same(self, place, instants) -> None:
        """As many as in double precision, whose numbers in [0, 1) lie closer than probabilities ever do."""
        as_double = kept(place, instants, 0, CHUNK, 0.001)
        assert (kept(place, instants, 0, CHUNK, 0.001, dtype=np.float32) == as_double).all()

    def test_rows_lost_before_stay_lost(self, place, instants) -> None:
        before = instants(0, 100, kept=np.arange(100) % 2 == 0)
        assert not DroppedSamples(0.1).sampled(before, place()).kept[1::2].any()

    @pytest.mark.parametrize("first", [0, 7, 8, 30])
    def test_named_losses_are_reproduced(self, place, instants, first: int) -> None:
        """Rows come every 0.01 s: 7 and 8 are due in the first one, the second is another run's; chance takes none."""
        effect = DroppedSamples(0.5, runs=(2, 3), moments_s=(0.065, 0.2), lengths_s=(0.02, 0.1))
        lost = ~effect.sampled(instants(first, 40), place(boot=2)).kept
        assert (first + np.flatnonzero(lost)).tolist() == [row for row in (7, 8) if row >= first]

    def test_lists_of_different_length_are_refused(self) -> None:
        with pytest.raises(ValueError, match="moments_s: 2; as many as runs, 1, are required"):
            DroppedSamples(runs=(0,), moments_s=(1.0, 2.0), lengths_s=(1.0,))


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: ClockError(-1e6), "error_ppm: -1000000.0; allowed is -500000 to 500000"),
    (lambda: ClockError(math.nan), "error_ppm: nan"),
    (lambda: ClockError(3e5, 3e5), r"error_ppm \+ warm_up_ppm: 600000.0; allowed is -500000 to 500000"),
    (lambda: ClockError(warm_up_ppm=1.0, warm_up_s=0.0), "warm_up_s: 0.0; allowed is 0.001 to 1e"),
    (lambda: Skew(math.inf), "delay_s: inf"),
    (lambda: Jitter(-1e-3), "rms_s: -0.001; allowed is 0 to 1000"),
    (lambda: Jitter(1e-3, 0.1, 1.5), "wait_share: 1.5; allowed is -1 to 1"),
    (lambda: DroppedSamples(0.6), "probability: 0.6; allowed is 0 to 0.5"),
    (lambda: DroppedSamples(0.9, 4.0), "probability: 0.9; allowed is 0 to 0.8"),
    (lambda: DroppedSamples(0.1, 0.5), "burst_rows: 0.5; allowed is 1 to"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_invalid_parameters_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        make()
