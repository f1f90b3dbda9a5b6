"""Who is unwell, since when, and what is done about it: silence, lost configuration, frozen readings, a wrong start.

Rows about which there is doubt wait or are flagged; the sensor is looked for or set up again (`recovery`); events tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imuarray.acquire.adapter import HUNG
from imuarray.acquire.freshness import Freshness
from imuarray.acquire.pending import HELD_S, Pending
from imuarray.acquire.recovery import Recovery
from imuarray.acquire.start_up import StartUp
from imuarray.acquire.trouble import QUIET_NS, Trouble, Troubles
from imuarray.acquire.watch import Watch
from imuarray.log.format import OVERRUN
from imuarray.log.writer import Block

AWAY_NS = 250_000_000
"""A sensor that has been silent for so long is looked for instead of read, ever less often; one that holds the clock
costs everybody time, and is left alone after two frames."""
IDLE_NS = 1_000_000_000
"""A queue that gives nothing for so long has stopped."""


class _Patient:
    """What is told about one sensor, and when."""

    def __init__(self, pending: Pending, troubles: Troubles) -> None:
        self.name = pending.station.sensor.name
        self._troubles = troubles
        self.lost = troubles.of(self.name, "lost")
        self.stale = troubles.of(self.name, "stale")
        self.overrun = troubles.of(self.name, "overrun")
        self.frozen = troubles.of(self.name, "frozen")
        self.unwell: list[Trouble] = []
        self.freshness = Freshness(pending.station.sensor)
        self.last_row_ns: int | None = None
        self.rows = 0

    def tell(self, at_ns: int, kind: str, message: str) -> None:
        """Something happened to it."""
        self._troubles.of(self.name, kind).happened(at_ns, message)

    def falls_ill(self, at_ns: int, kind: str, message: str) -> None:
        """It is not well until it was set up again."""
        trouble = self._troubles.of(self.name, kind)
        trouble.begin(at_ns, message)
        self.unwell.append(trouble)  # a kernel driver that takes a chip configures it too: two at once

    def is_ill(self, kind: str) -> bool:
        """Whether it was told that it is not well in that way."""
        return self._troubles.of(self.name, kind) in self.unwell


class Care:
    """All sensors'. `lost` counts readings that never arrived, by sensor."""

    def __init__(
        self,
        pending: Sequence[Pending],
        watch: Watch,
        start_up: StartUp | None,
        troubles: Troubles,
        lost: dict[str, int],
    ) -> None:
        self._pending = pending
        self._watch = watch
        self._start_up = start_up
        self._lost = lost
        self._patients = {id(item): _Patient(item, troubles) for item in pending}

    # In a frame -----------------------------------------------------------------------------------------------------

    def lost(self, pending: Pending, at_ns: int, error: OSError | None) -> None:
        """A reading did not arrive; None: it was not even asked for, the bus hangs or its adapter was removed."""
        patient = self._patients[id(pending)]
        count = self._count(pending, at_ns)
        if error is None:
            return
        patient.lost.happened(at_ns, f"no reading: {error.strerror or error} (errno {error.errno})", count)
        if pending.silent_since_ns is None:
            pending.silent_since_ns = at_ns
        elif error.errno in HUNG or at_ns - pending.silent_since_ns >= AWAY_NS:
            pending.recovery = Recovery(pending.station, at_ns, look=True)

    def set_up_later(self, pending: Pending, at_ns: int) -> None:
        """Its adapter was removed: it may lose its supply, and is set up when the adapter is there again."""
        pending.recovery = Recovery(pending.station, at_ns, look=False)

    def step(self, pending: Pending, now_ns: int) -> OSError | None:
        """In place of a reading: a piece of the way back. What the bus said, if it failed."""
        recovery = pending.recovery
        patient = self._patients[id(pending)]
        count = self._count(pending, now_ns)
        if patient.lost.on:
            patient.lost.happened(now_ns, "", count)
        if recovery is None or recovery.waits(now_ns):
            return None
        recovery.go_on(now_ns)
        if recovery.refusal and not patient.is_ill("taken"):  # and the watch, which asks now and then, has not seen it
            patient.falls_ill(now_ns, "taken", recovery.refusal)
        if recovery.done:
            self._recovered(pending, recovery, patient, now_ns)
        return recovery.failure if isinstance(recovery.failure, OSError) else None

    def arrived(self, pending: Pending, at_ns: int) -> None:
        """The first reading after a visit that failed, before it is added: what it came too late for is lost."""
        patient = self._patients[id(pending)]
        count = self._count(pending, at_ns)
        if patient.lost.on:
            patient.lost.count += count

    def _count(self, pending: Pending, at_ns: int) -> int:
        """Readings that are now known to be lost."""
        count = pending.overdue(at_ns)
        self._lost[self._patients[id(pending)].name] += count
        pending.missing |= count > 0
        return count

    def _recovered(self, pending: Pending, recovery: Recovery, patient: _Patient, now_ns: int) -> None:
        took_s = (now_ns - recovery.since_ns) * 1e-9
        pending.recovery = None
        pending.silent_since_ns = None
        patient.last_row_ns = now_ns
        patient.lost.over(now_ns)
        for trouble in patient.unwell:
            trouble.over(now_ns, told=True)  # by what follows
        patient.unwell.clear()
        if recovery.intact:
            patient.tell(now_ns, "back", f"answers again, configured as it was, after {took_s:.2f} s")
        else:
            self._watch.give_up(pending)
            pending.trust()
            pending.begin_anew()
            patient.tell(now_ns, "reconfigured", f"set up again after {took_s:.2f} s")
            if self._start_up is not None:
                self._start_up.again(pending, now_ns)
        self._watch.restart(pending)

    def not_as_it_was(self, pending: Pending, at_ns: int, kind: str, message: str) -> None:
        """The watch found that a chip is not configured as it was, or not ours; its rows are flagged already."""
        self._patients[id(pending)].falls_ill(at_ns, kind, message)
        pending.recovery = Recovery(pending.station, at_ns, look=False)

    # Now and then ---------------------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> None:
        """Who stands still, who came up wrong, what is over."""
        for pending in self._pending:
            patient = self._patients[id(pending)]
            if pending.recovery is None:
                self._see_whether_it_moves(pending, patient, now_ns)
        if self._start_up is not None:
            self._judge(self._start_up, now_ns, last=False)

    def _see_whether_it_moves(self, pending: Pending, patient: _Patient, now_ns: int) -> None:
        if len(pending.times_ns) != patient.rows or patient.last_row_ns is None:
            patient.rows, patient.last_row_ns = len(pending.times_ns), now_ns
        pending.flag_what_is_frozen_still()
        row = pending.frozen_since()
        if row is not None:
            began_ns = pending.still_since_ns(row)
            pending.thaw()
            pending.distrust(row)
            patient.frozen.begin(now_ns, f"the same reading for {(now_ns - began_ns) * 1e-9:.2f} s")
        elif pending.queue is not None and now_ns - patient.last_row_ns > IDLE_NS:
            patient.frozen.begin(now_ns, f"nothing in its queue for {IDLE_NS * 1e-9:.0f} s")
        else:
            if patient.frozen.lasts and pending.moves:
                patient.frozen.over(now_ns, told=True)  # by the event that it was set up again
            return
        pending.recovery = Recovery(pending.station, now_ns, look=False)

    def _judge(self, start_up: StartUp, now_ns: int, *, last: bool) -> None:
        for pending, verdict in start_up.verdicts(now_ns, last=last):
            if verdict.text:
                self._patients[id(pending)].tell(now_ns, "start_up", verdict.text)
            if not verdict.fault:
                continue
            pending.distrust(0)
            if start_up.hopeless(pending):
                pending.condemned = True
            elif not last:
                pending.recovery = Recovery(pending.station, now_ns, look=False)

    def finish(self, now_ns: int) -> None:
        """The log ends: judge what there is."""
        for pending in self._pending:
            pending.flag_what_is_frozen_still()
            if pending.recovery is None and (row := pending.frozen_since()) is not None:
                pending.distrust(row)
                self._patients[id(pending)].tell(now_ns, "frozen", "the same reading until the end")
        if self._start_up is not None:
            self._judge(self._start_up, now_ns, last=True)

    # Writing --------------------------------------------------------------------------------------------------------

    def trusted_rows(self, pending: Pending, now_ns: int) -> int:
        """How many of the waiting rows can be written: later checks found the chip as configured, and later readings
        that it doesn't stand still.
        """
        if self._start_up is not None and self._start_up.holds(pending):
            return 0
        rows = len(pending.times_ns)
        if pending.recovery is not None and now_ns - pending.recovery.since_ns > HELD_S * 1e9:
            self._watch.give_up(pending)
            return rows
        held = pending.held_rows
        if rows - self._watch.trusted_rows(pending) > max(HELD_S * pending.row_rate_hz, held):
            self._watch.give_up(pending)
        return min(self._watch.trusted_rows(pending), rows - held)

    def written(self, pending: Pending, block: Block, epoch_ns: int) -> None:
        """Tell of what only the decoded status shows."""
        patient = self._patients[id(pending)]
        patient.rows -= len(block.time)
        if pending.queue is None and pending.driver.tells_fresh:
            late = patient.freshness.overdue(block.time, block.status, pending.doubtful_rows)
            if late.any():
                _tell_at(block.time[late] + epoch_ns, patient.stale, "no new reading, though it must have one by then")
        if (block.status & OVERRUN).any():
            overrun = block.time[(block.status & OVERRUN) != 0] + epoch_ns
            _tell_at(overrun, patient.overrun, "samples passed unread: the chip had nowhere to keep them")


def _tell_at(times_ns: npt.NDArray[np.int64], trouble: Trouble, message: str) -> None:
    """One trouble at all these times, or several if it was over in between."""
    for part in np.split(times_ns, np.flatnonzero(np.diff(times_ns) > QUIET_NS) + 1):
        if len(part):
            trouble.settle(int(part[0]))
            trouble.happened(int(part[0]), message, len(part), int(part[-1]))
