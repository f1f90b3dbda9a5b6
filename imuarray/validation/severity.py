"""The detection limit of an effect in the very case in which it is put to work, by matched statistics.

The case is recorded without the effect and with it, by the same random streams, so that what differs is the effect's
doing. From both, each axis of each sensor is summarised: levels of stretches, the spectrum at rest, the answer to what
the box was told to do, tails, codes, repeated rows, times. `matched` is the largest of

    T = sqrt(d' (C + A A')^-1 d)

d the differences of one summary, C their variance by noise in this case, A what a fit or a part's tolerance explains
(bias, its slope with temperature, response to force and rate): the signal-to-noise ratio of a detector that knows all
the rest (Neyman and Pearson), with T^2/2 the expected log-likelihood ratio. At a T of `LIMIT` the effect just shows.
Noise that is drawn anew because an effect moves when it is drawn is taken off: its expectation, p for p summaries.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf, nan, sqrt

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.log import Log, SensorLog
from imuarray.units import SI_PER_UNIT

LIMIT = 4.0
"""Of the matched statistic: chance alone is beyond it once in 30000 (normal distribution, one side). Effects of the
foreign world are measured in the same unit."""
FURTHEST = 64.0
"""How far severities go either way, in reference sizes."""
PROBES = 4
"""So often a size is tried, the last one included."""
NEAR = 1.25
"""A size is right that is so many times too large or too small at most."""

_BLOCKS = 12
_WINDOW = 64
_QUIET = 3.0
_FAR = 6.0
_FREE = 1e3
"""Of what is fitted: as good as no bound."""
_SCALE, _CROSS, _G_SENSITIVITY_DPS, _TURN_ON = 0.03, 0.03, 0.02, 0.003
"""Tolerances of a part (one sigma): scale, and sine of an angle; dps per g; scatter of the bias between logs, as a
share of 0.1 g or 10 dps.
"""
_BIAS = {"g": 0.1, "dps": 10.0}


@dataclass(frozen=True)
class Sized:
    """A severity and how many detection limits it is as measured; nan if none could be reached."""

    severity: float
    limits: float


def sized(record: Callable[[float], Sequence[Log]], plain: Sequence[Log], wanted: float, first: float) -> Sized:
    """The severity of `wanted` limits in this case: what `record`s a severity is asked at `first`, then where a power
    law leads, `PROBES` times at most. limits is nan if the greatest severity doesn't get so far.
    """
    tried: list[tuple[float, float]] = []
    severity = first
    for _ in range(PROBES):
        reached = matched(plain, record(severity)) / LIMIT
        tried.append((severity, reached))
        if 1 / NEAR < reached / wanted < NEAR:
            return Sized(severity, reached)
        severity = _next(tried, wanted)
        if severity == tried[-1][0]:
            break
    severity, reached = min(tried, key=lambda one: abs(np.log(max(one[1], 1e-3) / wanted)))
    is_near = 0.5 < reached / wanted < 2.0
    return Sized(severity, reached) if is_near else Sized(max(one for one, _ in tried), nan)


def _next(tried: Sequence[tuple[float, float]], wanted: float) -> float:
    """By the power law of the last two, or in proportion; tenfold where nothing shows."""
    severity, reached = tried[-1]
    power = 1.0
    if reached < 0.05:
        return min(10 * severity, FURTHEST)
    if len(tried) > 1 and tried[-2][1] > 0.05 and tried[-2][0] != severity:
        slope = np.log(reached / tried[-2][1]) / np.log(severity / tried[-2][0])
        power = float(np.clip(slope, 0.5, 3.0))
    return float(np.clip(severity * (wanted / reached) ** (1 / power), 1 / FURTHEST, FURTHEST))


def matched(plain: Sequence[Log], changed: Sequence[Log]) -> float:
    """The largest matched statistic of any sensor's axis; `plain` logs have a reference if anything moved."""
    found = 0.0
    for name in dict.fromkeys(name for log in plain for name, one in log.sensors.items() if one.quantity in _SENSED):
        pairs = [_Pair(log, other, name) for log, other in zip(plain, changed, strict=True) if name in log.sensors]
        found = max([found, *_of_sensor(pairs)])
    return found


