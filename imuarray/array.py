"""The array description: the place, settings and orientation of each chip, read from a TOML file. `load_array` reads
and validates the file; every error names the file, the sensor, the key and the allowed values. Units are those of the
data sheets (g, dps, gauss, Hz); lengths are in mm.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from imuarray.axes import Matrix, orientation_of
from imuarray.chips import CHIPS, HALVES, ChipSpec, SpiRules, chip_of, die_of, half_of, kernel_chip
from imuarray.errors import ConfigError
from imuarray.shipped import find_config
from imuarray.spelling import guess
from imuarray.toml_files import Mistake, parse_toml, read_text, refusal
from imuarray.units import TRIADS

_STRICT = ConfigDict(extra="forbid", frozen=True, strict=True)
SPI_DEVICE = "/dev/spidev"
"""Prefix of the device file of a chip select: /dev/spidev0.1 is controller 0, chip select 1 (LNX-50)."""
IIO = "iio:"
"""Prefix of a device with a driver in the kernel: iio:mpu6050@1-0068 is its name and its place."""
_IIO_DEVICE = re.compile(r"iio:[^\s@/]{1,64}(@[^\s@/]{1,64})?")


class MuxConfig(BaseModel):
    """The multiplexer of an array, if this package drives it; omitted if the kernel's mux driver exposes the
    channels.
    """

    model_config = _STRICT
    chip: Literal["pca9544a"]
    """The multiplexer's chip."""
    address: Annotated[int, Field(ge=0x70, le=0x77)]
    """Its address on the root bus, by its pins A0, A1 and A2."""


