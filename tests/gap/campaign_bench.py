"""A bench for curves over replicates, with its runner and entries of its table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from imuarray.array import parse_array
from imuarray.gap.findings.diagnosis import Where
from imuarray.gap.model.base_model import fit
from imuarray.gap.model.bench import Bench, bench_of
from imuarray.gap.recording.recordings import Experiment, reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.gap.statistics.split import split_of
from imuarray.simulate import plan_of
from imuarray.simulate.effect import Effect
from tests.gap.small_campaign import ARRAY, PLANS, RATE_HZ, phases_of, simulation


def benched(kinds: Sequence[str], more: Mapping[str, Sequence[Effect]], seed: int = 1) -> tuple[Bench, Campaign]:
    """A simulated recording of these kinds, on its bench."""
    logs = [(kind, motion) for kind in kinds for motion in PLANS[kind]]
    split = split_of([kind for kind, _ in logs], [phases_of(motion) for _, motion in logs])
    found = []
    for boot, (kind, motion) in enumerate(logs):
        sources = simulated_sources(simulation(motion, more, seed, boot))
        found.append(summarise_log(kind, sources, split.phases()[boot], reference_of(motion)))
    campaign = Campaign(tuple(found))
    experiments = [Experiment(plan_of(parse_array(ARRAY), RATE_HZ, motion.seconds), motion) for _, motion in logs]
    train = split.train(campaign)
    base = fit(train.campaign, [experiments[at].motion for at in train.logs], seed=seed)
    return bench_of(campaign, split, experiments, base), campaign


def where(sensor: str = "G1", axis: str = "y", domain: str = "spectrum", phase: str = "static", log: str = "") -> Where:
    values = (0.0, 0.0, "", 9.0, 0.01, 9.0, 1.0, "material")
    return Where(log, sensor, axis, domain, phase, "line", "a line", *values)  # type: ignore[arg-type]


class Run:
    """Run the items in order and count them."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self.items = bench, 0

    def __call__(self, job: Callable[[Bench, Any], Any], items: Sequence[Any]) -> list[Any]:
        self.items += len(items)
        return [job(self._bench, item) for item in items]
