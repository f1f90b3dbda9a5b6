"""Table 8: slopes with temperature, beside what the data sheets allow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import sqrt

import numpy as np

from imuarray.paper.gap.candidate import Discrepancy, discrepancy, scored, with_checks, with_errors
from imuarray.paper.gap.chance import heated_line
from imuarray.paper.gap.sensor import Array, Floats, Sensor, data_sheet, printed, sigma
from imuarray.paper.model_units import runs_of
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.room import DEGC, FACES_DEGC
from imuarray.paper.startup import bias_states, boot_faults
from imuarray.paper.tables import number_in, table
from imuarray.simulate.effects.random_walk import RandomWalk
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.thermal_scale import ThermalScale
from imuarray.simulate.population import Spread

_NUMBERS = 54


def slopes(array: Array) -> Discrepancy:
    """Table 8's slopes and Table 11's in-run deviations, with `thermal_bias`, `thermal_scale` (axes that carry 1 g),
    drift by chance (`random_walk`) and the data sheet's population alone as candidates.
    """
    found = {name: _printed(name) for name in array}
    bias = {name: (ThermalBias(_triple(found[name] * s.lsb)),) for name, s in array.items()}
    scale = {name: (_thermal_scale(s, found[name]),) for name, s in array.items() if s.header.unit == "g"}
    walk = {name: (RandomWalk(_triple(_walk(found[name]) * s.lsb)),) for name, s in array.items()}
    candidates = [
        scored(array, ("thermal_bias",), bias, 27, _belongs),
        scored(array, ("thermal_scale",), scale, 6, _belongs, leaves="gyroscopes, and axes that carry no force"),
        scored(array, ("random_walk",), walk, 27, _belongs, leaves="why the same axes hardly wander within a run"),
        scored(array, (), {}, 0, _belongs, leaves="all of it"),
    ]
    result = discrepancy(array, "slopes", "Table 8: biases follow the temperature", candidates, _NUMBERS, _belongs)
    checks = [*_runs_against_temperature(array), *_levels(array)]
    result = with_checks(result, checks, slopes=[row for sensor in array.values() for row in allowed(sensor)])
    errors = {name: [slope_error(sensor, axis) * sensor.lsb for axis in range(3)] for name, sensor in array.items()}
    return with_errors(result, slope_per_degc=errors)


def _belongs(row: Statistic) -> bool:
    return row.statistic in ("slope_lsb_per_degc", "cont_std_of_means")


def _triple(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _printed(name: str) -> Floats:
    """(3,) counts per degC."""
    return np.array([printed(8, f"{name} {axis}", "slope_lsb_per_degc") for axis in "xyz"])


def _thermal_scale(sensor: Sensor, slope: Floats) -> ThermalScale:
    """As a share of the force, on the axis that carries it."""
    force = sensor.response[:, 2]
    carries = np.abs(force) * sensor.lsb > 0.5
    return ThermalScale(_triple(np.where(carries, slope / np.where(carries, force, 1.0), 0.0)))


def _walk(slope: Floats) -> Floats:
    """(3,) density by which such slopes come about by chance."""
    return np.asarray(np.abs(slope) / sqrt(heated_line().slope[2]))


def slope_error(sensor: Sensor, axis: int) -> float:
    """Standard error of a printed slope in counts per degC: in-run wander, white noise, rounding."""
    return sqrt(heated_line().variances(sensor, axis)[0] + (0.0005 / sqrt(3)) ** 2)


def allowed(sensor: Sensor) -> Iterator[dict[str, object]]:
    """By axis, in the unit per degC: the slope found with its error, the data sheet's sigma and limit."""
    key = f"slope_{sensor.header.unit}_per_degc"
    deviations = sigma(sensor.header, "thermal_bias", key)
    for axis in range(3):
        channel = f"{sensor.name} {'xyz'[axis]}"
        slope = printed(8, channel, "slope_lsb_per_degc") * sensor.lsb
        error, limit = slope_error(sensor, axis) * sensor.lsb, _limit(sensor, key, axis)
        yield {
            "channel": channel,
            key: slope,
            "error": error,
            "data_sheet_sigma": float(deviations[axis]),
            "data_sheet_limit": limit,
            "z_against_zero": slope / error,
            "z_against_data_sheet": slope / float(np.hypot(deviations[axis], error)),
            "beyond_limit": bool(abs(slope) > limit + 2 * error),
            "carries_1g": bool(abs(sensor.response[axis, 2]) * sensor.lsb > 0.5 and sensor.header.unit == "g"),
        }


