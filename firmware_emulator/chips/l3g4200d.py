"""L3G4200D gyroscope with its registers, according to the ST data sheet Doc ID 17116 Rev 3 (facts L3G-01 ... L3G-65).

After power-on it is in power-down; it has no reset. Sub-address bit 7 requests the next register after every byte;
without it a burst repeats the same register. Not modelled: the interrupts (INT1_SRC reads 0), the 3-wire SPI.

Choices: an axis counts as read when both its bytes have been read; with BDU it does not change between its first and
its second byte (L3G-50, L3G-51). An axis that is switched off keeps its value and is never new. BOOT clears itself
after 5 ms and has no other effect. The two FIFO modes that wait for an interrupt stay in their first mode:
stream-to-FIFO streams, bypass-to-stream bypasses. A set is removed from the FIFO when its first byte is read, and stays
in the output registers until its last byte, OUT_Z_H, has been read; while the FIFO is empty, the registers keep the
last set that was read.

Scale, filters and self-test act between element and output registers (facts L3G-30 ... L3G-45): 28571 codes are the
full scale of every range (250 dps at 8.75 mdps, L3G-40 ... L3G-43). Choices: in high-pass mode 01 the output is the
difference from REFERENCE, which is the high byte of a code; mode 11 acts as mode 00, because the interrupt is not
modelled.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from struct import Struct
from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chip import NEVER_NS, Chip, Element
from firmware_emulator.chips.high_pass import HighPass
from imuarray.facts import l3g4200d as facts

RATES_HZ = (100, 200, 400, 800)
LPF1_HZ = (32.0, 54.0, 78.0, 93.0)  # by DR: L3G-38, DEC-22
LPF2_HZ = (  # by DR, then BW: L3G-30 ... L3G-33
    (12.5, 25.0, 25.0, 25.0),
    (12.5, 25.0, 50.0, 70.0),
    (20.0, 25.0, 50.0, 110.0),
    (30.0, 35.0, 50.0, 110.0),
)
HIGH_PASS_HZ = (56.0, 30.0, 15.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # slower by DR and HPCF: L3G-35
RANGES_DPS = (250.0, 500.0, 2000.0, 2000.0)  # L3G-40 ... L3G-42
SELF_TESTS_DPS = (130.0, 200.0, 530.0, 530.0)  # L3G-62
SELF_TEST_SIGNS = (0.0, 1.0, 0.0, -1.0)  # by ST: L3G-14
RANGE_CODES = 250 / 0.00875
REFERENCE_MODE = 0b01

Codes = tuple[int, int, int]


class Path(NamedTuple):
    """The signal path that CTRL_REG1 ... CTRL_REG5 select."""

    range_dps: float
    bandwidth_hz: float
    self_test_dps: float
    high_pass_hz: float  # 0: none
    reference: bool


def path_of(page: bytes | bytearray) -> Path:
    """Return the path that a register page selects (L3G-36, L3G-37)."""
    ctrl1, ctrl2, ctrl4, ctrl5 = page[0x20], page[0x21], page[0x23], page[0x24]
    rate, scale, select = facts.DATA_RATE.of(ctrl1), facts.FULL_SCALE.of(ctrl4), facts.OUT_SELECT.of(ctrl5)
    filtered = select == 0b01 or (select >= 0b10 and bool(facts.HIGH_PASS_EN.of(ctrl5)))
    slowness = 3 - rate + min(9, facts.HIGH_PASS_CUTOFF.of(ctrl2))
    return Path(
        range_dps=RANGES_DPS[scale],
        bandwidth_hz=LPF2_HZ[rate][facts.BANDWIDTH.of(ctrl1)] if select >= 0b10 else LPF1_HZ[rate],
        self_test_dps=SELF_TESTS_DPS[scale] * SELF_TEST_SIGNS[facts.SELF_TEST.of(ctrl4)],
        high_pass_hz=HIGH_PASS_HZ[slowness] if filtered else 0.0,
        reference=filtered and facts.HIGH_PASS_MODE.of(ctrl2) == REFERENCE_MODE,
    )


class Signal:
    """Codes of the element's rate at any instant, through the selected signal path."""

    def __init__(self, element: Element, page: bytearray) -> None:
        self._element = element
        self._page = page
        self._high_pass: HighPass | None = None
        self._path = path_of(page)

    def configure(self, at_ns: int) -> None:
        """Set the path according to the registers at `at_ns`."""
        path = path_of(self._page)
        if path.high_pass_hz != self._path.high_pass_hz or path.reference != self._path.reference:
            filtered = path.high_pass_hz and not path.reference
            self._high_pass = HighPass(path.high_pass_hz, at_ns) if filtered else None
        self._path = path
        self._codes_per_dps = RANGE_CODES / path.range_dps
        self._offset = 0.0
        if self._high_pass is None:
            self._offset += path.self_test_dps * self._codes_per_dps
        if path.reference:
            reference = self._page[facts.REFERENCE.address]
            self._offset -= (reference - 256 if reference > 127 else reference) * 256

    def zero(self, at_ns: int) -> None:
        """Set the zero of the high-pass filter to the present rate, as reading REFERENCE does (L3G-12)."""
        if self._high_pass is not None:
            path = self._path
            x, y, z = self._element.sample(at_ns, path.range_dps, path.bandwidth_hz)
            push = path.self_test_dps
            self._high_pass.zero((x + push, y + push, z + push), at_ns)

    def codes(self, at_ns: int) -> Codes:
        """Return the conversion of `at_ns`, saturated (DEC-21)."""
        path = self._path
        dps = self._element.sample(at_ns, path.range_dps, path.bandwidth_hz)
        if self._high_pass is not None:
            push = path.self_test_dps
            dps = self._high_pass((dps[0] + push, dps[1] + push, dps[2] + push), at_ns)
        scale, offset = self._codes_per_dps, self._offset
        x, y, z = round(dps[0] * scale + offset), round(dps[1] * scale + offset), round(dps[2] * scale + offset)
        if -32768 <= x <= 32767 and -32768 <= y <= 32767 and -32768 <= z <= 32767:
            return x, y, z
        return _saturate(x), _saturate(y), _saturate(z)


