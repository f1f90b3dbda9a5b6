"""Faces that were noted wrongly: a phase that says which axis was up while the box lay on another side.

All accelerometers feel the same direction up, whatever bias each has. Where most of them contradict the label, and all
alike, the label is wrong and not the sensors; a single one that contradicts it has its own axes exchanged
(`axis_error`), and so have several that are turned in every phase beside one that is as noted. Every phase is told by
itself, so two faces that were noted in each other's place are both found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.gap.findings.diagnosis import Cause, Interval
from imuarray.gap.inference.effects.axis_error import exchanges
from imuarray.gap.recording.phases import attitudes_of, kind_of
from imuarray.gap.recording.recordings import Experiment, Recording
from imuarray.gap.statistics.campaign import Campaign, LogSummary
from imuarray.gap.statistics.probes.level import mean
from imuarray.log.format import Phase
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.like import LikeLog
from imuarray.simulate.motion.posed import Posed

ALONG = 0.9
"""Cosine between what is felt and a face from which on the box lies on that face, 26 degrees from it: the cosine with
any other face is then below 0.44."""

LEAST = 2
"""A single accelerometer that contradicts a label may be the one that is wrong."""

_UPS = np.array([up_vector(up) for up in UP_AXES])


@dataclass(frozen=True)
class WrongLabel:
    """A phase of log number `log`, named `name`, as it was noted; `up` is the axis that was up in it.

    `readings_g` are the accelerometers' means, (3,) in the box frame; `agree` names those that feel `up` themselves.
    `or_mounted`: one turn of all accelerometers against the box would explain every label of the campaign as well.
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
        """How far those that agree read from the noted face (rms), each scaled to 1 g: a wrong range is no matter of
        the label.
        """
        return self._off_g(self.phase.up)

    @property
    def true_g(self) -> float:
        """The same from the face that they feel."""
        return self._off_g(self.up)

    @cached_property
    def left(self) -> float:
        """Share of the squared distance that the right label leaves; of readings scaled to 1 g."""
        return (self.true_g / self.noted_g) ** 2

    @property
    def probability(self) -> float:
        """Of the label being wrong. Under either label errors of direction are normal, two for each accelerometer, of a
        size that nobody knows: the odds are the ratio of distances to the power of their number, and who does not agree
        takes away as much as another one gives.
        """
        votes = 2 * len(self.agree) - len(self.readings_g)
        return float(1 / (1 + self.left**votes))

    @property
    def closed_ci95(self) -> Interval:
        """Of `1 - left`, from the scatter of two normal errors of each accelerometer that agrees."""
        free = 2 * len(self.agree)
        low, high = (1 - self.left * free / float(chi2.ppf(share, free)) for share in (0.025, 0.975))
        return low, high

    def _off_g(self, up: str) -> float:
        found = np.array([self.readings_g[name] for name in self.agree])
        apart = found / np.linalg.norm(found, axis=1)[:, None] - up_vector(up)
        return float(np.sqrt((apart**2).sum(axis=1).mean()))


def mislabelled(recordings: Sequence[Recording], campaign: Campaign) -> tuple[WrongLabel, ...]:
    """The phases at rest whose noted face is wrong. `campaign` has the recordings' summaries, one log for each, of
    whole phases or of parts of them.

    What the accelerometers feel together, the median over them of their mean by nominal axes and sensitivity, lies
    along another face than the noted one, and more than half of at least two feel that face themselves. With fewer
    accelerometers nothing is found.

    Sensors may lie otherwise than configured as well, two whose wires are crossed for one. Each is then turned alike in
    every phase, while one that isn't feels what was noted: what needs fewer faults, of labels and sensors, is taken.
    """
    noted = [
        _Noted(number, recording.name, phase, readings)
        for number, (recording, log) in enumerate(zip(recordings, campaign.logs, strict=True))
        for phase in recording.phases
        if phase.up and (readings := _readings_g(log, phase))
    ]
    plain, turned = _told(noted, {}), _told(noted, _turns_of(noted))
    found = turned.wrong if turned.faults <= plain.faults else plain.wrong
    ups = {(one.log, one.phase): one.up for one in found}
    labels = [(one.phase.up, ups.get((one.log, one.phase), one.phase.up)) for one in noted]
    or_mounted = bool(found) and any(_explains(turn, labels) for turn in _turns())
    return tuple(replace(one, or_mounted=or_mounted) for one in found)


def face_of(force: Floats) -> str:
    """The box axis ("+X") along which a force (3,) lies within 26 degrees, "" for none."""
    length = float(np.linalg.norm(force))
    cosines = _UPS @ force / length if length > 0 else np.zeros(len(_UPS))
    best = int(np.argmax(cosines))
    return UP_AXES[best] if cosines[best] > ALONG else ""


def corrected(recordings: Sequence[Recording], found: Sequence[WrongLabel]) -> tuple[Recording, ...]:
    """The recordings with their labels put right, in phases, kind and motion; phases keep their names. A motion that
    follows the log's own track stays.
    """
    return tuple(
        _relabelled(recording, own) if (own := [one for one in found if one.log == number]) else recording
        for number, recording in enumerate(recordings)
    )


