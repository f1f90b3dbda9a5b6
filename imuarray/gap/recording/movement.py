"""The motion of the box in a log without a track, estimated from the sensors of the array.

All sensors of a quantity measure a turn or a stroke alike, so each can be compared with the others although no
instrument recorded the motion. A simulation needs the motion itself, which is estimated as the mean of the sensors in
windows of time: an error that all of them share becomes a part of the motion and is not detected. All simulated sensors
would also measure the noise of this mean, whereas recorded sensors have nothing in common on an axis that hardly moves.
It is therefore subtracted in the spectrum; its size is estimated from the differences between the sensors and, since
the filters of the chips make it unequal over frequency, from the spectrum of the same mean at rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.axes import up_vector
from imuarray.characterise.spectrum import Welch
from imuarray.gap.recording.source import RecordedSource
from imuarray.gap.recording.turns import Turn, factors_of, likely_exchange
from imuarray.log import Log, SensorLog
from imuarray.log.format import Phase
from imuarray.robust import MEDIAN_ABSOLUTE
from imuarray.simulate.effects.response import rotational_force
from imuarray.simulate.motion.like import SplineColumns
from imuarray.simulate.motion.posed import Movement, neighbours
from imuarray.simulate.motion.track_noise import reduce_noise
from imuarray.units import INERTIAL, SI_PER_UNIT, STANDARD_GRAVITY

_WINDOW_ROWS, _SHORTEST_S = 2.0, 0.02
"""Number of rows of the slowest sensor in a window of time, and the shortest window in s: a hand turns a box in
seconds.
"""

_COURSE_ROWS, _FINEST_S = 1.0, 0.005
"""The same for the windows in which the motion itself is estimated. A hand starts, stops and corrects a turn within a
few rows. In a simulation without these changes, sensors that are read at other moments, or are at other places in the
box, differ less than recorded ones.
"""

_FEWEST_WINDOWS, MOST_WINDOWS = 16, 200_000
"""Fewest and most windows of a motion. The most are an hour of 20 ms windows, which takes 80 MB for 16 sensors."""

_LEAST_FORCE, _LEAST_RATE, _NOISE_MARGIN = 0.02, 0.003, 2.0
"""Least changes of force (m/s2, rms) and of rate (rad/s, rms) that are motion, and the multiple of the noise variance
that is subtracted before they are compared.
"""

_FAST_SHARE, _OVER_NOISE, _LEAST_NOISE, _SOME_ROWS = 0.5, 4.0, 0.3, 50_000
"""A motion is a vibration if its change from row to row is at least the first value as a share of the motion and the
second as a multiple of the noise. The third is the least noise, in counts, that of rounding. The fourth is the largest
number of rows that are used.
"""

_ACCELERATION_S = 0.02
"""Time over which an angular acceleration is estimated, before and after each moment, in s: the noise of a difference
from one row to the next would exceed the force that it determines.
"""

_UNRESOLVED, _AS_QUIET = 2.0, 1.5
"""Ratio of the third differences of readings in a motion to those at rest above which the motion has changes that the
rows do not resolve: third differences of a smooth turn by hand are below the noise. The sensors that decide it have at
most the second value times the least noise.
"""

_LOUDER = 3.0
"""Ratio of the noise of every sensor in a rest to that in its quietest one above which a machine shakes the box: chips
hardly change their noise, and not all of them at once.
"""

_TURN_STEP_NS = 50_000_000
"""Interval of a turn over which a gyroscope's rates are averaged, in ns; a fast turn covers 5 degrees in it."""

_SHARED_OVER_OWN, _WINDOWS_AT_REST = 2.0, 4096
"""Ratio of the variance that sensors of a quantity share from one window to the next to that of their own noise, above
which the box is not at rest; and the largest number of windows of a phase that are used to decide this.
"""

_SEGMENT_ROWS, _FEWEST_SEGMENTS, _INDEPENDENT, _FIRST_BIN = 64, 16, 0.6, 2
"""Rows of a segment and fewest segments from which a spectrum is estimated; number of independent segments of one that
overlaps by half with the next; and the first bin that is used.
"""

_LOUD, _LOUD_SHARE, _RAISED, _RAISED_SIGMAS = 4.0, 0.01, 1.5, 6.0
"""Ratio to the median of a spectrum, and share of the highest one, above which a box is shaken at a frequency; the mean
ratio of another sensor at these frequencies above which it is shaken too, and the number of standard deviations that it
has to exceed that by.
"""