def _saturate(code: int) -> int:
    return max(-32768, min(32767, code))


DEPTH = 32
FIFO, STREAM, STREAM_TO_FIFO = 0b001, 0b010, 0b011
LAST_BYTE = 5  # OUT_Z_H, counted from OUT_X_L


class Fifo:
    """The FIFO: sets in the order of their conversion."""

    def __init__(self) -> None:
        self.mode = 0
        self._sets: deque[Codes] = deque()
        self._shown: Codes = (0, 0, 0)
        self._open = False
        self._upto = -1
        self._stopped = False  # full once, in FIFO mode

    @property
    def active(self) -> bool:
        """True if the mode stores sets."""
        return self.mode in (FIFO, STREAM, STREAM_TO_FIFO)

    @property
    def level(self) -> int:
        """The number of stored sets, 0 ... 32."""
        return len(self._sets)

    @property
    def waiting(self) -> bool:
        """True if there is a set that has not been read completely."""
        return self._open or bool(self._sets)

    def switch(self, mode: int, latest: int, shown: Codes) -> None:
        """Change the mode from conversion `latest` on; bypass empties the FIFO (L3G-54)."""
        was_active = self.active
        self.mode = mode
        if not self.active:
            self._sets.clear()
            self._stopped = False
        if not was_active:
            self._open, self._shown, self._upto = False, shown, latest

    def fill(self, latest: int, convert: Callable[[int], Codes]) -> None:
        """Store the conversions up to `latest` according to the mode."""
        first, end = self._upto + 1, latest + 1
        if self.mode == FIFO:
            end = first if self._stopped else min(end, first + DEPTH - len(self._sets))
        else:
            first = max(first, end - DEPTH)  # older ones would be discarded anyway
        for index in range(first, end):
            if len(self._sets) == DEPTH:
                self._sets.popleft()
            self._sets.append(convert(index))
        self._upto = latest
        self._stopped = self.mode == FIFO and (self._stopped or len(self._sets) == DEPTH)

    def shown(self, byte: int) -> Codes:
        """Return the set from which byte 0 ... 5 of the output registers is read now (L3G-56)."""
        if not self._open and self._sets:
            self._open, self._shown = True, self._sets.popleft()
        if byte == LAST_BYTE:
            self._open = False
        return self._shown

    def source(self, watermark: int) -> int:
        """Return FIFO_SRC_REG: watermark reached, full, empty, level up to 31 (L3G-55, L3G-58)."""
        level = len(self._sets)
        full = level == DEPTH
        return (level >= watermark) << 7 | full << 6 | (not level) << 5 | level - full


