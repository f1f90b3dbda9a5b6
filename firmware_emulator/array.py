"""A whole emulated array: a wire per bus, the multiplexer, chips with their units' imperfections, one world, one clock.

The description of the array is duck-typed (`firmware_emulator.board`).
"""

from __future__ import annotations

import errno
import math
import os
import random
from collections.abc import Callable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Self

from firmware_emulator.board import ArrayLike, Board, BoardKind, SensorLike, allowed_text, named
from firmware_emulator.chip import Chip, Target, TargetProxy
from firmware_emulator.chips import BAROMETERS, CHIPS, HALVES, ON_AUXILIARY_BUS
from firmware_emulator.chips.mpu_queue import MpuFamily
from firmware_emulator.clock import RealClock, VirtualClock, WireClock
from firmware_emulator.element import stream
from firmware_emulator.six_axis import SixAxis
from firmware_emulator.spi import DIALECTS, ChipSelect, ChipSelectPort
from firmware_emulator.tolerances import typical
from firmware_emulator.wire import Wire
from firmware_emulator.world import WORLDS, DelayedWorld, PhasedWorld, StillWorld, World, WorldKind, WorldPhase
from imuarray.facts import mpu6500

NOWHERE = -1


class BehindBypass(TargetProxy):
    """A device that has its address while the bypass of `host` is open, or always if it has no host."""

    host: MpuFamily | None = None

    @property
    def address(self) -> int:
        """The device's address; an unused one while the bypass is open."""
        return self.device.address if self.host is None or self.host.bypass_open else NOWHERE

    @address.setter
    def address(self, value: int) -> None:
        self.device.address = value


TRUNK = ""
SPI_DEVICE = "/dev/spidev"
"""Prefix of the bus name of a sensor on SPI."""
CLOCKS: dict[str, type[VirtualClock] | type[RealClock]] = {"virtual": VirtualClock, "real": RealClock}
Switches = Mapping[str, Mapping[str, Any]]
ERRNOS = (6, 121)
"""The errors of Linux adapters when no chip acknowledges (LNX-40, LNX-41)."""
SETTINGS = ("clock", "world", "seed", "bit_rate", "errno", "oscillators", "pulse_hz")
OSCILLATORS = ("exact", "drawn")
OSCILLATOR_ERROR = typical(0.01)
"""Relative rate error of the oscillator of a six-axis chip: an assumption; data sheets allow a few percent."""
PULSE_HZ = 10.0
"""Frequency of the synchronisation pulses if the URL does not state it."""
FITTINGS = ("mechanism", "severity", "sensor", "units", "run")
"""Parameters that `firmware_emulator.mechanisms` understands."""
BOARD = "board"
"""Parameter that names the array's configuration file; the caller has read that file already."""
FAULTS = "faults"
"""Parameter that names a file of scheduled faults (`firmware_emulator.faults`)."""


