"""`calibrate turn-on`: change of a bias from one switch-on to the next, beyond its change within a run.

Runs with a start-up fault are excluded first; the others are tested for two states. The remaining scatter about the
states, and about a line in temperature (a warm-up is not a turn-on change), is compared with the variance of a run's
mean that the scatter within runs predicts: for each noise that the runs may have, the ratio of the two variances
follows an F distribution if switching on changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.fits import refuse_imprecise
from imuarray.calibrate.model import BiasState, Calibration, TurnOn, nominal
from imuarray.calibrate.motion import motion_in, refuse_other_poses
from imuarray.calibrate.runs import (
    NO_RANGES,
    SIGNIFICANT,
    BootFault,
    Ranges,
    SensorRuns,
    explained_range,
    isolated_runs,
    read_runs,
    run_stretches,
    two_states,
)
from imuarray.errors import CalibrationError
from imuarray.log import Log, require_logs
from imuarray.printable import counted
from imuarray.units import INERTIAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NONE: Mapping[float, float] = MappingProxyType({})

_FEWEST_RUNS = 3

MOST_SEM: Mapping[str, float] = MappingProxyType({"specific_force": 0.05, "angular_rate": 10.0})
"""Largest standard error of a measured change from run to run, by quantity in its unit: about the tolerance of the
whole zero level in the data sheets (BMA-113: 60 mg; L3G-70: 10 dps).
"""
_IMPRECISE = (
    "these runs determine the change of the {axis} bias from run to run only to {sem} {unit}; readings change as much"
    " within a run"
)


@dataclass(frozen=True)
class TurnOnResult:
    """Turn-on changes of one sensor, arrays (3,) in counts.

    `run_sd_lsb` is the standard deviation from run to run about the states and about the line in temperature, with
    `run_freedom` degrees of freedom; `in_run_sd_lsb` the standard deviation of a run's mean by the scatter within runs,
    with `in_run_freedom`; `p_value` the probability of a ratio at least as large if switching on does not change the
    bias, not corrected for many axes (`holm`). These are nan if the scatter within runs is not known.
    `slope_lsb_per_degc` is None without temperatures. `p_states` is the probability of a split at least as good by
    chance; there is one state unless it is below 0.01, divided by the number of sensors. `apart` are the runs with a
    start-up fault.
    """

    runs: SensorRuns
    apart: tuple[BootFault, ...]
    states: tuple[BiasState, ...]
    p_states: float
    slope_lsb_per_degc: Floats | None
    run_sd_lsb: Floats
    run_freedom: int
    in_run_sd_lsb: Floats
    in_run_freedom: Floats
    p_value: Floats

    def turn_on(self) -> TurnOn:
        """Return the figures for the calibration file.

        The scatter within runs is subtracted from the variance; the standard error of the root is of first order, or,
        where the difference is about zero, the root of half the variance's error.
        """
        inside = np.nan_to_num(self.in_run_sd_lsb) ** 2
        variance = self.run_sd_lsb**2
        rms = np.sqrt(np.maximum(variance - inside, 0.0))
        error = np.sqrt(2 * variance**2 / self.run_freedom + np.nan_to_num(2 * inside**2 / self.in_run_freedom))
        return TurnOn(
            rms_lsb=rms,
            rms_sem_lsb=error / (2 * np.maximum(rms, np.sqrt(error / 2) + 1e-12)),
            spread_lsb=self.run_sd_lsb,
            p_value=self.p_value,
            runs=len(self.runs.numbers) - len(self.apart),
            states=self.states,
            apart=tuple(fault.run for fault in self.apart),
            gravity_lsb=self.runs.gravity_lsb if self.runs.gravity_lsb.any() else None,
        )


class TurnOnSeries(NamedTuple):
    """Result of `calibrate_turn_on`: the calibration (of `turn_on` only), and the result of every sensor."""

    calibration: Calibration
    results: tuple[TurnOnResult, ...]

    def plot(self) -> Figure:
        """Plot the change of the bias from run to run of every axis with two standard errors, in mg or dps;
        MissingExtraError without matplotlib.
        """
        return self.calibration.plot("turn_on")

    def __repr__(self) -> str:
        runs = max((len(result.runs.numbers) for result in self.results), default=0)
        return f"<TurnOnSeries of {counted(runs, 'run')}: {len(self.results)} sensors>"

    def _repr_html_(self) -> str:
        """Return a table of the changes from run to run with standard errors, for notebooks."""
        from imuarray.calibrate.plots import turn_on_rows
        from imuarray.html_table import html_table

        sentence = f"Change of the bias from run to run, of {len(self.results)} sensors"
        heading = ("axis", "unit", "run to run", "standard error", "runs", "states", "p of no change")
        return html_table(sentence, heading, turn_on_rows(self.calibration))


def calibrate_turn_on(logs: Sequence[Log], ranges: Ranges = NO_RANGES, seed: int = 1) -> TurnOnSeries:
    """Measure the turn-on changes of every inertial sensor from runs in one pose, between which it was switched off:
    one log per run, or one phase `run <k>` per run.

    `ranges` are the sensitivities by which a start in a wrong range is identified. CalibrationError for fewer than
    three runs, and for logs of different configurations or poses.
    """
    if not logs:
        raise CalibrationError("no log")
    require_logs(logs, "calibrate_turn_on(logs)")
    sensors = [sensor for sensor in logs[0].sensors.values() if sensor.quantity in INERTIAL]
    if not sensors:
        raise CalibrationError(f"{logs[0].path}: it has no inertial sensor")
    _refuse_moving(logs)
    results, calibrated = [], {}
    for sensor in sensors:
        result = compare_runs(read_runs(logs, sensor), ranges.get(sensor.chip, {}), seed, SIGNIFICANT / len(sensors))
        turn_on = result.turn_on()
        refuse_imprecise(sensor, turn_on.rms_sem_lsb, MOST_SEM, _IMPRECISE)
        results.append(result)
        calibrated[sensor.name] = replace(nominal(sensor), turn_on=turn_on)
    return TurnOnSeries(Calibration(calibrated, tuple(str(log.path) for log in logs)).stamped(logs), tuple(results))


def _refuse_moving(logs: Sequence[Log]) -> None:
    """Raise CalibrationError for runs in which the box moved, and for runs in several poses."""
    names: list[str] = []
    forces: list[Floats] = []
    for place, log in enumerate(logs, start=1):
        for name, start_ns, end_ns in run_stretches(log, place):
            if words := motion_in(log, start_ns, end_ns):
                raise CalibrationError(f"{name}: {words}")
            medians_g = [
                np.median(counts, axis=0) @ sensor.orientation.T / sensor.sensitivity
                for sensor in log.of("specific_force")
                if sensor.sensitivity > 0 and len(counts := sensor.counts[sensor.between(start_ns, end_ns)])
            ]
            names.append(name)
            forces.append(np.mean(medians_g, axis=0) if medians_g else np.full(3, np.nan))
    refuse_other_poses(names, np.array(forces).reshape(-1, 3))


def compare_runs(
    runs: SensorRuns, ranges: Mapping[float, float] = _NONE, seed: int = 1, significant: float = SIGNIFICANT
) -> TurnOnResult:
    """Evaluate the runs of one sensor (see the head of this file); CalibrationError if fewer than three are usable.

    `significant` is the level of the test for two states, divided by the number of sensors that are tested.
    """
    faults = _faults(runs, ranges)
    used = [place for place, number in enumerate(runs.numbers) if number not in {fault.run for fault in faults}]
    if len(used) < _FEWEST_RUNS:
        raise CalibrationError(
            f"sensor {runs.sensor}: {counted(len(used), 'sound run')}, at least {_FEWEST_RUNS} are required"
        )
    means, warm = runs.mean_lsb[used], None if runs.temperature_degc is None else runs.temperature_degc[used]
    second, p_states = two_states(means, warm, seed)
    groups = [~second, second] if p_states < significant else [np.ones(len(used), bool)]
    slope, sd, freedom = _fit_about(means, groups, warm)
    inside = runs.in_run(used)
    numbers = np.array(runs.numbers)[used]
    states = tuple(
        BiasState(means[group].mean(axis=0) - runs.gravity_lsb, float(group.mean()), tuple(numbers[group].tolist()))
        for group in groups
    )
    in_run = np.full((3, 3), np.nan)
    if inside:
        chances = [run.chance_of(float(spread) ** 2, freedom) for run, spread in zip(inside, sd, strict=True)]
        in_run = np.array([[run.mean**0.5 for run in inside], [run.freedom for run in inside], chances])
    return TurnOnResult(runs, faults, states, p_states, slope, sd, freedom, *in_run)


def holm(p_values: npt.ArrayLike) -> Floats:
    """Correct p-values (n,) for multiple testing: a corrected value below 0.05 is a false alarm in one of twenty sets
    of n values (Holm, Scand. J. Stat. 6, 1979, p. 65). nan remains nan and does not count.
    """
    values = np.asarray(p_values, float)
    limits = np.full(len(values), np.nan)
    finite = np.flatnonzero(np.isfinite(values))
    order = finite[np.argsort(values[finite])]
    raised = values[order] * np.arange(len(order), 0, -1)
    limits[order] = np.minimum(np.maximum.accumulate(raised), 1.0)
    return limits


def _faults(runs: SensorRuns, ranges: Mapping[float, float]) -> tuple[BootFault, ...]:
    """Return the runs with a start-up fault: without a valid reading, in another range, or far from all others."""
    is_read = np.asarray(np.isfinite(runs.mean_lsb).all(axis=1))
    if not is_read.any():
        raise CalibrationError(f"sensor {runs.sensor}: no valid readings in any run")
    usual = np.median(runs.mean_lsb[is_read], axis=0)
    ranges_of_runs: list[tuple[float, float | None]] = [(np.nan, None)] * len(is_read)
    if runs.quantity == "specific_force":  # a gyroscope's bias does not depend on its range
        ranges_of_runs = [explained_range(mean, usual, runs.sensitivity, ranges) for mean in runs.mean_lsb]
    wrong = ~is_read | np.array([span is not None for _, span in ranges_of_runs])
    sound = np.flatnonzero(~wrong)
    floor = np.array([pool.mean for pool in runs.in_run(sound.tolist())] or [0.0] * 3) ** 0.5
    wrong[sound[isolated_runs(runs.mean_lsb[sound], floor)]] = True
    return tuple(BootFault(runs.numbers[i], *ranges_of_runs[i], runs.unit) for i in np.flatnonzero(wrong))


def _fit_about(
    means: Floats, groups: Sequence[npt.NDArray[np.bool_]], warm: Floats | None
) -> tuple[Floats | None, Floats, int]:
    """Return the slope with temperature (3,), the standard deviation (3,) of run means (r, 3) about their groups and
    that slope, and its degrees of freedom. The slope is None without temperatures, if they are all equal, or with too
    few runs.
    """
    design = np.array(groups, float).T
    usable = warm is not None and np.ptp(warm) > 0 and len(means) > len(groups) + _FEWEST_RUNS - 1
    if usable and warm is not None:
        design = np.column_stack([design, warm - warm.mean()])
    values, _, rank, _ = np.linalg.lstsq(design, means, rcond=None)
    freedom = len(means) - int(rank)
    sd = np.sqrt(((means - design @ values) ** 2).sum(axis=0) / freedom)
    return (values[-1] if usable else None), sd, freedom
