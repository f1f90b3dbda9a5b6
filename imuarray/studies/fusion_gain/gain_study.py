"""The study: simulated experiments, fused by every technique and compared with the truth, the average and the bound.

`run` simulates one experiment with one seed and measures every technique; `study` does all runs and summarises them as
ratios with intervals over the seeds; `render_text` prints the result. `ARRAYS` are the simulated arrays, `SETS` the
sensors that are fused together.

The calibrations are those that `calibrate` makes from simulated logs of the same units, recorded at other switch-ons
than the logs that are fused.
"""

from __future__ import annotations

import math
import tomllib
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tomli_w

from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.arrays import Floats
from imuarray.calibrate import Calibration, calibrate_noise, calibrate_thermal, calibrate_tumble, calibrate_turn_on
from imuarray.calibrate.start_up import start_up_states
from imuarray.chips import CHIPS
from imuarray.fuse import OPTIMAL, ErrorFrames, FusedBlock, coasting, error_frames, fuse, technique_names
from imuarray.fuse.comparison import AXES, both
from imuarray.fuse.error_consistency import consistency
from imuarray.fuse.evaluation import Ratio, ratio_of, ten_second_means
from imuarray.fuse.fusion import AVERAGE
from imuarray.json_values import json_value
from imuarray.log import Log, open_log
from imuarray.printable import percent
from imuarray.shipped import configs
from imuarray.simulate import Motion, Simulation, effects_of, load_model, plan_of, write_log
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import ExperimentOptions
from imuarray.studies.fusion_gain.cramer_rao import OUTSIDE, ErrorLaw, Posterior, law_of, true_calibration
from imuarray.units import INERTIAL, READABLE_SI

ARRAY = "martin2013"


def martin2013() -> ArrayConfig:
    """Return the paper's array."""
    return load_array(configs() / f"{ARRAY}.toml")


def perpendicular() -> ArrayConfig:
    """Return the paper's ADXL345, with ADXL2's board mounted perpendicularly: its z, twice as noisy as x and y, lies
    along X instead of Z, and its x along Z (the paper's section 2.2; its own boards lie in parallel).
    """
    table = tomllib.loads(martin2013().text)
    table["array"]["name"] = "perpendicular"
    table["sensor"] = [entry for entry in table["sensor"] if entry["chip"] in ("adxl345", "bmp180")]
    next(entry for entry in table["sensor"] if entry["name"] == "ADXL2")["axes"] = "+Z-Y+X"
    return parse_array(tomli_w.dumps(table), "perpendicular")


ARRAYS: Mapping[str, Callable[[], ArrayConfig]] = {"martin2013": martin2013, "perpendicular": perpendicular}
"""Arrays by name."""

SETS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "all": ("martin2013", ()),
    "4 BMA180": ("martin2013", ("BMA1", "BMA2", "BMA3", "BMA4")),
    "2 ADXL345": ("perpendicular", ("ADXL1", "ADXL2")),
}
"""A set of sensors that is fused: the array and the names of its sensors (none: all). The angular rate of "all" is that
of Gyro1, Gyro2 and Gyro3, and its specific force that of all six accelerometers.
"""

RATE_HZ = 48.0
"""Frames per second: approximately the rate of the paper's array. At exactly 50 Hz, the 50 Hz tone of the gyroscopes
would be a constant.
"""

TUMBLE_S, HEATING_S, BOOT_S = 300.0, 900.0, 30.0
BOOTS = 12
_FIRST_BOOT = 1000
"""First boot number of the logs for calibration, larger than that of any log that is fused."""

FAULTS = ("range_reset",)
"""Effect that is never simulated: a unit that starts in another range is a fault to be detected, not an error to be
averaged.
"""

SLOPES = "measured"
NO_SLOPES = "no slopes"
TRUE = "true"

RANGES: Mapping[str, Mapping[float, float]] = {name: spec.sensitivity for name, spec in CHIPS.items()}


def simulate(array: ArrayConfig, motion: Motion, seed: int, boot: int, without: Collection[str]) -> Simulation:
    """Return the array with the units of the model `martin2013`, polled `RATE_HZ` times a second."""
    model = load_model(configs() / "models" / "martin2013.toml")
    plan = plan_of(array, RATE_HZ, motion.seconds)
    return Simulation(plan, motion, effects_of(plan, model, seed, without=without), seed=seed, boot=boot)


