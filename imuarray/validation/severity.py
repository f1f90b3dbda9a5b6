"""The detection limit of an effect in the case in which it is active, by a matched statistic.

The case is recorded without the effect and with it, by the same random streams, so that the difference is due to the
effect. Each axis of each sensor is summarised in both: means of blocks, the spectrum at rest, the response to the
commanded motion, tails, codes, repeated rows, times. `matched_statistic` is the largest of

    T = sqrt(d' (C + A A')^-1 d)

d the differences of one summary, C their noise covariance in this case, A the columns that the nuisance quantities of
the case explain. T is the signal-to-noise ratio of a detector that knows everything else (Neyman and Pearson), and
T^2/2 is the expected log-likelihood ratio. At T = `LIMIT` the effect is just detectable. If an effect shifts the random
streams, part of the noise is drawn anew; its expected contribution, p for p summaries, is subtracted.

Nuisance quantities are those that differ from part to part within the data sheet, with the tolerances that the
diagnosis uses (`imuarray.gap.model.populations`): bias, its slope with temperature, its scatter from log to log, the
lag of the element's temperature, the response to force and rate, the noise, the cutoff of the filter, the delay of the
signal and the position of an accelerometer. The attitude of the box is also one, if no log states which axis was up and
no other accelerometer shows it; so is the position of the level within a code (Widrow and Kollar, Quantization Noise,
2008, ch. 4: the moments and the shares of codes of a rounded normal quantity vary with its mean by the characteristic
function at multiples of 2 pi). The motion is known if the recordings have a track or another sensor of the quantity; an
effect of the recorder changes all sensors alike, so that only a track shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise
from math import degrees, inf, nan, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.gap.inference.effects.motion import rotation_columns
from imuarray.gap.model.populations import (
    ANGLE_SIGMA_DEG,
    CUTOFF_TOLERANCE,
    LONGEST_LAG_S,
    POSITION_SIGMA_MM,
    TOLERANCE_SIGMAS,
    response_tolerance,
    scale_tolerance,
    slope_tolerance,
    turn_on_rms,
)
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.log import Log, SensorLog
from imuarray.log.format import SensorHeader
from imuarray.log.sensor_log import recorded_header
from imuarray.robust import MEDIAN_ABSOLUTE
from imuarray.simulate.effects.bandwidth import two_pole_cutoff_hz
from imuarray.simulate.model import noise_bandwidth_hz
from imuarray.units import INERTIAL, SI_PER_UNIT

LIMIT = 4.0
"""The matched statistic at the detection limit: by chance it is exceeded once in 30000 cases (normal distribution, one
side). Effects of the foreign world are measured in the same unit.
"""
FURTHEST = 64.0
"""Largest severity, and the inverse of the smallest one, in reference sizes."""
PROBES = 4
"""Maximum number of recordings in a search, the last one included."""
NEAR = 1.25
"""Factor from the wanted size within which a size is accepted."""

_BLOCKS = 12
_WINDOW = 64
_QUIET = 3.0
_FAR = 6.0
_COLUMNS = 21
"""Columns of the response to a motion: force, rate, their changes, squares of the force, products of rates."""
_FREE = 1e3
"""Prior of a fitted parameter: practically unbounded."""
_TILT_DEG = 1.0
"""Angle (one sigma) between the axis that is noted as up and the vertical."""


@dataclass(frozen=True)
class SeverityFit:
    """A severity and its measured size in detection limits; nan if the limits could not be reached."""

    severity: float
    limits: float


def find_severity(statistic: Callable[[float], float], wanted: float, first: float) -> SeverityFit:
    """Search the severity of `wanted` limits in a case. `statistic` returns the matched statistic of a severity; the
    search starts at `first` and follows a power law for at most `PROBES` recordings. If no recording comes within a
    factor of two of the wanted size, `limits` is nan, and the severity is the smallest one tried that exceeds the
    wanted size, or the largest one tried. An effect that is much larger damages the sensor in other ways.
    """
    trials: list[tuple[float, float]] = []
    severity = first
    for _ in range(PROBES):
        reached = statistic(severity) / LIMIT
        trials.append((severity, reached))
        if 1 / NEAR < reached / wanted < NEAR:
            return SeverityFit(severity, reached)
        severity = _next_severity(trials, wanted)
        if severity == trials[-1][0]:
            break
    severity, reached = min(trials, key=lambda trial: abs(np.log(max(trial[1], 1e-3) / wanted)))
    is_near = 0.5 < reached / wanted < 2.0
    if is_near:
        return SeverityFit(severity, reached)
    above = [trial for trial, size in trials if size > wanted]
    return SeverityFit(min(above) if above else max(trial for trial, _ in trials), nan)


def _next_severity(trials: Sequence[tuple[float, float]], wanted: float) -> float:
    """Return the next severity: by the power law through the last two, or in proportion to the last one; ten times the
    last one if the effect is not visible.
    """
    severity, reached = trials[-1]
    power = 1.0
    if reached < 0.05:
        return min(10 * severity, FURTHEST)
    if len(trials) > 1 and trials[-2][1] > 0.05 and trials[-2][0] != severity:
        slope = np.log(reached / trials[-2][1]) / np.log(severity / trials[-2][0])
        power = float(np.clip(slope, 0.5, 3.0))
    return float(np.clip(severity * (wanted / reached) ** (1 / power), 1 / FURTHEST, FURTHEST))


def matched_statistic(
    plain: Sequence[Log], changed: Sequence[Log], has_track: bool = True, is_of_recorder: bool = False
) -> float:
    """Return the largest matched statistic of any sensor's axis. `plain` logs have a reference if anything moved;
    `has_track` states whether the diagnosis also receives it, `is_of_recorder` whether the effect is of the recorder,
    and therefore the same for all sensors.
    """
    quantities = {name: sensor.quantity for log in plain for name, sensor in log.sensors.items()}
    inertial = [name for name, quantity in quantities.items() if quantity in INERTIAL]
    largest = 0.0
    for name in inertial:
        has_others = [quantities[other] for other in inertial].count(quantities[name]) > 1
        is_motion_known = has_track or (has_others and not is_of_recorder)
        pairs = [_LogPair(log, other, name) for log, other in zip(plain, changed, strict=True) if name in log.sensors]
        largest = max([largest, *_sensor_statistics(pairs, is_motion_known)])
    return largest


class _LogPair:
    """One sensor in one log without the effect and in the log with it."""

    def __init__(self, plain: Log, changed: Log, name: str) -> None:
        self.sensor: SensorLog = plain[name]
        self.header = recorded_header(self.sensor)
        self.tilt = _unknown_tilt(plain, self.sensor)
        self.time, self.counts = _columns(plain, name)
        self.new_time, self.new_counts = _columns(changed, name)
        rows = min(len(self.time), len(self.new_time))
        self.rows = rows
        self.quiet = _quiet(self.counts[:rows])
        gain = np.maximum(_leap(self.new_counts) / _leap(self.counts), 1.0) ** 2  # of the variance of white noise
        self.noise = _density(self.counts[:rows], self.quiet) * gain
        self.row_sigma = _row_sigma(self.counts[:rows], self.quiet)
        self.new_row_sigma = _row_sigma(self.new_counts[:rows], self.quiet)
        # Rounding noise always differs; the correlation of powers is the square of that of the noise.
        rounding = float((1 - (1 - 1 / (12 * self.row_sigma**2 + 1)) ** 2).max())
        self.anew = max(rounding, _share_drawn_anew(self.counts[:rows], self.new_counts[:rows], self.quiet))
        self.track = _track(plain)

    def motion(self) -> tuple[Floats, Floats, Floats]:
        """Return the commanded motion at the rows: force (n, 3) in g and rate (n, 3) in dps, in the sensor's axes, and
        temperature (n,) in degC; zeros without a track.
        """
        count = len(self.time)
        if self.track is None:
            return np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
        times, force_box, rate_box, degc = self.track
        turned = np.asarray(self.sensor.orientation)
        force, rate = (
            np.stack([np.interp(self.time, times, axis) for axis in values.T], axis=1) @ turned / SI_PER_UNIT[unit]
            for values, unit in ((force_box, "g"), (rate_box, "dps"))
        )
        return force, rate, np.interp(self.time, times, degc)

    def rows_at_rest(self) -> Booleans:
        """Return (n,) whether each row lies in a window at rest."""
        at_rest = np.zeros(len(self.time), bool)
        at_rest[: len(self.quiet) * _WINDOW] = np.repeat(self.quiet, _WINDOW)
        return at_rest

    def lagging_degc(self, degc: Floats) -> Floats:
        """Return the temperature (n,) of an element that follows `degc` by half of the longest usual time constant."""
        share = -np.expm1(-np.diff(self.time, prepend=self.time[:1]) * 1e-9 / (LONGEST_LAG_S / 2))
        lagging, element = np.empty(len(degc)), degc[0] if len(degc) else 0.0
        for at, (own, part) in enumerate(zip(degc.tolist(), share.tolist(), strict=True)):
            element += part * (own - element)
            lagging[at] = element
        return lagging


def _unknown_tilt(log: Log, sensor: SensorLog) -> float:
    """Return one sigma of the unknown angle of the box in rad that changes the readings of a sensor: 0 for other
    quantities and if other accelerometers also show the attitude; practically unbounded if no phase states which axis
    was up.
    """
    forces = [other for other in log.sensors.values() if other.quantity == "specific_force"]
    if sensor.quantity != "specific_force" or len(forces) > 1:
        return 0.0
    return radians(_TILT_DEG) if any(phase.up for phase in log.phases) else _FREE


def _track(log: Log) -> tuple[Floats, Floats, Floats, Floats] | None:
    """Return times, force, rate and temperature of a log's reference; None if one of them is missing."""
    track = log.reference
    if track is None or len(track.time) < 2:
        return None
    columns = [track.time, track.specific_force, track.angular_rate, track.temperature]
    known = [np.asarray(column[:], np.float64) for column in columns if column is not None]
    if len(known) < len(columns):
        return None
    time, force, rate, degc = known
    return time, force, rate, degc


