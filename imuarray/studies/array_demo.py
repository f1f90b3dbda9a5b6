"""`imuarray demo --array NAME`: the whole path on any emulated array with accelerometers and gyroscopes.

The runs are those of `imuarray.studies.demo`: six faces, a long rest, a heating, a shaking. The emulated world provides
the truth, so that the errors of each sensor, of their average and of each technique can be measured. The sensors are
polled; queues are switched off, because the demonstration needs few samples.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imuarray.array import ArrayConfig, load_array
from imuarray.atomic import write_text
from imuarray.calibrate import Calibration, TumbleResult
from imuarray.errors import ConfigError, LogError
from imuarray.fuse import errors_of, fuse
from imuarray.gap.findings.diagnosis import Diagnosis
from imuarray.log import Log, open_log
from imuarray.report import Figure, Section, Table, Verdict, write_page
from imuarray.studies.demo import (
    calibration_section,
    common_figures,
    demo_summary,
    diagnose_rest,
    drift_of_gyroscopes,
    gap_section,
    noise_section,
    prepare_folder,
    record_and_fuse,
    recorded_section,
)
from imuarray.studies.emulated_runs import DemoOptions, Report
from imuarray.units import INERTIAL, READABLE_SI

TECHNIQUES = ("mean", "opposed", "optimal")
_RUNS = {"static": "at rest", "heating": "heated", "shaking": "shaken"}


@dataclass(frozen=True)
class ArrayError:
    """The errors of one quantity against the truth in one run, in SI, rms over the three axes: of each single sensor by
    its name, and of the fused results by technique.
    """

    run: str
    quantity: str
    single: Mapping[str, float]
    fused: Mapping[str, float]

    @property
    def typical(self) -> float:
        """The median of the sensors."""
        return float(np.median(list(self.single.values())))

    def ratio(self, technique: str) -> float:
        """Return the error of a technique divided by that of the median sensor."""
        return self.fused[technique] / self.typical


def run_array_demo(config: Path, folder: Path, options: DemoOptions, report: Report) -> dict[str, Any]:
    """Record, calibrate, fuse and report an array into `folder`; return the summary, JSON-ready. ConfigError for an
    array without accelerometers or gyroscopes, OutputExistsError before anything is recorded, unless `options.force`.
    """
    array = load_array(config)
    for quantity in INERTIAL:
        if not any(sensor.spec.quantity == quantity for sensor in array.sensors):
            raise ConfigError(f"{config}: no sensor of {quantity.replace('_', ' ')}; the demonstration needs both")
    polled = prepare_folder(folder, options.force, ("array.toml",)) / "array.toml"
    write_text(polled, polled_text(array), force=True)
    logs, tumble, calibration = record_and_fuse(polled, folder, options, report)
    errors = [error for run in _RUNS for error in errors_in(run, logs[run], calibration)]
    diagnosis, noise = diagnose_rest(logs["static"], folder, one_of_each(array), options.seed, report)
    counts = Counter(sensor.chip for sensor in array.sensors)
    chips = ", ".join(f"{number} {chip}" for chip, number in counts.items())  # "8 icm42688_acc, 8 icm42688_gyro"
    parts = [
        errors_section(errors),
        heating_section(logs["heating"], calibration),
        recorded_section(logs, f"The array {array.name}, emulated register by register: {chips}."),
        calibration_section(tumble),
        noise_section(noise),
        gap_section(diagnosis),
    ]
    lines = summary(errors)
    verdict = verdict_of(errors, tumble, diagnosis)
    title = f"The array {array.name}, emulated, recorded, calibrated and fused"
    write_page(folder / "report.html", title, lines, parts, verdict=verdict, force=True)
    return demo_summary(folder, lines, {"errors": [vars(error) for error in errors]}, tumble, diagnosis)


def polled_text(array: ArrayConfig) -> str:
    """Return the configuration of the array without the queues of its chips."""
    return re.sub(r"\bfifo(\s*=\s*)true\b", r"fifo\1false", array.text)


def one_of_each(array: ArrayConfig) -> tuple[str, ...]:
    """Return the first inertial sensor of each chip and quantity."""
    first: dict[str, str] = {}
    for sensor in array.sensors:
        if sensor.spec.quantity in INERTIAL:
            first.setdefault(sensor.chip, sensor.name)
    return tuple(first.values())


def errors_in(run: str, path: Path, calibration: Calibration) -> list[ArrayError]:
    """Return the errors of every sensor and technique in one run, of both quantities."""
    with open_log(path) as log:
        by_technique = {technique: _rms(log, calibration, technique) for technique in TECHNIQUES}
        return [
            ArrayError(
                run,
                quantity,
                {sensor.name: _rms(log, calibration, "mean", sensor.name)[quantity] for sensor in log.of(quantity)},
                {technique: rms[quantity] for technique, rms in by_technique.items()},
            )
            for quantity in INERTIAL
        ]


def _rms(log: Log, calibration: Calibration, technique: str, *names: str) -> dict[str, float]:
    """Return the rms error of a result by quantity, over all axes and frames with a result."""
    errors = errors_of(log, fuse(log, calibration, technique, only=list(names)))
    return {quantity: float(np.sqrt(np.nanmean(np.square(error)))) for quantity, (_, error) in errors.items()}


def summary(errors: list[ArrayError]) -> list[str]:
    """Return the summary: the gain of averaging in each run."""
    return [
        *map(_sentence, errors),
        "All figures are rms errors against the truth of the emulated world, after the calibration from six faces.",
    ]


def _sentence(error: ArrayError) -> str:
    factor, unit = READABLE_SI[error.quantity]
    count = len(error.single)
    sensors = {"specific_force": "accelerometers", "angular_rate": "gyroscopes"}[error.quantity]
    average, best = error.fused["mean"], min(error.fused, key=lambda technique: error.fused[technique])
    return (
        f"{count} {sensors} {_RUNS[error.run]}: {factor * error.typical:.3g} {unit} each (median),"
        f" {factor * average:.3g} {unit} averaged ({error.ratio('mean'):.2f} times; 1/√{count} is {count**-0.5:.2f}),"
        f" least with {best}: {factor * error.fused[best]:.3g} {unit}"
    )


def verdict_of(errors: list[ArrayError], tumble: TumbleResult, diagnosis: Diagnosis) -> Verdict:
    """Return the verdict: the gain of averaging at rest, the quality of the calibration, the gap of the simulator."""
    at_rest = [error for error in errors if error.run == "static"]
    figures = [
        (f"{error.ratio('mean'):.2f} ×", f"error of the average over one sensor's, {error.quantity.replace('_', ' ')}")
        for error in at_rest
    ]
    figures += common_figures(tumble, diagnosis)
    best = min(at_rest, key=lambda error: error.ratio("mean"))
    sentence = (
        f"Averaging works: the error of the {best.quantity.replace('_', ' ')} of {len(best.single)} sensors at rest is"
        f" {best.ratio('mean'):.2f} times that of one sensor."
    )
    return Verdict(sentence, "good" if best.ratio("mean") < 1 else "doubtful", tuple(figures))


def errors_section(errors: list[ArrayError]) -> Section:
    """Return the errors of single sensors and of all together."""
    rows = []
    for error in errors:
        factor, unit = READABLE_SI[error.quantity]
        single = factor * np.array(list(error.single.values()))
        fused = [f"{factor * error.fused[technique]:.4f}" for technique in TECHNIQUES]
        range_texts = [f"{np.median(single):.4f}", f"{single.min():.4f} to {single.max():.4f}"]
        name, count = f"{error.quantity.replace('_', ' ')}, {_RUNS[error.run]}", len(single)
        ratios = [f"{error.ratio('mean'):.3f}", f"{count**-0.5:.3f}"]
        rows.append([name, str(count), *range_texts, *fused, unit, *ratios])
    columns = ["quantity, run", "sensors", "one (median)", "one (range)", *TECHNIQUES, "unit", "mean / one", "1/√n"]
    return Section(
        "What the array gains over one sensor",
        "Rms error over time and axes, against the truth that the emulated world knows. Independent noise falls with"
        " the square root of the number of sensors; what sensors have in common, and what the calibration left, does"
        " not.",
        [Table(columns, rows, "Errors of single sensors, of their average and of two techniques.", (0, 3))],
    )


def heating_section(path: Path, calibration: Calibration) -> Section:
    """Draw the gyroscopes about box Y while the box is heated."""
    with open_log(path) as log:
        truth = log.truth
        if truth is None or truth.temperature is None:
            raise LogError(f"{path}: an emulated log without a true temperature")
        temperature = (np.asarray(truth.time[:]) * 1e-9, np.asarray(truth.temperature[:]))
        figure = drift_of_gyroscopes(log, calibration, temperature)
    return Section(
        "Heated: the drift of the gyroscopes",
        "The box is heated by 28 degrees. The drift of a unit is drawn from its data sheet; opposing the axes removes"
        " only what units of one design share.",
        [
            Figure(
                figure,
                "Five-second means of the error about box Y: of every gyroscope, of their average and with their axes"
                " opposed.",
                "Drift of single gyroscopes, their average and the opposed result while the box is heated",
            )
        ],
    )
