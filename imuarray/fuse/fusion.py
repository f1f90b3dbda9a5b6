"""Fusion of a log or of a recording in progress: one specific force and one angular rate per frame, in the box frame.

`prepare_inputs` adapts a calibration to one log and selects the sensors to fuse.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate import Calibration
from imuarray.calibrate.model import BIAS, SensorDescription
from imuarray.calibrate.runs import NO_RANGES
from imuarray.calibrate.start_up import start_up_states
from imuarray.errors import CalibrationError, FusionError
from imuarray.fuse import techniques
from imuarray.fuse.alignment import FIRST_ROWS, choose_grid
from imuarray.fuse.element_temperature import (
    TemperatureSources,
    causal_temperatures,
    element_temperatures,
    mismatch_sentences,
    slopes_of,
    temperature_mismatch,
    with_mismatch,
)
from imuarray.fuse.faults import FaultEvent, Ranges
from imuarray.fuse.faults.monitor import MonitoredPipeline
from imuarray.fuse.frames import Axis, Frames, FusedBlock, axes_of
from imuarray.fuse.gravity_directions import contradictions
from imuarray.fuse.optimal import ErrorModel, error_model
from imuarray.fuse.optimal.optimal import CausalPipeline, FrameBlock, FramePipeline, smoothed
from imuarray.fuse.pipeline import (
    FusionNotes,
    ObservedPipeline,
    Pipeline,
    PipelineFactory,
    QuantityPipeline,
    TechniqueSet,
    notes_of,
)
from imuarray.fuse.rate_directions import rate_contradictions
from imuarray.fuse.response_change import RESPONSE_CHANGE, with_response_change
from imuarray.fuse.spools import FrameSpool
from imuarray.fuse.stream import TIMEOUT_S, FusionStream
from imuarray.fuse.techniques import TECHNIQUES
from imuarray.log import Block, Log, SensorLog
from imuarray.log.format import SensorHeader
from imuarray.printable import listed
from imuarray.spelling import guess
from imuarray.units import INERTIAL


@dataclass(frozen=True)
class FusionInputs:
    """A calibration and the sensors to fuse (`only`, all if empty), with remarks for the user.

    `uncalibrated`: sensors that are fused with data-sheet values. `start_up`: sentences on the states in which sensors
    started. `thermal`: sensors whose bias follows the log's temperature. `temperature`: sentences on sensors that were
    calibrated at another temperature. `remarks`: sentences on doubts of the log's import, on sensors that
    contradict each other, and on missing parts of the calibration.
    """

    calibration: Calibration
    only: tuple[str, ...] = ()
    uncalibrated: tuple[str, ...] = ()
    start_up: tuple[str, ...] = ()
    thermal: tuple[str, ...] = ()
    temperature: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def prepare_inputs(
    log: Log,
    calibration: Calibration,
    *,
    technique: str | None = None,
    only: Sequence[str] = (),
    ranges: Ranges = NO_RANGES,
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> FusionInputs:
    """Prepare `calibration` for the fusion of `log` by `technique` (None: any), with `only` these sensors (empty: all).

    Biases become those of the states in which the sensors started, and sensors with a start-up fault are excluded; this
    includes a start in another range, for chips whose sensitivities by range are in `ranges`
    (`imuarray.chips.SENSITIVITIES`). Noise that the technique needs and the calibration lacks is measured where the box
    rests in the log; `progress` is called with the step, the number of sensors done, and their total.

    >>> from imuarray import load_calibration, open_log
    >>> from imuarray.chips import SENSITIVITIES
    >>> from imuarray.fuse import fuse
    >>> with open_log("run.h5") as log:
    ...     inputs = prepare_inputs(log, load_calibration("cal.toml"), technique="planes", ranges=SENSITIVITIES)
    ...     blocks = list(fuse(log, inputs.calibration, "planes", only=inputs.only))
    """
    uncalibrated = [sensor.name for sensor in _inertial(log, only) if sensor.name not in calibration.sensors]
    calibration, start_up, names = _apply_start_states(log, calibration, only, ranges)
    sensors = _inertial(log, names)
    sloped = [sensor for sensor in sensors if slopes_of(calibration, sensor) is not None]
    warm = element_temperatures(log, sloped, calibration)
    cold = [sensor.name for sensor in sloped if sensor.name not in warm]
    remarks = [f"{log.path}: {doubts}"] if (doubts := log.import_doubts) else []
    remarks += contradictions(sensors, calibration)
    remarks += rate_contradictions(sensors, calibration)
    if cold:
        remarks.append(f"{log.path}: no thermometer for the slopes of {', '.join(cold)}; calibrated biases are used")
    lacking = [sensor.name for sensor in sensors if calibration.or_nominal(sensor).noise_lsb is None]
    if lacking and (technique is None or technique in NEEDS_NOISE):
        sensors_text = "" if len(lacking) == len(sensors) else f" of {', '.join(lacking)}"
        from imuarray.calibrate.noise import with_noise_of  # slow to import

        remarks.append(f"no noise{sensors_text} in the calibration; it was measured in this log at rest")
        try:
            calibration = with_noise_of(log, calibration, lacking, progress)
        except CalibrationError as error:
            raise FusionError(
                f"{error}, to measure the noise{sensors_text}, which the calibration lacks; record the box at rest, run"
                " `imuarray calibrate noise` on that log and pass the file as calibration, or choose a technique"
                " that needs no noise (mean, opposed)"
            ) from None
    if technique != OPTIMAL and (unknown := _biases_outside(sensors, calibration)):
        remarks.append(
            f"the biases of {listed(unknown)} were not measured: covariances do not contain them, except those of"
            f" {OPTIMAL}, which allows for usual biases"
        )
    mismatch = temperature_mismatch(log, sensors, calibration)
    return FusionInputs(
        calibration,
        tuple(names),
        tuple(uncalibrated),
        tuple(start_up),
        tuple(warm),
        tuple(mismatch_sentences(calibration, mismatch)),
        tuple(remarks),
    )


def complete_responses(log: Log, inputs: FusionInputs) -> FusionInputs:
    """Complete the inputs of `prepare_inputs` by columns of gyroscopes' responses that the calibration lacks and the
    log determines, from other gyroscopes or from gravity, and by the change of responses since the calibration, with
    remarks. This uses the whole log, so it does not apply to causal fusion.
    """
    gyroscopes = [sensor for sensor in _inertial(log, inputs.only) if sensor.quantity == "angular_rate"]
    if any(inputs.calibration.or_nominal(sensor).uncertain_axes() for sensor in gyroscopes):
        inputs = _add_columns(log, inputs)
    calibration = with_response_change(log, inputs.calibration, inputs.only)
    remarks = [
        f"responses of {listed(names)} differ by {100 * change:.1f} % rms from the calibration; covariances include it"
        for change, names in _large_changes(calibration, inputs.calibration).items()
    ]
    return replace(inputs, calibration=calibration, remarks=(*inputs.remarks, *remarks))


_LARGE_CHANGE = 2 * RESPONSE_CHANGE
"""Estimated change of responses above which it is reported."""


def _large_changes(calibration: Calibration, before: Calibration) -> dict[float, list[str]]:
    """Return the names of sensors by the change of their responses, for changes that are large and that `before` does
    not state.
    """
    names: dict[float, list[str]] = {}
    for name, sensor in calibration.sensors.items():
        change = sensor.response_change
        if change is not None and change > _LARGE_CHANGE and before.sensors[name].response_change is None:
            names.setdefault(change, []).append(name)
    return names


def _add_columns(log: Log, inputs: FusionInputs) -> FusionInputs:
    """Return the inputs with columns of responses that the log determines, and remarks on these."""
    from imuarray.calibrate.response_transfer import transfer_response  # slow to import

    transfer = transfer_response(log, inputs.calibration, inputs.only)
    remarks = [
        f"response of {name} to rates about box {', '.join(axes)} determined in this log, from"
        f" {listed(transfer.references)}"
        for name, axes in transfer.axes.items()
    ]
    remarks += [
        f"rates of {name} contradict its calibration and {listed(transfer.references)}; its calibrated response is used"
        for name in transfer.refused
    ]
    return replace(inputs, calibration=transfer.calibration, remarks=(*inputs.remarks, *remarks))


def _inertial(log: Log, only: Sequence[str]) -> list[SensorLog]:
    """Return the accelerometers and gyroscopes of a log, `only` these (empty: all)."""
    return [sensor for quantity in INERTIAL for sensor in log.of(quantity, only)]


def require_known_sensors(log: Log, calibration: Calibration, only: Sequence[str], calibration_file: str) -> None:
    """Raise FusionError if a calibration, from the named file, contains none of the inertial sensors of `log` (`only`
    these).
    """
    fused = [sensor.name for sensor in _inertial(log, only)]
    if fused and not calibration.sensors.keys() & set(fused):
        raise FusionError(
            f"{calibration_file}: contains {', '.join(calibration.sensors) or 'no sensor'},"
            f" but none of {log.path}: {', '.join(fused)}"
        )


def _biases_outside(sensors: Sequence[SensorDescription], calibration: Calibration) -> list[str]:
    """Return the sensors of known noise whose bias was not measured: their covariances are too small, not unknown."""
    known = {sensor.name: calibration.or_nominal(sensor) for sensor in sensors}
    return [name for name, unit in known.items() if unit.noise_lsb is not None and BIAS not in unit.measured()]


def _apply_start_states(
    log: Log, calibration: Calibration, only: Sequence[str], ranges: Mapping[str, Mapping[float, float]]
) -> tuple[Calibration, list[str], Sequence[str]]:
    """Return the calibration with the biases of the states in which sensors started, sentences on these, and the
    sensors to fuse.
    """
    by_sensor = {name: ranges[sensor.chip] for name, sensor in log.sensors.items() if sensor.chip in ranges}
    adapted, starts = start_up_states(log, calibration, by_sensor)
    wrong = [name for name, start in starts.items() if start.fault]
    sentences = [start.sentence(name, calibration) for name, start in starts.items()]
    if wrong:
        only = [name for name in only or [sensor.name for sensor in _inertial(log, ())] if name not in wrong]
    return adapted, [sentence for sentence in sentences if sentence], only


BLOCK = 1 << 14
"""Number of rows per sensor that are read at once; the result does not depend on it."""

AVERAGE, OPTIMAL = "mean", "optimal"

NEEDS_NOISE = frozenset({*techniques.NEEDS_NOISE, OPTIMAL})
"""Techniques that need the noise of every axis (`calibrate noise`)."""

NAMES = (*TECHNIQUES, OPTIMAL)
"""All techniques: those that fuse each quantity separately, and the estimator of the whole array."""

_Sensor = TypeVar("_Sensor", SensorLog, SensorHeader)
_Out = TypeVar("_Out")
EventCallback = Callable[[FaultEvent], None]
Progress = Callable[[float], None]
"""Called from time to time with the share of the work that is done, 0 to 1."""


@dataclass(frozen=True)
class Watch:
    """Supervision of sensors: whether failed ones are excluded (None: by `optimal` only), the sensitivities of chips by
    name, to identify a chip that returned to another range, and the function that is called with each fault event.
    """

    on: bool | None = None
    ranges: Ranges = field(default_factory=lambda: NO_RANGES)
    on_fault: EventCallback = lambda event: None

    def over(self, technique: str | PipelineFactory) -> bool:
        """Return whether sensors are supervised with this technique."""
        return technique == OPTIMAL if self.on is None else self.on


WATCH = Watch()


@dataclass(frozen=True)
class Patience:
    """Time that frames wait for rows of a sensor; `on_remark` receives a sentence when a sensor times out, and when its
    rows arrive again.
    """

    timeout_s: float = TIMEOUT_S
    on_remark: Callable[[str], None] = lambda text: None


PATIENCE = Patience()

_FIRST_PASS = 0.75
"""Share of the time that the first of two passes takes; it detects faults and filters."""


# The options are independent of one another, keyword-only and the interface of the package.
def fuse(  # noqa: PLR0913
    log: Log,
    calibration: Calibration,
    technique: str | PipelineFactory,
    *,
    only: Collection[str] = (),
    causal: bool = False,
    watch: Watch = WATCH,
    notes: Callable[[FusionNotes], None] = lambda notes: None,
    average: Callable[[FusedBlock], None] | None = None,
    progress: Progress = lambda share: None,
    block: int = BLOCK,
) -> Iterator[FusedBlock]:
    """Fuse the inertial sensors of `log` (`only` these; empty: all) by `technique`, one of `NAMES` or a factory of a
    pipeline for their axes; FusionError if the sensors are not sufficient for it.

    Biases follow the temperature of the log if the calibration has slopes; covariances include the uncertainty of a
    calibration at another temperature. `causal`: each frame is estimated from rows before it only, as by `live`;
    otherwise `optimal` smooths, that is, estimates every frame from the whole log. `notes` is called after the last
    block with the technique's estimates on the sensors. `average` is called with blocks of the simple average of the
    same frames, by a smoothing `optimal` only.

    >>> from imuarray import load_calibration, open_log
    >>> with open_log("run.h5") as log:
    ...     blocks = list(fuse(log, load_calibration("cal.toml"), "ranges"))
    >>> sorted(blocks[0].triads), blocks[0].triads["angular_rate"].shape[1]
    (['angular_rate', 'specific_force'], 3)
    """
    sensors_of_log = list(log.sensors.values())
    by_quantity = _group_by_quantity(sensors_of_log, only, str(log.path))
    if not causal:
        calibration = with_response_change(log, calibration, only)
    if not causal and technique != OPTIMAL:  # `optimal` follows the temperature itself
        inertial = [sensor for sensors in by_quantity.values() for sensor in sensors]
        calibration = with_mismatch(calibration, temperature_mismatch(log, inertial, calibration))
    array = _Array(by_quantity, calibration, technique, watch)
    if causal:
        temperatures = causal_temperatures(sensors_of_log, array.inertial, calibration, of_all=array.is_optimal)
    else:
        temperatures = TemperatureSources(
            element_temperatures(log, array.inertial, calibration, of_all=array.is_optimal)
        )
    if array.is_optimal and not causal:
        yield from _smooth(log, array, temperatures, _Callbacks(notes, average, progress), block)
        return
    stream = array.stream(array.factory(temperatures), temperatures)
    yield from _replay(log, stream, block, progress)
    notes(notes_of(stream.pipeline))


def fuse_together(
    log: Log,
    calibration: Calibration,
    names: Sequence[str],
    *,
    only: Collection[str] = (),
    progress: Progress = lambda share: None,
) -> Iterator[dict[str, FusedBlock]]:
    """Fuse by several techniques that fuse each quantity separately (`TECHNIQUES`), each as by `fuse`; frames are
    aligned once. Returns blocks by the name of the technique. FusionError.
    """
    by_quantity = _group_by_quantity(list(log.sensors.values()), only, str(log.path))
    calibration = with_response_change(log, calibration, only)
    inertial = [sensor for sensors in by_quantity.values() for sensor in sensors]
    calibration = with_mismatch(calibration, temperature_mismatch(log, inertial, calibration))
    array = _Array(by_quantity, calibration, AVERAGE, Watch(on=False))
    temperatures = TemperatureSources(element_temperatures(log, array.inertial, calibration))
    stream = array.stream(lambda period_s: TechniqueSet(array.axes, names), temperatures)
    return _replay(log, stream, BLOCK, progress)


def live(
    sensors: Sequence[SensorHeader],
    calibration: Calibration,
    technique: str | PipelineFactory,
    *,
    only: Collection[str] = (),
    watch: Watch = WATCH,
    patience: Patience = PATIENCE,
) -> FusionStream[FusedBlock]:
    """Return a stream that fuses rows of `sensors` as they arrive, with the same result as `fuse` with `causal`.
    FusionError if the sensors are not sufficient for the technique.
    """
    sensors = sorted(sensors, key=lambda sensor: sensor.name)  # the order in a log
    array = _Array(_group_by_quantity(sensors, only, "the array"), calibration, technique, watch)
    temperatures = causal_temperatures(sensors, array.inertial, calibration, of_all=array.is_optimal)
    factory = array.factory(temperatures)
    factory(1.0)  # raises before anything is read
    return FusionStream(
        array.groups, calibration, factory, temperatures, timeout_s=patience.timeout_s, on_remark=patience.on_remark
    )


def aligned(log: Log, calibration: Calibration, *, only: Collection[str] = ()) -> Iterator[FrameBlock]:
    """Yield the input of techniques from a log: blocks of frames by quantity, with the temperatures of elements by
    sensor. FusionError if the log has no inertial sensors or too few rows, or if the calibration has none of its
    sensors.
    """
    array = _Array(
        _group_by_quantity(list(log.sensors.values()), only, str(log.path)), calibration, OPTIMAL, Watch(on=False)
    )
    temperatures = TemperatureSources(element_temperatures(log, array.inertial, calibration, of_all=True))
    return _replay(log, array.stream(lambda period_s: FramePipeline(), temperatures), BLOCK)


def require_technique(technique: str) -> None:
    """Raise FusionError unless this is the name of a technique."""
    if technique not in NAMES:
        raise FusionError(f"technique {technique!r}: allowed are {', '.join(NAMES)}{guess(technique, NAMES)}")


class _Array(Generic[_Sensor]):
    """Sensors by quantity, with calibration and technique; FusionError for an unknown technique."""

    def __init__(
        self, groups: dict[str, list[_Sensor]], calibration: Calibration, technique: str | PipelineFactory, watch: Watch
    ) -> None:
        if isinstance(technique, str):
            require_technique(technique)
        self.groups: dict[str, list[_Sensor]] = groups
        self.calibration, self.technique, self.watch = calibration, technique, watch
        self.inertial: list[_Sensor] = [sensor for sensors in groups.values() for sensor in sensors]
        names = [sensor.name for sensor in self.inertial]
        if calibration.sensors and not any(name in calibration.sensors for name in names):
            raise FusionError(
                f"the calibration contains {', '.join(calibration.sensors)}, but none of the sensors to be fused:"
                f" {', '.join(names)}"
            )
        self.is_optimal = technique == OPTIMAL

    @cached_property
    def axes(self) -> dict[str, list[Axis]]:
        """Axes by quantity."""
        return {quantity: axes_of(sensors, self.calibration) for quantity, sensors in self.groups.items()}

    def stream(
        self, factory: Callable[[float], Pipeline[_Out]], temperatures: TemperatureSources
    ) -> FusionStream[_Out]:
        """Return the stream of a recorded log, in which no sensor times out."""
        return FusionStream(self.groups, self.calibration, factory, temperatures, timeout_s=float("inf"))

    def model(self, temperatures: TemperatureSources) -> ErrorModel:
        """Return the model of the errors that remain after calibration."""
        return error_model(self.inertial, self.calibration, watched=temperatures.elements)

    def factory(self, temperatures: TemperatureSources) -> Callable[[float], Pipeline[FusedBlock]]:
        """Return the function that creates the pipeline from the seconds between frames."""
        axes, technique = self.axes, self.technique
        if technique == OPTIMAL:
            model = self.model(temperatures)
            return lambda period_s: self.supervised(CausalPipeline(axes, model, period_s), axes, period_s)
        if isinstance(technique, str):
            return lambda period_s: self.supervised(QuantityPipeline(axes, technique), axes, period_s)
        return lambda period_s: self.supervised(technique(axes, period_s), axes, period_s)

    def supervised(
        self, pipeline: Pipeline[_Out], axes: Mapping[str, Sequence[Axis]], period_s: float
    ) -> Pipeline[_Out]:
        """Return the pipeline with fault monitors before it, if sensors are supervised."""
        if not self.watch.over(self.technique):
            return pipeline
        return MonitoredPipeline(pipeline, axes, period_s, self.watch.ranges, self.watch.on_fault)


class _Callbacks(NamedTuple):
    """The callbacks of `fuse`."""

    notes: Callable[[FusionNotes], None]
    average: Callable[[FusedBlock], None] | None
    progress: Progress


def _smooth(
    log: Log, array: _Array[SensorLog], temperatures: TemperatureSources, callbacks: _Callbacks, block: int
) -> Iterator[FusedBlock]:
    """Estimate every frame from the whole log. Rows are aligned once, and their frames are processed twice."""
    axes, model = array.axes, array.model(temperatures)
    period_s = _period_s(array)
    supervised: list[Pipeline[FrameBlock]] = []
    average = QuantityPipeline(axes, AVERAGE)

    def observe(frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> None:
        spool.add(frames, degc)
        if callbacks.average is not None:
            for averaged in average(frames, degc):
                callbacks.average(averaged)

    def factory(period_s: float) -> Pipeline[FrameBlock]:
        supervised.append(array.supervised(FramePipeline(), axes, period_s))
        return ObservedPipeline(supervised[0], observe)

    def first_pass() -> Iterator[FrameBlock]:
        stream = array.stream(factory, temperatures)
        yield from _replay(log, stream, block, lambda frames_done: callbacks.progress(_FIRST_PASS * frames_done))

    def second_pass() -> Iterator[FrameBlock]:
        first = supervised[0]  # faults are detected and reported once
        left_out = first.left_out if isinstance(first, MonitoredPipeline) else {}
        frames_done = 0
        for frames, degc in spool.blocks():
            used = {name: left_out[name].of(part, frames_done) if left_out else part for name, part in frames.items()}
            frames_done += len(next(iter(frames.values())).time)
            callbacks.progress(_FIRST_PASS + (1 - _FIRST_PASS) * frames_done / spool.frames)
            yield used, degc

    def with_remarks(notes: FusionNotes) -> None:
        first = supervised[0]
        remarks = first.remarks() if isinstance(first, MonitoredPipeline) else []
        callbacks.notes(replace(notes, remarks=(*notes.remarks, *remarks)))

    with closing(FrameSpool()) as spool:
        passes = iter((first_pass, second_pass))
        yield from smoothed(lambda: next(passes)(), axes, model, period_s, with_remarks)


def _period_s(array: _Array[SensorLog]) -> float:
    """Return the time from frame to frame that a stream will choose."""
    first = [np.asarray(sensor.time[:FIRST_ROWS]) for sensor in array.inertial]
    numbers = iter(range(len(first)))
    groups = [[next(numbers) for _ in sensors] for sensors in array.groups.values()]
    return choose_grid(first, groups, [sensor.where for sensor in array.inertial]).period_ns * 1e-9


def _group_by_quantity(sensors: Sequence[_Sensor], only: Collection[str], where: str) -> dict[str, list[_Sensor]]:
    """Return the inertial sensors to fuse, by quantity; FusionError if there are none."""
    by_quantity: dict[str, list[_Sensor]] = {
        quantity: [s for s in sensors if s.quantity == quantity and (not only or s.name in only)]
        for quantity in INERTIAL
    }
    if not any(by_quantity.values()):
        choice = f" among {', '.join(sorted(only))}" if only else ""
        raise FusionError(f"{where}: no inertial sensor{choice}")
    return {quantity: group for quantity, group in by_quantity.items() if group}


def _replay(
    log: Log, stream: FusionStream[_Out], block: int, progress: Progress = lambda share: None
) -> Iterator[_Out]:
    """Push the rows of all sensors to the stream, about in order of time, so that none is far ahead of the others, and
    yield its output.
    """
    sensors = [sensor for sensor in log.sensors.values() if sensor.name in stream.sensors]
    reached_ns = {sensor.name: -1 for sensor in sensors}
    row = {sensor.name: 0 for sensor in sensors}
    rows = {sensor.name: len(sensor) for sensor in sensors}
    remaining = {sensor.name: sensor for sensor in sensors}
    total = max(1, sum(rows.values()))
    while remaining:
        name = min(remaining, key=lambda name: reached_ns[name])
        if row[name] >= rows[name]:
            del remaining[name]
            yield from stream.end(name)
            continue
        part = _read_block(remaining[name], slice(row[name], row[name] + block), name in stream.thermometers)
        reached_ns[name] = int(part.time[-1])
        row[name] += len(part.time)
        progress(sum(row.values()) / total)
        yield from stream.push(name, part)
    yield from stream.finish()


def _read_block(sensor: SensorLog, rows: slice, with_temperature: bool) -> Block:
    """Read some rows of a sensor, with the temperature if required."""
    time, counts = np.asarray(sensor.time[rows]), np.asarray(sensor.counts[rows])
    status = np.asarray(sensor.status[rows])
    if not with_temperature:
        return Block(time, counts, status)
    if sensor.quantity == "pressure":
        return Block(time, counts, status, None, {"temperature": np.asarray(sensor.compensated("temperature")[rows])})
    degrees = sensor.temperature_counts
    return Block(time, counts, status, None if degrees is None else np.asarray(degrees[rows]))
