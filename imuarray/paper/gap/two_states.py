"""Table 7: Gyro3's three axes jump together between two sets of biases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.special import logsumexp
from scipy.stats import beta

from imuarray.paper.gap.candidate import Candidate, Discrepancy, discrepancy, with_checks
from imuarray.paper.gap.chance import ONE_RUN, array_rate_hz
from imuarray.paper.gap.sensor import Array, Floats, Sensor
from imuarray.paper.model_units import runs_of
from imuarray.paper.replica.statistic import Statistic
from imuarray.paper.startup import bias_states, two_way_split
from imuarray.paper.tables import number_in, table
from imuarray.simulate.effects.bistable_bias import BistableBias
from imuarray.simulate.effects.thermal_bias import ThermalBias
from imuarray.simulate.effects.turn_on_bias import TurnOnBias

_NAME = "Gyro3"


def two_states(array: Array) -> Discrepancy:
    """Gyro3's runs, with `bistable_bias` (and `turn_on_bias` within a state), `turn_on_bias` alone, axes independent or
    correlated, and `thermal_bias` as candidates.
    """
    sensor, runs = array[_NAME], runs_of(_NAME)
    candidates = [
        _bistable(sensor, runs),
        _independent(sensor, runs),
        _correlated(sensor, runs),
        _thermal(sensor, runs),
    ]
    candidates.append(Candidate((), {}, 0, _chance_alone(sensor, runs), "all of it"))
    found = discrepancy(array, "two states", "Table 7: two sets of biases", candidates, runs.size, _belongs)
    return with_checks(found, _held_out(runs), runs_in_second_state=list(bias_states()[1].runs))


def _belongs(row: Statistic) -> bool:
    runs = row.table == "Table 11" and "runs" in row.statistic and "of_means" in row.statistic
    level = row.statistic in ("runs_mean", "cont_mean", "intercept_lsb")
    return row.table == "Table 7" or (row.channel.startswith(_NAME) and (runs or level))


def _within(runs: Floats) -> Floats:
    """(3,) pooled standard deviation within the two states."""
    squares = sum(len(s.runs) * np.array(s.spread) ** 2 * (len(s.runs) - 1) / len(s.runs) for s in bias_states())
    return np.asarray(np.sqrt(squares / (len(runs) - 2)))


def _bistable(sensor: Sensor, runs: Floats) -> Candidate:
    """A mixture of two normal triads: free are two centres less one, the spread and the probability."""
    first, second = bias_states()
    within, share = _within(runs), len(second.runs) / len(runs)
    logs = [
        np.log(weight) - (((runs - np.array(state.centre)) / within) ** 2 / 2 + np.log(within)).sum(axis=1)
        for weight, state in ((1 - share, first), (share, second))
    ]
    value = -2 * float(logsumexp(logs, axis=0).sum())
    offset = (np.array(second.centre) - np.array(first.centre)) * sensor.lsb
    error = within * sensor.lsb * np.sqrt(1 / len(first.runs) + 1 / len(second.runs))
    effects = (
        TurnOnBias(tuple((within * sensor.lsb).tolist())),
        BistableBias(tuple(offset.tolist()), share),
    )
    interval = [float(beta.ppf(0.025, len(second.runs), len(first.runs) + 1))]
    interval.append(float(beta.ppf(0.975, len(second.runs) + 1, len(first.runs))))
    return Candidate(
        ("bistable_bias", "turn_on_bias"),
        {_NAME: effects},
        7,
        value,
        f"{', '.join(f'{w:.2f}' for w in within)} LSB rms within a state",
        {"offset_dps": error.tolist(), "probability": interval},
    )


def _independent(sensor: Sensor, runs: Floats) -> Candidate:
    sd = runs.std(axis=0)
    value = float(len(runs) * (1 + 2 * np.log(sd)).sum())
    fit = TurnOnBias(tuple((runs.std(axis=0, ddof=1) * sensor.lsb).tolist()))
    return Candidate(("turn_on_bias",), {_NAME: (fit,)}, 3, value, "why nothing lies between the two sets")


def _correlated(sensor: Sensor, runs: Floats) -> Candidate:
    """One normal triad with all correlations: more than the effect has, so that joint jumps alone can't tell."""
    _, log_volume = np.linalg.slogdet(np.cov(runs.T, bias=True))
    value = float(len(runs) * (runs.shape[1] + log_volume))
    fit = TurnOnBias(tuple((runs.std(axis=0, ddof=1) * sensor.lsb).tolist()))
    return Candidate(
        ("turn_on_bias", "common_mode"), {_NAME: (fit,)}, 6, value, "why nothing lies between the two sets"
    )