def _columns(log: Log, name: str) -> tuple[Floats, Floats]:
    if name not in log.sensors:
        return np.zeros(0), np.zeros((0, 3))
    sensor = log[name]
    return np.asarray(sensor.time[:], float), np.asarray(sensor.counts[:], float)


def _windows(counts: Floats) -> Floats:
    """Split (n, 3) into (m, `_WINDOW`, 3), each detrended linearly."""
    many = len(counts) // _WINDOW
    cut = counts[: many * _WINDOW].reshape(many, _WINDOW, 3)
    ramp = np.linspace(-1, 1, _WINDOW)[:, None]
    level = cut - cut.mean(axis=1, keepdims=True)
    slope = (level * ramp).sum(axis=1, keepdims=True) / float((ramp**2).sum())
    return np.asarray(level - slope * ramp)


def _quiet(counts: Floats) -> Booleans:
    """Return (m,) whether each window is at rest: its standard deviation is at most `_QUIET` times the lower quartile
    of all windows.
    """
    spread = _windows(counts).std(axis=1).max(axis=1) if len(counts) >= _WINDOW else np.zeros(0)
    return np.asarray(spread <= _QUIET * np.quantile(spread, 0.25) + 1e-9) if len(spread) else np.zeros(0, bool)


def _density(counts: Floats, quiet: Booleans) -> Floats:
    """Return (3,) the variance per row that the mean of many rows scatters with; at least that of rounding."""
    spectra = _spectra(counts, quiet)
    low = spectra[:, 2:8].mean(axis=(0, 1)) if len(spectra) else counts.var(axis=0) if len(counts) else np.ones(3)
    return np.maximum(low, 1 / 12)


