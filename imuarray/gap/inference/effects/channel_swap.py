"""`channel_swap`: readings that belong to another sensor, by noise, axes or levels; or two sensors exchanged."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Integers, triple
from imuarray.gap.inference.effects.bias import RUN_TO_RUN
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.motion import takes_part
from imuarray.gap.inference.effects.response import response_to_all_motions
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence, Span, When
from imuarray.gap.model.rest import FittedParameters
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.readings import ChannelSwap

_NOISE = ("fast_own_axes", "fast_box_axes", "fast_other_chips", "slow_own_axes", "slow_box_axes")
_AXES = (("force_own", "motion_gain"), ("force_next", "motion_next"), ("force_after", "motion_after"))
_BEYOND = 3.0
_SAME = 0.9
"""Correlation of window means at rest above which two sensors have the same noise."""

_NEAR = 0.25
"""A response is that of another sensor's axes if each entry deviates by less than this. A level is another sensor's if
it deviates by less than this share of the difference between both levels.
"""

_TURNED_G = 0.5
"""Deviation of an accelerometer's level, in g, from which on axes are exchanged, if too few attitudes determine the
response.
"""

_APART = 8.0
"""Least difference of the levels of two sensors that shows which one is read, in standard deviations of a segment's
mean.
"""

_FAR = 0.5
"""Least difference of the levels of two sensors that shows in one segment which one is read, as a share of the largest
difference.
"""

_LEAST_SEGMENTS, _CLEAR = 3, 15.0
"""Fewest segments at rest before and after an exchange, and nats by which it must make the deviations more constant."""

_LEAST_ROWS = 4
_LEVELS = ("mean_halves", "mean_return", "wander", "mean", "level", *RUN_TO_RUN)
"""Statistics that change if a sensor has another sensor's level for a part of the time."""


