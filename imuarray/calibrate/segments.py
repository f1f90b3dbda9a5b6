"""Means of a long log over segments of some seconds, and of the temperature over the same time.

Rows are read block by block; one row per segment is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.model import Described
from imuarray.errors import CalibrationError, LogError
from imuarray.log import Log, SensorLog
from imuarray.log.columns import NamedColumn
from imuarray.log.format import SATURATED, STALE, SUSPECT, Phase
from imuarray.thermometers import thermometer_scale

_MOST_SEGMENTS = 20_000
_FULL = 0.5
"""Least share of the usual number of rows in a segment."""

FEWEST_ALIKE = 3
"""Fewest chips of one kind for the median of their thermometers: the median of two is only their mean."""

WITHOUT_ZERO = ("l3g4200d",)
"""Chips whose thermometer measures changes only (L3G-60)."""


def degc_of(sensor: Described) -> tuple[float, float] | None:
    """Return degrees at count 0 and degrees per count of a sensor's own thermometer, as its log states or else the data
    sheet of its chip; None if it has no thermometer, or neither states it.
    """
    has_thermometer = sensor.temperature_counts is not None if isinstance(sensor, SensorLog) else sensor.has_temperature
    if not has_thermometer:
        return None
    scale = sensor.thermometer or thermometer_scale(sensor.chip)
    return None if scale is None else (scale.zero_degc, 1 / scale.lsb_per_degc)


def has_zero(sensor: Described) -> bool:
    """Return whether a sensor's thermometer measures absolute temperature, and not only changes."""
    return sensor.thermometer is not None or sensor.chip not in WITHOUT_ZERO


@dataclass(frozen=True)
class SegmentMeans:
    """Means of rows: mid times (n,) in s since the log's epoch, and means (n, k) over the rows of each segment."""

    time_s: Floats
    mean: Floats


@dataclass(frozen=True)
class TemperatureSeries:
    """Temperatures (m,) in degC at times (m,) in s since the log's epoch; `kind` is one of `stability.THERMOMETERS`.
    Readings are multiples of `step_degc` (0: not known).
    """

    kind: str
    time_s: Floats
    degc: Floats
    step_degc: float = 0.0

    def at(self, time_s: Floats) -> Floats:
        """Return the temperature at other times, by linear interpolation."""
        return np.interp(time_s, self.time_s, self.degc)

    def lagged(self, time_s: Floats, lags_s: Sequence[float]) -> Floats:
        """Return the temperature (len(time_s), len(lags_s)) after first-order lags, at first in equilibrium.

        Exact for lines between readings: with slope s, lag L gives x1 - s L + (y0 - x0 + s L) exp(-dt / L).
        """
        lags = np.maximum(np.asarray(lags_s, float), 1e-9)
        steps = np.diff(self.time_s)
        slopes = np.diff(self.degc) / steps
        lagged = np.empty((len(self.degc), len(lags)))
        lagged[0] = self.degc[0]
        decay = np.exp(-steps[:, None] / lags)
        for i, slope in enumerate(slopes):
            late = slope * lags
            lagged[i + 1] = self.degc[i + 1] - late + (lagged[i] - self.degc[i] + late) * decay[i]
        return np.stack([np.interp(time_s, self.time_s, column) for column in lagged.T], axis=1)


def segment_means(
    sensor: SensorLog, width_s: float, left_out: Sequence[Phase] = (), within: slice | None = None
) -> SegmentMeans:
    """Return mean counts (n, k) of a sensor over segments of `width_s` (longer if there would be more than 20000), of
    all rows or of the rows `within`.

    Stale, saturated and suspect rows and phases `left_out` are ignored. CalibrationError if no rows remain.
    """

    def sound(rows: slice) -> npt.NDArray[np.bool_]:
        counted = np.asarray((np.asarray(sensor.status[rows]) & (STALE | SATURATED | SUSPECT)) == 0)
        time = np.asarray(sensor.time[rows]) if left_out else np.zeros(0, np.int64)
        for phase in left_out:
            counted &= (time < phase.start_ns) | (time >= phase.end_ns)
        return counted

    rows = slice(0, len(sensor)) if within is None else within
    return _means(sensor.time, lambda part: np.asarray(sensor.counts[part], float), sound, width_s, sensor.where, rows)