def _leap(counts: Floats) -> Floats:
    """Return (3,) the typical second difference of the readings; at least that of rounding."""
    leaps = np.abs(np.diff(counts, 2, axis=0))
    return np.maximum(np.median(leaps, axis=0) / MEDIAN_ABSOLUTE, 0.5) if len(leaps) else np.full(3, 0.5)


def _spectra(counts: Floats, quiet: Booleans) -> Floats:
    """Return (m, k, 3) periodograms of the quiet windows; white noise of variance 1 gives 1."""
    windows = _windows(counts)[: len(quiet)]
    windows = windows[quiet[: len(windows)]]
    taper = np.hanning(_WINDOW)[:, None]
    return np.asarray(np.abs(np.fft.rfft(windows * taper, axis=1)) ** 2 / float((taper**2).sum()))


def _share_drawn_anew(plain: Floats, changed: Floats, quiet: Booleans) -> float:
    """Return the share of the noise that differs with the effect, 0 to 1: 1 for independent noise, also of another
    size, and 0 for the same noise.
    """
    if len(plain) < 8:
        return 0.0
    moved, before, after = (_step_square(counts) for counts in (changed - plain, plain, changed))
    return float(np.clip(np.max(moved / np.maximum(before + after, 0.5)), 0.0, 1.0))