def guess_channel_swap(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest each sensor that has the same noise, each sensor whose axes agree with the response of this one, and each
    sensor of the chip whose levels this one has for a part of the time.
    """
    twins = _twins(evidence) if evidence.is_odd(*_NOISE, beyond=_BEYOND) else set()
    odd = evidence.is_odd("motion_along", *(probe for pair in _AXES for probe in pair), beyond=_BEYOND)
    for other in evidence.others:
        is_rescaled = odd and _lies_along(evidence, other, other.sensitivity / evidence.header.sensitivity)
        if other.name in twins or is_rescaled:
            yield Hypothesis((ChannelSwap(other.name),), shared=True, sensor=evidence.header.name, others=(other.name,))
        if other.name in twins or other.chip != evidence.header.chip:
            continue
        if (odd and _lies_along(evidence, other)) or (_is_turned(evidence) and not _is_parallel(evidence, other)):
            yield _crossed(evidence.header.name, other.name)
    if evidence.is_odd(*_LEVELS, beyond=_BEYOND):
        for name, phases in evidence.twins.items():
            lasting = list(_exchanges(evidence, name, phases))
            yield from lasting or _for_a_while(evidence, name, phases)


def _crossed(sensor: str, other: str) -> Hypothesis:
    """Return the hypothesis of crossed plugs: each of the two sensors is set up and read in the other's place."""
    swap, opposite_swap = ChannelSwap(other, "place"), ChannelSwap(sensor, "place")
    return Hypothesis((swap,), shared=True, sensor=sensor, others=(other,), opposite=(opposite_swap,))


class _Course(NamedTuple):
    """The segments at rest of a sensor, in order of time: `log` is the number of the log, `time_s` in s; `mean` (s, 3)
    in counts as recorded, and `deviation` (s, 3) in counts from what the model predicts; `noise` (3,) of a mean in
    counts. `face` (s,) numbers the attitudes.
    """

    log: Integers
    time_s: Floats
    face: Integers
    mean: Floats
    deviation: Floats
    noise: Floats


def _for_a_while(evidence: Evidence, other: str, phases: Sequence[PhaseEvidence]) -> Iterator[Hypothesis]:
    """Suggest the other sensor's data for a part of the time, and this sensor's data in the other's place if the
    other's levels agree.

    The usual levels are the medians, so the part must be shorter than the rest.
    """
    faces: dict[str, int] = {}
    course, other_course = _course(evidence.still, faces), _course(phases, faces)
    if not len(course.log) or not len(other_course.log):
        return
    usual, other_usual = _usual_levels(course, len(faces)), _usual_levels(other_course, len(faces))
    distance = other_usual - usual
    is_apart = np.asarray((np.abs(distance) > _APART * np.maximum(course.noise, other_course.noise)).any(axis=1))
    inside = is_apart[course.face] & (_share(course, usual, distance) > 0.5)
    if not inside.any() or not _is_at(course, inside, other_usual, distance):
        return
    when = _when(course, inside, _share(course, usual, distance))
    if not when.spans:
        return
    other_inside = np.array(
        [_is_within(when, *moment) for moment in zip(other_course.log, other_course.time_s, strict=True)], bool
    )
    is_exchange = bool(other_inside.any()) and _is_at(other_course, other_inside, usual, distance)
    yield from _readings(
        evidence,
        other,
        when,
        _refit(evidence.fitted, course, inside, evidence.header),
        _refit(evidence.twin_fitted[other], other_course, other_inside, phases[0].raw.header) if is_exchange else None,
    )


def _readings(
    evidence: Evidence, other: str, when: When, fitted: FittedParameters, opposite: FittedParameters | None
) -> Iterator[Hypothesis]:
    """Suggest that the other sensor's data replace this sensor's during `when`; if `opposite` parameters of the other
    are given, this sensor's data replace the other's too. If rows are flagged as no new reading, the flags may belong
    to the exchanged data or not.
    """
    name, rows_are_flagged = evidence.header.name, bool((evidence.values.get("stale", np.zeros(1)) > 0).any())
    for kind in ("data", "counts") if rows_are_flagged else ("data",):
        effects: tuple[Effect, ...] = () if opposite is None else (ChannelSwap(name, kind),)
        exchange = Hypothesis(
            (ChannelSwap(other, kind),),
            shared=True,
            sensor=name,
            others=(other,),
            opposite=effects,
            fitted=fitted,
            opposite_fitted=opposite,
        )
        yield replace(exchange.at(when), whole=True)


def _exchanges(evidence: Evidence, other: str, phases: Sequence[PhaseEvidence]) -> Iterator[Hypothesis]:
    """Suggest that the data of both sensors are exchanged for a part of the time.

    The readings of each sensor deviate by one offset from what the model predicts for it, in whichever column they are
    recorded. If the two measure different things, as accelerometers do that are mounted differently, each segment
    shows whose readings it has. Otherwise the exchange lasts from a moment to the end of its log or of all logs: the
    moment that makes the deviations most constant.
    """
    if not phases or phases[0].raw.header.sensitivity != evidence.header.sensitivity:
        return
    faces: dict[str, int] = {}
    pair = _Pair(*_in_common(_course(evidence.still, faces), _course(phases, faces)))
    if len(pair.course.log) < 2 * _LEAST_SEGMENTS:
        return
    if evidence.header.quantity == "specific_force":
        offsets = (np.array(fitted.offset) for fitted in (evidence.fitted, evidence.twin_fitted[other]))
        by_segment = pair.exchanged_segments(*(evidence.header.sensitivity * offset for offset in offsets))
        if by_segment is not None and (exchange := _exchange(evidence, other, pair, by_segment)):
            yield from exchange
            return
    floor = np.square(np.concatenate([pair.course.noise, pair.other_course.noise]))
    log = pair.course.log
    last = np.searchsorted(log, log, side="right")  # end of each segment's log
    for ends in (last, np.full(len(last), len(last))):
        gains = _gains_of_exchange(pair.own_deviation, pair.exchanged_deviation, ends, floor)
        begin = int(gains.argmax())
        if gains[begin] < _CLEAR:
            continue
        inside = np.zeros(len(log), bool)
        inside[begin : ends[begin]] = True
        yield from _exchange(evidence, other, pair, inside)


class _Pair(NamedTuple):
    """The courses of two sensors, with the same segments (s,)."""

    course: _Course
    other_course: _Course

    @property
    def way(self) -> Floats:
        """(s, 3) from the model's prediction for the sensor to its prediction for the other, in counts."""
        course, other_course = self.course, self.other_course
        return np.asarray(other_course.mean - other_course.deviation - course.mean + course.deviation)

    @property
    def own_deviation(self) -> Floats:
        """(s, 6) deviations of both sensors from the model's prediction, as recorded."""
        return np.concatenate([self.course.deviation, self.other_course.deviation], axis=1)

    @property
    def exchanged_deviation(self) -> Floats:
        """(s, 6) the same deviations if the rows of both sensors are exchanged."""
        return np.concatenate([self.other_course.deviation + self.way, self.course.deviation - self.way], axis=1)

    def exchanged_segments(self, offset: Floats, other_offset: Floats) -> Booleans | None:
        """Return (s,) the segments in which each sensor has the other's readings. The fitted offsets, in counts, are
        added to the deviations again, since an exchange falsifies the fit. A segment in which both sensors measure the
        same gets the state of the nearest clear segment of its log. None if no clear segment is exchanged, or all are.
        """
        way, time_s, log = self.way - other_offset + offset, self.course.time_s, self.course.log
        shares = np.stack(
            [
                _part_of_way(self.course.deviation + offset, way),
                _part_of_way(self.other_course.deviation + other_offset, -way),
            ]
        )
        length = np.linalg.norm(way, axis=1)
        is_own, is_others = (shares < 0.5).all(axis=0), (shares > 0.5).all(axis=0)
        tells = (length > _FAR * length.max(initial=0.0)) & (is_own | is_others)
        inside = np.asarray(tells & is_others)
        if not inside.any() or inside[tells].all():
            return None
        for at in np.flatnonzero(~tells).tolist():
            near = np.flatnonzero(tells & (log == log[at]))
            inside[at] = bool(len(near)) and inside[near[np.abs(time_s[near] - time_s[at]).argmin()]]
        return inside


def _exchange(evidence: Evidence, other: str, pair: _Pair, inside: Booleans) -> list[Hypothesis]:
    """Suggest the exchange in the segments `inside` (s,); none if it explains too few of them."""
    deviation = np.where(inside[:, None], pair.exchanged_deviation, pair.own_deviation)
    offsets = np.median(deviation, axis=0)
    way = pair.way + offsets[3:] - offsets[:3]
    error, length = np.linalg.norm((deviation - offsets)[:, :3], axis=1), np.linalg.norm(way, axis=1)
    is_far = (error > _NEAR * length) & (length > _FAR * length.max())
    if np.count_nonzero(is_far) >= _LEAST_SEGMENTS:  # fewer: segments that contain the moment of the exchange
        return []
    scale = evidence.header.sensitivity
    exchanges = _readings(
        evidence,
        other,
        _when(pair.course, inside, _part_of_way(pair.course.deviation - offsets[:3], way)),
        _with_offset(evidence.fitted, offsets[:3] / scale),
        _with_offset(evidence.twin_fitted[other], offsets[3:] / scale),
    )
    bounds_s = _gap_before(pair.course, inside)
    return [replace(exchange, begin_bounds_s=bounds_s) for exchange in exchanges]


def _gap_before(course: _Course, inside: Booleans) -> tuple[float, float] | None:
    """Return the gap between segments at rest, in seconds of the log, in which the last stretch of the segments
    `inside` begins; None if it begins with its log, or if the segments touch.
    """
    begins = np.flatnonzero(inside[1:] & ~inside[:-1] & (course.log[1:] == course.log[:-1])) + 1
    if not len(begins):
        return None
    begin = int(begins[-1])
    before_s, after_s = course.time_s[begin - 1 : begin + 1].tolist()
    width_s = float(np.median(np.diff(course.time_s[course.log == course.log[begin]])))
    return (before_s, after_s) if after_s - before_s > 2 * width_s else None


def _in_common(course: _Course, other_course: _Course) -> tuple[_Course, _Course]:
    """Return the segments that both courses contain at the same time."""
    pairs = [np.zeros((2, 0), np.int64)]
    for log in np.unique(course.log).tolist():
        rows_of_log, other_rows_of_log = np.flatnonzero(course.log == log), np.flatnonzero(other_course.log == log)
        if len(rows_of_log) < 2 or not len(other_rows_of_log):
            continue
        apart_s = np.abs(course.time_s[rows_of_log, None] - other_course.time_s[other_rows_of_log])
        nearest = apart_s.argmin(axis=1)
        is_same = apart_s.min(axis=1) < np.median(np.diff(course.time_s[rows_of_log])) / 4
        pairs.append(np.stack([rows_of_log[is_same], other_rows_of_log[nearest[is_same]]]))
    rows, other_rows = np.concatenate(pairs, axis=1)
    return _chosen(course, rows), _chosen(other_course, other_rows)


def _chosen(course: _Course, rows: Integers) -> _Course:
    """Return the segments `rows` of a course."""
    log, time_s, face, mean, deviation, noise = course
    return _Course(log[rows], time_s[rows], face[rows], mean[rows], deviation[rows], noise)


_TINY = float(np.finfo(float).tiny)


def _gains_of_exchange(own: Floats, exchanged: Floats, ends: Integers, floor: Floats) -> Floats:
    """Return (s,) the nats by which the deviations (s, 6) are more constant if those from each segment to `ends` (s,)
    are `exchanged` instead of `own`. Their variances are at least `floor` (6,), which is 0 for an axis that never
    changes.
    """
    floor = np.maximum(floor, _TINY)
    count, begins = len(own), np.arange(len(own))
    middle = np.median(own, axis=0)

    def total(power: int) -> Floats:
        own_sums, sums = (
            np.cumsum(np.pad((side - middle) ** power, ((1, 0), (0, 0))), axis=0) for side in (own, exchanged)
        )
        return np.asarray(own_sums[-1] - own_sums[ends] + own_sums[begins] + sums[ends] - sums[begins])

    variance = total(2) / count - (total(1) / count) ** 2
    usual = np.maximum(own.var(axis=0), floor)
    gains = count / 2 * np.log(usual / np.maximum(variance, floor)).sum(axis=1)
    return np.where(np.minimum(begins, ends - begins) < _LEAST_SEGMENTS, 0.0, gains)


def _with_offset(fitted: FittedParameters, more: Floats) -> FittedParameters:
    """Return the parameters with an offset that is larger by `more` (3,), in the sensor's unit."""
    return replace(fitted, offset=triple(np.array(fitted.offset) + more))


def _course(phases: Sequence[PhaseEvidence], faces: dict[str, int]) -> _Course:
    """Return the course of a sensor over its phases at rest. `faces` numbers the attitudes and is extended; a gyroscope
    has a single one, since it does not measure the attitude.
    """
    parts = []
    for phase in phases:
        raw, residual = phase.raw.segments, phase.residual.segments
        is_usable = phase.is_still & (raw.rows >= _LEAST_ROWS) & np.isfinite(raw.mean).all(axis=1)
        feels = phase.raw.header.quantity != "angular_rate"
        attitude = faces.setdefault(phase.raw.phase.up if feels else "", len(faces))
        noise = np.sqrt(raw.steady_variance[is_usable] / raw.rows[is_usable, None])
        count = int(is_usable.sum())
        numbers = np.full(count, phase.log), raw.time_s[is_usable], np.full(count, attitude)
        parts.append((*numbers, raw.mean[is_usable], residual.mean[is_usable], noise))
    if not any(len(part[0]) for part in parts):
        none, nothing = np.zeros(0, np.int64), np.zeros((0, 3))
        return _Course(none, np.zeros(0), none, nothing, nothing, np.zeros(3))
    log, time_s, face, mean, deviation, noise = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((time_s, log))
    typical = np.asarray(np.median(noise, axis=0))
    return _Course(log[order], time_s[order], face[order], mean[order], deviation[order], typical)


def _usual_levels(course: _Course, faces: int) -> Floats:
    """Return (f, 3) the median over the segments of each attitude; nan for an attitude without segments."""
    levels = np.full((faces, 3), np.nan)
    for number in np.unique(course.face):
        levels[number] = np.median(course.mean[course.face == number], axis=0)
    return levels


def _share(course: _Course, usual: Floats, distance: Floats) -> Floats:
    """Return (s,) the position of each segment between the usual level (0) and the other sensor's level (1)."""
    return _part_of_way(course.mean - usual[course.face], distance[course.face])


def _part_of_way(distance: Floats, way: Floats) -> Floats:
    """Return (s,) the component of `distance` (s, 3) along each `way` (s, 3), as a share of the way; 0 if it has no
    length.
    """
    along, square = (distance * way).sum(axis=1), (way**2).sum(axis=1)
    return np.asarray(np.divide(along, square, out=np.zeros(len(along)), where=square > 0))


def _is_at(course: _Course, inside: Booleans, levels: Floats, distance: Floats) -> bool:
    """Return whether the segments inside have these levels."""
    off = np.median(course.mean[inside] - levels[course.face[inside]], axis=0)
    way = np.median(np.abs(distance[course.face[inside]]), axis=0)
    return bool(np.linalg.norm(off) < _NEAR * np.linalg.norm(way))


def _when(course: _Course, inside: Booleans, share: Floats) -> When:
    """Return the stretches of segments inside. The moment of a step follows from its shares in the means of the two
    segments next to it.
    """
    spans: list[Span] = []
    for log in np.unique(course.log).tolist():
        is_of_log = course.log == log
        within, time_s, shares = inside[is_of_log], course.time_s[is_of_log], np.clip(share[is_of_log], 0.0, 1.0)
        width_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[0], within.astype(np.int8), [0]])))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            begin_s = _moment_s(time_s, shares, begin, width_s, is_begin=True)
            end_s = _moment_s(time_s, shares, end, width_s, is_begin=False)
            if end_s > begin_s:  # false for a single segment that contains little of the step
                spans.append(Span(log, begin_s, end_s - begin_s))
    return When(tuple(spans))


