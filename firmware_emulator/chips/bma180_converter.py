"""The BMA180's signal path: sensing element, free-running converter, filter.

One cycle converts temperature, x, y, z, a quarter of a period each (BMA-94). The model evaluates the element once per
cycle, when x is ready, and publishes each axis when its own quarter is over; if quarters are so long that the box moves
in them, it evaluates the element once per axis, when that is ready. Cycles count from the last change of a setting;
index -1 denotes the contents of the registers at that change. Codes are signed 14-bit integers (BMA-60).

Choices where the data sheet is silent: the filter settles exponentially (DEC-14), in codes, at its cut-off frequency;
with an unauthorised range or bandwidth code (BMA-77, BMA-91) the converter stops, so that its codes are not mistaken
for data; modes 01 and 10 act as 00 (BMA-96). The steps of the trims are choices too, see `Trims`.
"""

from __future__ import annotations

import math
from struct import Struct
from typing import NamedTuple

from firmware_emulator.chip import Element, Triple
from firmware_emulator.chips.high_pass import HighPass

FAR_NS = 1 << 62
"""A time in the infinite future."""

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
"""Quarters from which on the element is evaluated for every axis when it is ready: five times those of an accurate
oscillator.
"""

_BURST = Struct("<hhh")
Codes = tuple[int, int, int]


class Trims(NamedTuple):
    """Factory trims. Only their difference from the part's own values has an effect: those cancel the errors of the raw
    element.

    One step of a 12-bit offset is a sixteenth of 27 codes at 2 g (BMA-121 read as a step of its upper eight bits).
    Chosen, because no figures are published: 0.5 % per step of gain; steps of tco and tcs of twice the drift that the
    factory leaves (BMA-115, BMA-116); 1 code per step of offset_t.
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
    """The settings that change a conversion."""

    range_code: int
    bandwidth_code: int
    mode_code: int
    asleep: bool
    self_test: bool
    twelve_bits: bool
    trims: Trims


class Converter:
    """The contents of the data registers at any instant, their new_data bits and MSB shadows included."""

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
        self._start_ns = max(at_ns, ready_ns) if is_known and not settings.asleep else FAR_NS
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
        """Return the latest cycle that register `axis` shows at `at_ns`."""
        cycle = (at_ns - self._start_ns - self._ready_after_ns[axis]) // self._period_ns
        return cycle if cycle >= 0 else -1

    def _codes(self, cycle: int, at_ns: int) -> Codes:
        """Return the codes of `cycle`, one of those that the registers show at `at_ns`."""
        if cycle == self._latest_index:
            return self._latest
        if cycle == self._earlier_index:
            return self._earlier
        oldest = self._cycle(2, at_ns)
        if self._latest_index < oldest < cycle:
            self._convert(oldest)  # z still shows it: the element is never evaluated at an earlier time
        return self._convert(cycle)

    def _convert(self, cycle: int) -> Codes:
        at_ns = self._start_ns + cycle * self._period_ns + self._ready_after_ns[0]
        g = self._sampled(at_ns)
        if self._quarter_ns > IN_TURN_NS:
            y_g, z_g = (self._sampled(at_ns + axis * self._quarter_ns)[axis] for axis in (1, 2))
            g = g[0], y_g, z_g
        if not self._plain:
            g = self._disturbed(g, at_ns)
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

    def _sampled(self, at_ns: int) -> Triple:
        return self._element.sample(at_ns, self._range_g, self._bandwidth_hz)

    def _disturbed(self, g: Triple, at_ns: int) -> Triple:
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
        """Return six bytes, x low to z high, shadowed: the results of `low_byte` and `high_byte` in turn, computed
        faster.
        """
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