def _step_square(counts: Floats) -> Floats:
    """Return (3,) the mean square of the steps of the readings from row to row, less their median, without outliers. A
    median of the sizes would be too coarse, because those of a quiet sensor are one or two counts.
    """
    steps = np.diff(counts, axis=0)
    sizes = np.abs(steps - np.median(steps, axis=0))
    most = _FAR * np.maximum(np.median(sizes, axis=0) / MEDIAN_ABSOLUTE, 0.5)
    return np.asarray((np.minimum(sizes, most) ** 2).mean(axis=0))


def _sensor_statistics(pairs: Sequence[_LogPair], is_motion_known: bool) -> Iterator[float]:
    used = [pair for pair in pairs if pair.rows >= 4]
    if not used:
        yield inf if any(len(pair.time) for pair in pairs) else 0.0
        return
    anew = max(pair.anew for pair in used)
    yield from _levels(used, anew, is_motion_known)
    yield from _spectrum(used, anew)
    if is_motion_known:
        yield from _motion_responses(used, anew)
    for pair in used:
        yield from _events(pair, anew)


def _score(difference: Floats, variance: Floats, explained: Floats, anew: float) -> float:
    """Return T of p differences with these noise variances. Columns (p, k) are one sigma of explained changes."""
    count = explained.shape[1]
    weighed = np.vstack([explained / np.sqrt(variance)[:, None], np.eye(count)])
    d = np.concatenate([difference / np.sqrt(variance), np.zeros(count)])
    residual = d - weighed @ np.linalg.lstsq(weighed, d, rcond=None)[0]
    square = float(residual @ residual)
    return sqrt(max(square - 2 * anew * len(difference), 0.0) / max(1.0, 2 * anew))


class _Block(NamedTuple):
    """Means over one of the blocks of log `number`: `difference` (3,) in counts with its noise `variance` (3,); force
    and rate (3,) to which the axes respond, their `change` (3,) per s in the sensor's unit, temperature and lag of the
    element's temperature in degC; one sigma of the box's unknown `tilt` in rad.
    """

    number: int
    difference: Floats
    variance: Floats
    force: Floats
    rate: Floats
    change: Floats
    degc: float
    lag_degc: float
    tilt: float


def _levels(pairs: Sequence[_LogPair], anew: float, is_motion_known: bool) -> Iterator[float]:
    """Yield the statistic of block means over all logs, without the part that bias, its slope with temperature and the
    thermal lag, response and delay of a part, and an unknown attitude explain. If the motion is not known, rows in
    motion are omitted.
    """
    blocks = [block for number, pair in enumerate(pairs) for block in _blocks(pair, number, is_motion_known)]
    if not blocks:
        return
    header = pairs[0].header
    slopes = np.nan_to_num(slope_tolerance(header), nan=0.0) / TOLERANCE_SIGMAS
    logs = np.eye(len(pairs))[[block.number for block in blocks]]
    warmth, lags = np.array([[block.degc, block.lag_degc] for block in blocks]).T[:, :, None]
    responses = np.array([[*block.force, *block.rate] for block in blocks])
    for axis in range(3):
        explained = np.hstack(
            [
                np.full((len(blocks), 1), _FREE),
                _FREE * warmth,
                slopes[axis] * lags,
                responses * _responses(header, axis),
                turn_on_rms(header) * logs,
                [[_delay_s(header) * block.change[axis]] for block in blocks],
                _leans(blocks, axis),
            ]
        )
        difference = np.array([block.difference[axis] for block in blocks])
        variance = np.array([block.variance[axis] for block in blocks])
        yield _score(difference, variance, explained * header.sensitivity, anew)


