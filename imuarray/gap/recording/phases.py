"""The phases of a recorded log, their attitudes, and the detection of phases where none are noted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import up_vector
from imuarray.calibrate.pose_readings import MIN_POSE_S, find_rests
from imuarray.errors import CalibrationError, LogError
from imuarray.gap.recording.attitude import array_mean, attitude_numbers, shared_readings, ups_of
from imuarray.gap.recording.movement import (
    loud_rests,
    movements_of,
    noise_at_rest,
    shaken_quantities,
    shows_motion,
    unresolved_quantities,
    vibrates,
)
from imuarray.gap.recording.quiet import knocks, quiet_rest
from imuarray.gap.recording.source import RecordedSource
from imuarray.log import Log, SensorLog
from imuarray.log.format import Phase
from imuarray.log.rests import MOVING_NAMES, RUN, has_several_runs, is_face_check
from imuarray.log.rests import is_at_rest as is_noted_rest
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.posed import Movement, PoseAttitude
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.units import INERTIAL

Up = tuple[float, float, float]

_SHORT = 0.25
"""Least length of a static stretch, as a share of the longest one. In a shorter one, a hand often holds the box."""

MOST_TILT_DEG = 15.0
"""Largest tilt of a box on a noted face, in degrees; a nuisance quantity. By hand a box is set up within a dozen
degrees. If the tilt is larger, the note is doubted.
"""

MOST_RATE_DPS, _TRACK_TIMES = 3.0, 1000
"""Rate, in degrees per second (rms over this many moments of a phase), above which a box is not at rest according to
its track, even if the phase is noted as at rest.
"""

_CHANGE_DPS, _REFERENCE_DPS, _PARTS = 10.0, 0.3, 32
"""Least mean rates, in degrees per second, that are those of a turntable, according to gyroscopes less their reading at
rest (their biases change less in any heating) and according to a reference; and the number of parts of a phase in which
the mean is computed.
"""

HEATED_DEGC = 3.0
"""Change of temperature in a phase at rest, in degC, above which the box is heated: that of a room changes less in
minutes.
"""

NEEDED_S, NEEDED_ROWS = 3.0, 24
"""Shortest time at rest, in s, and fewest rows of a log without phases. Static stretches are detected in windows of
half a second or four rows, and the first and the last window are cut off.
"""

TURN = "turn"
"""Name of a stretch between two noted rests in which the box turns."""

_LONGEST_TURN_S = 20.0
"""Longest time, in s, in which a hand turns a box from one rest to the next."""

_UNKNOWN_MOTION = (
    "the log has no track of the box's motion, nor two sensors of a kind and a gyroscope that show it (in phases of up "
    "to an hour)"
)
_VIBRATION = (
    "the box vibrates faster than the rows of its accelerometers show, so that sensors that are read at other moments "
    "differ"
)
_LOUD = "it is noted as at rest, but all of its sensors are much noisier than in another rest of the log"
_SHAKEN = "it is noted as at rest, but its sensors feel the same motion, well beyond their noise"
_SHARED_MOTION = (
    "There is no track of the box's motion: it is estimated from the array's own sensors, so that an error of all of "
    "them does not show in motion."
)

_UNRESOLVED_CHANGES = (
    "{count} of {motions} motions have changes that the rows do not resolve: differences of the response to them count "
    "only beyond wide margins."
)

_SAME_COSINE = np.cos(np.radians(10))
"""Cosine of the largest angle between the directions up of poses on one face."""


def is_at_rest(phase: Phase) -> bool:
    """Return whether the box is at rest in a phase by the rule of `imuarray.log.rests`; a face that is read again is
    compared only if its axis is noted.
    """
    return is_noted_rest(phase) and (bool(phase.up) or not is_face_check(phase))


class ComparablePhases(NamedTuple):
    """The phases of a log that can be compared, and the motions that its own sensors show.

    `notes` say what was left out or assumed; `shaken` are the quantities that are shaken in all phases at rest;
    `restless` are the spans (begin, end), in ns, in which the box was touched, shaken or knocked; `unresolved` are, by
    phase, the quantities with changes in a motion that the rows do not resolve.
    """

    phases: tuple[Phase, ...]
    movements: tuple[Movement, ...]
    notes: list[str]
    shaken: tuple[str, ...]
    restless: tuple[tuple[int, int], ...]
    unresolved: Mapping[Phase, tuple[str, ...]]


def is_motion(phase: Phase) -> bool:
    """Return whether a phase is a motion that is more than a turn from one rest to the next."""
    return not is_at_rest(phase) and phase.name != TURN


def phases_of(log: Log, motion: LikeLog, sensors: Sequence[str]) -> ComparablePhases:
    """Return the phases in which these sensors can be compared, and notes on those in which they cannot.

    These are the phases at rest, or detected static stretches if no rest is noted. Other phases, turns between noted
    rests and motions between detected ones are included if `motion` follows a track or several sensors show the motion.
    Raises LogError if no phase can be compared.
    """
    is_tracked = motion.source != "phases"
    named = _without_names_of_runs(log.phases)
    noted = [
        _without_false_face(phase, motion) if is_tracked else _without_face_of_turntable(phase, log, named)
        for phase in named
    ]
    triads = [log[name] for name in sensors if log[name].sensitivity]
    moving = [phase for phase in noted if not is_at_rest(phase)]
    still = [quiet_rest(triads, phase) for phase in noted if is_at_rest(phase)]
    detected, notes = ([], []) if still else _detected_poses(log)
    if is_tracked:
        detected = [phase for phase in detected if not moves_by_track(phase, motion)]
    elif in_motion := [phase for phase in detected if _is_noted_as_motion(phase, noted)]:
        detected = [phase for phase in detected if phase not in in_motion]
        notes.append(f"Static stretches left out because they are noted as motion: {len(in_motion)}.")
    quiet = [*still, *(quiet_rest(triads, phase) for phase in detected)]
    all_rests = [rest.phase for rest in quiet]
    turns = list(_turns(sorted([*moving, *(rest.phase for rest in still)])))
    movements: list[Movement] = []
    knocked: list[tuple[int, int]] = []
    unresolved: dict[Phase, tuple[str, ...]] = {}
    if is_tracked and log.phases:
        moving += [turn for turn in turns if moves_by_track(turn, motion)]
    elif is_tracked:
        moving = list(_between_rests(log, all_rests))
    else:
        turns = turns if log.phases else list(_motions(all_rests))
        shown = movements_of(log, sensors, [*moving, *turns], all_rests)
        noise = {} if shown.keys() >= {*moving} else noise_at_rest(triads, all_rests)
        for phase in moving:
            if phase not in shown:
                reason = _VIBRATION if vibrates(triads, phase, noise) else _UNKNOWN_MOTION
                notes.append(f"Phase {phase.name!r} is left out: {reason}.")
        notes += [_SHARED_MOTION] if shown else []
        moving, movements = list(shown), sorted(shown.values(), key=lambda movement: movement.start_ns)
        unresolved = {phase: unresolved_quantities(triads, phase, all_rests) for phase in moving}
        rough = sum(map(bool, unresolved.values()))
        notes += [_UNRESOLVED_CHANGES.format(count=rough, motions=len(moving))] if rough else []
        knocked = [span for phase in moving for span in knocks(triads, phase, all_rests)]
    loud = loud_rests(triads, [rest.phase for rest in quiet])
    notes += [f"Phase {rest.phase.name!r} is left out: {_LOUD}." for rest in quiet if rest.phase in loud]
    quiet = [rest for rest in quiet if rest.phase not in loud]
    shaken = {rest: shaken_quantities(triads, rest.phase) for rest in quiet}
    rests = [rest for rest, quantities in shaken.items() if not quantities] or quiet
    notes += [f"Phase {rest.phase.name!r} is left out: {_SHAKEN}." for rest in quiet if rest not in rests]
    phases = tuple(sorted([*(rest.phase for rest in rests), *moving]))
    if not phases:
        raise LogError(f"{log.path}: nothing to compare: {_what_is_lacking(log)}")
    always = [quantity for quantity in INERTIAL if all(quantity in shaken[rest] for rest in rests)] if rests else []
    restless = [span for rest in rests for span in rest.restless]
    seconds = sum(rest.left_out_s for rest in rests)
    if seconds > 0:
        notes.append(f"{seconds:.3g} s at rest are left out: several sensors show that the box is touched or shaken.")
    if knocked:
        seconds = sum(end_ns - begin_ns for begin_ns, end_ns in knocked) * 1e-9
        notes.append(f"{seconds:.3g} s of motions are left out: several sensors show that the box is knocked.")
    return ComparablePhases(phases, tuple(movements), notes, tuple(always), (*restless, *knocked), unresolved)


def _is_noted_as_motion(stretch: Phase, phases: Sequence[Phase]) -> bool:
    """Return whether one of the noted phases with the name of a motion includes the stretch."""
    return any(
        phase.name in MOVING_NAMES and phase.start_ns <= stretch.start_ns and stretch.end_ns <= phase.end_ns
        for phase in phases
    )


def _without_names_of_runs(phases: Sequence[Phase]) -> list[Phase]:
    """Return the phases with other names for runs if a log has several, because these names then do not mean a rest."""
    if not has_several_runs(phases):
        return list(phases)
    return [
        phase._replace(name=phase.name.replace(" ", "-")) if phase.name.startswith(RUN) else phase for phase in phases
    ]


def _without_false_face(phase: Phase, motion: LikeLog) -> Phase:
    """Return the phase without its noted axis if the box turns in it according to the track: the note is then that of
    the first face only.
    """
    rate_dps = np.degrees(np.asarray(_sampled(phase, motion).rate_box, float))
    turns = float(np.sqrt(np.mean(rate_dps**2, axis=0).sum())) > MOST_RATE_DPS
    return phase._replace(up="") if phase.up and turns else phase


def _without_face_of_turntable(phase: Phase, log: Log, phases: Sequence[Phase]) -> Phase:
    """Return the phase without its noted axis if the box turns in it about that axis on a turntable and its name does
    not mean rest. A reference of the rate decides this, or else gyroscopes less their reading in the first rest among
    the `phases` of the log.
    """
    if not phase.up or is_at_rest(phase._replace(up="")):
        return phase
    rests = [rest for rest in phases if is_at_rest(rest._replace(up=""))][:1]
    gyroscopes = [sensor for sensor in log.of("angular_rate") if sensor.sensitivity]
    parts_ns = np.linspace(phase.start_ns, phase.end_ns, _PARTS + 1).astype(np.int64)
    parts = [Phase(int(start_ns), int(end_ns), phase.name) for start_ns, end_ns in pairwise(parts_ns)]
    biases_dps = [_mean_reading(sensor, rest) for rest in rests for sensor in gyroscopes]  # empty without a rest
    changes_dps = [
        [_mean_reading(sensor, part) - bias_dps for sensor, bias_dps in zip(gyroscopes, biases_dps, strict=False)]
        for part in parts
    ]
    known_dps = [[change for change in changes if np.isfinite(change).all()] for changes in changes_dps]
    largest_dps, least_dps = _largest([np.median(changes, axis=0) for changes in known_dps if changes]), _CHANGE_DPS
    reference = log.reference
    if reference is not None and reference.angular_rate is not None:
        places = np.searchsorted(reference.time[:], parts_ns).tolist()
        means = [
            np.asarray(reference.angular_rate[first:stop], float).mean(axis=0)
            for first, stop in pairwise(places)
            if stop > first
        ]
        largest_dps, least_dps = float(np.degrees(_largest(means))), _REFERENCE_DPS
    return phase._replace(up="") if largest_dps > least_dps else phase


def _largest(vectors: Sequence[Floats]) -> float:
    """Return the length of the longest finite vector (3,); 0 without one."""
    return float(max((np.linalg.norm(vector) for vector in vectors if np.isfinite(vector).all()), default=0.0))


def moves_by_track(phase: Phase, motion: LikeLog) -> bool:
    """Return whether the box moves in a phase according to the track that `motion` follows, by more than the track's
    noise. Sensors whose noise exceeds a gentle motion do not show it.
    """
    moment = _sampled(phase, motion)
    return shows_motion(np.asarray(moment.force_box, float), np.asarray(moment.rate_box, float))


def _sampled(phase: Phase, motion: LikeLog) -> BoxStimulus:
    """Return the force, the rate and the temperature of the box at moments evenly spread over a phase."""
    return motion.stimulus(np.linspace(phase.start_ns, phase.end_ns, _TRACK_TIMES, endpoint=False).astype(np.int64))


def _what_is_lacking(log: Log) -> str:
    """Return a sentence on why nothing can be compared, and what is needed."""
    triads = [sensor for sensor in log.sensors.values() if sensor.is_triad and len(sensor)]
    span_s = max(((int(sensor.time[-1]) - int(sensor.time[0])) * 1e-9 for sensor in triads), default=0.0)
    rate_hz = max((len(sensor) / span_s for sensor in triads), default=0.0) if span_s > 0 else 0.0
    needed_s = max(NEEDED_S, NEEDED_ROWS / rate_hz) if rate_hz > 0 else NEEDED_S
    if span_s < needed_s:
        return f"it is {span_s:.3g} s long, and at least {needed_s:.3g} s at rest are needed"
    return (
        f"the box is never at rest for {MIN_POSE_S:g} s and the log has no track of its motion; at least "
        f"{needed_s:.3g} s at rest are needed"
    )


def _detected_poses(log: Log) -> tuple[list[Phase], list[str]]:
    """Return the static stretches of a log without noted ones, except short ones, with notes."""
    try:
        rests = [pose.phase for pose in find_rests(log)]
    except CalibrationError:
        return [], []
    lengths = [phase.end_ns - phase.start_ns for phase in rests]
    long_rests = [phase for phase, length in zip(rests, lengths, strict=True) if length >= _SHORT * max(lengths)]
    stretches = "1 static stretch was" if len(long_rests) == 1 else f"{len(long_rests)} static stretches were"
    notes = [f"No phase is marked as at rest: {stretches} detected."] if long_rests else []
    if (short := len(rests) - len(long_rests)) > 0:
        notes.append(f"Static stretches left out because they are much shorter than the longest: {short}.")
    return long_rests, notes


def _between_rests(log: Log, still: Sequence[Phase]) -> Iterator[Phase]:
    """Yield the stretches before, between and after the static ones of a log that are at least as long as a pose."""
    begin = min(int(sensor.time[0]) for sensor in log.sensors.values() if len(sensor))
    end = max(int(sensor.time[-1]) for sensor in log.sensors.values() if len(sensor)) + 1
    starts, ends = [begin, *(phase.end_ns for phase in still)], [*(phase.start_ns for phase in still), end]
    for start_ns, end_ns in zip(starts, ends, strict=True):
        if end_ns - start_ns >= MIN_POSE_S * 1e9:
            yield Phase(start_ns, end_ns, "motion")


def _turns(phases: Sequence[Phase]) -> Iterator[Phase]:
    """Yield the stretches between consecutive phases at rest that are at least as long as a pose."""
    for before, after in pairwise(phases):
        between = Phase(before.end_ns, after.start_ns, TURN)
        if is_at_rest(before) and is_at_rest(after) and between.end_ns - between.start_ns >= MIN_POSE_S * 1e9:
            yield between


def _motions(rests: Sequence[Phase]) -> Iterator[Phase]:
    """Yield the stretches between consecutive rests that take longer than a turn from one to the next."""
    for turn in _turns(rests):
        if turn.end_ns - turn.start_ns > _LONGEST_TURN_S * 1e9:
            yield turn._replace(name="motion")


def attitudes_of(log: Log, phases: Sequence[Phase], motion: LikeLog) -> tuple[tuple[PoseAttitude, ...], list[str]]:
    """Return the attitudes of the box in the phases at rest, and notes on how they were obtained; empty if `motion`
    follows a track.

    Tables are not level and boxes are not square: on a noted face, the tilt is estimated from the accelerometers and
    used if it is at most `MOST_TILT_DEG`.
    """
    still = [phase for phase in phases if is_at_rest(phase)]
    if motion.source != "phases":
        return (), []
    noted = [up_vector(phase.up) if phase.up else None for phase in still]
    free = noted.count(None)
    accelerometers = [sensor for sensor in log.of("specific_force") if len(sensor) and sensor.sensitivity]
    if not accelerometers:
        ups = [up or (0.0, 0.0, 1.0) for up in noted]
        notes = (
            ["There is no accelerometer to estimate the attitude from: +Z up is assumed where no phase notes it."]
            if free
            else []
        )
        return tuple(PoseAttitude(phase, up, estimated=False) for phase, up in zip(still, ups, strict=True)), notes
    readings = shared_readings(
        attitude_numbers(still),
        np.array([[_mean_reading(sensor, phase) for sensor in accelerometers] for phase in still]),
    )
    known = np.array([(np.nan,) * 3 if up is None else up for up in noted])
    estimates = ups_of(array_mean(readings, known), np.full_like(known, np.nan), known).up_box.tolist()
    attitudes = [_attitude(*item) for item in zip(still, noted, estimates, strict=True)]
    note = (
        f"The axis that was up is not noted in {free} of {len(still)} phases at rest. It is estimated from all "
        "accelerometers; their common error is separated from it only as far as the attitudes differ."
    )
    return tuple(attitudes), [note] if free else []


def _attitude(phase: Phase, noted: Up | None, estimate: Sequence[float]) -> PoseAttitude:
    """Return the estimated attitude, or the noted face if the estimate differs from it by more than a tilt."""
    x, y, z = estimate
    if noted is not None and np.dot(noted, estimate) < np.cos(np.radians(MOST_TILT_DEG)):
        return PoseAttitude(phase, noted, estimated=False)
    return PoseAttitude(phase, (x, y, z), estimated=True)


def _mean_reading(sensor: SensorLog, phase: Phase) -> Floats:
    """Return the mean reading (3,) in the sensor's unit in the box frame; nan without readings."""
    rows, sums = 0, np.zeros(3)
    for block in RecordedSource(sensor).blocks(phase.start_ns, phase.end_ns):
        rows += len(block.time)
        sums += block.counts.sum(axis=0, dtype=float)
    return np.asarray(sensor.orientation @ sums / (rows * sensor.sensitivity)) if rows else np.full(3, np.nan)