@lru_cache(maxsize=4)
def calibrate_units(array_name: str, seed: int) -> Mapping[str, Calibration]:
    """Return the calibrations by name: "no slopes", biases and responses from the six faces with noise and turn-on;
    "measured", the same with slopes from a heating log. The result is cached: all experiments with one seed have the
    same units.
    """
    array = ARRAYS[array_name]()
    with TemporaryDirectory(prefix="imuarray_study_") as folder, ExitStack() as stack:

        def recorded(experiment: str, seconds: float, boot: int) -> Log:
            motion = MOTIONS[experiment](ExperimentOptions(seconds=seconds, run=max(boot, 1)))
            path = Path(folder) / f"calibrating_{experiment}_{boot}.h5"
            write_log(simulate(array, motion, seed, _FIRST_BOOT + boot, FAULTS), path)
            return stack.enter_context(open_log(path))

        tumble = recorded("tumble", TUMBLE_S, 0)
        boots = [recorded("turn-on", BOOT_S, boot) for boot in range(1, BOOTS + 1)]
        calibration = calibrate_tumble(tumble).calibration.merged(calibrate_noise(tumble))
        calibration = calibration.merged(calibrate_turn_on(boots, RANGES)[0])
        slopes = calibrate_thermal(recorded("heating", HEATING_S, BOOTS + 1)).calibration
        return {NO_SLOPES: calibration, SLOPES: calibration.merged(slopes)}


CAUSAL, SMOOTHED = "bound, causal", "bound, smoothed"
"""Name of the posterior mean among the techniques: it reaches the bound on the same readings."""

OPTIMAL_CAUSAL = "optimal, causal"
"""`optimal` as in the fusion of a live log; `optimal` itself uses the whole log."""

COASTING = ("heading", "velocity")


@dataclass(frozen=True)
class StudyExperiment:
    """Experiment of the study: the motion of the box (`imuarray.simulate.experiments`), its length, the number of
    switch-ons, and whether the bound holds.

    The bound does not hold for a motion that is fast compared with the chips' data rates, because a reading is up to
    one conversion period old and the bound does not include this delay.
    """

    motion: str
    seconds: float
    drive: str = "hand"
    boots: int = 1
    is_bounded: bool = True


EXPERIMENTS: Mapping[str, StudyExperiment] = {
    "static": StudyExperiment("static", 300.0),
    "tumble": StudyExperiment("tumble", 300.0),
    "heating": StudyExperiment("heating", 660.0),
    "turn-on": StudyExperiment("turn-on", 75.0, boots=4),
    "motion": StudyExperiment("motion", 120.0, "vehicle"),
    "shaking": StudyExperiment("motion", 120.0, "hand", is_bounded=False),
}
"""Experiments by name. "heating" is the paper's profile in a tenth of its time, with the full rise of 28 degC."""


_BOOTS_APART = 100
"""Distance between the first boots of two experiments, so that no two share random draws."""


@dataclass(frozen=True)
class RunErrors:
    """Mean squares of one run: experiment, sensors and technique, the quantity ("" for coasting), and by `measure` and
    box axis the mean square in SI (deg, m/s for coasting). `bound` has the mean squares of the bound (only for "rms");
    `normalised` the mean normalised error squared, and whether it is in its interval.
    """

    experiment: str
    calibration: str
    sensors: str
    technique: str
    quantity: str
    replicate: tuple[int, int]
    squares: Mapping[tuple[str, str], float]
    bound: Mapping[str, float] = field(default_factory=dict)
    normalised: float | None = None
    holds: bool | None = None


def run(name: str, seed: int, seconds: float | None = None) -> list[RunErrors]:
    """Return all results of one experiment with one seed; `seconds` replaces its own length."""
    rows: list[RunErrors] = []
    with TemporaryDirectory(prefix="imuarray_study_") as folder:
        for array_name, make in ARRAYS.items():
            array = make()
            (place := Path(folder) / array_name).mkdir()
            calibrations = calibrate_units(array_name, seed)
            first = _BOOTS_APART * list(EXPERIMENTS).index(name)
            for boot in range(first, first + EXPERIMENTS[name].boots):
                rows += _run_boot(name, (seed, boot), seconds, array, calibrations, place)
    return rows