def _blocks(pair: _LogPair, number: int, is_motion_known: bool) -> Iterator[_Block]:
    force, rate, degc = pair.motion()
    lag_degc = pair.lagging_degc(degc) - degc
    is_accelerometer = pair.header.unit == "g"
    commanded = force if is_accelerometer else rate
    own_readings = pair.counts / pair.sensor.sensitivity  # a scale factor error also multiplies vibrations
    stimulus, turned = (own_readings, rate) if is_accelerometer else (force, own_readings)
    at_rest = np.ones(len(pair.time), bool) if is_motion_known else pair.rows_at_rest()
    new_at_rest = np.interp(pair.new_time, pair.time, at_rest.astype(float)) > 0.5
    rounding = 0.5 * (_rounding_share(pair.row_sigma, 1) / pi) ** 2
    for begin, end in pairwise(np.linspace(pair.time[0], pair.time[-1] + 1, _BLOCKS + 1)):
        rows = at_rest & (pair.time >= begin) & (pair.time < end)
        new_rows = new_at_rest & (pair.new_time >= begin) & (pair.new_time < end)
        if rows.sum() < 2 or new_rows.sum() < 2:
            continue
        first, last = np.flatnonzero(rows)[[0, -1]]
        yield _Block(
            number,
            pair.new_counts[new_rows].mean(axis=0) - pair.counts[rows].mean(axis=0),
            pair.noise / rows.sum() + rounding,
            stimulus[rows].mean(axis=0),
            turned[rows].mean(axis=0),
            (commanded[last] - commanded[first]) / ((end - begin) * 1e-9),
            float(degc[rows].mean()) - REFERENCE_DEGC,
            float(lag_degc[rows].mean()),
            pair.tilt,
        )


def _leans(blocks: Sequence[_Block], axis: int) -> Floats:
    """Return (p, k) the changes of the readings of an axis by an unknown attitude, one sigma each, in g: the force on a
    block along the two other axes times the angle, which is common to the blocks of a log in one attitude.
    """
    poses = [(block.number, *np.round(block.force, 1).tolist()) for block in blocks]
    names = list(dict.fromkeys(poses))
    table = np.zeros((len(blocks), 2 * len(names)))
    for row, (pose, block) in enumerate(zip(poses, blocks, strict=True)):
        place = 2 * names.index(pose)
        table[row, place : place + 2] = block.tilt * np.delete(block.force, axis)
    return table


def _responses(header: SensorHeader, axis: int) -> list[float]:
    """Return one sigma of the response to force and to rate along each axis, in the sensor's unit."""
    to_force = (response_tolerance(header)[axis] / TOLERANCE_SIGMAS).tolist()
    if header.unit == "g":
        return [*to_force, 0.0, 0.0, 0.0]
    to_rate = np.full(3, sin(radians(ANGLE_SIGMA_DEG)))
    to_rate[axis] = scale_tolerance(header) / TOLERANCE_SIGMAS
    return [*to_force, *to_rate.tolist()]


def _spectrum(pairs: Sequence[_LogPair], anew: float) -> Iterator[float]:
    """Yield the statistic of the logarithmic spectrum at rest over all logs, without the part that the noise power, a
    change of the cutoff and the noise of rounding explain.
    """
    changes, filters, roundings = list[tuple[Floats, float]](), list[Floats](), list[Floats]()
    for pair in pairs:
        before, after = (_spectra(counts[: pair.rows], pair.quiet) for counts in (pair.counts, pair.new_counts))
        if len(before) and len(before) == len(after):
            powers = before.mean(axis=0)[1:] + 0.01
            change = np.log(after.mean(axis=0)[1:] + 0.01) - np.log(powers)
            changes.append((change, 1.0 / len(before)))
            filters.append(_cutoff_slope(pair, len(change)))
            roundings.append(1 / 12 / powers)
    if not changes:
        return
    bins = len(changes[0][0])
    variance = np.repeat([item for _, item in changes], bins)
    for axis in range(3):
        change, rounding = (
            np.concatenate([v[:, axis] for v in values]) for values in ([c for c, _ in changes], roundings)
        )
        explained = [np.full(len(change), _FREE), CUTOFF_TOLERANCE * np.concatenate(filters), rounding]
        yield _score(change, variance, np.stack(explained, axis=1), anew)


