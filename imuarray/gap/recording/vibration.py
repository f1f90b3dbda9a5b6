"""Vibrations of the surroundings that several sensors measure while the box is at rest: a floor, a fan, a hair dryer.

A box at rest stands on something that vibrates a little, always or while a machine runs. Every sensor of the quantity
measures the same vibration along the axes of the box; it is a property of the place and not of a sensor. Its power in
each band of frequencies has two estimates. The first is the cross-spectrum of sensors that were read at the same times.
The second is the excess of the spectra over those in the quietest part of the recordings; it also includes vibrations
faster than the rows show, which sensors that are read at different moments do not measure alike. A sensor that would
show the vibration but does not contradicts both. An excess of the only accelerometer that would show it counts too if
it is small: its origin cannot be determined.

A wander below `LOWEST_HZ` is no vibration.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Complexes, Floats, Times
from imuarray.log import SensorLog
from imuarray.log.format import Phase, SensorHeader
from imuarray.units import INERTIAL, SI_PER_UNIT, STANDARD_GRAVITY

LOWEST_HZ, BAND_RATIO = 2.0, 1.4
"""Lowest frequency of a vibration, in Hz, and ratio of the edges of a band."""

_LOWEST_SHARE = 0.25
"""Largest lowest frequency as a share of half of the row rate: in slow rows, vibrations have other frequencies."""

MOST = {"specific_force": 10e-3 * STANDARD_GRAVITY, "angular_rate": math.radians(1.0)}
"""Largest root mean square of a vibration of the surroundings along an axis, in SI units. A box that vibrates more is
not at rest.
"""

MOST_ALONE = 3e-3 * STANDARD_GRAVITY
"""The same in m/s2 for a vibration that only one accelerometer would show."""

_BLOCK_S, _MOST_BLOCKS, _BLOCK_ROWS = 20.0, 60, 1 << 15
"""Least length, in s, of the parts of a phase in which a vibration is constant; the largest number of parts of a phase,
and of rows of a sensor that are used in each.
"""

_BIN_HZ, _LEAST_SEGMENT, _MOST_SEGMENT = 1.0, 16, 1024
"""Resolution of a spectrum in Hz, and limits of the number of rows of its segments, a power of two."""

_FEWEST_SEGMENTS = 6
"""Fewest segments of a part."""

_INDEPENDENT = 0.35
"""Independent values per bin and segment: segments overlap by half, the window correlates neighbouring bins, and a
median scatters more than a mean.
"""

_SAME_RATE = 0.03
"""Relative difference of the rates of rows up to which spectra of different logs are compared."""

_STEADY = 0.5
"""Largest relative deviation of an interval between rows in a segment."""

_CERTAIN, _LIKELY, _CONFIRMED = 4.5, 3.0, 2.5
"""Standard deviations by which a vibration exceeds chance over a phase; by which it does so in a band next to such a
band, or along another axis; and by which each of two sensors shows it.
"""

_LEAST_SHARE, _SURE = 0.4, 3.0
"""A sensor contradicts a vibration if it measures less than this share of its power, by at least this number of
standard deviations.
"""

_QUIET = 0.25
"""Share of the parts of all phases, those with the least power, in which the box is taken as quiet."""

_OF_QUIETEST = 1.27
"""Standard deviations by which the lowest quarter of normal values lies below their mean."""

_MOST_COHERENCE = 0.98
"""Largest correlation of two axes."""

_STABLE = 0.02
"""Relative standard deviation of the power of a sensor's own noise over time."""

_CHANGES = 3.0
"""Standard deviations by which parts of a phase differ if the vibration is not constant in it."""


class Vibration(NamedTuple):
    """A vibration along the axes of the box in the time [start_ns, end_ns): power densities (b, 3) in squared SI units
    per Hz in bands between the `edges_hz` (b + 1,), of what the sensors have in `common` and of what each of them
    measures for itself (`private`), since it is faster than the rows; `coherence` (b, 3, 3) are the correlations of the
    axes.
    """

    start_ns: int
    end_ns: int
    quantity: str
    edges_hz: tuple[float, ...]
    common: Floats
    private: Floats
    coherence: Floats

    def autocovariance(self, lag_s: float) -> Floats:
        """Return the autocovariance (3,) along the axes of the box at a lag, in squared SI units."""
        edges = np.array(self.edges_hz)
        waves = np.diff(np.sin(2 * np.pi * edges * lag_s)) / (2 * np.pi * lag_s) if lag_s else np.diff(edges)
        return np.asarray(waves @ (self.common + self.private))