def _thermal(sensor: Sensor, runs: Floats) -> Candidate:
    """A straight line on its own thermometer, one code per degC."""
    codes = np.array([float(number_in(row, "temp_int")) for row in table(7)])
    warm = -(codes - codes.mean())
    slope = warm @ (runs - runs.mean(axis=0)) / (warm @ warm)
    left = (runs - runs.mean(axis=0) - np.outer(warm, slope)).std(axis=0)
    value = float(len(runs) * (1 + 2 * np.log(left)).sum())
    fit = ThermalBias(tuple((slope * sensor.lsb).tolist()))
    noise = TurnOnBias(tuple((left * sensor.lsb).tolist()))
    rest = ", ".join(f"{one:.1f}" for one in left)
    return Candidate(
        ("thermal_bias", "turn_on_bias"), {_NAME: (fit, noise)}, 6, value, f"{rest} LSB rms about the line"
    )


def _chance_alone(sensor: Sensor, runs: Floats) -> float:
    """In-run wander and white noise only, as far as the array has them."""
    var = np.array([float(ONE_RUN.covariance(sensor, i, array_rate_hz(11))[0, 0]) for i in range(3)])
    return float(((runs - runs.mean(axis=0)) ** 2 / var + np.log(var)).sum())


def _held_out(runs: Floats) -> Iterator[Mapping[str, object]]:
    """For each axis: states told from the two others, centres from the other runs, this axis of the left-out run."""
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        foretold, plain = np.zeros(len(runs)), np.zeros(len(runs))
        for out in range(len(runs)):
            rest = np.delete(np.arange(len(runs)), out)
            groups = [rest[list(part)] for part in two_way_split([tuple(runs[i, others]) for i in rest])]
            centres = [runs[group][:, others].mean(axis=0) for group in groups]
            near = groups[int(np.argmin([np.linalg.norm(runs[out, others] - centre) for centre in centres]))]
            foretold[out], plain[out] = runs[near, axis].mean(), runs[rest, axis].mean()
        gain = _gain(runs[:, axis], foretold, plain)
        yield {
            "check": f"state told from {' and '.join('xyz'[i] for i in others)} foretells {'xyz'[axis]}, run left out",
            "rms_lsb": float(np.sqrt(np.mean((runs[:, axis] - foretold) ** 2))),
            "rms_without_lsb": float(np.sqrt(np.mean((runs[:, axis] - plain) ** 2))),
            "variance_foretold": gain[0],
            "ci95": list(gain[1:]),
        }


def _gain(values: Floats, foretold: Floats, plain: Floats) -> tuple[float, float, float]:
    """Share of the squared error that is gone, and 95 % of it over 2000 resamplings of the runs."""
    ours, theirs = (values - foretold) ** 2, (values - plain) ** 2
    picks = np.random.Generator(np.random.Philox(7)).integers(len(values), size=(2000, len(values)))
    low, high = np.quantile(1 - ours[picks].sum(axis=1) / theirs[picks].sum(axis=1), [0.025, 0.975])
    return float(1 - ours.sum() / theirs.sum()), float(low), float(high)
