"""`own_clock`: the reading of each poll, compared with readings numbered by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats

from imuarray.array import parse_array
from imuarray.log.format import STALE
from imuarray.simulate.converters import hold_readings, latest_reading
from imuarray.simulate.effects.conversion import OdrError
from imuarray.simulate.effects.timing import OwnClock
from imuarray.simulate.sensor import SimulatedSensor
from imuarray.simulate.signal import Codes, Instants, Place
from imuarray.simulate.simulation import Simulation, plan_of
from imuarray.simulate.streams import CHUNK
from tests.simulate.conftest import MakePlace, header

MakeInstants = Callable[..., Instants]

DRAWN = math.nan


def polled(effect: OwnClock, rows: Instants, at: Place) -> Any:
    """(n,) ns: when the readings were made that polls get."""
    after = effect.sampled(rows, at)
    return latest_reading(after.instant_ns, after.rate_hz, after.phase)


def at_rate(place: MakePlace, rate_hz: float, **changes: Any) -> Place:
    return place(header("l3g4200d", rate_hz=rate_hz), **changes)


def sensor(motion: Any, effects: tuple[Any, ...], *, set_hz: float, frames_hz: float, seconds: float) -> Any:
    """An ADXL345 at 16 g."""
    text = (
        f'[array]\nname = "a"\n[[sensor]]\nname = "S"\nchip = "adxl345"\naddress = 0x53\nrange = 16\nrate_hz = {set_hz}'
    )
    made = Simulation(plan_of(parse_array(text), frames_hz, seconds), motion, {"S": effects}, seed=3)
    simulated = made.sensors["S"]
    assert isinstance(simulated, SimulatedSensor)
    return simulated


def ramp(g_per_s: float) -> Callable[[Any], Any]:
    return lambda seconds: np.outer(np.asarray(seconds), [g_per_s * 9.80665, 0.0, 0.0])


class TestInstants:
    def test_readings_match_those_numbered_by_hand(self, place: MakePlace, instants: MakeInstants) -> None:
        """80 Hz and a quarter more are 100 Hz; a quarter of 10 ms had passed at the epoch: -2.5, 7.5, 17.5 ... ms."""
        rows = instants(0, 5, rows_per_s=40.0, rate_hz=80.0)
        result = polled(OwnClock(0.25, 90.0), rows, at_rate(place, 80.0, rows_per_s=40.0))
        assert result.tolist() == [-2_500_000, 17_500_000, 47_500_000, 67_500_000, 97_500_000]

    def test_ages_have_a_beat(self, place: MakePlace, instants: MakeInstants) -> None:
        """1 % more than 800 Hz, polled 100 times a second: 8.08 periods a poll. Ages grow by 8 hundredths of a period
        and repeat after 25 polls, in which they have wrapped twice.
        """
        rows = instants(0, 1000, rate_hz=800.0)
        age = rows.instant_ns - polled(OwnClock(0.01), rows, at_rate(place, 800.0))
        period_ns = 1e9 / 808
        hundredths = 8 * np.arange(1000) % 100
        np.testing.assert_allclose(age, hundredths / 100 * period_ns, atol=1)
        assert age.mean() == pytest.approx(0.48 * period_ns, rel=1e-6)  # of 0, 4, ..., 96 hundredths

    def test_ages_are_constant_at_a_multiple_of_the_rate(self, place: MakePlace, instants: MakeInstants) -> None:
        """800 Hz polled 100 times a second, 120 deg: a third of 1.25 ms, always."""
        rows = instants(0, 1000, rate_hz=800.0)
        age = rows.instant_ns - polled(OwnClock(phase_deg=120.0), rows, at_rate(place, 800.0))
        assert np.unique(age).tolist() == [416_667]

    def test_the_phase_differs_for_every_boot_and_sensor(self, place: MakePlace, instants: MakeInstants) -> None:
        """Uniform by Kolmogorov and Smirnov, not correlated from one sensor to the next: a false alarm in 1000 seeds
        each.
        """
        rows, boots = instants(0, 1, rate_hz=100.0), range(1000)
        first, second = (
            [OwnClock(phase_deg=DRAWN).sampled(rows, place(header(name=name), boot=boot)).phase for boot in boots]
            for name in ("S1", "S2")
        )
        for phases in (first, second):
            assert stats.kstest(phases, "uniform").pvalue > 1e-3
        assert stats.pearsonr(first, second).pvalue > 1e-3

    def test_a_given_phase_is_that_of_every_boot(self, place: MakePlace, instants: MakeInstants) -> None:
        rows = instants(0, 1)
        assert {OwnClock(phase_deg=90.0).sampled(rows, place(boot=boot)).phase for boot in range(5)} == {0.25}

    @given(st.integers(-(10**12), 10**15), st.floats(0.1, 3400.0), st.floats(0.0, 1.0))
    @example(123_956_804, 3210.7, 0.25)
    def test_a_reading_is_at_most_one_period_old_and_stable(
        self, instant_ns: int, rate_hz: float, phase: float
    ) -> None:
        """`hold_readings` decides by the readings' times which of them are the same."""
        (result,) = latest_reading(np.array([instant_ns]), rate_hz, phase).tolist()
        rounding_ns = 2 + 1e-6 * 1e9 / rate_hz
        assert -rounding_ns <= instant_ns - result <= 1e9 / rate_hz + rounding_ns
        assert latest_reading(np.array([result]), rate_hz, phase).tolist() == [result]


