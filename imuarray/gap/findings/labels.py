"""Wrong labels: phases in which an axis other than the true one was noted as up.

All accelerometers measure the same direction up, whatever their biases. If most of them contradict the label in the
same way, the label is wrong and not the sensors. A single sensor that contradicts it has exchanged axes (`axis_error`).
So have several sensors that are rotated in every phase if another sensor agrees with the labels. Two sensors that are
read in each other's place for part of the time (`channel_swap`) contradict all labels of that time. Every phase is
tested separately, so that two exchanged faces are both detected.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv  # the inverse chi-squared distribution without the weight of scipy.stats

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.gap.findings.diagnosis import Cause, Interval
from imuarray.gap.model.base_model import headers_in
from imuarray.gap.recording.phases import attitudes_of, kind_of
from imuarray.gap.recording.recordings import Recording
from imuarray.gap.recording.turns import exchanges
from imuarray.gap.statistics.campaign import Campaign, LogSummary
from imuarray.gap.statistics.probes.level import mean
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.posed import PoseSequence
from imuarray.simulate.motion.stimulus import Motion

ALONG = 0.9
"""Least cosine of the angle between the measured force and the direction of the face on which the box lies (26
degrees). The cosine with any other face is then below 0.44.
"""

LEAST = 2
"""Fewest accelerometers that can contradict a label. A single one may itself be wrong, unless other phases determine
how it is mounted.
"""

_UP_AND_DOWN_G = 1.5
"""Least range of the readings of an axis, in g, that shows that it pointed up once and down once."""

_UPS = np.array([up_vector(up) for up in UP_AXES])


@dataclass(frozen=True)
class WrongLabel:
    """A phase of log number `log`, named `name`, as it was noted; `up` is the axis that was up in it.

    `readings_g` are the accelerometers' means (3,) in the box frame; `agree` names the accelerometers that measure
    `up`. `or_mounted`: one rotation of all accelerometers against the box would explain every label of the campaign as
    well.
    """

    log: int
    name: str
    phase: Phase
    up: str
    readings_g: Mapping[str, Floats]
    agree: tuple[str, ...]
    or_mounted: bool = False

    @property
    def noted_g(self) -> float:
        """Rms distance of the agreeing sensors from the noted face, in g. Each reading is scaled to 1 g, since a wrong
        range does not concern the label.
        """
        return self._rms_from_g(self.phase.up)

    @property
    def true_g(self) -> float:
        """Rms distance of the agreeing sensors from the face that they measure, in g."""
        return self._rms_from_g(self.up)

    @cached_property
    def remainder(self) -> float:
        """Share of the squared distance that remains with the right label, for readings scaled to 1 g."""
        return (self.true_g / self.noted_g) ** 2

    @property
    def probability(self) -> float:
        """Probability that the label is wrong.

        Under either label the errors of direction are normal with unknown variance, two for each accelerometer. The
        odds are the ratio of the distances to the power of the number of errors. A sensor that does not agree cancels
        one that does.
        """
        votes = 2 * len(self.agree) - len(self.readings_g)
        return float(1 / (1 + self.remainder**votes))

    @property
    def closed_ci95(self) -> Interval:
        """95 % interval of `1 - remainder`, from two normal errors of each agreeing accelerometer."""
        count = len(self.agree)
        low, high = (1 - self.remainder * count / float(gammaincinv(count, share)) for share in (0.025, 0.975))
        return low, high

    def _rms_from_g(self, up: str) -> float:
        readings = np.array([self.readings_g[name] for name in self.agree])
        difference = readings / np.linalg.norm(readings, axis=1)[:, None] - up_vector(up)
        return float(np.sqrt((difference**2).sum(axis=1).mean()))


def find_wrong_labels(recordings: Sequence[Recording], campaign: Campaign) -> tuple[WrongLabel, ...]:
    """Return the phases at rest in which the wrong face is noted. `campaign` has the summaries of the recordings, one
    log for each, of whole phases or of parts of them.

    A noted face is wrong if the median over the accelerometers of their means, by nominal axes and sensitivity, is
    along another face, and more than half of at least two accelerometers measure that face. A single accelerometer is
    trusted if it agrees with faces along two axes, which determine how it is mounted, and with more labels than it
    contradicts.

    Sensors may also be mounted differently than configured, for example two with exchanged wires. Such a sensor is
    rotated equally in every phase, while another agrees with the notes. Or two of one kind are read in each other's
    place for a part of the time; each then agrees with the notes in the other's place. The hypothesis with the fewest
    faults of labels and sensors is accepted.
    """
    noted = [
        _LabelledPhase(number, recording.name, phase, readings)
        for number, (recording, log) in enumerate(zip(recordings, campaign.logs, strict=True))
        for phase in recording.phases
        if phase.up and (readings := _readings_g(log, phase))
    ]
    noted = _without_biases(noted)
    plain, turned = _check_labels(noted, {}), _check_labels(noted, _rotations_of(noted))
    likelier = turned if turned.faults <= plain.faults else plain
    if likelier.wrong and _faults_of_exchange(noted, headers_in(campaign)) < likelier.faults:
        return ()
    wrong = likelier.wrong
    ups = {(label.log, label.phase): label.up for label in wrong}
    labels = [(item.phase.up, ups.get((item.log, item.phase), item.phase.up)) for item in noted]
    or_mounted = bool(wrong) and any(_is_consistent(turn, labels) for turn in _rotations())
    return tuple(replace(label, or_mounted=or_mounted) for label in wrong)


def face_of(force: Floats) -> str:
    """Return the box axis ("+X") from which a force (3,) differs by less than 26 degrees; "" without one."""
    length = float(np.linalg.norm(force))
    cosines = _UPS @ force / length if length > 0 else np.zeros(len(_UPS))
    best = int(np.argmax(cosines))
    return UP_AXES[best] if cosines[best] > ALONG else ""


def correct_labels(recordings: Sequence[Recording], wrong: Sequence[WrongLabel]) -> tuple[Recording, ...]:
    """Return the recordings with corrected labels in phases, kind and motion. Phases keep their names, and a motion
    that follows the log's own track is kept.
    """
    return tuple(
        _with_labels(recording, log_labels)
        if (log_labels := [label for label in wrong if label.log == number])
        else recording
        for number, recording in enumerate(recordings)
    )


def cause_of(label: WrongLabel, sensors: Sequence[str] = ()) -> Cause:
    """Return a wrong label as a cause, `face_error`, of `sensors` or of the accelerometers that were read in the phase.

    It closes the share of the accelerometers' squared distance from the face that the right label removes.
    """
    parameters = {"log": label.name, "phase": label.phase.name, "noted": label.phase.up, "true": label.up}
    return Cause(
        "face_error",
        "add",
        tuple(sensors) or tuple(label.readings_g),
        (),
        label.probability,
        parameters,
        1 - label.remainder,
        label.closed_ci95,
        ("axis_error",) if label.or_mounted else (),
        "metadata",
    )


def note_of(label: WrongLabel) -> str:
    """Return a sentence about a wrong label."""
    return (
        f"{label.name}: phase {label.phase.name!r} is noted with {label.phase.up} up, but {len(label.agree)} of "
        f"{len(label.readings_g)} accelerometers measure {label.up} up: {label.noted_g:.2g} g from the noted face, "
        f"{label.true_g:.2g} g from that one. {label.up} is used."
    )


def _readings_g(log: LogSummary, phase: Phase) -> dict[str, Floats]:
    """Return the means (3,) of the accelerometers over all summarised parts of a phase, in g, box frame, by name."""
    sums: dict[str, Floats] = {}
    rows: dict[str, int] = {}
    for part in log.phases:
        if part.phase.start_ns < phase.start_ns or part.phase.end_ns > phase.end_ns:
            continue
        for name, summary in part.sensors.items():
            if summary.header.quantity == "specific_force" and summary.rows:
                turned = np.array(summary.header.orientation) @ mean(summary)
                sums[name] = sums.get(name, np.zeros(3)) + summary.rows * turned
                rows[name] = rows.get(name, 0) + summary.rows
    return {name: total / rows[name] for name, total in sums.items()}


class _LabelledPhase(NamedTuple):
    """A phase with a noted face, and the accelerometers' means (3,) in it, in the box frame."""

    log: int
    name: str
    phase: Phase
    readings_g: Mapping[str, Floats]


