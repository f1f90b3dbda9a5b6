"""`glitches`: single readings are corrupted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.simulate.converters import code_span
from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.parameters import listed
from imuarray.simulate.signal import Codes, Counts, Place

KINDS = ("spike", "torn", "word")

_WORD = -32768, 32767
"""Number of values of two bytes, independent of the chip's range."""

_LOW_BITS = {"bma180": 6}
"""Number of bits of the code in the low byte, of chips for which it is not eight (BMA-60)."""


def high_byte(chip: str) -> int:
    """Return the counts that one unit of the high byte stands for."""
    return 1 << _LOW_BITS.get(chip, 8)


@dataclass(frozen=True)
class Glitches(Effect):
    """Each reading is corrupted with `probability`, in one of three ways (`kind`).

    "spike": one axis, drawn at random, is off by plus or minus `amplitude` (in the sensor's unit, at its nominal
    sensitivity), within its codes. "torn": one axis, drawn at random, has the low byte of this reading and the high
    byte of the previous row, because the chip updated its registers between two bytes of a burst (L3G-50, ADX-49,
    BMA-101). The low byte of a BMA180 holds six bits of the code (BMA-60), that of all other chips eight. "word": all
    axes read -1, as from a bus that no chip drives, whose lines float high (UM10204, 3.1.1). In data: heavy tails; torn
    readings are off by multiples of 256 (BMA180: 64) counts, and only if neighbours differ in the high byte; for a
    gyroscope at rest, -1 is a normal small reading.

    If the corrupted readings are known, exactly these are: the reading due at each of `moments_s`, in seconds since the
    log's epoch, of the run with that number in `runs`, is off by three values of `jumps`, one for each axis, in the
    sensor's unit.
    """

    name: ClassVar[str] = "glitches"
    probability: float = scalar(0.0, low=0.0, high=1.0)
    amplitude: float = scalar(0.0, suffix="_{u}", low=0.0, high=1e6)
    kind: str = field(default="spike")
    runs: tuple[float, ...] = listed()
    moments_s: tuple[float, ...] = listed()
    jumps: tuple[float, ...] = listed(suffix="_{u}")

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown kind, or for lists of different lengths."""
        super().__post_init__()
        if self.kind not in KINDS:
            raise ValueError(f"kind: {self.kind!r}; allowed are {', '.join(KINDS)}")
        for name in ("runs", "moments_s", "jumps"):
            object.__setattr__(self, name, tuple(float(value) for value in getattr(self, name)))
        if not (len(self.runs) == len(self.moments_s) == len(self.jumps) / 3):
            raise ValueError(
                f"moments_s: {len(self.moments_s)}; as many runs and three times as many jumps are required"
            )

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes have a jump of known size."""
        return tuple(any(self.jumps[axis::3]) for axis in range(3))

    def lookback(self, at: Place) -> int:
        """Return 1 if readings are torn or glitches have given moments, because these depend on the previous row."""
        if self.moments_s:
            return 1
        return 1 if self.probability and self.kind == "torn" else 0

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Corrupt rows of counts; flags and temperature do not change."""
        if self.moments_s:
            return replace(codes, counts=self._hit(codes, at))
        if not self.probability:
            return codes
        stream = at.streams.of_boot(at.sensor.name, self.name, self.kind, width=2)  # double precision: rare events
        hit, choice = stream.uniform(codes.first, codes.first + len(codes.counts)).T
        struck = (hit < self.probability)[:, None]
        axis, upwards = np.divmod(np.floor(choice * 6).astype(np.int32), 2)
        if self.kind == "word":
            return replace(codes, counts=np.where(struck, -1, codes.counts))
        wrong = _torn(codes.counts, at) if self.kind == "torn" else self._excursion(codes.counts, upwards * 2 - 1, at)
        return replace(codes, counts=np.where(struck & (np.arange(3) == axis[:, None]), wrong, codes.counts))

    def _hit(self, codes: Codes, at: Place) -> Counts:
        of_boot = np.array(self.runs) == at.streams.boot
        due_ns = np.array(self.moments_s)[of_boot] * 1e9
        rows = np.searchsorted(codes.instant_ns, due_ns)
        in_block = (rows < len(codes.counts)) & ((rows > 0) | (codes.first == 0))  # others belong to earlier rows
        jumps = np.rint(np.array(self.jumps).reshape(-1, 3)[of_boot] * at.sensor.sensitivity).astype(codes.counts.dtype)
        counts = codes.counts.copy()
        np.add.at(counts, rows[in_block], jumps[in_block])
        return np.asarray(np.clip(counts, *_WORD))

    def _excursion(self, counts: Counts, sign: Counts, at: Place) -> Counts:
        span = code_span(at.sensor)
        jump = round(self.amplitude * at.sensor.sensitivity)
        return np.asarray(np.clip(counts + sign[:, None] * jump, span.lowest, span.highest))


def _torn(counts: Counts, at: Place) -> Counts:
    """Return readings with the low byte of their own code and the high byte of the previous one (two's complement)."""
    low = high_byte(at.sensor.chip) - 1
    previous = np.concatenate([counts[:1], counts[:-1]])
    return (previous & ~low) | (counts & low)
