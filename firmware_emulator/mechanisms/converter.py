"""Mechanisms between the analogue signal and the registers: codes, ranges, rates, latches."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Self, cast

from firmware_emulator.chip import Chip, Triple
from firmware_emulator.chips.adxl345 import Adxl345Chip
from firmware_emulator.chips.bma180 import RANGES as BMA180
from firmware_emulator.chips.bma180 import UPDATE_HZ, Bma180Chip
from firmware_emulator.chips.l3g4200d import RANGES_DPS as L3G4200D_DPS
from firmware_emulator.chips.l3g4200d import L3g4200dChip
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import LAYOUTS, Codes, Site, plus
from imuarray.facts import adxl345, bma180, l3g4200d
from imuarray.facts.registers import Field


@dataclass(frozen=True)
class StuckBit(SensorMechanism):
    """One line of the output latch is shorted to ground: a bit that is always 0.

    The code becomes code & ~(1 << `bit`): codes are in every other interval of 2^bit only, and the mean decreases by
    2^(bit - 1).

    Reference: bit 2; each doubling of the severity moves the fault to the next bit.
    """

    bit: int = 2

    resembles: ClassVar[tuple[str, ...]] = ("quantisation",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return the mechanism with a more significant bit."""
        return cls(bit=min(7, max(1, cls.bit + round(math.log2(severity)))))

    def put_on(self, site: Site) -> None:
        """Clear the bit on all axes, which share the line."""
        mask = ~(1 << self.bit)

        def latch(at_ns: int, codes: Codes) -> Codes:
            return codes[0] & mask, codes[1] & mask, codes[2] & mask

        site.links.latches.append(latch)


PERIOD = 16