class SensorConfig(BaseModel):
    """One sensor: a chip at a place, with its settings and its orientation."""

    model_config = _STRICT
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]
    """Name of the sensor in logs, results and messages: a letter, then letters, digits and underscores."""
    chip: str
    """A chip of `imuarray.chips`; any name for a sensor with a driver in the kernel."""
    quantity: Literal["specific_force", "angular_rate", "magnetic_field"] | None = None
    """The triad of a device with a driver in the kernel, if the chip's name does not determine it."""
    address: int = 0
    """Address of the chip on its I2C bus; 0 for a chip on SPI and for one with a driver in the kernel."""
    channel: Annotated[int, Field(ge=0, le=3)] | None = None
    """Channel of the multiplexer; None: the chip is before the multiplexer, or there is none."""
    bus: str | None = None
    """A bus of the sensor's own: "/dev/i2c-11" (a channel that the kernel drives), "/dev/spidev0.1" (a chip select) or
    "iio:NAME@PLACE" (a device with a driver in the kernel); None: that of the array.
    """
    range: float | None = None
    """Measuring range in g, dps or gauss, as the data sheet lists it; required for chips that have ranges.
    Without it, a device with a driver in the kernel keeps its scale.
    """
    rate_hz: float | None = None
    """Data rate of the chip in Hz, for chips that can set one; None: the chip's default."""
    bandwidth_hz: float | None = None
    """The -3 dB bandwidth of the chip's filter in Hz, for chips that can set one; None: the default at this rate."""
    spi_clock_hz: Annotated[int, Field(ge=1)] | None = None
    """Clock of a chip on SPI in Hz; None: the fastest clock that the chip supports."""
    fifo: bool = False
    """Read the chip's own queue, or the kernel's buffer, so that no sample is lost even if the array is polled
    slowly.
    """
    high_resolution: bool = False
    """Read counts of more bits from the queue, at the largest range."""
    external_clock_hz: FiniteFloat | None = None
    """Frequency in Hz of the clock at the chip's clock input, which determines its sample rate; None: its own
    oscillator is used.
    """
    sync_pulse: bool = False
    """Mark the samples that follow a pulse on the chip's synchronisation input."""
    trigger: str | None = None
    """The trigger of each sample of a device with a driver in the kernel, if that driver does not provide a trigger."""
    axes: str = "+X+Y+Z"
    """The box axes along which the sensor's x, y and z point; a left-handed triad is refused."""
    position_mm: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    """Position of the sensing element in the box frame, in mm."""

    @model_validator(mode="before")
    @classmethod
    def _choose_half(cls, values: Any) -> Any:
        """Select the half of a six-axis chip by the quantity, or by a range in g or dps: `chip = "mpu6050"` may be
        either half. The name in the data sheet ("ICM-42688-P") is also accepted.
        """
        if (
            isinstance(values, dict)
            and isinstance(values.get("chip"), str)
            and not str(values.get("bus")).startswith(IIO)
        ):
            values = {**values, "chip": chip_of(values["chip"])}
        if isinstance(values, dict) and isinstance(values.get("chip"), str) and values["chip"] in HALVES:
            halves = {str(CHIPS[half].quantity): half for half in HALVES[values["chip"]]}
            meant = halves.get(str(values.get("quantity")), half_of(values["chip"], values.get("range")))
            return {**values, "chip": meant}
        return values

    @model_validator(mode="after")
    def _possible(self) -> Self:
        """Refuse settings that this chip does not have; the error lists all of them."""
        problems = []
        for check in (
            self._check_chip,
            self._check_address,
            self._check_spi,
            self._check_iio,
            self._check_range,
            self._check_rates,
            self._check_resolution,
            self._check_clock,
            self._check_pulse,
            self._check_place,
        ):
            try:
                check()
            except ValueError as error:
                problems.append(str(error))
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _check_chip(self) -> None:
        if self.on_iio:
            spec = CHIPS.get(self.chip)
            if spec is not None and spec.quantity not in TRIADS:
                raise ValueError(
                    f"chip {self.chip!r}: the kernel's drivers are read for triads only: {_choice(TRIADS)}"
                )
            if (spec.quantity if spec is not None else self.quantity) is None:
                raise ValueError(f"quantity is missing: allowed are {_choice(TRIADS)}")
            if spec is not None and self.quantity not in (None, spec.quantity):
                raise ValueError(f"quantity {self.quantity!r}: the {self.chip} measures {spec.quantity}")
        elif self.chip in HALVES:  # neither half has this range
            ranges = tuple(limit for half in HALVES[self.chip] for limit in CHIPS[half].sensitivity)
            _one_of("range", self.range, ranges, "g")
        elif self.chip not in CHIPS:
            names = [name for name in (*CHIPS, *HALVES) if die_of(name) == name]
            raise ValueError(f"chip {self.chip!r}: allowed are {', '.join(names)}")

    def _check_address(self) -> None:
        if (spec := CHIPS.get(self.chip)) is not None and self.on_i2c:
            _one_of("address", self.address or None, spec.addresses, "#x")

    def _check_spi(self) -> None:
        """Refuse settings of I2C on SPI, and settings of SPI on I2C."""
        spec = CHIPS.get(self.chip)
        if not self.on_spi:
            if self.spi_clock_hz is not None:
                raise ValueError(f'spi_clock_hz: only for a sensor on SPI, as with bus = "{SPI_DEVICE}0.0"')
            return
        if self.address:
            raise ValueError("address: a chip on SPI has none, leave it out; its chip select is in the name of the bus")
        if spec is None:
            return
        if spec.spi is None:
            chips = ", ".join(name for name, other in CHIPS.items() if other.spi is not None)
            raise ValueError(f"bus {self.bus!r}: the {self.chip} has no SPI that is supported; allowed for {chips}")
        if self.spi_clock_hz is not None and self.spi_clock_hz > spec.spi.clock_hz:
            raise ValueError(f"spi_clock_hz {self.spi_clock_hz}: the {self.chip} supports up to {spec.spi.clock_hz}")

    def _check_iio(self) -> None:
        """Refuse settings that only devices with a driver in the kernel have on other devices, and settings that the
        kernel controls on these.
        """
        if not self.on_iio:
            for key in ("quantity", "trigger"):
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: only for a sensor that the kernel serves, as with bus = "iio:mpu6050"')
            return
        if not _IIO_DEVICE.fullmatch(str(self.bus)):
            raise ValueError(
                f'bus {self.bus!r}: allowed are "iio:NAME" and "iio:NAME@PLACE", as in "iio:mpu6050@1-0068"'
            )
        if self.address:
            raise ValueError(
                "address: the kernel's driver has it, leave it out; name the place, as in iio:mpu6050@1-0068"
            )
        if self.rate_hz is None or not 0 < self.rate_hz < math.inf:
            raise ValueError(
                "rate_hz is missing or not positive: the data rate of the kernel's driver, or of its trigger"
            )
        if self.range is not None and not 0 < self.range < math.inf:
            raise ValueError(f"range {self.range:g}: a positive number is required")
        if self.trigger is not None and not self.fifo:
            raise ValueError("trigger: only with fifo = true, which captures into the kernel's buffer")

    def _check_range(self) -> None:
        spec = None if self.on_iio else CHIPS.get(self.chip)
        if spec is not None and (spec.sensitivity or self.range is not None):
            _one_of("range", self.range, tuple(spec.sensitivity), "g")

    def _check_rates(self) -> None:
        spec = None if self.on_iio else CHIPS.get(self.chip)
        if spec is None:
            return
        if self.rate_hz is not None:
            _one_of("rate_hz", self.rate_hz, spec.rates_hz, ".10g")
        if self.bandwidth_hz is not None:
            _one_of("bandwidth_hz", self.bandwidth_hz, spec.allowed_bandwidths_hz(spec.rate_hz(self.rate_hz)), "g")
        if self.fifo and not spec.has_fifo:
            chips = ", ".join(name for name, other in CHIPS.items() if other.has_fifo)
            raise ValueError(f"fifo true: the {self.chip} has none; allowed for {chips}")

    def _check_resolution(self) -> None:
        if not self.high_resolution:
            return
        spec = None if self.on_iio else CHIPS.get(self.chip)
        if spec is None or spec.high_resolution is None:
            chips = ", ".join(name for name, other in CHIPS.items() if other.high_resolution is not None)
            raise ValueError(f"high_resolution true: the {self.chip} has no such queue; allowed for {chips}")
        if not self.fifo:
            raise ValueError("high_resolution: only with fifo = true, its counts are in the queue alone")
        if self.range in spec.sensitivity:
            _one_of("range", self.range, (spec.high_resolution.range,), "g", " with high_resolution")

    def _check_clock(self) -> None:
        if self.external_clock_hz is None:
            return
        spec = None if self.on_iio else CHIPS.get(self.chip)
        if spec is None or not spec.external_clocks:
            chips = ", ".join(name for name, other in CHIPS.items() if other.external_clocks)
            raise ValueError(
                f"external_clock_hz: the {self.chip} has no clock input that is supported; allowed for {chips}"
            )
        if spec.external_clock(self.external_clock_hz) is None:
            spans = " or ".join("{:.8g} to {:.8g} Hz".format(*clock.allowed_hz) for clock in spec.external_clocks)
            raise ValueError(f"external_clock_hz {self.external_clock_hz:.8g}: the {self.chip} supports {spans}")

    def _check_pulse(self) -> None:
        if not self.sync_pulse:
            return
        spec = None if self.on_iio else CHIPS.get(self.chip)
        if spec is None or spec.pulse_input is None:
            chips = ", ".join(name for name, other in CHIPS.items() if other.pulse_input is not None)
            raise ValueError(f"sync_pulse true: the {self.chip} has no such input; allowed for {chips}")
        if not self.fifo:
            raise ValueError("sync_pulse: only with fifo = true, a polled chip may lose the sample that has the mark")
        if self.high_resolution:
            raise ValueError("sync_pulse: not with high_resolution = true")
        if spec.pulse_input.is_on_clock_pin and self.external_clock_hz is not None:
            raise ValueError(f"sync_pulse: the {self.chip} has one pin for pulses and for external_clock_hz")
        if self.rate_hz is not None and self.rate_hz < spec.pulse_input.least_rate_hz:
            raise ValueError(f"sync_pulse: only with rate_hz of {spec.pulse_input.least_rate_hz:g} and more")

    def _check_place(self) -> None:
        if self.channel is not None and self.bus is not None:
            raise ValueError("channel and bus: a sensor is on a channel of the mux or on a bus of its own, not both")
        orientation_of(self.axes)

    @property
    def spec(self) -> ChipSpec:
        """The data of this chip's data sheet; for a chip that only a driver in the kernel supports, the quantity it
        measures.
        """
        if self.on_iio and self.chip not in CHIPS and self.quantity is not None:
            return kernel_chip(self.quantity)
        return CHIPS[self.chip]

    @property
    def orientation(self) -> Matrix:
        """3x3, ``vector_box = orientation @ vector_sensor``."""
        return orientation_of(self.axes)

    @property
    def sensitivity(self) -> float:
        """Typical counts per unit at the configured range; 0 for a chip without ranges, and if only the kernel has the
        scale.
        """
        if self.on_iio:
            return 0.0 if self.range is None else self.spec.sensitivity.get(self.range, 0.0)
        if self.high_resolution and self.spec.high_resolution is not None:
            return self.spec.high_resolution.sensitivity
        return 0.0 if self.range is None else self.spec.sensitivity[self.range]

    @property
    def count_bits(self) -> int:
        """Bits of each axis's counts."""
        if self.high_resolution and self.spec.high_resolution is not None:
            return self.spec.high_resolution.count_bits
        return self.spec.count_bits

    @property
    def nominal_rate_hz(self) -> float:
        """The chip's update rate in Hz according to its registers, with its clock at the nominal frequency."""
        return self.spec.rate_hz(self.rate_hz)

    @property
    def chip_rate_hz(self) -> float:
        """The chip's own update rate in Hz with this configuration; it is proportional to the frequency of an external
        clock.
        """
        clock = None if self.external_clock_hz is None else self.spec.external_clock(self.external_clock_hz)
        if self.external_clock_hz is None or clock is None:
            return self.nominal_rate_hz
        return self.nominal_rate_hz * self.external_clock_hz / clock.nominal_hz

    @property
    def marks_pulses(self) -> bool:
        """True if the chip marks the sensor's samples that follow a synchronisation pulse."""
        return self.sync_pulse and self.spec.pulse_input is not None and self.spec.pulse_input.is_marked

    @property
    def chip_bandwidth_hz(self) -> float:
        """-3 dB bandwidth in Hz; 0 if the data sheet has no bandwidth that can be set, or if the kernel sets it."""
        if self.on_iio:
            return self.bandwidth_hz or 0.0
        allowed, default = self.spec.allowed_bandwidths_hz(self.nominal_rate_hz), self.spec.default_bandwidth_hz
        return self.bandwidth_hz or (default if default in allowed else (*allowed, 0.0)[0])

    @property
    def delay_ns(self) -> int | None:
        """Delay of the signal in the chip's filter; None if no data sheet states it, or if the kernel sets the
        filter.
        """
        delay_s = None if self.on_iio else self.spec.delays_s.get(self.chip_bandwidth_hz)
        return None if delay_s is None else round(delay_s * 1e9)

    @property
    def on_spi(self) -> bool:
        """True if its bus is a chip select of an SPI controller."""
        return self.bus is not None and self.bus.startswith(SPI_DEVICE)

    @property
    def on_i2c(self) -> bool:
        """True if the chip is connected by I2C."""
        return not self.on_spi and not self.on_iio

    @property
    def on_iio(self) -> bool:
        """True if the sensor is read through a driver in the kernel."""
        return self.bus is not None and self.bus.startswith(IIO)

    @property
    def estimates_times(self) -> bool:
        """True if the times of its rows are estimated from the number of samples in its queue."""
        return self.fifo and not self.on_iio

    @property
    def spi_rules(self) -> SpiRules:
        """The SPI protocol of the sensor's chip, with the configured clock; only for a sensor on SPI."""
        rules = self.spec.spi
        if rules is None:
            raise ValueError(f"{self.name}: the {self.chip} has no SPI")
        return replace(rules, clock_hz=self.spi_clock_hz or rules.clock_hz)

    @property
    def place(self) -> str:
        """The location for messages: "channel 1 address 0x40"."""
        if self.on_spi or self.on_iio:
            return str(self.bus)
        segment = self.bus or ("trunk" if self.channel is None else f"channel {self.channel}")
        return f"{segment} address {self.address:#04x}"


