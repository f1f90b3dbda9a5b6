"""Reads the configuration registers of all chips back, a few per frame in turn; two wrong reads in a row count.

A chip that a supply glitch has reset goes on measuring with its default settings and does not report it (the paper's
BMA1, run 10). Each register is read at least once in `SWEEP_S`, so that a reset is noticed within a second; the rows
since the last good check are flagged, and an event says what was read. The bit that keeps the two bytes of a reading
together is one of the settings. A check uses the bus segment that is selected anyway: it costs one read, never a
switch. Registers that also identify the connected channel (`imuarray.acquire.bus_segment`) are read there and take no
turn here. Once a sweep the kernel is asked whether one of its drivers has claimed the address.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.acquire.sensor_routes import Witness
from imuarray.errors import SensorError
from imuarray.facts.registers import Setting

SWEEP_S = 0.85
"""Longest time between two reads of the same register; a wrong one is read again in the next frame."""


def frames_of(rate_hz: float) -> int:
    """Frames in a sweep, at least one."""
    return max(1, math.floor(SWEEP_S * rate_hz))


@dataclass
class _Check:
    """One register of one chip; without a `setting`, whose its address is."""

    buffer: SampleBuffer
    setting: Setting | None
    good_rows: int = 0
    """Rows that were waiting when this register was last right."""
    wrong: int = 0
    """Wrong reads in a row."""


class ConfigurationReadback:
    """The checks of all routes, and whose turn it is."""

    def __init__(
        self,
        buffers: Sequence[SampleBuffer],
        rate_hz: float,
        report: Callable[[SampleBuffer, str, str], None],
        witnesses: Iterable[Witness] = (),
    ) -> None:
        """`buffers` in visiting order; `report` (sensor, kind of event, message) is told when a chip has lost its
        configuration or its address; the registers of `witnesses` are read by others, who say what they saw.
        """
        self._checks = [_Check(item, setting) for item in buffers for setting in (*item.driver.watched, None)]
        self._of = {id(item): [check for check in self._checks if check.buffer is item] for item in buffers}
        self._by_setting = {
            (id(check.buffer.route), check.setting): check for check in self._checks if check.setting is not None
        }
        elsewhere = {(id(witness.route), witness.setting) for witness in witnesses}
        self._in_turn = [check for check in self._checks if (id(check.buffer.route), check.setting) not in elsewhere]
        self._report = report
        self._next = 0
        reads = sum(check.setting is not None for check in self._in_turn)
        self.per_frame = math.ceil(reads / frames_of(rate_hz))

    def due(self) -> list[_Check]:
        """This frame's checks: those that were wrong last time first, then the next in turn."""
        again = [check for check in self._checks if check.wrong == 1 and check.buffer.recovery is None]
        turn: list[_Check] = []
        reads, index, count = 0, self._next, len(self._in_turn)
        for _ in range(count):
            check = self._in_turn[index]
            if check.setting is not None and reads == self.per_frame:
                break
            reads += check.setting is not None
            index = (index + 1) % count
            if check.wrong != 1 and check.buffer.recovery is None:
                turn.append(check)
        self._next = index
        return again + turn

    def saw(self, witness: Witness) -> None:
        """Note that this register was read elsewhere, and is right."""
        check = self._by_setting[id(witness.route), witness.setting]
        check.wrong = 0
        check.good_rows = len(check.buffer.times_ns)

    def doubts(self, witness: Witness) -> None:
        """Note that this register was read elsewhere, and is not as configured."""
        check = self._by_setting[id(witness.route), witness.setting]
        check.wrong = max(check.wrong, 1)

    def run(self, check: _Check) -> None:
        """Read one register back; a bus that fails says nothing about it."""
        if check.setting is None:
            self._ask(check)
            return
        registers = check.buffer.driver.registers
        try:
            value = registers.read_back(check.setting.register)
        except OSError:
            return
        if value & check.setting.mask == check.setting.value:
            check.wrong = 0
            check.good_rows = len(check.buffer.times_ns)
        else:
            address, wanted = check.setting.register.address, check.setting.into(value)
            text = f"register {address:#04x} reads {value:#04x}, configured {wanted:#04x}"
            self._wrong(check, "configuration", text)

    def _ask(self, check: _Check) -> None:
        """Ask the kernel who owns the address. One answer is enough."""
        try:
            check.buffer.route.claim()
        except SensorError as error:
            check.wrong = 1
            self._wrong(check, "taken", str(error))
            return
        except OSError:
            return
        check.wrong = 0
        check.good_rows = len(check.buffer.times_ns)

    def _wrong(self, check: _Check, kind: str, message: str) -> None:
        check.wrong += 1
        if check.wrong == 2:
            check.buffer.distrust(check.good_rows)
            self._report(check.buffer, kind, message)

    def restart(self, buffer: SampleBuffer) -> None:
        """Note that all registers of a chip are right: they were just read, or configured."""
        for check in self._of[id(buffer)]:
            check.wrong = 0
            check.good_rows = len(buffer.times_ns)

    def finish(self) -> None:
        """Check everything once more (twice where it is wrong), and flag what can't be: no row stays in doubt."""
        for check in self._checks:
            if check.buffer.recovery is None:
                self.run(check)
                if check.wrong == 1:
                    self.run(check)
        for checks in self._of.values():
            self.give_up(checks[0].buffer)

    def give_up(self, buffer: SampleBuffer) -> None:
        """Flag the waiting rows that no check has verified."""
        trusted = self.trusted_rows(buffer)
        if trusted < len(buffer.times_ns):
            buffer.flag_suspect(trusted, len(buffer.times_ns))
            self.restart(buffer)

    def trusted_rows(self, buffer: SampleBuffer) -> int:
        """Return how many waiting rows were followed by a successful check of every register."""
        return min(check.good_rows for check in self._of[id(buffer)])

    def taken(self, buffer: SampleBuffer, count: int) -> None:
        """Note that the oldest `count` rows were written."""
        for check in self._of[id(buffer)]:
            check.good_rows = max(check.good_rows - count, 0)
