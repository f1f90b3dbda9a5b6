"""Parts that fail at given times: a chip, a sensing element.

Instants are in ns since power-on. A fault takes effect on a chip when the chip is next addressed, as of the instant at
which it was due.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from firmware_emulator.chip import Chip, Element, Target, TargetProxy, Triple
from firmware_emulator.chips import HALVES
from imuarray.facts import bma180, l3g4200d


@dataclass(frozen=True)
class Times:
    """The times of a fault: from `begin_ns` on for `length_ns`, and again every `period_ns` (0: once), `count` times
    (0: without end).
    """

    begin_ns: int
    length_ns: int
    period_ns: int = 0
    count: int = 0

    def begun(self, at_ns: int) -> int:
        """Return the number of times that it has begun by then."""
        if at_ns < self.begin_ns:
            return 0
        number = (at_ns - self.begin_ns) // self.period_ns + 1 if self.period_ns else 1
        return min(number, self.count) if self.count else number

    def start_ns(self, number: int) -> int:
        """Return when occurrence `number`, counted from 1, begins."""
        return self.begin_ns + (number - 1) * self.period_ns

    def during(self, at_ns: int) -> bool:
        """Return whether it is active at that time."""
        number = self.begun(at_ns)
        return number > 0 and at_ns - self.start_ns(number) < self.length_ns

    def ended(self, at_ns: int) -> int:
        """Return the number of times that it has ended by then."""
        return self.begun(at_ns - self.length_ns)


class ReadyLayout(NamedTuple):
    """The location of a chip's triad of `length` bytes (9 for axes of 20 bits), and the bits, in a register or in bytes
    of the triad, that mark it as new.
    """

    first: int
    ready: int
    ready_mask: int
    inside: tuple[int, ...] = ()
    length: int = 6


LAYOUTS = MappingProxyType(
    {
        "adxl345": ReadyLayout(0x32, 0x30, 0x80),  # ADX-27, ADX-50
        "bma180": ReadyLayout(0x02, -1, 0, (0, 2, 4)),  # BMA-12, BMA-62
        "l3g4200d": ReadyLayout(0x28, 0x27, 0x0F),  # L3G-44, L3G-52
        **{chip: ReadyLayout(half.first.address, -1, 0) for chip, half in HALVES.items()},
        "hmc5883": ReadyLayout(0x03, -1, 0),  # HMC-15
        "hmc5883l": ReadyLayout(0x03, -1, 0),
        "mmc5983": ReadyLayout(0x00, -1, 0),  # MMC-11
        "ak8963": ReadyLayout(0x03, 0x02, 0x01),  # AKM-11, AKM-12
        "ak8975": ReadyLayout(0x03, 0x02, 0x01),  # AKM-22, AKM-23
        "lis3mdl": ReadyLayout(0x28, 0x27, 0x0F),  # LIS-12, LIS-14
    }
)


@dataclass
class ChipFault:
    """One fault of one chip: `action` is a key of `firmware_emulator.faults.CHIP_FAULTS`.

    With `until_set_up` it ends when the chip is next written to. `bias` is that of a start-up fault.
    """

    action: str
    times: Times
    until_set_up: bool = False
    bias: Triple = (0.0, 0.0, 0.0)
    done: int = 0
    cured: int = 0
    held: bytes = b""

    def active(self, at_ns: int) -> bool:
        """Return whether it is active and has not been ended by a set-up."""
        return self.times.during(at_ns) and self.times.begun(at_ns) > self.cured


class FaultyDevice(TargetProxy):
    """A chip of that `kind` with its faults. It replaces `device`, which is the chip or a device in front of it."""

    def __init__(
        self, device: Target, chip: Chip, kind: str, faults: Sequence[ChipFault], powered_on_ns: int = 0
    ) -> None:
        super().__init__(device)
        self._chip, self._kind = chip, kind
        self._faults = faults
        self._powered_on_ns = powered_on_ns
        self._pointer = 0

    def hangs(self, at_ns: int) -> bool:
        """Return whether it holds the clock without end when it is addressed."""
        return any(fault.action == "hangs" and fault.active(at_ns - self._powered_on_ns) for fault in self._faults)

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Carry out the faults that are due, then write to the device, unless it does not answer or is unplugged."""
        since_ns = at_ns - self._powered_on_ns
        for fault in self._faults:
            self._catch_up(fault, since_ns)
            if fault.action in ("silent", "unplugged") and fault.active(since_ns):
                return 0 if data else -1
            if len(data) > 1 and fault.until_set_up and fault.active(since_ns):
                fault.cured = fault.times.begun(since_ns)
        if data:
            self._pointer = data[0] & 0x7F
        return super().write(data, at_ns, byte_ns)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read the device; while a fault freezes the triad, its last value is returned."""
        sent = super().read(count, at_ns, byte_ns)
        since_ns = at_ns - self._powered_on_ns
        for fault in self._faults:
            if fault.action in ("frozen", "stale"):
                sent = self._standing(fault, sent, since_ns)
        return sent

    def _catch_up(self, fault: ChipFault, since_ns: int) -> None:
        plugged_in = fault.action == "unplugged"
        number = fault.times.ended(since_ns) if plugged_in else fault.times.begun(since_ns)
        if number <= fault.done or fault.action not in ("unplugged", "reset", "torn"):
            return
        fault.done = number
        when_ns = self._powered_on_ns + fault.times.start_ns(number) + plugged_in * fault.times.length_ns
        if fault.action == "torn":
            TEARS[self._kind](self._chip, when_ns)
        else:
            self._chip.power_on(when_ns)

    def _standing(self, fault: ChipFault, sent: bytes, since_ns: int) -> bytes:
        if not fault.active(since_ns):
            fault.held = b""
            return sent
        layout, fresh = LAYOUTS[self._kind], fault.action == "frozen"
        shown = bytearray(sent)
        ready, triad = layout.ready - self._pointer, layout.first - self._pointer
        if 0 <= ready < len(shown):
            shown[ready] = shown[ready] & ~layout.ready_mask | layout.ready_mask * fresh
        while 0 <= triad <= len(shown) - layout.length:
            fault.held = fault.held or sent[triad : triad + layout.length]
            shown[triad : triad + layout.length] = fault.held
            for index in layout.inside:
                shown[triad + index] = shown[triad + index] & ~1 | fresh
            triad += layout.length
        return bytes(shown)


def _unshadow(chip: Chip, at_ns: int) -> None:
    """Disable the shadow of the high byte by its bit; the two bytes can then belong to two readings (BMA-99)."""
    control = chip.page[bma180.CTRL_REG0.address]
    chip.store(bma180.CTRL_REG0.address, control | bma180.EE_W.mask, at_ns)
    chip.store(bma180.GAIN_Y.address, chip.page[bma180.GAIN_Y.address] | bma180.SHADOW_DIS.mask, at_ns)
    chip.store(bma180.CTRL_REG0.address, control, at_ns)


def _update_at_once(chip: Chip, at_ns: int) -> None:
    """Clear the bit that keeps low and high byte of a reading together (L3G-50)."""
    control = chip.page[l3g4200d.CTRL_REG4.address]
    chip.store(l3g4200d.CTRL_REG4.address, control & ~l3g4200d.BLOCK_DATA_UPDATE.mask, at_ns)


TEARS: MappingProxyType[str, Callable[[Chip, int], None]] = MappingProxyType(
    {"bma180": _unshadow, "l3g4200d": _update_at_once}
)
"""Functions that cause torn readings, by chip; other chips have no bit for this (ADX-49, HMC-33)."""


class ShiftedElement:
    """A sensing element whose bias is different during a start-up fault."""

    def __init__(self, element: Element, faults: Sequence[ChipFault], powered_on_ns: int) -> None:
        self._element, self._faults, self._powered_on_ns = element, faults, powered_on_ns

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> Triple:
        """Return the element's sample plus the biases of active faults."""
        x, y, z = self._element.sample(at_ns, full_scale, bandwidth_hz)
        for fault in self._faults:
            if fault.active(at_ns - self._powered_on_ns):
                x, y, z = x + fault.bias[0], y + fault.bias[1], z + fault.bias[2]
        return x, y, z

    def temperature(self, at_ns: int) -> float:
        """Return the element's temperature."""
        return self._element.temperature(at_ns)

    def pressure(self, at_ns: int) -> float:
        """Return the element's pressure."""
        return self._element.pressure(at_ns)