def is_heated(phases: Sequence[Phase], motion: LikeLog) -> bool:
    """Return whether a phase is noted as heating, or the temperature changes by more than `HEATED_DEGC` in a phase at
    rest.
    """
    return any("heat" in phase.name or _change_degc(phase, motion) > HEATED_DEGC for phase in phases)


def _change_degc(phase: Phase, motion: LikeLog) -> float:
    return float(np.ptp(_sampled(phase, motion).temperature_degc)) if is_at_rest(phase) else 0.0


def kind_of(phases: Sequence[Phase], attitudes: Sequence[PoseAttitude], *, heated: bool) -> str:
    """Return the kind of a log: heating, turn-on, tumble, motion or static, the first that applies."""
    names = [phase.name for phase in phases]
    if heated:
        return "heating"
    if any(name.startswith(RUN) for name in names):
        return "turn-on"
    if _count_attitudes(phases, attitudes) > 1:
        return "tumble"
    return "motion" if any(map(is_motion, phases)) else "static"


def _count_attitudes(phases: Sequence[Phase], attitudes: Sequence[PoseAttitude]) -> int:
    """Return the number of different attitudes."""
    ups = [attitude.up_box for attitude in attitudes] or [up_vector(phase.up) for phase in phases if phase.up]
    distinct: list[Up] = []
    for up in ups:
        if all(np.dot(up, other) < _SAME_COSINE for other in distinct):
            distinct.append(up)
    return len(distinct)


def temperature_notes(motion: LikeLog) -> list[str]:
    """Return a note if the log has no reference temperature."""
    if motion.temperature_source == "nothing":
        return ["There is no reference temperature: 25 degC is assumed, and any usual change of a room's temperature."]
    if motion.temperature_source == "chip":
        return [
            "There is no reference temperature: it is taken from a chip's own thermometer, which may be some degrees "
            "off and is warmer than the air. Thermometers are therefore not compared."
        ]
    return []