def _means(
    time: NamedColumn,
    values: Callable[[slice], Floats],
    sound: Callable[[slice], npt.NDArray[np.bool_]],
    width_s: float,
    where: str,
    rows: slice,
) -> SegmentMeans:
    """Return the means of columns of values over segments of some rows."""
    if rows.stop <= rows.start:
        raise CalibrationError(f"{where}: no readings")
    begin = int(time[rows.start])
    span_ns = int(time[rows.stop - 1]) - begin + 1
    width_ns = max(round(width_s * 1e9), -(-span_ns // _MOST_SEGMENTS))
    count = -(-span_ns // width_ns)
    number, moments, sums = np.zeros(count), np.zeros(count), np.zeros((0, 0))
    for start in range(rows.start, rows.stop, 1 << 16):
        part = slice(start, min(start + (1 << 16), rows.stop))
        counted = sound(part)
        rows_used = slice(None) if counted.all() else counted  # avoids a copy
        since = (np.asarray(time[part])[rows_used] - begin).astype(np.int64)
        segment, value = since // width_ns, values(part)[rows_used]
        if len(segment) and (segment.min() < 0 or segment.max() >= count):
            raise CalibrationError(f"{where}: time does not increase")
        sums = np.zeros((count, value.shape[1])) if sums.size == 0 else sums
        starts = np.flatnonzero(np.diff(segment, prepend=-1))
        if len(starts):
            places = segment[starts]
            np.add.at(number, places, np.diff(starts, append=len(segment)))
            np.add.at(moments, places, np.add.reduceat(since.astype(float), starts))
            np.add.at(sums, places, np.add.reduceat(value, starts, axis=0))
    if not number.any():
        raise CalibrationError(f"{where}: no valid readings")
    full = number >= _FULL * np.median(number[number > 0])
    return SegmentMeans((begin + moments[full] / number[full]) * 1e-9, sums[full] / number[full, None])


def thermometer_of(log: Log, sensor: SensorLog, width_s: float) -> TemperatureSeries | None:
    """Return the best thermometer for `sensor` in its log, averaged over `width_s`: the barometer's, that of
    `/reference`, the chip's own, or another chip's (those with a zero first); None if there is none.
    """
    for barometer in log.of("pressure"):
        with suppress(CalibrationError, LogError):  # for example if it was imported without a temperature
            return _read("barometer", barometer.time, barometer.compensated("temperature"), 0.0, 1.0, width_s)
    track = log.reference
    if track is not None and track.temperature is not None:
        with suppress(CalibrationError):
            return _read("reference", track.time, track.temperature, 0.0, 1.0, width_s)
    return _chip_thermometer(log, sensor, width_s)


def chip_thermometer(log: Log, width_s: float) -> TemperatureSeries | None:
    """Return the thermometer of a log, averaged over `width_s`: a thermometer with a known zero (preferably a separate
    one, otherwise a chip's), or else one that measures changes only ("relative"); None without any.

    For three or more chips of one kind it is the median, which a single late or failed thermometer does not affect.
    """
    sensors = [*log.of("temperature"), *(sensor for sensor in log.sensors.values() if sensor.is_triad)]
    thermometers = [sensor for sensor in sensors if len(sensor) and degc_of(sensor) is not None]
    thermometers.sort(key=has_zero, reverse=True)
    first = _chip_thermometer(log, thermometers[0], width_s) if thermometers else None
    of_same_chip = [sensor for sensor in thermometers if sensor.is_triad and sensor.chip == thermometers[0].chip]
    if first is None or not thermometers[0].is_triad or len(of_same_chip) < FEWEST_ALIKE:
        return first
    other_series = [_chip_thermometer(log, sensor, width_s) for sensor in of_same_chip[1:]]
    degc = [first.degc, *(other.at(first.time_s) for other in other_series if other is not None)]
    means = [series.mean() for series in degc]
    changes = np.median([series - mean for series, mean in zip(degc, means, strict=True)], axis=0)
    return replace(first, degc=np.median(means) + changes)


def _chip_thermometer(log: Log, sensor: SensorLog, width_s: float) -> TemperatureSeries | None:
    others = sorted(log.sensors.values(), key=lambda other: (other.name != sensor.name, not has_zero(other)))
    for other in others:
        column, degc = other.temperature_counts, degc_of(other)
        if column is not None and degc is not None and len(other):
            return _read("chip" if has_zero(other) else "relative", other.time, column, *degc, width_s)
    return None


def _read(
    kind: str, time: NamedColumn, column: NamedColumn, zero: float, step: float, width_s: float
) -> TemperatureSeries:
    """Return the segment means of a temperature column's finite values; CalibrationError if there are none."""

    def values(rows: slice) -> Floats:
        return np.asarray(np.nan_to_num(np.asarray(column[rows], float), posinf=0.0, neginf=0.0)[:, None])

    means = _means(
        time,
        values,
        lambda part: np.isfinite(np.asarray(column[part], float)),
        width_s,
        column.name,
        slice(0, int(time.shape[0])),
    )
    return TemperatureSeries(kind, means.time_s, zero + step * means.mean[:, 0], abs(step))