def _without_biases(noted: Sequence[_LabelledPhase]) -> list[_LabelledPhase]:
    """Return the phases with each sensor's bias removed from its readings, along axes that pointed up and down. The
    noted faces are not used.
    """
    biases: dict[str, Floats] = {}
    for sensor in dict.fromkeys(name for item in noted for name in item.readings_g):
        readings = np.array([item.readings_g[sensor] for item in noted if sensor in item.readings_g])
        high, low = readings.max(axis=0), readings.min(axis=0)
        biases[sensor] = np.where(high - low > _UP_AND_DOWN_G, (high + low) / 2, 0.0)
    return [
        item._replace(readings_g={sensor: reading - biases[sensor] for sensor, reading in item.readings_g.items()})
        for item in noted
    ]


class _LabelCheck(NamedTuple):
    """Wrong labels, and the number of faults of labels and sensors if they are wrong."""

    wrong: tuple[WrongLabel, ...]
    faults: int


def _check_labels(noted: Sequence[_LabelledPhase], turns: Mapping[str, Floats]) -> _LabelCheck:
    """Return the wrong labels if some sensors' axes are rotated by `turns` (3, 3) against the configuration. Faults are
    these sensors, the wrong labels, and sensors that measure a face other than the true one.
    """
    wrong, odd = [], set(turns)
    mountings = _known_mountings(noted)
    for log, name, phase, readings_g in noted:
        readings = {
            sensor: turns[sensor].T @ reading if sensor in turns else reading for sensor, reading in readings_g.items()
        }
        up = face_of(np.median(list(readings.values()), axis=0))
        agree = tuple(sensor for sensor, reading in readings.items() if up and face_of(reading) == up)
        is_believed = len(readings) >= LEAST or mountings.issuperset(readings)
        is_wrong = up not in ("", phase.up) and is_believed and 2 * len(agree) > len(readings)
        if is_wrong:
            wrong.append(WrongLabel(log, name, phase, up, readings, agree))
        true = up if is_wrong else phase.up
        odd |= {sensor for sensor, reading in readings.items() if face_of(reading) not in ("", true)}
    return _LabelCheck(tuple(wrong), len(wrong) + len(odd))