class _ArrayTable(BaseModel):
    """The `[array]` table."""

    model_config = _STRICT
    name: Annotated[str, Field(min_length=1)]
    """Name of the array."""
    bus: str | None = None
    """URL of the bus, such as "i2c:/dev/i2c-1"; `--bus` overrides it, and one of the two is required to record."""
    mux: MuxConfig | None = None
    """The multiplexer; None: there is none, or the kernel drives it."""


class _ArrayFile(BaseModel):
    """The whole TOML file."""

    model_config = _STRICT
    array: _ArrayTable
    sensor: Annotated[list[SensorConfig], Field(min_length=1)]


class ArrayConfig(BaseModel):
    """An array: its name, its bus (a URL, or None: it must be given on the command line), its mux and its sensors in
    file order.
    """

    model_config = ConfigDict(frozen=True)
    name: str
    bus: str | None
    mux: MuxConfig | None
    sensors: tuple[SensorConfig, ...]
    text: str = ""
    """The TOML text, which every log stores."""

    def __repr__(self) -> str:
        return f"<ArrayConfig {self.name}: {', '.join(sensor.name for sensor in self.sensors)}>"

    def __getitem__(self, name: str) -> SensorConfig:
        """The sensor of that name; KeyError if unknown."""
        return {sensor.name: sensor for sensor in self.sensors}[name]

    @property
    def sensitivities(self) -> dict[str, Mapping[float, float]]:
        """Counts per unit by range of each sensor's chip, by sensor; only for chips with ranges, and not with
        `high_resolution`.
        """
        return {
            sensor.name: sensor.spec.sensitivity
            for sensor in self.sensors
            if sensor.spec.sensitivity and not sensor.high_resolution
        }

    def only(self, names: tuple[str, ...]) -> ArrayConfig:
        """Return the array reduced to these sensors; ConfigError names one that it does not have."""
        all_names = [sensor.name for sensor in self.sensors]
        for name in names:
            if name not in all_names:
                raise ConfigError(
                    f"array {self.name}: no sensor {name!r}; it has {', '.join(all_names)}{guess(name, all_names)}"
                )
        return self.model_copy(update={"sensors": tuple(sensor for sensor in self.sensors if sensor.name in names)})