START_UP_NS = 0  # some sources state 300 ms from power-down, but no document that is available: L3G-65
BOOT_NS = 5_000_000
SECOND_NS = 1_000_000_000  # OUT_TEMP is refreshed at 1 Hz, L3G-60
ALL_AXES = 0b111
NO_HALVES = [-1, -1, -1]

_CTRL1, _CTRL4, _CTRL5 = facts.CTRL_REG1.address, facts.CTRL_REG4.address, facts.CTRL_REG5.address
_REFERENCE, _TEMP, _STATUS = facts.REFERENCE.address, facts.OUT_TEMP.address, facts.STATUS_REG.address
_X_LOW, _Z_HIGH = facts.OUT_X_L.address, facts.OUT_Z_H.address
_FIFO_CTRL, _FIFO_SRC = facts.FIFO_CTRL_REG.address, facts.FIFO_SRC_REG.address
_LITTLE, _BIG = Struct("<hhh"), Struct(">hhh")


class L3g4200dChip(Chip):
    """The chip. `forbidden_writes` counts writes to reserved registers, which may destroy a real part (L3G-07).

    temperature_zero: OUT_TEMP at 0 degC, unknown for a real part (L3G-60). left_over: registers as set by an earlier
    program; the part then neither boots nor warms up. start_up_ns: time from the end of power-down to the first
    conversion; L3G-65 is unverified, so the default is 0. wrap_always: 0x2D is followed by 0x28 even without FIFO
    (DEC-20). rate_error: relative error of the output data rate.
    """

    table: ClassVar[ModuleType] = facts

    # The switches are properties that data sheets do not specify, or settings of an earlier program.
    def __init__(  # noqa: PLR0913
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        temperature_zero: float = 47.0,
        left_over: Mapping[int, int] | None = None,
        start_up_ns: int = START_UP_NS,
        wrap_always: bool = False,
        rate_error: float = 0.0,
    ) -> None:
        self.forbidden_writes = 0
        self._temperature_zero, self._wrap_always = temperature_zero, wrap_always
        self._start_up_ns, self._rate_error = start_up_ns, rate_error
        super().__init__(address, element, powered_on_ns)
        if left_over is not None:
            for register, value in left_over.items():
                self.page[register] = value
            self._start_up_ns = 0
            self._reconfigure(powered_on_ns)
            self._start_up_ns = start_up_ns

    def power_on(self, at_ns: int) -> None:
        """Set the reset values: power-down, outputs 0."""
        super().power_on(at_ns)
        self._increment = False
        self._signal, self._fifo = Signal(self.element, self.page), Fifo()
        self._powered, self._running, self._rate, self._ready_ns = False, False, -1, at_ns
        self._base, self._start_ns, self._period_ns = -1, NEVER_NS, SECOND_NS  # conversions are numbered from 0
        self._index, self._codes = -1, (0, 0, 0)  # the latest conversion that was evaluated
        self._axes = ALL_AXES
        self._stopped = [-1, -1, -1]  # latest conversion of an axis that is switched off
        self._read_upto = [-1, -1, -1]
        self._half = NO_HALVES.copy()  # the byte of an axis that has been read alone: 0, 1, or -1 for none
        self._frozen = [(0, -1)] * 3  # code and index shown between the two bytes
        self._temperature_start_ns, self._second, self._temperature = NEVER_NS, -1, 0
        self._boot_end_ns = NEVER_NS
        self._reconfigure(at_ns)

    # Conversions ----------------------------------------------------------------------------------------------------

    def _latest(self, at_ns: int) -> int:
        """Return the number of the latest conversion at `at_ns`."""
        return self._base if at_ns < self._start_ns else self._base + 1 + (at_ns - self._start_ns) // self._period_ns

    def _convert(self, index: int) -> Codes:
        """Evaluate conversion `index`, the latest one or one that is still to be queued."""
        codes = self._signal.codes(self._start_ns + (index - self._base - 1) * self._period_ns)
        if self._axes != ALL_AXES:
            x, y, z = (new if self._axes >> axis & 1 else self._codes[axis] for axis, new in enumerate(codes))
            codes = x, y, z
        self._index, self._codes = index, codes
        return codes

    def _sync(self, at_ns: int) -> int:
        """Update outputs and FIFO to `at_ns`; return the number of the latest conversion."""
        latest = self._latest(at_ns)
        if self._fifo.active:
            self._fifo.fill(latest, self._convert)
        elif latest != self._index:
            self._convert(latest)
        return latest

    def _reconfigure(self, at_ns: int) -> None:
        """Apply the control registers from `at_ns` on; `_sync` has been called with the old ones."""
        ctrl1, ctrl5 = self.page[_CTRL1], self.page[_CTRL5]
        latest = self._latest(at_ns)
        self._set_axes(facts.AXES_ON.of(ctrl1), latest)
        self._signal.configure(at_ns)
        self._set_clock(ctrl1, at_ns, latest)
        mode = facts.FIFO_MODE.of(self.page[_FIFO_CTRL]) if facts.FIFO_EN.of(ctrl5) else 0
        self._fifo.switch(mode, latest, self._codes)
        self._pack = (_BIG if facts.BIG_ENDIAN.of(self.page[_CTRL4]) else _LITTLE).pack
        self._blocking = bool(facts.BLOCK_DATA_UPDATE.of(self.page[_CTRL4]))
        self._is_plain = self._axes == ALL_AXES and not self._fifo.active

    def _set_axes(self, axes: int, latest: int) -> None:
        for axis in range(3):
            if self._axes >> axis & 1 and not axes >> axis & 1:
                self._stopped[axis] = latest
        self._axes = axes

    def _set_clock(self, ctrl1: int, at_ns: int, latest: int) -> None:
        """Apply power mode (L3G-34) and data rate; a change of either restarts the grid of conversions."""
        powered, rate = bool(facts.POWER_ON.of(ctrl1)), facts.DATA_RATE.of(ctrl1)
        running = powered and facts.AXES_ON.of(ctrl1) != 0
        waking, starting = powered and not self._powered, running and not self._running
        if powered != self._powered:
            self._ready_ns = at_ns + self._start_up_ns
            self._temperature_start_ns = self._ready_ns if powered else NEVER_NS
            self._second = -1
        if (running, rate) != (self._running, self._rate) or waking:
            self._period_ns = round(1e9 / (RATES_HZ[rate] * (1 + self._rate_error)))
            filtered = facts.OUT_SELECT.of(self.page[_CTRL5]) >= 0b10
            periods = 6 if starting and filtered else 1  # L3G-64
            soonest = at_ns if waking else at_ns + periods * self._period_ns
            self._base, self._start_ns = latest, max(self._ready_ns, soonest) if running else NEVER_NS
        self._powered, self._running, self._rate = powered, running, rate

    def _status(self, latest: int) -> int:
        """Return STATUS_REG: new data per axis and altogether, and the same for overwritten data (L3G-52)."""
        x, y, z = self._read_upto
        if self._is_plain and x == y == z:  # the usual case
            return (0xF0 if latest > x + 1 else 0) | (0x0F if latest > x else 0)
        if self._fifo.active:
            return (0x0F if self._fifo.waiting else 0) | (0xF0 if self._fifo.level == DEPTH else 0)
        available = overrun = 0
        for axis in range(3):
            index = latest if self._axes >> axis & 1 else self._stopped[axis]
            available |= (index > self._read_upto[axis]) << axis
            overrun |= (index > self._read_upto[axis] + 1) << axis
        return (overrun == 7) << 7 | overrun << 4 | (available == 7) << 3 | available

    def _temperature_byte(self, at_ns: int) -> int:
        """Return OUT_TEMP: one code less per degree (L3G-60); it holds its value in power-down."""
        second = (at_ns - self._temperature_start_ns) // SECOND_NS
        if second > self._second:
            self._second = second
            degc = self.element.temperature(self._temperature_start_ns + second * SECOND_NS)
            self._temperature = max(-128, min(127, round(self._temperature_zero - degc))) & 0xFF
        return self._temperature

    # Reading --------------------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Return `count` bytes from the pointer on; a burst that no conversion interrupts is read by a faster path."""
        if not self._increment or (count != 8 if self.pointer == _TEMP else count != 6 or self.pointer != _X_LOW):
            return super().read(count, at_ns, byte_ns)
        periods, since_ns = divmod(at_ns - self._start_ns, self._period_ns)
        if periods < 0 or since_ns + (count - 1) * byte_ns >= self._period_ns:
            return super().read(count, at_ns, byte_ns)
        if not self._is_plain or self._half != NO_HALVES:
            return super().read(count, at_ns, byte_ns)
        latest = self._base + 1 + periods
        codes = self._codes if latest == self._index else self._convert(latest)
        answer = self._pack(*codes)
        if count == 8:
            answer = bytes((self._temperature_byte(at_ns), self._status(latest))) + answer
        self._read_upto = [latest, latest, latest]
        self.pointer = _X_LOW if self._wrap_always else _Z_HIGH + 1
        return answer

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte."""
        if _X_LOW <= address <= _Z_HIGH:
            return self._output(address - _X_LOW, at_ns)
        if address == _TEMP:
            return self._temperature_byte(at_ns)
        if address == _STATUS:
            return self._status(self._sync(at_ns))
        if address == _FIFO_SRC:
            self._sync(at_ns)
            return self._fifo.source(facts.FIFO_WATERMARK.of(self.page[_FIFO_CTRL])) if self._fifo.active else 0x20
        if address == _REFERENCE:
            self._sync(at_ns)
            self._signal.zero(at_ns)
        elif address == _CTRL5 and at_ns >= self._boot_end_ns:
            self.page[_CTRL5] &= ~facts.BOOT.mask
        return self.page[address]

    def _output(self, byte: int, at_ns: int) -> int:
        """Return byte 0 ... 5 of the output registers: for each axis the low byte first, or with BLE the high byte
        (L3G-44).
        """
        latest = self._sync(at_ns)
        axis, half = divmod(byte, 2)
        big = self.page[_CTRL4] & facts.BIG_ENDIAN.mask
        shift = 8 if bool(half) != bool(big) else 0
        if self._fifo.active:
            return self._fifo.shown(byte)[axis] >> shift & 0xFF
        if not (self._blocking and self._half[axis] >= 0):
            self._frozen[axis] = self._codes[axis], latest if self._axes >> axis & 1 else self._stopped[axis]
        code, index = self._frozen[axis]
        if self._half[axis] == 1 - half:
            self._half[axis] = -1
            self._read_upto[axis] = index
        else:
            self._half[axis] = half
        return code >> shift & 0xFF

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next register if sub-address bit 7 requested it (L3G-03, L3G-04), otherwise the same; with a FIFO
        the data registers wrap from z to x (L3G-05).
        """
        if not self._increment:
            return pointer
        if reading and pointer == _Z_HIGH and (self._fifo.active or self._wrap_always):
            return _X_LOW
        return pointer + 1 & 0x7F

    # Writing --------------------------------------------------------------------------------------------------------

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write: the first byte is the sub-address, whose bit 7 requests auto-increment; the values follow."""
        if data:
            self._increment = data[0] >= 0x80
            if len(data) == 1:  # the usual case
                self.pointer = data[0] & 0x7F
                return 1
            data = bytes((data[0] & 0x7F,)) + data[1:]
        return super().write(data, at_ns, byte_ns)

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Write a byte to a register; conversions before it are unchanged."""
        if address < facts.WHO_AM_I.address or 0x10 <= address < _CTRL1:
            self.forbidden_writes += 1
            return
        latest = self._sync(at_ns)
        if latest != self._index:
            self._convert(latest)  # not stored by a full FIFO
        self._temperature_byte(at_ns)
        super().store(address, value, at_ns)
        if address == _CTRL5 and value & facts.BOOT.mask:
            self._boot_end_ns = at_ns + BOOT_NS
        self._reconfigure(at_ns)
