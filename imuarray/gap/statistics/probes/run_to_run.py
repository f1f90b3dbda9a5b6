"""Probes of the variation from run to run, and of the profile that all runs have in common."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.statistics.margins import GENEROUS, LEVEL, RMS, VARIANCE, Margin
from imuarray.gap.statistics.probes.probe import NOTHING, Probes, RunsProbe, log
from imuarray.gap.statistics.runs import PARTS, Runs, divide
from imuarray.gap.statistics.split import FEWEST_RUNS

_TIMES = np.log((np.arange(PARTS) + 0.5) / PARTS)


def spread(runs: Runs) -> Floats:
    """Return the log of the robust standard deviation of the runs' means."""
    return log(runs.spread)


def scatter(runs: Runs) -> Floats:
    """Return the log of the ratio of the variance of the runs' means to that expected for independent readings."""
    return np.asarray(log(runs.means.var(axis=0, ddof=1)) - log((runs.errors**2).mean(axis=0)))


def rms(runs: Runs) -> Floats:
    """Return the standard deviation of the runs' means. The usual scatter of a part is anything between zero and the
    largest usual one: its log has a long lower tail, in whose scale a scatter of twice the largest usual one is small.
    """
    return np.asarray(runs.means.std(axis=0, ddof=1))


def two_states(runs: Runs) -> Floats:
    """Return, for each axis, the log of the ratio of the variance of the runs' means to that within the two groups that
    `divide` returns.
    """
    variances = runs.errors**2
    return np.array([divide(runs.means[:, [axis]], variances[:, [axis]])[1] for axis in range(runs.means.shape[1])])


def shared_states(runs: Runs) -> Floats:
    """Return the same as `two_states` for groups that are common to all axes; one number."""
    return np.array(divide(runs.means, runs.errors**2)[1])


def outlier(runs: Runs) -> Floats:
    """Return the log of the largest joint distance of a run from the median, in robust standard deviations; one
    number.
    """
    return log(runs.joint_distance.max())


def creep(runs: Runs) -> Floats:
    """Return the slope of the mean profile over the log of the time since the start of the run."""
    times = _TIMES - _TIMES.mean()
    return np.asarray(times @ runs.mean_profile / (times @ times))


def profile(runs: Runs) -> Floats:
    """Return the log of the ratio of the variance of the mean profile to the variance expected from the scatter of the
    single profiles about it.
    """
    common = (runs.mean_profile**2).sum(axis=0)
    single = ((runs.profiles - runs.mean_profile) ** 2).sum(axis=(0, 1)) / (len(runs.means) - 1)
    return np.asarray(log(len(runs.means) * common) - log(single))


_BOOT = ("turn_on_bias", "bistable_bias", "range_reset")
_STATES = ("bistable_bias", "range_reset")


def _probe(
    about: str, moved_by: tuple[str, ...], margin: Margin, statistic: Callable[[Runs], Floats], unit: str = ""
) -> RunsProbe:
    def of_many(runs: Runs) -> Floats:
        missing = np.array(np.nan) if statistic in _JOINT else NOTHING
        return statistic(runs) if len(runs.means) >= FEWEST_RUNS else missing

    return RunsProbe("run_to_run", about, moved_by, margin, of_many, unit=unit)


_JOINT = (outlier, shared_states)
"""Statistics that are one number for all axes."""

PROBES: Probes = {
    "run_spread": _probe("log of the robust spread of runs' means", _BOOT, RMS, spread, "log {u}"),
    "run_scatter": _probe(
        "log of the variance of runs' means over white noise's", (*_BOOT, "bias_instability"), VARIANCE, scatter
    ),
    "run_rms": _probe("standard deviation of runs' means", _BOOT, LEVEL, rms, "{u}"),
    "run_two_states": _probe("log of the runs' variance over that within two groups", _STATES, GENEROUS, two_states),
    "run_shared_states": _probe("the same, for groups that all axes share", _STATES, GENEROUS, shared_states),
    "run_outlier": _probe("log of the farthest run's distance", _STATES, GENEROUS, outlier),
    "run_creep": _probe("slope of the mean profile over log time", (), LEVEL, creep, "{u}"),
    "run_profile": _probe("log of the variance that runs' profiles have in common", (), VARIANCE, profile),
}
