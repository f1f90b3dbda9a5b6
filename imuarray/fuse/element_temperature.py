"""Temperature of each sensor's element, which its bias follows, and the uncertainty of a bias from another temperature.

Biases follow the temperature where the calibration has slopes. `element_temperatures` reads a finished log.
`causal_temperatures` uses only rows that were read before the frame: a temperature is the mean over the last complete
segment of `SEGMENT_S`, extrapolated from its middle along the line through the segments of the last `TREND_S`, because
a barometer's value of 20 s ago is degrees behind while a box is heated. An element with a first-order lag follows
straight lines between the middles of segments, and the extrapolated line after the last of them. Before the first
segment is complete its rows so far are averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import Described
from imuarray.calibrate.segments import TemperatureSeries, degc_of, has_zero, thermometer_of
from imuarray.calibrate.stability import BIAS, Thermal
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.fuse.alignment import ElementTemperature
from imuarray.fuse.optimal.error_model import STEEP, USUAL
from imuarray.log import Block, Log, SensorLog
from imuarray.log.rotate import runs_of
from imuarray.printable import listed
from imuarray.units import READABLE

AWAY_DEGC = 5.0
"""A log whose temperature differs by more from that of a calibration is told of: a bias changes by more than a good
calibration leaves of it (2.5 mg by BMA-115's 0.5 mg per degC).
"""

SCALE_PER_DEGC = 1.6e-4
"""Standard deviation of what a scale factor changes by per degC, a share: 2 % over 125 degC (L3G-72)."""

_OF_THE_BOX = ("barometer", "reference")


def slopes_of(calibration: Calibration, sensor: Described) -> Thermal | None:
    """The slopes of a sensor's bias; None where none were measured, or none of its axes is known to be one of bias."""
    thermal = calibration.or_nominal(sensor).thermal
    return thermal if thermal is not None and BIAS in thermal.meaning else None


def element_temperatures(
    log: Log, sensors: Iterable[SensorLog], calibration: Calibration, *, of_all: bool = False
) -> dict[str, TemperatureSeries]:
    """The temperature that the bias of each sensor follows, behind its lag, by sensor: one row for 5 s, or longer.

    Read as `calibrate thermal` reads it: barometer, `/reference`, the chip's own thermometer, that of another chip.
    Without the sensors whose bias has no slopes, and those that have none of these here; slopes over a thermometer
    without a zero go with no other kind, and slopes over another not with it. `of_all`: of sensors without slopes too,
    without a lag.
    """
    sensors = list(sensors)
    slopes = {sensor.name: slopes_of(calibration, sensor) for sensor in sensors}
    return {
        sensor.name: thermometer if (thermal := slopes[sensor.name]) is None else _behind(thermometer, thermal)
        for sensor, thermometer in _thermometers(log, [s for s in sensors if of_all or slopes[s.name] is not None])
        if is_compatible(thermometer.kind, slopes[sensor.name])
    }


def _thermometers(log: Log, sensors: Iterable[SensorLog]) -> Iterator[tuple[SensorLog, TemperatureSeries]]:
    """Each sensor that has one with its best thermometer; one that serves the whole box is read once."""
    of_box: TemperatureSeries | None = None
    for sensor in sensors:
        thermometer = of_box or thermometer_of(log, sensor, SEGMENT_S)
        if thermometer is not None:
            of_box = thermometer if thermometer.kind in _OF_THE_BOX else None
            yield sensor, thermometer


def is_compatible(kind: str, thermal: Thermal | None) -> bool:
    """Return whether slopes can be taken over a thermometer of a kind: both have a zero, or neither has. Slopes that
    nobody measured want one that compares with the temperature of the bias.
    """
    return (kind == "relative") == (thermal is not None and thermal.thermometer == "relative")


def _behind(thermometer: TemperatureSeries, thermal: Thermal) -> TemperatureSeries:
    """The thermometer behind the lag of the slopes, unless their interval holds no lag at all."""
    lag_s = thermal.significant_lag_s
    if lag_s == 0:
        return thermometer
    lagged = thermometer.lagged(thermometer.time_s, [lag_s])[:, 0]
    return replace(thermometer, degc=np.asarray(lagged))


@dataclass(frozen=True)
class TemperatureMismatch:
    """The distance of a log from the temperature at which a sensor was calibrated: its temperature then and its mean
    one in the log (degC), the root mean square of the difference, and what the bias (3,) is uncertain by for each
    degree, in counts.
    """

    sensor: str
    calibrated_degc: float
    mean_degc: float
    rms_degc: float
    unsure_lsb_per_degc: Floats

    @property
    def bias_sd_lsb(self) -> Floats:
        """(3,) standard deviation of what the temperature does to the bias."""
        return self.rms_degc * self.unsure_lsb_per_degc


def temperature_mismatch(
    log: Log, sensors: Iterable[SensorLog], calibration: Calibration
) -> dict[str, TemperatureMismatch]:
    """Return the temperature mismatch by sensor, for sensors whose bias was calibrated at a known temperature that the
    log knows, too. A bias that follows the log's temperature is uncertain by the standard errors of its slopes; one
    that does not, by the usual size of such slopes.
    """
    mismatches: dict[str, TemperatureMismatch] = {}
    sensors = list(sensors)
    calibrated = {sensor.name: calibration.or_nominal(sensor) for sensor in sensors}
    wanted = [s for s in sensors if calibrated[s.name].temperature_degc is not None]
    wanted = [s for s in wanted if calibrated[s.name].bias_sem_lsb is not None]
    for sensor, thermometer in _thermometers(log, wanted):
        known = calibrated[sensor.name]
        if known.temperature_degc is None or thermometer.kind == "relative":
            continue
        off = thermometer.degc - known.temperature_degc
        usual = [STEEP.get((sensor.chip, axis), USUAL[sensor.quantity].slope_per_degc) for axis in range(3)]
        unsure = np.array(usual) * known.lsb_per_si
        thermal = known.thermal
        if thermal is not None and thermal.thermometer != "relative":
            follows = np.array([meaning == BIAS for meaning in thermal.meaning])
            doubt = np.hypot(thermal.slope_lsb_per_degc, thermal.slope_sem_lsb_per_degc)
            unsure = np.where(follows, thermal.slope_sem_lsb_per_degc, doubt)
        mean, rms = known.temperature_degc + float(off.mean()), float(np.sqrt(np.mean(off**2)))
        mismatches[sensor.name] = TemperatureMismatch(sensor.name, known.temperature_degc, mean, rms, unsure)
    return mismatches


def with_mismatch(calibration: Calibration, away: Mapping[str, TemperatureMismatch]) -> Calibration:
    """The calibration with covariances of bias and response that hold at the temperatures of a log."""
    sensors = dict(calibration.sensors)
    for name, each in away.items():
        known = sensors[name]
        bias = known.bias_covariance_lsb2
        if bias is None and known.bias_sem_lsb is not None:
            bias = np.diag(known.bias_sem_lsb**2)
        response = known.response_covariance()
        if response is not None:
            rows = known.response_lsb_per_unit
            scale = np.zeros((3, 3, 3, 3))
            for axis, row in enumerate(rows):
                scale[axis, :, axis] = (SCALE_PER_DEGC * each.rms_degc) ** 2 * np.outer(row, row)
            response = response + scale.reshape(9, 9)
        sensors[name] = replace(
            known,
            bias_covariance_lsb2=None if bias is None else bias + np.diag(each.bias_sd_lsb**2),
            response_covariance_lsb2_per_unit2=response,
        )
    return replace(calibration, sensors=sensors)


def mismatch_sentences(calibration: Calibration, away: Mapping[str, TemperatureMismatch]) -> Iterator[str]:
    """A line for all sensors that were calibrated at one temperature, if the log is far from it."""
    far = [each for each in away.values() if each.rms_degc > AWAY_DEGC]
    for calibrated_degc in sorted({round(each.calibrated_degc, 1) for each in far}):
        group = [each for each in far if round(each.calibrated_degc, 1) == calibrated_degc]
        most: dict[str, float] = {}
        for each in group:
            known = calibration.sensors[each.sensor]
            factor, unit = READABLE[known.unit]
            worst = factor * float((each.bias_sd_lsb / known.scale_lsb_per_unit).max())
            most[unit] = max(most.get(unit, 0.0), worst)
        names = listed([each.sensor for each in group])
        sizes = " and ".join(f"{size:.2g} {unit}" for unit, size in most.items())
        unknown = [each.sensor for each in group if calibration.sensors[each.sensor].noise_lsb is None]
        covariances = (
            "the covariances are unknown without the noise (calibrate noise)"
            if unknown
            else "the covariances include this"
        )
        yield (
            f"calibrated at {calibrated_degc:.1f} degC, this log is at {np.mean([e.mean_degc for e in group]):.1f}:"
            f" {names}; biases are known to {sizes} only; {covariances}"
        )


BAROMETER_S = 15.0
"""How much older than a frame a barometer's rows are that it is told by: a recording gives them out only when later
looks at the chip have vouched for them, and frames don't wait so long.
"""

TREND_S = 20.0
"""Time over which the trend is fitted: short beside the minutes in which a box is heated, and gone on for 20 s it makes
the noise of the means, hundredths of a degree, two or three times as large.
"""

_FEWEST = 3
"""Segments without which no trend is told."""

_WIDTH_NS = round(SEGMENT_S * 1e9)
_KEPT = 64
"""Segments that are kept beyond those that are asked for."""


class _Segment(NamedTuple):
    """One segment: its end, the mean time of its rows (s), its mean (degC), the elements behind each lag then, and the
    trend (degC/s) from then on.
    """

    end_s: float
    mid_s: float
    degc: float
    behind: Floats
    trend: float = 0.0


class CausalThermometer:
    """Temperatures as they come, and what elements behind the lags (k,) have of them, by rows that are `delay_s` old.

    Ask for no time before all rows up to `delay_s` earlier were added, nor for times long before those that were asked
    for.
    """

    def __init__(self, lags_s: Sequence[float], delay_s: float = 0.0) -> None:
        self.delay_s = delay_s
        self._lags = np.maximum(np.asarray(lags_s, float), 1e-9)
        self._closed: list[_Segment] = []
        self._begin_ns: int | None = None
        self._number = self._count = 0
        self._moment = self._sum = 0.0
        self._first_s: Floats = np.zeros(0)
        self._first_degc: Floats = np.zeros(0)
        """The rows of the first segment."""

    def add(self, time: Times, degc: Floats) -> None:
        """Rows (n,) in ns and degC; those that are not finite don't count."""
        kept = np.isfinite(degc)
        time, degc = time[kept], degc[kept]
        if len(time) == 0:
            return
        if self._begin_ns is None:
            self._begin_ns = int(time[0])
        number = (time - self._begin_ns) // _WIDTH_NS
        first = number == 0
        self._first_s = np.concatenate([self._first_s, time[first] * 1e-9])
        self._first_degc = np.concatenate([self._first_degc, degc[first]])
        for segment, rows in runs_of(number):
            self._into(segment, time[rows], degc[rows])

    def _into(self, number: int, time: Times, degc: Floats) -> None:
        """Rows of one segment; the one before is whole if this is another."""
        if number > self._number and self._count:
            closed = self._open()
            self._closed.append(closed._replace(trend=self._trend(closed)))
            self._count, self._moment, self._sum = 0, 0.0, 0.0
        self._number = number
        self._count += len(time)
        self._moment += float((time - (self._begin_ns or 0)).sum())
        self._sum += float(degc.sum())

    def _open(self) -> _Segment:
        """The segment that rows go into, as far as it is known."""
        begin_ns = self._begin_ns or 0
        mid_s = (begin_ns + self._moment / self._count) * 1e-9
        degc = self._sum / self._count
        behind = np.full(len(self._lags), degc)
        if self._closed:
            last = self._closed[-1]
            late = (degc - last.degc) / (mid_s - last.mid_s) * self._lags
            kept = np.exp(-(mid_s - last.mid_s) / self._lags)
            behind = degc - late + (last.behind - last.degc + late) * kept
        return _Segment((begin_ns + (self._number + 1) * _WIDTH_NS) * 1e-9, mid_s, degc, behind)

    def _trend(self, last: _Segment) -> float:
        """The slope of the line through the segments that end with `last`."""
        recent = [each for each in self._closed[-_KEPT:] if each.mid_s > last.mid_s - TREND_S + SEGMENT_S / 2]
        if len(recent) + 1 < _FEWEST:
            return 0.0
        since = np.array([each.mid_s - last.mid_s for each in (*recent, last)])
        return float(np.polyfit(since, [each.degc for each in (*recent, last)], 1)[0])

    def at(self, time_s: Floats, column: int) -> Floats:
        """The temperature (n,) behind one of the lags at times (n,) in s, NaN before there is any."""
        if self._begin_ns is None or len(time_s) == 0:
            return np.full(len(time_s), np.nan)
        known_s = time_s - self.delay_s
        self._forget(float(known_s.min()))
        segments = [*self._closed, self._open()]
        end, mid, degc, trend = (np.array([segment[k] for segment in segments]) for k in (0, 1, 2, 4))
        behind = np.array([segment.behind[column] for segment in segments])
        last = np.searchsorted(end, known_s, "right") - 1
        whole = np.maximum(last, 0)
        since = np.maximum(time_s - mid[whole], 0.0)
        late = trend * self._lags[column]
        kept = np.exp(-since / self._lags[column])
        going = (degc - late)[whole] + trend[whole] * since + (behind - degc + late)[whole] * kept
        return np.where(last >= 0, going, self._at_first(known_s))

    def _at_first(self, time_s: Floats) -> Floats:
        """The mean of the rows so far; that of the first one before it."""
        means = np.cumsum(self._first_degc) / np.arange(1, len(self._first_degc) + 1)
        return np.asarray(means[np.maximum(np.searchsorted(self._first_s, time_s, "right") - 1, 0)])

    def _forget(self, before_s: float) -> None:
        done = sum(segment.end_s < before_s for segment in self._closed)
        del self._closed[: max(0, done - _KEPT)]


@dataclass(frozen=True)
class ElementThermometer:
    """The element of one sensor: a thermometer behind one of its lags."""

    thermometer: CausalThermometer
    column: int

    def at(self, time_s: Floats) -> Floats:
        """Degrees (n,) at times (n,) in s since the log's epoch; NaN where it is not known."""
        return self.thermometer.at(time_s, self.column)


@dataclass(frozen=True)
class TemperatureSources:
    """The `elements` whose temperature the bias follows; who must hear of rows for that, and how much older than a
    frame these may be; all by sensor.
    """

    elements: Mapping[str, ElementTemperature]
    feeds: Mapping[str, Callable[[Block], None]]
    delays_s: Mapping[str, float]


def causal_temperatures(
    everything: Sequence[Described], sensors: Iterable[Described], calibration: Calibration, *, of_all: bool = False
) -> TemperatureSources:
    """Return element temperatures as `element_temperatures` does, from what is known at the time of a frame: the
    barometer, the chip's own thermometer, or that of another chip among `everything`. A reference is known only
    afterwards and not used.
    """
    wanted: dict[str, dict[str, float]] = {}
    for sensor in sensors:
        thermal = slopes_of(calibration, sensor)
        source = _source(everything, sensor) if of_all or thermal is not None else None
        if source is not None and is_compatible(_kind(source), thermal):
            lag_s = 0.0 if thermal is None else thermal.significant_lag_s
            wanted.setdefault(source.name, {})[sensor.name] = lag_s
    elements: dict[str, ElementTemperature] = {}
    feeds: dict[str, Callable[[Block], None]] = {}
    delays_s: dict[str, float] = {}
    for source in everything:
        if lags := wanted.get(source.name):
            delays_s[source.name] = BAROMETER_S if source.quantity == "pressure" else 0.0
            thermometer = CausalThermometer(list(lags.values()), delays_s[source.name])
            elements |= {name: ElementThermometer(thermometer, column) for column, name in enumerate(lags)}
            feeds[source.name] = _feed(thermometer, source)
    return TemperatureSources(elements, feeds, delays_s)


def _source(everything: Sequence[Described], sensor: Described) -> Described | None:
    """Return the best thermometer for a sensor."""
    barometers = [other for other in everything if other.quantity == "pressure" and _compensates(other)]
    chips = [other for other in everything if degc_of(other) is not None]
    chips.sort(key=lambda other: (other.name != sensor.name, not has_zero(other)))
    return next(iter([*barometers, *chips]), None)


def _kind(source: Described) -> str:
    """The kind of its thermometer, one of `stability.THERMOMETERS`."""
    if source.quantity == "pressure":
        return "barometer"
    return "chip" if has_zero(source) else "relative"


def _compensates(sensor: Described) -> bool:
    return (
        sensor.has_compensated("temperature") if isinstance(sensor, SensorLog) else "temperature" in sensor.compensated
    )


def _feed(thermometer: CausalThermometer, source: Described) -> Callable[[Block], None]:
    """Return the function that adds the temperatures of a sensor's rows."""
    if source.quantity == "pressure":
        return lambda block: thermometer.add(block.time, np.asarray(block.compensated["temperature"], float))
    degc = degc_of(source)
    if degc is None:
        raise ValueError(f"{source.name}: the scale of its thermometer is unknown")
    zero, step = degc

    def add(block: Block) -> None:
        if block.temperature_counts is not None:
            thermometer.add(block.time, zero + step * np.asarray(block.temperature_counts, float))

    return add
