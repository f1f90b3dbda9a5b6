"""Each fault many times (a thousand by the campaigns): every one is flagged and reported, no bad reading is stored as
good, the other sensors go on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.array import ArrayConfig
from imuarray.log.format import LOST_BEFORE, OVERRUN, RECONFIGURED, STALE, SUSPECT
from imuarray.log.health import StartVerdict
from tests.reliability.night import Memory, Night, array_of, night

TIMES = [
    pytest.param(20, id="20"),
    pytest.param(100, id="100", marks=pytest.mark.slow),
    pytest.param(1000, id="1000", marks=pytest.mark.campaign),
]
SECOND = 1_000_000_000
FIRST_S = 8.0

Times = npt.NDArray[np.int64]


class Faults:
    """A night of `count` faults of one kind, one every `every_s`, and their times in its log."""

    def __init__(
        self,
        array: ArrayConfig,
        count: int,
        every_s: float,
        table: dict[str, Any],
        *,
        rate_hz: float = 10.0,
        also: Any = (),
    ) -> None:
        fault = {"at_s": FIRST_S, "every_s": every_s, "times": count, **table}
        self.count, self.rate_hz = count, rate_hz
        self.night: Night = night(array, [fault, *also], FIRST_S + every_s * count, rate_hz=rate_hz, each=True)
        self.log: Memory = self.night.log
        first_ns = round(FIRST_S * SECOND) + self.night.powered_on_ns
        self.begin: Times = first_ns + np.arange(count) * round(every_s * SECOND)
        self.end: Times = self.begin + round(table.get("for_s", 0.0) * SECOND)

    def rows(self, sensor: str) -> tuple[Times, npt.NDArray[np.uint16]]:
        """Times and status."""
        return self.log.of(sensor, "time"), self.log.of(sensor, "status")

    def next_with(self, sensor: str, flag: int) -> Times:
        """For each fault the first row after its begin with that flag; it must come before the next fault."""
        time, status = self.rows(sensor)
        flagged = time[(status & flag) != 0]
        index = np.searchsorted(flagged, self.begin)
        assert (index < len(flagged)).all()
        result: Times = flagged[index]
        assert (result[:-1] < self.begin[1:]).all()
        return result

    def event_delays(self, kind: str, sensor: str = "") -> Times:
        """For each fault the delay in ns until an event of that kind; it must come before the next fault."""
        at = self.log.times_of(kind, sensor)
        index = np.searchsorted(at, self.begin)
        assert (index < len(at)).all()
        assert (at[index][:-1] < self.begin[1:]).all()
        delay: Times = at[index] - self.begin
        return delay

    def good_between(self, sensor: str, begin: Times, end: Times) -> int:
        """Rows in [begin, end) of some fault that are flagged neither suspect nor stale."""
        time, status = self.rows(sensor)
        good = time[(status & (SUSPECT | STALE)) == 0]
        return int((np.searchsorted(good, end) - np.searchsorted(good, begin)).sum())

    def undisturbed(self, sensor: str) -> None:
        """Every frame has a reading, without a flag."""
        _, status = self.rows(sensor)
        assert len(status) == self.night.summary.frames
        assert not status.any()
        assert self.night.summary.missed == 0


@pytest.mark.parametrize("count", TIMES)
def test_a_missing_acknowledgement_is_flagged_and_reported(count: int) -> None:
    faults = Faults(array_of(A=0, C=0), count, 2.013, {"kind": "no_acknowledge", "sensor": "C", "for_s": 0.31})
    time, _ = faults.rows("C")
    assert (np.searchsorted(time, faults.end) == np.searchsorted(time, faults.begin)).all()  # nothing made up
    assert (faults.next_with("C", LOST_BEFORE) - faults.end < SECOND).all()
    assert (faults.event_delays("lost", "C") < 0.2 * SECOND).all()
    faults.undisturbed("A")


@pytest.mark.parametrize("count", TIMES)
def test_an_unplugged_sensor_is_flagged_and_set_up_again(count: int) -> None:
    faults = Faults(array_of(A=0, C=0), count, 4.017, {"kind": "unplugged", "sensor": "C", "for_s": 0.7})
    again = faults.next_with("C", RECONFIGURED)
    assert faults.good_between("C", faults.begin, again) == 0
    assert (again - faults.end < 2 * SECOND).all()
    np.testing.assert_array_equal(again, faults.next_with("C", LOST_BEFORE))
    faults.event_delays("lost", "C")
    faults.event_delays("reconfigured", "C")
    faults.undisturbed("A")


@pytest.mark.parametrize("count", TIMES)
@pytest.mark.parametrize(("kind", "sensor"), [("reset", "C"), ("torn", "C"), ("torn", "G")])
def test_a_lost_configuration_is_reported_within_a_second(count: int, kind: str, sensor: str) -> None:
    """Within a second of array time it is reported; no reading in between is stored as good."""
    faults = Faults(array_of(A=0, **{sensor: 0}), count, 3.017, {"kind": kind, "sensor": sensor})
    again = faults.next_with(sensor, RECONFIGURED)
    assert faults.good_between(sensor, faults.begin, again) == 0
    assert faults.event_delays("configuration", sensor).max() < SECOND
    faults.event_delays("reconfigured", sensor)
    time, status = faults.rows(sensor)
    assert not (status[time < faults.begin[0] - SECOND] & SUSPECT).any()
    assert np.mean((status & SUSPECT) == 0) > 0.3  # most of the time it worked
    faults.undisturbed("A")


@pytest.mark.parametrize("count", TIMES)
@pytest.mark.parametrize("cured", [True, False])
def test_a_frozen_sensor_is_flagged_and_reported(count: int, cured: bool) -> None:
    table = {"kind": "frozen", "sensor": "C", "for_s": 3.2, "until_set_up": cured}
    faults = Faults(array_of(A=0, C=0), count, 6.017, table)
    time, _ = faults.rows("C")
    first = time[np.searchsorted(time, faults.begin)]  # the reading at which it froze was a good one
    again = faults.next_with("C", RECONFIGURED)
    assert faults.good_between("C", first + 1, again if cured else faults.end) == 0
    faults.event_delays("frozen", "C")
    faults.undisturbed("A")


@pytest.mark.parametrize("count", TIMES)
def test_stale_readings_are_flagged_and_reported(count: int) -> None:
    faults = Faults(array_of(A=0, C=0), count, 3.013, {"kind": "stale", "sensor": "C", "for_s": 0.5})
    time, status = faults.rows("C")
    inside = (np.searchsorted(faults.begin, time, "right") - np.searchsorted(faults.end, time, "right")) == 1
    assert inside.sum() >= 4 * count
    np.testing.assert_array_equal(inside, (status & STALE) != 0)
    faults.event_delays("stale", "C")
    faults.undisturbed("A")


@pytest.mark.parametrize("count", TIMES)
def test_a_queue_overrun_is_flagged(count: int) -> None:
    """The program is not run for 0.5 s; 32 sets at 100 Hz last 0.32 s. Polled sensors have lost readings too."""
    faults = Faults(array_of(A=0, Q=0), count, 2.013, {"kind": "stall", "for_s": 0.5})
    faults.next_with("Q", OVERRUN)
    faults.event_delays("overrun", "Q")
    faults.event_delays("late")
    faults.next_with("A", LOST_BEFORE)
    assert faults.night.summary.missed >= 3 * count
    _, status = faults.rows("Q")
    assert np.count_nonzero(status & OVERRUN) == count


@pytest.mark.parametrize("count", TIMES)
def test_a_stuck_bus_is_reported(count: int) -> None:
    faults = Faults(array_of(A=0, C=1), count, 4.013, {"kind": "stuck_bus", "for_s": 0.4})
    assert faults.event_delays("bus").max() < 0.3 * SECOND
    for sensor in "AC":
        time, _ = faults.rows(sensor)
        assert (np.searchsorted(time, faults.end) == np.searchsorted(time, faults.begin)).all()
        assert (faults.next_with(sensor, LOST_BEFORE) - faults.end < SECOND).all()


@pytest.mark.parametrize("count", TIMES)
def test_a_sensor_that_holds_the_clock_costs_the_others_no_reading(count: int) -> None:
    """It costs all sensors a time-out at intervals, and the others no reading."""
    faults = Faults(array_of(A=0, C=0), count, 3.013, {"kind": "clock_held", "sensor": "C", "for_s": 0.5})
    time, _ = faults.rows("C")
    assert (np.searchsorted(time, faults.end) == np.searchsorted(time, faults.begin)).all()
    assert (faults.next_with("C", LOST_BEFORE) - faults.end < SECOND).all()
    faults.event_delays("lost", "C")
    assert not len(faults.log.times_of("bus"))
    faults.undisturbed("A")


@pytest.mark.parametrize("count", TIMES)
@pytest.mark.parametrize("reads_right", [True, False])
def test_a_wrong_channel_gives_no_reading_of_the_twin(count: int, reads_right: bool) -> None:
    """Two BMA180 at one address, at 2 g and at 16 g, at rest: 4096 and 512 counts per g (BMA-72, BMA-76)."""
    table = {"kind": "wrong_channel", "for_s": 0.25, "reads_right": reads_right}
    faults = Faults(array_of(A=0, B=0, C=1), count, 2.013, table)
    faults.event_delays("channel")
    for sensor, low, high in (("B", 3000, 5000), ("C", 350, 700)):
        z = faults.log.of(sensor, "counts")[:, 2]
        assert ((z > low) & (z < high)).all()
    lost = [np.searchsorted(time[(status & LOST_BEFORE) != 0], faults.begin) for time, status in map(faults.rows, "BC")]
    assert (np.diff(lost[0]) + np.diff(lost[1]) > 0).all()  # in each night's window one of the two lost a reading


@pytest.mark.parametrize("count", TIMES)
def test_a_wrong_channel_gives_no_reading_of_a_twin_configured_alike(count: int) -> None:
    """The second of two equal gyroscopes starts 50 dps off, so that their readings differ."""
    off = {"kind": "start_up", "sensor": "H", "bias": [50.0, 0.0, 0.0]}
    table = {"kind": "wrong_channel", "for_s": 0.25, "reads_right": True}
    faults = Faults(array_of(G=0, H=1), count, 2.013, table, also=[off])
    faults.event_delays("channel")
    assert (np.abs(faults.log.of("G", "counts")[:, 0]) < 2000).all()
    assert (faults.log.of("H", "counts")[:, 0] > 4000).all()  # 50 dps are 5714 counts (L3G-40)


@pytest.mark.parametrize("count", TIMES)
def test_a_reset_multiplexer_gives_no_wrong_reading(count: int) -> None:
    faults = Faults(array_of(A=0, B=0, C=1), count, 1.513, {"kind": "mux_reset"})
    for sensor, low, high in (("B", 3000, 5000), ("C", 350, 700)):
        z = faults.log.of(sensor, "counts")[:, 2]
        assert ((z > low) & (z < high)).all()
        _, status = faults.rows(sensor)  # read again in the same frame, unless the reset was during a visit
        assert len(z) == faults.night.summary.frames - faults.night.summary.lost[sensor]
        assert np.count_nonzero(status & LOST_BEFORE) == faults.night.summary.lost[sensor] < 0.02 * count


@pytest.mark.parametrize("count", TIMES)
def test_an_address_taken_by_a_kernel_driver_is_reported(count: int) -> None:
    faults = Faults(array_of(A=0, C=0), count, 5.017, {"kind": "kernel_driver", "sensor": "C", "for_s": 1.1})
    again = faults.next_with("C", RECONFIGURED)
    assert faults.good_between("C", faults.begin, again) == 0
    assert faults.event_delays("taken", "C").max() < SECOND
    faults.event_delays("reconfigured", "C")
    faults.undisturbed("A")


@pytest.mark.parametrize("count", [pytest.param(5, id="5"), TIMES[1]])
def test_a_start_up_in_another_state_is_flagged_and_set_up_again(count: int) -> None:
    """Known are -2 (the emulated unit's own) and 1 dps; it starts in another state, and in a known state after it was
    set up again.
    """
    sensitivity = 1 / 0.00875  # L3G-40
    random = np.random.default_rng(8)

    def judge(readings: Any) -> dict[str, StartVerdict]:
        rate_dps = readings["G"].mean(axis=0)[0] / sensitivity
        fault = bool(min(abs(rate_dps + 2.0), abs(rate_dps - 1.0)) > 1.0)
        return {"G": StartVerdict(fault, f"{rate_dps:.1f} dps" if fault else "")}

    for _ in range(count):
        bias = float(random.uniform(5.0, 20.0))
        fault = {"kind": "start_up", "sensor": "G", "bias": [bias, 0.0, 0.0], "until_set_up": True, "at_s": 1.0}
        log = night(array_of(G=0), [fault], 24.0, rate_hz=4.0, judge=judge).log
        status, counts = log.of("G", "status"), log.of("G", "counts")[:, 0]
        wrong = counts > 2.0 * sensitivity
        assert wrong.sum() > 30
        (again,) = np.flatnonzero(status & RECONFIGURED)
        assert (status[wrong] & SUSPECT).all()
        assert not (status[again:] & SUSPECT).any()
        assert [event.kind for event in log.events] == ["start_up", "reconfigured"]