def _run_boot(
    name: str,
    replicate: tuple[int, int],
    seconds: float | None,
    array: ArrayConfig,
    calibrations: Mapping[str, Calibration],
    folder: Path,
) -> Iterator[RunErrors]:
    """Yield the results of one log with all effects, and of one with only the effects that the error law describes."""
    experiment = EXPERIMENTS[name]
    motion = MOTIONS[experiment.motion](
        ExperimentOptions(seconds=seconds or experiment.seconds, drive=experiment.drive)
    )
    sets = {chosen: names for chosen, (whose, names) in SETS.items() if whose == array.name}
    kinds = ((FAULTS, "all.h5"), (OUTSIDE, "law.h5"))
    for without, file in kinds if experiment.is_bounded else kinds[:1]:
        simulation = simulate(array, motion, *replicate, without)
        write_log(simulation, folder / file, force=True)
        with open_log(folder / file) as log:
            ranges = {sensor.name: RANGES[sensor.chip] for sensor in log.sensors.values()}
            for sensors, names in sets.items():
                label = partial(RunErrors, name, sensors=sensors, replicate=replicate)
                if file == "all.h5":
                    slopes_used = (SLOPES, NO_SLOPES) if name == "heating" else (SLOPES,)
                    for slopes in slopes_used:
                        calibration, _ = start_up_states(log, calibrations[slopes], ranges)
                        for technique, blocks in _results(log, calibration, names).items():
                            of_technique = partial(label, calibration=slopes, technique=technique)
                            yield from _errors_of(error_frames(log, blocks()), of_technique, {})
                else:
                    yield from _compare_with_bound(log, simulation, names, partial(label, calibration=TRUE))


Label = Callable[..., RunErrors]


def _results(
    log: Log, calibration: Calibration, names: tuple[str, ...]
) -> dict[str, Callable[[], Iterator[FusedBlock]]]:
    """Return the functions that fuse the log, by technique."""
    results: dict[str, Callable[[], Iterator[FusedBlock]]] = {
        technique: partial(fuse, log, calibration, technique, only=names) for technique in technique_names()
    }
    results[OPTIMAL_CAUSAL] = partial(fuse, log, calibration, OPTIMAL, only=names, causal=True)
    return results


def _compare_with_bound(log: Log, simulation: Simulation, names: tuple[str, ...], label: Label) -> Iterator[RunErrors]:
    """Yield the errors of the techniques with the true calibration, and of the posterior mean, each with the bound."""
    headers = {
        quantity: [
            sensor.header
            for sensor in simulation.sensors.values()
            if (sensor.header.quantity == quantity and (not names or sensor.header.name in names))
        ]
        for quantity in INERTIAL
    }
    effects = {name: sensor.effects for name, sensor in simulation.sensors.items()}
    laws: dict[str, ErrorLaw] = {quantity: law_of(chosen, effects) for quantity, chosen in headers.items() if chosen}
    calibration = true_calibration([header for chosen in headers.values() for header in chosen], effects)
    posterior = Posterior(log, calibration, laws, names)
    causal = {quantity: bound.causal_rms**2 for quantity, bound in posterior.bounds.items()}
    smoothed = {quantity: bound.smoothed_rms**2 for quantity, bound in posterior.bounds.items()}
    results = _results(log, calibration, names)
    results[CAUSAL] = posterior.blocks
    results[SMOOTHED] = partial(posterior.blocks, smoothed=True)
    for technique, blocks in results.items():
        bounds = smoothed if technique in (OPTIMAL, SMOOTHED) else causal
        yield from _errors_of(error_frames(log, blocks()), partial(label, technique=technique), bounds)


def _errors_of(
    frames_by_quantity: Mapping[str, ErrorFrames], label: Label, bounds: Mapping[str, Floats]
) -> Iterator[RunErrors]:
    for quantity, frames in frames_by_quantity.items():
        result = consistency(frames.errors, frames.covariances)
        measures = {
            "rms": frames.errors,
            "noise": np.diff(frames.errors, axis=0) / np.sqrt(2),
            "drift": ten_second_means(frames.time, frames.errors)[1:],  # relative to the first
        }
        yield label(
            quantity=quantity,
            squares={
                (measure, axis): value
                for measure, part in measures.items()
                if len(part)
                for axis, value in _axis_squares(np.mean(part**2, axis=0)).items()
            },
            bound=_axis_squares(bounds[quantity]) if quantity in bounds else {},
            normalised=None if result is None else result.normalised,
            holds=None if result is None else result.holds,
        )
    if len(frames_by_quantity) == len(INERTIAL):
        coast = coasting(both(frames_by_quantity))
        if len(coast.begins_s):
            ends = zip(COASTING, (coast.heading_deg, coast.velocity_mps), strict=True)
            yield label(quantity="", squares={(measure, ""): float(np.mean(values**2)) for measure, values in ends})