def load_array(path: str | PathLike[str]) -> ArrayConfig:
    """Read an array's TOML file, or the file of that name in the package; ConfigError names file and line of every
    mistake in it.

    >>> array = load_array("martin2013")
    >>> len(array.sensors), array.sensors[0].chip
    (12, 'adxl345')
    """
    file = find_config(Path(path))
    return parse_array(read_text(file), str(file))


def parse_array(text: str, where: str = "configuration") -> ArrayConfig:
    """Return an array from TOML text; every error message begins with `where`."""
    file = parse_toml(text, _ArrayFile, where)
    array = ArrayConfig(
        name=file.array.name, bus=file.array.bus, mux=file.array.mux, sensors=tuple(file.sensor), text=text
    )
    if mistakes := [*_place_mistakes(array)]:
        raise refusal(text, where, mistakes)
    return array


def recorded_sensors(text: str) -> Mapping[str, SensorConfig]:
    """Return the sensors of the configuration in a log, by name; empty if it is missing or was written by another
    program, because that may have other keys and chips.
    """
    try:
        return {sensor.name: sensor for sensor in parse_array(text).sensors} if text else {}
    except ConfigError:
        return {}


def _one_of(key: str, value: float | None, allowed: tuple[float, ...], style: str, when: str = "") -> None:
    """Raise ValueError unless `value` is one of `allowed`; the message lists these, followed by `when`."""
    if value in allowed:
        return
    problem = "is missing" if value is None else f"{value:{style}}"
    choice = (
        f"allowed are {', '.join(f'{option:{style}}' for option in allowed)}{when}"
        if allowed
        else "this chip has none to set"
    )
    raise ValueError(f"{key} {problem}: {choice}")