def _cutoff_slope(pair: _LogPair, bins: int) -> Floats:
    """Return (bins,) the change of the logarithmic spectrum for a relative change of the cutoff of one pole, from the
    first frequency above zero to half the rate of the rows.
    """
    cutoff_hz = noise_bandwidth_hz(pair.header)
    if cutoff_hz <= 0:
        return np.zeros(bins)
    nyquist_hz = 0.5e9 / float(np.median(np.diff(pair.time)))
    square = (nyquist_hz * np.arange(1, bins + 1) / bins / cutoff_hz) ** 2
    return np.asarray(2 * square / (1 + square))


def _motion_responses(pairs: Sequence[_LogPair], anew: float) -> Iterator[float]:
    """Yield the statistic of the difference's response to force and rate, their derivatives, squares and products."""
    header = pairs[0].header
    parts = [pair for pair in pairs if pair.track is not None and not pair.quiet.all()]
    if not parts:
        return
    designs, differences, weights = list[Floats](), list[Floats](), list[Floats]()
    for pair in parts:
        force, rate, _ = pair.motion()
        spin = np.radians(rate)
        changes = [np.gradient(values, pair.time * 1e-9, axis=0) for values in (force, spin)]
        products = [spin[:, [a]] * spin[:, [b]] for a, b in combinations_with_replacement(range(3), 2)]
        designs.append(np.hstack([force, rate, *changes, force**2, *products]))
        interpolated = np.stack([np.interp(pair.time, pair.new_time, axis) for axis in pair.new_counts.T], axis=1)
        differences.append(interpolated - pair.counts)
        weights.append(np.repeat(pair.noise[None], len(force), axis=0))
    # Block means are subtracted: levels and their drift with temperature have a statistic of their own.
    design, difference = (
        np.vstack([block - block.mean(axis=0) for log in logs for block in np.array_split(log, _BLOCKS) if len(block)])
        for logs in (designs, differences)
    )
    variance = np.vstack(weights)
    spread = design.std(axis=0)
    used = np.flatnonzero(spread > 1e-6)
    if not len(used):
        return
    scaled = design[:, used] / spread[used]
    for axis in range(3):
        reach = np.zeros(design.shape[1])
        reach[:6] = _responses(header, axis)
        reach[:3] = np.where(np.arange(3) == axis, reach[:3], np.hypot(reach[:3], max(pair.tilt for pair in parts)))
        reach[6 + axis if header.unit == "g" else 9 + axis] = _delay_s(header) * (
            1 if header.unit == "g" else degrees(1)
        )
        basis, values, tolerance = np.linalg.svd(scaled / np.sqrt(variance[:, [axis]]), full_matrices=False)
        kept = values > 1e-6 * values[0]
        coefficient = basis[:, kept].T @ (difference[:, axis] / np.sqrt(variance[:, axis]))
        nuisances = np.concatenate([np.diag(reach)[:, reach > 0], _displacements(header, axis)], axis=1)
        explained = (values[kept, None] * tolerance[kept]) @ (spread[:, None] * nuisances)[used] * header.sensitivity
        yield _score(coefficient, np.ones(int(kept.sum())), explained, anew)


def _displacements(header: SensorHeader, axis: int) -> Floats:
    """Return (21, 3) the response that a displacement along each axis (one sigma) adds to an axis of an accelerometer,
    in g, for each column of the design of `_motion_responses`.
    """
    added = np.zeros((_COLUMNS, 3))
    if header.unit == "g":
        products, turns = np.split(rotation_columns()[:, axis] * POSITION_SIGMA_MM * 1e-3 / SI_PER_UNIT["g"], [6])
        added[9:12], added[15:] = turns, products
    return added


def _delay_s(header: SensorHeader) -> float:
    """Return one sigma of the delay of a sensor's signal in s: that of its filter, from the tolerance of its cutoff,
    plus one sample of the chip.
    """
    cutoff_hz = noise_bandwidth_hz(header)
    filter_s = CUTOFF_TOLERANCE * two_pole_cutoff_hz(cutoff_hz) if cutoff_hz > 0 else 0.0
    return filter_s + (1 / header.rate_hz if header.rate_hz > 0 else 0.0)


