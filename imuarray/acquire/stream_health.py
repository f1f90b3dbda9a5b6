"""The health of the chips of a streamed array: registers read back in turn, frozen readings, start-up states.

The microcontroller reads the registers in its lists; two wrong reads in a row count. A chip that is `ill` is configured
again while the stream is stopped.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from imuarray.acquire.sample_buffer import HELD_S
from imuarray.acquire.start_up import StartUpCheck
from imuarray.acquire.stream_plan import ReadbackPlace, Rows, readings_at
from imuarray.bus.serial_bus import Samples
from imuarray.errors import SensorError

Note = Callable[[Rows, str, str], None]
"""(whose, kind, message)."""


@dataclass
class _Check:
    """One register of one chip."""

    watched: ReadbackPlace
    good_rows: int = 0
    """Rows that waited when this register was last right."""
    wrong: int = 0


class StreamHealth:
    """The health of all sensors. `ill` are those that must be configured again."""

    def __init__(
        self, rows: Sequence[Rows], watched: Sequence[ReadbackPlace], start_up: StartUpCheck | None, note: Note
    ) -> None:
        self.ill: dict[int, Rows] = {}
        self._rows = rows
        self._start_up = start_up
        self._note = note
        self._checks = {
            id(item): [_Check(place) for place in watched if place.route is item.buffer.route] for item in rows
        }

    def look(self, samples_by_list: Mapping[int, Samples], rate: float) -> None:
        """Check the registers that were read back."""
        for rows in self._rows:
            for check in self._checks[id(rows)]:
                place = check.watched.place
                if place.number in samples_by_list:
                    values = readings_at(place, samples_by_list[place.number], rate)
                    for time_ns, part in zip(values.times_ns.tolist(), values.parts.tolist(), strict=True):
                        self._judge(rows, check, part[0], bisect_left(rows.buffer.times_ns, time_ns))

    def _judge(self, rows: Rows, check: _Check, value: int, before: int) -> None:
        """Judge one value of one register that was read after `before` of the waiting rows; two wrong values in a row
        count.
        """
        setting = check.watched.setting
        if value & setting.mask == setting.value:
            check.wrong, check.good_rows = 0, before
            return
        check.wrong += 1
        if check.wrong != 2:
            return
        rows.buffer.distrust(check.good_rows)
        if id(rows) not in self.ill:
            self.ill[id(rows)] = rows
            address, wanted = setting.register.address, setting.into(value)
            self._note(rows, "configuration", f"register {address:#04x} reads {value:#04x}, configured {wanted:#04x}")

    def doubt_queue(self, rows: Rows) -> None:
        """Have the chip configured again, because the bytes from its queue are not a sequence of samples."""
        if id(rows) not in self.ill:
            self.ill[id(rows)] = rows
            self._note(rows, "configuration", rows.doubt)

    def note_idle(self, rows: Rows) -> None:
        """Have the chip configured again, because its queue does not fill."""
        if id(rows) not in self.ill:
            self.ill[id(rows)] = rows
            rows.buffer.distrust(self._vouched(rows))
            self._note(rows, "frozen", f"nothing in its queue for {rows.idle_ns * 1e-9:.1f} s")

    def tick(self, now_ns: int) -> None:
        """Look for frozen sensors and wrong start-up states."""
        for rows in self._rows:
            row = rows.buffer.frozen_since()
            if row is not None and id(rows) not in self.ill:
                lasted_s = (rows.buffer.times_ns[-1] - rows.buffer.still_since_ns(row)) * 1e-9
                rows.buffer.thaw()
                rows.buffer.distrust(row)
                self.ill[id(rows)] = rows
                self._note(rows, "frozen", f"the same reading for {lasted_s:.2f} s")
        if self._start_up is not None:
            self._judge_start(self._start_up, now_ns, last=False)

    def _judge_start(self, start_up: StartUpCheck, now_ns: int, *, last: bool) -> None:
        whose = {id(rows.buffer): rows for rows in self._rows}
        for buffer, verdict in start_up.verdicts(now_ns, last=last):
            rows = whose[id(buffer)]
            if verdict.text:
                self._note(rows, "start_up", verdict.text)
            if verdict.fault:
                buffer.distrust(0)
                if start_up.hopeless(buffer):
                    buffer.condemn()
                else:
                    self.ill[id(rows)] = rows

    def set_up_again(self, now_ns: int) -> None:
        """Configure the failed sensors while the stream is stopped; one that can't be configured remains failed."""
        for key, rows in list(self.ill.items()):
            try:
                rows.buffer.driver.identify()
                rows.buffer.driver.configure()
            except (OSError, SensorError) as error:
                self._note(rows, "configuration", f"can't be set up again: {error}")
                continue
            del self.ill[key]
            rows.buffer.trust()
            rows.buffer.begin_anew()
            for check in self._checks[id(rows)]:
                check.wrong, check.good_rows = 0, len(rows.buffer.times_ns)
            self._note(rows, "reconfigured", "set up again")
            if self._start_up is not None:
                self._start_up.again(rows.buffer, now_ns)

    def doubt_everything(self) -> None:
        """Mark all chips as ill, and their rows since the last verification as suspect, because they may have lost
        their supply.
        """
        for rows in self._rows:
            rows.buffer.distrust(self._vouched(rows))
            self.ill[id(rows)] = rows

    def trusted_rows(self, rows: Rows) -> int:
        """Return how many of the waiting rows can be written; rows that nothing verified within `HELD_S` are written as
        suspect.
        """
        if self._start_up is not None and self._start_up.holds(rows.buffer):
            return 0
        buffer = rows.buffer
        waiting, held = len(buffer.times_ns), buffer.held_rows
        if id(rows) in self.ill:  # flagged already
            return waiting
        vouched = self._vouched(rows)
        if waiting - vouched > max(HELD_S * buffer.row_rate_hz, held):
            buffer.flag_suspect(vouched, waiting)
            for check in self._checks[id(rows)]:
                check.good_rows = waiting
        return max(0, min(self._vouched(rows), waiting - held))

    def _vouched(self, rows: Rows) -> int:
        """Return the number of rows that were followed by a successful check of every register."""
        return min((check.good_rows for check in self._checks[id(rows)]), default=len(rows.buffer.times_ns))

    def written(self, rows: Rows, count: int) -> None:
        """Note that the oldest `count` rows were written."""
        for check in self._checks[id(rows)]:
            check.good_rows = max(check.good_rows - count, 0)

    def finish(self, now_ns: int) -> None:
        """At the end of the log, after the stream was stopped, read every register back twice, and flag the rows that
        remain unverified.
        """
        if self._start_up is not None:
            self._judge_start(self._start_up, now_ns, last=True)
        for rows in self._rows:
            waiting = len(rows.buffer.times_ns)
            for check in self._checks[id(rows)]:
                setting, registers = check.watched.setting, rows.buffer.driver.registers
                try:
                    values = [registers.read_back(setting.register) for _ in range(2)]
                except OSError:
                    continue
                if any(value & setting.mask == setting.value for value in values):
                    check.good_rows = waiting
            first = self._vouched(rows)
            frozen = rows.buffer.frozen_since()
            if frozen is not None:
                self._note(rows, "frozen", "the same reading until the end")
                first = min(first, frozen)
            if first < waiting:
                rows.buffer.distrust(first)
