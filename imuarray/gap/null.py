"""How statistics scatter where nothing is wrong: the campaign simulated again and again with the base model.

Every replicate goes through all that the recorded campaign goes through: summaries on the same grids, the fit, and
statistics of what the fit leaves. So a parameter's own uncertainty is in the scatter, and is not taken for a gap; a
statistic that the fit makes zero is zero in every replicate as well, and says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.gap.base_model import Base, Fitted, fit, replicate_seed, residual
from imuarray.gap.campaign import Campaign, Layout, LogSummary, summarise_log
from imuarray.gap.segments import Times
from imuarray.gap.source import simulated_sources
from imuarray.gap.statistics import Key, Statistics, statistics
from imuarray.gap.workers import run
from imuarray.log.format import Phase
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.simulation import Plan, Simulation

Floats = npt.NDArray[np.float64]

LARGEST = 100.0
"""No score is beyond; that of a statistic which is there on one side only."""

_ROUNDING = 1e-9
_LOW, _BETWEEN = 0.0692, 2.9636
"""The two quantiles that say most of a normal scale, and how many standard deviations lie between them: 2 Phi^-1(1 -
0.0692). A twentieth of wild values does no harm."""

_NOISE_POWERS = {"noise": 1, "motion_residual": 2, "run_spread": 1}
"""Statistics in logs of the sensor's unit to a power: as many logs of the fitted noise are taken from them."""


class Experiment(NamedTuple):
    """What happened in one log: which sensors were read when, and what the box did."""

    plan: Plan
    motion: Motion


class Look(NamedTuple):
    """How a log is summarised: its kind, its phases, and the grids of each."""

    kind: str
    phases: tuple[Phase, ...]
    layouts: tuple[Layout, ...]


@dataclass(frozen=True)
class Null:
    """Statistics without a gap: `location` and `scale` (n,) of the residual statistics `keys` from one half of the
    replicates, and whether they `always` or `never` say something there; `scores` (b, n) of the other half.
    """

    keys: tuple[Key, ...]
    location: Floats
    scale: Floats
    scores: Floats
    always: npt.NDArray[np.bool_]
    never: npt.NDArray[np.bool_]

    def score(self, values: Floats) -> Floats:
        """(..., n) signed distances of residual statistics from those without a gap, in standard deviations; nan where
        nothing can be said. What always speaks without a gap and is silent here has the largest score; so has what
        never speaks without one.
        """
        apart = np.clip((values - self.location) / self.scale, -LARGEST, LARGEST)
        strange = np.where(np.isfinite(values), self.never, self.always)
        return np.where(strange, LARGEST, apart)


def residual_statistics(campaign: Campaign, motions: Sequence[Motion], base: Base | None = None) -> Statistics:
    """Statistics of what the campaign's own fit leaves, or that of another part of it (`base`): of levels less the
    predicted ones, of noises over the fitted ones.
    """
    base = base or fit(campaign, motions)
    found = statistics(residual(campaign, motions, base))
    return replace(found, values=found.values - _predictions(found.keys, base))


