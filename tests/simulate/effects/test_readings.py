"""Effects on converted readings: stale_samples, glitches, stuck, channel_swap."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from imuarray.simulate.effects.readings import ChannelSwap, Glitches, StaleSamples, Stuck

ROWS = 100_000
shared = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])  # fixtures are plain functions here


class TestStaleSamples:
    """Bounds of 5 standard errors: one in 1.7 million draws of the seed would fail each."""

    @pytest.mark.parametrize("probability", [0.01, 0.3, 0.9])
    def test_repetitions_have_their_probability_and_chains(self, place, codes, probability: float) -> None:
        before = codes(0, ROWS)
        after = StaleSamples(probability).codes(before, place())
        repeated = (after.counts[1:] == after.counts[:-1]).all(axis=1)
        assert np.array_equal(after.fresh, np.concatenate([[True], ~repeated]))
        assert abs(repeated.mean() - probability) < 5 * math.sqrt(probability * (1 - probability) / ROWS)
        chains = np.diff(np.flatnonzero(after.fresh)) - 1
        after_one = (chains[chains > 0] > 1).mean()  # a repetition is as likely after a repetition
        assert abs(after_one - probability) < 5 * math.sqrt(probability * (1 - probability) / (chains > 0).sum())
        assert np.array_equal(after.counts[after.fresh], before.counts[after.fresh])

    def test_repetitions_can_have_bursts(self, place, codes) -> None:
        """One reading in 800 begins a burst of four rows on average; a quarter of geometric lengths are one row."""
        after = StaleSamples(0.005, rows=4.0).codes(codes(0, ROWS), place())
        lengths = np.diff(np.append(np.flatnonzero(after.fresh), ROWS)) - 1
        bursts = lengths[lengths > 0]
        assert abs(len(bursts) - ROWS / 800) < 5 * math.sqrt(ROWS / 800)
        assert abs(bursts.mean() - 4) < 5 * math.sqrt(12 / len(bursts))
        assert abs((bursts == 1).mean() - 0.25) < 5 * math.sqrt(0.1875 / len(bursts))
        part = StaleSamples(0.005, rows=4.0).codes(codes(50_000, 51_000), place())
        longest = StaleSamples(0.005, rows=4.0).longest
        assert np.array_equal(part.fresh[longest + 1 :], after.fresh[50_000 + longest + 1 : 51_000])

    def test_white_readings_are_correlated_by_repetitions(self, place, codes) -> None:
        noise = np.random.default_rng(1).integers(-1000, 1000, (ROWS, 3))
        after = StaleSamples(0.4).codes(codes(0, ROWS, noise), place())
        lag_1 = np.corrcoef(after.counts[1:, 0], after.counts[:-1, 0])[0, 1]
        assert lag_1 == pytest.approx(0.4, abs=0.02)  # standard error below 0.004

    @shared
    @given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 50))
    def test_fresh_marks_new_readings(self, place, codes, chip_fresh: list[bool], boot: int) -> None:
        """Each new conversion has a distinct number, so a reading is fresh if and only if the number changes."""
        new = np.array([True, *chip_fresh])
        before = codes(0, len(new), np.cumsum(new)[:, None], fresh=new)
        after = StaleSamples(0.5).codes(before, place(boot=boot))
        assert np.array_equal(after.fresh[1:], np.diff(after.counts[:, 0]) > 0)

    def test_temperature_is_repeated_too(self, place, codes) -> None:
        after = StaleSamples(0.5).codes(codes(0, 100, temperature_counts=np.arange(100)), place())
        assert np.array_equal(after.temperature_counts, after.counts[:, 0])
        assert (np.diff(after.temperature_counts) == 0).any()

    @pytest.mark.parametrize(("probability", "longest"), [(0.0, 0), (0.001, 4), (0.5, 40)])
    def test_the_longest_chain_has_a_probability_of_at_most_1e_12(
        self, place, probability: float, longest: int
    ) -> None:
        """10^-12 = 0.001^4, and 2^-40 is the first power of a half below it."""
        effect = StaleSamples(probability)
        assert effect.longest == longest
        assert effect.lookback(place()) == (longest + 1 if probability else 0)

    def test_longer_chains_are_cut(self, place, codes, monkeypatch) -> None:
        """At most three repetitions here: every row shows one of the four before the next, wherever one begins."""
        monkeypatch.setattr(StaleSamples, "longest", 3)
        whole = StaleSamples(0.9).codes(codes(0, 2000), place())
        assert (np.arange(2000) - whole.counts[:, 0]).max() == 3
        part = StaleSamples(0.9).codes(codes(996, 1200), place())
        assert np.array_equal(part.counts[4:], whole.counts[1000:1200])
        assert np.array_equal(part.fresh[4:], whole.fresh[1000:1200])


def as_bytes(value: int) -> bytes:
    return struct.pack("<h", value)


class TestGlitches:
    def test_spikes_have_their_share_size_and_directions(self, place, codes) -> None:
        """2 g of a BMA180 at 16 g, 512 LSB/g, are 1024 counts; six ways, as likely (chi-square, p > 1e-6)."""
        before = codes(0, ROWS, (10, 20, 30))
        off = Glitches(0.02, amplitude=2.0).codes(before, place()).counts - before.counts
        assert set(np.unique(off)) == {-1024, 0, 1024}
        struck = (off != 0).sum(axis=1)
        assert struck.max() == 1
        assert abs(struck.mean() - 0.02) < 5 * math.sqrt(0.02 * 0.98 / ROWS)
        ways = [(off[:, axis] == size).sum() for axis in range(3) for size in (-1024, 1024)]
        assert chisquare(ways).pvalue > 1e-6

    def test_spikes_are_limited_to_the_codes(self, place, codes, sensor) -> None:
        ended = Glitches(1.0, amplitude=1e6).codes(codes(0, 100, 5), place(sensor("bma180")))
        assert set(np.unique(ended.counts)) == {-8192, 5, 8191}

    @pytest.mark.parametrize("cut", [1, 49, 50, 51, 99])
    def test_named_readings_are_changed(self, place, codes, sensor, cut: int) -> None:
        """The first one at or after its moment, of that run, up to the ends of a word; in pieces as in one."""
        whole = codes(0, 100, 5)
        due_s = (whole.instant_ns[50] - 1) * 1e-9
        effect = Glitches(runs=(2, 2, 3), moments_s=(due_s, 0, due_s), jumps=(0, 0, 1e6, 1, 0, 0, 9, 9, 9))
        here = place(sensor("bma180"), boot=2)
        after = effect.codes(whole, here).counts
        expected = whole.counts.copy()
        expected[50, 2], expected[0, 0] = 32767, 5 + here.sensor.sensitivity
        np.testing.assert_array_equal(after, expected)
        back = cut - effect.lookback(here)
        later = effect.codes(codes(back, 100, 5), here).counts[1:]
        np.testing.assert_array_equal(later, expected[cut:])

    def test_lists_of_different_length_are_refused(self) -> None:
        with pytest.raises(ValueError, match="moments_s: 1; as many runs"):
            Glitches(runs=(0,), moments_s=(1.0,), jumps=(1.0,))

    def test_a_word_of_ones_is_read(self, place, codes) -> None:
        after = Glitches(0.5, kind="word").codes(codes(0, 1000, (10, 20, 30)), place())
        assert {tuple(row) for row in after.counts.tolist()} == {(10, 20, 30), (-1, -1, -1)}
        assert struct.unpack("<3h", b"\xff" * 6) == (-1, -1, -1)

    @shared
    @given(st.lists(st.integers(-32768, 32767), min_size=2, max_size=20), st.integers(0, 5))
    def test_torn_readings_have_bytes_of_two_rows(self, place, codes, sensor, values: list[int], boot: int) -> None:
        """L3G4200D: the low byte of this reading, the high one of the row before."""
        before = codes(0, len(values), np.array(values)[:, None])
        after = Glitches(1.0, kind="torn").codes(before, place(sensor("l3g4200d"), boot=boot))
        mixed = [
            struct.unpack("<h", as_bytes(new)[:1] + as_bytes(old)[1:])[0] for old, new in itertools.pairwise(values)
        ]
        for row, (torn, whole) in enumerate(zip([values[0], *mixed], values, strict=True)):
            assert sorted(after.counts[row].tolist()) == sorted([torn, whole, whole])

    @shared
    @given(st.lists(st.integers(-8192, 8191), min_size=2, max_size=20))
    def test_torn_readings_of_fourteen_bits_have_bytes_of_two_rows(self, place, codes, values: list[int]) -> None:
        """BMA180: code = int16(MSB << 8 | LSB) >> 2 (BMA-60), so that the two bytes part at six bits of the code."""
        after = Glitches(1.0, kind="torn").codes(codes(0, len(values), np.array(values)[:, None]), place())
        for row, (old, new) in enumerate(itertools.pairwise(values), start=1):
            torn = struct.unpack("<h", as_bytes(new << 2)[:1] + as_bytes(old << 2)[1:])[0] >> 2
            assert sorted(after.counts[row].tolist()) == sorted([torn, new, new])

    def test_a_carry_is_torn_by_a_high_byte(self, place, codes, sensor) -> None:
        after = Glitches(1.0, kind="torn").codes(
            codes(0, 2, np.array([[0xFF] * 3, [0x100] * 3])), place(sensor("adxl345"))
        )
        assert sorted(after.counts[1].tolist()) == [0, 0x100, 0x100]

    def test_torn_readings_look_back_one_row(self, place, codes) -> None:
        """Counts jump by 100 a row, so that every torn reading shows (BMA180: the high byte is what is above 63)."""
        at, rows = place(), 100 * np.arange(80)[:, None]
        effect = Glitches(1.0, kind="torn")
        whole = effect.codes(codes(0, 80, rows), at)
        for first in range(1, 80):
            reach = effect.lookback(at)
            part = effect.codes(codes(first - reach, 80, rows[first - reach :]), at)
            assert np.array_equal(part.counts[reach:], whole.counts[first:])
        assert (whole.counts[1:] != rows[1:]).any(axis=1).all()
        assert Glitches(1.0, kind="word").lookback(at) == Glitches(kind="torn").lookback(at) == 0

    def test_flags_and_temperature_are_unchanged(self, place, codes) -> None:
        before = codes(0, 50, temperature_counts=np.arange(50), fresh=np.arange(50) % 3 == 0)
        for kind in ("spike", "torn", "word"):
            after = Glitches(1.0, amplitude=1.0, kind=kind).codes(before, place())
            assert np.array_equal(after.fresh, before.fresh)
            assert np.array_equal(after.temperature_counts, before.temperature_counts)

    def test_glitches_in_single_precision_are_the_same(self, place, codes) -> None:
        """Its random numbers are multiples of 2^-24: too coarse for events rarer than one row in a million."""
        before = codes(0, ROWS)
        after = [Glitches(0.01, kind="word").codes(before, place(dtype=dtype)) for dtype in (np.float64, np.float32)]
        assert np.array_equal(after[0].counts, after[1].counts)


class TestStuck:
    @pytest.fixture
    def standing(self, place, codes):
        """A place where row 6 contains 6, 7, 8 and temperature 6, and no other row is requested."""

        def reaching(effect: str, row: int):
            assert effect == "stuck"
            return codes(row, row + 1, temperature_counts=np.array([row]))

        return lambda rows_per_s=100.0: place(reaching=reaching, rows_per_s=rows_per_s)

    @pytest.mark.parametrize("first", [0, 3, 7, 8])
    def test_readings_are_stuck_for_the_duration(self, standing, codes, first: int) -> None:
        """At 100 rows a second 0.07 s is row 7 (0.07 * 100 isn't, in binary), 0.03 s later row 10 moves again."""
        before = codes(first, 20, temperature_counts=np.arange(first, 20))
        after = Stuck(0.07, 0.03).codes(before, standing())
        shown = [6 if 7 <= row < 10 else row for row in range(first, 20)]
        assert after.counts[:, 0].tolist() == after.temperature_counts.tolist() == shown
        assert after.counts[:, 2].tolist() == [value + 2 for value in shown]
        assert after.fresh.tolist() == [not 7 <= row < 10 for row in range(first, 20)]

    def test_readings_can_be_stuck_for_ever(self, standing, codes) -> None:
        after = Stuck(0.061).codes(codes(1000, 1010), standing())
        assert after.counts.tolist() == [[6, 7, 8]] * 10
        assert not after.fresh.any()

    def test_readings_can_be_stuck_from_the_first_on(self, standing, codes) -> None:
        after = Stuck(0.0).codes(codes(0, 5), standing())
        assert after.counts.tolist() == [[0, 1, 2]] * 5
        assert after.fresh.tolist() == [True, False, False, False, False]

    @pytest.mark.parametrize(("first", "stop"), [(0, 7), (10, 20)])
    def test_no_row_is_requested_outside_the_stretch(self, place, codes, first: int, stop: int) -> None:
        before = codes(first, stop)
        assert Stuck(0.07, 0.03).codes(before, place()) is before  # this place refuses requests for a row

    @pytest.mark.parametrize("kind", ["stale", "new"])
    @pytest.mark.parametrize("first", [0, 3, 7, 8, 12])
    def test_named_stretches_are_stuck(self, standing, codes, first: int, kind: str) -> None:
        """Rows come every 0.01 s: 7, 8 and 9 lie in the first one, none in the last, the second is another run's. The
        chip flags repetitions as new if so configured, independently of their flags.
        """
        lists = {"runs": (0, 1, 0), "moments_s": (0.065, 0.11, 0.123), "lengths_s": (0.03, 0.03, 0.004)}
        before = codes(first, 20, temperature_counts=np.arange(first, 20), fresh=np.arange(first, 20) != 8)
        after = Stuck(kind=kind, **lists).codes(before, standing())
        assert after.counts[:, 0].tolist() == [6 if 7 <= row < 10 else row for row in range(first, 20)]
        held = {"stale": (7, 8, 9), "new": ()}[kind]
        assert after.fresh.tolist() == [row not in held for row in range(first, 20)]

    @pytest.mark.parametrize("first", [0, 3, 7, 8, 12])
    def test_single_axes_can_be_stuck(self, standing, codes, first: int) -> None:
        """Of rows 7 ... 9 only y and z are held; temperature and flags are as usual."""
        lists = {"runs": (0,), "moments_s": (0.065,), "lengths_s": (0.03,)}
        before = codes(first, 20, temperature_counts=np.arange(first, 20))
        after = Stuck(**lists, stuck_axes=(1, 2)).codes(before, standing())
        held = [6 if 7 <= row < 10 else row for row in range(first, 20)]
        assert after.counts.tolist() == [[row, y + 1, y + 2] for row, y in zip(range(first, 20), held, strict=True)]
        assert np.array_equal(after.temperature_counts, before.temperature_counts)
        assert np.array_equal(after.fresh, before.fresh)
        with pytest.raises(ValueError, match="axes"):
            Stuck(stuck_axes=(3,))

    @pytest.mark.parametrize("first", [0, 3, 6, 7, 8, 12])
    def test_stuck_readings_can_be_given(self, standing, place, codes, first: int) -> None:
        """Rows 6 ... 9 have the given readings; row 6 is the reading that the others repeat, and fresh."""
        stretch = {"runs": (0,), "moments_s": (0.055,), "lengths_s": (0.04,)}
        given = tuple(count / place().sensor.sensitivity for count in (-5, 90, 17))
        before = codes(first, 20, temperature_counts=np.arange(first, 20))
        after = Stuck(**stretch, readings=given).codes(before, standing())
        rows = np.arange(first, 20)
        is_held = (rows >= 6) & (rows < 10)
        assert (after.counts[is_held] == (-5, 90, 17)).all()
        assert np.array_equal(after.counts[~is_held], before.counts[~is_held])
        assert after.counts.dtype == before.counts.dtype
        assert after.temperature_counts.tolist() == np.where(is_held, 6, rows).tolist()
        assert after.fresh.tolist() == (~is_held | (rows == 6)).tolist()

    def test_readings_that_do_not_match_the_stretches_are_refused(self) -> None:
        with pytest.raises(ValueError, match="readings: 2; none, or three for each of moments_s, are required"):
            Stuck(runs=(0,), moments_s=(1.0,), lengths_s=(1.0,), readings=(1.0, 2.0))

    def test_lists_of_different_length_are_refused(self) -> None:
        with pytest.raises(ValueError, match="lengths_s: 0; as many as runs, 1, are required"):
            Stuck(runs=(0,), moments_s=(1.0,))
        with pytest.raises(ValueError, match=r"lengths_s: -1\.0; allowed is 0"):
            Stuck(runs=(0,), moments_s=(1.0,), lengths_s=(-1.0,))
        with pytest.raises(ValueError, match="kind: 'old'; allowed are stale, new"):
            Stuck(kind="old")

    @pytest.mark.slow
    def test_readings_are_stuck_repeatedly_at_random(self, place, codes) -> None:
        """Free for 2 s on average, then held for 0.5 s: a fifth of the time. Holds of 4000 s are 1600, give or take 5
        standard errors (of the Poisson process between them: 6e-7).
        """
        at = place(reaching=lambda _, row: codes(row, row + 1), rows_per_s=20.0)
        after = Stuck(duration_s=0.5, every_s=2.0).codes(codes(0, 80_000), at)
        begins = np.flatnonzero(after.fresh[:-1] & ~after.fresh[1:])
        assert abs(len(begins) - 1600) < 5 * math.sqrt(1600)
        runs = np.diff(np.flatnonzero(after.fresh)) - 1
        assert set(runs[runs > 0].tolist()) <= {9, 10, 11, 19, 20, 21}  # two holds may meet
        part = Stuck(duration_s=0.5, every_s=2.0).codes(codes(70_000, 70_100), at)
        assert np.array_equal(part.counts, after.counts[70_000:70_100])


class TestChannelSwap:
    @pytest.fixture
    def between(self, place, codes):
        def neighbour(name: str, first: int, stop: int):
            if name not in ("S2", "S3"):
                raise KeyError(f"{name}: no triad of this array; it has S1, S2, S3")
            warm = np.arange(first, stop) + 500 if name == "S2" else None
            fresh = np.arange(first, stop) % 2 == 0
            return codes(first, stop, -np.arange(first, stop)[:, None], temperature_counts=warm, fresh=fresh)

        return place(neighbour=neighbour)

    def test_a_swap_reads_the_neighbour_row_by_row(self, between, codes) -> None:
        before = codes(5, 9, temperature_counts=np.zeros(4, np.int64))
        after = ChannelSwap("S2").codes(before, between)
        assert after.counts.tolist() == [[-row] * 3 for row in range(5, 9)]
        assert after.temperature_counts.tolist() == [505, 506, 507, 508]
        assert after.fresh.tolist() == [False, True, False, True]
        assert (after.first, after.instant_ns.tolist()) == (5, before.instant_ns.tolist())

    def test_temperature_is_swapped_where_both_have_a_thermometer(self, between, codes) -> None:
        """A log has a temperature column for a chip with a thermometer, and for no other."""
        cold = codes(5, 9, temperature_counts=np.zeros(4, np.int64))
        assert ChannelSwap("S3").codes(cold, between).temperature_counts.tolist() == [0, 0, 0, 0]
        assert ChannelSwap("S2").codes(replace(cold, temperature_counts=None), between).temperature_counts is None

    @pytest.mark.parametrize("name", ["", "S1"])
    def test_a_swap_with_itself_does_nothing(self, between, codes, name: str) -> None:
        before = codes(0, 5)
        assert ChannelSwap(name).codes(before, between) is before

    def test_counts_alone_can_be_swapped(self, between, codes) -> None:
        before = codes(5, 9, temperature_counts=np.zeros(4, np.int64))
        after = ChannelSwap("S2", "counts").codes(before, between)
        assert after.counts.tolist() == [[-row] * 3 for row in range(5, 9)]
        assert after.temperature_counts.tolist() == [0, 0, 0, 0]
        assert after.fresh is before.fresh

    def test_a_swap_of_places_does_not_change_readings(self, between, codes) -> None:
        before = codes(0, 5)
        assert ChannelSwap("S2", "place").codes(before, between) is before

    def test_an_unknown_neighbour_is_refused(self, between, codes) -> None:
        with pytest.raises(ValueError, match=r"^channel_swap of S1: S9: no triad of this array; it has S1, S2, S3$"):
            ChannelSwap("S9").codes(codes(0, 5), between)


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: StaleSamples(1.0), "probability: 1.0; allowed is 0 to 0.99"),
    (lambda: Glitches(1.5), "probability: 1.5; allowed is 0 to 1"),
    (lambda: Glitches(0.1, -1.0), "amplitude: -1.0"),
    (lambda: Glitches(0.1, kind="spikes"), "kind: 'spikes'; allowed are spike, torn, word"),
    (lambda: ChannelSwap("S2", "wires"), "kind: 'wires'; allowed are data, counts, place"),
    (lambda: Stuck(-1.0), "onset_s: -1.0"),
    (lambda: Stuck(1.0, math.nan), "duration_s: nan"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_invalid_parameters_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        make()