def _limit(sensor: Sensor, key: str, axis: int) -> float:
    """The furthest from its mean that the data sheet's population goes."""
    (recipe,) = data_sheet().parts(sensor.header)["thermal_bias"].effects["thermal_bias"]
    figure = recipe[key]
    one = figure[axis] if isinstance(figure, tuple) else figure
    return float(one.reach) if isinstance(one, Spread) else 0.0


def _runs_against_temperature(array: Array) -> Iterator[Mapping[str, object]]:
    """Single runs against the sensor's own thermometer (Tables 6 and 7; odd run out, Gyro3 within its states)."""
    for name, codes_per_degc in (("BMA1", 2.0), ("Gyro3", -1.0)):
        rows = table(6 if name == "BMA1" else 7)
        degc = np.array([float(number_in(row, "temp_int")) for row in rows]) / codes_per_degc
        runs, groups = runs_of(name), _alike(name)
        warm, apart = (_centred(values, groups) for values in (degc[:, None], runs))
        freedom = len(warm) - len(groups) - 1
        for axis in range(3):
            slope = float(warm[:, 0] @ apart[:, axis] / (warm[:, 0] @ warm[:, 0]))
            left = apart[:, axis] - slope * warm[:, 0]
            error = sqrt(float(left @ left) / freedom / float(warm[:, 0] @ warm[:, 0]))
            known = printed(8, f"{name} {'xyz'[axis]}", "slope_lsb_per_degc")
            own = slope_error(array[name], axis)
            yield {
                "check": f"Table 8's slope foretells {name} {'xyz'[axis]} over its thermometer, run by run",
                "foretold": known,
                "printed": slope,
                "sd": float(np.hypot(error, own)),
                "z": (known - slope) / float(np.hypot(error, own)),
                "unit": "LSB/degC",
            }


def _alike(name: str) -> list[list[int]]:
    """Indices of runs that share a level."""
    if name == "Gyro3":
        return [[run - 1 for run in state.runs] for state in bias_states()]
    faulty = {fault.run for fault in boot_faults()}
    return [[run for run in range(len(table(6))) if run + 1 not in faulty]]


def _centred(values: Floats, groups: list[list[int]]) -> Floats:
    return np.concatenate([values[group] - values[group].mean(axis=0) for group in groups])


def _levels(array: Array) -> Iterator[Mapping[str, object]]:
    """Slopes foretell how Table 11's levels differ from Table 10's: regression through 0, weights 1 / noise."""
    for column in ("runs_mean", "cont_mean"):
        foretold, found = [], []
        for name, sensor in array.items():
            if name in ("BMA1", "Gyro3") and column == "runs_mean":
                continue
            for axis in range(3):
                channel, weight = f"{name} {'xyz'[axis]}", 1 / float(sensor.rounded_noise[axis])
                warm = DEGC[11, column] - FACES_DEGC[0]
                foretold.append(printed(8, channel, "slope_lsb_per_degc") * warm * weight)
                found.append((printed(11, channel, column) - printed(10, channel, "z_up")) * weight)
        x, y = np.array(foretold), np.array(found)
        picks = np.random.Generator(np.random.Philox(13)).integers(len(x), size=(2000, len(x)))
        slopes_found = (x[picks] * y[picks]).sum(axis=1) / (x[picks] ** 2).sum(axis=1)
        low, high = np.quantile(slopes_found, [0.025, 0.975])
        yield {
            "check": f"Table 8's slopes foretell {column} of Table 11 from Table 10's z_up (1: exactly)",
            "share": float(x @ y / (x @ x)),
            "ci95": [float(low), float(high)],
        }
