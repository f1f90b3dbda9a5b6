"""Recorded logs in the form that the diagnosis needs: what was done in each, when each sensor was read, and the box's
attitudes.

Notes in a log are trusted: phases that name the axis that was up, and `/truth` or `/reference` for the motion. Without
them, static poses are detected and their attitudes estimated from the accelerometers
(`imuarray.gap.recording.attitude`), and a motion without a track is estimated from several sensors
(`imuarray.gap.recording.movement`). Each of these decisions becomes a note.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats, Reals, Times
from imuarray.characterise.processing import find_processing
from imuarray.errors import LogError
from imuarray.gap.recording.field import fields_of
from imuarray.gap.recording.phases import (
    attitudes_of,
    is_at_rest,
    is_heated,
    is_motion,
    kind_of,
    moves_by_track,
    phases_of,
    temperature_notes,
)
from imuarray.gap.recording.recorder_gaps import EARLY, RecorderGaps, recorder_gaps, usual_interval_ns
from imuarray.gap.recording.shared_stamps import add_lost_rows
from imuarray.gap.recording.source import RowFilter, Source, recorded_source
from imuarray.gap.recording.vibration import Vibration, vibrations_of
from imuarray.log import Log, SensorLog
from imuarray.log.format import LOST_BEFORE, Phase, SensorHeader
from imuarray.log.row_timing import RowTiming, even_rows, notes_of, row_timing
from imuarray.log.writer import Block
from imuarray.printable import counted, listed
from imuarray.simulate.converters import thermometer_of
from imuarray.simulate.host_latency import find_delays, lost_rows
from imuarray.simulate.motion.like import LikeLog, TemperatureSource
from imuarray.simulate.motion.posed import PoseSequence
from imuarray.simulate.motion.stimulus import Motion
from imuarray.simulate.simulation import Plan, plan_like
from imuarray.simulate.timeline import Timeline, filled
from imuarray.spelling import guess
from imuarray.units import SI_PER_UNIT, UNIT_OF

Temperature = Callable[[Times], Reals]
"""Function from times (n,) in ns to the reference temperature (n,) in degC, the same for all sensors."""


_DRIFT_SIGMAS, _DRIFT_ROWS, _LEAST_DRIFT_ROWS = 8.0, 10_000, 16
"""A drift is detected if the means of an axis in sections of a phase at rest differ by this number of standard errors
of a difference. Then the largest and the smallest number of rows of a section that are used.
"""

_PARTS = 8
"""Number of parts of a section. The differences of their means show whether the noise is correlated over time."""

_OTHER_COURSE = 0.2
"""Largest deviation of two axes from a common course, as a share of the smaller drift, at which both follow one
temperature. Thermal lags and curved slopes cause small deviations.
"""

_SECTIONS, _STEP_SHARE = 24, 0.8
"""Number of sections of a phase, and the share of its total change within two sections above which it is a step, not a
drift: a change of temperature takes a time constant.
"""


UNREFERENCED: Collection[TemperatureSource] = ("chip", "nothing")
"""Sources of a temperature that is not a reference: the chips' own thermometers, and an assumed value."""


CHIP_LEAD_S = 5.0
"""Time constant, in s, with which a chip's own thermometer usually follows the temperature of the box. In a heated log
without a reference temperature, the box is assumed to have the temperature that this thermometer follows with this lag.
Elements that respond faster than the chip then have a positive lag too. The value is used where readings determine
none.
"""

_SETTLING, _MOST_SETTLING = 5.0, 1000
"""Number of time constants of its filter in which a chip settles after power-on, and the largest number of rows that
are left out for it.
"""


class LogReference(NamedTuple):
    """The references of a log: the `temperature`; the `track` of an instrument's motion; `turned`, the motion that
    the array's own sensors show between attitudes; and a function that returns the quantities with changes in a phase
    that the rows leave `unresolved`.
    """

    temperature: Temperature
    track: Motion | None = None
    turned: PoseSequence | None = None
    unresolved: Callable[[Phase], tuple[str, ...]] = lambda _: ()


