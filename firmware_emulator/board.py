"""Parts of the emulated array, and the host, from which `open_array` assembles it.

`Board` creates the parts of the array's description. A board with other parts (`firmware_emulator.mechanisms`)
overrides single methods; the array is assembled and polled in the same way.

`ArrayLike` is the description of an array as the emulator needs it; `imuarray.array` satisfies it.

`Pca9544aChip` has one control byte that selects which of four channels is connected to the trunk, if any (NXP data
sheet Rev 5, 2014). The byte can be read back immediately, but the wires are switched only by the STOP that ends the
transaction (PCA-06, DEC-40), even if that transaction was aborted (DEC-41).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from firmware_emulator.chip import Chip, Element, Target
from firmware_emulator.chips import CHIPS
from firmware_emulator.clock import WireClock
from firmware_emulator.element import IDENTITY, Matrix, SensingElement
from firmware_emulator.units import unit_of
from firmware_emulator.wire import Wire
from firmware_emulator.world import World
from imuarray.facts import pca9544a as facts

NO_CHANNEL = -1


class Pca9544aChip:
    """The multiplexer as a device on the trunk; `channels` holds the devices behind each of its channels.

    `route` is the channel that is connected now, `NO_CHANNEL` if none. `interrupts` are the inputs INT3 ... INT0 as
    bits 3:0, 1 where an input is pulled low (PCA-12).
    """

    def __init__(
        self, address: int, channels: Mapping[int, Sequence[Target]] | None = None, powered_on_ns: int = 0
    ) -> None:
        self.address = address
        self.channels = {channel: tuple((channels or {}).get(channel, ())) for channel in facts.CHANNELS}
        self.interrupts = 0
        self.power_on(powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Reset the control register to 0: no channel is connected (PCA-05)."""
        self.control = facts.CONTROL.reset
        self.route = NO_CHANNEL

    @property
    def ordered(self) -> int:
        """The channel that the control register selects, `NO_CHANNEL` if none."""
        return facts.CHANNEL.of(self.control) if facts.ENABLE.of(self.control) else NO_CHANNEL

    def branch(self) -> Sequence[Target]:
        """Return the devices that are joined to the trunk now."""
        return self.channels.get(self.route, ())

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write every byte to the control register, which keeps the last one (PCA-02, PCA-08)."""
        if data:
            self.control = data[-1] & (facts.ENABLE.mask | facts.CHANNEL.mask)
        return len(data)

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Return the control register, repeated `count` times."""
        return bytes([self.interrupts << 4 & 0xF0 | self.control]) * count

    def stop(self, at_ns: int) -> None:
        """Connect the channel that the control register selects."""
        self.route = self.ordered


class MuxLike(Protocol):
    """A multiplexer in the description of an array."""

    @property
    def chip(self) -> str:
        """The chip: only "pca9544a"."""

    @property
    def address(self) -> int:
        """The address on the trunk."""


class SensorLike(Protocol):
    """A sensor in the description of an array."""

    @property
    def name(self) -> str:
        """The name, unique in the array."""

    @property
    def chip(self) -> str:
        """A key of `CHIPS`."""

    @property
    def channel(self) -> int | None:
        """The channel of the multiplexer; None for one on a trunk."""

    @property
    def bus(self) -> str | None:
        """A trunk other than the array's own: a channel that the kernel drives."""

    @property
    def address(self) -> int:
        """The address, seven bits."""

    @property
    def range(self) -> float | None:
        """Full scale in g, dps or gauss; None for a chip without ranges."""

    @property
    def orientation(self) -> Matrix:
        """box = orientation @ sensor."""


class ArrayLike(Protocol):
    """The description of an array."""

    @property
    def name(self) -> str:
        """ "martin2013" for the paper's array, of which the units are known."""

    @property
    def mux(self) -> MuxLike | None:
        """The multiplexer on the trunk, if any."""

    @property
    def sensors(self) -> Sequence[SensorLike]:
        """Every chip."""


T = TypeVar("T")
MUXES = {"pca9544a": Pca9544aChip}


def named(name: str, entries: Mapping[str, T], kind: str) -> T:
    """Return the entry of that name; the ValueError for an unknown name lists the others."""
    if name not in entries:
        raise ValueError(f"{kind} {name!r}; {allowed_text(name, entries)}")
    return entries[name]


def allowed_text(name: str, entries: Iterable[str]) -> str:
    """Return "allowed are A, B", and "; did you mean A?" if a known name resembles `name`."""
    from difflib import get_close_matches

    names = {word.casefold(): word for word in entries}
    near = get_close_matches(name.casefold(), list(names), n=1)
    return f"allowed are {', '.join(names.values())}" + (f"; did you mean {names[near[0]]}?" if near else "")


class Board:
    """The parts of the array called `array`, in `world`; `seed` keys noise and the units that are drawn."""

    def __init__(self, array: str, world: World, seed: int) -> None:
        self.array = array
        self.world = world
        self.seed = seed

    def wire(self, clock: WireClock, bit_rate_hz: int, nack_errno: int, host_ns: int) -> Wire:
        """Return the wire of one adapter."""
        return Wire(clock, bit_rate_hz, nack_errno, host_ns)

    def router(
        self, chip: str, address: int, channels: Mapping[int, Sequence[Target]], powered_on_ns: int
    ) -> Pca9544aChip:
        """Return the multiplexer; ValueError for an unknown chip."""
        return named(chip, MUXES, "mux")(address, channels, powered_on_ns)

    def element(self, sensor: SensorLike) -> Element:
        """Return the sensing element of one sensor, with its unit's imperfections."""
        unit = unit_of(self.array, sensor.name, sensor.chip, sensor.range or 0.0, self.seed)
        orientation = IDENTITY if sensor.orientation is None else sensor.orientation
        return SensingElement(self.world, sensor.chip, sensor.name, orientation, unit, self.seed)

    def kind(self, sensor: SensorLike) -> Callable[..., Chip]:
        """Return the builder of one sensor's chip; ValueError for a chip that isn't known."""
        return named(sensor.chip, CHIPS, f"sensor {sensor.name}: chip")

    def switches(self, sensor: SensorLike) -> Mapping[str, Any]:
        """Return keyword arguments of that chip; those of the caller take precedence."""
        return {}

    def generator_key(self, sensor: SensorLike) -> str:
        """Return the key of the noise that a chip draws itself."""
        return f"{self.seed} {sensor.name}"

    def device(self, sensor: SensorLike, chip: Chip) -> Target:
        """Return the device that is connected to the wire for one sensor: the chip, or a device in front of it."""
        return chip

    def owned(self, address: int, bus: str, clock: WireClock) -> bool:
        """Return True if a kernel driver has claimed this address of this bus."""
        return False

    def host_clock(self, clock: WireClock) -> WireClock:
        """Return the clock that the polling program reads and sleeps on; `clock` is that of the world."""
        return clock


BoardKind = Callable[[str, World, int], Board]
"""Function that creates a board from the name of the array, the world and the seed."""
