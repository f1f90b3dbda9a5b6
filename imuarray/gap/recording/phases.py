"""What was done in a recorded log: its phases, how the box lay in them, and what nobody noted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import up_vector
from imuarray.calibrate.pose_readings import MIN_POSE_S, find_rests
from imuarray.characterise.stretch import FACE_NAMES, STILL_NAMES
from imuarray.errors import CalibrationError, LogError
from imuarray.gap.recording.attitude import array_mean, ups_of
from imuarray.gap.recording.source import RecordedSource
from imuarray.log import Log, SensorLog
from imuarray.log.format import Phase
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.posed import Attitude

Up = tuple[float, float, float]

_SHORT = 0.25
"""A static stretch of less than this share of the longest says little, and often is a hand that holds the box."""

MOST_TILT_DEG = 5.0
"""A box that is said to stand on a face leans no further: a nuisance quantity. Beyond, the label is doubted."""

MOST_RATE_DPS, _TRACK_TIMES = 3.0, 1000
"""A box that turns faster by its track, rms over so many moments of a phase, is not at rest, whatever is noted."""

HEATED_DEGC = 3.0
"""A room changes less in the minutes in which a box stands still."""

NEEDED_S, NEEDED_ROWS = 3.0, 24
"""So long, and so many rows, a log without phases has to be at rest: a static stretch is found by windows of half a
second or four rows, of which the first and the last are cut off."""

_SAME_COSINE = np.cos(np.radians(10))
"""Poses nearer to each other than that are of one face."""


def is_at_rest(phase: Phase) -> bool:
    """Whether the box is at rest in a phase: it says which axis is up, or its name says it."""
    name = phase.name
    return bool(phase.up) or name in STILL_NAMES or name in FACE_NAMES or name.startswith(("run ", "pose "))


def phases_of(log: Log, motion: LikeLog) -> tuple[tuple[Phase, ...], list[str]]:
    """What can be compared, and notes on what can't: phases at rest, else static stretches that are found; others where
    `motion` follows a track. LogError if there is nothing.
    """
    is_told = motion.source != "phases"
    noted = [_as_tracked(phase, motion) if is_told else phase for phase in log.phases]
    still = [phase for phase in noted if is_at_rest(phase)]
    found, notes = ([], []) if still else _found_poses(log)
    moving = [phase for phase in noted if phase not in still]
    if not is_told:
        notes += [f"Phase {phase.name!r} is left out: nothing says how the box moved." for phase in moving]
        moving = []
    elif not log.phases:
        moving = list(_between(log, found))
    phases = tuple(sorted([*still, *found, *moving]))
    if not phases:
        raise LogError(f"{log.path}: nothing to compare: {_lacking(log)}")
    return phases, notes


def _as_tracked(phase: Phase, motion: LikeLog) -> Phase:
    """Without an axis that is up, if the track says that the box turns: that of the face on which it began."""
    times_ns = np.linspace(phase.start_ns, phase.end_ns, _TRACK_TIMES, endpoint=False).astype(np.int64)
    rate_dps = np.degrees(np.asarray(motion.felt(times_ns).rate_box, float))
    turns = float(np.sqrt(np.mean(rate_dps**2, axis=0).sum())) > MOST_RATE_DPS
    return phase._replace(up="") if phase.up and turns else phase


def _lacking(log: Log) -> str:
    """Why there is nothing, and what is needed."""
    read = [sensor for sensor in log.sensors.values() if sensor.is_triad and len(sensor)]
    span_s = max(((int(one.time[-1]) - int(one.time[0])) * 1e-9 for one in read), default=0.0)
    rate_hz = max((len(one) / span_s for one in read), default=0.0) if span_s > 0 else 0.0
    needed_s = max(NEEDED_S, NEEDED_ROWS / rate_hz) if rate_hz > 0 else NEEDED_S
    if span_s < needed_s:
        return f"it is {span_s:.3g} s long, and at least {needed_s:.3g} s at rest are needed"
    return (
        f"the box is never at rest for {MIN_POSE_S:g} s and nothing says how it moved; at least {needed_s:.3g} s at "
        "rest are needed"
    )


def _found_poses(log: Log) -> tuple[list[Phase], list[str]]:
    """Static stretches that no phase names, without the shortest."""
    try:
        found = [pose.phase for pose in find_rests(log)]
    except CalibrationError:
        return [], []
    lengths = [phase.end_ns - phase.start_ns for phase in found]
    kept = [phase for phase, length in zip(found, lengths, strict=True) if length >= _SHORT * max(lengths)]
    notes = [f"No phase is named as one at rest: {len(kept)} static stretches were found."] if kept else []
    if (short := len(found) - len(kept)) > 0:
        notes.append(f"Stretches left out that are short beside the longest one: {short}.")
    return kept, notes


def _between(log: Log, still: Sequence[Phase]) -> Iterator[Phase]:
    """The stretches of a log between its static ones, if they are as long as one."""
    begin = min(int(sensor.time[0]) for sensor in log.sensors.values() if len(sensor))
    end = max(int(sensor.time[-1]) for sensor in log.sensors.values() if len(sensor)) + 1
    starts, ends = [begin, *(phase.end_ns for phase in still)], [*(phase.start_ns for phase in still), end]
    for start_ns, end_ns in zip(starts, ends, strict=True):
        if end_ns - start_ns >= MIN_POSE_S * 1e9:
            yield Phase(start_ns, end_ns, "motion")


def attitudes_of(log: Log, phases: Sequence[Phase], motion: LikeLog) -> tuple[tuple[Attitude, ...], list[str]]:
    """How the box lay in the phases at rest, and notes on how that is known; nothing where `motion` follows a track.

    A table is not level and a box is not square: a face that is noted is tilted as the array's accelerometers say, if
    that is within `MOST_TILT_DEG` of it.
    """
    still = [phase for phase in phases if is_at_rest(phase)]
    if motion.source != "phases":
        return (), []
    noted = [up_vector(phase.up) if phase.up else None for phase in still]
    free = noted.count(None)
    accelerometers = [sensor for sensor in log.of("specific_force") if len(sensor) and sensor.sensitivity]
    if not accelerometers:
        ups = [up or (0.0, 0.0, 1.0) for up in noted]
        notes = ["No accelerometer tells which axis was up: where no phase says so, +Z is assumed."] if free else []
        return tuple(Attitude(phase, up, estimated=False) for phase, up in zip(still, ups, strict=True)), notes
    readings = np.array([[_mean_g(sensor, phase) for sensor in accelerometers] for phase in still])
    known = np.array([(np.nan,) * 3 if up is None else up for up in noted])
    estimates = ups_of(array_mean(readings), np.full_like(known, np.nan), known).up_box.tolist()
    attitudes = [_attitude(*item) for item in zip(still, noted, estimates, strict=True)]
    note = (
        f"Which axis was up is not noted in {free} of {len(still)} phases at rest: it is estimated from all "
        "accelerometers, whose common error is told from it only as far as the attitudes differ."
    )
    return tuple(attitudes), [note] if free else []


def _attitude(phase: Phase, noted: Up | None, estimate: Sequence[float]) -> Attitude:
    """As estimated, unless a face is noted that is further off than a tilt."""
    x, y, z = estimate
    if noted is not None and np.dot(noted, estimate) < np.cos(np.radians(MOST_TILT_DEG)):
        return Attitude(phase, noted, estimated=False)
    return Attitude(phase, (x, y, z), estimated=True)


def _mean_g(sensor: SensorLog, phase: Phase) -> Floats:
    """(3,) in the box frame; nan without readings."""
    rows, sums = 0, np.zeros(3)
    for block in RecordedSource(sensor).blocks(phase.start_ns, phase.end_ns):
        rows += len(block.time)
        sums += block.counts.sum(axis=0, dtype=float)
    return np.asarray(sensor.orientation @ sums / (rows * sensor.sensitivity)) if rows else np.full(3, np.nan)


def is_heated(phases: Sequence[Phase], motion: LikeLog) -> bool:
    """Whether a phase says so, or the temperature changes by `HEATED_DEGC` in one in which the box is at rest."""
    return any("heat" in phase.name or _change_degc(phase, motion) > HEATED_DEGC for phase in phases)


def _change_degc(phase: Phase, motion: LikeLog) -> float:
    times_ns = np.linspace(phase.start_ns, phase.end_ns, _TRACK_TIMES, endpoint=False).astype(np.int64)
    return float(np.ptp(motion.felt(times_ns).temperature_degc)) if is_at_rest(phase) else 0.0


def kind_of(phases: Sequence[Phase], attitudes: Sequence[Attitude], *, heated: bool) -> str:
    """What was done: heating, turn-on, tumble, motion, static, the first that fits."""
    names = [phase.name for phase in phases]
    if heated:
        return "heating"
    if any(name.startswith("run ") for name in names):
        return "turn-on"
    if _sides(phases, attitudes) > 1:
        return "tumble"
    return "static" if all(is_at_rest(phase) for phase in phases) else "motion"


def _sides(phases: Sequence[Phase], attitudes: Sequence[Attitude]) -> int:
    """How many different attitudes there are."""
    ups = [attitude.up_box for attitude in attitudes] or [up_vector(phase.up) for phase in phases if phase.up]
    apart: list[Up] = []
    for up in ups:
        if all(np.dot(up, other) < _SAME_COSINE for other in apart):
            apart.append(up)
    return len(apart)


def temperature_notes(motion: LikeLog) -> list[str]:
    """A note, if no reference tells the temperature."""
    if motion.temperature_source == "nothing":
        return ["No reference tells the temperature: 25 degC is assumed all the time."]
    if motion.temperature_source == "chip":
        return [
            "No reference tells the temperature: it is taken from a chip's own thermometer, which may be some degrees "
            "off and is warmer than the air. So no thermometer is compared with another one."
        ]
    return []
