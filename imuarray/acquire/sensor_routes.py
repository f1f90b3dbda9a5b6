"""The route to each sensor (its bus segment and driver), the order in which a frame visits them, and witnesses of
channels.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from imuarray.array import IIO, ArrayConfig, SensorConfig
from imuarray.bus.iio import IioBus, IioDevice
from imuarray.bus.protocol import Bus, MuxChannel, OpenBus, Pca9544a
from imuarray.bus.spi import SpiChip
from imuarray.chips import die_of
from imuarray.drivers import Driver, driver_of
from imuarray.drivers.iio import IioCapture, IioSensor, iio_sensor
from imuarray.drivers.six_axis import QueuedHalf
from imuarray.errors import BusUrlError, SensorError
from imuarray.facts.registers import Setting
from imuarray.log.format import SensorHeader, header_of


def _nobody_asks() -> None:
    """Do nothing, for a bus that does not know the owners of addresses."""


@dataclass(frozen=True)
class SensorRoute:
    """One sensor, its driver, and its segment of the bus (channels of one multiplexer exclude each other)."""

    sensor: SensorConfig
    driver: Driver
    segment: int | str | None
    claim: Callable[[], None] = _nobody_asks
    """Raises SensorError if a kernel driver owns the address of the sensor."""

    @property
    def header(self) -> SensorHeader:
        """Return the header of the sensor in a log, once it is configured."""
        header = header_of(self.sensor, self.driver.header(), is_estimated=self.sensor.estimates_times)
        return self.driver.described(header) if isinstance(self.driver, IioSensor) else header


class Witness(NamedTuple):
    """One register of one chip, and its values on the other channels; empty if the chip has no twin."""

    route: SensorRoute
    setting: Setting
    others: frozenset[int]


def routes_of(array: ArrayConfig, bus: OpenBus) -> list[SensorRoute]:
    """Create a route to every sensor of `array`; nothing is sent yet."""
    mux = Pca9544a(bus, array.mux.address) if array.mux else None
    ask: Callable[[int, str | None], None] | None = getattr(bus, "claim", None)
    routes = []
    halves: dict[tuple[int, int | str | None], QueuedHalf] = {}
    captures: dict[str, IioCapture] = {}
    for sensor in array.sensors:
        segment: Bus = bus
        if sensor.on_iio:
            capture = captures.setdefault(str(sensor.bus), IioCapture(_device(bus, sensor), bus.clock))
            routes.append(SensorRoute(sensor, iio_sensor(sensor, capture), sensor.bus))
            continue
        if sensor.on_spi:
            segment = _chip_select(bus, sensor)
        elif sensor.bus is not None:
            segment = _channel_bus(bus, sensor.bus, sensor.name)
        elif mux is not None and sensor.channel is not None:
            segment = mux.channel(sensor.channel)
        driver = driver_of(sensor)(segment, sensor, bus.clock)
        if isinstance(driver, QueuedHalf):
            first = halves.setdefault((driver.registers.address, sensor.bus or sensor.channel), driver)
            if first is not driver:
                driver.share(first)
        claim = _nobody_asks if ask is None or not sensor.on_i2c else partial(_claim, ask, sensor)
        routes.append(SensorRoute(sensor, driver, sensor.bus or sensor.channel, claim))
    return routes


def _chip_select(bus: OpenBus, sensor: SensorConfig) -> Bus:
    """Return the chip select of a sensor on SPI; BusUrlError names the sensor if the bus has none."""
    rules = sensor.spi_rules
    try:
        return SpiChip(bus.spi_port(str(sensor.bus), rules.mode, rules.clock_hz), rules)
    except OSError as error:
        raise BusUrlError(f"{sensor.name}: chip select {sensor.bus}: {error.strerror or error}") from error


def _device(bus: OpenBus, sensor: SensorConfig) -> IioDevice:
    """Return the kernel device that serves a sensor; BusUrlError for a bus that has none."""
    if not isinstance(bus, IioBus):
        raise BusUrlError(
            f"{sensor.name}: {sensor.bus} is served by the kernel, which --bus iio: reads; it cannot write a transcript"
        )
    return bus.iio_device(str(sensor.bus).removeprefix(IIO))


def _channel_bus(bus: OpenBus, path: str, name: str) -> Bus:
    """Return the bus at `path`; BusUrlError names the sensor that requires it."""
    try:
        return bus.channel_bus(path)
    except OSError as error:
        raise BusUrlError(f"{name}: bus {path}: {error.strerror or error}") from error


def connect(array: ArrayConfig, bus: OpenBus) -> list[SensorRoute]:
    """Identify and configure every sensor. SensorError names the first sensor that is owned by a kernel driver,
    missing, wrong, refuses its configuration, or has lost it by the time that the last one is configured.
    """
    routes = routes_of(array, bus)
    _claim_mux(array, bus)
    for route in routes:
        route.claim()
    for route in routes:
        route.driver.identify()
    mark_twins(routes)
    for route in routes:
        try:
            route.driver.configure()
        except OSError as error:
            name, place = route.sensor.name, route.sensor.place
            raise SensorError(
                f"{name} at {place}: the bus fails while it is configured: {error.strerror or error}"
            ) from error
    return routes


def _claim_mux(array: ArrayConfig, bus: OpenBus) -> None:
    """Claim the multiplexer's address if the bus knows the owners of addresses; SensorError if the kernel owns it
    (LNX-12).
    """
    ask: Callable[[int, str | None], None] | None = getattr(bus, "claim", None)
    if ask is not None and array.mux is not None:
        ask(array.mux.address, None)


def _claim(ask: Callable[[int, str | None], None], sensor: SensorConfig) -> None:
    """Claim the address of a sensor; behind a multiplexer, on the root bus."""
    try:
        ask(sensor.address, sensor.bus)
    except SensorError as error:
        raise SensorError(f"{sensor.name} ({sensor.chip}): {error}") from error
    except OSError as error:
        if error.errno != errno.EBUSY:
            raise
        raise SensorError(
            f"{sensor.name} ({sensor.chip}): {sensor.place} belongs to a driver of the kernel; unbind that driver"
        ) from error


def alternating_orders(routes: Sequence[SensorRoute]) -> tuple[list[list[SensorRoute]], list[list[SensorRoute]]]:
    """Return the visiting orders of even and of odd frames, in opposite directions: a frame begins with the segment
    with which the previous one ended.

    With k segments behind a multiplexer, a frame then needs k - 1 switches, the fewest possible. Within a segment the
    order of the configuration is kept in both directions. The spacing of a sensor's readings alternates by the time
    that the other segments take, and each reading has its own time.
    """
    segments: dict[int | str | None, list[SensorRoute]] = {}
    for route in routes:
        segments.setdefault(route.segment, []).append(route)
    forth = list(segments.values())
    return forth, forth[::-1]


def twins_of(route: SensorRoute, everywhere: Iterable[SensorRoute]) -> list[SensorRoute]:
    """Return the routes at the same address of other channels."""
    if not isinstance(route.driver.registers.bus, MuxChannel):
        return []
    return [
        other
        for other in everywhere
        if other.segment != route.segment
        and isinstance(other.driver.registers.bus, MuxChannel)
        and other.sensor.address == route.sensor.address
    ]


def mark_twins(routes: Sequence[SensorRoute]) -> None:
    """Give twins with equal configurations different values in a register that has no effect, before they are
    configured.
    """
    ambiguous: dict[int, SensorRoute] = {}
    for route in routes:
        twins = twins_of(route, routes)
        if twins and not witnesses_of(route, routes):
            ambiguous.update((id(twin), twin) for twin in (route, *twins))
    for route in ambiguous.values():
        route.driver.mark(int(route.segment or 0) + 1)


def witnesses_of(route: SensorRoute, everywhere: Sequence[SensorRoute]) -> list[Witness]:
    """Return the registers in which this chip differs from all its twins, even after one of them was reset; all its
    registers if it has no twin.
    """
    twins = twins_of(route, everywhere)
    witnesses = []
    for setting in route.driver.watched:
        theirs = [
            {other.value for other in twin.driver.watched if other.register == setting.register}
            for twin in twins
            if die_of(twin.sensor.chip) == die_of(route.sensor.chip)
        ]
        mine = {setting.value, setting.register.reset & setting.mask}
        if len(theirs) == len(twins) and all(values and not values & mine for values in theirs):
            witnesses.append(Witness(route, setting, frozenset().union(*theirs)))
    return witnesses