class EmulatedBus:
    """The bus of an emulated array. `chips` are its chips by name of the sensor, `wire` is its trunk, `selects` are the
    chip selects of those on SPI.

    `transfer` is the trunk's (`Wire.transfer`). `phases` (the named stretches of the world) and ``truth(at_ns)`` (the
    true stimulus of the box) use the times of `clock`.
    """

    source = "emulated"

    def __init__(
        self,
        wires: Mapping[str, Wire],
        chips: Mapping[str, Chip],
        world: World,
        clock: WireClock,
        owned: Callable[[int, str], bool] = lambda address, bus: False,
        selects: Mapping[str, ChipSelect] = MappingProxyType({}),
    ) -> None:
        self.wires = dict(wires)
        self.selects = dict(selects)
        self.wire = self.wires[TRUNK]
        self.chips = dict(chips)
        self.clock = clock
        self.truth = world
        self.transfer = self.wire.transfer
        self.phases: tuple[WorldPhase, ...] = getattr(world, "phases", ())
        self._owned = owned

    def claim(self, address: int, path: str | None = None) -> None:
        """Raise OSError with EBUSY, as I2C_SLAVE does, if a kernel driver owns that address (LNX-12)."""
        if self._owned(address, path or TRUNK):
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))

    def channel_bus(self, bus: str) -> Wire:
        """Return the trunk of that name; OSError, as for a missing device file, if it has no sensor."""
        if bus == TRUNK or bus not in self.wires:
            raise FileNotFoundError(2, "no emulated sensor on this bus", bus)
        return self.wires[bus]

    def spi_port(self, path: str, mode: int, clock_hz: int) -> ChipSelectPort:
        """Return the chip select with this name; OSError, as for a missing device file, if it has no sensor."""
        if path not in self.selects:
            raise FileNotFoundError(2, "no emulated sensor on this chip select", path)
        return self.selects[path].port(mode, clock_hz)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Release nothing: an emulated array holds no resource of the system."""


# Keyword-only and independent of one another: the options of an emulated bus, in code or in its URL.
def open_array(  # noqa: PLR0913
    array: ArrayLike,
    *,
    clock: str | WireClock = "virtual",
    world: World | None = None,
    seed: int = 0,
    bit_rate_hz: int = 400_000,
    nack_errno: int = 121,
    host_ns: int = 0,
    switches: Switches = MappingProxyType({}),
    board: BoardKind = Board,
) -> EmulatedBus:
    """Power up the array in `world` (at rest on its -Z face by default); both begin at the present time.

    `seed` keys noise and the units that are drawn. `switches` are keyword arguments of chips, by sensor or by chip
    (``{"BMA2": {"download_ns": 0}, "l3g4200d": {"wrap_always": True}}``): properties that data sheets do not specify,
    and settings of an earlier program. `board` (name of the array, world, seed) creates the parts. ValueError for an
    unknown chip, clock, multiplexer or switch.
    """
    unknown = set(switches) - {sensor.name for sensor in array.sensors} - set(CHIPS)
    if unknown:
        raise ValueError(f"switches for {', '.join(sorted(unknown))}: allowed are sensors of the array and chips")
    time = named(clock, CLOCKS, "clock")() if isinstance(clock, str) else clock
    now_ns = time.now_ns()
    started_world = DelayedWorld(world or StillWorld(), now_ns)
    parts = board(array.name, started_world, seed)
    names = [TRUNK, *(sensor.bus for sensor in array.sensors if sensor.bus and not on_spi(sensor))]
    wires = {name: parts.wire(time, bit_rate_hz, nack_errno, host_ns) for name in names}
    selects: dict[str, ChipSelect] = {}
    chips: dict[str, Chip] = {}
    dies: dict[tuple[str | int | None, int], Chip] = {}
    branches: dict[int, list[Target]] = {}
    bypassed: dict[tuple[str | None, int | None], BehindBypass] = {}
    for sensor in array.sensors:
        place = sensor.bus or sensor.channel, sensor.address
        die = dies.get(place)
        if isinstance(die, SixAxis) and sensor.chip in HALVES:  # the die is already connected
            die.take_element(HALVES[sensor.chip].name, parts.element(sensor))
            chips[sensor.name] = die
            if parts.device(sensor, die) is not die:
                first = next(name for name, chip in chips.items() if chip is die)
                raise ValueError(
                    f"sensor {sensor.name}: it is one chip with {first}; faults of the chip are given there"
                )
            continue
        chips[sensor.name] = dies[place] = powered_chip(parts, sensor, now_ns, switches)
        device = parts.device(sensor, chips[sensor.name])
        if sensor.chip in ON_AUXILIARY_BUS:
            device = bypassed[sensor.bus, sensor.channel] = BehindBypass(device)
        if on_spi(sensor):
            wire = parts.wire(time, bit_rate_hz, nack_errno, host_ns)
            selects[str(sensor.bus)] = ChipSelect(wire, device, named(sensor.chip, DIALECTS, "chip on SPI"))
        elif sensor.channel is None:
            wires[sensor.bus or TRUNK].connect(device)
        else:
            branches.setdefault(sensor.channel, []).append(device)
    for (own_bus, channel), bypassed_device in bypassed.items():
        hosts = [dies.get((own_bus or channel, address)) for address in mpu6500.ADDRESSES]
        bypassed_device.host = next((host for host in hosts if isinstance(host, MpuFamily)), None)
        if bypassed_device.host is not None:
            bypassed_device.host.auxiliary.devices.append(bypassed_device.device)
            bypassed_device.host.on_bypass = wires[own_bus or TRUNK].reroute
            bypassed_device.host.on_bypass()
    if array.mux is not None:
        wires[TRUNK].connect_router(parts.router(array.mux.chip, array.mux.address, branches, now_ns))
    elif branches:
        raise ValueError(f"array {array.name}: sensors on channels {sorted(branches)}, but no mux")

    def owned(address: int, bus: str) -> bool:
        return parts.owned(address, bus, time)

    return EmulatedBus(wires, chips, started_world, parts.host_clock(time), owned, selects)


def on_spi(sensor: SensorLike) -> bool:
    """Return whether a sensor is on a chip select of an SPI controller."""
    return sensor.bus is not None and sensor.bus.startswith(SPI_DEVICE)


def powered_chip(board: Board, sensor: SensorLike, now_ns: int, switches: Switches = MappingProxyType({})) -> Chip:
    """Return the chip of one sensor with its unit's imperfections, powered up at `now_ns`."""
    clock_hz = getattr(sensor, "external_clock_hz", None)
    wired = {} if clock_hz is None else {"clock_input_hz": clock_hz}
    wired |= {"pulse_hz": PULSE_HZ} if getattr(sensor, "sync_pulse", False) else {}
    arguments = {**wired, **board.switches(sensor), **switches.get(sensor.chip, {}), **switches.get(sensor.name, {})}
    chip = board.kind(sensor)
    element = board.element(sensor)
    if sensor.chip in BAROMETERS:
        arguments = {"generator": random.Random(board.generator_key(sensor)), **arguments}
    try:
        return chip(sensor.address, element, now_ns, **arguments)
    except TypeError as error:
        raise ValueError(f"sensor {sensor.name}: {error}") from None