def _place_mistakes(array: ArrayConfig) -> Iterator[Mistake]:
    """Yield mistakes of names and places: two sensors with one name or in one place, channels without a mux, and
    addresses that conflict with the mux.
    """
    for name, count in Counter(sensor.name for sensor in array.sensors).items():
        if count > 1:
            last = max(index for index, sensor in enumerate(array.sensors) if sensor.name == name)
            yield Mistake(("sensor", last, "name"), "", f"{count} sensors are called {name!r}; names are unique")
    sensor_at: dict[tuple[int | str | None, int], SensorConfig] = {}
    halves: dict[int, list[str]] = {}
    for index, sensor in enumerate(array.sensors):
        place, subject = ("sensor", index), f"sensor {sensor.name!r}"
        if sensor.channel is not None and array.mux is None:
            yield Mistake(place, subject, f"channel {sensor.channel}, but [array] has no mux")
        for complaint in _against_trunk(array, sensor):
            yield Mistake((*place, "address"), "", complaint)
        rival = sensor_at.setdefault((sensor.bus or sensor.channel, sensor.address), sensor)
        if rival is sensor:
            continue
        if sensor.on_iio:
            devices = [other for other in array.sensors[: index + 1] if other.bus == sensor.bus]
            mistakes = _against_device(rival, sensor, devices)
        else:
            mistakes = _against_half(rival, sensor, halves.setdefault(id(rival), [rival.chip]))
        for key, complaint in mistakes:
            yield Mistake((*place, key), "", complaint)