def _known_mountings(noted: Sequence[_LabelledPhase]) -> set[str]:
    """Return the sensors with a known mounting: they agree with noted faces along two axes, and with more labels than
    they contradict.
    """
    agreed: dict[str, list[str]] = {}
    contradicted: dict[str, int] = {}
    for item in noted:
        for sensor, reading in item.readings_g.items():
            face = face_of(reading)
            if face == item.phase.up:
                agreed.setdefault(sensor, []).append(face)
            elif face:
                contradicted[sensor] = contradicted.get(sensor, 0) + 1
    return {
        sensor
        for sensor, faces in agreed.items()
        if len({face[1:] for face in faces}) > 1 and len(faces) > contradicted.get(sensor, 0)
    }


def _faults_of_exchange(noted: Sequence[_LabelledPhase], headers: Mapping[str, SensorHeader]) -> float:
    """Return the number of faults if the labels are right and two sensors of one chip and sensitivity are read in each
    other's place for a part of the time: these two, and other sensors that measure a face other than the noted one.
    Infinite without such a pair.
    """
    names = dict.fromkeys(name for item in noted for name in item.readings_g)
    odd = {
        name
        for item in noted
        for name, reading in item.readings_g.items()
        if face_of(reading) not in ("", item.phase.up)
    }
    pairs = (
        {first, other}
        for first, other in combinations(names, 2)
        if (headers[first].chip, headers[first].sensitivity) == (headers[other].chip, headers[other].sensitivity)
        and _is_exchange(noted, headers[first], headers[other])
    )
    return min((len(pair | odd) for pair in pairs), default=math.inf)