def null(
    campaign: Campaign,
    experiments: Sequence[Experiment],
    base: Base,
    replicates: int,
    *,
    executor: Executor | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> Null:
    """The scatter of a campaign's statistics if `base`, which was fitted to it (and, with a model, `settled`), were all
    there is.

    `experiments` are those of its logs. `executor` works replicates out side by side, in threads or processes
    (`imuarray.gap.workers`); the result doesn't depend on it. `progress` hears how many are done. ValueError for fewer
    than 8 replicates, of which no half says how statistics scatter.
    """
    if replicates < 8:
        raise ValueError(f"replicates: {replicates}; at least 8 are needed")
    job = partial(_residual_values, looks_of(campaign), tuple(experiments), base)
    found = run(executor, job, range(replicates))
    return _null_of(statistics(campaign), np.array(list(_heard(found, progress))))


def looks_of(campaign: Campaign) -> tuple[Look, ...]:
    """How each log of a campaign was looked at."""
    return tuple(
        Look(log.kind, tuple(part.phase for part in log.phases), tuple(part.layout for part in log.phases))
        for log in campaign.logs
    )


def replicate(looks: Sequence[Look], experiments: Sequence[Experiment], base: Base, number: int) -> Campaign:
    """Simulation `number` of a campaign: units drawn anew, everything else as in the recorded one."""
    seed, effects = replicate_seed(base.seed, number), base.effects(number)
    logs = [
        _summarised(look, Simulation(experiment.plan, experiment.motion, effects, seed=seed, boot=boot))
        for boot, (look, experiment) in enumerate(zip(looks, experiments, strict=True))
    ]
    return Campaign(tuple(logs))


def settled(
    campaign: Campaign,
    experiments: Sequence[Experiment],
    base: Base,
    replicates: int = 8,
    *,
    executor: Executor | None = None,
) -> Base:
    """`base` with its parameters moved by as much as the fit of its replicates misses that of the campaign: what the
    other effects of its model add to noise and level is not in them twice (indirect inference, one step; Gourieroux,
    Monfort and Renault 1993). Populations of the model scatter the result by their sigma over the root of `replicates`.
    `executor` as of `null`.
    """
    motions = [item.motion for item in experiments]
    looks, wanted = looks_of(campaign), fit(campaign, motions).fitted
    came = list(run(executor, partial(_fitted, looks, tuple(experiments), base), range(replicates)))
    moved = {name: one.moved(wanted[name], [fitted[name] for fitted in came]) for name, one in base.fitted.items()}
    return replace(base, fitted=moved)


def _residual_values(looks: Sequence[Look], experiments: Sequence[Experiment], base: Base, number: int) -> Floats:
    """(n,) of one replicate, by its own fit."""
    return residual_statistics(
        replicate(looks, experiments, base, number), [item.motion for item in experiments]
    ).values


def _fitted(looks: Sequence[Look], experiments: Sequence[Experiment], base: Base, number: int) -> Mapping[str, Fitted]:
    """The parameters of one replicate, by its own fit."""
    return fit(replicate(looks, experiments, base, number), [item.motion for item in experiments]).fitted


def _summarised(look: Look, simulation: Simulation) -> LogSummary:
    motion = simulation.motion

    def temperature(time_ns: Times) -> Floats:
        return np.asarray(motion.felt(time_ns).temperature_degc, float)

    return summarise_log(look.kind, simulated_sources(simulation), look.phases, temperature, look.layouts)


def _null_of(like: Statistics, found: Floats) -> Null:
    """Odd replicates say where and how far statistics lie, even ones how large scores get."""
    first, second = found[1::2], found[::2]
    spoken = np.isfinite(first)
    known = np.count_nonzero(spoken, axis=0) > len(first) // 2
    location, scale = np.full((2, found.shape[1]), np.nan)
    for column in np.flatnonzero(known):
        low, location[column], high = np.quantile(first[spoken[:, column], column], (_LOW, 0.5, 1 - _LOW))
        scale[column] = (high - low) / _BETWEEN
    always, never = np.asarray(spoken.all(axis=0)), np.asarray(~spoken.any(axis=0))
    floor = np.maximum(like.resolutions, _ROUNDING * (1 + np.abs(location)))
    unscored = Null(like.keys, location, np.maximum(scale, floor), np.zeros((0, 0)), always, never)
    return replace(unscored, scores=unscored.score(second))


def _predictions(keys: Sequence[Key], base: Base) -> Floats:
    """(n,) what the noise that was fitted makes of statistics in logs, 0 of others."""
    noises = {name: fitted.noise(base.headers[name]).tolist() for name, fitted in base.fitted.items()}
    predicted = np.zeros(len(keys))
    for place, key in enumerate(keys):
        if power := _NOISE_POWERS.get(key.probe, 0):
            predicted[place] = power * math.log(noises[key.sensor]["xyz".index(key.axis)])
    return predicted


def _heard(results: Iterable[Floats], progress: Callable[[int], None]) -> Iterable[Floats]:
    for done, result in enumerate(results, start=1):
        yield result
        progress(done)
