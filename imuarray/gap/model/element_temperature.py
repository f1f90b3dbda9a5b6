"""Temperature of the sensing elements, which follows the temperature that is measured in the box with a lag.

A chip, its board and the air around them take up to some tens of seconds to warm up, and no data sheet prints this
time. The time constant of each chip is therefore a nuisance parameter, fitted to the readings during heating and
limited to `LONGEST_LAG_S`, or to a longer time if the chips' own thermometers have one (`longest_lags_s`).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, MutableMapping, Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.model.populations import LONGEST_LAG_S
from imuarray.gap.recording.recordings import CHIP_LEAD_S
from imuarray.gap.statistics.campaign import Campaign, LogSummary
from imuarray.gap.statistics.segments import Segments
from imuarray.simulate.effects.temperature import ThermalLag
from imuarray.simulate.motion.stimulus import Motion, thermometer_lag_s

LONGEST_DIE_LAG_S, _BEYOND_DIE = 50.0, 1.25
"""Longest usual time constant, in s, that a die's thermometer can justify: some tens of seconds for a small board in
still air; and the largest ratio of the time constant of an element to that of its die.
"""

LEAST_HEATING_DEGC = 3.0
"""Least range of temperatures, in degC, in one attitude of the box from which a slope or a lag is estimated: within
minutes a bias wanders by as much as it changes per degree.
"""

_LAGS_S = (0.0, 1.0, 2.0, 3.5, CHIP_LEAD_S, 7.5, 10.0, 14.0, LONGEST_LAG_S, 28.0, 38.0, LONGEST_DIE_LAG_S)
"""Time constants that are tried, in s; the minimum between them is that of a parabola through the sums of squares."""

_GAIN = 16.0
"""Least decrease of chi-squared for which a lag is accepted: four standard deviations."""

_GAIN_BY_CHIP = 2.0
"""The same if a chip's thermometer measures the temperature: the lag of that thermometer is not known, so the usual lag
has little weight.
"""

_MOST_CACHED = 2000
"""Largest number of cached temperature arrays per motion, one for each phase and time constant; replicates have the
same times.
"""

_cache: MutableMapping[Motion, dict[tuple[bytes, float], Floats]] = WeakKeyDictionary()


def with_element_temperatures(campaign: Campaign, motions: Sequence[Motion], lags_s: Mapping[str, float]) -> Campaign:
    """Return the campaign with the temperatures of each sensor's element in its segments at rest, which lag by the
    time constants `lags_s`.
    """
    if not any(lags_s.values()):
        return campaign
    return Campaign(tuple(_log_with(log, motion, lags_s) for log, motion in zip(campaign.logs, motions, strict=True)))


class HeatedRest(NamedTuple):
    """A phase at rest: the `attitude` of the box, which several phases can have in common, its segments, the motion of
    the log, and the readings (s, a) of the segments with rows: of three axes in the sensor's unit, or of a thermometer
    in counts.
    """

    attitude: Hashable
    segments: Segments
    motion: Motion
    readings: Floats


def longest_lags_s(rests: Mapping[str, Sequence[HeatedRest]]) -> dict[str, float]:
    """Return the longest usual time constant, in s, of the element of each sensor with the phases at rest `rests`.

    It is the time constant of the die, measured by its own thermometer, with a margin; at least `LONGEST_LAG_S` and at
    most `LONGEST_DIE_LAG_S`. For a chip without a usable thermometer the longest one of the other chips is used.
    """
    by_sensor = {sensor: _die_lag_s(phases) for sensor, phases in rests.items()}
    slowest_s = max((lag_s for lag_s in by_sensor.values() if lag_s is not None), default=0.0)
    return {
        sensor: min(max(LONGEST_LAG_S, _BEYOND_DIE * (slowest_s if lag_s is None else lag_s)), LONGEST_DIE_LAG_S)
        for sensor, lag_s in by_sensor.items()
    }


def _die_lag_s(rests: Sequence[HeatedRest]) -> float | None:
    """Return the time constant, in s, with which a chip's own thermometer follows the temperature best; None without a
    thermometer or without heating.
    """
    known = []
    for rest in rests:
        counts = rest.segments.thermometer[rest.segments.rows > 0]
        if len(counts) and np.isfinite(counts).all():
            known.append(rest._replace(readings=counts[:, None]))
    attitudes = _heated_attitudes(known)
    if not attitudes:
        return None
    misfits = [_misfits(attitudes, lag_s, np.ones(1))[0] for lag_s in _LAGS_S]
    return _least(misfits, _LAGS_S)


def fit_lag(rests: Sequence[HeatedRest], rms: Floats, longest_s: float = LONGEST_LAG_S) -> float:
    """Return the time constant in s, from 0 to `longest_s`, with which the readings in these phases follow the
    temperature best.

    `rms` (3,) is the noise of single readings in the sensor's unit. If no attitude has enough heating, or if no lag is
    significantly better, the usual lag is returned: 0, or that of the chip thermometer that measured the temperature
    (`CHIP_LEAD_S`). If a parabola over temperature with the usual lag fits better than a straight line with any lag,
    the lag is fitted together with a parabola, since with a temperature that only rises a curve is similar to a lag.
    """
    attitudes, lags_s = _heated_attitudes(rests), [*(lag_s for lag_s in _LAGS_S if lag_s < longest_s), longest_s]
    usual_s = usual_lag_s([rest.motion for rest in rests])
    if not attitudes or not rms.all():
        return usual_s
    usual = int(np.abs(np.subtract(lags_s, usual_s)).argmin())
    straight, curved = np.array([_misfits(attitudes, lag_s, rms) for lag_s in lags_s]).T
    misfits = curved if straight.min() - curved[usual] > _GAIN else straight
    if not misfits[usual] - misfits.min() > (_GAIN_BY_CHIP if usual_s else _GAIN):
        return usual_s
    return _least(misfits, lags_s)


def _least(misfits: Sequence[float] | Floats, lags_s: Sequence[float]) -> float:
    """Return the lag with the least misfit, interpolated by a parabola through the least misfit and its neighbours."""
    best = int(np.argmin(misfits))
    near = slice(max(best - 1, 0), best + 2)
    if len(misfits[near]) < 3:
        return lags_s[best]
    curve, slope, _ = np.polyfit(lags_s[near], misfits[near], 2)
    return float(np.clip(-slope / (2 * curve), lags_s[best - 1], lags_s[best + 1])) if curve > 0 else lags_s[best]


def usual_lag_s(motions: Sequence[Motion]) -> float:
    """Return the lag, in s, that is assumed for a chip whose readings do not determine it, in logs with these motions:
    0, or that of the chip thermometer that measured the temperature.
    """
    return max(map(thermometer_lag_s, motions), default=0.0)


def _heated_attitudes(rests: Sequence[HeatedRest]) -> list[list[HeatedRest]]:
    """Return the phases of each attitude in which the temperature changes by at least `LEAST_HEATING_DEGC`."""
    by_attitude: dict[Hashable, list[HeatedRest]] = {}
    for rest in rests:
        by_attitude.setdefault(rest.attitude, []).append(rest)
    return [members for members in by_attitude.values() if _is_heated(members)]


def _is_heated(rests: Sequence[HeatedRest]) -> bool:
    degc = np.concatenate([rest.segments.temperature_degc[rest.segments.rows > 0] for rest in rests])
    return float(np.ptp(degc)) >= LEAST_HEATING_DEGC


def _misfits(attitudes: Sequence[Sequence[HeatedRest]], lag_s: float, rms: Floats) -> tuple[float, float]:
    """Return chi-squared of the readings (s, a) with noise `rms` (a,) about a straight line and about a parabola over
    the lagged temperature, with one level for each attitude.
    """
    moments, shared, total = np.zeros((2, 2)), np.zeros((2, len(rms))), np.zeros(len(rms))
    for members in attitudes:
        has_rows = [rest.segments.rows > 0 for rest in members]
        rows = np.concatenate([rest.segments.rows[mask] for rest, mask in zip(members, has_rows, strict=True)])
        degc = np.concatenate(
            [lagged_degc(rest.segments, rest.motion, lag_s)[mask] for rest, mask in zip(members, has_rows, strict=True)]
        )
        readings = np.concatenate([rest.readings for rest in members])
        warm = degc - np.average(degc, weights=rows)
        powers = np.stack([warm, warm**2 - np.average(warm**2, weights=rows)])
        apart = readings - np.average(readings, axis=0, weights=rows)
        moments += (rows * powers) @ powers.T
        shared += (rows * powers) @ apart
        total += rows @ apart**2
    straight = total - shared[0] ** 2 / moments[0, 0]
    curved = total - np.einsum("pa,pa->a", shared, np.linalg.lstsq(moments, shared, rcond=1e-12)[0])
    return float((straight / rms**2).sum()), float((curved / rms**2).sum())


def _log_with(log: LogSummary, motion: Motion, lags_s: Mapping[str, float]) -> LogSummary:
    phases = []
    for part in log.phases:
        sensors = {
            name: replace(summary, segments=_segments_with(summary.segments, motion, lags_s[name]))
            if lags_s.get(name) and part.is_still
            else summary
            for name, summary in part.sensors.items()
        }
        phases.append(replace(part, sensors=sensors))
    return replace(log, phases=tuple(phases))


def _segments_with(segments: Segments, motion: Motion, lag_s: float) -> Segments:
    degc = lagged_degc(segments, motion, lag_s)
    return replace(segments, temperature_degc=degc, warming_degc_per_s=(segments.temperature_degc - degc) / lag_s)


def lagged_degc(segments: Segments, motion: Motion, lag_s: float) -> Floats:
    """Return the temperature (s,), in degC, of an element with the time constant `lag_s` at the segments' mean times;
    nan for segments without rows.
    """
    if lag_s == 0.0:
        return segments.temperature_degc
    of_motion = _cache.setdefault(motion, {})
    key = segments.time_s.tobytes(), lag_s
    if key not in of_motion:
        has_rows = segments.rows > 0
        degc = np.full(len(has_rows), np.nan)
        if has_rows.any():
            at_ns = np.rint(segments.time_s[has_rows] * 1e9).astype(np.int64)
            degc[has_rows] = ThermalLag(lag_s).temperature_degc(at_ns, motion)
        if len(of_motion) >= _MOST_CACHED:
            of_motion.clear()
        of_motion[key] = degc
    return of_motion[key]