def vibrations_of(
    logs: Sequence[Mapping[str, SensorLog]],
    rests: Sequence[Sequence[Phase]],
    uncertain_ns: Sequence[Mapping[str, Times]],
) -> tuple[tuple[Vibration, ...], ...]:
    """Return the vibrations of the surroundings in the phases at rest of each log, from its sensors by name, without
    the rows at uncertain times.
    """
    by_log: list[list[Vibration]] = [[] for _ in logs]
    for quantity in INERTIAL:
        triads = [
            {name: sensor for name, sensor in log.items() if sensor.quantity == quantity and sensor.sensitivity}
            for log in logs
        ]
        rates = [rate for log in triads for sensor in log.values() if (rate := _rows_per_s(sensor)) > 0]
        edges_hz = _edges_hz(max(rates, default=0.0) / 2)
        if len(edges_hz) < 2:
            continue
        phases = [
            (number, _powers_of(log, phase, edges_hz, uncertain_ns[number]))
            for number, (log, of_log) in enumerate(zip(triads, rests, strict=True))
            for phase in of_log
        ]
        known = [(number, powers) for number, powers in phases if powers.sensors and len(powers.edges_ns) > 1]
        for group in _groups(known):
            phases_of_group = [powers for _, powers in group]
            quietest, usual = _quietest(phases_of_group), _usual(phases_of_group)
            for number, powers in group:
                by_log[number] += _vibrations(quantity, edges_hz, powers, quietest, usual)
    return tuple(map(tuple, by_log))


def vibration_along(
    header: SensorHeader, vibrations: Sequence[Vibration], start_ns: int, end_ns: int, lag_s: float = 0.0
) -> Floats:
    """Return the autocovariance (3,) of the vibrations at a lag along a sensor's axes, averaged over a time, in squared
    counts.
    """
    total_box = np.zeros(3)
    for vibration in vibrations:
        together_ns = min(end_ns, vibration.end_ns) - max(start_ns, vibration.start_ns)
        if vibration.quantity == header.quantity and together_ns > 0:
            total_box += vibration.autocovariance(lag_s) * (together_ns / (end_ns - start_ns))
    counts = header.sensitivity / SI_PER_UNIT[header.unit]
    return np.asarray(total_box @ np.square(np.array(header.orientation)) * counts**2)


class _Power(NamedTuple):
    """Power of a sensor along the axes of the box in p parts of a phase: densities (p, b, 3) in b bands, nan in bands
    that its rows do not show, and `products` (p, b, 3), the real parts of the cross-densities of the axes xy, xz and
    yz; `deviation` (p, b) is the relative standard deviation of the densities.
    """

    density: Floats
    products: Floats
    deviation: Floats


class _Pair(NamedTuple):
    """Cross-spectrum of two sensors in p parts of a phase: real parts of the densities (p, b, 3) along the axes of the
    box and of the `products` (p, b, 3) of the axes xy, xz and yz, and the standard deviations (p, b, 3) of the
    densities for independent noise.
    """

    density: Floats
    products: Floats
    deviation: Floats


class _Powers(NamedTuple):
    """Powers by sensor in the parts of a phase between `edges_ns`, cross-spectra by pair of sensors, and row rates."""

    edges_ns: tuple[int, ...]
    sensors: Mapping[str, _Power]
    pairs: Mapping[tuple[str, str], _Pair]
    rows_per_s: Mapping[str, float]


