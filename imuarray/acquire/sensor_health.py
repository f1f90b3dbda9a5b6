"""The health of polled sensors: silence, lost configuration, frozen readings, a wrong start-up state, and the response
to each.

Doubtful rows wait or are flagged; the sensor is searched for or configured again (`SensorRecovery`); events
report it.

`Freshness` decides whether a chip must have had a new reading. A chip's data-ready flag shows whether it has a new
reading since the last read. Two reads may follow each other closely (a late frame, a burst of frames after a stall); an
old reading is then normal. It is an error if more time has passed since the last new reading than the chip needs for
one at the slow end of its oscillator. Chips without such a flag can't be tested in this way, because two equal readings
may be chance; `SampleBuffer.frozen_since` tests them.

The rows of the first seconds wait until a `Judge`, which knows the start-up states, has given a verdict. Some chips
start with a different bias each time (the paper's Gyro3 has two), or in another range, and do not report it. The states
of a sensor are in its calibration, which this package does not read; the judge does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.acquire.bus_segment import HUNG, SLACK_NS, ConfigurationReadback
from imuarray.acquire.fault_episode import QUIET_NS, FaultEpisode, FaultEpisodes
from imuarray.acquire.sample_buffer import HELD_S, SampleBuffer, SensorRecovery
from imuarray.array import SensorConfig
from imuarray.arrays import Booleans, Times
from imuarray.drivers import Driver
from imuarray.drivers.fifo_clock import TOLERANCE
from imuarray.drivers.six_axis_queue import QueueReader
from imuarray.log.format import LOST_BEFORE, OVERRUN, RECONFIGURED, STALE, SUSPECT
from imuarray.log.health import StartVerdict
from imuarray.log.writer import Block

SECONDS = 10.0
FEWEST_READINGS = 10
"""Least number of readings for a verdict; the mean of fewer is so noisy that it could look like another state."""
ATTEMPTS = 3
"""Largest number of attempts to configure a sensor that started wrong; after them, none of its readings are trusted."""


Judge = Callable[[Mapping[str, npt.NDArray[Any]]], Mapping[str, StartVerdict]]
"""Function from the counts (n, 3) of the sensors' first seconds to verdicts by name; a sensor that can't be judged has
no verdict.
"""


class StartUpCheck:
    """The sensors whose start-up state is not judged yet."""

    def __init__(self, buffers: Sequence[SampleBuffer], judge: Judge, now_ns: int) -> None:
        self._judge = judge
        self._since_ns = {id(item): now_ns for item in buffers if item.route.sensor.sensitivity}
        self._attempts: dict[int, int] = {}
        self._buffers = [item for item in buffers if id(item) in self._since_ns]

    def holds(self, buffer: SampleBuffer) -> bool:
        """Return whether the rows of this sensor must wait."""
        return id(buffer) in self._since_ns

    def judge_again(self, buffer: SampleBuffer, now_ns: int) -> None:
        """Judge a sensor again after it was configured again because of a wrong start-up state."""
        if id(buffer) in self._attempts:
            self._since_ns[id(buffer)] = now_ns

    def verdicts(self, now_ns: int, *, last: bool = False) -> list[tuple[SampleBuffer, StartVerdict]]:
        """Return the verdicts on sensors whose first seconds are over (or all, at the end of the log, `last`)."""
        due = [
            item
            for item in self._buffers
            if self.holds(item)
            and (last or now_ns - self._since_ns[id(item)] >= SECONDS * 1e9)
            and (last or item.recovery is None)
        ]
        counts_by_name = {item.route.sensor.name: item.counts() for item in due if item.times_ns}
        readings = {name: counts for name, counts in counts_by_name.items() if len(counts) >= FEWEST_READINGS}
        verdicts = dict(self._judge(readings)) if readings else {}
        for name in counts_by_name.keys() - readings.keys():
            verdicts[name] = StartVerdict(
                False, f"not checked: {len(counts_by_name[name])} readings of at least {FEWEST_READINGS}"
            )
        results = [(item, verdicts.get(item.route.sensor.name, StartVerdict(False))) for item in due]
        for item, verdict in results:
            del self._since_ns[id(item)]
            if verdict.fault:
                self._attempts[id(item)] = self._attempts.get(id(item), 0) + 1
        return results

    def judge(
        self,
        now_ns: int,
        report: Callable[[SampleBuffer, str], None],
        configure: Callable[[SampleBuffer], object],
        *,
        last: bool = False,
    ) -> None:
        """Report the verdicts that are due, flag the rows of sensors that started wrong, and `configure` these sensors
        again, unless all attempts are used up or the log ends (`last`).
        """
        for buffer, verdict in self.verdicts(now_ns, last=last):
            if verdict.text:
                report(buffer, verdict.text)
            if verdict.fault:
                buffer.distrust(0)
                if self._attempts[id(buffer)] >= ATTEMPTS:
                    buffer.condemn()
                elif not last:
                    configure(buffer)


_UNRELATED = LOST_BEFORE | RECONFIGURED | SUSPECT
"""Flags of rows before which another read may have occurred, or the chip was not as configured."""


class Freshness:
    """Checks that one sensor has new readings as often as it must, block after block."""

    def __init__(self, sensor: SensorConfig) -> None:
        self.longest_ns = round(1e9 / (sensor.chip_rate_hz * (1 - TOLERANCE))) + 2 * SLACK_NS
        self._fetched_ns: int | None = None

    def overdue(self, times_ns: Times, status: npt.NDArray[np.uint16], doubtful: Booleans) -> Booleans:
        """Return (n,) True for rows that are stale although the chip must have had a new reading.

        `times_ns` (n,) are the times of the reads, `status` (n,) their flags; `doubtful` (n,) marks reads whose time is
        uncertain, or before which another read may have taken the new reading. Such a read is not judged, nor is the
        time since the previous one.
        """
        unrelated = doubtful | ((status & _UNRELATED) != 0)
        stale = (status & STALE) != 0
        late = np.zeros(len(times_ns), bool)
        if len(late) and not stale.any():
            self._fetched_ns = None if unrelated[-1] else int(times_ns[-1])
            return late
        for row, (at_ns, is_stale, is_unrelated) in enumerate(
            zip(times_ns.tolist(), stale.tolist(), unrelated.tolist(), strict=True)
        ):
            if is_unrelated:
                self._fetched_ns = None
            elif not is_stale or self._fetched_ns is None:
                self._fetched_ns = at_ns
            else:
                late[row] = at_ns - self._fetched_ns > self.longest_ns
        return late


AWAY_NS = 250_000_000
"""Duration of silence in ns after which a sensor is searched for at growing intervals instead of read. A sensor that
holds the clock delays all others, and is no longer read after two frames.
"""


class _SensorState:
    """The fault episodes of one sensor."""

    def __init__(self, buffer: SampleBuffer, faults: FaultEpisodes) -> None:
        self.name = buffer.route.sensor.name
        self._faults = faults
        self.lost = faults.episode(self.name, "lost")
        self.stale = faults.episode(self.name, "stale")
        self.overrun = faults.episode(self.name, "overrun")
        self.frozen = faults.episode(self.name, "frozen")
        self.open_faults: list[FaultEpisode] = []
        self.freshness = Freshness(buffer.route.sensor)
        self.last_row_ns: int | None = None
        self.rows = 0
        self.overruns = 0

    def report(self, at_ns: int, kind: str, message: str) -> None:
        self._faults.episode(self.name, kind).happened(at_ns, message)

    def begin_fault(self, at_ns: int, kind: str, message: str) -> None:
        episode = self._faults.episode(self.name, kind)
        episode.begin(at_ns, message)
        self.open_faults.append(episode)  # there may be several: a kernel driver that takes a chip also configures it

    def has_fault(self, kind: str) -> bool:
        return self._faults.episode(self.name, kind) in self.open_faults


class SensorHealth:
    """The health of all sensors. `lost` counts readings that did not arrive, by sensor."""

    def __init__(
        self,
        buffers: Sequence[SampleBuffer],
        readback: ConfigurationReadback,
        start_up: StartUpCheck | None,
        faults: FaultEpisodes,
        lost: dict[str, int],
    ) -> None:
        self._buffers = buffers
        self._readback = readback
        self._start_up = start_up
        self._lost = lost
        self._states = {id(item): _SensorState(item, faults) for item in buffers}

    # In a frame -----------------------------------------------------------------------------------------------------

    def lost(self, buffer: SampleBuffer, at_ns: int, error: OSError | None) -> None:
        """Note that a reading did not arrive; `error` is None if it was not requested because the bus hangs or its
        adapter is removed.
        """
        state = self._states[id(buffer)]
        count = self._count(buffer, at_ns)
        if error is None:
            return
        state.lost.happened(at_ns, f"no reading: {error.strerror or error} (errno {error.errno})", count)
        was_silent = buffer.is_silent
        silent_ns = buffer.note_silence(at_ns)
        if was_silent and (error.errno in HUNG or silent_ns >= AWAY_NS):
            buffer.recover(at_ns, compare=True)

    def configure_later(self, buffer: SampleBuffer, at_ns: int) -> None:
        """Configure a sensor once its removed adapter is back, since it may have lost its supply."""
        buffer.recover(at_ns, compare=False)

    def step(self, buffer: SampleBuffer, now_ns: int) -> OSError | None:
        """Do one step of a recovery in place of a reading; return the error of the bus, if there is one."""
        recovery = buffer.recovery
        state = self._states[id(buffer)]
        count = self._count(buffer, now_ns)
        if state.lost.is_open:
            state.lost.happened(now_ns, "", count)
        if recovery is None or recovery.waits(now_ns):
            return None
        recovery.step(now_ns)
        if recovery.refusal and not state.has_fault("taken"):  # not yet reported by the read-back of the configuration
            state.begin_fault(now_ns, "taken", recovery.refusal)
        if recovery.is_done:
            self._end_recovery(buffer, recovery, state, now_ns)
        return recovery.failure if isinstance(recovery.failure, OSError) else None

    def note_arrival(self, buffer: SampleBuffer, at_ns: int) -> None:
        """Count the lost readings, at the first reading after a failed visit and before it is added."""
        state = self._states[id(buffer)]
        count = self._count(buffer, at_ns)
        if state.lost.is_open:
            state.lost.count += count

    def _count(self, buffer: SampleBuffer, at_ns: int) -> int:
        count = buffer.overdue(at_ns)
        self._lost[self._states[id(buffer)].name] += count
        if count:
            buffer.mark_lost()
        return count

    def _end_recovery(self, buffer: SampleBuffer, recovery: SensorRecovery, state: _SensorState, now_ns: int) -> None:
        took_s = (now_ns - recovery.since_ns) * 1e-9
        buffer.end_recovery()
        state.last_row_ns = now_ns
        state.lost.end(now_ns)
        for episode in state.open_faults:
            episode.end(now_ns, reported=True)  # by the event below
        state.open_faults.clear()
        if recovery.is_intact:
            state.report(now_ns, "back", f"answers again with its configuration intact, after {took_s:.2f} s")
        else:
            self._readback.give_up(buffer)
            buffer.trust()
            buffer.note_configured()
            state.report(now_ns, "reconfigured", f"set up again after {took_s:.2f} s")
            if self._start_up is not None:
                self._start_up.judge_again(buffer, now_ns)
        buffer.note_verified()

    def note_lost_configuration(self, buffer: SampleBuffer, at_ns: int, kind: str, message: str) -> None:
        """Handle a chip that has lost its configuration or its address; its rows are already flagged."""
        self._states[id(buffer)].begin_fault(at_ns, kind, message)
        buffer.recover(at_ns, compare=False)

    # At each tick ---------------------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> None:
        """Look for frozen sensors and wrong start-up states."""
        for buffer in self._buffers:
            state = self._states[id(buffer)]
            if buffer.recovery is None:
                self._check_frozen(buffer, state, now_ns)
        self._judge(now_ns)

    def _check_frozen(self, buffer: SampleBuffer, state: _SensorState, now_ns: int) -> None:
        if len(buffer.times_ns) != state.rows or state.last_row_ns is None:
            state.rows, state.last_row_ns = len(buffer.times_ns), now_ns
            if isinstance(buffer.queue, QueueReader):
                state.overruns = buffer.queue.overruns
        buffer.flag_frozen_rows()
        row = buffer.frozen_since()
        if row is not None:
            began_ns = buffer.still_since_ns(row)
            buffer.note_frozen()
            buffer.distrust(row)
            state.frozen.begin(now_ns, f"the same reading for {(now_ns - began_ns) * 1e-9:.2f} s")
        elif buffer.queue is not None and now_ns - state.last_row_ns > buffer.idle_ns:
            overruns = buffer.queue.overruns if isinstance(buffer.queue, QueueReader) else 0
            if overruns > state.overruns:  # the chip measures, but its queue overflows
                state.overruns = overruns
                state.overrun.happened(now_ns, "its queue runs over between two frames: raise the frame rate")
                return
            idle_s = (now_ns - state.last_row_ns) * 1e-9
            state.frozen.begin(now_ns, f"nothing in its queue for {idle_s:.1f} s{_lost_setting(buffer.driver)}")
        else:
            if state.frozen.lasts and buffer.moves:
                state.frozen.end(now_ns, reported=True)  # by the event "reconfigured"
            return
        buffer.recover(now_ns, compare=False)

    def _judge(self, now_ns: int, *, last: bool = False) -> None:
        if self._start_up is not None:
            self._start_up.judge(
                now_ns,
                lambda buffer, text: self._states[id(buffer)].report(now_ns, "start_up", text),
                lambda buffer: buffer.recover(now_ns, compare=False),
                last=last,
            )

    def finish(self, now_ns: int) -> None:
        """Judge the remaining rows at the end of the log."""
        for buffer in self._buffers:
            buffer.flag_frozen_rows()
            if buffer.recovery is None and (row := buffer.frozen_since()) is not None:
                buffer.distrust(row)
                self._states[id(buffer)].report(now_ns, "frozen", "the same reading until the end")
        self._judge(now_ns, last=True)

    # Writing --------------------------------------------------------------------------------------------------------

    def trusted_rows(self, buffer: SampleBuffer, now_ns: int) -> int:
        """Return how many of the waiting rows can be written: later checks confirmed the configuration, and later
        readings showed that the sensor is not frozen; after `HELD_S` without that, all can.
        """
        if self._start_up is not None and self._start_up.holds(buffer):
            return 0
        rows = len(buffer.times_ns)
        if buffer.recovery is not None and now_ns - buffer.recovery.since_ns > HELD_S * 1e9:
            self._readback.give_up(buffer)
            return rows
        held_rows = buffer.held_rows
        if rows - buffer.verified_rows > max(HELD_S * buffer.row_rate_hz, held_rows):
            self._readback.give_up(buffer)
        return min(buffer.verified_rows, rows - held_rows)

    def note_written(self, buffer: SampleBuffer, block: Block, epoch_ns: int) -> None:
        """Report stale readings and overruns, which only the decoded status shows."""
        state = self._states[id(buffer)]
        state.rows -= len(block.time)
        if buffer.queue is None and buffer.driver.has_data_ready:
            late = state.freshness.overdue(block.time, block.status, buffer.doubtful_rows)
            if late.any():
                _report_at(block.time[late] + epoch_ns, state.stale, "no new reading although one was due")
        if (block.status & OVERRUN).any():
            overrun = block.time[(block.status & OVERRUN) != 0] + epoch_ns
            cause = (
                "they were overwritten before they were read" if buffer.queue is None else "the chip's buffer was full"
            )
            _report_at(overrun, state.overrun, f"samples were lost: {cause}")


def _lost_setting(driver: Driver) -> str:
    """Return a clause that names the first register that is not as configured; "" if none or if the chip is silent."""
    with suppress(OSError):
        for setting in driver.watched:
            value = driver.registers.read_back(setting.register)
            if value & setting.mask != setting.value:
                return f": {setting.mismatch(value)}"
    return ""


def _report_at(times_ns: Times, episode: FaultEpisode, message: str) -> None:
    """Note occurrences at all these times, as several episodes if there are long gaps."""
    for part in np.split(times_ns, np.flatnonzero(np.diff(times_ns) > QUIET_NS) + 1):
        if len(part):
            episode.settle(int(part[0]))
            episode.happened(int(part[0]), message, len(part), int(part[-1]))