def open_bus(query: Mapping[str, str], array: ArrayLike) -> EmulatedBus:
    """Open an array as `open_array` does, from the parameters of a URL such as
    ``emulated:?clock=real&world=tumble&face_s=10``.

    `board` may name the file of `array`. ValueError, one line that states what is allowed, for an unknown parameter or
    value.
    """
    kind = named(query.get("world", "still"), WORLDS, "world")
    field_names = [field.name for field in fields(kind)]
    allowed_keys = (*SETTINGS, *field_names, *FITTINGS, FAULTS, BOARD)
    for key in query:
        if key not in allowed_keys:
            raise ValueError(f"{key}: no such parameter; {allowed_text(key, allowed_keys)}")
    nack_errno = whole_number(query, "errno", 121)
    if nack_errno not in ERRNOS:
        raise ValueError(f"errno={nack_errno}; allowed are {', '.join(map(str, ERRNOS))}")
    return open_array(
        array,
        clock=query.get("clock", "virtual"),
        world=world_from(kind, query),
        seed=whole_number(query, "seed", 0),
        bit_rate_hz=whole_number(query, "bit_rate", 400_000),
        nack_errno=nack_errno,
        switches=six_axis_switches(query, array),
        board=board_kind(query, array),
    )


def six_axis_switches(query: Mapping[str, str], array: ArrayLike) -> Switches:
    """Return switches of the six-axis chips, by the name of the first sensor of each: rate errors, each drawn by seed
    and that name, and the frequency of the pulses of chips that use them, if the query has these parameters. ValueError
    for a value that is not allowed.
    """
    kind = query.get("oscillators", OSCILLATORS[0])
    if kind not in OSCILLATORS:
        raise ValueError(f"oscillators={kind}; {allowed_text(kind, OSCILLATORS)}")
    pulse_hz = number("pulse_hz", query.get("pulse_hz", str(PULSE_HZ)))
    if not 0 <= pulse_hz <= 1e6:
        raise ValueError(f"pulse_hz={pulse_hz:g}; allowed is 0 (no pulses) to 1e6")
    seed = whole_number(query, "seed", 0)
    firsts: dict[tuple[str | int | None, int], SensorLike] = {}
    for sensor in array.sensors:
        if sensor.chip in HALVES:
            firsts.setdefault((sensor.bus or sensor.channel, sensor.address), sensor)
    switches: dict[str, dict[str, float]] = {sensor.name: {} for sensor in firsts.values()}
    for sensor in firsts.values():
        if kind == "drawn":
            switches[sensor.name]["rate_error"] = OSCILLATOR_ERROR.draw(stream(seed, f"oscillator of {sensor.name}"))
        if getattr(sensor, "sync_pulse", False):
            switches[sensor.name]["pulse_hz"] = pulse_hz
    return switches


def board_kind(query: Mapping[str, str], array: ArrayLike) -> BoardKind:
    """Return the plain board, or one with the mechanisms, and the faults of the file, that the query names."""
    board: BoardKind = Board
    if any(key in FITTINGS for key in query):
        from firmware_emulator.mechanisms.query import board_from

        board = board_from(query, array)
    if FAULTS in query:
        from firmware_emulator.faults import read_faults
        from firmware_emulator.faulty_board import with_faults

        board = with_faults(board, read_faults(query[FAULTS], array))
    return board


def world_from(kind: WorldKind, query: Mapping[str, str]) -> PhasedWorld:
    """Return the world with the values of its fields that are in the query."""
    values: dict[str, float | str] = {}
    for field in fields(kind):
        if field.name in query:
            text = query[field.name]
            values[field.name] = number(field.name, text) if isinstance(field.default, float) else axis(text)
    build: Callable[..., PhasedWorld] = kind
    return build(**values)


def axis(text: str) -> str:
    """Return a box axis; the plus sign of ``up=+X`` arrives as a space, as in every URL."""
    name = text.strip()
    return name if name[:1] in ("+", "-") else f"+{name}"


def number(key: str, text: str) -> float:
    """Return a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{key}={text}; allowed is a number")
    return value


def whole_number(query: Mapping[str, str], key: str, default: int) -> int:
    """Return a parameter that is a number without sign or fraction."""
    text = query.get(key, str(default))
    if not (text.isascii() and text.isdigit()):
        raise ValueError(f"{key}={text}; allowed is a whole number")
    return int(text)