def _against_device(
    first: SensorConfig, second: SensorConfig, members: Sequence[SensorConfig]
) -> Iterator[_KeyMistake]:
    """Yield mistakes of a sensor of a kernel device with other sensors before it (`members`, which include this one):
    different settings of the device, or a triad that occurs twice.
    """
    for key in ("rate_hz", "fifo", "trigger"):
        if getattr(first, key) != getattr(second, key):
            yield key, f"sensors {first.name!r} and {second.name!r} are both of {first.bus}: {key} is the same for both"
    count = [member.spec.quantity for member in members].count(second.spec.quantity)
    if count > 1:
        yield "bus", f"{count} sensors are the {second.spec.quantity} of {first.bus}; each is read once"


_KeyMistake = tuple[str, str]
"""A key of a sensor's table, and the error message about it."""


def _choice(words: Iterable[str]) -> str:
    return ", ".join(words)


_OF_DIE = ("axes", "position_mm", "fifo", "high_resolution", "external_clock_hz", "sync_pulse", "spi_clock_hz")
"""Keys that both halves of a six-axis chip share."""


def _against_half(first: SensorConfig, second: SensorConfig, paired: list[str]) -> Iterator[_KeyMistake]:
    """Yield mistakes of two sensors in one place, unless they are the two halves of one chip, which have the same
    place, orientation, data rate and filter. `paired` lists the chips of that place so far; the second chip is
    appended.
    """
    pair = f"sensors {first.name!r} and {second.name!r}"
    if die_of(first.chip) != die_of(second.chip) or second.chip in paired:
        yield "address", f"{pair} are both at {second.place}"
        return
    paired.append(second.chip)
    die = die_of(first.chip)
    different = [key for key in (*_OF_DIE, "nominal_rate_hz") if getattr(first, key) != getattr(second, key)]
    for key in different:
        setting = key.removeprefix("nominal_")
        yield setting, f"{pair} are one {die}: {setting} is the same for both"
    if "nominal_rate_hz" in different:
        return
    numbers = [
        sensor.spec.allowed_bandwidths_hz(sensor.nominal_rate_hz).index(sensor.chip_bandwidth_hz)
        for sensor in (first, second)
    ]
    if numbers[0] != numbers[1]:
        bandwidth = second.spec.allowed_bandwidths_hz(second.nominal_rate_hz)[numbers[0]]
        yield (
            "bandwidth_hz",
            f"{pair} are one {die} with one filter: bandwidth_hz {first.chip_bandwidth_hz:g} of the first requires"
            f" {bandwidth:g} of the second, not {second.chip_bandwidth_hz:g}",
        )


def _against_trunk(array: ArrayConfig, sensor: SensorConfig) -> Iterator[str]:
    """Yield error messages about addresses of chips upstream of the mux, which also answer on every channel (PCA-10,
    PCA-11).
    """
    if array.mux is None or sensor.bus is not None:
        return
    if sensor.address == array.mux.address:
        free = "0x70 to 0x76" if sensor.chip == "bmp180" else "another of 0x70 to 0x77"
        yield (
            f"sensor {sensor.name!r}: address {sensor.address:#x} is the mux's own, both would answer;"
            f" strap the mux to {free}"
        )
        return
    if sensor.channel is None:
        return
    for other in array.sensors:
        if other.channel is None and other.bus is None and other.address == sensor.address:
            yield (
                f"sensor {sensor.name!r} on channel {sensor.channel}: {other.name!r} on the trunk answers"
                f" at {other.address:#x} too"
            )
