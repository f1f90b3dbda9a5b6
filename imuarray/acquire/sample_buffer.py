"""The readings of one sensor between bus and log: stored as raw bytes, decoded in blocks, and written once they are
trusted; and the recovery of a sensor that returns no readings.

A row is written only after the chip's configuration was verified *after* the row was read. A chip that falls back to
its defaults is noticed with a delay, and the readings in between must not be stored as good. The same applies to a chip
with a reading that no longer changes, because it takes a while to distinguish this from chance.

`SensorRecovery` takes one step per frame during the sensor's own visits, so that no other sensor waits for it: read its
identity, at growing intervals while it does not answer; compare its configuration with the intended one; if they
differ, configure it from the start, and let its filters settle while the others are read.

`Intake` writes decoded rows into the log, for every bus. Times in a log strictly increase. A row whose time does not
(after a miscounted queue, a bad fit of the clock, a frame that was delivered twice) must end neither the log nor the
rows around it: it is rejected and counted as a lost reading, an event reports it, and the next row carries the flag
"readings lost just before".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.acquire.fault_episode import FaultEpisodes
from imuarray.array import SensorConfig
from imuarray.arrays import Booleans, Times
from imuarray.drivers import Driver, FifoDriver, OnDemandDriver
from imuarray.drivers.fifo_clock import TOLERANCE
from imuarray.drivers.iio import IioSensor
from imuarray.errors import SensorError
from imuarray.facts.registers import Setting
from imuarray.log.format import (
    LOST_BEFORE,
    OVERRUN,
    RECONFIGURED,
    STALE,
    SUSPECT,
    TIME_UNCERTAINTY,
    SensorHeader,
    header_of,
)
from imuarray.log.rotate import Writer
from imuarray.log.writer import Block
from imuarray.printable import counted

FIRST_PAUSE_NS = 100_000_000
LONGEST_PAUSE_NS = 3_200_000_000
"""Longest pause in ns between attempts to reach a sensor; pauses double. An attempt at a silent address takes 30 us."""


class SensorRecovery:
    """The recovery of one sensor. `is_intact` is True if it still had its configuration, `is_done` when it can be
    read again.

    With `compare`, its configuration is compared first; without, the chip is configured anew in any case.
    """

    def __init__(self, route: SensorRoute, now_ns: int, *, compare: bool) -> None:
        self.route = route
        self.since_ns = now_ns
        self.is_intact = False
        self.is_done = False
        self.failure: Exception | None = None
        self.refusal = ""
        """The kernel driver that owns the address now, if there is one."""
        self._compares = compare
        self._pause_ns = FIRST_PAUSE_NS
        self._next_ns = now_ns
        self._progress: Iterator[float] | None = None

    def waits(self, now_ns: int) -> bool:
        """Return whether the next step is not due yet."""
        return now_ns < self._next_ns

    @property
    def next_step_ns(self) -> int | None:
        """The time of the next step of a configuration in progress; None if none is in progress."""
        return None if self._progress is None or self.is_done else self._next_ns

    def step(self, now_ns: int) -> None:
        """Do one step. An error is stored in `failure`, and the recovery starts again after a pause."""
        self._progress = self._progress or self._steps()
        self.failure = None
        try:
            self._next_ns = now_ns + round(next(self._progress) * 1e9)
        except StopIteration:
            self.is_done = True
        except (OSError, SensorError) as error:
            cause = error.__cause__
            self.failure = cause if isinstance(cause, OSError) else error
            self._progress = None
            self._next_ns = now_ns + self._pause_ns
            self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)

    def _steps(self) -> Iterator[float]:
        driver = self.route.driver
        self._claim()
        driver.identify()
        if self._compares and driver.watched:
            settings = [(setting, driver.registers.read_back(setting.register)) for setting in driver.watched]
            if all(byte & setting.mask == setting.value for setting, byte in settings):
                self.is_intact = True
                return
        self._compares = False
        yield 0.0
        yield from driver.steps()

    def _claim(self) -> None:
        try:
            self.route.claim()
        except SensorError as error:
            self.refusal = str(error)
            raise
        self.refusal = ""


@dataclass(frozen=True)
class SensorRoute:
    """One sensor, its driver, and its segment of the bus (channels of one multiplexer exclude each other)."""

    sensor: SensorConfig
    driver: Driver
    segment: int | str | None
    claim: Callable[[], None] = lambda: None
    """Raises SensorError if a kernel driver owns the address of the sensor; does nothing on a bus without drivers."""

    @property
    def header(self) -> SensorHeader:
        """Return the header of the sensor in a log, once it is configured."""
        header = header_of(self.sensor, self.driver.header(), is_estimated=self.sensor.estimates_times)
        if isinstance(self.driver, IioSensor):
            return self.driver.described(header)
        return replace(header, delay_ns=self.sensor.delay_ns)


_NEXT_FRAME = 1.1e9
"""Time until the next visit in ns at 1 Hz, with a margin for the alternating order."""
_FROZEN_READINGS = 24
_FROZEN_S = 1.0
_FROZEN_BANDWIDTHS = 30.0
"""Number of readings, duration in s and number of correlation times for which a reading must be constant to count as
frozen. With noise of half a code rms on a single axis, three of four readings repeat the previous code.
"""
_FROZEN_LONGEST = 64 * _FROZEN_READINGS
_FROZEN_SHARE = 0.9
"""Least duration of a constant reading, as a share of the nominal one: frames in quick succession read the same sample
of the chip again.
"""
_SILENT_S = 2.0
_SILENT_READINGS = 3.0
"""Duration in s, and number of reading periods, without a reading after which a sensor is silent (the longer one)."""
_DOUBTFUL = 0
"""Key of rows whose time is uncertain, or before which another read may have occurred; they have no flag in a log."""
HELD_S = 10.0
"""Longest time in s that a row waits. A row that was not verified in this time is written as suspect. If a sensor is
read so rarely that a frozen reading is detected only later, its rows are written before that.
"""


@dataclass(eq=False)
class RegisterCheck:
    """The read-back of one register of a chip, or, without a `setting`, of the owner of its address."""

    buffer: SampleBuffer
    setting: Setting | None
    good_rows: int = 0
    """Number of waiting rows when it was last as configured."""
    wrong: int = 0
    """Number of wrong results in a row."""

    def note_right(self, rows: int | None = None) -> None:
        """Note a right result after so many waiting rows (None: all)."""
        self.wrong = 0
        self.good_rows = len(self.buffer.times_ns) if rows is None else rows

    def note_wrong(self) -> bool:
        """Note a wrong result. The second in a row counts: return True, and flag the rows since the last right one."""
        self.wrong += 1
        if self.wrong == 2:
            self.buffer.distrust(self.good_rows)
        return self.wrong == 2


class SampleBuffer:
    """Bursts of the sensor at `route`, read in `rate_hz` frames per second, until they are written.

    Row numbers count from the oldest waiting row. All flags are set through methods.
    """

    def __init__(self, route: SensorRoute, rate_hz: float) -> None:
        self.route = route
        self.driver = route.driver
        self.rate_hz = rate_hz
        self.times_ns: list[int] = []
        """Times of the waiting rows."""
        self.checks: list[RegisterCheck] = []
        """The checks of its registers, after which waiting rows are verified."""
        self._uncertainties_ns: list[float] = []  # uncertainties of the times, for rows that have one
        self._bursts = bytearray()
        self._flagged: dict[int, list[int]] = {LOST_BEFORE: [], OVERRUN: [], RECONFIGURED: [], _DOUBTFUL: []}
        """Rows with each of these flags."""
        self._suspect: list[tuple[int, int | None]] = []  # [first, end) of misconfigured rows; end None: until `trust`
        self._missing = False
        self.has_failed = False
        """True if a visit has failed since the last reading, for a sensor that converts on demand."""
        self._set_up_again = False
        self._condemned = False
        self.recovery: SensorRecovery | None = None
        """The recovery in progress, None while the sensor is read."""
        self._silent_since_ns: int | None = None
        self._last: npt.NDArray[Any] | None = None
        self.clocks = 9 * (self.driver.burst + 3)  # BUS-02
        self._visited_ns = -(1 << 62)
        self.queue = self.driver.queue if isinstance(self.driver, FifoDriver) else None
        sensor = self.route.sensor
        self._on_demand = sensor.spec.on_demand
        self._converter = self.driver if isinstance(self.driver, OnDemandDriver) else None
        self._reading_period_ns = 1e9 * max(1 / sensor.chip_rate_hz, self._frames_of_a_reading() / self.rate_hz)
        self._awaited_ns: int | None = None
        self._overdue = 0
        self.idle_ns = max(IDLE_NS, round(IDLE_SAMPLES * 1e9 / (sensor.chip_rate_hz * (1 - TOLERANCE))))
        has_own_rate = self.queue is not None or sensor.spec.on_demand
        self.always_due = has_own_rate or sensor.chip_rate_hz >= self.rate_hz
        self.row_rate_hz = sensor.chip_rate_hz if has_own_rate else min(self.rate_hz, sensor.chip_rate_hz)
        if self._on_demand:
            self.row_rate_hz = 1e9 / self._reading_period_ns
        self._frozen_s = _frozen_s(sensor)
        self._frozen_rows = max(_FROZEN_READINGS, math.ceil(self._frozen_s * self.row_rate_hz))
        self.frozen_rows = self._frozen_rows
        self.frozen_reading: bytes | None = None
        self._since_set_up = self._still_row = 0
        self._watch_still = False
        self.doubtful_rows = np.zeros(0, bool)
        self.newest_ns: int | None = None
        # The last reading that was written, its repetitions since the chip was configured, and the time of the first.
        self._written_reading = b""
        self._written_run = self._written_since_ns = 0

    def mark_lost(self) -> None:
        """Flag the next row: readings were lost just before it."""
        self._missing = True

    def recover(self, at_ns: int, *, compare: bool) -> None:
        """Begin a recovery at `at_ns` in place of readings (`SensorRecovery`)."""
        self.recovery = SensorRecovery(self.route, at_ns, compare=compare)

    def end_recovery(self) -> None:
        """Return to reading the sensor."""
        self.recovery = None
        self._silent_since_ns = None

    def note_silence(self, at_ns: int) -> int:
        """Note that a read at `at_ns` failed; return for how many ns reads have been failing."""
        if self._silent_since_ns is None:
            self._silent_since_ns = at_ns
        return at_ns - self._silent_since_ns

    @property
    def is_silent(self) -> bool:
        """True if the last read failed."""
        return self._silent_since_ns is not None

    def condemn(self) -> None:
        """Mark this sensor as permanently untrusted: `trust` has no effect from now on."""
        self._condemned = True

    def _frames_of_a_reading(self) -> int:
        """Return the number of frames in which a chip that converts on demand is visited for one reading. A result that
        would be too old by the next frame is fetched between the frames (`conversion_before`).
        """
        if self._converter is None:
            return 1
        frames, begun_ns = 1, 0.0
        for conversion_ns in self._converter.conversions_ns:
            begun_ns += conversion_ns
            if 1e9 / self.rate_hz - begun_ns <= self._converter.lasting_ns:
                frames, begun_ns = frames + 1, 0.0
        return frames

    def conversion_before(self, due_ns: int) -> int | None:
        """Return when a conversion ends whose result would be too old in the frame at `due_ns`; None without one."""
        if self._converter is None or self.recovery is not None:
            return None
        ready_ns = self._converter.ready_ns
        return None if ready_ns is None or due_ns - ready_ns <= self._converter.lasting_ns else ready_ns

    @property
    def held_rows(self) -> int:
        """The number of newest rows that wait until it is known whether the reading still changes."""
        return min(self.frozen_rows * 5 // 4, math.ceil(HELD_S * self.row_rate_hz))

    def due(self, now_ns: int) -> bool:
        """Return whether to read in this frame; False if the next frame is soon enough for a slow chip."""
        if self.always_due:
            return True
        if now_ns + _NEXT_FRAME / self.rate_hz <= self._visited_ns + 1e9 / self.route.sensor.chip_rate_hz:
            return False
        self._visited_ns = now_ns
        return True

    def overdue(self, at_ns: int) -> int:
        """Return how many more readings are lost after a visit at `at_ns` without a reading: one per visit; for a
        sensor that converts on demand, the number that its reading period yields since its last reading.
        """
        if not self._on_demand:
            return 1
        self.has_failed = True
        if self._awaited_ns is None:
            self._awaited_ns = at_ns
        reported = self._overdue
        self._overdue = max(math.floor((at_ns - self._awaited_ns) / self._reading_period_ns + 0.5), 0)
        return max(self._overdue - reported, 0)

    def silent(self, now_ns: int) -> bool:
        """Return whether `take` received none of the readings of the last seconds, or of the last few that were due."""
        longest_ns = max(_SILENT_S, _SILENT_READINGS / self.row_rate_hz) * 1e9
        return self.newest_ns is None or now_ns - self.newest_ns > longest_ns

    def add(self, burst: bytes, at_ns: int, *, doubtful: bool = False) -> None:
        """Add the readings of one fetch: a single one taken at `at_ns`, or those of a queue. They end a silence."""
        self._silent_since_ns = None
        if doubtful:
            self._flagged[_DOUBTFUL].append(len(self.times_ns))
        if self._missing:
            self._flagged[LOST_BEFORE].append(len(self.times_ns))
            self._missing = False
        if self._set_up_again:
            self._flagged[RECONFIGURED].append(len(self.times_ns))
            self._set_up_again = False
        if self._on_demand:
            self._awaited_ns, self._overdue, self.has_failed = at_ns + round(self._reading_period_ns), 0, False
        if self.queue is None:
            self.times_ns.append(at_ns)
        else:
            self._flagged[OVERRUN] += [len(self.times_ns) + row for row in self.queue.gaps]
            self.times_ns += self.queue.drained
            self._uncertainties_ns += self.queue.uncertainties_ns
        self._bursts += burst

    def add_rows(
        self,
        times_ns: Sequence[int],
        bursts: bytes,
        gaps: Sequence[int],
        *,
        overrun: bool = False,
        uncertainties_ns: Sequence[float] = (),
    ) -> None:
        """Add readings of a stream, taken at `times_ns`. Readings were lost before the rows `gaps` (ascending), and
        with `overrun` before the first, because the chip's queue overflowed. `uncertainties_ns` are those of the times
        of a queue.
        """
        rows = len(self.times_ns)
        if self._set_up_again:
            self._flagged[RECONFIGURED].append(rows)
            self._set_up_again = False
        first_lost = [0] if self._missing and 0 not in gaps else []
        self._flagged[LOST_BEFORE] += [rows + row for row in (*first_lost, *gaps)]
        self._missing = False
        if overrun:
            self._flagged[OVERRUN].append(rows)
        self.times_ns += times_ns
        self._uncertainties_ns += uncertainties_ns
        self._bursts += bursts

    def cut(self, row: int) -> int:
        """Discard the rows from `row` on, which are another chip's readings; return their number."""
        count = max(len(self.times_ns) - row, 0)
        if count:
            self._missing = True
            self._set_up_again |= any(index >= row for index in self._flagged[RECONFIGURED])
            del self.times_ns[row:], self._uncertainties_ns[row:], self._bursts[row * self.driver.burst :]
            for rows in self._flagged.values():
                rows[:] = [index for index in rows if index < row]
            self._suspect = [
                (min(first, row), None if last is None else min(last, row)) for first, last in self._suspect
            ]
            self._still_row = min(self._still_row, row)
        return count

    def distrust(self, row: int) -> None:
        """Flag rows from `row` on as suspect, until `trust`."""
        self._suspect.append((max(row, 0), None))

    def flag_suspect(self, first: int, end: int) -> None:
        """Flag rows from `first` up to `end`, not included, as suspect."""
        self._suspect.append((first, end))

    @property
    def verified_rows(self) -> int:
        """Number of waiting rows that were followed by a right result of every check; all if there are no checks."""
        return min((check.good_rows for check in self.checks), default=len(self.times_ns))

    def flag_unverified(self) -> bool:
        """Flag the waiting rows that no check has verified, so that they can be written. False if there are none."""
        verified, waiting = self.verified_rows, len(self.times_ns)
        if verified < waiting:
            self.flag_suspect(verified, waiting)
            for check in self.checks:
                check.good_rows = waiting
        return verified < waiting

    def note_verified(self) -> None:
        """Note that every register is right, because all were just read or configured."""
        for check in self.checks:
            check.note_right()

    def trust(self) -> None:
        """Stop flagging rows from now on, unless the sensor is condemned."""
        if not self._condemned:
            self._suspect = [(first, len(self.times_ns) if last is None else last) for first, last in self._suspect]

    def note_configured(self) -> None:
        """Note that the chip was configured: its next reading is flagged, and may equal its last one."""
        self._set_up_again = True
        self._since_set_up = self._still_row = len(self.times_ns)
        self._written_run = 0
        self._watch_still = self.frozen_reading is not None

    def frozen_since(self) -> int | None:
        """Return the row since which the reading has been constant for too long to be chance; None otherwise. Rows that
        are already written are counted, but can no longer be flagged.
        """
        rows, needed, oldest = len(self.times_ns), self.frozen_rows, self._since_set_up
        if rows == oldest or rows - oldest + self._written_run < needed:
            return None
        reading = self._reading(rows - 1)
        for steps in (needed // 2, needed - 1):  # usually one of these readings differs
            if steps < rows - oldest and self._reading(rows - 1 - steps) != reading:
                return None
        first = rows - 1
        while first > oldest and self._reading(first - 1) == reading:
            first -= 1
        written = self._written_run if first == 0 and self._written_reading == reading else 0
        lasted_ns = self.times_ns[-1] - self.still_since_ns(first)
        is_long_enough = lasted_ns >= _FROZEN_SHARE * self._frozen_s * 1e9
        return first if rows - first + written >= needed and is_long_enough else None

    def still_since_ns(self, row: int) -> int:
        """Return when the reading that is constant from `row` on was read first."""
        continues = row == 0 and self._written_run and self._written_reading == self._reading(0)
        return self._written_since_ns if continues else self.times_ns[row]

    def note_frozen(self) -> None:
        """Note that the reading is frozen. If configuring the chip did not help, wait longer before the next attempt,
        since the signal may be quiet.
        """
        self.frozen_rows = min(2 * self.frozen_rows, _FROZEN_LONGEST) if self._watch_still else self._frozen_rows
        self.frozen_reading = self._reading(len(self.times_ns) - 1)

    def flag_frozen_rows(self) -> None:
        """Flag rows after a configuration that still repeat the frozen reading."""
        while self._watch_still and self._still_row < len(self.times_ns):
            self._watch_still = self._reading(self._still_row) == self.frozen_reading
            if self._watch_still:
                self._suspect.append((self._still_row, self._still_row + 1))
                self._still_row += 1

    @property
    def moves(self) -> bool:
        """True if a reading since the configuration differs from the frozen one."""
        return not self._watch_still and len(self.times_ns) > self._since_set_up

    def _reading(self, row: int) -> bytes:
        start, part = row * self.driver.burst, self.driver.reading
        return bytes(self._bursts[start + part.start : start + part.stop])

    def counts(self) -> npt.NDArray[Any]:
        """Return the counts of the waiting rows since the chip was configured."""
        return self.driver.decode(self._bytes(len(self.times_ns))).counts[self._since_set_up :]

    def _bytes(self, count: int) -> npt.NDArray[np.uint8]:
        size = self.driver.burst
        return np.frombuffer(bytes(self._bursts[: count * size]), np.uint8).reshape(count, size)

    def take(self, count: int, epoch_ns: int) -> Block:
        """Decode the oldest `count` rows, at least one, and remove them; `doubtful_rows` (count,) is True for rows that
        were doubtful.

        A chip that is polled more slowly than it measures overruns by design. An overrun is flagged only if every
        sample should be read, frame by frame or from its queue.
        """
        decoded = self.driver.decode(self._bytes(count))
        status = decoded.status.copy()
        if self.route.sensor.chip_rate_hz > self.rate_hz:
            status &= ~np.uint16(OVERRUN)
        for flag, rows in self._flagged.items():
            if rows and flag != _DOUBTFUL:
                status[[row for row in rows if row < count]] |= flag
        for first, last in self._suspect:
            status[first:last] |= SUSPECT
        if not self.driver.has_data_ready:
            status |= self._flag_repeated(self._bytes(count)[:, self.driver.reading])
        times = np.array(self.times_ns[:count], np.int64) - epoch_ns
        self.newest_ns = self.times_ns[count - 1]
        self.doubtful_rows = np.zeros(count, bool)
        self.doubtful_rows[[row for row in self._flagged[_DOUBTFUL] if row < count]] = True
        further = dict(decoded.compensated)
        if self._uncertainties_ns:
            further[TIME_UNCERTAINTY] = 1e-9 * np.array(self._uncertainties_ns[:count])
        self._count_run(count)
        self._forget(count)
        return Block(times, decoded.counts, status, decoded.temperature_counts, further)

    def _count_run(self, count: int) -> None:
        """Count how often the last of the oldest `count` rows, which are being written, repeats its reading."""
        oldest = min(self._since_set_up, count)
        if oldest == count:
            return
        reading, first = self._reading(count - 1), count - 1
        while first > oldest and self._reading(first - 1) == reading:
            first -= 1
        continues = first == 0 and self._written_run > 0 and reading == self._written_reading
        if not continues:
            self._written_run, self._written_since_ns = 0, self.times_ns[first]
        self._written_run += count - first
        self._written_reading = reading

    def _forget(self, count: int) -> None:
        del self.times_ns[:count], self._uncertainties_ns[:count], self._bursts[: count * self.driver.burst]
        for rows in self._flagged.values():
            rows[:] = [row - count for row in rows if row >= count]
        for check in self.checks:
            check.good_rows = max(check.good_rows - count, 0)
        self._since_set_up = max(self._since_set_up - count, 0)
        self._still_row = max(self._still_row - count, 0)
        self._suspect = [
            (max(first - count, 0), None if last is None else last - count)
            for first, last in self._suspect
            if last is None or last > count
        ]

    def _flag_repeated(self, readings: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint16]:
        """Return STALE where the bytes of a reading equal the previous ones, the only evidence in a chip without a
        data-ready bit.
        """
        previous = np.concatenate([~readings[:1] if self._last is None else self._last, readings[:-1]])
        self._last = readings[-1:]
        return np.where((readings == previous).all(axis=1), STALE, 0).astype(np.uint16)


def _frozen_s(sensor: SensorConfig) -> float:
    """Return how long a reading must stay constant before the sensor counts as frozen."""
    bandwidth_hz = sensor.chip_bandwidth_hz
    return max(_FROZEN_S, _FROZEN_BANDWIDTHS / bandwidth_hz if bandwidth_hz else 0.0)


IDLE_NS = 450_000_000
"""Time in ns after which an empty queue has stopped. With a tick of `Poll` before and after this time it is reported
within a second. For a slow chip it is the duration of `IDLE_SAMPLES` samples.
"""
IDLE_SAMPLES = 5

AHEAD_NS = 1_000_000_000
"""Time in ns by which a row may be ahead of the clock; the time of a row further ahead is wrong. The times of a
microcontroller's rows are estimated to within some milliseconds.
"""

_EARLIEST_NS = int(np.iinfo(np.int64).min)

_INHERITED = np.uint16(LOST_BEFORE | OVERRUN | RECONFIGURED)
"""Flags about the time before a row: a rejected row passes them to the next row."""


class Intake:
    """Writes rows into `log`. `on_block` receives each written block, `faults` report rejected rows, `lost` counts them
    by sensor.
    """

    def __init__(
        self,
        log: Writer,
        epoch_ns: int,
        on_block: Callable[[str, Block], None],
        faults: FaultEpisodes,
        lost: dict[str, int],
    ) -> None:
        self._log, self._epoch_ns, self._on_block, self._faults, self._lost = log, epoch_ns, on_block, faults, lost
        self._newest_ns: dict[str, int] = {}
        self._inherited: dict[str, np.uint16] = {}

    def write(self, buffer: SampleBuffer, count: int, now_ns: int) -> Block:
        """Take the oldest `count` waiting rows, and write those that are in order; return the written rows, possibly
        none.

        DiskFullError, LogError.
        """
        name = buffer.route.sensor.name
        block = buffer.take(count, self._epoch_ns)
        accepted = in_order(block.time, self._newest_ns.get(name), now_ns - self._epoch_ns + AHEAD_NS)
        if not accepted.all():
            self._refuse(name, int(np.count_nonzero(~accepted)), now_ns)
            buffer.doubtful_rows = buffer.doubtful_rows[accepted]
        block, self._inherited[name] = selected(block, accepted, self._inherited.get(name, np.uint16(0)))
        if len(block.time):
            self._newest_ns[name] = int(block.time[-1])
            self._log.append(name, block)
            self._on_block(name, block)
        return block

    def _refuse(self, name: str, count: int, now_ns: int) -> None:
        self._lost[name] += count
        text = f"{counted(count, 'reading')} refused: not later than the reading before, or ahead of the clock"
        self._faults.episode(name, "refused").happened(now_ns, text, count)


def in_order(times: Times, newest_ns: int | None, latest_ns: int) -> Booleans:
    """Return (n,) which of the `times` (n,) can be stored after `newest_ns` (None: nothing is stored yet): those that
    are at most `latest_ns` and later than all earlier ones that are stored.
    """
    possible = times <= latest_ns
    reached = np.maximum.accumulate(np.where(possible, times, _EARLIEST_NS))
    latest = np.concatenate([[_EARLIEST_NS if newest_ns is None else newest_ns], reached[:-1]])
    return np.asarray(possible & (times > np.maximum.accumulate(latest)), np.bool_)


def selected(block: Block, accepted: Booleans, inherited: np.uint16) -> tuple[Block, np.uint16]:
    """Return the rows of `block` that are `accepted` (n,), and the flags that its next row inherits.

    The first row takes over the flags `inherited` from before the block; each row takes over those of rejected rows
    just before it, and is flagged as following lost readings.
    """
    if accepted.all() and not inherited:
        return block, np.uint16(0)
    status = block.status.copy()
    for row, is_accepted in enumerate(accepted.tolist()):
        if is_accepted:
            status[row] |= inherited
            inherited = np.uint16(0)
        else:
            inherited |= (status[row] & _INHERITED) | np.uint16(LOST_BEFORE)
    return block._replace(status=status).rows(accepted), inherited
