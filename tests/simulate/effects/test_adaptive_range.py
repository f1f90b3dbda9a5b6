"""adaptive_range: the readings of a ramp, by hand, and compared with the emulated chip."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.element import UnitDeviations
from firmware_emulator.mechanisms.converter import AdaptiveRange as Mechanism
from firmware_emulator.mechanisms.mechanism import FittedBoard, Fitting
from firmware_emulator.world import WorldStimulus
from imuarray.simulate.effects.conversion import LONGEST, AdaptiveRange

MS = 10**6
PER_DPS = 10.0


@pytest.fixture
def gyroscope(sensor):
    return sensor("icm42688_gyro", "S1", 2000.0, sensitivity=PER_DPS, rate_hz=1000.0)


def shown(place, codes, sensor, counts, hold_s: float = 1.5e-3, every_ms: float = 1.0, first: int = 0) -> list[int]:
    """The first axis after the effect, of rows so far apart; the others are 1 and 2 more."""
    rows_per_s = 1e3 / every_ms
    before = codes(first, first + len(counts), np.asarray(counts)[:, None] + np.arange(3), rows_per_s=rows_per_s)
    after = AdaptiveRange(100.0, hold_s).codes(before, place(sensor, rows_per_s=rows_per_s))
    assert np.array_equal(after.fresh, before.fresh)
    assert np.array_equal(after.counts[:, 2] - after.counts[:, 0], np.full(len(counts), 2))
    return after.counts[:, 0].tolist()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_ramp_through_the_threshold_is_held(place, codes, gyroscope, sign: int) -> None:
    """1000 counts are 100 dps: of rows 1 ms apart the one that is beyond, and the next, show the one before."""
    ramp = [sign * 300 * row for row in range(8)]
    expected = [0, 300, 600, 900, 900, 900, 1800, 2100]
    assert shown(place, codes, gyroscope, ramp) == [sign * count for count in expected]
    back = [2100, 1800, 1500, 1200, 1200, 1200, 300, 0]
    assert shown(place, codes, gyroscope, ramp[::-1]) == [sign * count for count in back]


@pytest.mark.parametrize(("hold_s", "rows"), [(0.5e-3, 1), (1e-3, 1), (1.001e-3, 2), (3.5e-3, 4)])
def test_the_hold_has_its_duration(place, codes, gyroscope, hold_s: float, rows: int) -> None:
    step = [0] * 5 + [2000 + row for row in range(20)]
    after = shown(place, codes, gyroscope, step, hold_s)
    assert after == [0] * (5 + rows) + [2000 + row for row in range(rows, 20)]


def test_another_crossing_within_the_hold_lengthens_it(place, codes, gyroscope) -> None:
    after = shown(place, codes, gyroscope, [10, 20, 1500, 30, 40, 50, 60])
    assert after == [10, 20, 20, 20, 20, 50, 60]


def test_slow_rows_show_the_reading_of_the_crossing(place, codes, gyroscope) -> None:
    """A ramp of 100 counts a millisecond, of which a row is read every 10 ms: 1000 is passed 4 ms before the row at 24
    ms, so late that the hold is over; 0.5 ms before that at 20.5 ms, which shows the reading at 20 ms.
    """
    late = [100 * (10 * row + 4) for row in range(5)]
    assert shown(place, codes, gyroscope, late, every_ms=10.0) == late
    soon = [50 * (20 * row) + 50 for row in range(5)]
    after = shown(place, codes, gyroscope, soon, every_ms=10.0)
    assert after[0] == soon[0]
    assert after[2:] == soon[2:]
    assert 950 <= after[1] <= 1000 < soon[1]


def test_readings_below_the_threshold_are_unchanged(place, codes, gyroscope) -> None:
    noise = np.random.default_rng(1).integers(-500, 500, 5000).tolist()
    assert shown(place, codes, gyroscope, noise) == noise


def test_readings_do_not_depend_on_blocks(place, codes, gyroscope) -> None:
    """Within its lookback, also while the threshold is passed all the time."""
    counts = np.random.default_rng(2).integers(900, 1100, 6000).tolist()
    at = place(gyroscope, rows_per_s=1000.0)
    back = AdaptiveRange(100.0, 1.5e-3).lookback(at)
    assert back == LONGEST + 4
    whole = shown(place, codes, gyroscope, counts)
    assert whole != counts
    for first in (back, 1000, 3333, 5000):
        part = shown(place, codes, gyroscope, counts[first - back :], first=first - back)
        assert part[back:] == whole[first:]


def test_defaults_do_nothing_and_parameters_are_checked(place, codes) -> None:
    before = codes(0, 10)
    assert AdaptiveRange().codes(before, place()) is before
    for wrong in ({"threshold": -1.0}, {"hold_s": -1.0}, {"hold_s": 2.0}):
        with pytest.raises(ValueError, match="allowed is"):
            AdaptiveRange(**wrong)


SENSOR = SimpleNamespace(
    name="G",
    chip="icm42688_gyro",
    channel=None,
    bus=None,
    address=0x68,
    range=2000.0,
    orientation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
)
ARRAY = SimpleNamespace(name="bench", mux=None, sensors=(SENSOR,))


def turning(at_ns: int) -> WorldStimulus:
    """160 dps there and back in 0.4 s, about x."""
    return WorldStimulus(
        (0.0, 0.0, 9.80665), (float(np.radians(160.0) * np.sin(at_ns * 1e-9 * 2 * np.pi / 0.4)), 0.0, 0.0)
    )


class IdealBoard(FittedBoard):
    def unit(self, sensor: object) -> UnitDeviations:
        return UnitDeviations()


def readings(control: str, *fittings: Fitting) -> list[int]:
    """Counts of x at 2000 dps, one a millisecond, of a chip whose adaptive range is as INTF_CONFIG1 is set."""
    bus = open_array(ARRAY, world=turning, board=lambda array, world, seed: IdealBoard(ARRAY, world, seed, fittings))
    for text in (control, "4f06", "4e0c"):
        bus.transfer(0x68, bytes.fromhex(text))
    values = []
    bus.clock.sleep_until(200 * MS + 250_000)
    for index in range(1000):
        bus.clock.sleep_until(200 * MS + 250_000 + index * MS)
        values.append(int.from_bytes(bus.transfer(0x68, b"\x25", 2), "big", signed=True))
    return values


def test_the_mechanism_the_register_and_the_effect_agree(place, codes, sensor) -> None:
    """Three independent implementations of TDK-18."""
    clean = readings("4d51")
    by_register = readings("4d91")
    by_mechanism = readings("4d51", Fitting(Mechanism(), ("G",)))
    assert by_register != clean
    assert by_mechanism == by_register
    gyroscope = sensor("icm42688_gyro", "S1", 2000.0, rate_hz=1000.0)
    rows = codes(0, len(clean), np.stack([clean, *np.zeros((2, len(clean)), int)], axis=1), rows_per_s=1000.0)
    after = AdaptiveRange(100.0, 1.5e-3).codes(rows, place(gyroscope, rows_per_s=1000.0))
    assert after.counts[:, 0].tolist() == by_register
    changed = np.array(clean) != by_register
    assert np.count_nonzero(changed) == 2 * 10  # two rows at each of four passages in each of 2.5 periods


def test_severity_lengthens_the_hold() -> None:
    assert Mechanism.at(2.0).held_s == pytest.approx(3e-3)
    longer = readings("4d51", Fitting(Mechanism.at(4.0), ("G",)))
    assert max(np.diff(np.flatnonzero(np.diff(longer)))) >= 6
