"""The interface of every mechanism: its physical parameters, the sensors on which it can act, and its effect on a
board.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

from firmware_emulator.board import MUXES, Board, Pca9544aChip, allowed_text, named
from firmware_emulator.chip import Chip, Target
from firmware_emulator.chips import HALVES
from firmware_emulator.clock import WireClock
from firmware_emulator.element import IDENTITY, NOTHING, SensingElement, UnitDeviations, stream
from firmware_emulator.mechanisms.host import HostClock, LatentWire, Reading, WatchedMux
from firmware_emulator.mechanisms.site import INERTIAL, ChipLine, MountedElement, Site
from firmware_emulator.tolerances import TruncatedNormal, typical
from firmware_emulator.units import drawn_unit, tolerances_of, unit_of
from firmware_emulator.wire import Wire
from firmware_emulator.world import DelayedWorld, World

if TYPE_CHECKING:
    from firmware_emulator.board import ArrayLike, SensorLike


@dataclass(frozen=True)
class Mechanism(ABC):
    """One cause of differences with its physical parameters, which a subclass defines in SI or data-sheet units.

    `touches` are the chips on which it can act. `place` states which sensors it needs: "sensor" (any number), "pair"
    (two of one chip), "design" (all of one chip), "host" (the whole array). `resembles` contains the effect names that
    are correct in a diagnosis; it is empty if no effect describes the mechanism. `scaled` names the parameters that are
    proportional to the severity, up to `largest`; `inverse` those that are inversely proportional to it.
    """

    touches: ClassVar[tuple[str, ...]] = INERTIAL
    place: ClassVar[str] = "sensor"
    resembles: ClassVar[tuple[str, ...]] = ()
    scaled: ClassVar[tuple[str, ...]] = ()
    largest: ClassVar[float] = math.inf
    inverse: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return the mechanism at `severity` times its reference size, which is that of the default parameters."""
        changes = {name: min(cls.largest, severity * getattr(cls, name)) for name in cls.scaled}
        changes |= {name: getattr(cls, name) / severity for name in cls.inverse}
        return replace(cls(), **changes)

    @abstractmethod
    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Put it on these sensors of the board."""

    def wherever(self, sensors: Sequence[SensorLike]) -> tuple[str, ...]:
        """Return its default sensors: all on which it can act, or for a "design" those of the most frequent chip."""
        touched = [sensor for sensor in sensors if sensor.chip in self.touches]
        if self.place == "design":
            ((chip, _),) = Counter(sensor.chip for sensor in touched).most_common(1) or [("", 0)]
            touched = [sensor for sensor in touched if sensor.chip == chip]
        return tuple(sensor.name for sensor in touched)


@dataclass(frozen=True)
class SensorMechanism(Mechanism):
    """A mechanism that acts on every sensor independently."""

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Put it on each sensor in turn."""
        for site in sites:
            self.put_on(site)

    @abstractmethod
    def put_on(self, site: Site) -> None:
        """Put it on one sensor."""


UNITS = ("paper", "drawn", "toleranced")
"""Kinds of units, in this order: those of the paper; units drawn only in the basic properties (see `plain_part`); units
drawn in all properties for which a data sheet states a tolerance.
"""
TURN_ON_SHARE = 0.003
"""Scatter (one sigma) of a toleranced part's bias between power-ups, as a share of the bias tolerance of its data
sheet; it is that of the paper's parts (left half of its Table 11: up to 0.65 mg and 0.036 dps).
"""
RATE_ERROR: Mapping[str, TruncatedNormal] = MappingProxyType({"bma180": typical(0.10), "l3g4200d": typical(0.02)})
"""Relative error of a toleranced part's oscillator: BMA-107; for the L3G4200D, whose data sheet states none, that of an
RC oscillator is assumed. The oscillator of an ADXL345 is exact.
"""
LEAST_SENSORS = {"pair": 2, "design": 2}


@dataclass(frozen=True)
class Fitting:
    """A mechanism and the names of the sensors on which it is put."""

    mechanism: Mechanism
    sensors: tuple[str, ...]


def plain_part(chip: str, name: str, full_scale: float, seed: int) -> UnitDeviations:
    """Return a part that is drawn from its data sheet's tolerances, but only in its basic properties.

    These are noise, bias, its slope with temperature, scale factor and alignment. Temperature slope of the scale
    factor, g-sensitivity and error of the thermometer are omitted, because they are mechanisms.
    """
    unit = drawn_unit(chip, name, full_scale, seed)
    return replace(unit, scale_slope_per_degc=0.0, g_sensitivity=NOTHING, thermometer_offset_degc=0.0)