def _moment_s(time_s: Floats, shares: Floats, at: int, width_s: float, *, is_begin: bool) -> float:
    """Return the moment of a change between segments at - 1 and at; 0 or infinity at the ends of a log."""
    if at == 0 or at == len(time_s):
        return 0.0 if at == 0 else math.inf
    early_s = width_s * (float(shares[at - 1 : at + 1].sum()) - 1)
    return float(time_s[at - 1 : at + 1].mean()) + (-early_s if is_begin else early_s)


def _is_within(when: When, log: int, time_s: float) -> bool:
    return any(number == log and begin_s <= time_s < end_s for number, begin_s, end_s in when.triples)


def _refit(fitted: FittedParameters, course: _Course, inside: Booleans, header: SensorHeader) -> FittedParameters:
    """Return the parameters with the offset that the segments outside have."""
    if inside.all():
        return fitted
    return _with_offset(fitted, np.median(course.deviation[~inside], axis=0) / header.sensitivity)


def _twins(evidence: Evidence) -> set[str]:
    """Return the other sensors with the same readings count for count, whatever their axes are configured to be."""
    name = evidence.header.name
    largest: dict[str, float] = {}
    for phase in evidence.still:
        if phase.cross is None or not takes_part(evidence, phase.cross):
            continue
        for other in phase.cross.others(name, family=False):
            columns, other_columns = phase.cross.columns(name), phase.cross.columns(other)
            size = np.sqrt(
                np.diag(phase.cross.fast[columns, columns]) * np.diag(phase.cross.fast[other_columns, other_columns])
            )
            shared = np.diag(phase.cross.fast[columns, other_columns])
            if (size > 0).all():
                largest[other] = max(largest.get(other, -1.0), float((shared / size).min()))
    return {other for other, correlation in largest.items() if correlation > _SAME}