def _is_exchange(noted: Sequence[_LabelledPhase], first: SensorHeader, other: SensorHeader) -> bool:
    """Return whether two sensors agree with the noted face in every phase, either as themselves or as each other, and
    are exchanged at most once in a log.
    """
    turn = np.array(first.orientation) @ np.array(other.orientation).T  # from the other's rows to the first's
    states: dict[int, list[bool]] = {}
    for item in noted:
        if not {first.name, other.name} <= set(item.readings_g):
            continue
        reading, other_reading = item.readings_g[first.name], item.readings_g[other.name]
        as_noted = {face_of(reading), face_of(other_reading)} == {item.phase.up}
        as_exchanged = {face_of(turn @ other_reading), face_of(turn.T @ reading)} == {item.phase.up}
        if not as_noted and not as_exchanged:
            return False
        if as_noted != as_exchanged:
            states.setdefault(item.log, []).append(as_exchanged)
    changes = (sum(a != b for a, b in pairwise(log_states)) for log_states in states.values())
    return max(changes, default=0) <= 1 and any(not all(log_states) for log_states in states.values())


def _rotations_of(noted: Sequence[_LabelledPhase]) -> dict[str, Floats]:
    """Return the rotation of each sensor with which it agrees with most of the noted faces, if it agrees with more of
    them than without. Empty if all sensors are rotated: only the labels then determine the direction up.
    """
    names = dict.fromkeys(name for item in noted for name in item.readings_g)
    turns = {name: turn for name in names if (turn := _rotation_of(noted, name)) is not None}
    return turns if len(turns) < len(names) else {}


def _rotation_of(noted: Sequence[_LabelledPhase], sensor: str) -> Floats | None:
    pairs = [(item.phase.up, face_of(item.readings_g[sensor])) for item in noted if sensor in item.readings_g]
    known = [(up, measured) for up, measured in pairs if measured]

    def fits(turn: Floats) -> int:
        return sum(_is_consistent(turn, [pair]) for pair in known)

    best = max((np.eye(3), *exchanges().values()), key=fits)
    return None if np.array_equal(best, np.eye(3)) else best


def _rotations() -> Iterator[Floats]:
    """Return the rotations (3, 3) that exchange axes; mirrored chips do not exist."""
    return (matrix for matrix in exchanges().values() if np.linalg.det(matrix) > 0)


def _is_consistent(turn: Floats, labels: Sequence[tuple[str, str]]) -> bool:
    """Return whether a rotation converts every noted face to the measured one."""
    return all(np.array_equal(turn @ up_vector(noted), up_vector(measured)) for noted, measured in labels)


def _with_labels(recording: Recording, wrong: Sequence[WrongLabel]) -> Recording:
    ups = {label.phase: label.up for label in wrong}
    phases = tuple(phase._replace(up=ups.get(phase, phase.up)) for phase in recording.phases)
    motion = recording.experiment.motion
    of_log = motion.surroundings if isinstance(motion, PoseSequence) else motion
    movements = motion.movements if isinstance(motion, PoseSequence) else ()
    attitudes = attitudes_of(recording.log, phases, of_log)[0] if isinstance(of_log, LikeLog) else ()
    lies: Motion = (
        PoseSequence(attitudes, of_log, of_log.fields, movements)
        if attitudes and isinstance(of_log, LikeLog)
        else motion
    )
    experiment = recording.experiment._replace(motion=lies)
    notes = (*recording.notes, *(note_of(label).partition(": ")[2] for label in wrong))
    kind = kind_of(phases, attitudes, heated=recording.kind == "heating")
    return replace(recording, kind=kind, phases=phases, experiment=experiment, notes=notes)