class TestUnchangedRows:
    @pytest.mark.parametrize("rows_per_s", [95.5, 100.0, 104.5])
    def test_rows_at_the_rate_of_readings_are_unchanged(
        self, place: MakePlace, instants: MakeInstants, rows_per_s: float
    ) -> None:
        rows = instants(0, 50, rows_per_s=rows_per_s, rate_hz=100.0)
        at, effect = at_rate(place, 100.0, rows_per_s=rows_per_s), OwnClock(-0.03, DRAWN)
        assert effect.sampled(rows, at) is rows
        assert effect.lookback(at) == 0

    @pytest.mark.parametrize("rows_per_s", [90.0, 110.0])
    def test_polled_rows_are_changed(self, place: MakePlace, instants: MakeInstants, rows_per_s: float) -> None:
        rows = instants(0, 50, rows_per_s=rows_per_s, rate_hz=100.0)
        after = OwnClock(-0.03, DRAWN).sampled(rows, at_rate(place, 100.0, rows_per_s=rows_per_s))
        assert after.rate_hz == pytest.approx(97.0)
        assert after.phase != 0

    def test_a_chip_without_a_rate_is_unchanged(self, place: MakePlace, instants: MakeInstants) -> None:
        rows = instants(0, 50, rate_hz=0.0)
        assert OwnClock(0.1, DRAWN).sampled(rows, at_rate(place, 0.0)) is rows

    def test_a_drained_queue_is_unchanged(self, constant: Any) -> None:
        text = '[array]\nname = "a"\n[[sensor]]\nname = "S"\nchip = "adxl345"\naddress = 0x53\nrange = 16\nfifo = true'
        plan, motion = plan_of(parse_array(text), 30.0, 2.0), constant(force_box=ramp(5.0))
        plain, late = (
            Simulation(plan, motion, {"S": effects}).sensors["S"].block(0, 200).counts.tolist()
            for effects in ((), (OwnClock(0.08, 200.0),))
        )
        assert plain == late