def _groups(phases: Sequence[tuple[int, _Powers]]) -> list[list[tuple[int, _Powers]]]:
    """Group phases in which the sensors have the same rates of rows: at another rate, the same noise has another
    density.
    """
    groups: list[list[tuple[int, _Powers]]] = []
    for number, powers in phases:
        for group in groups:
            others = group[0][1].rows_per_s
            shared = [(rate, others[name]) for name, rate in powers.rows_per_s.items() if name in others]
            if shared and all(abs(rate / other - 1) < _SAME_RATE for rate, other in shared):
                group.append((number, powers))
                break
        else:
            groups.append([(number, powers)])
    return groups


def _rows_per_s(sensor: SensorLog) -> float:
    """Return the usual number of rows of a sensor per second; 0 if it has too few."""
    time_ns = np.asarray(sensor.time[:_BLOCK_ROWS], np.int64)
    interval_ns = float(np.median(np.diff(time_ns))) if len(time_ns) > _LEAST_SEGMENT else 0.0
    return 1e9 / interval_ns if interval_ns > 0 else 0.0


def _edges_hz(highest_hz: float) -> tuple[float, ...]:
    """Return the edges of the bands up to the highest frequency."""
    lowest_hz = min(LOWEST_HZ, _LOWEST_SHARE * highest_hz)
    bands = round(math.log(highest_hz / lowest_hz) / math.log(BAND_RATIO)) if lowest_hz > 0 else 0
    return tuple(np.geomspace(lowest_hz, highest_hz, bands + 1).tolist()) if bands else ()


