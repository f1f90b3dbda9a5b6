"""Table 11: biases that wander within a run and differ from one run to the next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from imuarray.paper.gap.acting import Effects, with_effects
from imuarray.paper.gap.candidate import (
    Discrepancy,
    discrepancy,
    scored,
    statistics,
    told_from,
    with_checks,
    with_errors,
)
from imuarray.paper.gap.chance import PARTS_OF_RUN, array_rate_hz
from imuarray.paper.gap.sensor import Array, Floats, Sensor, printed
from imuarray.paper.model_units import unit_of
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.wander import TIME_CONSTANT_S
from imuarray.simulate.effects.bias_instability import BiasInstability
from imuarray.simulate.effects.random_walk import RandomWalk
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.turn_on_bias import TurnOnBias

_ODD = ("BMA1", "Gyro3")
"""Their runs are Tables 6 and 7's: other discrepancies."""


def in_run(array: Array) -> Discrepancy:
    """Table 11's deviations of fifteen windows in a row and the drifts of Tables 3 and 4, with `bias_instability`,
    `random_walk`, Table 8's slopes (`thermal_bias`) and no cause as candidates.
    """
    wander = {name: (BiasInstability(_triple(unit_of(name).in_run), TIME_CONSTANT_S),) for name in array}
    walk = {name: (RandomWalk(_triple(walk_density(sensor) * sensor.lsb)),) for name, sensor in array.items()}
    slopes = {name: (ThermalBias(_triple(unit_of(name).slope)),) for name in array}
    candidates = [
        scored(array, ("bias_instability",), wander, 27, _in_run),
        scored(array, ("random_walk",), walk, 27, _in_run),
        scored(array, ("thermal_bias",), slopes, 0, _in_run, leaves="wander at a steady temperature"),
        scored(array, (), {}, 0, _in_run, leaves="all of it"),
    ]
    found = discrepancy(array, "in-run", "Tables 3-5, 11: biases wander within a run", candidates, 54, _in_run)
    found = with_checks(found, _drifts(array, {"bias_instability": wander, "random_walk": walk}))
    return with_errors(found, rms_share=told_from(found.after, "cont_std_of_means"))


def turn_on(array: Array) -> Discrepancy:
    """Table 11's deviations of fifteen runs but for BMA1 and Gyro3, with `turn_on_bias` and none as candidates; slopes
    and in-run wander are in the array already.
    """
    # BMA1's is of its fourteen sound runs, not among the numbers that are scored; Gyro3's belongs to its states
    rms = {name: (TurnOnBias(_triple(unit_of(name).turn_on)),) for name in array if name != "Gyro3"}
    candidates = [
        scored(array, ("turn_on_bias",), rms, 21, _between_runs),
        scored(array, (), {}, 0, _between_runs, leaves="all that in-run wander and temperature don't explain"),
    ]
    found = discrepancy(array, "turn-on", "Table 11: biases differ from run to run", candidates, 21, _between_runs)
    found = with_checks(found, _next_day(array, rms))
    return with_errors(found, rms_share=told_from(found.after, "runs_std_of_means"))


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _in_run(row: Statistic) -> bool:
    return row.statistic in ("cont_std_of_means", "drift_lsb")


def _between_runs(row: Statistic) -> bool:
    return row.statistic == "runs_std_of_means" and row.channel.split()[0] not in _ODD


def walk_density(sensor: Sensor) -> Floats:
    """(3,) counts per root second whose walk scatters fifteen windows as Table 11 prints it, white noise taken out."""
    walk = PARTS_OF_RUN.walk
    per_density = float(np.trace(walk - walk.mean(axis=0))) / (len(walk) - 1)
    channels = [f"{sensor.name} {axis}" for axis in "xyz"]
    deviation = np.array([printed(11, channel, "cont_std_of_means") for channel in channels])
    white = sensor.rounded_noise**2 / (array_rate_hz(11) * PARTS_OF_RUN.seconds)
    return np.asarray(np.sqrt(np.maximum(deviation**2 - white, 0) / per_density))


def _drifts(array: Array, effects: Mapping[str, Effects]) -> Iterator[Mapping[str, object]]:
    """Fitted to Table 11, checked on Tables 3 and 4's drift over six faces."""
    for name, adds in {"(nothing)": {}, **effects}.items():
        rows = [row for row in statistics(with_effects(array, adds)) if row.statistic == "drift_lsb"]
        squares = np.array([row.z**2 for row in rows])
        yield {
            "check": f"{name} fitted to Table 11 foretells the drifts of Tables 3 and 4",
            "mean_z2": float(squares.mean()),
            "ci95": _resampled(squares),
            "median_abs_z": float(np.median(np.sqrt(squares))),
        }


def _next_day(array: Array, adds: Effects) -> Iterator[Mapping[str, object]]:
    """Fitted to fifteen runs of two hours, checked on levels of other days."""
    for name, effects in {"(nothing)": {}, "turn_on_bias": adds}.items():
        rows = [row for row in statistics(with_effects(array, effects)) if row.statistic in LEVELS]
        squares = np.array([row.z**2 for row in rows if row.channel.split()[0] not in _ODD])
        yield {
            "check": f"{name} fitted to runs within two hours foretells levels of other days",
            "mean_z2": float(squares.mean()),
            "ci95": _resampled(squares),
            "median_abs_z": float(np.median(np.sqrt(squares))),
        }


LEVELS = ("runs_mean", "cont_mean", "intercept_lsb")
"""What +Z up reads on other days than Table 10's."""


def _resampled(values: Floats) -> list[float]:
    """95 % of the mean over 2000 resamplings."""
    picks = np.random.Generator(np.random.Philox(11)).integers(len(values), size=(2000, len(values)))
    return [float(edge) for edge in np.quantile(values[picks].mean(axis=1), [0.025, 0.975])]