def toleranced_part(chip: str, name: str, full_scale: float, seed: int, run: int) -> UnitDeviations:
    """Return a part drawn in all properties that its data sheet specifies by a tolerance; its bias scatters between
    power-ups.
    """
    unit, random = drawn_unit(chip, name, full_scale, seed), stream(seed, f"power-up {run} of {name}")
    limits = [tolerance.limit for tolerance in tolerances_of(chip, full_scale).bias]
    scattered = [
        bias + TURN_ON_SHARE * limit * float(random.standard_normal())
        for bias, limit in zip(unit.bias, limits, strict=True)
    ]
    return replace(unit, bias=(scattered[0], scattered[1], scattered[2]))


def sites_of(array: ArrayLike, fitting: Fitting) -> list[SensorLike]:
    """Return the sensors of a fitting; ValueError for an unknown sensor or one on which the mechanism cannot act."""
    mechanism, by_name = fitting.mechanism, {sensor.name: sensor for sensor in array.sensors}
    mechanism_name = type(mechanism).__name__
    suitable = [sensor.name for sensor in array.sensors if sensor.chip in mechanism.touches]
    for name in fitting.sensors:
        if name not in by_name or name not in suitable:
            raise ValueError(f"sensor {name!r} for {mechanism_name}; {allowed_text(name, suitable)}")
    sensors = [by_name[name] for name in fitting.sensors]
    fewest = LEAST_SENSORS.get(mechanism.place, 1)
    if len(sensors) < fewest or (mechanism.place == "pair" and len(sensors) != fewest):
        raise ValueError(
            f"{mechanism_name} needs {'exactly' if mechanism.place == 'pair' else 'at least'} {fewest} sensors"
        )
    if mechanism.place in LEAST_SENSORS and len({sensor.chip for sensor in sensors}) > 1:
        raise ValueError(f"{mechanism_name} needs sensors of one chip: name them, not {', '.join(fitting.sensors)}")
    return sensors


@dataclass
class BenchHost:
    """The host and the multiplexer on which mechanisms act; see `firmware_emulator.mechanisms.host`.

    `clocks` are pairs (shown, when); each clock reads the time displayed by the one before. `mux` exists once the array
    is assembled, if a mechanism acts on it.
    """

    waits_ns: list[Callable[[], int]] = field(default_factory=list)
    clocks: list[tuple[Reading, Reading]] = field(default_factory=list)
    obeys: list[Callable[[int], bool]] = field(default_factory=list)
    switched: list[Callable[[int], None]] = field(default_factory=list)
    mux: WatchedMux | None = None