def _axis_squares(squares: Floats) -> dict[str, float]:
    """Return the mean square of each box axis, and their sum, which is that of the length of the error vector."""
    return dict(zip(AXES, [*squares.tolist(), float(squares.sum())], strict=True))


Progress = Callable[[int, int, str], None]
"""Function that receives the number of completed runs, of all runs, and the name of the last one."""

SEEDS = 6
QUICK_SEEDS, QUICK_S = 2, 80.0


@dataclass(frozen=True)
class GainRow:
    """One measure of one technique, over all seeds.

    `value`: root mean square in SI (degrees of heading, m/s of velocity). `over_mean`: relative to the simple average
    of the same sensors; `over_bound`: relative to the bound (only for "rms" with the true calibration), which is the
    smoothed one for techniques that use the whole log and otherwise the causal one. `normalised`: the mean normalised
    error squared, and the share of runs in which it was in its interval ("rms").
    """

    experiment: str
    calibration: str
    sensors: str
    technique: str
    quantity: str
    measure: str
    box_axis: str
    value: float
    over_mean: Ratio
    over_bound: Ratio | None = None
    normalised: float | None = None
    consistent: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the row, JSON-ready; an end of an interval that cannot be determined from one seed is None."""
        return {name: json_value(value) for name, value in vars(self).items()}


@dataclass(frozen=True)
class Study:
    """The rows, their seeds, and the requested length (None: that of each experiment)."""

    rows: tuple[GainRow, ...]
    seeds: tuple[int, ...]
    seconds: float | None = None

    def of(self, **wanted: str) -> list[GainRow]:
        """Return the rows with these properties."""
        return [row for row in self.rows if all(getattr(row, name) == value for name, value in wanted.items())]

    def as_json(self) -> dict[str, Any]:
        """Return the study, JSON-ready."""
        return {
            "seeds": list(self.seeds),
            "experiments": {name: vars(EXPERIMENTS[name]) for name in dict.fromkeys(r.experiment for r in self.rows)},
            "seconds": self.seconds,
            "rows": [row.as_json() for row in self.rows],
        }


def study(
    experiments: Sequence[str] = tuple(EXPERIMENTS),
    seeds: int = SEEDS,
    *,
    seconds: float | None = None,
    executor: Executor | None = None,
    progress: Progress = lambda done, total, what: None,
) -> Study:
    """Return every technique in these experiments with seeds 1 ... `seeds`; `executor` distributes the runs, without
    effect on the result. `seconds` replaces the length of every log.
    """
    jobs = [(name, seed) for seed in range(1, seeds + 1) for name in experiments]
    names, numbers = [name for name, _ in jobs], [seed for _, seed in jobs]
    work = (executor.map if executor else map)(partial(run, seconds=seconds), names, numbers)
    measured: list[RunErrors] = []
    for done, ((name, seed), rows) in enumerate(zip(jobs, work, strict=True), 1):
        measured += rows
        progress(done, len(jobs), f"{name}, seed {seed}")
    return Study(tuple(rows_of(measured)), tuple(range(1, seeds + 1)), seconds)


def rows_of(measured: Iterable[RunErrors]) -> list[GainRow]:
    """Return the rows of all runs; boots of one seed share their calibration and count as one."""
    groups: dict[tuple[str, ...], list[RunErrors]] = defaultdict(list)
    for item in measured:
        groups[item.experiment, item.calibration, item.sensors, item.technique, item.quantity].append(item)
    rows = []
    for (experiment, calibration, sensors, technique, quantity), runs in groups.items():
        average = groups[experiment, calibration, sensors, AVERAGE, quantity]
        for measure, axis in runs[0].squares:
            before, after = (
                _seed_means(several, [item.squares[measure, axis] for item in several]) for several in (average, runs)
            )
            is_rms = measure == "rms"
            bounds = _seed_means(runs, [item.bound[axis] for item in runs]) if is_rms and runs[0].bound else None
            rows.append(
                GainRow(
                    experiment, calibration, sensors, technique, quantity, measure, axis,
                    value=math.sqrt(after.mean()),
                    over_mean=ratio_of(before, after),
                    over_bound=None if bounds is None else ratio_of(bounds, after),
                    normalised=_mean([item.normalised for item in runs]) if is_rms else None,
                    consistent=_mean([item.holds for item in runs]) if is_rms else None,
                )
            )  # fmt: skip
    return rows


def _seed_means(runs: Sequence[RunErrors], squares: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return means of the runs' squares, one for each seed."""
    results: dict[int, list[float]] = defaultdict(list)
    for item, square in zip(runs, squares, strict=True):
        results[item.replicate[0]].append(square)
    return np.array([np.mean(several) for several in results.values()])