class Experiment(NamedTuple):
    """The plan of one log (which sensors were read when) and the motion of the box.

    `uncertain_ns`: by sensor the times (u,) of rows that are not compared, because they were read at an unknown time
    (`imuarray.gap.recording.recorder_gaps`), the box was touched, or the chip's filter had not settled.
    `has_temperature`: whether the log has a reference temperature; without one, the box may still have been heated
    (`is_heated`). `vibrations`: those of the surroundings at rest.
    """

    plan: Plan
    motion: Motion
    uncertain_ns: Mapping[str, Times] = {}
    has_temperature: bool = True
    is_heated: bool = False
    vibrations: tuple[Vibration, ...] = ()

    def comparable_rows(self, name: str, source: Source) -> Source:
        """Return the rows of a sensor, recorded or simulated, without the rows at uncertain times."""
        return RowFilter(source, self.uncertain_ns[name]) if name in self.uncertain_ns else source


@dataclass(frozen=True)
class Recording:
    """A recorded log with the name of its file; the log stays open.

    `kind` is what was done (static, tumble, heating, turn-on, motion), `phases` are the stretches that are compared,
    `experiment` is what a simulation of the log needs, lost rows included, `notes` say what was assumed or left out,
    `gap_ends_ns` has by sensor the times of the first rows after gaps of the recorder. `is_shaken`: all of its sensors
    are on a box that is shaken in every phase at rest. `unresolved`: by phase the quantities with changes in a motion
    that the rows do not resolve.
    """

    name: str
    log: Log
    kind: str
    phases: tuple[Phase, ...]
    experiment: Experiment
    notes: tuple[str, ...] = ()
    gap_ends_ns: Mapping[str, Times] = field(default_factory=dict)
    is_shaken: bool = False
    unresolved: Mapping[Phase, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def temperature_source(self) -> TemperatureSource:
        """The source of the reference temperature."""
        return LikeLog(self.log).temperature_source

    @property
    def has_reference_temperature(self) -> bool:
        """True if the temperature has another source than the chips' own thermometers or an assumption."""
        return self.temperature_source not in UNREFERENCED


def recording_of(log: Log, only: Collection[str] = ()) -> Recording:
    """Read one log: all its triads, or only those named in `only`.

    Raises LogError for a sensor that the log does not have, and for a log in which nothing can be compared.
    """
    chosen, left_out = _chosen_sensors(log, only)
    chosen, processed = _without_processed(log, chosen)
    motion = LikeLog(log)
    comparable = phases_of(log, motion, chosen)
    phases, movements = comparable.phases, comparable.movements
    is_shaken = all(log[name].quantity in comparable.shaken for name in chosen)
    chosen, shaken_notes = _without_shaken(log, chosen, comparable.shaken)
    heated = is_heated(phases, motion)
    tracked = phases if motion.source != "phases" else tuple(filter(is_at_rest, phases))
    chosen, unknown = _without_unknown_field(log, chosen, tracked, heated=heated)
    plan = plan_like(log, chosen)
    timings = {name: row_timing(log[name]) for name in plan.sensors}
    gaps = _timelines(log, timings)
    is_compared = motion.temperature_source != "chip"
    sensors = {
        name: (_with_comparable_thermometer(header, is_compared), gaps.lines[name])
        for name, (header, _) in plan.sensors.items()
    }
    attitudes, assumed = attitudes_of(log, phases, motion)
    notes = (
        *left_out,
        *processed,
        *unknown,
        *comparable.notes,
        *shaken_notes,
        *assumed,
        *temperature_notes(motion),
        *notes_of(timings.items()),
    )
    notes = (*notes, *([gaps.note] if gaps.note else []))
    fields = fields_of([log[name] for name in chosen], phases)
    lead_s = CHIP_LEAD_S if heated and motion.temperature_source == "chip" else 0.0
    motion = replace(motion, fields=fields, rests=_rests_of(phases, motion), lead_s=lead_s)
    is_posed = movements or any(attitude.estimated for attitude in attitudes)
    posed = PoseSequence(attitudes, motion, fields, movements) if is_posed and attitudes else motion
    has_temperature = motion.temperature_source not in UNREFERENCED
    uncertain_ns = {}
    for name, (header, line) in sensors.items():
        times_ns = [_settling_ns(header, line), *(_times_within(log[name], span) for span in comparable.restless)]
        if name in gaps.uncertain_ns:
            times_ns.append(gaps.uncertain_ns[name])
        if any(map(len, times_ns)):
            uncertain_ns[name] = np.unique(np.concatenate(times_ns))
    experiment = Experiment(replace(plan, sensors=sensors), posed, uncertain_ns, has_temperature)
    kind = kind_of(phases, attitudes, heated=heated)
    return Recording(
        log.path.name, log, kind, phases, experiment, notes, gaps.ends_ns, is_shaken, comparable.unresolved
    )


def recordings_of(logs: Sequence[Log], only: Collection[str] = ()) -> tuple[Recording, ...]:
    """Read several logs of one array, in the order of recording if all of them have a date.

    A sensor that a log lacks is left out there, with a note. Raises LogError for a sensor that no log has, for a sensor
    that is configured differently in another log, and for a log without a sensor in common with the others.
    """
    recordings: list[Recording] = []
    first: dict[str, SensorLog] = {}
    if all(log.epoch for log in logs):
        logs = sorted(logs, key=lambda log: log.epoch)
    names = dict.fromkeys(only or (name for log in logs for name, sensor in log.sensors.items() if sensor.is_triad))
    for name in names:
        if not any(name in log.sensors for log in logs):
            known = {sensor for log in logs for sensor in log.sensors}
            raise LogError(f"{logs[0].path}: no sensor {name!r}, nor in any other log{guess(name, known)}")
    _refuse_two_arrays(logs)
    for log in logs:
        here = [name for name in names if name in log.sensors and len(log[name])]
        for name in here:
            _refuse_other_configuration(first.setdefault(name, log[name]), log[name])
        if not here:
            raise LogError(f"{log.path}: none of the sensors {', '.join(names)} was read in it")
        recording = recording_of(log, here)
        lacking = tuple(f"{name} is left out: it was not read in this log." for name in names if name not in here)
        recordings.append(replace(recording, notes=(*lacking, *recording.notes)))
    return _with_vibrations(_without_unknown_temperature(_without_shaken_logs(recordings)))


def _with_vibrations(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the recordings with the vibrations of the surroundings, and with notes on them."""
    sensors = [{name: recording.log[name] for name in recording.experiment.plan.sensors} for recording in recordings]
    rests = [[phase for phase in recording.phases if is_at_rest(phase)] for recording in recordings]
    uncertain_ns = [recording.experiment.uncertain_ns for recording in recordings]
    return tuple(
        replace(
            recording,
            experiment=recording.experiment._replace(vibrations=vibrations),
            notes=(*recording.notes, *_vibration_notes(vibrations)),
        )
        for recording, vibrations in zip(recordings, vibrations_of(sensors, rests, uncertain_ns), strict=True)
    )


def _vibration_notes(vibrations: Sequence[Vibration]) -> Iterator[str]:
    """Yield a note for each quantity with vibrations of the surroundings: the largest root mean square of an axis."""
    for quantity in dict.fromkeys(vibration.quantity for vibration in vibrations):
        of_quantity = [vibration for vibration in vibrations if vibration.quantity == quantity]
        rms_si = math.sqrt(max(float(vibration.autocovariance(0.0).max()) for vibration in of_quantity))
        rms = rms_si / SI_PER_UNIT[UNIT_OF[quantity]]
        size = f"{1e3 * rms:.2g} mg" if quantity == "specific_force" else f"{rms:.2g} dps"
        yield f"The surroundings vibrate at rest, by up to {size} (rms) along an axis; simulations do too."


def _without_shaken_logs(recordings: Sequence[Recording]) -> Sequence[Recording]:
    """Return the recordings without those in which the box is shaken in every phase at rest, or all if it always is."""
    calm = [recording for recording in recordings if not recording.is_shaken]
    if not calm or len(calm) == len(recordings):
        return recordings
    why = "the box is shaken in every phase at rest, as its sensors show"
    notes = [f"{recording.name} is left out: {why}." for recording in recordings if recording.is_shaken]
    return (replace(calm[0], notes=(*notes, *calm[0].notes)), *calm[1:])


def _without_unknown_temperature(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return the recordings without those that were heated while no temperature was recorded, whether noted or
    detected. If none remains, return all of them, marked as heated by an unknown course of temperature.
    """
    known: list[Recording] = []
    notes: list[str] = []
    for recording in recordings:
        if recording.temperature_source != "nothing":
            known.append(recording)
        elif recording.kind == "heating":
            notes.append(f"{recording.name} is left out: the box is heated and no temperature is recorded.")
        elif drifts_together(recording):
            why = "most sensors drift at the same time, as in the heat, and no temperature is recorded"
            notes.append(f"{recording.name} is left out: {why}.")
        else:
            known.append(recording)
    if not known:
        note = "The box is heated and no temperature is recorded: biases may change as in any heating."
        return tuple(
            replace(each, experiment=each.experiment._replace(is_heated=True), notes=(note, *each.notes))
            for each in recordings
        )
    if not notes:
        return tuple(recordings)
    return (replace(known[0], notes=(*notes, *known[0].notes)), *known[1:])


def drifts_together(recording: Recording) -> bool:
    """Return whether most sensors drift by many standard errors in the same phase at rest or, if only one sensor was
    read, whether two of its axes drift along one course.
    """
    sensors = [recording.log[name] for name in recording.experiment.plan.sensors]
    for phase in filter(is_at_rest, recording.phases):
        drifting = [means for sensor in sensors if (means := _drifting_axes(sensor, phase)).size]
        if len(sensors) > 1 and len(drifting) > max(1, len(sensors) / 2):
            return True
        if len(sensors) == 1 and drifting and len(drifting[0]) > 1 and _follows_one_course(drifting[0]):
            return True
    return False


def _follows_one_course(means: Floats) -> bool:
    """Return whether the means (k, s) of k axes in s sections, in standard errors, are multiples of one course within
    chance.
    """
    _, second, *_ = np.linalg.svd(means - means.mean(axis=1, keepdims=True), compute_uv=False)
    return bool(second < max(_OTHER_COURSE * np.ptp(means, axis=1).min(), math.sqrt(2 * means.shape[1])))


def _drifting_axes(sensor: SensorLog, phase: Phase) -> Floats:
    """Return the means (k, s), in standard errors, of the k axes that drift in s sections of a phase. A drift is a
    difference of many standard errors that is not a step. Without enough rows, no axis is returned.
    """
    edges_ns = np.linspace(phase.start_ns, phase.end_ns, _SECTIONS + 1).astype(np.int64).tolist()
    sections = [np.asarray(sensor.counts[sensor.between(*ends)][:_DRIFT_ROWS], float) for ends in pairwise(edges_ns)]
    if min(map(len, sections)) < _LEAST_DRIFT_ROWS:
        return np.zeros((0, _SECTIONS))
    means = np.array([section.mean(axis=0) for section in sections]).T
    variances = [_variance_of_mean(section) for section in sections]
    means /= np.sqrt(np.mean(variances, axis=0))[:, None]
    size = np.ptp(means, axis=1)
    is_step = np.abs(means[:, 2:] - means[:, :-2]).max(axis=1) > _STEP_SHARE * size
    return np.asarray(means[(size > _DRIFT_SIGMAS * math.sqrt(2)) & ~is_step])


def _variance_of_mean(section: Floats) -> Floats:
    """Return the variance (3,) of the mean of readings (n, 3), estimated from neighbouring readings, or from the means
    of neighbouring parts if that is larger because the noise is correlated over time.
    """
    white = np.maximum(np.diff(section, axis=0).var(axis=0) / 2, 1 / 12) / len(section)
    parts = np.array([part.mean(axis=0) for part in np.array_split(section, _PARTS)])
    return np.asarray(np.maximum(white, (np.diff(parts, axis=0) ** 2).mean(axis=0) / 2 / _PARTS))


def refuse_other_array(recordings: Sequence[Recording], earlier: Sequence[Recording]) -> None:
    """Raise LogError if the earlier recordings are of another array: it has no sensor in common, or its sensors are
    configured differently.
    """
    sensors = {name: recording.log[name] for recording in earlier for name in recording.experiment.plan.sensors}
    for recording in recordings:
        shared = [name for name in recording.experiment.plan.sensors if name in sensors]
        for name in shared:
            _refuse_other_configuration(sensors[name], recording.log[name])
        if not shared:
            first = earlier[0].log.path
            raise LogError(
                f"{recording.log.path}: no sensor in common with {first}: earlier logs are of the same array"
            )


def temperature_of(motion: Motion) -> Temperature:
    """Return the reference temperature of a motion, as a function of time."""

    def temperature(time_ns: Times) -> Floats:
        return np.asarray(motion.stimulus(time_ns).temperature_degc, float)

    return temperature


def reference_of(motion: Motion) -> LogReference:
    """Return the temperature of a motion, and the motion itself if it is a log's track or a sequence of attitudes."""
    is_tracked = isinstance(motion, LikeLog) and motion.source != "phases"
    turned = motion if isinstance(motion, PoseSequence) else None
    return LogReference(temperature_of(motion), motion if is_tracked else None, turned)


def sources_of(recording: Recording) -> dict[str, Source]:
    """Return the rows of a recording's sensors in the form of a simulation.

    The counts of thermometers are removed if their scale is unknown or they are the only source of the temperature, and
    the flag of lost rows is removed after gaps of the recorder. Rows that arrived in bursts get the times at which they
    were read. The flag of lost rows is set after each gap in which rows were lost, as in a simulation that loses them,
    whether or not the recorder set it.
    """
    sources: dict[str, Source] = {}
    for name, (header, line) in recording.experiment.plan.sensors.items():
        source: Source = recorded_source(recording.log[name], line)
        gap_ends_ns = recording.gap_ends_ns.get(name, np.zeros(0, np.int64))
        loss_ends_ns = np.array([end_ns for _, end_ns, _ in lost_rows(line)], np.int64)
        if not recording.experiment.plan.flags & LOST_BEFORE:
            loss_ends_ns = loss_ends_ns[:0]
        early_ns = EARLY * usual_interval_ns(recording.log[name])
        source = _Comparable(source, header.has_temperature, gap_ends_ns, loss_ends_ns, early_ns)
        sources[name] = recording.experiment.comparable_rows(name, source)
    return sources


def _rests_of(phases: Sequence[Phase], motion: LikeLog) -> tuple[tuple[int, int], ...]:
    """Return the stretches, in ns, in which the box is at rest although the reference that is followed has noise."""
    if motion.source != "reference":
        return ()
    still = [phase for phase in phases if is_at_rest(phase) and not moves_by_track(phase, motion)]
    return tuple((phase.start_ns, phase.end_ns) for phase in still)


def _without_shaken(log: Log, sensors: Sequence[str], quantities: Collection[str]) -> tuple[list[str], list[str]]:
    """Return the sensors without those of quantities that are shaken in all phases at rest, with a note. If none would
    remain, all are kept.
    """
    shaken = [name for name in sensors if log[name].quantity in quantities]
    if not shaken or len(shaken) == len(sensors):
        return list(sensors), []
    why = "the box is shaken in every phase at rest, as they all show, so that their noise is not seen"
    return [name for name in sensors if name not in shaken], [f"{', '.join(shaken)} are left out: {why}."]


def _times_within(sensor: SensorLog, span_ns: tuple[int, int]) -> Times:
    """Return the times of a sensor's rows within a span (begin, end) in ns."""
    return np.asarray(sensor.time[sensor.between(*span_ns)], np.int64)


def _settling_ns(header: SensorHeader, line: Timeline) -> Times:
    """Return the times of the first rows of a log, in which the filter of a chip may still settle after power-on."""
    if header.bandwidth_hz <= 0 or not line.rows:
        return np.zeros(0, np.int64)
    settling_s = _SETTLING / (2 * math.pi * header.bandwidth_hz)
    first_ns = np.asarray(line.stamps(0, min(line.rows, _MOST_SETTLING)), np.int64)
    return first_ns[: np.searchsorted(first_ns, first_ns[0] + settling_s * 1e9)]


FEWEST_READINGS = 10
"""Fewest readings of a sensor at which it is compared: five for the fit and five for the check."""


class _Comparable:
    """A source without what can't be compared.

    Its thermometer's counts are removed unless it `has_temperature`. The flag of lost rows is removed from the rows at
    `gap_ends_ns` (k,) and set in those at `loss_ends_ns` (l,). It is also removed from rows that follow the row before
    by less than `early_ns`: a recorder that was delayed within a frame reports the frames that it missed with the next
    one.
    """

    def __init__(
        self, source: Source, has_temperature: bool, gap_ends_ns: Times, loss_ends_ns: Times, early_ns: float
    ) -> None:
        self.header = replace(source.header, has_temperature=source.header.has_temperature and has_temperature)
        self.cache: dict[Hashable, Any] = {}
        self._source = source
        self._gap_ends_ns, self._loss_ends_ns, self._early_ns = gap_ends_ns, loss_ends_ns, early_ns

    def rows(self, start_ns: int, end_ns: int) -> int:
        return self._source.rows(start_ns, end_ns)

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        last_ns = -1 << 62
        for block in self._source.blocks(start_ns, end_ns):
            temperature = block.temperature_counts if self.header.has_temperature else None
            status = block.status.copy()
            is_early = np.diff(block.time, prepend=last_ns) < self._early_ns
            status[np.isin(block.time, self._gap_ends_ns) | is_early] &= np.uint16(~LOST_BEFORE & 0xFFFF)
            status[np.isin(block.time, self._loss_ends_ns)] |= np.uint16(LOST_BEFORE)
            last_ns = int(block.time[-1])
            yield block._replace(temperature_counts=temperature, status=status)


def _chosen_sensors(log: Log, only: Collection[str]) -> tuple[list[str], list[str]]:
    """Return the names of the sensors to compare, and notes on those left out."""
    sensors = [log[name] for name in only] or [sensor for sensor in log.sensors.values() if sensor.is_triad]
    for sensor in sensors:
        if not sensor.is_triad:
            raise LogError(f"{sensor.where}: {sensor.quantity} has no three axes; allowed are triads")
    notes = []
    for sensor in sensors:
        if not sensor.sensitivity:
            notes.append(f"{sensor.name} is left out: its sensitivity is not known.")
        elif len(sensor) < FEWEST_READINGS:
            notes.append(
                f"{sensor.name} is left out: it has {counted(len(sensor), 'reading')}, {FEWEST_READINGS} are required."
            )
    chosen = [sensor.name for sensor in sensors if sensor.sensitivity and len(sensor) >= FEWEST_READINGS]
    if not chosen:
        raise LogError(
            f"{log.path}: no sensor with three axes, a known sensitivity and at least {FEWEST_READINGS} readings"
        )
    return chosen, notes


def _without_processed(log: Log, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the sensors with readings as a chip gives them, and notes on those that a program processed. A simulated
    chip would differ from processed readings by the processing, and every cause would be false. Raises LogError if no
    sensor remains.
    """
    if log.source != "imported":
        return list(names), []
    processing = {name: texts for name in names if (texts := find_processing(log[name]))}
    kept = [name for name in names if name not in processing]
    names_of_text: dict[str, list[str]] = {}
    for name, texts in processing.items():
        names_of_text.setdefault("; ".join(texts), []).append(name)
    sentences = [f"{listed(group)}: {text}" for text, group in names_of_text.items()]
    if not kept:
        raise LogError(
            f"{log.path}: every sensor was processed, so a simulated chip would differ by that: {'; '.join(sentences)}."
            " Import raw readings; characterise and calibrate describe these"
        )
    return kept, [f"{sentence}. Left out: a simulated chip would differ by that." for sentence in sentences]


def _without_unknown_field(
    log: Log, names: Sequence[str], phases: Sequence[Phase], *, heated: bool
) -> tuple[list[str], list[str]]:
    """Return the sensors for which the input is known, and notes on the others.

    No log records the magnetic field while the box moves. The field is also unknown in a box that is heated on several
    faces, because a magnetometer's scale follows the temperature (HMC-57). Raises LogError if no sensor remains.
    """
    moves = any(map(is_motion, phases))
    if not moves and not (heated and len(phases) > 1):
        return list(names), []
    when = "while the box moves" if moves else "in a box that is heated on several faces"
    others = [name for name in names if log[name].quantity != "magnetic_field"]
    if not others:
        raise LogError(f"{log.path}: the magnetic field is not known {when}, and there is no other sensor")
    magnetometers = [name for name in names if name not in others]
    return others, [f"{name} is left out: the magnetic field is not known {when}." for name in magnetometers]


def _timelines(log: Log, timings: Mapping[str, RowTiming]) -> RecorderGaps:
    """Return the timelines of all sensors, with lost rows and delays of the host, and without the recorder's gaps."""
    steady: dict[str, Timeline] = {
        name: filled(log[name]) for name, timing in timings.items() if timing.kind != "bursts"
    }
    even: dict[str, Timeline] = {name: even_rows(log[name]) for name in timings if name not in steady}
    gaps = recorder_gaps(log, add_lost_rows(log, steady))
    lines = find_delays(gaps.lines, log.sensors) if steady else {}
    return replace(gaps, lines={**lines, **add_lost_rows(log, even)})


def _refuse_two_arrays(logs: Sequence[Log]) -> None:
    """Raise LogError for a log that has no triad in common with another log."""
    triads = [{name for name, sensor in log.sensors.items() if sensor.is_triad} for log in logs]
    for at, (log, names) in enumerate(zip(logs, triads, strict=True)):
        others = set().union(*triads[:at], *triads[at + 1 :])
        if len(logs) > 1 and not names & others:
            rest = logs[0 if at else 1].path
            raise LogError(
                f"{log.path}: no sensor in common with {rest}: logs of different arrays are diagnosed separately"
            )


def _refuse_other_configuration(first: SensorLog, other: SensorLog) -> None:
    """Raise LogError if a sensor is configured differently in two logs."""
    for name in ("chip", "quantity", "unit", "range", "sensitivity", "axes"):
        if (here := getattr(other, name)) != (there := getattr(first, name)):
            raise LogError(f"{other.where}: {name} is {here}, but {there} in {first.where}")


def _with_comparable_thermometer(header: SensorHeader, is_compared: bool) -> SensorHeader:
    """Return the header without its thermometer if the scale is unknown or the thermometer can't be compared."""
    return replace(header, has_temperature=is_compared and thermometer_of(header) is not None)
