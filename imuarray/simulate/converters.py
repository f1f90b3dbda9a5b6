"""Conversion of each chip's element signal: codes, and the temperature that its own thermometer reads.

Codes are rounded to the nearest multiple of the step and end at the code span. Sensitivities are those of
`imuarray.chips`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Integers, Reals
from imuarray.chips import CHIPS, die_of
from imuarray.log.format import SensorHeader
from imuarray.simulate.signal import Analog, Codes, Counts
from imuarray.thermometers import ChipThermometer

EVEN_ONLY_FROM_HZ = 1600.0
"""Data rate of the ADXL345 from which its lowest bit is always 0 in full resolution (ADX-47)."""

_NEAREST = 0.75
"""Fraction of a configured rate. An actual rate above it is taken to be this setting and not the next lower one,
because the rates of the ADXL345 are octaves apart (ADX-32).
"""

_ON_TIME = 1e-6
_ROUNDED_S = 1e-9
"""Tolerances of a due time, as a fraction of a period and in s (the rounding of times). A reading that is due within
the larger of the two counts as made.
"""


@dataclass(frozen=True)
class CodeSpan:
    """The lowest and highest code, the step between codes that occur, and the code delivered beyond them."""

    lowest: int
    highest: int
    step: int = 1
    beyond: int | None = None


THERMOMETERS: Mapping[str, ChipThermometer] = MappingProxyType(
    {chip: spec.thermometer for chip, spec in CHIPS.items() if spec.thermometer is not None}
    | {"l3g4200d": ChipThermometer(47.0, -1.0)}  # the zero differs from part to part; this one is assumed (L3G-60)
)

_COUNT_BITS = 16
"""Bits of the column `temperature_counts`, because a log does not state the bits of a thermometer."""


def thermometer_of(header: SensorHeader) -> ChipThermometer | None:
    """Return the chip's own thermometer, from its header or otherwise from its data sheet; None if the chip has none,
    or if the meaning of its counts is unknown.
    """
    if not header.has_temperature:
        return None
    scale = header.thermometer
    return THERMOMETERS.get(header.chip) if scale is None else ChipThermometer(*scale, bits=_COUNT_BITS)


def thermometer_counts(thermometer: ChipThermometer, temperature_degc: Reals) -> Counts:
    """Return the codes (n,) of a thermometer at these temperatures."""
    if temperature_degc.strides == (0,):  # a constant temperature: one row stands for all
        return np.broadcast_to(thermometer_counts(thermometer, temperature_degc[:1].copy()), temperature_degc.shape)
    codes = np.rint((temperature_degc - thermometer.zero_degc) * thermometer.lsb_per_degc)
    beyond = 1 << (thermometer.bits - 1)
    return np.asarray(np.clip(codes, -beyond, beyond - 1), np.int32)


def even_step(chip: str, rate_hz: float) -> int:
    """Return 2 for an ADXL345 at a rate at which only even codes occur (ADX-47), otherwise 1. The actual rate may be up
    to 25 % below the configured one (`_NEAREST`).
    """
    return 2 if chip == "adxl345" and rate_hz >= _NEAREST * EVEN_ONLY_FROM_HZ else 1


def adxl345_bandwidth_hz(rate_hz: float) -> float:
    """Return the bandwidth of the ADXL345's noise in Hz: half the data rate (ADX-32), but at least 50 Hz (ADX-68)."""
    return max(rate_hz, 100.0) / 2


def code_span(sensor: SensorHeader) -> CodeSpan:
    """Return the code span of a triad as it is configured (ADX-46, BMA-60, HMC-32, TDK-13); for other chips, the span
    of all bits.
    """
    if sensor.chip == "adxl345":
        half = round(sensor.range * 256)
        step = even_step(sensor.chip, sensor.rate_hz)
        return CodeSpan(-half, half - step, step)
    if sensor.chip == "bma180":
        return CodeSpan(-8192, 8191)
    if sensor.chip in ("hmc5883", "hmc5883l"):
        return CodeSpan(-2048, 2047, beyond=-4096)
    if die_of(sensor.chip) == "icm42688":
        highest = (1 << sensor.count_bits - 1) - 1
        return CodeSpan(-highest, highest)
    return CodeSpan(-(1 << sensor.count_bits - 1), (1 << sensor.count_bits - 1) - 1)


def convert(analog: Analog, span: CodeSpan) -> Counts:
    """Convert an analog signal to counts (n, 3)."""
    scaled = analog.value + analog.noise
    scaled *= analog.sensitivity / analog.step
    codes = np.rint(scaled, out=scaled)
    if np.any(analog.step != 1):
        codes *= analog.step
    if span.beyond is not None:
        codes[(codes < analog.lowest) | (codes > analog.highest)] = span.beyond
    else:
        np.clip(codes, analog.lowest, analog.highest, out=codes)
    return np.asarray(codes, np.int32)


def latest_reading(instant_ns: Integers, rate_hz: float, phase: float = 0.0) -> Integers:
    """Return the time at which the chip made the reading that it delivers at `instant_ns` (n,). The chip makes
    `rate_hz` readings a second, one of them `phase` periods before time 0. For a chip without a rate this is the
    instant itself.
    """
    if rate_hz <= 0:
        return instant_ns
    latest = _reading(instant_ns, rate_hz, phase)
    latest -= phase
    latest *= 1e9 / rate_hz
    return np.asarray(np.rint(latest, out=latest), np.int64)


def _reading(instant_ns: Integers, rate_hz: float, phase: float) -> Reals:
    """Return the number of the latest reading; a reading that is due at exactly that instant is included."""
    periods = instant_ns * (rate_hz * 1e-9)
    periods += max(_ON_TIME, _ROUNDED_S * rate_hz) + phase
    return np.asarray(np.floor(periods, out=periods))


def hold_readings(codes: Codes, rate_hz: float, phase: float = 0.0) -> Codes:
    """Return the readings of a chip that is polled faster than its `rate_hz` (one reading is `phase` periods before
    time 0): the latest reading is repeated and not fresh.
    """
    sample = _reading(codes.instant_ns, rate_hz, phase)
    fresh = np.concatenate([[True], np.diff(sample) > 0])
    newest = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
    return replace(codes, counts=codes.counts[newest], fresh=codes.fresh[newest] & fresh)
