"""A bench of few sensors and short recordings, with the runner of its functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

from imuarray.array import ArrayConfig, parse_array
from imuarray.gap.model.base_model import fit
from imuarray.gap.model.bench import Bench, bench_of
from imuarray.gap.recording.recordings import Experiment, reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.gap.statistics.split import split_of
from imuarray.simulate import Motion, Simulation, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.motion.faces import Still
from tests.gap.small_campaign import ARRAY, BASE, RATE_HZ, phases_of

More = Mapping[str, tuple[Effect, ...]]
SHORT = Still(seconds=20)
LINE = Tone((0.0, 0.04, 0.0), 17.0)
"""0.8 of the noise's standard deviation."""


def array_of(*names: str) -> ArrayConfig:
    """`ARRAY` with these sensors only."""
    head, *parts = ARRAY.split("[[sensor]]")
    return parse_array("[[sensor]]".join([head, *(part for part in parts if part.split('"')[1] in names)]))


def simulated(motion: Motion, names: Sequence[str], more: More, seed: int = 1, boot: int = 0) -> Simulation:
    """With `BASE` and more effects."""
    effects = {name: (*BASE[name], *more.get(name, ())) for name in names}
    plan = plan_of(array_of(*names), RATE_HZ, motion.seconds)
    return Simulation(plan, motion, effects, seed=seed, boot=boot)


def prepared(
    logs: Sequence[tuple[str, Motion]], names: Sequence[str], more: More | None = None, seed: int = 1
) -> tuple[Bench, Campaign]:
    """A recording of these sensors on its bench."""
    split = split_of([kind for kind, _ in logs], [phases_of(motion) for _, motion in logs])
    found = []
    for boot, (kind, motion) in enumerate(logs):
        sources = simulated_sources(simulated(motion, names, more or {}, seed, boot))
        found.append(summarise_log(kind, sources, split.phases()[boot], reference_of(motion)))
    campaign = Campaign(tuple(found))
    experiments = [Experiment(plan_of(array_of(*names), RATE_HZ, motion.seconds), motion) for _, motion in logs]
    train = split.train(campaign)
    base = fit(train.campaign, [experiments[at].motion for at in train.logs], seed=seed)
    return bench_of(campaign, split, experiments, base), campaign


@cache
def static(*more: Effect, seed: int = 1) -> tuple[Bench, Campaign]:
    """One gyroscope, 20 s at rest; computed once."""
    return prepared([("static", SHORT)], ["G1"], {"G1": more}, seed)


class Run:
    """Run the items in order."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def __call__(self, job: Callable[[Bench, Any], Any], items: Sequence[Any]) -> list[Any]:
        return [job(self._bench, item) for item in items]
