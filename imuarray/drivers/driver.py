"""The interface of a driver to the poll loop (configure once, fetch a burst per frame, decode many at once), and
`Registers`, a chip's registers as a driver uses them: read, write, modify, each write verified by reading back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from imuarray.array import SensorConfig
from imuarray.arrays import Floats, Integers
from imuarray.bus.protocol import Bus
from imuarray.bus.spi import SpiChip
from imuarray.clock import Clock, sleep_for
from imuarray.errors import NOT_ACKNOWLEDGED, SensorError
from imuarray.facts.registers import Field, Register, Setting
from imuarray.log.format import OVERRUN, SATURATED, STALE


class Registers:
    """The registers of one chip at `address` of `bus`; `label` names it in messages ("BMA2 (bma180)
    at channel 0 ...").
    """

    def __init__(self, bus: Bus, address: int, label: str) -> None:
        self.bus = bus
        self.address = address
        self.label = label

    def peek(self, register: Register, count: int = 1) -> bytes:
        """Read `count` bytes from `register` on, in one transaction."""
        return self.bus.transfer(self.address, register.pointer, count)

    def peek_counting(self, register: Register, count: int) -> bytes:
        """Read `count` bytes from `register` on of an ST chip, whose address counts up if bit 7 is set (L3G-03,
        LIS-03).
        """
        return self.bus.transfer(self.address, bytes([register.address | 0x80]), count)

    def read_back(self, register: Register) -> int:
        """Read a register without affecting the measurement."""
        return self.peek(register, register.readback_bytes)[0]

    def poke(self, register: Register, value: int) -> None:
        """Write a whole register."""
        self.bus.transfer(self.address, bytes([register.address, value]))

    def change(self, setting: Setting) -> None:
        """Read, modify and write: other bits of the register (such as a factory trim) keep their value."""
        self.poke(setting.register, setting.into(self.peek(setting.register)[0]))

    def write(self, setting: Setting) -> None:
        """Write a setting; bits outside its mask keep their value."""
        if setting.mask == 0xFF:
            self.poke(setting.register, setting.value)
        else:
            self.change(setting)

    def store(self, setting: Setting) -> None:
        """Write a setting and read it back; bits outside its mask keep their value. SensorError as `verify`."""
        self.write(setting)
        self.verify(setting)

    def set(self, *settings: Setting) -> None:
        """Write each setting as a whole register and read it back, one after the other; SensorError as `verify`."""
        for setting in settings:
            self.poke(setting.register, setting.value)
            self.verify(setting)

    def set_step_by_step(self, *settings: Setting) -> Iterator[float]:
        """Do the same as `set`, and yield 0 after each setting, so that other chips can be read before the next."""
        for setting in settings:
            self.set(setting)
            yield 0.0

    def verify(self, setting: Setting) -> None:
        """Raise SensorError if the chip did not store `setting`."""
        kept = self.peek(setting.register)[0]
        if kept & setting.mask != setting.value:
            raise SensorError(
                f"{self.label}: register {setting.register.address:#04x} reads {kept:#04x} after"
                f" {setting.into(kept):#04x} was written; the chip refuses its configuration"
            )

    def expect(self, *registers: Register, relatives: Mapping[int, str] = MappingProxyType({})) -> None:
        """Raise SensorError unless a chip answers whose identity registers have the values of the data sheet.
        `relatives` names other chips at these addresses, by the value of the first register.
        """
        try:
            identity = b"".join(self.peek(register) for register in registers)
        except OSError as error:
            if error.errno not in NOT_ACKNOWLEDGED:
                raise SensorError(f"{self.label}: the bus fails: {error.strerror or error}") from error
            raise SensorError(f"{self.label}: no chip acknowledges this address") from error
        expected = bytes(register.reset for register in registers)
        if identity != expected:
            what = f", {relatives[identity[0]]}" if identity[0] in relatives else ""
            if not what and isinstance(self.bus, SpiChip) and set(identity) in ({0x00}, {0xFF}):
                what = ", which is a line that no chip drives"
            raise SensorError(f"{self.label}: identity {identity.hex(' ')}{what}, expected {expected.hex(' ')}")


Bytes = npt.NDArray[np.uint8]
Limits = tuple[tuple[float, float], ...]
"""Lowest and highest value of each axis."""


class DecodedBursts(NamedTuple):
    """The readings of n bursts.

    counts (n, 3) int16 for triads (int32 for chips of more bits), (n, 2) int32 for barometers; temperature_counts (n,)
    int16 where the chip has a thermometer; status (n,) uint16, flags of `imuarray.log.format` that follow from the
    burst; `compensated`: further columns in physical units by name, where the chip's own calibration gives them.
    """

    counts: npt.NDArray[np.int16] | npt.NDArray[np.int32]
    temperature_counts: npt.NDArray[np.int16] | None
    status: npt.NDArray[np.uint16]
    compensated: Mapping[str, Floats] = {}


def barometer_readings(ut: Integers, up: Integers, temperature_degc: Floats, pressure_pa: Floats) -> DecodedBursts:
    """Return the readings of a barometer: its words UT and UP (n,) as counts, the physical values that follow from
    them, and no flags.
    """
    counts = np.stack([ut, up], axis=1).astype(np.int32)
    compensated = {"temperature": temperature_degc, "pressure": pressure_pa}
    return DecodedBursts(counts, None, np.zeros(len(counts), np.uint16), compensated)


class SelfTest(NamedTuple):
    """The result of a chip's self-test, a text with numbers; `passed` is None where it could not be determined: the
    chip could not be read often enough, or it moved meanwhile.
    """

    passed: bool | None
    text: str


def compare_readings(before: Floats, during: Floats, limits: Limits, text: str, *, still: float) -> SelfTest:
    """Compare (n, 3) readings before a self-test with (m, 3) during it: the test passes if the difference of their
    means is within `limits`.

    The result is undetermined if the readings of either scatter by more than `still` (one standard deviation), because
    the box moved. `text` is a template with {change}.
    """
    change = during.mean(axis=0) - before.mean(axis=0)
    result = text.format(change=", ".join(f"{value:+.3g}" for value in change))
    if max(before.std(axis=0).max(), during.std(axis=0).max()) > still:
        return SelfTest(None, f"{result}; it moved during the test: keep it at rest and try again")
    return SelfTest(within(change, limits), result)


def within(values: Floats, limits: Limits) -> bool:
    """Return whether each of three values lies within its limits."""
    return all(low <= value <= high for value, (low, high) in zip(values, limits, strict=True))


class Driver(Protocol):
    """The interface of one chip for the poll loop.

    `watched` are the settings that the chip must keep while it measures; reading them back does not affect readings.
    """

    burst: ClassVar[int]
    """Length of one fetched burst in bytes."""
    has_data_ready: ClassVar[bool]
    """True if the burst shows whether the reading is new; if not, the logger compares it with the one before."""
    watched: tuple[Setting, ...]
    registers: Registers

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None: ...

    @property
    def reading(self) -> slice:
        """Position of the reading in a burst, without status and temperature; bursts are compared by these bytes."""

    def identify(self) -> None:
        """Check that this chip answers; SensorError."""

    def steps(self) -> Iterator[float]:
        """Set the chip up from any state, and verify the settings, step by step; yield the seconds to wait before each
        next step.

        A poll loop reads other chips during a wait. SensorError if the chip does not store a setting.
        """

    def configure(self) -> None:
        """Carry out all `steps`, with their waits."""

    def mark(self, code: int) -> bool:
        """Write `code`, 1 ... 31, to an unused register from the next `steps` on, and verify it with the configuration.

        It distinguishes this chip from its twin at the same address of another channel. False if there is no such
        register.
        """

    def self_test(self) -> SelfTest:
        """Run the chip's self-test, compare the response with the limits of the data sheet, and configure the chip
        again.

        The result is undetermined if the chip could not be read often enough, or moved during the test (`SelfTest`).
        """

    def fetch(self) -> bytes:
        """Return one burst of one instant; empty if there is no reading yet. OSError from the bus.

        A driver that drains a queue (`FifoDriver`) returns any number of bursts.
        """

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """Decode (n, burst) bytes; the chip is not accessed."""

    def header(self) -> Mapping[str, int] | Mapping[str, float]:
        """Return attributes of the chip that its log needs (the barometer's calibration words)."""


class QueueTimes(Protocol):
    """The times of the samples that were drained last (`FifoClock`)."""

    drained: list[int]

    @property
    def gaps(self) -> Sequence[int]:
        """Places in `drained`, counted from 0, before which samples are missing."""

    @property
    def uncertainties_ns(self) -> Sequence[float]:
        """Largest error of each time in `drained`; empty where it is not known."""

    def restart(self) -> None:
        """Discard the state: the chip was set up again, or another chip's queue was drained in its place."""


@runtime_checkable
class FifoDriver(Protocol):
    """A driver whose `fetch` drains a queue: any number of bursts, with the times of `queue`."""

    queue: QueueTimes


@runtime_checkable
class RemarkingDriver(Protocol):
    """A driver of a chip that may have a setting with which readings are wrong."""

    def remark(self) -> str:
        """Read the present settings, before the chip is configured, and return a remark on them; empty if there is
        none. OSError from the bus.
        """


@runtime_checkable
class OnDemandDriver(Protocol):
    """A driver of a chip that converts on command: `fetch` reads the result and starts the next conversion.

    `conversions_ns` are the longest durations of the conversions of a reading, in order. A result is used until
    `lasting_ns` after its conversion, unless `fetch` is called less often than that.
    """

    conversions_ns: ClassVar[tuple[int, ...]]
    lasting_ns: ClassVar[int]

    @property
    def ready_ns(self) -> int | None:
        """The latest end of the conversion in progress; None if there is none."""


def carry_out(clock: Clock, steps: Iterator[float]) -> None:
    """Carry out all steps of a set-up, with their waits."""
    for seconds in steps:
        sleep_for(clock, seconds)


class ChipDriver:
    """The common part of the drivers of this package: the registers of one chip, a set-up with waits, and bursts of one
    transaction.

    `clock` is the bus's; `relatives` names other chips that answer at its addresses, by identity.
    """

    burst: ClassVar[int]
    first: ClassVar[Register]
    """Register at which a burst begins."""
    unused: ClassVar[Register | None] = None
    """A register without effect, which distinguishes the chip from its twins; a chip that has none can't be marked."""
    relatives: ClassVar[Mapping[int, str]] = MappingProxyType({})
    settings: tuple[Setting, ...] = ()
    watched: tuple[Setting, ...] = ()

    def __init__(self, bus: Bus, sensor: SensorConfig, clock: Clock) -> None:
        self.registers = registers_for(sensor, bus)
        self.identity = sensor.spec.identity
        self.clock = clock

    def identify(self) -> None:
        """Check the register that identifies the chip; SensorError names a relative or a clone."""
        self.registers.expect(self.identity, relatives=self.relatives)

    def steps(self) -> Iterator[float]:
        """Set the chip up, as `Driver.steps`."""
        raise NotImplementedError

    def configure(self) -> None:
        """Carry out all `steps`, with their waits."""
        carry_out(self.clock, self.steps())

    def mark(self, code: int) -> bool:
        """Mark the chip in its register `unused`, as `Driver.mark`."""
        if self.unused is None:
            return False
        setting = self.unused[7:0](code)
        self.settings, self.watched = (*self.settings, setting), (*self.watched, setting)
        return True

    def fetch(self) -> bytes:
        """Read one burst."""
        return self.registers.peek(self.first, self.burst)

    def triads(
        self, read: Callable[[], bytes], settle_s: float, period_s: float, *, count: int = 32, order: str = "<i2"
    ) -> Floats:
        """Return counts (count, 3) for a self-test: `read` returns a triad of words of the given byte order; it is
        called once per period, for the first time a period after `settle_s`.
        """
        sleep_for(self.clock, settle_s)
        triads = []
        for _ in range(count):
            sleep_for(self.clock, period_s)
            triads.append(np.frombuffer(read(), order))
        return np.array(triads, np.float64)

    def header(self) -> Mapping[str, int] | Mapping[str, float]:
        """Return no attributes."""
        return {}


def registers_for(sensor: SensorConfig, bus: Bus) -> Registers:
    """Return the registers of `sensor` on `bus`, labelled for messages."""
    return Registers(bus, sensor.address, f"{sensor.name} ({sensor.chip}) at {sensor.place}")


def words16(data: Bytes, order: str = "<i2") -> npt.NDArray[np.int16]:
    """Return (n, k) signed words of 16 bits from (n, 2 k) bytes in this byte order."""
    return np.ascontiguousarray(data).view(order).astype(np.int16)


def flag_bits(bits: Bytes, mask: int, flag: int) -> npt.NDArray[np.uint16]:
    """Return `flag` for each of (n,) status bytes in which `mask` is set."""
    return np.where(bits & mask, flag, 0).astype(np.uint16)


def flag_freshness(states: Bytes, available: Field, overrun: Field) -> npt.NDArray[np.uint16]:
    """Return the flags of readings by (n,) status bytes: stale where no new reading was `available`, and `overrun`
    where a reading was replaced before it was read.
    """
    return flag_bits(~states, available.mask, STALE) | flag_bits(states, overrun.mask, OVERRUN)


def flag_saturated(
    counts: npt.NDArray[np.int16] | npt.NDArray[np.int32], low: int, high: int
) -> npt.NDArray[np.uint16]:
    """Flag SATURATED for each row of (n, 3) counts with an axis at or beyond an end of the code span."""
    at_end = ((counts <= low) | (counts >= high)).any(axis=1)
    return np.where(at_end, SATURATED, 0).astype(np.uint16)
