"""Sensors that a driver of the kernel serves as devices of the IIO subsystem: any chip with a driver in Linux.

A sensor is one triad of a device (its accelerometer, gyroscope or magnetometer): two sensors may share a device, as the
halves of a six-axis chip do. With `fifo = true` the kernel captures into its buffer, and every sample arrives with the
time that the kernel gave it; without it the three attributes `in_..._raw` are read in each frame, one after the other.

The log holds raw counts. Their unit follows from the kernel's `scale`, which is the log's sensitivity, and its
`offset`, which is added to the counts as a whole number. The mounting matrix gives the axes where the configuration
does not. There is no register read-back: only the kernel reads the chip's registers, and a chip that was reset to its
defaults is detected only if its samples stop. Facts LNX-60 to -68.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np

from imuarray.array import SensorConfig
from imuarray.axes import orientation_of
from imuarray.bus.iio import IioDevice, ScanElement, ScanLayout
from imuarray.clock import Clock
from imuarray.drivers.driver import Bytes, DecodedBursts, Registers, SelfTest, carry_out
from imuarray.drivers.fifo_clock import FifoClock
from imuarray.errors import SensorError
from imuarray.facts.registers import Setting
from imuarray.log.format import COUNT_BITS, SATURATED, TIME_UNCERTAINTY, SensorHeader, ThermometerScale
from imuarray.printable import printable
from imuarray.units import SI_PER_UNIT

AXES = ("x", "y", "z")
CHANNELS: Mapping[str, tuple[str, float]] = {
    "specific_force": ("in_accel", SI_PER_UNIT["g"]),
    "angular_rate": ("in_anglvel", SI_PER_UNIT["dps"]),
    "magnetic_field": ("in_magn", 1.0),
}
"""By quantity: the channel's name, and the size of the log's unit in the kernel's unit (m/s2, rad/s, gauss: LNX-65)."""
TIMESTAMP = "in_timestamp"
TEMPERATURE = "in_temp"
MOST_BITS = 31
"""Largest number of bits of a signed count; a log stores counts in 32 bits."""
RANGE_MARGIN = 0.98
"""Least full scale that is accepted, as a share of the required range: 32767 counts of 0.488 mg are 15.99 g."""
RATE_MARGIN = 0.01
"""Largest relative difference between the requested data rate and that of the driver, which may be rounded."""
SCALE_MARGIN = 1e-3
"""Largest relative difference of the axes' scales that counts as equal: sysfs prints six digits after the point."""
ROUNDED = 2e-3
"""Largest relative difference of a scale from that of the data sheet that is attributed to rounding."""
BUFFER_S = 4.0
SHORTEST_BUFFER = 128
LONGEST_BUFFER = 1 << 15
WATERMARK_S = 0.05
"""Duration in s of the samples that wait in the chip's own queue, if the driver uses one."""
GAP_PERIODS = 1.6
"""Interval, in nominal intervals, above which samples are missing: oscillators have errors of some percent."""
BURST = np.dtype("<i4")
_WORDS = 4  # x, y, z and the temperature


def triads_of(device: IioDevice) -> list[str]:
    """Return the quantities of which a device has at least the x axis."""
    return [quantity for quantity, (name, _) in CHANNELS.items() if (device.folder / f"{name}_x_raw").exists()]


def rates_of(device: IioDevice) -> dict[str, float]:
    """Return each triad's data rate in Hz, by quantity; 0 if the driver states none. Raises SensorError, OSError."""
    rates = {}
    for quantity in triads_of(device):
        names = ("sampling_frequency", f"{CHANNELS[quantity][0]}_sampling_frequency")
        text = next((text for name in names if (text := device.read(name)) is not None), "0")
        rates[quantity] = _number("sampling_frequency", text)
    return rates


class Conversion(NamedTuple):
    """Conversion of one sensor's counts: physical = (raw + `offset`) x `scale` in the kernel's unit."""

    scale: float
    offset: int
    reach: int
    """Counts are from -reach to below reach; others are clipped."""
    full_scale: float
    """Largest value in the log's unit."""
    thermometer: ThermometerScale | None = None

    @property
    def bits(self) -> int:
        """Return the bits of a signed number that holds every count."""
        return (self.reach - 1).bit_length() + 1