_SENSED = {"specific_force": "g", "angular_rate": "dps"}


class _Pair:
    """One sensor in one log, without the effect and with it."""

    def __init__(self, plain: Log, changed: Log, name: str) -> None:
        self.sensor: SensorLog = plain[name]
        self.time, self.counts = _columns(plain, name)
        self.new_time, self.new_counts = _columns(changed, name)
        rows = min(len(self.time), len(self.new_time))
        self.rows = rows
        self.quiet = _quiet(self.counts[:rows])
        self.noise = _density(self.counts[:rows], self.quiet)
        self.anew = _drawn_anew(self.counts[:rows], self.new_counts[:rows], self.quiet)
        self.track = _track(plain)

    def told(self, at_ns: Floats) -> tuple[Floats, Floats, Floats]:
        """What the box was told to do at these times: force (n, 3) and rate (n, 3) in the sensor's axes and its unit or
        its companion's, temperature (n,).
        """
        turned = np.asarray(self.sensor.orientation)
        if self.track is None:
            return np.zeros((len(at_ns), 3)), np.zeros((len(at_ns), 3)), np.zeros(len(at_ns))
        times, force, rate, degc = self.track
        columns = []
        for values, unit in ((force, "g"), (rate, "dps")):
            rows = [np.interp(at_ns, times, axis) for axis in values.T]
            columns.append(np.stack(rows, axis=1) @ turned / SI_PER_UNIT[unit])
        return columns[0], columns[1], np.interp(at_ns, times, degc)


def _track(log: Log) -> tuple[Floats, Floats, Floats, Floats] | None:
    """Times, force, rate and temperature of a log's reference; None if it doesn't tell all of them."""
    told = log.reference
    if told is None or told.specific_force is None or told.angular_rate is None or told.temperature is None:
        return None
    if len(told.time) < 2:
        return None
    time, force, rate, degc = (
        np.asarray(one[:], np.float64) for one in (told.time, told.specific_force, told.angular_rate, told.temperature)
    )
    return time, force, rate, degc


def _columns(log: Log, name: str) -> tuple[Floats, Floats]:
    if name not in log.sensors:
        return np.zeros(0), np.zeros((0, 3))
    sensor = log[name]
    return np.asarray(sensor.time[:], float), np.asarray(sensor.counts[:], float)


def _windows(counts: Floats) -> Floats:
    """(m, `_WINDOW`, 3) of (n, 3), each without its line."""
    many = len(counts) // _WINDOW
    cut = counts[: many * _WINDOW].reshape(many, _WINDOW, 3)
    ramp = np.linspace(-1, 1, _WINDOW)[:, None]
    level = cut - cut.mean(axis=1, keepdims=True)
    slope = (level * ramp).sum(axis=1, keepdims=True) / float((ramp**2).sum())
    return np.asarray(level - slope * ramp)


def _quiet(counts: Floats) -> Booleans:
    """(m,) the windows in which nothing but noise goes on: those that are about as still as the stillest half."""
    spread = _windows(counts).std(axis=1).max(axis=1) if len(counts) >= _WINDOW else np.zeros(0)
    return np.asarray(spread <= _QUIET * np.quantile(spread, 0.25) + 1e-9) if len(spread) else np.zeros(0, bool)


def _density(counts: Floats, quiet: Booleans) -> Floats:
    """(3,) variance of a row that the mean of many scatters with; at least that of rounding."""
    spectra = _spectra(counts, quiet)
    low = spectra[:, 2:8].mean(axis=(0, 1)) if len(spectra) else counts.var(axis=0) if len(counts) else np.ones(3)
    return np.maximum(low, 1 / 12)


def _spectra(counts: Floats, quiet: Booleans) -> Floats:
    """(m, k, 3) periodograms of the quiet windows; white noise of variance 1 has 1."""
    windows = _windows(counts)[: len(quiet)]
    windows = windows[quiet[: len(windows)]]
    taper = np.hanning(_WINDOW)[:, None]
    return np.asarray(np.abs(np.fft.rfft(windows * taper, axis=1)) ** 2 / float((taper**2).sum()))