def cause_of(found: WrongLabel, sensors: Sequence[str] = ()) -> Cause:
    """A wrong label as a cause, `face_error`; of `sensors`, or of the accelerometers that were read in the phase.

    `closed` is the share of the accelerometers' squared distance from the face that goes with the label.
    """
    parameters = {"log": found.name, "phase": found.phase.name, "noted": found.phase.up, "true": found.up}
    return Cause(
        "face_error",
        "add",
        tuple(sensors) or tuple(found.readings_g),
        (),
        found.probability,
        parameters,
        1 - found.left,
        found.closed_ci95,
        ("axis_error",) if found.or_mounted else (),
        "metadata",
    )


def note_of(found: WrongLabel) -> str:
    """A wrong label in a sentence."""
    return (
        f"{found.name}: phase {found.phase.name!r} is noted with {found.phase.up} up, but {len(found.agree)} of "
        f"{len(found.readings_g)} accelerometers feel {found.up}: {found.noted_g:.2g} g from the noted face, "
        f"{found.true_g:.2g} g from that one. It is taken as {found.up}."
    )


def _readings_g(log: LogSummary, phase: Phase) -> dict[str, Floats]:
    """Means of the accelerometers in all that is summarised of a phase, (3,) in the box frame, by name."""
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


class _Noted(NamedTuple):
    """A phase whose face was noted, and the accelerometers' means in it, (3,) in the box frame."""

    log: int
    name: str
    phase: Phase
    readings_g: Mapping[str, Floats]


class _Told(NamedTuple):
    """Labels that are wrong, and how many faults of labels and sensors there are with them."""

    wrong: tuple[WrongLabel, ...]
    faults: int


def _told(noted: Sequence[_Noted], turns: Mapping[str, Floats]) -> _Told:
    """What is wrong if some sensors' axes are `turns` (3, 3) of what is configured. At fault are these, and who feels
    another face than the one that is taken for true.
    """
    wrong, odd = [], set(turns)
    for log, name, phase, readings_g in noted:
        readings = {one: turns[one].T @ read if one in turns else read for one, read in readings_g.items()}
        up = face_of(np.median(list(readings.values()), axis=0))
        agree = tuple(one for one, read in readings.items() if up and face_of(read) == up)
        is_wrong = up not in ("", phase.up) and len(readings) >= LEAST and 2 * len(agree) > len(readings)
        if is_wrong:
            wrong.append(WrongLabel(log, name, phase, up, readings, agree))
        true = up if is_wrong else phase.up
        odd |= {one for one, read in readings.items() if face_of(read) not in ("", true)}
    return _Told(tuple(wrong), len(wrong) + len(odd))


def _turns_of(noted: Sequence[_Noted]) -> dict[str, Floats]:
    """The turn of each sensor by which it feels most of the faces as noted, where those are more than without one; none
    if no sensor is left that isn't turned: nothing but the labels then tells which way is up.
    """
    names = dict.fromkeys(name for one in noted for name in one.readings_g)
    turns = {name: turn for name in names if (turn := _turn_of(noted, name)) is not None}
    return turns if len(turns) < len(names) else {}


def _turn_of(noted: Sequence[_Noted], sensor: str) -> Floats | None:
    pairs = [(one.phase.up, face_of(one.readings_g[sensor])) for one in noted if sensor in one.readings_g]
    known = [(up, felt) for up, felt in pairs if felt]

    def fits(turn: Floats) -> int:
        return sum(_explains(turn, [pair]) for pair in known)

    best = max((np.eye(3), *exchanges().values()), key=fits)
    return None if np.array_equal(best, np.eye(3)) else best


def _turns() -> Iterator[Floats]:
    """The turns (3, 3) of a chip that exchange axes; no chip is mirrored."""
    return (matrix for matrix in exchanges().values() if np.linalg.det(matrix) > 0)


def _explains(turn: Floats, labels: Sequence[tuple[str, str]]) -> bool:
    """Whether a turn takes every noted face to the one that was felt."""
    return all(np.array_equal(turn @ up_vector(noted), up_vector(felt)) for noted, felt in labels)


def _relabelled(recording: Recording, found: Sequence[WrongLabel]) -> Recording:
    ups = {one.phase: one.up for one in found}
    phases = tuple(phase._replace(up=ups.get(phase, phase.up)) for phase in recording.phases)
    motion = recording.experiment.motion
    of_log = motion.surroundings if isinstance(motion, Posed) else motion
    attitudes = attitudes_of(recording.log, phases, of_log)[0] if isinstance(of_log, LikeLog) else ()
    lies: Motion = Posed(attitudes, of_log, of_log.fields) if attitudes and isinstance(of_log, LikeLog) else motion
    experiment = Experiment(recording.experiment.plan, lies)
    notes = (*recording.notes, *(note_of(one).partition(": ")[2] for one in found))
    kind = kind_of(phases, attitudes, heated=recording.kind == "heating")
    return replace(recording, kind=kind, phases=phases, experiment=experiment, notes=notes)