class IioQueue:
    """Samples of one sensor that wait until it is visited. `drained`, `gaps` and `uncertainties_ns` describe the last
    result of `take`: the times, the positions before which samples are missing (unknown for the kernel's buffer), and
    the largest error of each time where it is known: for times by count, not for those of the kernel.
    """

    def __init__(self, period_ns: float) -> None:
        self.drained: list[int] = []
        self.gaps: list[int] = []
        self._longest_ns = GAP_PERIODS * period_ns
        self._rows = bytearray()
        self.uncertainties_ns: list[float] = []
        self._times_ns: list[int] = []
        self._uncertainties_ns: list[float] = []
        self._newest_ns: int | None = None

    def _forget(self) -> None:
        self._rows, self._times_ns, self._uncertainties_ns = bytearray(), [], []

    def restart(self) -> None:
        """Discard the state: the device was set up again."""
        self._forget()
        self._newest_ns = None

    def put(self, rows: bytes, times_ns: Sequence[int], uncertainties_ns: Sequence[float] = ()) -> None:
        """Store rows, one for each time; if they are not fetched, they are dropped."""
        if len(self._times_ns) > LONGEST_BUFFER:
            self._forget()
        self._rows += rows
        self._times_ns += times_ns
        self._uncertainties_ns += uncertainties_ns

    def take(self) -> bytes:
        """Return and remove all waiting rows."""
        self.drained, self.uncertainties_ns, taken = self._times_ns, self._uncertainties_ns, bytes(self._rows)
        self._forget()
        before = [] if self._newest_ns is None else [self._newest_ns]
        steps = enumerate(pairwise([*before, *self.drained]), 1 - len(before))
        self.gaps = [row for row, (earlier, later) in steps if later - earlier > self._longest_ns]
        if self.drained:
            self._newest_ns = self.drained[-1]
        return taken


