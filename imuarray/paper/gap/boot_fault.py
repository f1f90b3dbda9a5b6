"""Table 6: one run of BMA1 is unlike the fourteen others.

A range that a boot fell back to has a bias of its own, of the data sheet's population at that range; so has any other
bias that a boot may draw. Which range it was follows from gravity: its reading is counts per g times (response + bias).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import log

import numpy as np
from scipy.stats import beta

from imuarray.chips import CHIPS
from imuarray.log.format import SensorHeader
from imuarray.paper.gap.candidate import Candidate, Discrepancy, discrepancy, with_checks
from imuarray.paper.gap.sensor import Array, Floats, Sensor, bias_sigma, faces_of
from imuarray.paper.model_units import bma1_reset_noise_share, runs_of
from imuarray.paper.replica.statistic import Statistic
from imuarray.simulate.effects.bistable_bias import BistableBias
from imuarray.simulate.effects.range_reset import RangeReset
from imuarray.simulate.effects.scale import Scale
from imuarray.simulate.effects.turn_on_bias import TurnOnBias

_NAME = "BMA1"
_NUMBERS = 45


def boot_fault(array: Array) -> Discrepancy:
    """BMA1's odd run, with `range_reset` for every other range of the chip, `scale`, `turn_on_bias`, `bistable_bias`
    and no cause as candidates.
    """
    sensor = array[_NAME]
    candidates = [*_resets(sensor), _scaled(sensor), _turned_on(sensor), _second_state(sensor)]
    plain = _steady(sensor) + _odd(sensor, _usual(sensor), _within(sensor))
    candidates.append(Candidate((), {}, 0, plain, "all of it"))
    found = discrepancy(array, "boot fault", "Table 6: one run unlike the others", candidates, _NUMBERS, _belongs)
    return with_checks(found, _held_out(sensor), readings_lsb=_reading().tolist(), usual_lsb=_usual(sensor).tolist())


def _belongs(row: Statistic) -> bool:
    """The odd run, and what Table 11 makes of all of them."""
    spread = row.table == "Table 11" and row.statistic.startswith("runs_") and "of_means" in row.statistic
    odd = row.table == "Table 6" and row.statistic == f"run {_run() + 1}"
    return odd or (spread and row.channel.startswith(_NAME))


def _run() -> int:
    """Index of the run that is furthest from the median of all."""
    runs = runs_of(_NAME)
    return int(np.argmax(np.linalg.norm(runs - np.median(runs, axis=0), axis=1)))


def _reading() -> Floats:
    return np.asarray(runs_of(_NAME)[_run()])


def _usual(sensor: Sensor) -> Floats:
    return np.asarray(np.delete(runs_of(sensor.name), _run(), axis=0).mean(axis=0))


def _within(sensor: Sensor) -> Floats:
    return np.asarray(np.delete(runs_of(sensor.name), _run(), axis=0).std(axis=0, ddof=1))


def _steady(sensor: Sensor) -> float:
    """-2 ln L of the fourteen others."""
    others = np.delete(runs_of(sensor.name), _run(), axis=0)
    return float(((others - others.mean(axis=0)) ** 2 / _within(sensor) ** 2 + 2 * np.log(_within(sensor))).sum())


def _odd(sensor: Sensor, mean: Floats, sd: Floats) -> float:
    """-2 ln L of the odd run."""
    return float((((_reading() - mean) / sd) ** 2 + 2 * np.log(sd)).sum())


def _chance(runs: int = 15) -> float:
    """-2 ln L of one run in so many, the probability fitted."""
    return -2 * (log(1 / runs) + (runs - 1) * log(1 - 1 / runs))


def _resets(sensor: Sensor) -> Iterator[Candidate]:
    """One for each other range: free are the range and the probability; the offset comes with its population."""
    for range_, per_g in CHIPS[sensor.header.chip].sensitivity.items():
        if range_ == sensor.header.range:
            continue
        there = replace(sensor.header, range=range_, sensitivity=per_g)
        mean, sd = _at_range(sensor, there)
        value = _steady(sensor) + _odd(sensor, mean, sd) + _chance()
        offset = _reading() / per_g - _usual(sensor) * sensor.lsb
        noise = bma1_reset_noise_share()
        reset = RangeReset(range_, tuple(offset.tolist()), tuple(noise.tolist()), probability=1 / 15)
        gap = ", ".join(f"{z:+.1f}" for z in (_reading() - mean) / sd)
        yield Candidate(
            ("range_reset",),
            {_NAME: (reset,)},
            2,
            value,
            f"at {range_:g} g the biases would be {gap} of the data sheet's deviations",
            {"offset_g": (_within(sensor) * sensor.lsb).tolist(), "probability": _probability_interval()},
        )


def _at_range(sensor: Sensor, there: SensorHeader) -> tuple[Floats, Floats]:
    """What +Z up reads at another range: response of Table 10, bias of the data sheet's population."""
    response = _measured_response(sensor) * sensor.lsb * there.sensitivity
    spread = bias_sigma(there) * there.sensitivity
    return response, np.asarray(np.hypot(spread, _within(sensor) * sensor.lsb * there.sensitivity))