def _events(pair: _LogPair, anew: float) -> Iterator[float]:
    """Yield the statistics of event counts: outliers, missing codes, repeated rows, late or lost rows."""
    before, after = pair.counts, pair.new_counts
    yield _count_statistic(_far(before, pair.row_sigma), _far(after, pair.new_row_sigma), anew)
    yield _repetition_statistic(pair, anew)
    period = np.median(np.diff(pair.time))
    for beyond in (0.02, 0.5):
        late = [
            int((np.abs(np.diff(counts) - period) > beyond * period).sum()) for counts in (pair.time, pair.new_time)
        ]
        yield _count_statistic(late[0], late[1], 0.0)
    yield _count_statistic(0, abs(len(before) - len(after)), 0.0)
    for step in (2, 4, 8):
        shares = [[(counts % step == rest).mean(axis=0) for rest in range(step)] for counts in (before, after)]
        change = np.abs(np.array(shares[1]) - np.array(shares[0]))
        # The change by a different level, at the smaller noise.
        level = 2 / step * _rounding_share(np.minimum(pair.row_sigma, pair.new_row_sigma), step).max()
        if min(_spread(before)) > 0.3 * step:
            # Any effect changes the code of each row.
            yield float(change.max() / sqrt(2 / (len(before) * step) + level**2))


def _repetition_statistic(pair: _LogPair, anew: float) -> float:
    """Compare the numbers of rows that repeat the codes of the row before, allowing for changes by the noise and by a
    different level within a code. With white noise, the codes of three axes repeat in inverse proportion to the product
    of the three standard deviations.
    """
    before, after = (int((np.diff(counts, axis=0) == 0).all(axis=1).sum()) for counts in (pair.counts, pair.new_counts))
    expected = before * float(np.clip(np.prod(pair.row_sigma / pair.new_row_sigma), 0.1, 10.0))
    level = sqrt(float(np.sum(np.exp(-((pi * pair.row_sigma) ** 2)) ** 2)) * 2)  # relative, three axes
    noise = max(1.0, 2 * anew) / 4 + (level**2 + (expected / max(before, 1) - 1) ** 2 / 4) * expected / 4
    return abs(sqrt(after + 0.375) - sqrt(expected + 0.375)) / sqrt(noise)


def _row_sigma(counts: Floats, quiet: Booleans) -> Floats:
    """Return (3,) the standard deviation of the white noise of a row at rest; at least a fifth of a code."""
    count = len(quiet) * _WINDOW
    at_rest = counts[:count].reshape(len(quiet), _WINDOW, 3)[quiet] if count else counts[None]
    leaps = np.diff(at_rest, 2, axis=1).reshape(-1, 3)
    if not len(leaps):
        return np.full(3, 0.2)
    bounded = np.minimum(np.abs(leaps), _FAR * _leap(counts))
    return np.asarray(np.maximum(np.sqrt((bounded**2).mean(axis=0) / 6), 0.2))


def _rounding_share(row_sigma: Floats, step: int) -> Floats:
    """Return (3,) half the relative amplitude at which the share of codes of a residue class modulo `step` varies with
    the level of a rounded normal quantity: its first harmonic. Divided by pi, for a step of 1, it is the amplitude of
    the error of the mean code.
    """
    return np.asarray(np.exp(-2 * (pi * row_sigma / step) ** 2))


def _far(counts: Floats, row_sigma: Floats) -> int:
    """Return the number of second differences that exceed `_FAR` standard deviations of their own noise."""
    threshold = _FAR * np.maximum(_leap(counts), sqrt(6) * row_sigma)
    return int((np.abs(np.diff(counts, 2, axis=0)) > threshold).any(axis=1).sum())


def _count_statistic(before: int, after: int, anew: float) -> float:
    """Compare two counts by their square roots, whose standard deviation is a half."""
    return 2 * abs(sqrt(after + 0.375) - sqrt(before + 0.375)) / sqrt(max(1.0, 2 * anew))


def _spread(counts: Floats) -> Floats:
    return np.asarray(np.median(np.abs(np.diff(counts, axis=0)), axis=0)) if len(counts) > 1 else np.zeros(3)
