"""Many short logs as runs: what each sensor read in each, how warm it was, and how its reading wandered meanwhile."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from imuarray.axes import up_vector
from imuarray.calibrate.correlated import MeanVariance, mean_of_series
from imuarray.calibrate.segments import Segments, segment_means, thermometer_of
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.log.format import Phase

Floats = npt.NDArray[np.float64]

_SEGMENTS = 60
"""A run is looked at in so many parts."""

_RUN = re.compile(r"run (\d{1,6})")


@dataclass(frozen=True)
class Runs:
    """One sensor's runs: their numbers, mean counts (r, 3), temperatures (r,) in degC (None: not known) and the
    segments that the means are made of (none where only the means are known).

    `gravity_lsb` (3,): what gravity adds to the counts in the pose of the runs by the data sheet's scale; zeros for a
    gyroscope.
    """

    sensor: str
    quantity: str
    unit: str
    range: float
    sensitivity: float
    numbers: tuple[int, ...]
    mean_lsb: Floats
    temperature_degc: Floats | None = None
    segments: tuple[Segments, ...] = ()
    gravity_lsb: Floats = field(default_factory=lambda: np.zeros(3))

    def in_run(self, used: Sequence[int]) -> tuple[MeanVariance, ...]:
        """For each axis what the runs at `used` places say of the variance of a run's mean; nothing if only means are
        known.

        A wander that is slower than a run is long can't be seen within it and counts as one from run to run.
        """
        parts = [self.segments[place] for place in used] if self.segments else []
        parts = [part for part in parts if len(part.time_s) > 2]
        if not parts:
            return ()
        starts = np.cumsum([0, *(len(part.time_s) for part in parts[:-1])])
        gaps_s = np.diff(np.concatenate([part.time_s for part in parts]))
        gaps_s[starts[1:] - 1] = np.inf
        values = np.concatenate([part.mean for part in parts])
        return tuple(mean_of_series(column, gaps_s, starts) for column in values.T)


def read_runs(logs: Sequence[Log], sensor: SensorLog) -> Runs:
    """One sensor's runs: every phase called `run <k>`, or a whole log, numbered in their order, that has none.

    CalibrationError if the sensor was set otherwise in one of the logs, if two runs have one number, or if the box
    stood in different ways.
    """
    numbers: list[int] = []
    segments: list[Segments | None] = []
    temperatures: list[float] = []
    kinds: set[str] = set()
    ups: set[str] = set()
    for place, log in enumerate(logs, start=1):
        here = log[sensor.name]
        if (here.range, here.axes, here.sensitivity) != (sensor.range, sensor.axes, sensor.sensitivity):
            raise CalibrationError(f"{here.where}: another range or other axes than in {sensor.where}")
        for number, rows, up in _runs_in(log, here, place):
            if number in numbers:
                raise CalibrationError(f"{log.path}: run {number} a second time")
            part = _segments(here, rows)
            numbers.append(number)
            segments.append(part)
            kind, degc = _temperature(log, here, part)
            kinds.add(kind)
            temperatures.append(degc)
            ups.add(up)
    if len(ups) > 1:
        raise CalibrationError(f"{sensor.where}: runs with up {', '.join(map(repr, sorted(ups)))}: one pose is wanted")
    means = [np.full(3, np.nan) if part is None else part.mean.mean(axis=0) for part in segments]
    return Runs(
        sensor.name,
        sensor.quantity,
        sensor.unit,
        sensor.range,
        sensor.sensitivity,
        tuple(numbers),
        np.array(means),
        np.array(temperatures) if len(kinds - {""}) == 1 and "none" not in kinds else None,
        tuple(Segments(np.zeros(0), np.zeros((0, 3))) if part is None else part for part in segments),
        _gravity(sensor, "".join(ups), np.array(means)),
    )


def run_stretches(log: Log, place: int) -> list[tuple[str, int, int]]:
    """Name, start and end (ns) of every run of one log: its phases `run <k>`, else all of it."""
    named = [phase for phase in log.phases if _RUN.fullmatch(phase.name)]
    if named:
        return [(f"{log.path}, {phase.name}", phase.start_ns, phase.end_ns) for phase in named]
    times = [(int(sensor.time[0]), int(sensor.time[len(sensor) - 1])) for sensor in log.sensors.values() if len(sensor)]
    return [(f"run {place}, {log.path}", min(times)[0], max(end for _, end in times))] if times else []


def _runs_in(log: Log, sensor: SensorLog, place: int) -> list[tuple[int, slice, str]]:
    """(number, rows, up) of the runs of one log."""
    named = [(phase, _RUN.fullmatch(phase.name)) for phase in log.phases]
    runs = [(int(match[1]), _rows(sensor, phase), phase.up) for phase, match in named if match]
    ups = {phase.up for phase in log.phases}
    return runs or [(place, slice(0, len(sensor)), ups.pop() if len(ups) == 1 else "")]


def _rows(sensor: SensorLog, phase: Phase) -> slice:
    return sensor.between(phase.start_ns, phase.end_ns)


def _segments(sensor: SensorLog, rows: slice) -> Segments | None:
    """A run in some sixty parts; None if it has no sound reading."""
    if rows.stop <= rows.start:
        return None
    span_s = (int(sensor.time[rows.stop - 1]) - int(sensor.time[rows.start])) * 1e-9
    try:
        return segment_means(sensor, max(span_s / _SEGMENTS, 1e-9), within=rows)
    except CalibrationError:
        return None


def _temperature(log: Log, sensor: SensorLog, run: Segments | None) -> tuple[str, float]:
    """Which thermometer, and the mean temperature over a run in degC; ("", nan) for a run without readings, ("none",
    nan) if nothing knows it.
    """
    if run is None:
        return "", float("nan")
    thermometer = thermometer_of(log, sensor, 1.0)
    return (
        ("none", float("nan")) if thermometer is None else (thermometer.kind, float(thermometer.at(run.time_s).mean()))
    )


def _gravity(sensor: SensorLog, up: str, means: Floats) -> Floats:
    """Gravity (3,) in counts by the data sheet's scale: along the axis that the phases say, else as it was felt."""
    if sensor.quantity != "specific_force":
        return np.zeros(3)
    if up:
        return np.asarray(sensor.sensitivity * (sensor.orientation.T @ np.array(up_vector(up))))
    felt = np.nanmedian(means, axis=0)
    length = float(np.linalg.norm(felt))
    return np.asarray(felt * (sensor.sensitivity / length)) if length else np.zeros(3)
