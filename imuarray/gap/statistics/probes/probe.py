"""Types of probes: pure functions that compute a number per axis from a summary, with their description.

A statistic is transformed so that its distribution without a gap is symmetric and nearly normal: logs of variances,
Fisher's z of correlations, arcsines of the roots of shares. It is nan where it is not defined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr, ndtri_exp

from imuarray.arrays import Floats, Integers
from imuarray.gap.statistics.campaign import LogSummary
from imuarray.gap.statistics.cross import Cross
from imuarray.gap.statistics.margins import Margin
from imuarray.gap.statistics.runs import Runs
from imuarray.gap.statistics.summary import Summary

Subject = TypeVar("Subject")
Result = TypeVar("Result")
Domain = Literal[
    "level",
    "spread",
    "distribution",
    "codes",
    "spectrum",
    "autocorrelation",
    "allan",
    "temperature",
    "force",
    "motion",
    "cross_sensor",
    "run_to_run",
    "timing",
    "status",
]

NOTHING = np.full(3, np.nan)


@dataclass(frozen=True)
class Probe:
    """Description of a statistic. `about`: what it measures; `moved_by`: the effects that it is intended to detect;
    `margin`: the least difference that matters; `unit`: that of its values ("" for pure numbers; "{u}" stands for the
    sensor's unit).
    """

    domain: Domain
    about: str
    moved_by: tuple[str, ...]
    margin: Margin
    unit: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class PhaseProbe(Probe):
    """Probe of one sensor in one phase; its value is (3,), or one number for all axes.

    `in_motion`: it is also computed while the box moves. `resolution` returns the least meaningful difference, where
    values can be equal by chance. `by_column`: the statistic is computed column by column for any number of columns, so
    that replicates can be processed together.
    """

    statistic: Callable[[Summary], Floats]
    in_motion: bool = False
    resolution: Callable[[Summary], float] = lambda _: 0.0
    by_column: bool = True


@dataclass(frozen=True)
class LogProbe(Probe):
    """Probe of one sensor in all phases of a log in which the box is at rest; `resolution` as in `PhaseProbe`."""

    statistic: Callable[[Sequence[Summary]], Floats]
    resolution: Callable[[Sequence[Summary]], float] = lambda _: 0.0


@dataclass(frozen=True)
class CrossProbe(Probe):
    """Probe of one sensor compared with the others of the array, at rest or (`in_motion`) in motion; `resolution` is
    the least meaningful difference, `uncertainty` returns that for what the motion determines of each axis (3,) or of
    all, and `unresolved` that for a motion with changes that the rows do not resolve.
    """

    statistic: Callable[[Cross, str], Floats]
    in_motion: bool = False
    resolution: float = 0.0
    uncertainty: Callable[[Cross, str], Floats | float] = lambda _, __: 0.0
    unresolved: Callable[[Cross], float] = lambda _: 0.0


@dataclass(frozen=True)
class ArrayProbe(Probe):
    """Probe of one sensor compared with the others of the array, in all phases of a log in which the box is at rest, or
    (`in_motion`) moves; `resolution` as in `PhaseProbe`.
    """

    statistic: Callable[[LogSummary, str], Floats]
    resolution: Callable[[LogSummary, str], float] = lambda _, __: 0.0
    in_motion: bool = False


@dataclass(frozen=True)
class TurnProbe(Probe):
    """Probe of one sensor in the turns of a log between two rests; `resolution` is the least meaningful difference."""

    statistic: Callable[[LogSummary, str], Floats]
    resolution: float = 0.0


@dataclass(frozen=True)
class RunsProbe(Probe):
    """Probe of one sensor over the logs of one kind."""

    statistic: Callable[[Runs], Floats]


@dataclass(frozen=True)
class CampaignProbe(Probe):
    """Probe of one sensor in all phases of all logs, at rest and in motion; `resolution` as in `PhaseProbe`."""

    statistic: Callable[[Sequence[Summary]], Floats]
    resolution: Callable[[Sequence[Summary]], float]


Probes = Mapping[str, PhaseProbe | LogProbe | CrossProbe | ArrayProbe | TurnProbe | RunsProbe | CampaignProbe]
"""Probes by their names."""


def once(work: Callable[[Subject], Result]) -> Callable[[Subject], Result]:
    """Cache the result of `work` in its subject (a summary, the evidence of a sensor), so that it is computed once for
    several probes, sensors or effects.
    """
    name = f"{work.__module__}.{work.__qualname__}"

    @wraps(work)
    def kept(subject: Subject) -> Result:
        results: dict[str, Any] = vars(subject)
        if name not in results:
            results[name] = work(subject)
        return results[name]  # type: ignore[no-any-return]

    return kept


def once_by_sensor(work: Callable[[Subject, str], Result]) -> Callable[[Subject, str], Result]:
    """Cache the results of `work` in its subject, so that each is computed once for several probes of a sensor."""
    name = f"{work.__module__}.{work.__qualname__}"

    @wraps(work)
    def kept(subject: Subject, sensor: str) -> Result:
        results: dict[str, Result] = vars(subject).setdefault(name, {})
        if sensor not in results:
            results[sensor] = work(subject, sensor)
        return results[sensor]

    return kept


def log(values: float | npt.ArrayLike) -> Floats:
    """Return the natural logarithm; nan for values that are not positive."""
    if isinstance(values, float):
        return np.array(math.log(values) if values > 0 else math.nan)
    numbers = np.asarray(values, float)
    return np.asarray(np.log(np.where(numbers > 0, numbers, np.nan)))


def fisher_z(correlation: npt.ArrayLike) -> Floats:
    """Return the artanh of a correlation, whose standard error does not depend on the correlation; limited to 7.25."""
    return np.asarray(np.arctanh(np.asarray(correlation).clip(-1 + 1e-6, 1 - 1e-6)))


def arcsine(count: float | npt.ArrayLike, of: int | npt.ArrayLike) -> Floats:
    """Return the arcsine of the root of the share `count` / `of`: its standard error is 1 / (2 sqrt(of)) whatever the
    share; nan if `of` is 0.
    """
    if isinstance(count, int | float) and isinstance(of, int):
        return np.array(math.asin(math.sqrt(min(max(count / of, 0.0), 1.0))) if of > 0 else math.nan)
    total = np.asarray(of, float)
    share = np.asarray(count, float) / np.where(total > 0, total, np.nan)
    return np.asarray(np.arcsin(np.sqrt(share.clip(0.0, 1.0))))


def score_of_largest(score: npt.ArrayLike, count: float) -> Floats:
    """Return the normal score of the largest of `count` independent normal numbers, given that number. Without a gap
    this score is normal, while the largest number itself has a long tail.
    """
    log_expected = math.log(max(count, 1)) + log_ndtr(-np.asarray(score, float))
    expected = np.exp(np.asarray(log_expected).clip(_RARE, _COMMON))
    return np.asarray(-ndtri_exp(np.where(log_expected > _RARE, np.log(-np.expm1(-expected)), log_expected)))


def one_row(summary: Summary) -> float:
    """Return the standard error of `arcsine` of a share of the rows."""
    return 0.5 / math.sqrt(max(summary.rows, 1))


@once
def noise_lsb(summary: Summary) -> Floats:
    """Return the standard deviation (3,) of white noise in counts, estimated from the smallest 95 % of the differences
    between neighbours, which excludes drift, motion and outliers. nan where neighbours never differ.

    For Gaussian noise the mean size of these differences is 0.71683 of their standard deviations: 2 (phi(0) -
    phi(1.96)) / 0.95.
    """
    means = [_trimmed_mean(steps.codes, steps.counts) for steps in summary.steps]
    noise = np.array(means) / (_TRIMMED * np.sqrt(2))
    return np.where(noise > 0, noise, np.nan)


_RARE, _COMMON = -30.0, 3.5
"""Limits of the log of the expected number of larger values, for numerical stability."""

_KEPT = 0.95
"""Share of the smallest differences from which the noise is estimated."""

_TRIMMED = 0.71683
"""Mean of the smallest 95 % of absolute Gaussian numbers, in standard deviations."""


def _trimmed_mean(sizes: Integers, counts: Integers) -> float:
    """Return the mean of the smallest 95 % of values of a histogram: `sizes`, each of which occurred `counts` times."""
    if len(sizes) == 0:
        return math.nan
    upto = counts.cumsum()
    total = float(upto[-1]) * _KEPT
    return float(sizes[-1] - np.minimum(upto[:-1], total) @ (sizes[1:] - sizes[:-1]) / total)
