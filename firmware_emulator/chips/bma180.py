"""BMA180 accelerometer with its registers, according to the Bosch data sheet v2.5 (facts BMA-01 ... BMA-107).

There are three regions: operational registers, the image 0x20 ... 0x3B that acts on the chip, and the EEPROM from which
the image is loaded. After wake-up it measures at +/-2 g, 150 Hz. The model includes the known pitfalls: image writes
that are acknowledged and dropped while ee_w is 0, the 10 ms download that undoes early writes, trims next to settings
in the same registers, writes in (register, value) pairs.

Not modelled: the interrupt logic and the offset regulation, so their status bits read 0; wake-up mode; the
thermometer's gain trim.

The signal path is sensing element, free-running converter, filter. One cycle converts temperature, x, y, z, a quarter
of a period each (BMA-94). The model evaluates the element once per cycle, when x is ready, and publishes each axis when
its own quarter ends. If the box moves noticeably within a quarter, because quarters are long, it evaluates the element
once for each axis, when that axis is ready. Cycles count from the last change of a setting; index -1 denotes the
contents of the registers at that change. Codes are signed 14-bit integers (BMA-60).

Choices where the data sheet states nothing: the filter settles exponentially (DEC-14), in codes, at its cut-off
frequency; with an unauthorised range or bandwidth code (BMA-77, BMA-91) the converter stops, so that its codes are not
mistaken for data; modes 01 and 10 act as 00 (BMA-96). The steps of the trims are choices too, see `Trims`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from struct import Struct
from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chip import NEVER_NS, Chip, Element, Triple, registers_of
from firmware_emulator.chips.high_pass import HighPass
from imuarray.facts import bma180 as facts

RANGES = {  # code: g, mg per code (BMA-70 ... BMA-76, the exact column)
    0b000: (1.0, 0.12207),
    0b001: (1.5, 0.18315),
    0b010: (2.0, 0.24414),
    0b011: (3.0, 0.36630),
    0b100: (4.0, 0.48828),
    0b101: (8.0, 0.97656),
    0b110: (16.0, 1.95313),
}
BANDWIDTHS = {  # code: upper cut-off Hz, lower cut-off Hz, samples to settle (BMA-81 ... BMA-90)
    0b0000: (10.0, 0.0, 253),
    0b0001: (20.0, 0.0, 127),
    0b0010: (40.0, 0.0, 64),
    0b0011: (75.0, 0.0, 35),
    0b0100: (150.0, 0.0, 18),
    0b0101: (300.0, 0.0, 9),
    0b0110: (600.0, 0.0, 6),
    0b0111: (1200.0, 0.0, 0),
    0b1000: (1200.0, 1.0, 1978),
    0b1001: (300.0, 0.2, 8833),
}
UPDATE_HZ = 2400  # BMA-93; half of it in low-power mode
LOW_POWER = 0b11  # mode_config, BMA-96
SELF_TEST_NS = 8_000_000  # less than 10 ms, BMA-104
SELF_TEST_G = 700 / 4096  # typical response, 700 codes at 2 g (BMA-104)

IN_TURN_NS = 500_000
"""Length of a quarter of the cycle in ns above which the element is evaluated at the time of each axis, not once for
all: five times the quarter of an accurate oscillator.
"""

_BURST = Struct("<hhh")
Codes = tuple[int, int, int]


class Trims(NamedTuple):
    """Factory trims. Only their difference from the part's own values has an effect, because the part's own values
    cancel the errors of the raw element.

    One step of a 12-bit offset is a sixteenth of 27 codes at 2 g (BMA-121 read as a step of its upper eight bits).
    Assumed, because no figures are published: 0.5 % per step of gain; steps of tco and tcs of twice the drift that
    remains after the factory trim (BMA-115, BMA-116); 1 code per step of offset_t.
    """

    offset: Codes
    gain: Codes
    tco: Codes
    tcs: int
    offset_t: int


OFFSET_STEP_G = 27 / 16 / 4096
GAIN_STEP = 0.005
TCO_STEP_G = 1e-3  # per K
TCS_STEP = 2e-4  # per K
TRIM_DEGC = 25.0


class Settings(NamedTuple):
    """The settings that affect a conversion."""

    range_code: int
    bandwidth_code: int
    mode_code: int
    asleep: bool
    self_test: bool
    twelve_bits: bool
    trims: Trims


class Converter:
    """The contents of the data registers at any instant, including their new_data bits and MSB shadows."""

    def __init__(self, element: Element, factory: Trims, rate_error: float) -> None:
        self._element = element
        self._factory = factory
        self._rate_hz = UPDATE_HZ * (1 + rate_error)

    def power_on(self, at_ns: int, settings: Settings, ready_ns: int) -> None:
        """Begin with empty registers and filter; the first cycle begins at `ready_ns`."""
        self._held: Codes = (0, 0, 0)
        self._held_temperature = 0
        self._seen = [-1, -1, -1]  # latest cycle read, per axis
        self._shadow = [0, 0, 0]  # BMA-99
        self._start(at_ns, settings, ready_ns)

    def apply(self, at_ns: int, settings: Settings, ready_ns: int) -> None:
        """Convert from `at_ns` on with `settings`, not before `ready_ns`; existing codes remain."""
        if settings == self._settings and ready_ns == self._ready_ns:
            return
        cycles = [self._cycle(axis, at_ns) for axis in range(3)]
        x, y, z = (self._codes(cycle, at_ns)[axis] for axis, cycle in enumerate(cycles))
        self._held_temperature = self.temperature(at_ns)
        self._held = x, y, z
        self._seen = [-1 if seen >= cycle else -2 for seen, cycle in zip(self._seen, cycles, strict=True)]
        self._start(at_ns, settings, ready_ns)

    def _start(self, at_ns: int, settings: Settings, ready_ns: int) -> None:
        self._settings, self._ready_ns = settings, ready_ns
        slow = settings.mode_code == LOW_POWER
        period = round(1e9 / self._rate_hz) * (2 if slow else 1)
        self._period_ns, self._quarter_ns = period, period // 4
        self._ready_after_ns = (period // 2, period // 2 + period // 4, period)
        is_known = settings.range_code in RANGES and settings.bandwidth_code in BANDWIDTHS
        self._start_ns = max(at_ns, ready_ns) if is_known and not settings.asleep else NEVER_NS
        self._latest_index = self._earlier_index = self._temperature_index = -1
        self._latest = self._earlier = self._held
        self._temperature = self._held_temperature
        self._range_g, mg = RANGES.get(settings.range_code, RANGES[0b010])
        high, low, settling = BANDWIDTHS.get(settings.bandwidth_code, BANDWIDTHS[0b0111])
        self._bandwidth_hz = high / 2 if slow else high
        self._settling = 0 if low else settling
        self._decay = math.exp(-2 * math.pi * high / UPDATE_HZ)
        self._high_pass = HighPass(low, self._start_ns) if low else None
        self._set_scales(1000 / mg)

    def _set_scales(self, codes_per_g: float) -> None:
        trims, factory = self._settings.trims, self._factory
        sx, sy, sz = (
            codes_per_g * (1 + GAIN_STEP * (gain - factory_gain))
            for gain, factory_gain in zip(trims.gain, factory.gain, strict=True)
        )
        ox, oy, oz = (
            OFFSET_STEP_G * (offset - factory_gain)
            for offset, factory_gain in zip(trims.offset, factory.offset, strict=True)
        )
        self._scales = sx, ox * sx, sy, oy * sy, sz, oz * sz
        self._thermal = trims.tco != factory.tco or trims.tcs != factory.tcs
        self._plain = not (self._thermal or self._settings.self_test or self._high_pass)

    def _cycle(self, axis: int, at_ns: int) -> int:
        """Return the latest cycle of which register `axis` contains the result at `at_ns`."""
        cycle = (at_ns - self._start_ns - self._ready_after_ns[axis]) // self._period_ns
        return cycle if cycle >= 0 else -1

    def _codes(self, cycle: int, at_ns: int) -> Codes:
        """Return the codes of `cycle`, which is one of those in the registers at `at_ns`."""
        if cycle == self._latest_index:
            return self._latest
        if cycle == self._earlier_index:
            return self._earlier
        oldest = self._cycle(2, at_ns)
        if self._latest_index < oldest < cycle:
            self._convert(oldest)  # z still contains it: the element is never evaluated at an earlier time
        return self._convert(cycle)

    def _convert(self, cycle: int) -> Codes:
        at_ns = self._start_ns + cycle * self._period_ns + self._ready_after_ns[0]
        g = self._sample(at_ns)
        if self._quarter_ns > IN_TURN_NS:
            y_g, z_g = (self._sample(at_ns + axis * self._quarter_ns)[axis] for axis in (1, 2))
            g = g[0], y_g, z_g
        if not self._plain:
            g = self._disturb(g, at_ns)
        sx, ox, sy, oy, sz, oz = self._scales
        x, y, z = round(g[0] * sx + ox), round(g[1] * sy + oy), round(g[2] * sz + oz)
        if cycle < self._settling:
            residue = self._decay ** (cycle + 1)
            x, y, z = (round(new + (old - new) * residue) for new, old in zip((x, y, z), self._held, strict=True))
        codes = x, y, z
        if not (-8192 <= x <= 8191 and -8192 <= y <= 8191 and -8192 <= z <= 8191):
            codes = max(-8192, min(8191, x)), max(-8192, min(8191, y)), max(-8192, min(8191, z))
        if self._settings.twelve_bits:
            codes = codes[0] & ~3, codes[1] & ~3, codes[2] & ~3
        self._earlier_index, self._earlier = self._latest_index, self._latest
        self._latest_index, self._latest = cycle, codes
        return codes

    def _sample(self, at_ns: int) -> Triple:
        return self._element.sample(at_ns, self._range_g, self._bandwidth_hz)

    def _disturb(self, g: Triple, at_ns: int) -> Triple:
        """Return `g` after a self-test, wrong temperature trims and a high-pass."""
        x, y, z = g
        if self._settings.self_test:
            push = SELF_TEST_G if at_ns - self._start_ns < SELF_TEST_NS // 2 else -SELF_TEST_G
            x, y, z = x + push, y + push, z + push
        if self._thermal:
            warmer = self._element.temperature(at_ns) - TRIM_DEGC
            trims, factory = self._settings.trims, self._factory
            gain = 1 + TCS_STEP * (trims.tcs - factory.tcs) * warmer
            step = TCO_STEP_G * warmer
            dx, dy, dz = (step * (tco - factory_tco) for tco, factory_tco in zip(trims.tco, factory.tco, strict=True))
            x, y, z = x * gain + dx, y * gain + dy, z * gain + dz
        return self._high_pass((x, y, z), at_ns) if self._high_pass else (x, y, z)

    def low_byte(self, axis: int, at_ns: int) -> int:
        """Return six bits of the code and new_data; copy the other eight to the shadow (BMA-12, BMA-62, BMA-99)."""
        cycle = self._cycle(axis, at_ns)
        code = self._codes(cycle, at_ns)[axis]
        new = self._seen[axis] < cycle
        self._seen[axis] = cycle
        self._shadow[axis] = code >> 6 & 0xFF
        return (code << 2 & 0xFC) | new

    def high_byte(self, axis: int, at_ns: int, shadowed: bool) -> int:
        """Return eight bits of the code: of the shadow (BMA-100) or, unshadowed, of the latest conversion (BMA-101)."""
        cycle = self._cycle(axis, at_ns)
        self._seen[axis] = cycle
        return self._shadow[axis] if shadowed else self._codes(cycle, at_ns)[axis] >> 6 & 0xFF

    def temperature(self, at_ns: int) -> int:
        """Return the byte of register temp: 128 codes for the 64 K below 24 degC (BMA-63)."""
        cycle = (at_ns - self._start_ns - self._quarter_ns) // self._period_ns
        if cycle > self._temperature_index:
            self._temperature_index = cycle
            time_ns = self._start_ns + cycle * self._period_ns + self._quarter_ns
            code = round((self._element.temperature(time_ns) - 24) * 128 / 64)
            code += self._settings.trims.offset_t - self._factory.offset_t
            self._temperature = max(-128, min(127, code)) & 0xFF
        return self._temperature

    def burst(self, at_ns: int, byte_ns: int) -> bytes:
        """Return six bytes, x low to z high, shadowed: a faster way to the results of `low_byte` and `high_byte`."""
        period = self._period_ns
        after_x, after_y, after_z = self._ready_after_ns
        begun_ns = at_ns - self._start_ns
        x_ns, y_ns, z_ns = begun_ns - after_x, begun_ns - after_y + 2 * byte_ns, begun_ns - after_z + 4 * byte_ns
        x, y, z = x_ns // period, y_ns // period, z_ns // period
        if x < 0 or y < 0 or z < 0:
            return bytes(
                self.high_byte(byte // 2, at_ns + byte * byte_ns, shadowed=True)
                if byte % 2
                else self.low_byte(byte // 2, at_ns + byte * byte_ns)
                for byte in range(6)
            )
        first = x if x == y == z else min(x, y, z)
        if first == self._latest_index:
            codes = self._latest
        else:
            codes = self._earlier if first == self._earlier_index else self._convert(first)
        code_x, code_y, code_z = codes
        if x != first:
            code_x = self._codes(x, at_ns)[0]
        if y != first:
            code_y = self._codes(y, at_ns)[1]
        if z != first:
            code_z = self._codes(z, at_ns)[2]
        seen_x, seen_y, seen_z = self._seen
        self._seen = [(x_ns + byte_ns) // period, (y_ns + byte_ns) // period, (z_ns + byte_ns) // period]
        self._shadow = [code_x >> 6 & 0xFF, code_y >> 6 & 0xFF, code_z >> 6 & 0xFF]
        return _BURST.pack(code_x * 4 | (seen_x < x), code_y * 4 | (seen_y < y), code_z * 4 | (seen_z < z))


IMAGE = range(0x20, 0x3C)  # writable while ee_w = 1 (BMA-51); BMA-48: 0x3C ... 0x3F stay locked
WINDOW = range(0x40, 0x5C)  # the same registers in EEPROM, BMA-49
RESERVED_WINDOW_END = 0x60
DOWNLOAD_NS = 10_000_000  # BMA-53
BURN_NS = 10_000_000  # BMA-55
START_UP_NS = 2_500_000  # BMA-106
WAKE_NS = 2_000_000  # from sleep, BMA-106
VERSION = 0x14  # placeholder, DEC-12
SOFT_RESET = 0xB6  # BMA-24
NO_ADDRESS = -1

_CONTROL = facts.CTRL_REG0.address
_STATUS = facts.STATUS_REG1.address
_RESET = facts.RESET.address
_X_LOW = facts.ACC_X_LSB.address
_Z_HIGH = facts.ACC_Z_MSB.address
_TEMP = facts.TEMP.address
_UNSHADOWED = facts.GAIN_Y.address


def trims_of(page: bytes | bytearray) -> Trims:
    """Return the trim fields in a register page."""
    low1, low2 = page[0x35], page[0x36]  # BMA-43, BMA-44
    return Trims(
        offset=(page[0x38] << 4 | low1 >> 4, page[0x39] << 4 | low2 & 15, page[0x3A] << 4 | low2 >> 4),
        gain=(page[0x32] >> 1, page[0x33] >> 1, page[0x34] >> 1),
        tco=(page[0x2E] >> 2, page[0x2F] >> 2, page[0x30] >> 2),
        tcs=facts.TCS.of(page[0x20]),
        offset_t=page[0x37] >> 1,
    )


def settings_of(page: bytes | bytearray) -> Settings:
    """Return the settings of a conversion in a register page."""
    testing = bool(facts.SELF_TEST_0.of(page[_CONTROL]))
    return Settings(
        range_code=facts.RANGE.of(page[0x35]),
        bandwidth_code=0b0111 if testing else facts.BANDWIDTH.of(page[0x20]),  # BMA-104
        mode_code=facts.MODE_CONFIG.of(page[0x30]),
        asleep=bool(facts.SLEEP.of(page[_CONTROL])),
        self_test=testing,
        twelve_bits=bool(facts.READOUT_12BIT.of(page[0x37])),
        trims=trims_of(page),
    )


class Bma180Chip(Chip):
    """The chip. `eeprom_writes` counts writes to 0x40 and above, which a driver must never do (BMA-55, DEC-13).

    eeprom: bytes by register address that differ from BMA-58: a part's own trims, settings of a previous owner
    (BMA-59). left_over: registers as an earlier program set them; the part then neither boots nor warms up.
    download_ns: duration of the download from the EEPROM, 0 for an instantaneous one (DEC-10). early_writes_vanish:
    image writes during the download are dropped immediately, not undone at its end (DEC-10). rate_error: relative error
    of the oscillator, within +/-0.1 (BMA-107).
    """

    table: ClassVar[ModuleType] = facts

    # The switches are properties that data sheets do not specify, or settings of an earlier program.
    def __init__(  # noqa: PLR0913
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        eeprom: Mapping[int, int] | None = None,
        left_over: Mapping[int, int] | None = None,
        download_ns: int = DOWNLOAD_NS,
        early_writes_vanish: bool = False,
        rate_error: float = 0.0,
    ) -> None:
        self.eeprom_writes = 0
        self._strapped = address
        self._download_ns, self._early_writes_vanish = download_ns, early_writes_vanish
        delivered = bytearray(256)
        for register, fact in registers_of(facts).items():
            delivered[register] = fact.reset
        for register, value in (eeprom or {}).items():
            delivered[register] = value
        self.eeprom = delivered[IMAGE.start : IMAGE.stop]
        self._converter = Converter(element, trims_of(delivered), rate_error)
        super().__init__(address, element, powered_on_ns)
        if left_over is not None:
            self._leave(left_over, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Set registers to their reset values, the image to that of the EEPROM; begin the download (BMA-52, BMA-57)."""
        super().power_on(at_ns)
        self.address = self._strapped
        self.page[facts.VERSION.address] = VERSION
        self.page[IMAGE.start : IMAGE.stop] = self.eeprom
        self._pending: int | None = None
        self._begin(at_ns)

    def _begin(self, at_ns: int) -> None:
        self._self_test_end_ns = self._burn_end_ns = NEVER_NS
        self._ready_ns = at_ns + START_UP_NS
        self._converter.power_on(at_ns, settings_of(self.page), self._ready_ns)
        self._download_end_ns = at_ns + self._download_ns
        self._act(at_ns)
        self._catch_up(at_ns)

    def _leave(self, left_over: Mapping[int, int], at_ns: int) -> None:
        self._download_end_ns, self._ready_ns = NEVER_NS, at_ns
        for register, value in left_over.items():
            self.page[register] = value
        self.page[_CONTROL] &= ~(facts.UPDATE_IMAGE.mask | facts.SELF_TEST_0.mask)
        self._act(at_ns)

    # What happens by itself -----------------------------------------------------------------------------------------

    def _catch_up(self, at_ns: int) -> None:
        while self._next_ns <= at_ns:
            due = self._next_ns
            if due == self._download_end_ns:
                self.page[IMAGE.start : IMAGE.stop] = self.eeprom
                self.page[_CONTROL] &= ~facts.UPDATE_IMAGE.mask
                self._download_end_ns = NEVER_NS
            if due == self._self_test_end_ns:
                self.page[_CONTROL] &= ~facts.SELF_TEST_0.mask
                self._self_test_end_ns = NEVER_NS
            if due == self._burn_end_ns:
                self.page[_STATUS] &= ~facts.EE_WRITE.mask
                self._burn_end_ns = NEVER_NS
            self._act(due)

    def _act(self, at_ns: int) -> None:
        self._next_ns = min(self._download_end_ns, self._self_test_end_ns, self._burn_end_ns)
        self._converter.apply(at_ns, settings_of(self.page), self._ready_ns)
        if facts.DIS_I2C.of(self.page[facts.HIGH_DUR.address]):
            self.address = NO_ADDRESS  # BMA-33: no answer until the supply is switched off and on

    # Reading --------------------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Return `count` bytes from the pointer on; a faster path returns the same bytes for a shadowed burst from
        acc_x_lsb.
        """
        self._pending = None
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if self.address == NO_ADDRESS:
            return b"\xff" * count
        end_ns = at_ns + count * byte_ns
        if self.pointer != _X_LOW or not 6 <= count <= 7 or end_ns >= self._next_ns or self.page[_UNSHADOWED] & 1:
            return super().read(count, at_ns, byte_ns)
        self.pointer = _X_LOW + count
        answer = self._converter.burst(at_ns, byte_ns)
        return answer if count == 6 else answer + bytes((self._converter.temperature(end_ns - byte_ns),))

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte; the EEPROM's window shows the image (BMA-54)."""
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if _X_LOW <= address <= _Z_HIGH:
            axis, high = divmod(address - _X_LOW, 2)
            if high:
                return self._converter.high_byte(axis, at_ns, shadowed=not self.page[_UNSHADOWED] & 1)
            return self._converter.low_byte(axis, at_ns)
        if address == _TEMP:
            return self._converter.temperature(at_ns)
        if WINDOW.start <= address < RESERVED_WINDOW_END:
            return self.page[address - 0x20]
        return self.page[address]

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next pointer, which has seven bits (BMA-03, BMA-04)."""
        return pointer + 1 & 0x7F

    # Writing --------------------------------------------------------------------------------------------------------

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write registers and values in turn (BMA-05). Every byte is acknowledged, even if not stored (BMA-07)."""
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if len(data) == 1 and self.address != NO_ADDRESS:  # the usual case
            self.pointer = self._pending = data[0] & 0x7F
            return 1
        for index, byte in enumerate(data):
            if self.address == NO_ADDRESS:
                return index
            if index % 2 == 0:
                self.pointer = self._pending = byte & 0x7F
            else:
                self._pending = None
                self.store(self.pointer, byte, at_ns + index * byte_ns)
        return len(data)

    def stop(self, at_ns: int) -> None:
        """End the transaction: a write of an even address of the EEPROM's window without data copies two bytes into the
        EEPROM (BMA-55), unless a read follows.
        """
        if self._pending is not None and self._pending in WINDOW and self._pending % 2 == 0:
            self._burn(self._pending, at_ns)
        self._pending = None

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Store a byte in a register, if the register accepts it."""
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if address >= WINDOW.start:
            self._burn(address, at_ns)
        elif address == _RESET:
            self._soft_reset(value, at_ns)
        elif self._burn_end_ns != NEVER_NS:
            return  # BMA-17
        elif address == _CONTROL:
            self._control(value, at_ns)
        elif not self.page[_CONTROL] & facts.SLEEP.mask:  # DEC-11
            self._keep(address, value, at_ns)

    def _keep(self, address: int, value: int, at_ns: int) -> None:
        if address in IMAGE:
            locked = not self.page[_CONTROL] & facts.EE_W.mask  # BMA-51
            if locked or (self._early_writes_vanish and self._download_end_ns != NEVER_NS):
                return
            self.page[address] = value
            self._act(at_ns)
        elif address == facts.CTRL_REG2.address:
            super().store(address, value, at_ns)  # ctrl_reg1 is one-shot (BMA-22) and reads 0

    def _control(self, value: int, at_ns: int) -> None:
        """Carry out ctrl_reg0 (BMA-21): update_image and st0 stay set until they clear themselves, reset_int clears
        itself immediately.
        """
        previous = self.page[_CONTROL]
        self.page[_CONTROL] = value & ~(facts.CTRL_REG0.reserved | facts.RESET_INT.mask) & 0xFF
        self.page[_CONTROL] |= previous & facts.UPDATE_IMAGE.mask
        if value & facts.UPDATE_IMAGE.mask and self._download_end_ns == NEVER_NS:
            self._download_end_ns = at_ns + self._download_ns
        if previous & facts.SLEEP.mask and not value & facts.SLEEP.mask:
            self._ready_ns = at_ns + WAKE_NS
        if not value & facts.SELF_TEST_0.mask:
            self._self_test_end_ns = NEVER_NS
        elif self._self_test_end_ns == NEVER_NS:
            self._self_test_end_ns = at_ns + SELF_TEST_NS
        self._act(at_ns)
        self._catch_up(at_ns)

    def _soft_reset(self, value: int, at_ns: int) -> None:
        """Reset as after power-on, but keep the image's contents until the download ends (BMA-56, DEC-10)."""
        if value != SOFT_RESET:
            return
        self.page[_STATUS : _CONTROL + 3] = bytes(_CONTROL + 3 - _STATUS)
        self._begin(at_ns)

    def _burn(self, address: int, at_ns: int) -> None:
        """Copy two bytes of the image into the EEPROM if the address is even and the EEPROM is not busy; always count
        the write.
        """
        self.eeprom_writes += 1
        if address not in WINDOW or address % 2 or self._burn_end_ns != NEVER_NS or self._download_end_ns != NEVER_NS:
            return
        first = address - WINDOW.start
        self.eeprom[first : first + 2] = self.page[address - 0x20 : address - 0x1E]
        self.page[_STATUS] |= facts.EE_WRITE.mask
        self._burn_end_ns = at_ns + BURN_NS
        self._next_ns = min(self._next_ns, self._burn_end_ns)