class IioSensor:
    """One triad of a device, read attribute by attribute; shares `capture` with the other sensors of the device."""

    burst: ClassVar[int] = _WORDS * BURST.itemsize
    has_data_ready: ClassVar[bool] = False
    reading: ClassVar[slice] = slice(0, 3 * BURST.itemsize)

    def __init__(self, sensor: SensorConfig, capture: IioCapture) -> None:
        self.sensor = sensor
        self.channel, self.unit_si = CHANNELS[sensor.spec.quantity]
        self.watched: tuple[Setting, ...] = ()
        self.registers = Registers(capture.device, 0, f"{sensor.name} ({sensor.chip}) at {sensor.place}")
        self.conversion = Conversion(1.0, 0, 1 << 15, 0.0)
        self.axes = sensor.axes
        self._capture = capture
        capture.join(self)

    @property
    def device(self) -> IioDevice:
        """The device of this triad."""
        return self._capture.device

    @property
    def names(self) -> list[str]:
        """The names of its channels in sysfs."""
        return [f"{self.channel}_{axis}" for axis in AXES]

    # Set-up -------------------------------------------------------------------------------------------------------

    def identify(self) -> None:
        """Check that the device exists and has all three axes of this quantity; SensorError."""
        folder = self.device.folder
        missing = [name for name in self.names if not (folder / f"{name}_raw").exists()]
        if missing:
            others = triads_of(self.device)
            has = f"it has {', '.join(others)}" if others else "it has no triad"
            raise self.error(f"{self.device.name} has no {', '.join(missing)}; {has}")

    def error(self, text: str) -> SensorError:
        """Return an error of this sensor."""
        return SensorError(f"{self.registers.label}: {text}")

    def steps(self) -> Iterator[float]:
        """Set the device up; SensorError names the attribute that can't be set, and what is allowed."""
        self.identify()
        try:
            self._capture.set_up(self)
        except OSError as error:
            raise self.error(_advice(error)) from error
        except SensorError as error:
            raise self.error(str(error).removeprefix(f"{self.device}: ")) from error
        yield 0.0

    def configure(self) -> None:
        """Carry out all `steps`."""
        carry_out(self._capture.clock, self.steps())

    def set_scale(self, elements: Mapping[str, ScanElement]) -> None:
        """Choose the scale of the required range and read scale and offset, while no capture runs."""
        wanted, attribute = self.sensor.range, self._attribute("scale")
        offset = self._common("offset", 0.0)
        if not abs(offset) < 2**MOST_BITS:
            raise SensorError(
                f"{self.device}: {self.channel}_offset is {offset:g}; counts of a log are below 2^{MOST_BITS}"
            )
        reach = _reach([elements[name] for name in self.names if name in elements], round(offset))
        bits = (reach - 1).bit_length() + 1
        if bits > MOST_BITS:
            raise SensorError(f"{self.device}: counts of {bits} bits; a log holds at most {MOST_BITS}")
        if wanted is not None:
            self._choose_scale(attribute, wanted, reach)
        scale = self._common("scale")
        if not 0 < scale < math.inf:
            raise SensorError(f"{self.device}: {attribute} is {scale:g}; a positive number is required")
        scale = self._exact_scale(scale, self.device.read(attribute) or "")
        full_scale = reach * scale / self.unit_si
        if wanted is not None and full_scale < RANGE_MARGIN * wanted:
            raise SensorError(
                f"{self.device}: range {wanted:g}: the scale is {scale:g}, which reaches {full_scale:.4g}"
            )
        self.conversion = Conversion(scale, round(offset), reach, full_scale, self._thermometer(elements))
        self.axes = self._mounting()

    def _choose_scale(self, attribute: str, wanted: float, reach: int) -> None:
        """Set the smallest full scale that has the required range; SensorError lists the possible ones."""
        available = _numbers(self._text("scale_available"))
        full = {text: reach * float(text) / self.unit_si for text in available if float(text) > 0}
        if not full:
            return
        enough = [text for text in full if full[text] >= RANGE_MARGIN * wanted]
        if not enough:
            choice = ", ".join(f"{value:.4g}" for value in sorted(full.values()))
            raise SensorError(f"{self.device}: range {wanted:g}: allowed are up to {choice} {self.sensor.spec.unit}")
        text = min(enough, key=full.__getitem__)
        self.device.write(attribute, text)
        kept = _number(attribute, self.device.read(attribute))
        if not math.isclose(kept, float(text), rel_tol=SCALE_MARGIN):
            raise SensorError(f"{self.device}: {attribute} reads {kept:g} after {text} was written")

    def _exact_scale(self, scale: float, text: str) -> float:
        """Return the data sheet's scale that the kernel printed as `text`, if there is one: some drivers print six
        digits after the point, of which three are zeros for a gyroscope, or multiples of a rounded value.
        """
        digit = 10.0 ** -len(text.partition(".")[2])
        exact = [self.unit_si / counts for counts in self.sensor.spec.sensitivity.values()]
        return next((value for value in exact if abs(value - scale) < max(digit, ROUNDED * value)), scale)

    def _attribute(self, kind: str) -> str:
        """Return the name of an attribute that all axes share, or that of x; it may be missing."""
        for name in (f"{self.channel}_{kind}", f"{self.channel}_x_{kind}"):
            if self.device.read(name) is not None:
                return name
        return f"{self.channel}_{kind}"

    def _text(self, kind: str) -> str:
        return self.device.read(self._attribute(kind)) or ""

    def _common(self, kind: str, default: float | None = None) -> float:
        """Return the value of an attribute that is the same for all axes."""
        shared = f"{self.channel}_{kind}"
        text = self.device.read(shared)
        if text is not None:
            return _number(shared, text)
        texts = {name: self.device.read(f"{name}_{kind}") for name in self.names}
        if default is not None and not any(texts.values()):
            return default
        values = [_number(f"{name}_{kind}", text) for name, text in texts.items()]
        if not all(math.isclose(value, values[0], rel_tol=SCALE_MARGIN) for value in values):
            text = ", ".join(f"{value:g}" for value in values)
            raise SensorError(f"{self.device}: {shared} of x, y, z is {text}; a log has one for all axes")
        return values[0]

    def _thermometer(self, elements: Mapping[str, ScanElement]) -> ThermometerScale | None:
        """Return the thermometer that is captured with it, if its counts are known and fit 16 bits (LNX-65)."""
        element = elements.get(TEMPERATURE)
        if element is None or element.range_bits > 16 or not self.sensor.fifo:
            return None
        scale = _number("in_temp_scale", self.device.read("in_temp_scale") or "0")
        offset = _number("in_temp_offset", self.device.read("in_temp_offset") or "0")
        return ThermometerScale(offset * scale / 1e3, 1e3 / scale) if scale else None

    def _mounting(self) -> str:
        """Return the axes of the configuration, or those of the device's mounting matrix (LNX-66)."""
        text = self.mount_matrix
        if "axes" in self.sensor.model_fields_set or not text:
            return self.sensor.axes
        try:
            rows = [[float(number) for number in row.split(",")] for row in text.split(";")]
            if [len(row) for row in rows] != [3, 3, 3]:
                raise ValueError
            axes = "".join(_signed_axis([row[column] for row in rows]) for column in range(3))
            orientation_of(axes)
        except ValueError:
            raise SensorError(
                f"{self.device}: mount_matrix {text!r} is not a rotation by quarter turns; give axes in the"
                " configuration"
            ) from None
        return axes

    @property
    def mount_matrix(self) -> str:
        """The device's mounting matrix as in sysfs; "" if it has none."""
        names = (f"{self.channel}_mount_matrix", "in_mount_matrix", "mount_matrix")
        return next((text for name in names if (text := self.device.read(name))), "")

    def mark(self, code: int) -> bool:
        """Do nothing: there is no register to write to."""
        return False

    def self_test(self) -> SelfTest:
        """Raise an error: IIO has no self-test that all drivers share."""
        return SelfTest(None, "the kernel's driver offers no self-test")

    # Reading ------------------------------------------------------------------------------------------------------

    def fetch(self) -> bytes:
        """Return the three attributes, read one after the other. OSError."""
        values = []
        for name in self.names:
            text = self.device.read(f"{name}_raw")
            try:
                values.append(int(text or ""))
            except ValueError:
                raise OSError(5, f"{self.device}: {name}_raw is {str(text)[:40]!r}") from None
        counts = np.clip(np.array(values, np.float64) + self.conversion.offset, -(2**31), 2**31 - 1)
        return np.append(counts, 0).astype(BURST).tobytes()

    def decode(self, bursts: Bytes) -> DecodedBursts:
        """See `Driver.decode`."""
        words = np.ascontiguousarray(bursts).view(BURST).reshape(len(bursts), _WORDS)
        reach = self.conversion.reach
        counts = words[:, :3].clip(-reach, reach - 1)
        has_temperature = self.conversion.thermometer is not None
        temperature = words[:, 3].astype(np.int16) if has_temperature else None
        at_end = ((counts == -reach) | (counts == reach - 1)).any(axis=1)
        status = np.where(at_end, SATURATED, 0).astype(np.uint16)
        narrow = self.conversion.bits <= 16
        return DecodedBursts(counts.astype(np.int16) if narrow else counts.astype(np.int32), temperature, status)

    # Description in the log ---------------------------------------------------------------------------------------

    def header(self) -> Mapping[str, int] | Mapping[str, float]:
        """Return an empty header: `described` has all of it."""
        return {}

    def described(self, header: SensorHeader) -> SensorHeader:
        """Return `header` with the kernel's description of the sensor: sensitivity, range, axes, and texts."""
        conversion, thermometer = self.conversion, self.conversion.thermometer
        extra: dict[str, int | float | str] = {
            "iio_name": self.device.name[:255],
            "iio_place": self.device.place[:255],
            "iio_offset": conversion.offset,
            "time_source": self._capture.time_source if self.sensor.fifo else "CLOCK_MONOTONIC of the reader",
        }
        if self.mount_matrix:
            extra["mount_matrix"] = self.mount_matrix[:255]
        if conversion.bits > 16:
            extra[COUNT_BITS] = conversion.bits
        if thermometer is not None:
            extra |= thermometer.attributes
        return replace(
            header,
            range=self.sensor.range or conversion.full_scale,
            sensitivity=self.unit_si / conversion.scale,
            axes=self.axes,
            has_temperature=thermometer is not None,
            compensated=(TIME_UNCERTAINTY,) if self.sensor.fifo and self._capture.counts_out_times else (),
            extra={**header.extra, **extra},
        )


