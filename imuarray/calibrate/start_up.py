"""Start-up state of a sensor: which of its calibrated turn-on states it started in, or a fault, which requires a
restart. It is determined from a whole log, or from the first readings of a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.model import Calibration, SensorCalibration, TurnOn
from imuarray.calibrate.pose_readings import Pose, find_poses
from imuarray.calibrate.runs import NO_RANGES, Ranges, explained_range
from imuarray.errors import CalibrationError
from imuarray.log import Log
from imuarray.log.health import StartVerdict
from imuarray.log.rests import rests_of

_SECONDS = 10.0
_LIMIT, _POSE_G = 8.0, 0.02
"""Largest distance of a usual start from its state, in spreads, and tolerance of the pose of accelerometers, g."""
_ROUNDING = 1 / 12
"""Variance of the rounding of a reading to a count."""


@dataclass(frozen=True)
class StartUp:
    """Start-up state of a sensor: its index in the calibration's list, the distance of the reading from it (rms over
    the axes, in spreads), whether the start is a `fault`, and the explanation.
    """

    state: int
    distance: float
    fault: bool
    explanation: str = ""

    def sentence(self, name: str, calibration: Calibration) -> str:
        """Describe the start of sensor `name`; empty without a fault or a choice of states."""
        turn_on = calibration.sensors[name].turn_on
        if self.fault:
            return f"{name} started in a wrong state ({self.explanation}): do not use it; switch it off and on again"
        states = 0 if turn_on is None else len(turn_on.states)
        if states < 2:
            return ""
        holds = ": its bias is used" if calibration.sensors[name].quantity == "angular_rate" else ""
        return f"{name} started in state {self.state + 1} of {states}{holds}"


class RestMean(NamedTuple):
    """Mean counts (3,) at rest and their standard errors, (3,) or 0."""

    counts: Floats
    error: Floats

    @classmethod
    def of(cls, counts: npt.NDArray[Any]) -> RestMean:
        """Return the mean of counts (n, 3), n > 0. Its error is that of white noise and rounding."""
        readings = np.asarray(counts, float)
        return cls(readings.mean(axis=0), np.sqrt((readings.var(axis=0) + _ROUNDING) / len(readings)))


def states_of(rests: Mapping[str, RestMean], calibration: Calibration, ranges: Ranges) -> dict[str, StartUp]:
    """Return the start-up state of each sensor that has a `turn_on`, from its mean over some seconds at rest.

    Accelerometers must be in the pose of the calibration runs, within `_POSE_G`. A start more than `_LIMIT` spreads
    from every state, or in another range, is a fault; `ranges` are the sensitivities of each sensor's chip, by sensor.
    """
    return {
        name: _start_up(rests[name], sensor, sensor.turn_on, ranges.get(name, {}))
        for name, sensor in calibration.sensors.items()
        if name in rests and sensor.turn_on is not None and sensor.turn_on.states
    }


def _start_up(rest: RestMean, sensor: SensorCalibration, turn_on: TurnOn, ranges: Mapping[float, float]) -> StartUp:
    mean = rest.counts
    gravity = np.zeros(3) if turn_on.gravity_lsb is None else turn_on.gravity_lsb
    tilt = _POSE_G * sensor.scale_lsb_per_unit if turn_on.gravity_lsb is not None else 0.0
    spread = np.maximum(np.sqrt(np.square(turn_on.spread_lsb) + tilt**2 + rest.error**2), 1e-9)
    usual = np.array([state.bias_lsb for state in turn_on.states]) + gravity
    distances = np.sqrt(np.mean(((mean - usual) / spread) ** 2, axis=1))
    state = int(distances.argmin())
    sensitivity = ranges.get(np.nan if sensor.range is None else sensor.range, np.nan)
    is_accelerometer = sensor.quantity == "specific_force"
    ratio, result = explained_range(mean, usual[state], sensitivity, ranges) if is_accelerometer else (np.nan, None)
    distance = float(distances[state])
    if result is not None:
        return StartUp(
            state, distance, True, f"{ratio:.2f} times the usual reading: started at {result:g} {sensor.unit}"
        )
    far = not distance <= _LIMIT
    return StartUp(state, distance, far, f"{distance:.1f} spreads from every state" if far else "")


def start_up_states(
    log: Log, calibration: Calibration, ranges: Ranges = NO_RANGES
) -> tuple[Calibration, dict[str, StartUp]]:
    """Return the calibration reduced to the states in which the gyroscopes of a log started, with the biases of these,
    and the start-up state of each sensor.

    The states are determined from the first seconds at rest: a phase that states a rest, or a detected pose. Without a
    rest the calibration is unchanged. If most accelerometers are far from their states, the box is in another pose than
    in the calibration runs, and only wrong ranges of accelerometers are reported.
    """
    rests = _first_rests(log, [name for name, sensor in calibration.sensors.items() if sensor.turn_on is not None])
    result = without_other_pose(states_of(rests, calibration, ranges), calibration)
    return in_states(result, calibration), result


def in_states(starts: Mapping[str, StartUp], calibration: Calibration) -> Calibration:
    """Return the calibration with the biases of the states in which gyroscopes started."""
    sensors = dict(calibration.sensors)
    for name, start in starts.items():
        turn_on = sensors[name].turn_on
        is_gyroscope = sensors[name].quantity == "angular_rate"  # an accelerometer's state includes the runs' tilt
        if is_gyroscope and turn_on is not None and len(turn_on.states) > 1 and not start.fault:
            sensors[name] = replace(
                sensors[name],
                bias_lsb=_bias_in(start.state, sensors[name], turn_on),
                turn_on=replace(turn_on, states=(turn_on.states[start.state],)),
            )
    return replace(calibration, sensors=sensors)


def _bias_in(state: int, sensor: SensorCalibration, turn_on: TurnOn) -> Floats:
    """Return a gyroscope's bias in one state: the calibrated bias plus the difference of this state and the state that
    is nearest to it; the state's own bias if none was calibrated.
    """
    biases = np.array([item.bias_lsb for item in turn_on.states])
    if sensor.bias_sem_lsb is None:
        return np.asarray(biases[state])
    nearest = int(np.linalg.norm(biases - sensor.bias_lsb, axis=1).argmin())
    return np.asarray(sensor.bias_lsb + biases[state] - biases[nearest])


def _first_rests(log: Log, names: Sequence[str]) -> dict[str, RestMean]:
    """Return the means over the first seconds at rest by sensor, for sensors with readings there."""
    still = [Pose(phase, None, log) for phase in rests_of(log.phases)]
    if names and not still:
        with suppress(CalibrationError):
            still = find_poses(log)
    rests: dict[str, RestMean] = {}
    for name in names if still else ():
        if name in log.sensors:
            start_ns = still[0].phase.start_ns
            end_ns = min(still[0].phase.end_ns, start_ns + round(_SECONDS * 1e9))
            counts = log[name].counts[log[name].between(start_ns, end_ns)]
            if len(counts):
                rests[name] = RestMean.of(counts)
    return rests


def without_other_pose(starts: dict[str, StartUp], calibration: Calibration) -> dict[str, StartUp]:
    """Return the states without those of accelerometers if most of these are far from theirs, because the box is in
    another pose; wrong ranges are kept.
    """
    accelerometers = [name for name in starts if calibration.sensors[name].quantity == "specific_force"]
    far = [name for name in accelerometers if starts[name].fault]
    other_pose = 2 * len(far) > len(accelerometers)
    return {
        name: start
        for name, start in starts.items()
        if not (other_pose and name in accelerometers) or start.explanation.endswith(calibration.sensors[name].unit)
    }


PARTS = 10
_RESTLESS = 25.0
"""Largest variance of the means of parts at rest, relative to that by white noise; a wandering bias has a ratio of up
to five.
"""


class StartStateDetector:
    """Judges the first readings of sensors (an `imuarray.acquire.sensor_health.Judge`): a call returns verdicts by
    name.

    `sentences` keeps every sentence; `report` is called with each new one. If the box moved, there are no verdicts.
    """

    def __init__(
        self, calibration: Calibration, ranges: Ranges, report: Callable[[str], None] = lambda text: None
    ) -> None:
        """`ranges` are the sensitivities of each sensor's chip by range, by sensor (`ArrayConfig.sensitivities`)."""
        self.sentences: list[str] = []
        self._calibration, self._ranges, self._report = calibration, ranges, report
        self._rests: dict[str, RestMean] = {}
        self._starts: dict[str, StartUp] = {}

    @property
    def knows_states(self) -> bool:
        """Return whether the calibration knows the start-up states of any sensor."""
        return any(sensor.turn_on is not None for sensor in self._calibration.sensors.values())

    def in_states(self) -> Calibration:
        """Return the calibration with the biases of the states in which sensors started, as far as known."""
        return in_states(dict(self._starts), self._calibration)

    def __call__(self, readings: Mapping[str, npt.NDArray[Any]]) -> dict[str, StartVerdict]:
        """Return verdicts by sensor; a restarted sensor is judged together with the first readings of the others."""
        calibrated = {name: counts for name, counts in readings.items() if name in self._calibration.sensors}
        if calibrated and np.median([_restlessness(counts) for counts in calibrated.values()]) > _RESTLESS:
            self._say("the box was moved in the first seconds: the states of the sensors are not known")
            return {}
        self._rests.update((name, RestMean.of(counts)) for name, counts in readings.items())
        states = states_of(self._rests, self._calibration, self._ranges)
        possible = without_other_pose(states, self._calibration)
        starts = {name: start for name, start in possible.items() if name in readings}
        self._starts.update(starts)
        verdicts = {name: self._verdict(name, start) for name, start in starts.items()}
        if not any(verdict.text for verdict in verdicts.values()):
            usual = f"{len(starts)} sensors started as usual"
            self._report(usual if states else "the calibration contains no turn-on states")
        return verdicts

    def _verdict(self, name: str, start: StartUp) -> StartVerdict:
        text = start.sentence(name, self._calibration)
        if text:
            self._say(text)
        return StartVerdict(start.fault, text)

    def _say(self, text: str) -> None:
        if text not in self.sentences:
            self.sentences.append(text)
            self._report(text)


def _restlessness(counts: npt.NDArray[Any]) -> float:
    """Return the ratio of the variance of part means of counts (n, 3) to that by white noise, for the worst axis."""
    if len(counts) < 4 * PARTS:
        return 0.0
    length = len(counts) // PARTS
    parts = counts[: PARTS * length].reshape(PARTS, length, -1).astype(float)
    noise = parts.var(axis=1, ddof=1).mean(axis=0) + _ROUNDING
    return float((parts.mean(axis=1).var(axis=0, ddof=1) / (noise / length)).max())