def _drawn_anew(plain: Floats, changed: Floats, quiet: Booleans) -> float:
    """Share of the noise that is another with the effect, 0 to 1."""
    if len(plain) < 8:
        return 0.0
    moved, before = np.diff(changed - plain, axis=0), np.diff(plain, axis=0)
    scatter = [np.median(np.abs(one - np.median(one, axis=0)), axis=0) for one in (moved, before)]
    return float(np.clip(np.max(scatter[0] ** 2 / np.maximum(2 * scatter[1] ** 2, 0.5)), 0.0, 1.0))


def _of_sensor(pairs: Sequence[_Pair]) -> Iterator[float]:
    used = [pair for pair in pairs if pair.rows >= 4]
    if not used:
        yield inf if any(len(pair.time) for pair in pairs) else 0.0
        return
    anew = max(pair.anew for pair in used)
    yield from _levels(used, anew)
    yield from _spectrum(used, anew)
    yield from _answers(used, anew)
    for pair in used:
        yield from _events(pair, anew)


def _score(difference: Floats, variance: Floats, explained: Floats, anew: float) -> float:
    """T of p differences with these variances by noise, and columns (p, k) of what is explained, one sigma each."""
    count = explained.shape[1]
    weighed = np.vstack([explained / np.sqrt(variance)[:, None], np.eye(count)])
    d = np.concatenate([difference / np.sqrt(variance), np.zeros(count)])
    left = d - weighed @ np.linalg.lstsq(weighed, d, rcond=None)[0]
    square = float(left @ left)
    return sqrt(max(square - 2 * anew * len(difference), 0.0) / max(1.0, 2 * anew))


def _levels(pairs: Sequence[_Pair], anew: float) -> Iterator[float]:
    """Means of stretches of all logs, less bias, its slope with temperature and the response that a part may have."""
    unit = _SENSED[pairs[0].sensor.quantity]
    rows, columns = list[tuple[Floats, Floats]](), list[Floats]()
    for number, pair in enumerate(pairs):
        edges = np.linspace(pair.time[0], pair.time[-1] + 1, _BLOCKS + 1)
        force, rate, degc = pair.told(pair.time)
        for begin, end in pairwise(edges):
            own, new = (pair.time >= begin) & (pair.time < end), (pair.new_time >= begin) & (pair.new_time < end)
            if own.sum() < 2 or new.sum() < 2:
                continue
            difference = pair.new_counts[new].mean(axis=0) - pair.counts[own].mean(axis=0)
            rows.append((difference, pair.noise / own.sum()))
            log = np.eye(len(pairs))[number]
            columns.append(
                np.array([1.0, degc[own].mean() - 25.0, *force[own].mean(axis=0), *rate[own].mean(axis=0), *log])
            )
    if not rows:
        return
    size = pairs[0].sensor.sensitivity
    table = np.array(columns)
    for axis in range(3):
        reach = np.array([_FREE, _FREE, *_responses(unit, axis), *[_TURN_ON * _BIAS[unit]] * len(pairs)]) * size
        difference, variance = (np.array([row[part][axis] for row in rows]) for part in (0, 1))
        yield _score(difference, variance, table * reach, anew)


def _responses(unit: str, axis: int) -> list[float]:
    """One sigma of the response to force and to rate along each axis, in the sensor's unit."""
    own = [_SCALE if place == axis else _CROSS for place in range(3)]
    return [*own, 0.0, 0.0, 0.0] if unit == "g" else [*[_G_SENSITIVITY_DPS] * 3, *own]


def _spectrum(pairs: Sequence[_Pair], anew: float) -> Iterator[float]:
    """Logarithms of the spectrum at rest, of each log, less how much noise there is."""
    found: list[tuple[Floats, float]] = []
    for pair in pairs:
        before, after = (_spectra(counts[: pair.rows], pair.quiet) for counts in (pair.counts, pair.new_counts))
        if len(before) and len(before) == len(after):
            change = np.log(after.mean(axis=0)[1:] + 0.01) - np.log(before.mean(axis=0)[1:] + 0.01)
            found.append((change, 1.0 / len(before)))
    if not found:
        return
    bins = len(found[0][0])
    variance = np.repeat([one for _, one in found], bins)
    for axis in range(3):
        change = np.concatenate([one[:, axis] for one, _ in found])
        yield _score(change, variance, np.full((len(change), 1), _FREE), anew)