class BufferedIioSensor(IioSensor):
    """One triad of a device that captures into the kernel's buffer."""

    has_data_ready: ClassVar[bool] = True

    def __init__(self, sensor: SensorConfig, capture: IioCapture) -> None:
        self.queue = IioQueue(1e9 / sensor.chip_rate_hz)
        super().__init__(sensor, capture)

    def fetch(self) -> bytes:
        """Return all waiting samples. OSError with ENODEV if the device was removed."""
        self._capture.drain()
        return self.queue.take()


class IioCapture:
    """One device and the sensors that it serves, which are set up together."""

    def __init__(self, device: IioDevice, clock: Clock) -> None:
        self.device = device
        self.clock = clock
        self.time_source = ""
        self._members: list[IioSensor] = []
        self._set_up: list[IioSensor] = []
        self._layout: ScanLayout | None = None
        self._clock: FifoClock | None = None

    def join(self, sensor: IioSensor) -> None:
        """Add `sensor` to those that the device serves."""
        self._members.append(sensor)

    @property
    def counts_out_times(self) -> bool:
        """Return whether the buffer has no times; the times of its samples are then computed from their counts."""
        return self._clock is not None

    def set_up(self, sensor: IioSensor) -> None:
        """Set the device up for all its sensors, unless that was just done for another one. OSError, SensorError."""
        if self._set_up and sensor not in self._set_up:
            self._set_up.append(sensor)
            return
        self._set_up = []
        config = sensor.sensor
        elements = self.device.elements()
        if config.fifo:
            missing = [name for member in self._members for name in member.names if name not in elements]
            if missing:
                raise SensorError(
                    f"{self.device}: its buffer has no {', '.join(missing)}; without fifo it is read through sysfs"
                )
            self.device.hold()
        self._set_rate(config, [member.channel for member in self._members])
        for member in self._members:
            member.set_scale(elements)
        if config.fifo:
            self._start(config, elements)
        self._set_up = [sensor]

    def _set_rate(self, config: SensorConfig, channels: Sequence[str]) -> None:
        """Set the data rate, if the driver has one: the configured one, or with a trigger the lowest that is not
        slower. SensorError if there is none, with the possible ones, or if the driver sets another one.
        """
        rate_hz = config.chip_rate_hz
        names = ("sampling_frequency", *(f"{channel}_sampling_frequency" for channel in channels))
        for attribute in names:
            if self.device.read(attribute) is None:
                continue
            texts = _numbers(self.device.read(f"{attribute}_available") or "")
            fits = [text for text in texts if math.isclose(float(text), rate_hz, rel_tol=RATE_MARGIN)]
            if config.trigger is not None:
                fits = fits or sorted((text for text in texts if float(text) > rate_hz), key=float)
            if texts and not fits:
                raise SensorError(f"{self.device}: rate_hz {rate_hz:g}: allowed are {', '.join(texts)}")
            text = fits[0] if fits else _plain(rate_hz)
            self.device.write(attribute, text)
            kept = _number(attribute, self.device.read(attribute))
            if not math.isclose(kept, float(text), rel_tol=RATE_MARGIN):
                raise SensorError(f"{self.device}: {attribute} reads {kept:g} after {text} was written")

    def _start(self, config: SensorConfig, elements: Mapping[str, ScanElement]) -> None:
        """Choose the clock and the trigger, and start the capture."""
        wanted = {name for member in self._members for name in member.names}
        if TIMESTAMP in elements:
            if self.device.read("current_timestamp_clock") is not None:
                self.device.keep("current_timestamp_clock", "monotonic")
            else:
                raise SensorError(f"{self.device}: no current_timestamp_clock; Linux 4.5 or later is required")
            wanted.add(TIMESTAMP)
            self._clock, self.time_source = None, "CLOCK_MONOTONIC of the kernel's driver"
        else:
            self._clock, self.time_source = FifoClock(config.chip_rate_hz), "counts of the buffer on CLOCK_MONOTONIC"
        if any(member.conversion.thermometer is not None for member in self._members):
            wanted.add(TEMPERATURE)
        self._choose_trigger(config)
        length = min(max(round(BUFFER_S * config.chip_rate_hz), SHORTEST_BUFFER), LONGEST_BUFFER)
        watermark = max(1, min(round(WATERMARK_S * config.chip_rate_hz), length // 2))
        self._layout = self.device.start(wanted, length, watermark)
        for member in self._members:
            if isinstance(member, BufferedIioSensor):
                member.queue.restart()

    def _choose_trigger(self, config: SensorConfig) -> None:
        """Set the configured trigger, and its rate if it has one, or keep the trigger that is set. SensorError if the
        trigger is unknown, if the device has none, or if none is set.
        """
        attribute, wanted = "trigger/current_trigger", config.trigger
        current = self.device.read(attribute)
        if current is None:
            if wanted is not None:
                raise SensorError(f"{self.device}: trigger {wanted!r}: this device samples by itself; leave it out")
        elif wanted is not None:
            triggers = self.device.triggers()
            if wanted not in triggers:
                raise SensorError(f"{self.device}: trigger {wanted!r}: allowed are {_choice(triggers)}")
            self.device.keep(attribute, wanted)
            pace = triggers[wanted] / "sampling_frequency"
            if pace.exists():
                self.device.write(str(pace), _plain(config.chip_rate_hz))
        elif not current:
            raise SensorError(
                f"{self.device}: no trigger starts its samples; give trigger, one of"
                f" {_choice(self.device.triggers())}, or leave out fifo"
            )

    def drain(self) -> None:
        """Read all waiting scans and pass each sensor its part. OSError."""
        layout = self._layout
        from_ns = self.clock.now_ns()
        scans = self.device.scans()
        if layout is None or not scans:
            return
        columns = layout.unpack(scans)
        count = len(scans) // layout.size
        if self._clock is None:
            times: list[int] = columns[TIMESTAMP].tolist()
            uncertainties: Sequence[float] = ()
        else:
            times = self._clock.times(count, from_ns, until_ns=self.clock.now_ns())
            uncertainties = self._clock.uncertainties_ns
        for member in self._members:
            if isinstance(member, BufferedIioSensor):
                member.queue.put(_rows(columns, member), times, uncertainties)


def _reach(elements: Sequence[ScanElement], offset: int) -> int:
    """Return the largest magnitude of counts, from the types of the axes; without types that of signed 16 bits."""
    ends = [
        (-(1 << element.bits - 1), 1 << element.bits - 1) if element.is_signed else (0, 1 << element.bits)
        for element in elements
    ] or [(-(1 << 15), 1 << 15)]
    return max(1, *(max(abs(low + offset), abs(high + offset)) for low, high in ends))


def _rows(columns: Mapping[str, Any], member: IioSensor) -> bytes:
    """Return (n, 4) words of a sensor: x, y, z with their offset, and the temperature."""
    counts = [columns[name] + member.conversion.offset for name in member.names]
    temperature = columns.get(TEMPERATURE)
    last = np.zeros_like(counts[0]) if temperature is None else temperature
    return np.stack([*counts, last], axis=1).astype(BURST).tobytes()


def _choice(triggers: Iterable[str]) -> str:
    """Return the existing triggers, for a message."""
    return ", ".join(printable(name) for name in triggers) or "none yet: the module iio-trig-hrtimer creates them"


def _plain(number: float) -> str:
    return f"{number:.6f}".rstrip("0").rstrip(".")


def _signed_axis(column: Sequence[float]) -> str:
    """Return the signed box axis of a column of a rotation by quarter turns; ValueError for another rotation."""
    rounded = [round(value) for value in column]
    if max(abs(value - whole) for value, whole in zip(column, rounded, strict=True)) > 1e-3:
        raise ValueError
    (axis,) = [number for number, value in enumerate(rounded) if value]
    if abs(rounded[axis]) != 1:
        raise ValueError
    return ("+" if rounded[axis] > 0 else "-") + "XYZ"[axis]


def _number(name: str, text: str | None) -> float:
    """Return the number in an attribute; SensorError if there is none."""
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise SensorError(f"{name} is {str(text)[:40]!r}: a finite number is required")
    return value


def _numbers(text: str) -> list[str]:
    """Return the values of an attribute `..._available`, as text; none for a range, "[least step most]"."""
    if text.startswith("["):
        return []
    values = text.split()
    for value in values:
        _number("available value", value)
    return values


def _advice(error: OSError) -> str:
    """Return a sentence on an error of a file, with advice."""
    where = error.filename or "the device"
    advice = {
        errno.EACCES: "; give your group write access by a udev rule, or run as root",
        errno.EBUSY: "; another program captures from it: end that program",
    }.get(error.errno or 0, "")
    return f"{where}: {error.strerror or error}{advice}"


def iio_sensor(sensor: SensorConfig, capture: IioCapture) -> IioSensor:
    """Return the driver of a sensor that the kernel serves: by its buffer with `fifo`, else by its attributes."""
    return BufferedIioSensor(sensor, capture) if sensor.fifo else IioSensor(sensor, capture)
