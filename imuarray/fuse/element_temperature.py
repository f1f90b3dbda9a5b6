"""Temperature of each sensor's element, which its bias follows, and the uncertainty of a bias from another temperature.

Biases follow the temperature if the calibration has slopes. `element_temperatures` reads a finished log.
`causal_temperatures` uses only rows that were read before the frame: a temperature is the mean over the last complete
segment of `SEGMENT_S`, extrapolated from its middle along the line through the segments of the last `TREND_S`, because
while a box is heated a barometer's value of 20 s ago differs by degrees. An element with a first-order lag follows
straight lines between the middles of segments, and the extrapolated line after the last of them. Before the first
segment is complete, its rows so far are averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import BIAS, SensorDescription, Thermal
from imuarray.calibrate.segments import TemperatureSeries, degc_of, has_zero, thermometer_of
from imuarray.calibrate.thermal import SEGMENT_S
from imuarray.fuse.alignment import ElementTemperature
from imuarray.fuse.optimal.prior import STEEP, USUAL
from imuarray.log import Block, Log, SensorLog
from imuarray.log.rotate import runs_of
from imuarray.printable import listed
from imuarray.units import READABLE

AWAY_DEGC = 5.0
"""Largest difference between the temperatures of a log and of a calibration without a remark: beyond it a bias changes
by more than the error of a good calibration (2.5 mg by BMA-115's 0.5 mg per degC).
"""

SCALE_PER_DEGC = 1.6e-4
"""Standard deviation of the relative change of a scale factor per degC: 2 % over 125 degC (L3G-72)."""

_OF_THE_BOX = ("barometer", "reference")


def slopes_of(calibration: Calibration, sensor: SensorDescription) -> Thermal | None:
    """Return the slopes of a sensor's bias; None if none were measured, or if no axis has a slope of bias."""
    thermal = calibration.or_nominal(sensor).thermal
    return thermal if thermal is not None and BIAS in thermal.meaning else None


def element_temperatures(
    log: Log, sensors: Iterable[SensorLog], calibration: Calibration, *, of_all: bool = False
) -> dict[str, TemperatureSeries]:
    """Return, by sensor, the temperature in degC that the bias of the sensor follows, after its lag: one row per 5 s,
    or longer.

    The thermometer is the one that `calibrate thermal` uses: barometer, `/reference`, the chip's own thermometer, or
    that of another chip. Sensors without slopes or without a compatible thermometer are omitted; slopes from a
    thermometer without a zero are compatible only with such a thermometer. `of_all`: include sensors without slopes,
    without a lag.
    """
    sensors = list(sensors)
    slopes = {sensor.name: slopes_of(calibration, sensor) for sensor in sensors}
    return {
        sensor.name: thermometer if (thermal := slopes[sensor.name]) is None else _apply_lag(thermometer, thermal)
        for sensor, thermometer in _thermometers(log, [s for s in sensors if of_all or slopes[s.name] is not None])
        if is_compatible(thermometer.kind, slopes[sensor.name])
    }


def _thermometers(log: Log, sensors: Iterable[SensorLog]) -> Iterator[tuple[SensorLog, TemperatureSeries]]:
    """Yield sensors with their best thermometers, if any; a thermometer of the whole box is read once."""
    of_box: TemperatureSeries | None = None
    for sensor in sensors:
        thermometer = of_box or thermometer_of(log, sensor, SEGMENT_S)
        if thermometer is not None:
            of_box = thermometer if thermometer.kind in _OF_THE_BOX else None
            yield sensor, thermometer


def is_compatible(kind: str, thermal: Thermal | None) -> bool:
    """Return whether slopes apply to a thermometer of this kind: both have a zero, or neither has. Without slopes
    (None) a zero is required, so that the temperature is comparable with that of the bias.
    """
    return (kind == "relative") == (thermal is not None and thermal.thermometer == "relative")


def _apply_lag(thermometer: TemperatureSeries, thermal: Thermal) -> TemperatureSeries:
    """Return the temperature after the lag of the slopes, if that is significant."""
    lag_s = thermal.significant_lag_s
    if lag_s == 0:
        return thermometer
    lagged = thermometer.lagged(thermometer.time_s, [lag_s])[:, 0]
    return replace(thermometer, degc=np.asarray(lagged))


@dataclass(frozen=True)
class TemperatureMismatch:
    """Difference between the temperature of a log and that at which a sensor was calibrated: the temperature of the
    calibration and the mean temperature of the log (degC), the rms difference (degC), and the uncertainty of the bias
    (3,) in counts per degC.
    """

    sensor: str
    calibrated_degc: float
    mean_degc: float
    rms_degc: float
    unsure_lsb_per_degc: Floats

    @property
    def bias_sd_lsb(self) -> Floats:
        """Standard deviation (3,) of the change of the bias by the temperature difference."""
        return self.rms_degc * self.unsure_lsb_per_degc


def temperature_mismatch(
    log: Log, sensors: Iterable[SensorLog], calibration: Calibration
) -> dict[str, TemperatureMismatch]:
    """Return the temperature mismatch by sensor, for sensors whose bias was calibrated at a known temperature, in a log
    with a temperature. The uncertainty of a bias that follows the log's temperature is that of its slopes; otherwise it
    is the usual size of slopes.
    """
    mismatches: dict[str, TemperatureMismatch] = {}
    sensors = list(sensors)
    calibrated = {sensor.name: calibration.or_nominal(sensor) for sensor in sensors}
    measured = [s for s in sensors if calibrated[s.name].bias_sem_lsb is not None]
    comparable = [s for s in measured if calibrated[s.name].temperature_degc is not None]
    for sensor, thermometer in _thermometers(log, comparable):
        parameters = calibrated[sensor.name]
        if parameters.temperature_degc is None or thermometer.kind == "relative":
            continue
        difference = thermometer.degc - parameters.temperature_degc
        usual = [STEEP.get((sensor.chip, axis), USUAL[sensor.quantity].slope_per_degc) for axis in range(3)]
        unsure = np.array(usual) * parameters.lsb_per_si
        thermal = parameters.thermal
        if thermal is not None and thermal.thermometer != "relative":
            follows = np.array([meaning == BIAS for meaning in thermal.meaning])
            doubt = np.hypot(thermal.slope_lsb_per_degc, thermal.slope_sem_lsb_per_degc)
            unsure = np.where(follows, thermal.slope_sem_lsb_per_degc, doubt)
        mean, rms = parameters.temperature_degc + float(difference.mean()), float(np.sqrt(np.mean(difference**2)))
        mismatches[sensor.name] = TemperatureMismatch(sensor.name, parameters.temperature_degc, mean, rms, unsure)
    return mismatches


def with_mismatch(calibration: Calibration, mismatches: Mapping[str, TemperatureMismatch]) -> Calibration:
    """Return the calibration with covariances of bias and response that are valid at the temperatures of a log."""
    sensors = dict(calibration.sensors)
    for name, mismatch in mismatches.items():
        parameters = sensors[name]
        bias = parameters.bias_covariance_lsb2
        if bias is None and parameters.bias_sem_lsb is not None:
            bias = np.diag(parameters.bias_sem_lsb**2)
        response = parameters.response_covariance()
        if response is not None:
            rows = parameters.response_lsb_per_unit
            scale = np.zeros((3, 3, 3, 3))
            for axis, row in enumerate(rows):
                scale[axis, :, axis] = (SCALE_PER_DEGC * mismatch.rms_degc) ** 2 * np.outer(row, row)
            response = response + scale.reshape(9, 9)
        sensors[name] = replace(
            parameters,
            bias_covariance_lsb2=None if bias is None else bias + np.diag(mismatch.bias_sd_lsb**2),
            response_covariance_lsb2_per_unit2=response,
        )
    return replace(calibration, sensors=sensors)


def mismatch_sentences(calibration: Calibration, mismatches: Mapping[str, TemperatureMismatch]) -> Iterator[str]:
    """Yield one sentence for all sensors that were calibrated at one temperature, if that of the log differs much."""
    far = [mismatch for mismatch in mismatches.values() if mismatch.rms_degc > AWAY_DEGC]
    for calibrated_degc in sorted({round(mismatch.calibrated_degc, 1) for mismatch in far}):
        group = [mismatch for mismatch in far if round(mismatch.calibrated_degc, 1) == calibrated_degc]
        largest: dict[str, float] = {}
        for mismatch in group:
            parameters = calibration.sensors[mismatch.sensor]
            factor, unit = READABLE[parameters.unit]
            worst = factor * float((mismatch.bias_sd_lsb / parameters.scale_lsb_per_unit).max())
            largest[unit] = max(largest.get(unit, 0.0), worst)
        names = listed([mismatch.sensor for mismatch in group])
        sizes = " and ".join(f"{size:.2g} {unit}" for unit, size in largest.items())
        unknown = [mismatch.sensor for mismatch in group if calibration.sensors[mismatch.sensor].noise_lsb is None]
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
"""Age in s of the barometer's rows that a frame uses: a recording releases them only after later checks of the chip,
and frames do not wait for that.
"""

TREND_S = 20.0
"""Time in s over which the trend is fitted: short compared with the minutes of a heating; extrapolation by 20 s
multiplies the noise of the means, hundredths of a degree, by two or three.
"""

_FEWEST = 3
"""Least number of segments for a trend."""

_WIDTH_NS = round(SEGMENT_S * 1e9)
_MOST_SEGMENTS = 64
"""Number of segments that are kept before the requested times."""


class _Segment(NamedTuple):
    """One segment: its end, the mean time of its rows (s), its mean (degC), the temperatures after the lags (k,) at
    that time (`lagged_degc`), and the trend (degC/s) after it.
    """

    end_s: float
    mid_s: float
    degc: float
    lagged_degc: Floats
    trend: float = 0.0


class CausalThermometer:
    """Temperatures of a stream of rows after the lags (k,), from rows that are at least `delay_s` old.

    A time may be requested once all rows up to `delay_s` before it were added, and not long after later times were
    requested.
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
        """Add rows: times (n,) in ns and degC (n,); values that are not finite are ignored."""
        is_finite = np.isfinite(degc)
        time, degc = time[is_finite], degc[is_finite]
        if len(time) == 0:
            return
        if self._begin_ns is None:
            self._begin_ns = int(time[0])
        number = (time - self._begin_ns) // _WIDTH_NS
        first = number == 0
        self._first_s = np.concatenate([self._first_s, time[first] * 1e-9])
        self._first_degc = np.concatenate([self._first_degc, degc[first]])
        for segment, rows in runs_of(number):
            self._add_to(segment, time[rows], degc[rows])

    def _add_to(self, number: int, time: Times, degc: Floats) -> None:
        """Add rows to a segment; a new segment completes the one before."""
        if number > self._number and self._count:
            closed = self._open()
            self._closed.append(closed._replace(trend=self._trend(closed)))
            self._count, self._moment, self._sum = 0, 0.0, 0.0
        self._number = number
        self._count += len(time)
        self._moment += float((time - (self._begin_ns or 0)).sum())
        self._sum += float(degc.sum())

    def _open(self) -> _Segment:
        """Return the current segment, with its rows so far."""
        begin_ns = self._begin_ns or 0
        mid_s = (begin_ns + self._moment / self._count) * 1e-9
        degc = self._sum / self._count
        lagged = np.full(len(self._lags), degc)
        if self._closed:
            last = self._closed[-1]
            late = (degc - last.degc) / (mid_s - last.mid_s) * self._lags
            remaining = np.exp(-(mid_s - last.mid_s) / self._lags)
            lagged = degc - late + (last.lagged_degc - last.degc + late) * remaining
        return _Segment((begin_ns + (self._number + 1) * _WIDTH_NS) * 1e-9, mid_s, degc, lagged)

    def _trend(self, last: _Segment) -> float:
        """Return the slope of the line through the segments up to `last`."""
        recent = [
            segment
            for segment in self._closed[-_MOST_SEGMENTS:]
            if segment.mid_s > last.mid_s - TREND_S + SEGMENT_S / 2
        ]
        if len(recent) + 1 < _FEWEST:
            return 0.0
        since = np.array([segment.mid_s - last.mid_s for segment in (*recent, last)])
        return float(np.polyfit(since, [segment.degc for segment in (*recent, last)], 1)[0])

    def at(self, time_s: Floats, column: int) -> Floats:
        """Return the temperature (n,) after one of the lags at times (n,) in s; NaN before the first row."""
        if self._begin_ns is None or len(time_s) == 0:
            return np.full(len(time_s), np.nan)
        known_s = time_s - self.delay_s
        self._forget(float(known_s.min()))
        segments = [*self._closed, self._open()]
        end, mid, degc, trend = (np.array([segment[k] for segment in segments]) for k in (0, 1, 2, 4))
        lagged = np.array([segment.lagged_degc[column] for segment in segments])
        last = np.searchsorted(end, known_s, "right") - 1
        whole = np.maximum(last, 0)
        since = np.maximum(time_s - mid[whole], 0.0)
        late = trend * self._lags[column]
        remaining = np.exp(-since / self._lags[column])
        going = (degc - late)[whole] + trend[whole] * since + (lagged - degc + late)[whole] * remaining
        return np.where(last >= 0, going, self._first_mean(known_s))

    def _first_mean(self, time_s: Floats) -> Floats:
        """Return the mean of the rows so far; before the first row, the first row."""
        means = np.cumsum(self._first_degc) / np.arange(1, len(self._first_degc) + 1)
        return np.asarray(means[np.maximum(np.searchsorted(self._first_s, time_s, "right") - 1, 0)])

    def _forget(self, before_s: float) -> None:
        count = sum(segment.end_s < before_s for segment in self._closed)
        del self._closed[: max(0, count - _MOST_SEGMENTS)]


@dataclass(frozen=True)
class ElementThermometer:
    """The element of one sensor: a thermometer after one of its lags."""

    thermometer: CausalThermometer
    column: int

    def at(self, time_s: Floats) -> Floats:
        """Return degrees Celsius (n,) at times (n,) in s since the log's epoch; NaN if not known."""
        return self.thermometer.at(time_s, self.column)


@dataclass(frozen=True)
class TemperatureSources:
    """The sources of temperatures, by sensor: the `elements` whose temperature the bias follows, the functions
    (`feeds`) to call with rows of thermometers, and the age of these rows with respect to a frame (`delays_s`).
    """

    elements: Mapping[str, ElementTemperature]
    feeds: Mapping[str, Callable[[Block], None]] = field(default_factory=dict)
    delays_s: Mapping[str, float] = field(default_factory=dict)


def causal_temperatures(
    all_sensors: Sequence[SensorDescription],
    sensors: Iterable[SensorDescription],
    calibration: Calibration,
    *,
    of_all: bool = False,
) -> TemperatureSources:
    """Return element temperatures as `element_temperatures` does, from rows before a frame only: the barometer, the
    chip's own thermometer, or that of another chip among `all_sensors`. A reference is known only afterwards and not
    used.
    """
    lags_by_source: dict[str, dict[str, float]] = {}
    for sensor in sensors:
        thermal = slopes_of(calibration, sensor)
        source = _source(all_sensors, sensor) if of_all or thermal is not None else None
        if source is not None and is_compatible(_kind(source), thermal):
            lag_s = 0.0 if thermal is None else thermal.significant_lag_s
            lags_by_source.setdefault(source.name, {})[sensor.name] = lag_s
    elements: dict[str, ElementTemperature] = {}
    feeds: dict[str, Callable[[Block], None]] = {}
    delays_s: dict[str, float] = {}
    for source in all_sensors:
        if lags := lags_by_source.get(source.name):
            delays_s[source.name] = BAROMETER_S if source.quantity == "pressure" else 0.0
            thermometer = CausalThermometer(list(lags.values()), delays_s[source.name])
            elements |= {name: ElementThermometer(thermometer, column) for column, name in enumerate(lags)}
            feeds[source.name] = _feed(thermometer, source)
    return TemperatureSources(elements, feeds, delays_s)


def _source(all_sensors: Sequence[SensorDescription], sensor: SensorDescription) -> SensorDescription | None:
    """Return the best thermometer for a sensor."""
    barometers = [other for other in all_sensors if other.quantity == "pressure" and _compensates(other)]
    chips = [other for other in all_sensors if degc_of(other) is not None]
    chips.sort(key=lambda other: (other.name != sensor.name, not has_zero(other)))
    return next(iter([*barometers, *chips]), None)


def _kind(source: SensorDescription) -> str:
    """Return the kind of a sensor's thermometer, one of `model.THERMOMETERS`."""
    if source.quantity == "pressure":
        return "barometer"
    return "chip" if has_zero(source) else "relative"


def _compensates(sensor: SensorDescription) -> bool:
    return (
        sensor.has_compensated("temperature") if isinstance(sensor, SensorLog) else "temperature" in sensor.compensated
    )


def _feed(thermometer: CausalThermometer, source: SensorDescription) -> Callable[[Block], None]:
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