def _measured_response(sensor: Sensor) -> Floats:
    """(3,) counts per g along box Z."""
    faces = faces_of(sensor.name)
    return np.asarray((faces[:, 0] - faces[:, 5]) / 2)


def _scaled(sensor: Sensor) -> Candidate:
    """One factor for the three axes, fitted to gravity; free with the probability."""
    usual, within = _usual(sensor), _within(sensor)
    weight = usual**2 / within**2
    factor = float((weight * _reading() / usual).sum() / weight.sum())
    value = _steady(sensor) + _odd(sensor, factor * usual, np.abs(factor) * within) + _chance()
    left = ", ".join(f"{off:+.0f}" for off in _reading() - factor * usual)
    left = f"x, y, z of the run off by {left} LSB"
    return Candidate(("scale",), {_NAME: (Scale((factor - 1,) * 3),)}, 2, value, left)


def _turned_on(sensor: Sensor) -> Candidate:
    """An rms of its own for each axis, all fifteen runs alike."""
    runs = runs_of(sensor.name)
    sd = runs.std(axis=0)
    value = float(len(runs) * (1 + 2 * np.log(sd)).sum())
    fit = TurnOnBias(tuple((runs.std(axis=0, ddof=1) * sensor.lsb).tolist()))
    return Candidate(("turn_on_bias",), {_NAME: (fit,)}, 3, value, "why fourteen of fifteen runs agree")


def _second_state(sensor: Sensor) -> Candidate:
    """Another bias at the same range, of the data sheet's population there; free is the probability."""
    spread = bias_sigma(sensor.header) / sensor.lsb
    value = _steady(sensor) + _odd(sensor, _measured_response(sensor), np.hypot(spread, _within(sensor))) + _chance()
    away = (_reading() - _measured_response(sensor)) / spread
    offset = tuple(((_reading() - _usual(sensor)) * sensor.lsb).tolist())
    left = ", ".join(f"{z:+.1f}" for z in away) + " of the data sheet's deviations"
    second = BistableBias(offset, 1 / 15)
    return Candidate(("bistable_bias",), {_NAME: (second,)}, 1, value, f"biases {left}")


def _probability_interval() -> list[float]:
    """95 % of a share of which 1 of 15 was seen (Clopper and Pearson 1934)."""
    return [float(beta.ppf(0.025, 1, 15)), float(beta.ppf(0.975, 2, 14))]


def _held_out(sensor: Sensor) -> Iterator[Mapping[str, object]]:
    """The range told from gravity alone foretells the other two axes."""
    per_g = CHIPS[sensor.header.chip].sensitivity
    logs = {r: _z_of_gravity(sensor, r, s) for r, s in per_g.items() if r != sensor.header.range}
    range_ = min(logs, key=lambda r: abs(logs[r]))
    mean, sd = _at_range(sensor, replace(sensor.header, range=range_, sensitivity=per_g[range_]))
    for axis in (0, 1):
        yield {
            "check": f"range told from z alone ({range_:g} g) foretells {'xy'[axis]} of the odd run",
            "foretold": float(mean[axis]),
            "sd": float(sd[axis]),
            "printed": float(_reading()[axis]),
            "z": float((mean[axis] - _reading()[axis]) / sd[axis]),
            "unit": "LSB",
        }


def _z_of_gravity(sensor: Sensor, range_: float, per_g: float) -> float:
    mean, sd = _at_range(sensor, replace(sensor.header, range=range_, sensitivity=per_g))
    return float((_reading()[2] - mean[2]) / sd[2])