_NOISE_WINDOWS, _FEWEST_OF_NOISE, _MOST_OF_NOISE = 256, 4, 64
"""Windows of a segment from which the spectrum of the noise at rest is estimated, and fewest and most such segments."""

_ROUNDING = 1e-9
"""Relative error of a sum of weights."""

_OUTLIER, _LEAST_WEIGHT = 2.0, 1e-300
"""Deviation of a reading from the median of the sensors, in standard deviations of its noise, to which it is limited in
their mean: a faulty sensor shifts the mean by at most its weight times this deviation. The least sum of weights avoids
a division by zero where no sensor has a reading.
"""

_CLIPPED = 0.97
"""Share of the range above which a rate is assumed to be clipped: zero and scale vary from part to part."""

_TURN_TOLERANCE, _MOST_FACTOR = 0.03, 2.4
"""Relative error of the turns that healthy gyroscopes may have against the attitudes, and the largest factor of rates
that is accepted: beyond it the axes are other ones.
"""

_WRONG_FORCE = 3.0
"""Difference of an accelerometer at rest from gravity on the noted face, in m/s2, that no tolerance explains. Its axes
or its range are not those of its header, and it is not used to estimate a motion.
"""


def movements_of(
    log: Log, sensors: Sequence[str], phases: Sequence[Phase], rests: Sequence[Phase]
) -> dict[Phase, Movement]:
    """Return the motions in phases, estimated from the readings of these sensors. `rests` are phases at rest, from
    which the biases of gyroscopes are estimated; without rests the result is empty.

    Accelerometers that are wrong at rest are not used. If the turns of a gyroscope do not lead to the attitude of the
    next rest, and exchanged axes explain this, its axes are exchanged back.

    A phase is left out if the box does not move, if it vibrates faster than the rows show, if no two sensors measure
    the same quantity, if it has more than `MOST_WINDOWS`, or if it has no gyroscope: accelerometers at different places
    then measure an unknown rotation.
    """
    if not phases or not rests:
        return {}
    triads = [sensor for name in sensors if (sensor := log[name]).quantity in INERTIAL and sensor.sensitivity]
    wrong = _wrong_at_rest([sensor for sensor in triads if sensor.quantity == "specific_force"], rests)
    triads = [sensor for sensor in triads if sensor.name not in wrong]
    biases = {sensor.name: _mean_at_rest(sensor, rests) for sensor in triads if sensor.quantity == "angular_rate"}
    ends = _ends_of_turns(triads, phases, rests)
    exchanged = _exchanged_axes(triads, ends, biases)
    noise = noise_at_rest(triads, rests)
    courses = {
        phase: course
        for phase in phases
        if not vibrates(triads, phase, noise)
        and (course := _course(triads, phase, rests, biases, exchanged)) is not None
    }
    turns = (course.turn(phase, *ends[phase]) for phase, course in courses.items() if phase in ends)
    factors = _factors([turn for turn in turns if turn is not None])
    return {
        phase: Movement(
            phase.start_ns,
            phase.end_ns,
            SplineColumns(course.middles_ns, (course.force, factors * course.rate), f"{log.path}, motion"),
        )
        for phase, course in courses.items()
    }


def noise_at_rest(triads: Sequence[SensorLog], rests: Sequence[Phase]) -> dict[str, Floats]:
    """Return the noise (3,) in counts of each accelerometer in the quietest phase at rest in which it has rows."""
    noise = {}
    for sensor in triads:
        counts = [_some_counts(sensor, rest) for rest in rests if sensor.quantity == "specific_force"]
        scatters = [_scatter(rows) for rows in counts if len(rows) > _FEWEST_WINDOWS]
        if scatters:
            noise[sensor.name] = np.maximum(np.min(scatters, axis=0), _LEAST_NOISE)
    return noise


def vibrates(triads: Sequence[SensorLog], phase: Phase, noise: Mapping[str, Floats]) -> bool:
    """Return whether an accelerometer measures mostly changes from row to row that are larger than its `noise`
    (`noise_at_rest`). This is a vibration, which sensors that are read at other moments measure differently.
    """
    for sensor in triads:
        moving = _some_counts(sensor, phase) if sensor.name in noise else np.zeros((0, 3))
        if len(moving) > _FEWEST_WINDOWS:
            least = np.maximum(_FAST_SHARE * moving.std(axis=0), _OVER_NOISE * noise[sensor.name])
            if (_scatter(moving) > least).any():
                return True
    return False


