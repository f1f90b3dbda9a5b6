"""The steps of an analysis as one Python call each, with the same results as the commands of the same names.

Logs are given as paths or as open logs; those that are opened here are closed again. Results contain numbers with their
uncertainties, have a method for figures (`plot`, needs matplotlib) and are shown as tables in notebooks.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from imuarray.errors import ConfigError
from imuarray.log import Log, open_log, require_distinct, require_logs
from imuarray.spelling import as_names

if TYPE_CHECKING:
    from imuarray.array import ArrayConfig
    from imuarray.calibrate import Calibration, ThermalResult, TumbleResult
    from imuarray.calibrate.turn_on import TurnOnSeries
    from imuarray.characterise.allan import Estimator
    from imuarray.characterise.characterisation import Characterisation
    from imuarray.fuse.fused_result import FusedResult
    from imuarray.simulate import Model
    from imuarray.simulate.effect import Effect
    from imuarray.simulate.experiments import BootRun, ExperimentOptions

LogLike = str | PathLike[str] | Log
"""A path, or an open log."""


def calibrate_tumble(*logs: LogLike) -> TumbleResult:
    """Determine bias and response of accelerometers, and bias, g-sensitivity and (from turns) response of gyroscopes,
    from one or more logs of a box that was put on its faces, held in static poses, or turned slowly: `imuarray
    calibrate tumble`. LogError, CalibrationError.

    >>> tumble = calibrate_tumble("tumble.h5")
    >>> tumble.method, sorted(tumble.residual_g)[0]
    ('faces', 'ADXL1')
    >>> tumble.calibration.sensors["BMA1"].bias_sem_lsb.shape
    (3,)
    """
    from imuarray.calibrate import calibrate_tumble as calibrate

    with _open_logs("calibrate_tumble(*logs)", logs) as opened:
        return calibrate(*opened)


def calibrate_noise(*logs: LogLike, known: str | PathLike[str] | Calibration | None = None) -> Calibration:
    """Determine the scatter of single readings, its correlation and the drift of every inertial sensor, from stretches
    in which the box stood still: `imuarray calibrate noise`. The part of the drift that follows temperature by the
    slopes of the calibration `known` is removed. LogError, CalibrationError.

    >>> noise = calibrate_noise("run.h5").sensors["Gyro1"]
    >>> noise.noise_lsb.shape, bool((noise.noise_sem_lsb < noise.noise_lsb).all())
    ((3,), True)
    """
    from imuarray.calibrate import calibrate_noise as calibrate

    with _open_logs("calibrate_noise(*logs)", logs) as opened:
        return calibrate(*opened, known=None if known is None else _calibration(known)).stamped(opened)


def calibrate_thermal(*logs: LogLike) -> ThermalResult:
    """Determine the change of biases with temperature, from logs in which the box stood still and was heated or cooled:
    `imuarray calibrate thermal`. LogError, CalibrationError.

    >>> slopes = calibrate_thermal("heating.h5").calibration.sensors["BMA1"].thermal
    >>> slopes.slope_lsb_per_degc.shape, slopes.slope_sem_lsb_per_degc.shape
    ((3,), (3,))
    """
    from imuarray.calibrate import calibrate_thermal as calibrate

    with _open_logs("calibrate_thermal(*logs)", logs) as opened:
        return calibrate(*opened)


def calibrate_turn_on(*logs: LogLike, seed: int = 1) -> TurnOnSeries:
    """Determine the change of biases from one switch-on to the next, from one log per run, or from one log with the
    runs as its phases `run 1`, `run 2`, ...: `imuarray calibrate turn-on`. `seed` is that of the simulated draws of the
    test for two states. LogError, CalibrationError.

    >>> series = calibrate_turn_on("boot_1.h5", "boot_2.h5", "boot_3.h5")
    >>> series.calibration.sensors["Gyro1"].turn_on.runs
    3
    """
    from imuarray.calibrate import calibrate_turn_on as calibrate
    from imuarray.chips import SENSITIVITIES

    with _open_logs("calibrate_turn_on(*logs)", logs) as opened:
        return calibrate(opened, SENSITIVITIES, seed)


def characterise(
    log: LogLike,
    *,
    phase: str | None = None,
    sensors: Sequence[str] = (),
    estimator: Estimator | None = None,
    calibration: str | PathLike[str] | Calibration | None = None,
) -> Characterisation:
    """Compute Allan deviation, spectrum, correlation, codes and noise coefficients of the sensors of a log at rest:
    `imuarray characterise`. `phase` names the stretch (None: the longest at rest), `estimator` is "overlapping" or
    "decimated" (None: by the length of the log); a `calibration` gives the scale factors. LogError, CalibrationError.

    >>> noise = characterise("run.h5", sensors=["Gyro1"])
    >>> white = noise.coefficient("Gyro1", "x", "white")
    >>> white.low < white.value < white.high  # dps/sqrt(Hz)
    True
    """
    from imuarray.calibrate.motion import longest_rest
    from imuarray.characterise import characterise_log
    from imuarray.characterise.characterisation import Characterisation

    with _open_logs("characterise(log)", [log]) as (opened,):
        scales = {} if calibration is None else _calibration(calibration).scales(opened.sensors.values())
        return Characterisation(
            characterise_log(
                opened,
                longest_rest(opened, phase) or phase,
                list(as_names(sensors)) or None,
                estimator=estimator,
                scales=scales,
            )
        )


# The public interface: keyword-only options with the names of the command's options, on which users rely.
def fuse(  # noqa: PLR0913
    log: LogLike,
    calibration: str | PathLike[str] | Calibration | None = None,
    technique: str = "mean",
    *,
    only: Sequence[str] = (),
    causal: bool = False,
    watch: bool | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> FusedResult:
    """Fuse all inertial sensors of a log (`only` these) into one specific force in m/s2 and one angular rate in rad/s,
    (n, 3) each, in the box frame: `imuarray fuse`. The whole result is in memory.

    `technique` is "mean", "opposed", "planes", "ranges" or "optimal"; without a `calibration`, data-sheet values are
    used. Biases are those of the states in which the sensors started, and follow the temperature in the log. Noise that
    is not in the calibration is measured while the log is at rest; `remarks` of the result state this. With `causal`,
    each frame is estimated from earlier readings only. With `watch`, failing sensors are detected and excluded (None:
    with "optimal"). `progress` is called with the completed share. LogError, CalibrationError, FusionError.

    >>> fused = fuse("run.h5", "cal.toml", "optimal")
    >>> fused.specific_force.shape[1], fused.standard_error("angular_rate").shape[1]
    (3, 3)
    >>> sorted(fused.errors)  # against the truth, which an emulated log knows
    ['angular_rate', 'specific_force']
    """
    from imuarray.calibrate import Calibration
    from imuarray.chips import SENSITIVITIES
    from imuarray.fuse import FusedBlock, Watch, evaluate
    from imuarray.fuse.faults import FaultEvent
    from imuarray.fuse.fused_result import FusedResult
    from imuarray.fuse.fusion import complete_responses, prepare_inputs, require_known_sensors
    from imuarray.fuse.fusion import fuse as fused_blocks
    from imuarray.fuse.pipeline import FusionNotes

    name = str(calibration) if isinstance(calibration, str | PathLike) else ""
    calibration_used = Calibration() if calibration is None else _calibration(calibration)
    events: list[FaultEvent] = []
    notes: list[FusionNotes] = []
    with _open_logs("fuse(log)", [log]) as (opened,):
        sensor_names = [opened[sensor].name for sensor in as_names(only)]
        if name or calibration_used.sensors:
            require_known_sensors(opened, calibration_used, sensor_names, name or "the calibration")
        inputs = prepare_inputs(opened, calibration_used, technique=technique, only=sensor_names, ranges=SENSITIVITIES)
        if not causal:
            inputs = complete_responses(opened, inputs)
        blocks = fused_blocks(
            opened,
            inputs.calibration,
            technique,
            only=inputs.only,
            causal=causal,
            watch=Watch(watch, SENSITIVITIES, events.append),
            notes=notes.append,
            progress=progress,
        )
        frames = FusedBlock.joined(list(blocks))
        truth = opened.motion_track
        return FusedResult(
            frames,
            opened.epoch,
            technique,
            {quantity: [sensor.name for sensor in opened.of(quantity, inputs.only)] for quantity in frames.triads},
            str(opened.path),
            name,
            tuple(events),
            notes[-1] if notes else FusionNotes(),
            (*inputs.remarks, *inputs.start_up, *inputs.temperature),
            evaluate(opened, [frames]) if truth else {},
        )


class Conditions(TypedDict, total=False):
    """The conditions of an experiment: its length, the box axis that points up ("+Z"; static, heating), the
    temperature, and the motion of the box in "motion": "hand", "vehicle" or the path of a trajectory file.
    """

    seconds: float
    up: str
    temperature_degc: float
    drive: str


# The public interface: keyword-only options with the names of the command's options, on which users rely.
def simulate(  # noqa: PLR0913
    source: str | PathLike[str] | ArrayConfig | Log,
    output: str | PathLike[str],
    *,
    experiment: str = "static",
    model: str | PathLike[str] | Model = "datasheet",
    effects: Mapping[str, Sequence[Effect]] | None = None,
    calibration: str | PathLike[str] | Calibration | None = None,
    only: Collection[str] = (),
    without: Collection[str] = (),
    population: bool = False,
    rate_hz: float = 50.0,
    seed: int = 0,
    boot: int = 0,
    force: bool = False,
    **conditions: Unpack[Conditions],
) -> Log:
    """Simulate the log that an array would record, write it to `output`, and return it, opened for reading: `imuarray
    simulate`.

    `source` is an array ("martin2013", a configuration file or the result of `load_array`), or a recorded log (an open
    one, or a path that ends in .h5) with the sensors, times, faces and temperature of the simulated log. `experiment`
    is "static", "tumble", "heating", "turn-on" (one run: `boot` numbers it from 0) or "motion". `model` is a model, its
    file or the name of one that comes with the package ("datasheet", "martin2013"); with a `calibration`, each unit has
    its calibrated parameters. `effects` by sensor (of `imuarray.simulate.EFFECTS`) are added to those of the model, and
    the effects `without` are removed; with `population` every unit is drawn from its design. The same `seed` gives the
    same log; `boot` is another run of the same units. A UserWarning states what the model omits.

    ConfigError, LogError, SourceError, OutputExistsError.

    >>> from imuarray.simulate import EFFECTS
    >>> tone = EFFECTS["tone"](amplitude=0.5, frequency_hz=7.0)
    >>> with simulate("martin2013", "with_tone.h5", seconds=4, effects={"Gyro1": [tone]}) as log:
    ...     len(log["Gyro1"]), log.source
    (200, 'simulated')
    """
    from imuarray.simulate import Simulation, effects_of, write_log
    from imuarray.simulate.experiments import remarks_on, run_of, with_effects
    from imuarray.simulate.record import EPOCH, Origin

    only, without = as_names(only), as_names(without)
    with ExitStack() as stack:
        with _mistakes_as_config_errors():
            recorded = _open_recording(source, stack)
            if recorded is not None:
                run = _run_like(recorded, Path(output), only, boot, conditions)
            else:
                array = _array(source, only)
                chosen_experiment = _experiment(experiment, boot, conditions)
                run = run_of(array, Path(output), experiment, chosen_experiment, rate_hz=rate_hz, boot=boot)
            chosen_model = _model(model, calibration, run)
            for sentence in remarks_on(run.plan, chosen_model, recorded, population=population):
                warnings.warn(sentence, UserWarning, stacklevel=2)
            chosen_effects = effects_of(run.plan, chosen_model, seed, population=population, without=without)
            chosen_effects = with_effects(chosen_effects, effects or {})
            simulation = Simulation(run.plan, run.motion, chosen_effects, seed=seed, boot=run.boot)
        note = f"model {chosen_model.name}, seed {seed}, boot {run.boot}"
        epoch = EPOCH if recorded is None else recorded.epoch
        write_log(simulation, run.path, origin=Origin(epoch, note), force=force)
    return open_log(output)


@contextmanager
def _mistakes_as_config_errors() -> Iterator[None]:
    """Convert the ValueError for an invalid time, side of the box or seed to ConfigError."""
    try:
        yield
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _open_recording(source: str | PathLike[str] | ArrayConfig | Log, stack: ExitStack) -> Log | None:
    """Return the recorded log that a simulation imitates; None for an array."""
    if isinstance(source, Log):
        return source
    if isinstance(source, str | PathLike) and Path(source).suffix == ".h5":
        return stack.enter_context(open_log(source))
    return None


def _run_like(log: Log, path: Path, only: Collection[str], boot: int, conditions: Conditions) -> BootRun:
    from imuarray.simulate.experiments import run_like

    if conditions:
        raise ConfigError(
            f"{', '.join(conditions)}: with a recorded log these come from the log; give an array to choose them"
        )
    return run_like(log, path, only, boot)


def _array(source: str | PathLike[str] | ArrayConfig | Log, only: Collection[str]) -> ArrayConfig:
    """Return the array to simulate, with `only` these sensors if any are named."""
    from imuarray.array import ArrayConfig, load_array
    from imuarray.shipped import find_config

    array = source if isinstance(source, ArrayConfig) else load_array(find_config(Path(str(source))))
    return array.only(tuple(only)) if only else array


def _experiment(experiment: str, boot: int, conditions: Conditions) -> ExperimentOptions:
    """Return the conditions of an experiment, for run `boot` of a turn-on series; ConfigError if unknown."""
    from imuarray.simulate.experiments import EXPERIMENTS, ExperimentOptions
    from imuarray.spelling import guess

    if experiment not in EXPERIMENTS:
        choices = ", ".join(EXPERIMENTS)
        raise ConfigError(f"experiment {experiment!r}: allowed are {choices}{guess(experiment, EXPERIMENTS)}")
    seconds = conditions.get("seconds")
    if seconds is not None and not isinstance(seconds, int | float):
        raise ConfigError(f"seconds {seconds!r}: allowed is a number of seconds, such as 600")
    return ExperimentOptions(**conditions, run=boot + 1 if experiment == "turn-on" else 1)


def _model(
    model: str | PathLike[str] | Model, calibration: str | PathLike[str] | Calibration | None, run: BootRun
) -> Model:
    from imuarray.errors import CalibrationError
    from imuarray.shipped import find_model
    from imuarray.simulate import Model, load_model
    from imuarray.simulate.from_calibration import calibrated

    loaded = model if isinstance(model, Model) else load_model(find_model(Path(model)))
    if calibration is None:
        return loaded
    known, sensors = _calibration(calibration), run.plan.sensors
    if not set(known.sensors) & set(sensors):
        name = ", ".join(known.sensors) or "no sensor"
        raise CalibrationError(f"the calibration contains {name}, but none of {', '.join(sensors)}")
    return calibrated(loaded, known, [header for header, _ in sensors.values()])


def _calibration(calibration: object) -> Calibration:
    """Return the calibration itself, or that of a file; CalibrationError, also if it is neither."""
    from imuarray.calibrate import Calibration, load_calibration
    from imuarray.errors import CalibrationError

    if isinstance(calibration, Calibration):
        return calibration
    if not isinstance(calibration, str | PathLike):
        kind = type(calibration).__name__
        raise CalibrationError(f"{kind} given as a calibration; allowed is a path or a Calibration")
    return load_calibration(calibration)


@contextmanager
def _open_logs(call: str, logs: Sequence[LogLike]) -> Iterator[list[Log]]:
    """Open the logs that are given as paths, and close these at the end. LogError, also without logs or for other
    objects; the message names the `call`.
    """
    require_logs(logs, call, or_paths=True)
    with ExitStack() as stack:
        opened = [log if isinstance(log, Log) else stack.enter_context(open_log(log)) for log in logs]
        require_distinct(opened)
        yield opened