def _mean(values: Sequence[float | None]) -> float | None:
    numbers = [float(value) for value in values if value is not None]
    return sum(numbers) / len(numbers) if numbers else None


_HEAD = f"  {'':18} {'rms':>8} {'over the average':>23} {'its drift':>23} {'over the bound':>23} {'normalised^2':>12}"

_NEGLIGIBLE = 5e-4
"""Change of a ratio that is not visible in three digits."""

_WIDE = 20.0
"""Ratio of the ends of an interval above which it has no information."""

WORDS = {
    "measured": "calibrated",
    "no slopes": "calibrated, no slopes with temperature",
    "true": "true parameters, model right",
}
"""The words for each kind of calibration."""


def render_text(study: Study) -> str:
    """Return the results as text: the lengths of error vectors, one line for each technique that changes the result;
    then the results of coasting.
    """
    return "".join(f"{line}\n" for line in _lines(study))


def _lines(study: Study) -> Iterator[str]:
    yield f"seeds {study.seeds[0]} to {study.seeds[-1]}; error of the whole vector, 95 % intervals over the seeds"
    groups = dict.fromkeys((row.experiment, row.sensors, row.calibration) for row in study.rows)
    for experiment, sensors, calibration in groups:
        rows = study.of(experiment=experiment, sensors=sensors, calibration=calibration)
        yield ""
        yield f"{experiment}: {sensors}, {WORDS[calibration]}"
        yield _HEAD
        for quantity in INERTIAL:
            vectors = [row for row in rows if row.quantity == quantity and row.box_axis == "XYZ"]
            for row in [row for row in vectors if row.measure == "rms" and is_shown(row)]:
                yield _vector_line(
                    row, next(r for r in vectors if r.technique == row.technique and r.measure == "drift")
                )
        yield from _coasting_lines([row for row in rows if not row.quantity])


def differs(row: GainRow) -> bool:
    """Return whether a technique changes the result of the average."""
    return abs(row.over_mean.ratio - 1) > _NEGLIGIBLE


def is_shown(row: GainRow) -> bool:
    """Return whether a row is of the average or of a technique that changes its result."""
    return row.technique == AVERAGE or differs(row)


def _vector_line(row: GainRow, drift: GainRow) -> str:
    factor, unit = READABLE_SI[row.quantity]
    over_bound = "" if row.over_bound is None else interval_text(row.over_bound)
    normal = (
        "" if row.normalised is None or row.consistent is None else f"{row.normalised:.2f} ({percent(row.consistent)})"
    )
    value = f"{factor * row.value:8.3f} {unit:3}"
    return (
        f"  {row.technique:15} {value} {interval_text(row.over_mean):>22}"
        f" {interval_text(drift.over_mean):>23} {over_bound:>23} {normal:>12}"
    )


def _coasting_lines(rows: Sequence[GainRow]) -> Iterator[str]:
    for row in [row for row in rows if row.measure == "heading"]:
        velocity = next(r for r in rows if r.technique == row.technique and r.measure == "velocity")
        if is_shown(row) or differs(velocity):
            yield (
                f"  {row.technique:15} after 60 s: heading {row.value:.3f} deg, {interval_text(row.over_mean)};"
                f" velocity {velocity.value:.3f} m/s, {interval_text(velocity.over_mean)}"
            )


def interval_text(ratio: Ratio) -> str:
    """Return a ratio as text, with its interval if there is one."""
    if ratio.low == ratio.high or not ratio.low < ratio.high:
        return f"{ratio.ratio:.3f}"
    if ratio.high > _WIDE * ratio.low:
        return f"{ratio.ratio:.3f} (too few seeds)"
    return f"{ratio.ratio:.3f} ({ratio.low:.3f}-{ratio.high:.3f})"