def _answers(pairs: Sequence[_Pair], anew: float) -> Iterator[float]:
    """How the difference follows what the box was told: force, rate, their changes, squares and products."""
    unit = _SENSED[pairs[0].sensor.quantity]
    parts = [pair for pair in pairs if pair.track is not None and not pair.quiet.all()]
    if not parts:
        return
    designs, differences, weights = list[Floats](), list[Floats](), list[Floats]()
    for pair in parts:
        force, rate, _ = pair.told(pair.time)
        spin = np.radians(rate)
        changes = [np.gradient(one, pair.time * 1e-9, axis=0) for one in (force, spin)]
        products = [spin[:, [a]] * spin[:, [b]] for a in range(3) for b in range(a, 3)]
        designs.append(np.hstack([np.ones((len(force), 1)), force, rate, *changes, force**2, *products]))
        told = np.stack([np.interp(pair.time, pair.new_time, axis) for axis in pair.new_counts.T], axis=1)
        differences.append(told - pair.counts)
        weights.append(np.repeat(pair.noise[None], len(force), axis=0))
    design, difference, variance = (np.vstack(one) for one in (designs, differences, weights))
    spread = design.std(axis=0)
    used = np.flatnonzero(spread > 1e-6)
    if not len(used):
        return
    scaled = design[:, used] / spread[used]
    for axis in range(3):
        reach = np.zeros(design.shape[1])
        reach[:7] = [_FREE, *_responses(unit, axis)]
        basis, values, tolerance = np.linalg.svd(scaled / np.sqrt(variance[:, [axis]]), full_matrices=False)
        kept = values > 1e-6 * values[0]
        coefficient = basis[:, kept].T @ (difference[:, axis] / np.sqrt(variance[:, axis]))
        told = (values[kept, None] * tolerance[kept]) * (spread * reach)[used] * pairs[0].sensor.sensitivity
        yield _score(coefficient, np.ones(int(kept.sum())), told[:, reach[used] > 0], anew)


def _events(pair: _Pair, anew: float) -> Iterator[float]:
    """What is counted: far readings, codes that are left out, repeated rows, rows that are late or lost."""
    before, after = pair.counts, pair.new_counts
    limit = _FAR * np.maximum(np.median(np.abs(np.diff(before, 2, axis=0)), axis=0) / 0.6745, 0.5)
    far = [int((np.abs(np.diff(one, 2, axis=0)) > limit).any(axis=1).sum()) for one in (before, after)]
    yield _counted(far[0], far[1], anew)
    repeated = [int((np.diff(one, axis=0) == 0).all(axis=1).sum()) for one in (before, after)]
    yield _counted(repeated[0], repeated[1], anew)
    period = np.median(np.diff(pair.time))
    for beyond in (0.02, 0.5):
        late = [int((np.abs(np.diff(one) - period) > beyond * period).sum()) for one in (pair.time, pair.new_time)]
        yield _counted(late[0], late[1], 0.0)
    yield _counted(0, abs(len(before) - len(after)), 0.0)
    for step in (2, 4, 8):
        shares = [[(one % step == rest).mean(axis=0) for rest in range(step)] for one in (before, after)]
        change = np.abs(np.array(shares[1]) - np.array(shares[0]))
        if min(_spread(before)) > 0.3 * step:
            yield float(change.max() * sqrt(len(before) * step / 2))  # any effect moves each row to another code


def _counted(before: int, after: int, anew: float) -> float:
    """By the square root, which scatters by a half."""
    return 2 * abs(sqrt(after + 0.375) - sqrt(before + 0.375)) / sqrt(max(1.0, 2 * anew))


def _spread(counts: Floats) -> Floats:
    return np.asarray(np.median(np.abs(np.diff(counts, axis=0)), axis=0)) if len(counts) > 1 else np.zeros(3)