class TestHeldReadings:
    @pytest.mark.parametrize("phase", [0.2, 1e-6])
    def test_rows_repeat_according_to_the_real_rate(self, constant: Any, phase: float) -> None:
        """50 Hz and 3 % are 51.5 readings a second; asked 100 times. The force rises by 2 counts a millisecond, so
        every reading has distinct counts, those of the instant at which it was made.
        """
        effects = (OwnClock(0.03, 360 * phase),)
        slow = sensor(constant(force_box=ramp(8.0)), effects, set_hz=50, frames_hz=100.0, seconds=1.9)
        block = slow.block(0, 190)
        made_s = (np.floor(block.time * 1e-9 * 51.5 + phase) - phase) / 51.5
        assert np.abs(block.counts[:, 0] - 8.0 * 256 * made_s).max() <= 0.5 + 1e-6
        stale = (block.status & STALE) != 0
        assert stale.tolist() == [False, *(np.diff(block.counts[:, 0]) == 0).tolist()]
        assert abs((~stale).sum() - 1.9 * 51.5) <= 1

    @pytest.mark.parametrize(
        ("effect", "set_hz"),
        [(OwnClock(-0.3, DRAWN), 100), (OwnClock(0.05, DRAWN), 100), (OwnClock(phase_deg=DRAWN), 100),
         (OwnClock(-0.5, DRAWN), 400), (OwnClock(-0.5, DRAWN), 200)],
    )  # fmt: skip
    def test_any_block_alone_equals_that_of_the_whole(self, constant: Any, effect: OwnClock, set_hz: int) -> None:
        """Across the border of two chunks, where readings are held from one to the next; also of a chip that is set to
        be faster than the polls, and isn't.
        """
        motion = constant(force_box=lambda seconds: np.outer(np.sin(900.0 * np.asarray(seconds)), [50.0, 0.0, 0.0]))
        frames_hz = 180.0 if set_hz == 200 else 201.0
        made = [sensor(motion, (effect,), set_hz=set_hz, frames_hz=frames_hz, seconds=95.0) for _ in range(2)]
        whole = made[0].block(CHUNK - 400, CHUNK + 400)
        for first in range(CHUNK - 20, CHUNK + 20):
            part = made[1].block(first, first + 3)
            rows = slice(first - CHUNK + 400, first - CHUNK + 403)
            assert part.counts.tolist() == whole.counts[rows].tolist()
            assert part.status.tolist() == whole.status[rows].tolist()

    @pytest.mark.parametrize(("rate_error", "rows"), [(-0.5, 21), (-0.2, 14), (0.2, 10), (0.0, 0)])
    def test_the_lookback_is_sufficient(
        self, place: MakePlace, codes: Callable[..., Codes], rate_error: float, rows: int
    ) -> None:
        """A chip set to 10 Hz, asked 100 times: all rows that share a reading, and the one before them."""
        back = OwnClock(rate_error, 90.0).lookback(at_rate(place, 10.0))
        assert back == rows
        if back:
            whole, alone = (hold_readings(codes(first, 1000), 10 * (1 + rate_error), 0.25) for first in (0, 700 - back))
            np.testing.assert_array_equal(alone.counts[back:], whole.counts[700:])
            np.testing.assert_array_equal(alone.fresh[back:], whole.fresh[700:])


class TestWithOdrError:
    def test_odr_error_determines_the_rate(self, place: MakePlace, instants: MakeInstants) -> None:
        rows, at = instants(0, 3, rate_hz=800.0), at_rate(place, 800.0)
        after = OdrError(200.0).sampled(OwnClock(0.05, 90.0).sampled(rows, at), at)
        assert (after.rate_hz, after.phase) == (200.0, 0.25)

    @pytest.mark.parametrize(("set_hz", "step"), [(1600, 2), (800, 1)])
    @pytest.mark.parametrize("rate_error", [-0.1, 0.1])
    @pytest.mark.parametrize("bandwidth_hz", [math.nan, 300.0])
    def test_codes_depend_on_the_configured_rate(
        self, constant: Any, set_hz: int, step: int, rate_error: float, bandwidth_hz: float
    ) -> None:
        """ADX-47: at 1600 Hz they are even, for any error of the oscillator, at 800 Hz they aren't."""
        effects = (OwnClock(rate_error), OdrError(bandwidth_hz=bandwidth_hz))
        made = sensor(constant(force_box=ramp(1.0)), effects, set_hz=set_hz, frames_hz=400.0, seconds=2.0)
        codes = np.unique(made.block(0, 800).counts[:, 0])
        assert set(np.diff(codes).tolist()) == {step}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.6, 0.0), r"rate_error: 0\.6; allowed is -0\.5 to 0\.5"),
        ((math.nan, 0.0), "rate_error: nan"),
        ((0.0, math.inf), "phase_deg: inf; a number is required, or nan: drawn at each boot"),
    ],
)
def test_invalid_parameters_are_refused(arguments: tuple[float, float], message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        OwnClock(*arguments)