def _powers_of(
    sensors: Mapping[str, SensorLog], phase: Phase, edges_hz: Sequence[float], uncertain_ns: Mapping[str, Times]
) -> _Powers:
    """Return the powers of sensors in the parts of a phase."""
    seconds = (phase.end_ns - phase.start_ns) * 1e-9
    rates = {name: rate for name, sensor in sensors.items() if (rate := _rows_per_s(sensor)) > 0}
    part_s = max(_BLOCK_S, _FEWEST_SEGMENTS * _LEAST_SEGMENT / min(rates.values(), default=1.0))
    parts = int(min(max(seconds // part_s, 1), _MOST_BLOCKS))
    edges_ns = tuple(np.linspace(phase.start_ns, phase.end_ns, parts + 1).astype(np.int64).tolist())
    by_sensor: dict[str, list[_Power]] = {name: [] for name in sensors}
    by_pair: dict[tuple[str, str], list[_Pair]] = {}
    for span_ns in pairwise(edges_ns):
        waves = {
            name: wave
            for name, sensor in sensors.items()
            if (wave := _waves_of(sensor, *span_ns, uncertain_ns.get(name, np.zeros(0, np.int64)))) is not None
        }
        for name in sensors:
            by_sensor[name].append(_own_power(waves.get(name), edges_hz))
        names = [name for name in sensors if name in waves]
        for at, first in enumerate(names):
            for second in names[at + 1 :]:
                common = _common_power(waves[first], waves[second], edges_hz)
                by_pair.setdefault((first, second), []).append(common)
    powers = {name: _Power(*map(np.array, zip(*of_parts, strict=True))) for name, of_parts in by_sensor.items()}
    known = {name: power for name, power in powers.items() if np.isfinite(power.density).any()}
    pairs = {
        pair: _Pair(*map(np.array, zip(*several, strict=True)))
        for pair, several in by_pair.items()
        if len(several) == parts
    }
    return _Powers(edges_ns, known, pairs, rates)


class _Waves(NamedTuple):
    """Rows of a sensor in a part of a phase: times (n,) in s, readings (n, 3) along the axes of the box in SI units,
    which of them are compared, their rate, and the number of rows of a segment.
    """

    time_s: Floats
    readings_box: Floats
    is_certain: Booleans
    rows_per_s: float
    segment: int


def _waves_of(sensor: SensorLog, start_ns: int, end_ns: int, uncertain_ns: Times) -> _Waves | None:
    """Return the rows of a sensor in a part of a phase; None if they are too few."""
    first, stop, _ = sensor.between(start_ns, end_ns).indices(len(sensor))
    stop = min(stop, first + _BLOCK_ROWS)
    if stop - first <= _LEAST_SEGMENT:
        return None
    time_ns = np.asarray(sensor.time[first:stop], np.int64)
    time_s: Floats = (time_ns - start_ns).astype(np.float64) * 1e-9
    interval_s = float(np.median(np.diff(time_s)))
    if interval_s <= 0:
        return None
    segment = 1 << round(math.log2(1 / interval_s / _BIN_HZ)) if interval_s < 1 else 1
    unit = SI_PER_UNIT[sensor.unit] / sensor.sensitivity
    turn = np.array(sensor.orientation, np.float64).T * unit
    readings: Floats = np.asarray(sensor.counts[first:stop], np.float64) @ turn
    is_certain = ~np.isin(time_ns, uncertain_ns)
    return _Waves(time_s, readings, is_certain, 1 / interval_s, min(max(segment, _LEAST_SEGMENT), _MOST_SEGMENT))


def _transforms(waves: _Waves, rows: Sequence[int], readings: Floats) -> Complexes:
    """Return Fourier transforms (s, f, 3) of segments that begin at `rows`, scaled to densities in squared units per
    Hz.
    """
    window = np.hanning(waves.segment + 1)[:-1]
    parts = np.stack([readings[row : row + waves.segment] for row in rows])
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window[:, None]
    scale = math.sqrt(2 / (waves.rows_per_s * float(window @ window)))
    return np.asarray(np.fft.rfft(parts, axis=1) * scale)


def _starts(waves: _Waves, is_usable: Booleans) -> list[int]:
    """Return the first rows of the segments in which all intervals are regular and all rows usable."""
    is_bad = np.r_[False, np.abs(np.diff(waves.time_s) * waves.rows_per_s - 1) > _STEADY] | ~is_usable
    is_bad |= ~waves.is_certain
    bad = np.concatenate([[0], np.cumsum(is_bad)])
    rows = np.arange(0, len(is_bad) - waves.segment + 1, waves.segment // 2)
    return [row for row in rows.tolist() if bad[row + waves.segment] == bad[row]]


def _in_bands(density: Floats, waves: _Waves, edges_hz: Sequence[float]) -> tuple[Floats, Floats]:
    """Return the typical value of densities (f, k) in each band, nan in bands without bins, and the number of bins
    (b,). It is the median, so that lines have no influence, or the mean of fewer than three bins. The bin at half of
    the row rate is left out.
    """
    hertz = np.arange(len(density)) * waves.rows_per_s / waves.segment
    bands = len(edges_hz) - 1
    values, bins = np.full((bands, density.shape[1]), np.nan), np.zeros(bands)
    for at, (low_hz, high_hz) in enumerate(pairwise(edges_hz)):
        inside = (hertz >= low_hz) & (hertz < high_hz)
        inside[:2], inside[-1:] = False, False
        if inside.any():
            several = density[inside]
            values[at] = np.median(several, axis=0) if len(several) > 2 else several.mean(axis=0)
            bins[at] = len(several)
    return values, bins


def _own_power(waves: _Waves | None, edges_hz: Sequence[float]) -> _Power:
    """Return the power of a sensor in one part of a phase: arrays (b, 3), (b, 3) and (b,)."""
    bands = len(edges_hz) - 1
    rows = _starts(waves, np.ones(len(waves.time_s), bool)) if waves is not None else []
    if waves is None or len(rows) < _FEWEST_SEGMENTS:
        return _Power(np.full((bands, 3), np.nan), np.full((bands, 3), np.nan), np.full(bands, np.nan))
    own = _transforms(waves, rows, waves.readings_box)
    density, bins = _in_bands(_products(own, own), waves, edges_hz)
    return _Power(density[:, :3], density[:, 3:], 1 / np.sqrt(np.maximum(bins * len(rows) * _INDEPENDENT, 1.0)))


_FIRST, _SECOND = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
"""Axes of the products xx, yy, zz, xy, xz and yz."""


def _products(first: Complexes, second: Complexes) -> Floats:
    """Return the means (f, 6) over segments of the real parts of the products of transforms (s, f, 3), symmetric in the
    axes.
    """
    several = first[..., _FIRST] * second[..., _SECOND].conj() + first[..., _SECOND] * second[..., _FIRST].conj()
    return np.asarray(several.real.mean(axis=0) / 2)


def _common_power(first: _Waves, second: _Waves, edges_hz: Sequence[float]) -> _Pair:
    """Return the cross-spectrum of two sensors in one part of a phase: arrays (b, 3).

    Rows at one rate are matched by their times, and the offset between them is a phase shift. If the rates differ, the
    faster sensor is interpolated, up to a quarter of its rate.
    """
    if first.rows_per_s > second.rows_per_s:
        first, second = second, first
    half_s = 0.5 / first.rows_per_s
    at = np.searchsorted(second.time_s, first.time_s - half_s).clip(0, len(second.time_s) - 1)
    offset_s = second.time_s[at] - first.time_s
    is_usable = (np.abs(offset_s) < 2 * half_s) & (np.diff(at, prepend=at[0] - 1) == 1)
    rows, readings = _starts(first, is_usable), second.readings_box[at]
    hertz = np.arange(first.segment // 2 + 1) * first.rows_per_s / first.segment
    shift_s, highest_hz = float(np.median(offset_s)), math.inf
    if len(rows) * first.segment < len(at):  # the clocks differ
        is_usable = (first.time_s >= second.time_s[0]) & (first.time_s <= second.time_s[-1])
        rows, shift_s, highest_hz = _starts(first, is_usable), 0.0, second.rows_per_s / 4
        readings = np.column_stack([np.interp(first.time_s, second.time_s, column) for column in second.readings_box.T])
    if len(rows) < _FEWEST_SEGMENTS:
        return _Pair(*np.full((3, len(edges_hz) - 1, 3), np.nan))
    own = _transforms(first, rows, first.readings_box)
    other = _transforms(first, rows, readings)
    density, bins = _in_bands(_products(own, other * np.exp(-2j * np.pi * hertz * shift_s)[:, None]), first, edges_hz)
    squares = np.square(np.abs(own)).mean(axis=0) * np.square(np.abs(other)).mean(axis=0)
    noise, _ = _in_bands(np.sqrt(squares), first, edges_hz)
    density[np.array(edges_hz[1:]) > highest_hz] = np.nan
    count = np.maximum(bins * len(rows) * _INDEPENDENT, 1.0)
    return _Pair(density[:, :3], density[:, 3:], noise / np.sqrt(2 * count)[:, None])


def _quietest(phases: Sequence[_Powers]) -> dict[str, _Power]:
    """Return the power of each sensor in the quietest parts of all phases, with one part: those of all logs with the
    least power over all sensors and bands.
    """
    names = dict.fromkeys(name for powers in phases for name in powers.sensors)
    density = {name: _stacked(phases, name) for name in names}
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        heights = [
            np.log(power.density / np.nanmedian(power.density, axis=0)).reshape(len(power.density), -1)
            for power in density.values()
        ]
    values = np.concatenate(heights, axis=1)
    deviations = np.concatenate([np.repeat(power.deviation, 3, axis=1) for power in density.values()], axis=1)
    known_deviations = np.where(np.isfinite(values), deviations, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # parts without values
        height = np.nanmean(values, axis=1)
        chance = np.nanmean(known_deviations**2, axis=1) / np.isfinite(known_deviations).sum(axis=1)
        is_quiet = height <= np.nanquantile(height, _QUIET)
        scatter = float(np.nanstd(height))
    selected = _OF_QUIETEST * float(np.nanmean(chance)) / scatter if scatter > 0 else 0.0  # by chance, as a share
    quietest = {}
    for name, power in density.items():
        known = is_quiet & np.isfinite(power.density).any(axis=(1, 2))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # bands without values
            density_mean, products, deviation = (np.nanmean(each[known], axis=0) for each in power)
        share = math.exp(min(selected, 1.0))
        quietest[name] = _Power(share * density_mean, products, deviation / math.sqrt(max(int(known.sum()), 1)))
    return quietest


def _stacked(phases: Sequence[_Powers], name: str) -> _Power:
    """Return the power of a sensor in the parts of all phases, nan in phases in which it was not read."""
    first = next(powers.sensors[name] for powers in phases if name in powers.sensors)
    parts = [
        powers.sensors.get(name)
        or _Power(*(np.full((len(powers.edges_ns) - 1, *each.shape[1:]), np.nan) for each in first))
        for powers in phases
    ]
    return _Power(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _vibrations(
    quantity: str,
    edges_hz: tuple[float, ...],
    powers: _Powers,
    quietest: Mapping[str, _Power],
    usual: Floats,
) -> Iterator[Vibration]:
    """Yield the vibrations in the parts of a phase."""
    shared = _shared(powers, usual)
    excess = _excess(quantity, powers, quietest, np.diff(edges_hz))
    total = np.maximum(shared, excess)
    if not total.any():
        return
    power = (total * np.diff(edges_hz)[:, None]).sum(axis=1)
    if np.sqrt(power.max()) > MOST[quantity]:
        return
    private, coherence = total - shared, _coherence(powers, quietest)
    groups: list[list[int]] = []
    for at in range(len(total)):
        if groups and (total[at] == total[groups[-1][0]]).all() and (shared[at] == shared[groups[-1][0]]).all():
            groups[-1].append(at)
        else:
            groups.append([at])
    for group in groups:
        if total[group[0]].any():
            yield Vibration(
                powers.edges_ns[group[0]],
                powers.edges_ns[group[-1] + 1],
                quantity,
                edges_hz,
                shared[group[0]],
                private[group[0]],
                coherence,
            )


def _coherence(powers: _Powers, quietest: Mapping[str, _Power]) -> Floats:
    """Return the correlations (b, 3, 3) of a vibration along the axes: those of the cross-spectra of sensors where they
    are significant, or else those of the excess of the spectra of the least noisy sensor. Correlations within chance
    are 0.
    """
    pairs = powers.pairs.values()
    coherence = np.tile(np.eye(3), (len(next(iter(powers.sensors.values())).density[0]), 1, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bands without values
        name = min(powers.sensors, key=lambda sensor: float(np.nanmean(quietest[sensor].density)))
        least, quiet = powers.sensors[name], quietest[name]
        scatters = [np.square(least.density * least.deviation[..., None])[None] / 2]
        products = [np.nanmean(least.products - quiet.products, axis=0)]
        densities = [np.nanmean(least.density - quiet.density, axis=0)]
        if pairs:
            scatters.append(np.array([np.square(pair.deviation) for pair in pairs]))
            products.append(np.nanmean([pair.products for pair in pairs], axis=(0, 1)))
            densities.append(np.nanmean([pair.density for pair in pairs], axis=(0, 1)))
    for product, density, scatter in zip(products, densities, scatters, strict=True):
        deviation = np.sqrt(np.nansum(scatter, axis=(0, 1))) / np.maximum(np.isfinite(scatter).sum(axis=(0, 1)), 1)
        size = np.sqrt(np.maximum(np.nan_to_num(density), 0.0))
        for at, (first, second) in enumerate(((0, 1), (0, 2), (1, 2))):
            chance, scale = np.sqrt(deviation[:, first] * deviation[:, second]), size[:, first] * size[:, second]
            is_real = (np.abs(product[:, at]) > _SURE * chance) & (scale > 0)
            value = np.where(is_real, product[:, at], 0.0) / np.where(scale > 0, scale, 1.0)
            value = np.where(is_real, value.clip(-_MOST_COHERENCE, _MOST_COHERENCE), coherence[:, first, second])
            coherence[:, first, second] = coherence[:, second, first] = value
    levels, axes = np.linalg.eigh(coherence)
    positive = (axes * np.maximum(levels, 0.0)[:, None]) @ axes.swapaxes(1, 2)
    own = np.sqrt(np.diagonal(positive, axis1=1, axis2=2))
    return np.asarray(positive / own[:, :, None] / own[:, None, :])


class _Estimates(NamedTuple):
    """Estimates (e, p, b, 3) of a power by several sensors or pairs, and their standard deviations; nan if unknown."""

    value: Floats
    deviation: Floats

    def over_parts(self) -> _Estimates:
        """Return the means (e, b, 3) over the parts, and their standard deviations."""
        known = np.isfinite(self.value) & np.isfinite(self.deviation)
        count = np.maximum(known.sum(axis=1), 1)
        value = np.where(known, self.value, 0.0).sum(axis=1) / count
        deviation = np.sqrt(np.square(np.where(known, self.deviation, 0.0)).sum(axis=1)) / count
        unknown = ~known.any(axis=1)
        return _Estimates(np.where(unknown, np.nan, value), np.where(unknown, np.nan, deviation))

    def mean(self) -> _Estimates:
        """Return the weighted mean of the estimates of all sensors, and its standard deviation."""
        known = np.isfinite(self.value) & (self.deviation > 0)
        weight = np.where(known, 1 / np.square(np.where(known, self.deviation, 1.0)), 0.0)
        total = weight.sum(axis=0)
        is_known, total = total > 0, np.where(total > 0, total, 1.0)
        value = (weight * np.where(known, self.value, 0.0)).sum(axis=0) / total
        return _Estimates(np.where(is_known, value, np.nan), np.where(is_known, 1 / np.sqrt(total), np.nan))


def _shared(powers: _Powers, usual: Floats) -> Floats:
    """Return the density (p, b, 3) that the sensors have in common in the parts of a phase, by their cross-spectra:
    that of the phase where it is significant, the `usual` one (b, 3) of all phases where that is compatible with it,
    at most the power of the least noisy sensor.
    """
    if not powers.pairs:
        return np.zeros_like(next(iter(powers.sensors.values())).density)
    pairs = _pairs_of(powers)
    phase = pairs.over_parts()
    mean, deviation = phase.mean()
    is_real = _is_shared(powers, tuple(powers.pairs), phase)
    own = _over_time(pairs.mean(), mean, is_real, _relative(powers))
    is_usual = ~is_real & (np.abs(mean - usual) < _SURE * deviation)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bands without values
        most = np.nanmin([power.density for power in powers.sensors.values()], axis=0) * (1 + _SURE * _relative(powers))
    return np.asarray(np.fmin(np.where(is_usual, usual, own), most))


def _usual(phases: Sequence[_Powers]) -> Floats:
    """Return the density (b, 3) that the sensors have in common in the phases without a significant one of their own,
    taken together; 0 where it is not significant.
    """
    with_pairs = [powers for powers in phases if powers.pairs]
    if not with_pairs:
        return np.zeros(())
    names = tuple(dict.fromkeys(pair for powers in with_pairs for pair in powers.pairs))
    values: list[list[Floats]] = []
    deviations: list[list[Floats]] = []
    for powers in with_pairs:
        phase = _pairs_of(powers).over_parts()
        is_own = _is_shared(powers, tuple(powers.pairs), phase)
        value = dict(zip(powers.pairs, np.where(is_own, np.nan, phase.value), strict=True))
        deviation = dict(zip(powers.pairs, phase.deviation, strict=True))
        unknown = np.full(is_own.shape, np.nan)
        values.append([value.get(pair, unknown) for pair in names])
        deviations.append([deviation.get(pair, unknown) for pair in names])
    together = _Estimates(np.array(values), np.array(deviations)).mean()
    longest = max(with_pairs, key=lambda powers: powers.edges_ns[-1] - powers.edges_ns[0])
    is_real = _is_shared(longest, names, together)
    return np.where(is_real, together.mean().value, 0.0)


def _pairs_of(powers: _Powers) -> _Estimates:
    pairs = powers.pairs.values()
    return _Estimates(np.array([pair.density for pair in pairs]), np.array([pair.deviation for pair in pairs]))


def _is_shared(powers: _Powers, names: Sequence[tuple[str, str]], pairs: _Estimates) -> Booleans:
    """Return where the power (e, b, 3) that pairs of sensors have in common is significant and no sensor contradicts
    it. A sensor without a pair contradicts it by its own power.
    """
    mean, deviation = pairs.mean()
    is_compatible = np.ones(mean.shape, bool)
    for name in dict.fromkeys(name for pair in names for name in pair):
        places = [at for at, pair in enumerate(names) if name in pair]
        estimate = _Estimates(pairs.value[places], pairs.deviation[places]).mean()
        is_compatible &= ~_contradicts(estimate.value, estimate.deviation, mean)
    for name, power in powers.sensors.items():
        if not any(name in pair for pair in names):
            deviations = power.density * power.deviation[..., None]
            own = _Estimates(power.density[None], deviations[None]).over_parts()
            is_compatible &= ~_contradicts(own.value[0], own.deviation[0], mean)
    return _with_neighbours(is_compatible & (mean > _CERTAIN * deviation), is_compatible & (mean > _LIKELY * deviation))


def _with_neighbours(is_real: Booleans, is_likely: Booleans) -> Booleans:
    """Return where a vibration is real, by band and axis (b, 3), or likely and next to a real one: in a neighbouring
    band or along another axis.
    """
    near = is_real.any(axis=1, keepdims=True) | np.zeros_like(is_real)
    near[1:] |= is_real[:-1]
    near[:-1] |= is_real[1:]
    return np.asarray(is_real | (near & is_likely))


def _contradicts(value: Floats, deviation: Floats, expected: Floats) -> Booleans:
    """Return where a sensor measures far less power than expected."""
    return np.asarray((value < _LEAST_SHARE * expected) & (expected - value > _SURE * deviation))


def _relative(powers: _Powers) -> Floats:
    """Return the relative standard deviation (p, b, 1) of a power that all sensors have in common."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # bands without values
        return np.asarray(np.nanmin([power.deviation for power in powers.sensors.values()], axis=0)[..., None])


def _over_time(parts: _Estimates, mean: Floats, is_real: Booleans, relative: Floats) -> Floats:
    """Return the density (p, b, 3) in the parts of a phase: the mean over the phase where the parts do not differ, and
    0 where it is not real. The power itself has the standard deviation `relative` (p, b, 1).
    """
    value, deviation = parts.value, np.hypot(parts.deviation, relative * mean)
    count = np.maximum(np.isfinite(value).sum(axis=0), 2)
    spread = np.nansum(np.square((value - mean) / np.where(deviation > 0, deviation, np.inf)), axis=0) / (count - 1)
    changes = (spread - 1) > _CHANGES * np.sqrt(2 / (count - 1))
    own = np.where(np.isfinite(value), np.maximum(value, 0.0), np.nan_to_num(mean))
    return np.asarray(np.where(is_real, np.where(changes, own, np.nan_to_num(mean)), 0.0))


def _excess(quantity: str, powers: _Powers, quietest: Mapping[str, _Power], widths_hz: Floats) -> Floats:
    """Return the density (p, b, 3) by which the spectra of several sensors exceed those in the quietest phase; 0 where
    it is not significant, not confirmed or contradicted.
    """
    names = list(powers.sensors)
    density = np.array([powers.sensors[name].density for name in names])
    deviation = density * np.array([powers.sensors[name].deviation for name in names])[..., None]
    quiet = np.array([quietest[name].density for name in names])
    quiet_deviation = quiet * np.array([quietest[name].deviation for name in names])[..., None]
    parts = _Estimates(density - quiet[:, None], deviation)
    phase = parts.over_parts()
    phase = phase._replace(deviation=np.sqrt(phase.deviation**2 + quiet_deviation**2 + (_STABLE * quiet) ** 2))
    mean, mean_deviation = phase.mean()
    shows = phase.value > _CONFIRMED * phase.deviation
    is_compatible = np.ones(mean.shape, bool)
    for at in range(len(names)):
        is_compatible &= ~_contradicts(phase.value[at], phase.deviation[at], mean)
    is_certain = is_compatible & (mean > _CERTAIN * mean_deviation)
    is_confirmed = is_certain & (shows.sum(axis=0) > 1)
    would_show = mean > _SURE * phase.deviation
    is_alone = is_certain & (shows.sum(axis=0) == 1) & (would_show.sum(axis=0) <= 1)
    alone = (np.where(is_alone, mean, 0.0) * widths_hz[:, None]).sum(axis=0)
    is_faint = (alone < MOST_ALONE**2) & (quantity == "specific_force")
    is_likely = is_compatible & (mean > _LIKELY * mean_deviation)
    is_real = _with_neighbours(is_confirmed | (is_alone & is_faint), is_likely)
    return _over_time(parts.mean(), mean, is_real, _relative(powers))