def unresolved_quantities(triads: Sequence[SensorLog], phase: Phase, rests: Sequence[Phase]) -> tuple[str, ...]:
    """Return the quantities of which the sensors measure changes in a motion that the rows of the slowest sensor do not
    resolve. How a sensor responds to such a motion depends on the moments of its rows, and cannot be predicted from
    other sensors.

    The sensors with the least noise at rest decide; of several, the lower median, since a fault of one is no motion.
    """
    rows = {sensor.name: RecordedSource(sensor).rows(phase.start_ns, phase.end_ns) for sensor in triads}
    slowest = min(filter(None, rows.values()), default=0)
    unresolved = []
    for quantity in INERTIAL:
        group = [sensor for sensor in triads if sensor.quantity == quantity and rows[sensor.name]]
        ratios_of = (_roughness_ratio(sensor, phase, rests, round(rows[sensor.name] / slowest)) for sensor in group)
        known = [pair for pair in ratios_of if pair is not None]
        least = min((noise for noise, _ in known), default=0.0)
        ratios = sorted(ratio for noise, ratio in known if noise <= _AS_QUIET * least)
        if ratios and ratios[(len(ratios) - 1) // 2] > _UNRESOLVED:
            unresolved.append(quantity)
    return tuple(unresolved)


def _roughness_ratio(sensor: SensorLog, phase: Phase, rests: Sequence[Phase], rows: int) -> tuple[float, float] | None:
    """Return the third differences (rms, in units of the sensor) of means over so many rows in the quietest phase at
    rest, and those in a phase as a multiple of them, on the axis where this is largest; None without enough rows.
    """
    at_rest = [_block_means(_some_counts(sensor, rest), rows) for rest in rests]
    quietest = [_roughness(means) for means in at_rest if len(means) > _FEWEST_WINDOWS]
    moving = _block_means(_some_counts(sensor, phase), rows)
    if not quietest or len(moving) <= _FEWEST_WINDOWS:
        return None
    least = math.sqrt(20) * _LEAST_NOISE  # white noise of variance 1 has third differences of variance 20
    quiet = np.maximum(np.min(quietest, axis=0), least)
    return float(np.mean(quiet)) / sensor.sensitivity, float((_roughness(moving) / quiet).max())


def _block_means(counts: Floats, rows: int) -> Floats:
    """Return the means (n // rows, 3) of counts (n, 3) over so many rows."""
    whole = len(counts) // rows
    return np.asarray(counts[: whole * rows].reshape(whole, rows, 3).mean(axis=1))


def _roughness(counts: Floats) -> Floats:
    """Return the third differences (3,) of counts (n, 3), rms."""
    return np.asarray(np.sqrt((np.diff(counts, n=3, axis=0) ** 2).mean(axis=0)))


def loud_rests(triads: Sequence[SensorLog], rests: Sequence[Phase]) -> set[Phase]:
    """Return the rests of a log in which all inertial sensors that were read, two or more, are much noisier than in
    their quietest rest: a motor runs, which each of them may measure at frequencies of its own.
    """
    inertial = [sensor for sensor in triads if sensor.quantity in INERTIAL]
    if len(inertial) < 2 or len(rests) < 2:
        return set()
    noise = np.full((len(inertial), len(rests), 3), np.nan)
    for number, sensor in enumerate(inertial):
        for place, rest in enumerate(rests):
            if len(counts := _some_counts(sensor, rest)) > _FEWEST_WINDOWS:
                noise[number, place] = np.maximum(_scatter(counts), _LEAST_NOISE)
    with np.errstate(invalid="ignore"):
        ratio = (noise / np.fmin.reduce(noise, axis=1)[:, None]).max(axis=2)
    was_read = np.isfinite(ratio)
    is_loud = (was_read.sum(axis=0) > 1) & ((ratio > _LOUDER) | ~was_read).all(axis=0)
    return {rest for rest, loud in zip(rests, is_loud.tolist(), strict=True) if loud}


def shaken_quantities(triads: Sequence[SensorLog], rest: Phase) -> list[str]:
    """Return the quantities in which all sensors, two or more, measure the same changes along an axis of the box in a
    phase at rest, well above their noise: a hand holds the box, or an engine runs. A quantity with a single sensor is
    shaken too if its spectrum is raised at the same frequencies.
    """
    groups = {quantity: [sensor for sensor in triads if sensor.quantity == quantity] for quantity in INERTIAL}
    shaken = {quantity: group for quantity, group in groups.items() if len(group) > 1 and _is_shared(group, rest)}
    singles = {quantity: group[0] for quantity, group in groups.items() if len(group) == 1}
    return [
        *shaken,
        *(
            quantity
            for quantity, single in singles.items()
            if any(_is_shaken_with(single, group, rest) for group in shaken.values())
        ),
    ]


def _is_shaken_with(single: SensorLog, sensors: Sequence[SensorLog], rest: Phase) -> bool:
    """Return whether the spectrum of a sensor at rest is raised at those frequencies at which a box is shaken according
    to other sensors.
    """
    spectra = [spectrum for sensor in sensors if (spectrum := _spectrum(sensor, rest)) is not None]
    own = _spectrum(single, rest)
    if own is None or not spectra:
        return False
    heights = [np.interp(own.hertz, other.hertz, other.height.max(axis=1), left=0.0, right=0.0) for other in spectra]
    height = np.median(heights, axis=0)
    is_loud = height > max(_LOUD, _LOUD_SHARE * height.max())
    if not is_loud.any():
        return False
    chance = 1 / np.sqrt(own.segments * np.count_nonzero(is_loud))
    return bool(own.height[is_loud].mean(axis=0).max() > _RAISED + _RAISED_SIGMAS * chance)


class _Spectrum(NamedTuple):
    """Power of a sensor's readings at rest at frequencies `hertz` (f,), relative to the median over the frequencies:
    `height` (f, 3), from a number of independent `segments`.
    """

    hertz: Floats
    height: Floats
    segments: float


def _spectrum(sensor: SensorLog, rest: Phase) -> _Spectrum | None:
    """Return the spectrum of a sensor, from overlapping segments (Welch); None with too few rows."""
    rows = sensor.between(rest.start_ns, rest.end_ns)
    counts = np.asarray(sensor.counts[rows][:_SOME_ROWS], float)
    segments = 2 * len(counts) // _SEGMENT_ROWS - 1
    if segments < _FEWEST_SEGMENTS:
        return None
    interval_s = float(np.median(np.diff(np.asarray(sensor.time[rows][: len(counts)], float)))) * 1e-9
    welch = Welch(1 / interval_s, _SEGMENT_ROWS, counts.shape[1], "double")
    welch.update(counts)
    spectrum = welch.result()
    inner = slice(_FIRST_BIN, -1)  # the last bin, at half the rate, has half of the density
    density = spectrum.density[inner]
    height = density / np.maximum(np.median(density, axis=0), 1e-30)
    return _Spectrum(spectrum.frequency_hz[inner], height, segments * _INDEPENDENT)


def _is_shared(sensors: Sequence[SensorLog], rest: Phase) -> bool:
    """Return whether changes from window to window are common to these sensors."""
    rows = [RecordedSource(sensor).rows(rest.start_ns, rest.end_ns) for sensor in sensors]
    if not all(rows):
        return False
    window_s = max(_WINDOW_ROWS * (rest.end_ns - rest.start_ns) * 1e-9 / min(rows), _SHORTEST_S)
    edges_ns = _edges_ns(rest, window_s)[1:-1][:_WINDOWS_AT_REST]
    if len(edges_ns) <= _FEWEST_WINDOWS:
        return False
    steps = np.diff([_window_means(sensor, edges_ns) for sensor in sensors], axis=1)
    steps = steps[:, np.isfinite(steps).all(axis=(0, 2))]
    if steps.shape[1] < _FEWEST_WINDOWS:
        return False
    mean = steps.mean(axis=0)
    # Medians are used because a short touch does not change them.
    own = (_usual(steps - mean) ** 2).max(axis=0) * len(sensors) / (len(sensors) - 1)
    shared = _usual(mean[None])[0] ** 2 - own / len(sensors)
    return bool((shared > _SHARED_OVER_OWN * own).any())


def _usual(values: Floats) -> Floats:
    """Return the standard deviations (s, 3) of normal values (s, n, 3) of s sensors, from their median absolute
    deviations.
    """
    apart = np.abs(values - np.median(values, axis=1, keepdims=True))
    return np.asarray(np.median(apart, axis=1) / MEDIAN_ABSOLUTE)


def _some_counts(sensor: SensorLog, phase: Phase) -> Floats:
    """Return the counts (n, 3) of the first rows of a phase, `_SOME_ROWS` at most."""
    return np.asarray(sensor.counts[sensor.between(phase.start_ns, phase.end_ns)][:_SOME_ROWS], float)


def _scatter(counts: Floats) -> Floats:
    """Return the standard deviation (3,) of the changes from row to row, as noise of a single row."""
    return np.asarray(np.sqrt((np.diff(counts, axis=0) ** 2).mean(axis=0) / 2))


class _Course(NamedTuple):
    """Motion common to the sensors, in windows of time: force (w, 3) in m/s2 and rate (w, 3) in rad/s in the box's
    frame.
    """

    middles_ns: Integers
    force: Floats
    rate: Floats

    def turn(self, phase: Phase, up_before: Floats, up_after: Floats) -> Turn | None:
        """Return the turn of the box in the phase; None if the windows do not determine it."""
        inside = (phase.start_ns <= self.middles_ns) & (self.middles_ns < phase.end_ns)
        return Turn.of(up_before, up_after, self.rate[inside], (phase.end_ns - phase.start_ns) * 1e-9)


def _factors(turns: Sequence[Turn]) -> Floats:
    """Return the factors (3,) that correct the rates about the box's axes. Where the turns differ from the attitudes by
    more than the tolerances of gyroscopes and attitudes, all gyroscopes are assumed to have the same scale error.
    """
    factors = factors_of(turns)
    is_likely = (factors > 1 / _MOST_FACTOR) & (factors < _MOST_FACTOR)
    return np.where(is_likely, factors - np.clip(factors - 1, -_TURN_TOLERANCE, _TURN_TOLERANCE), 1.0)


def _course(
    triads: Sequence[SensorLog],
    phase: Phase,
    rests: Sequence[Phase],
    biases: Mapping[str, Floats],
    exchanged: Mapping[str, Floats],
) -> _Course | None:
    """Return the common motion in a phase; None if too few sensors or windows determine it, or the box does not move.
    `biases` (3,) and matrices `exchanged` (3, 3) of gyroscopes are in the box's frame.
    """
    rows = {sensor.name: RecordedSource(sensor).rows(phase.start_ns, phase.end_ns) for sensor in triads}
    there = [sensor for sensor in triads if rows[sensor.name]]
    gyroscopes = [sensor for sensor in there if sensor.quantity == "angular_rate"]
    accelerometers = [sensor for sensor in there if sensor.quantity == "specific_force"]
    if not gyroscopes or max(len(gyroscopes), len(accelerometers)) < 2:
        return None
    seconds = (phase.end_ns - phase.start_ns) * 1e-9
    slowest_hz = min(rows[sensor.name] for sensor in there) / seconds
    if not _FEWEST_WINDOWS < len(_edges_ns(phase, max(_WINDOW_ROWS / slowest_hz, _SHORTEST_S))) <= MOST_WINDOWS:
        return None
    window_s = max(_COURSE_ROWS / slowest_hz, _FINEST_S, seconds / MOST_WINDOWS)
    edges_ns = _edges_ns(phase, window_s)
    middles_ns = (edges_ns[:-1] + edges_ns[1:]) // 2
    rate = _mean_of(
        [
            (_window_means(sensor, edges_ns) - biases[sensor.name]) @ exchanged.get(sensor.name, np.eye(3)).T
            for sensor in gyroscopes
        ],
        _mean_noise(gyroscopes, rests, window_s),
    )
    if accelerometers:
        places = np.array([sensor.position_mm for sensor in accelerometers]) * 1e-3
        rotation_forces = force_of_rotation(rate, window_s, places - places.mean(axis=0))
        force = _mean_of(
            [
                _window_means(sensor, edges_ns) - rotation_force
                for sensor, rotation_force in zip(accelerometers, rotation_forces, strict=True)
            ],
            _mean_noise(accelerometers, rests, window_s),
        )
    else:
        force = np.tile([0.0, 0.0, STANDARD_GRAVITY], (len(middles_ns), 1))
    known = np.isfinite(force).all(axis=1) & np.isfinite(rate).all(axis=1)
    if np.count_nonzero(known) < _FEWEST_WINDOWS or not shows_motion(force[known], rate[known]):
        return None
    return _Course(middles_ns[known], force[known], rate[known])


def force_of_rotation(rate: Floats, window_s: float, places_m: Floats) -> Floats:
    """Return the specific forces (s, w, 3), in m/s2, that a rotation adds at the places (s, 3). The rates (w, 3) of
    successive windows, in rad/s, are interpolated where they are unknown. All vectors are in the box's frame.
    """
    known = np.flatnonzero(np.isfinite(rate[:, 0]))
    if not places_m.any() or not len(known):
        return np.zeros((len(places_m), *rate.shape))
    windows = np.arange(len(rate))
    step = max(round(_ACCELERATION_S / window_s), 1)
    before, now, after = (
        np.stack([np.interp(windows + shift, known, column[known]) for column in rate.T], axis=1)
        for shift in (-step, 0, step)
    )
    acceleration = (after - before) / (2 * step * window_s)
    return np.array([rotational_force(now, acceleration, place_m) for place_m in places_m])


def shows_motion(force: Floats, rate: Floats) -> bool:
    """Return whether force (n, 3) in m/s2 or rate (n, 3) in rad/s change by more than their own noise."""
    for values, least in ((force, _LEAST_FORCE), (rate, _LEAST_RATE)):
        # The noise is assumed to be white: rows are independent.
        noise = np.diff(values, n=2, axis=0).var(axis=0) / 6
        smooth = np.maximum(values.var(axis=0) - _NOISE_MARGIN * noise, 0.0)
        if np.sqrt(smooth.max()) > least:
            return True
    return False


def _edges_ns(phase: Phase, window_s: float) -> Integers:
    """Return the edges of the windows of time in a phase, with one more window on either side."""
    window_ns = round(window_s * 1e9)
    return np.arange(phase.start_ns - window_ns, phase.end_ns + 2 * window_ns, window_ns, dtype=np.int64)


def _window_means(sensor: SensorLog, edges_ns: Integers) -> Floats:
    """Return the mean readings (w, 3) in the windows, interpolated to their middles, in SI units along the box's axes;
    nan in windows without rows.
    """
    count = len(edges_ns) - 1
    sums, rows = np.zeros((count, 4)), np.zeros(count)
    for block in RecordedSource(sensor).blocks(int(edges_ns[0]), int(edges_ns[-1])):
        windows = np.searchsorted(edges_ns, block.time, side="right") - 1
        since_ns = (block.time - edges_ns[windows]).astype(float)
        np.add.at(sums, windows, np.column_stack([block.counts, since_ns]))
        np.add.at(rows, windows, 1)
    known = rows > 0
    means = np.full((count, 3), np.nan)
    if not known.any():
        return means
    readings = sums[known] / rows[known, None]
    middles_ns = ((edges_ns[:-1] + edges_ns[1:]) / 2)[known]
    times_ns = edges_ns[:-1][known] + readings[:, 3]
    for axis in range(3):
        means[known, axis] = np.interp(middles_ns, times_ns, readings[:, axis])
    return np.asarray(means @ np.asarray(sensor.orientation).T / sensor.sensitivity * SI_PER_UNIT[sensor.unit])


def _ends_of_turns(
    triads: Sequence[SensorLog], phases: Sequence[Phase], rests: Sequence[Phase]
) -> dict[Phase, tuple[Floats, Floats]]:
    """Return the directions up (3,), in the box's frame, before and after each phase that lies between two rests in
    which they are known. Phases in which a gyroscope clips are left out.
    """
    accelerometers = [sensor for sensor in triads if sensor.quantity == "specific_force"]
    gyroscopes = [sensor for sensor in triads if sensor.quantity == "angular_rate"]
    ends = {}
    for phase in phases:
        adjacent = None if any(_clips(sensor, phase) for sensor in gyroscopes) else neighbours(phase, rests)
        ups = [] if adjacent is None else [_up_at_rest(accelerometers, rest) for rest in adjacent]
        known = [up for up in ups if up is not None]
        if len(known) == 2:
            ends[phase] = (known[0], known[1])
    return ends


def _clips(sensor: SensorLog, phase: Phase) -> bool:
    """Return whether readings of a phase reach an end of the range."""
    counts = _some_counts(sensor, phase)
    return bool(len(counts) and sensor.range and np.abs(counts).max() > _CLIPPED * sensor.range * sensor.sensitivity)


def _exchanged_axes(
    triads: Sequence[SensorLog], ends: Mapping[Phase, tuple[Floats, Floats]], biases: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Return matrices (3, 3) by gyroscope, in the box's frame, that convert readings with exchanged axes to rates,
    estimated from the turns between the attitudes `ends`. The result is empty if all gyroscopes, of two or more, seem
    to have exchanged axes: the attitudes are then wrong.
    """
    gyroscopes = [sensor for sensor in triads if sensor.quantity == "angular_rate"]
    exchanged = {}
    for sensor in gyroscopes:
        turns = []
        for phase, ups in ends.items():
            count = -(-(phase.end_ns - phase.start_ns) // _TURN_STEP_NS)
            edges_ns = np.linspace(phase.start_ns, phase.end_ns, count + 1).astype(np.int64)
            rate = _window_means(sensor, edges_ns) - biases[sensor.name]
            turn = Turn.of(*ups, rate, (phase.end_ns - phase.start_ns) * 1e-9)
            turns += [turn] if turn is not None else []
        if (exchange := likely_exchange(turns)) is not None:
            exchanged[sensor.name] = exchange
    return exchanged if len(exchanged) < max(len(gyroscopes), 2) else {}


def _up_at_rest(accelerometers: Sequence[SensorLog], rest: Phase) -> Floats | None:
    """Return the direction up (3,) in the box from the mean of the accelerometers, or else as noted; None if it is not
    known.
    """
    readings = [_mean_in(sensor, rest) for sensor in accelerometers]
    known = [reading for reading in readings if np.isfinite(reading).all()]
    force = np.mean(known, axis=0) if known else np.zeros(3)
    size = float(np.linalg.norm(force))
    if abs(size - STANDARD_GRAVITY) < _WRONG_FORCE:
        return np.asarray(force / size)
    return np.array(up_vector(rest.up)) if rest.up else None


def _wrong_at_rest(accelerometers: Sequence[SensorLog], rests: Sequence[Phase]) -> set[str]:
    """Return the names of the accelerometers that contradict the noted face in a phase at rest in which another one
    agrees with it. If all contradict it, the note is wrong.
    """
    wrong: set[str] = set()
    for rest in rests if len(accelerometers) > 1 else ():
        if not rest.up:
            continue
        gravity = STANDARD_GRAVITY * np.array(up_vector(rest.up))
        off = {sensor.name: np.abs(_mean_in(sensor, rest) - gravity).max() for sensor in accelerometers}
        contradicting = {name for name, difference in off.items() if difference > _WRONG_FORCE}
        if any(difference <= _WRONG_FORCE for difference in off.values()):
            wrong |= contradicting
    return wrong


def _mean_in(sensor: SensorLog, phase: Phase) -> Floats:
    """Return the mean reading (3,) in a phase, in SI units along the box's axes; nan without rows."""
    return np.asarray(_window_means(sensor, np.array([phase.start_ns, phase.end_ns], np.int64))[0])


def _mean_at_rest(sensor: SensorLog, rests: Sequence[Phase]) -> Floats:
    """Return the mean reading (3,) over the phases at rest in which the sensor was read; 0 if there are none."""
    parts = [_mean_in(sensor, rest) for rest in rests]
    known = [part for part in parts if np.isfinite(part).all()]
    return np.mean(known, axis=0) if known else np.zeros(3)


def _mean_of(sensors: Sequence[Floats], noise: Floats) -> Floats:
    """Return the mean (w, 3) of the readings (w, 3) of the sensors, with its noise reduced; nan where no sensor has
    readings. `noise` (f, 3) is that of `_mean_noise`.
    """
    readings = np.array(sensors)
    known = np.flatnonzero(np.isfinite(readings[:, :, 0]).any(axis=0))
    means = np.full(readings.shape[1:], np.nan)
    if len(known) < _FEWEST_WINDOWS:
        return means
    mean, apart = _middle_of(readings[:, known])
    # White noise of variance 1 has second differences of variance 6. The difference of a sensor from the mean of s
    # sensors has (s - 1) / s of the sensor's variance, and the mean has 1 / s of it.
    scatter = np.nanmedian(_noise_of(mean[None] if len(readings) == 1 else apart), axis=0)
    white = scatter / max(len(readings) - 1, 1)
    places = np.linspace(0, 1, len(known) // 2 + 1)
    at_rest = np.array([np.interp(places, np.linspace(0, 1, len(noise)), column) for column in noise.T]).T
    means[known] = reduce_noise(mean, np.maximum(white, at_rest), keeps_power=True)
    return means


def _middle_of(readings: Floats) -> tuple[Floats, Floats]:
    """Return the mean (w, 3) of the readings (s, w, 3) of s sensors and the deviation (s, w, 3) of each from it.

    For three or more sensors it is the one-step M-estimate of Huber (Ann. Math. Stat. 35, 1964): their median, weighted
    by the inverse variances of their noise, of which no sensor has more than half, plus the mean of the deviations from
    it, each limited to `_OUTLIER` standard deviations of the noise. The noise of a median alone may be twice that of a
    mean. Each sensor's mean deviation is subtracted first, so that a sensor without readings in a window causes no
    step.
    """
    middle: Callable[..., Floats] = np.nanmean
    if len(readings) > 2:
        middle = partial(robust_mean, weights=_weights(readings))
    apart = readings - middle(readings, axis=0)
    return middle(readings - np.nanmean(apart, axis=1, keepdims=True), axis=0), apart


def robust_mean(readings: Floats, axis: int = 0, *, weights: Floats) -> Floats:
    """Return the robust mean (w, 3) of readings (s, w, 3) with weights (s,), as `_middle_of` describes it."""
    median = weighted_median(readings, axis, weights=weights)
    apart = readings - median
    limit = _OUTLIER * np.sqrt(_noise_of(apart))[:, None]
    shares = np.where(np.isfinite(apart), weights[:, None, None], 0.0)
    total = np.maximum(shares.sum(axis=0), _LEAST_WEIGHT)
    return np.asarray(median + (shares * np.nan_to_num(np.clip(apart, -limit, limit))).sum(axis=0) / total)


def _noise_of(values: Floats) -> Floats:
    """Return the variance (s, 3) of white noise from the second differences of values (s, w, 3)."""
    return np.asarray(np.nanmedian(np.diff(values, n=2, axis=1) ** 2, axis=1) / MEDIAN_ABSOLUTE**2 / 6)


def _mean_noise(sensors: Sequence[SensorLog], rests: Sequence[Phase], window_s: float) -> Floats:
    """Return the noise (f, 3) of the mean of the sensors in windows at rest, at frequencies from 0 to half the rate of
    the windows: the variance that white noise of this density would have. 0 with too few windows.

    It is the median over segments of the rests (Welch), since a knock must not count as noise.
    """
    segments: list[Floats] = []
    for rest in rests:
        edges_ns = _edges_ns(rest, window_s)[1:-1][: _MOST_OF_NOISE * _NOISE_WINDOWS]
        if sensors and len(edges_ns) > _NOISE_WINDOWS and len(segments) < _MOST_OF_NOISE:
            readings = np.array([_window_means(sensor, edges_ns) for sensor in sensors])
            readings = readings[:, np.isfinite(readings).all(axis=(0, 2))]
            whole = readings.shape[1] // _NOISE_WINDOWS
            if whole:
                mean, _ = _middle_of(readings[:, : whole * _NOISE_WINDOWS])
                segments += list(mean.reshape(whole, _NOISE_WINDOWS, 3))
    if len(segments) < _FEWEST_OF_NOISE:
        return np.zeros((2, 3))
    parts = np.array(segments)
    parts -= parts.mean(axis=1, keepdims=True)
    taper = np.hanning(_NOISE_WINDOWS)[:, None]
    power = np.abs(np.fft.rfft(parts * taper, axis=1)) ** 2 / (taper**2).sum()
    noise = np.median(power, axis=0) / np.log(2)
    noise[[0, -1]] = noise[[1, -2]]  # without the mean; a real number has half of the degrees of freedom
    return np.asarray(noise)


def _weights(readings: Floats) -> Floats:
    """Return the weights (s,) of sensors with readings (s, w, 3): the inverse squares of their second differences, but
    no more than the sum of the others. The motion in the differences makes the weights more alike.
    """
    changes = np.diff(readings, n=2, axis=1) ** 2
    noise = np.array([np.nanmedian(change) if np.isfinite(change).any() else np.inf for change in changes])
    weights = 1 / np.maximum(noise, 1e-30)
    return np.asarray(np.minimum(weights, weights.sum() - weights))


def weighted_median(values: Floats, axis: int = 0, *, weights: Floats) -> Floats:
    """Return the medians (w, 3) of values (s, w, 3) over their first axis with weights (s,): the mean of the values at
    which the cumulative weight reaches and exceeds half of the total. nan without values.
    """
    order = np.argsort(values, axis=axis)  # nan is last
    ordered = np.take_along_axis(values, order, axis=axis)
    shares = np.where(np.isfinite(ordered), weights[order], 0.0)
    upto = np.cumsum(shares, axis=axis)
    half = upto[-1:] / 2
    at = [np.argmax(upto >= limit * half, axis=axis)[None] for limit in (1 - _ROUNDING, 1 + _ROUNDING)]
    low, high = (np.take_along_axis(ordered, place, axis=axis)[0] for place in at)
    return np.asarray((low + high) / 2)