class FittedBoard(Board):
    """The board of `array` after power-up number `run`, on which `fittings` are active; `units` as in `UNITS`.

    `notes` collects events of mechanisms that do not follow from their parameters, `touched` the sensors with false
    readings, for mechanisms that affect random ones; `crossed` maps sensors with swapped wiring. ValueError for
    mechanisms that cannot act on this array.
    """

    def __init__(
        self,
        array: ArrayLike,
        world: World,
        seed: int,
        fittings: Sequence[Fitting] = (),
        *,
        run: int = 0,
        units: str = "paper",
    ) -> None:
        super().__init__(array.name, world, seed)
        if units not in UNITS:
            raise ValueError(f"units={units}; allowed are {', '.join(UNITS)}")
        self.run, self.units = run, units
        self.sensors = {sensor.name: sensor for sensor in array.sensors}
        self.notes: list[str] = []
        self.touched: dict[Mechanism, set[str]] = {}
        self.crossed: dict[str, str] = {}
        self.host = BenchHost()
        self.powered_on_ns = world.start_ns if isinstance(world, DelayedWorld) else 0
        self._sites: dict[str, Site] = {}
        for fitting in fittings:
            fitting.mechanism.fit(self, [self.site(sensor) for sensor in sites_of(array, fitting)])
        if array.mux is None and (self.host.obeys or self.host.switched):
            raise ValueError(f"array {array.name} has no multiplexer for a mechanism to act on")
        for site in self._sites.values():
            if len(site.kinds) > 1:
                raise ValueError(f"sensor {site.name}: two mechanisms would change the inside of its {site.chip}")

    def site(self, sensor: SensorLike) -> Site:
        """Return the site of that sensor, at which mechanisms act."""
        if sensor.name not in self._sites:
            self._sites[sensor.name] = Site(
                sensor.name,
                sensor.chip,
                sensor.range or 0.0,
                IDENTITY if sensor.orientation is None else sensor.orientation,
                self.world.world if isinstance(self.world, DelayedWorld) else self.world,
                self.seed,
                self.run,
                self.notes,
                self.touched,
            )
        return self._sites[sensor.name]

    def wire(self, clock: WireClock, bit_rate_hz: int, nack_errno: int, host_ns: int) -> Wire:
        """Return one adapter, with latency if a mechanism adds it."""
        if self.host.waits_ns:
            return LatentWire(clock, bit_rate_hz, nack_errno, host_ns, self.host.waits_ns)
        return super().wire(clock, bit_rate_hz, nack_errno, host_ns)

    def router(
        self, chip: str, address: int, channels: Mapping[int, Sequence[Target]], powered_on_ns: int
    ) -> Pca9544aChip:
        """Return the multiplexer, with the mechanisms that act on it."""
        if not (self.host.obeys or self.host.switched):
            return super().router(chip, address, channels, powered_on_ns)
        named(chip, MUXES, "mux")
        self.host.mux = WatchedMux(address, channels, powered_on_ns, self.host.obeys, self.host.switched)
        return self.host.mux

    def element(self, sensor: SensorLike) -> SensingElement:
        """Return the sensing element at that sensor's place, with its unit and the mechanisms that act on it."""
        site_sensor = self.sensors[self.crossed.get(sensor.name, sensor.name)]
        orientation = IDENTITY if site_sensor.orientation is None else site_sensor.orientation
        site = self._sites.get(sensor.name)
        key = f"{site_sensor.name}, run {self.run}" if self.run else site_sensor.name
        if site is None or site_sensor.chip not in (*INERTIAL, *HALVES):
            return SensingElement(self.world, site_sensor.chip, key, orientation, self.unit(site_sensor), self.seed)
        unit, start_ns = self.unit(site_sensor), self.powered_on_ns
        mounted = MountedElement(self.world, site_sensor.chip, key, orientation, unit, self.seed)
        return mounted.mount(site.chain, start_ns)

    def unit(self, sensor: SensorLike) -> UnitDeviations:
        """Return the imperfections of one unit."""
        if self.units == "drawn":
            return plain_part(sensor.chip, sensor.name, sensor.range or 0.0, self.seed)
        if self.units == "toleranced":
            return toleranced_part(sensor.chip, sensor.name, sensor.range or 0.0, self.seed, self.run)
        return unit_of(self.array, sensor.name, sensor.chip, sensor.range or 0.0, self.seed)

    def kind(self, sensor: SensorLike) -> Callable[..., Chip]:
        """Return the builder of the chip, changed by mechanisms inside it."""
        kind = super().kind(sensor)
        for change in self._sites[sensor.name].kinds if sensor.name in self._sites else ():
            kind = change(kind)
        return kind

    def switches(self, sensor: SensorLike) -> Mapping[str, Any]:
        """Return the switches that mechanisms set, and the rate error of a toleranced part."""
        changes: dict[str, Any] = {}
        if self.units == "toleranced" and sensor.chip in RATE_ERROR:
            changes["rate_error"] = RATE_ERROR[sensor.chip].draw(stream(self.seed, f"oscillator of {sensor.name}"))
        return {**changes, **(self._sites[sensor.name].switches if sensor.name in self._sites else {})}

    def generator_key(self, sensor: SensorLike) -> str:
        """Return the key of the noise, which is different after each power-up."""
        return f"{self.seed} {sensor.name} {self.run}" if self.run else super().generator_key(sensor)

    def device(self, sensor: SensorLike, chip: Chip) -> Target:
        """Return the chip, or its line if a mechanism acts there."""
        site = self._sites.get(sensor.name)
        if site is None or site.links.idle:
            return chip
        return ChipLine(chip, sensor.chip, site.links, self.powered_on_ns)

    def host_clock(self, clock: WireClock) -> WireClock:
        """Return the world's clock, or the host's clock with its errors."""
        for shown, when in self.host.clocks:
            clock = HostClock(clock, shown, when, self.powered_on_ns)
        return clock
