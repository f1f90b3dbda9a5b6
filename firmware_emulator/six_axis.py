"""A die with two sensors of the array in one place, an accelerometer and a gyroscope."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from firmware_emulator.chip import NEVER_NS, Chip, Element, Triple
from firmware_emulator.tolerances import Sheet
from imuarray.facts.registers import Field, Register

ACCELEROMETER, GYROSCOPE = "accelerometer", "gyroscope"


@dataclass
class SampleGrid:
    """The grid of the samples: sample n = 1, 2, ... is at `start_ns` + n * `period_ns`; `index` is the number of the
    latest one, counted from 0.
    """

    start_ns: int = NEVER_NS
    period_ns: int = 1_000_000
    index: int = -1

    def latest(self, at_ns: int) -> int:
        """Return the number of the latest sample at `at_ns`; -1 before the first."""
        return (at_ns - self.start_ns) // self.period_ns - 1 if at_ns >= self.start_ns else -1

    def time_ns(self, index: int) -> int:
        """Return the time of the sample with this number."""
        return self.start_ns + (index + 1) * self.period_ns

    def take(self, at_ns: int) -> int | None:
        """Return the time of the latest sample, if it has not been taken yet."""
        latest = self.latest(at_ns)
        if latest <= self.index:
            return None
        self.index = latest
        return self.time_ns(latest)

    def set(self, at_ns: int, period_ns: int) -> bool:
        """Set the period, 0 for off. Samples restart if the period changes or was 0. Return True if it was 0."""
        if not period_ns:
            self.start_ns = NEVER_NS
            return False
        was_off = self.start_ns == NEVER_NS
        if was_off or period_ns != self.period_ns:
            self.start_ns, self.index = at_ns, -1
        self.period_ns = period_ns
        return was_off


class SixAxis(Chip):
    """Registers with two elements behind them. It is created with the `elements` of one half or of both, by half;
    `take_element` adds the other one. The converter of a half without an element has an input of zero.
    """

    reset_bit: ClassVar[Field]
    reset_ns: ClassVar[int]

    def __init__(
        self,
        address: int,
        elements: Mapping[str, Element],
        powered_on_ns: int = 0,
        *,
        identity: int | None = None,
        rate_error: float = 0.0,
        pulse_hz: float = 0.0,
    ) -> None:
        """Create the die. `rate_error` is the relative rate error of its oscillator. `pulse_hz` is the frequency of the
        pulses at its synchronisation input (0: not connected). They are short, at multiples of their period on the
        clock of the bus, so that they are the same for all chips.
        """
        self._oscillator = 1 + rate_error
        self._pulse_ns = round(1e9 / pulse_hz) if pulse_hz else 0
        self._elements = dict(elements)
        super().__init__(address, next(iter(elements.values())), powered_on_ns, identity=identity)

    def own_period_ns(self, period_ns: float) -> int:
        """Return the duration, by the die's oscillator, of a period with this nominal length."""
        return round(period_ns / self._oscillator)

    def latest_pulse_ns(self, at_ns: int) -> int | None:
        """Return the time of the last pulse up to `at_ns`; None without pulses."""
        return at_ns - at_ns % self._pulse_ns if self._pulse_ns else None

    def is_marked(self, grid: SampleGrid, at_ns: int) -> bool:
        """Return whether a pulse occurred between the previous sample and that at `at_ns`."""
        pulse_ns = self.latest_pulse_ns(at_ns)
        return pulse_ns is not None and pulse_ns > at_ns - grid.period_ns

    def power_on(self, at_ns: int) -> None:
        """Set every register to its reset value; no reset is in progress."""
        super().power_on(at_ns)
        self._reset_end_ns = at_ns

    def begin_reset(self, address: int, value: int, at_ns: int) -> bool:
        """Power on again if this byte sets the reset bit, which then reads 1 until the reset ends."""
        if address != self.reset_bit.register.address or not value & self.reset_bit.mask:
            return False
        self.reset(at_ns)
        self.page[address] |= self.reset_bit.mask
        self._reset_end_ns = at_ns + self.reset_ns
        return True

    def end_reset(self, at_ns: int) -> None:
        """Clear the reset bit if the reset has ended."""
        if at_ns >= self._reset_end_ns:
            self.page[self.reset_bit.register.address] &= ~self.reset_bit.mask & 0xFF

    def take_element(self, half: str, element: Element) -> None:
        """Add the element of the other half; ValueError if this half already has one."""
        if half in self._elements:
            raise ValueError(f"two sensors are the {half} of one {type(self).__name__}")
        self._elements[half] = element

    def sample(self, half: str, at_ns: int, full_scale: float, bandwidth_hz: float, delay_s: float = 0.0) -> Triple:
        """Return the input of one half's converter, in g or dps, `delay_s` before `at_ns`."""
        element = self._elements.get(half)
        input_ns = max(self.powered_on_ns, at_ns - round(delay_s * 1e9)) if delay_s else at_ns
        return (0.0, 0.0, 0.0) if element is None else element.sample(input_ns, full_scale, bandwidth_hz)

    def degc(self, at_ns: int) -> float:
        """Return the temperature of the die."""
        return next(iter(self._elements.values())).temperature(at_ns)


class Half(NamedTuple):
    """One sensor of a die: its half, the first register of its triad, and the tolerances of its units."""

    name: str
    first: Register
    sheet: Sheet


class Die(NamedTuple):
    """The properties of a six-axis chip: its class, and for both halves, accelerometer first, the first register of the
    triad and the tolerances of the data sheet.
    """

    build: Callable[..., SixAxis]
    first: tuple[Register, Register]
    sheets: tuple[Sheet, Sheet]

    @property
    def halves(self) -> dict[str, Half]:
        """Return both halves by the suffix of the die's name."""
        return {
            suffix: Half(name, first, sheet)
            for suffix, name, first, sheet in zip(
                ("acc", "gyro"), (ACCELEROMETER, GYROSCOPE), self.first, self.sheets, strict=True
            )
        }


def clipped(code: int, lowest: int = -32768) -> int:
    """Return a code within the span of 16 bits, of which `lowest` is the lower end."""
    return max(lowest, min(32767, code))