def _axes_in(evidence: Evidence, other: SensorHeader) -> Floats:
    """Return (3, 3) the sensor's axes (columns) in the frame of the other sensor."""
    return np.asarray(np.array(other.orientation).T @ np.array(evidence.header.orientation))


def _is_parallel(evidence: Evidence, other: SensorHeader) -> bool:
    return bool(np.allclose(_axes_in(evidence, other), np.eye(3)))


def _is_turned(evidence: Evidence) -> bool:
    """Return whether an accelerometer's level at rest deviates so far that only other axes explain it, and no response
    shows which axes.
    """
    if evidence.header.quantity != "specific_force" or next(_shown(evidence), None) is not None:
        return False
    return evidence.is_odd("mean", beyond=_BEYOND) and bool(np.abs(evidence.shift("mean")).max() > _TURNED_G)


def _lies_along(evidence: Evidence, other: SensorHeader, scale: float = 1.0) -> bool:
    """Return whether the response is that of the other sensor's axes, times `scale`, rather than of its own axes."""
    expected = _axes_in(evidence, other) * scale
    if np.allclose(expected, np.eye(3)):
        return False
    return any((np.abs(response - expected) < _NEAR).all() for response in _shown(evidence))


def _shown(evidence: Evidence) -> Iterator[Floats]:
    """Yield (3, 3) responses of the axes (rows) to force or motion along the nominal axes: by the medians over phases,
    and by all motions together. The probes of force are residuals, so the ideal response is added to them.
    """
    rows = np.arange(3)
    for kind, ideal in ((0, np.eye(3)), (1, np.zeros((3, 3)))):
        if kind == 0 and evidence.header.quantity != "specific_force":
            continue
        turned = ideal.copy()
        for step, probes in enumerate(_AXES):
            response = evidence.values.get(probes[kind], np.full((1, 3), np.nan))
            known = np.isfinite(response).all(axis=1)
            turned[rows, (rows + step) % 3] += np.median(response[known], axis=0) if known.any() else np.nan
        if np.isfinite(turned).all():
            yield turned
    turned = response_to_all_motions(evidence)
    if np.isfinite(turned).all():
        yield turned