@dataclass(frozen=True)
class MissingCodes(SensorMechanism):
    """A converter with poorly matched capacitors: some codes never occur and are replaced by their neighbours.

    Missing codes: of every 16 codes, the last `missing` before a carry never occur; the result is the code of the
    carry.

    Differential nonlinearity of -1 LSB at the carry of bit 4. Reference: 4 of 16.
    """

    missing: int = 4

    resembles: ClassVar[tuple[str, ...]] = ("quantisation",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return the mechanism with more missing codes."""
        return cls(missing=min(PERIOD - 2, max(2, round(cls.missing * severity))))

    def put_on(self, site: Site) -> None:
        """Skip the same codes on all axes, which share one converter."""
        first = PERIOD - self.missing

        def carried(code: int) -> int:
            return code - code % PERIOD + PERIOD if code % PERIOD >= first else code

        def latch(at_ns: int, codes: Codes) -> Codes:
            return carried(codes[0]), carried(codes[1]), carried(codes[2])

        site.links.latches.append(latch)


@dataclass(frozen=True)
class ConverterHold(SensorMechanism):
    """The converter latches up for a while: it repeats the same triad, marked as new.

    It converts for `free_s` on average (exponentially distributed) and then holds for `held_s`. Reference: about 1 s in
    every 20 s.
    """

    held_s: float = 1.0
    free_s: float = 20.0

    resembles: ClassVar[tuple[str, ...]] = ("stuck",)
    scaled: ClassVar[tuple[str, ...]] = ("held_s",)

    def put_on(self, site: Site) -> None:
        """Hold all axes together, because they share the converter."""
        random = site.run_random("holds")
        next_ns = random.exponential(self.free_s * 1e9)
        until_ns, held = -1.0, (0, 0, 0)

        def latch(at_ns: int, codes: Codes) -> Codes:
            nonlocal next_ns, until_ns, held
            if at_ns < until_ns:
                return held
            if at_ns >= next_ns:
                until_ns, held = at_ns + self.held_s * 1e9, codes
                next_ns = until_ns + random.exponential(self.free_s * 1e9)
                site.note(f"held from {at_ns * 1e-9:.3f} s")
            return codes

        site.links.latches.append(latch)


@dataclass(frozen=True)
class TornReads(SensorMechanism):
    """The shadow register fails: the bytes of a reading belong to two conversions.

    Torn readings: with probability `share` a reading has the high byte of the previous one and its own low byte, on all
    axes.

    The error is 256 codes (64 for the BMA180) if the high bytes of the two readings differ, as near 0. Reference: 1 %.
    """

    share: float = 0.01

    resembles: ClassVar[tuple[str, ...]] = ("glitches",)
    scaled: ClassVar[tuple[str, ...]] = ("share",)
    largest: ClassVar[float] = 1.0

    def put_on(self, site: Site) -> None:
        """Act in the latch, before the wire."""
        random = site.run_random("tears")
        low = 0xFF >> LAYOUTS[site.chip].shift
        before: Codes | None = None

        def latch(at_ns: int, codes: Codes) -> Codes:
            nonlocal before
            old, before = before, codes
            if old is None or random.random() >= self.share:
                return codes
            x, y, z = (high & ~low | code & low for high, code in zip(old, codes, strict=True))
            return x, y, z

        site.links.latches.append(latch)


SAME_BURST_NS = 1_000_000


@dataclass(frozen=True)
class InterleavedConverters(SensorMechanism):
    """Two converters alternate, and their offsets differ.

    Readings have the error +o and -o in turn, o = `offset_g` or `offset_dps`.

    Time-interleaved converters (Black and Hodges 1980), which alternate from burst to burst; conversions within
    `SAME_BURST_NS` belong to one burst. Reference: 4 mg or 0.15 dps.
    """

    offset_g: float = 4e-3
    offset_dps: float = 0.15
    scaled: ClassVar[tuple[str, ...]] = ("offset_g", "offset_dps")

    def put_on(self, site: Site) -> None:
        """Add the same offset to all axes, which use both converters."""
        offset, before_ns = site.by_unit(self.offset_g, self.offset_dps), 0

        def amplified(at_ns: int, value: Triple, full_scale: float) -> Triple:
            nonlocal offset, before_ns
            if at_ns > before_ns + SAME_BURST_NS:
                offset = -offset
            before_ns = at_ns
            return plus(value, (1.0, 1.0, 1.0), offset)

        site.chain.amplified.append(amplified)


class LimpingAdxl345(Adxl345Chip):
    """An ADXL345 that converts every `period_ns`, independent of its rate register."""

    period_ns = 0

    def _schedule(self, period_ns: int, at_ns: int) -> None:
        super()._schedule(self.period_ns or period_ns, at_ns)


class LimpingL3g4200d(L3g4200dChip):
    """An L3G4200D that converts every `period_ns`, independent of its rate bits."""

    period_ns = 0

    def _set_clock(self, ctrl1: int, at_ns: int, latest: int) -> None:
        super()._set_clock(ctrl1, at_ns, latest)
        self._period_ns = self.period_ns or self._period_ns


LIMPING: dict[str, type[Chip]] = {"adxl345": LimpingAdxl345, "l3g4200d": LimpingL3g4200d}


@dataclass(frozen=True)
class SlowOscillator(SensorMechanism):
    """The chip's own oscillator is slow: it converts less often than configured.

    `rate_hz` conversions a second on the chip's own grid; a reading that is requested in between is the previous one.

    The chip's ready flags show it. Reference: 40 Hz, slower as severity grows.
    """

    rate_hz: float = 40.0

    resembles: ClassVar[tuple[str, ...]] = ("stale_samples", "odr_error")
    inverse: ClassVar[tuple[str, ...]] = ("rate_hz",)

    def put_on(self, site: Site) -> None:
        """Set the rate error of a BMA180, which is a switch of its model; replace the class of other chips."""
        if site.chip == "bma180":
            site.switches["rate_error"] = self.rate_hz / UPDATE_HZ - 1
            return
        kind = type(f"Slow{site.chip}", (LIMPING[site.chip],), {"period_ns": round(1e9 / self.rate_hz)})
        site.kinds.append(lambda _: cast(Callable[..., Any], kind))


def without_bit(code: int, which: int) -> int:
    """Return `code` without its set bit number `which`, counted from the lowest; if it has fewer set bits, without the
    highest one.
    """
    bits = [bit for bit in range(code.bit_length()) if code >> bit & 1]
    return code & ~(1 << bits[min(which, len(bits) - 1)]) if bits else code


@contextmanager
def lost(page: bytearray, field: Field, which: int) -> Iterator[None]:
    """Clear the lost bit of the field in the register page within the block, as the divider receives it."""
    written = page[field.register.address]
    page[field.register.address] = field(without_bit(field.of(written), which)).into(written)
    try:
        yield
    finally:
        page[field.register.address] = written


class Divider:
    """A mix-in for a chip class: the actual effect of its rate bits."""

    which = 0
    page: bytearray

    def as_wired(self, field: Field) -> AbstractContextManager[None]:
        """Return a context in which the field lacks the lost bit."""
        return lost(self.page, field, self.which)


class DividedAdxl345(Divider, Adxl345Chip):
    """An ADXL345 whose rate follows BW_RATE (ADX-36)."""

    def _configure(self, at_ns: int) -> None:
        with self.as_wired(adxl345.RATE):
            super()._configure(at_ns)


class DividedBma180(Divider, Bma180Chip):
    """A BMA180 whose rate follows the filter code, because its rate can't be set (BMA-81 ... BMA-88)."""

    def _act(self, at_ns: int) -> None:
        with self.as_wired(bma180.BANDWIDTH):
            super()._act(at_ns)


class DividedL3g4200d(Divider, L3g4200dChip):
    """An L3G4200D whose rate follows DR (L3G-30 ... L3G-33)."""

    def _reconfigure(self, at_ns: int) -> None:
        with self.as_wired(l3g4200d.DATA_RATE):
            super()._reconfigure(at_ns)


DIVIDED: dict[str, type[Chip]] = {"adxl345": DividedAdxl345, "bma180": DividedBma180, "l3g4200d": DividedL3g4200d}


@dataclass(frozen=True)
class RateDivider(SensorMechanism):
    """A bit of the rate register does not reach the divider: it reads back as written but has no effect.

    Among the set bits of the rate code, number `lost_bit`, counted from the lowest, acts as 0. Rate and filter, and
    therefore the noise, are those of the remaining code. Reference: the lowest set bit; higher ones from severities 2
    and 4 on.
    """

    lost_bit: int = 0

    resembles: ClassVar[tuple[str, ...]] = ("odr_error",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return the mechanism with a more significant bit."""
        return cls(lost_bit=min(2, max(0, math.floor(math.log2(severity)))))

    def put_on(self, site: Site) -> None:
        """Replace the chip's class."""
        kind = type(f"Divided{site.chip}", (DIVIDED[site.chip],), {"which": self.lost_bit})
        site.kinds.append(lambda _: cast(Callable[..., Any], kind))


RANGES: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {"bma180": tuple(range_g for range_g, _ in BMA180.values()), "l3g4200d": tuple(dict.fromkeys(L3G4200D_DPS))}
)
"""Ranges of each chip, in g or dps, the smallest first."""


@dataclass(frozen=True)
class RangeSwitch(SensorMechanism):
    """The switch of the range bits does not close after some power-ups: the register reads back as written, the range
    differs.

    A wrong range: after every `every`-th power-up, the amplifier stays in the next smaller range than that of the range
    bits, or in the next larger one if that is the smallest. Codes are larger by the ratio and clip at their ends; the
    offset is that of the actual range (BMA-79). An ADXL345 in full resolution has one scale in all ranges (ADX-40) and
    therefore no switch.

    It resembles run 10 of BMA1 in the paper's Table 6. It has no severity, because the change is always a whole range;
    it occurs at every fourth power-up.
    """

    every: int = 4

    touches: ClassVar[tuple[str, ...]] = ("bma180", "l3g4200d")
    resembles: ClassVar[tuple[str, ...]] = ("range_reset",)

    def put_on(self, site: Site) -> None:
        """Choose the power-ups with the wrong range by the part; they never include the first two."""
        first = 2 + int(site.unit_random("range switch").integers(self.every))
        if site.run < first or (site.run - first) % self.every:
            return
        site.note(f"in a range of {_active_offset(site.chip, site.full_scale):g}")
        site.chain.full_scale.append(lambda full_scale: _active_offset(site.chip, full_scale))


def _active_offset(chip: str, asked: float) -> float:
    ranges = RANGES[chip]
    place = min(range(len(ranges)), key=lambda at: abs(ranges[at] - asked))
    return ranges[place - 1 if place else 1]


THRESHOLD_DPS = 100.0


@dataclass(frozen=True)
class AdaptiveRange(SensorMechanism):
    """A gyroscope that changes its full-scale range automatically, without new readings during the change.

    An adaptive range that stays on: when the magnitude of an axis crosses 100 dps, in either direction, the converter
    keeps its reading for `held_s`.

    An ICM-42688-P does this unless INTF_CONFIG1 disables it (TDK-18), which the driver sets and verifies; in this part
    the register reads back as written but has no effect. Reference: 1.5 ms (DEC-63).
    """

    held_s: float = 1.5e-3

    touches: ClassVar[tuple[str, ...]] = ("icm42688_gyro",)
    resembles: ClassVar[tuple[str, ...]] = ("adaptive_range",)
    scaled: ClassVar[tuple[str, ...]] = ("held_s",)

    def put_on(self, site: Site) -> None:
        """Hold all axes together, because they share the range."""
        was_inside: tuple[bool, ...] | None = None
        until_ns, shown = -1.0, (0.0, 0.0, 0.0)

        def hold(at_ns: int, value: Triple, full_scale: float) -> Triple:
            nonlocal was_inside, until_ns, shown
            inside = tuple(abs(part) < THRESHOLD_DPS for part in value)
            if was_inside is not None and inside != was_inside:
                until_ns = at_ns + self.held_s * 1e9
            was_inside = inside
            if at_ns >= until_ns:
                shown = value
            return shown

        site.chain.amplified.append(hold)
