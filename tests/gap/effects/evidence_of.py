"""Evidence of one sensor from a simulated campaign, compared with its fitted base model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import numpy.typing as npt

from imuarray.array import parse_array
from imuarray.gap.inference.evidence import Evidence, PhaseEvidence
from imuarray.gap.model.base_model import fit, headers_in, residual, residual_statistics
from imuarray.gap.model.bench import bench_of
from imuarray.gap.recording.recordings import Experiment, reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, LogSummary, runs_in, summarise_log
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.split import Share, Split
from imuarray.simulate import Motion, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.tumble import Tumble
from tests.gap.small_campaign import ARRAY, PLANS, RATE_HZ, Effects, phases_of, simulation

Floats = npt.NDArray[np.float64]

REPLICATES = 12

TWO_FACES = "heating on two faces"
"""A plan besides those of `PLANS`, as is the next."""

WARM_TUMBLE = "tumble at 45 degC"

_PLANS: Mapping[str, tuple[Motion, ...]] = {
    **PLANS,
    TWO_FACES: (Heating(scale=0.02), Heating(scale=0.02, up="-Z")),
    WARM_TUMBLE: (Tumble(10.0, 1.0, (45.0,) * 7),),
}


def evidence_of(
    kinds: str | tuple[str, ...],
    sensor: str,
    more: Effects | None = None,
    *,
    seed: int = 0,
    modelled: Sequence[Effect] = (),
) -> Evidence:
    """Of `sensor` in a campaign of one or more of `PLANS` or `TWO_FACES`, simulated with `BASE` and `more`; `modelled`
    are further effects of the sensor in the model. Scores are rough: their scale is that of a dozen replicates.
    """
    names = (kinds,) if isinstance(kinds, str) else kinds
    campaign, motions = _campaign(names, more, seed), _motions(names)
    base, (location, scale) = fit(campaign, motions), _usual(names)
    found = residual_statistics(campaign, motions, base)
    scores = np.clip((found.values - location) / np.maximum(scale, found.resolutions), -100.0, 100.0)
    left, headers = residual(campaign, motions, base), headers_in(campaign)
    own = headers[sensor]
    twins = [item.name for item in headers.values() if item.chip == own.chip and item.name != sensor]
    return Evidence(
        own,
        base.fitted[sensor],
        _seen(campaign, left, sensor),
        _by_probe(found.keys, found.values, sensor),
        _by_probe(found.keys, location, sensor),
        _by_probe(found.keys, scores, sensor),
        (*base.effects(0)[sensor], *modelled),
        runs_in(campaign.series()["turn-on"], sensor) if "turn-on" in campaign.series() else None,
        tuple(item for item in headers.values() if item.quantity == own.quantity and item.name != sensor),
        rows_of=_logs_of(found.keys, sensor),
        twins={name: _seen(campaign, left, name) for name in twins},
        twin_fitted={name: base.fitted[name] for name in twins},
    )


def _campaign(kinds: tuple[str, ...], more: Effects | None, seed: int) -> Campaign:
    logs: list[LogSummary] = []
    for kind in kinds:
        for motion in _PLANS[kind]:
            sources = simulated_sources(simulation(motion, more or {}, seed, len(logs)))
            logs.append(summarise_log(kind.split()[0], sources, phases_of(motion), reference_of(motion)))
    return Campaign(tuple(logs))


def _motions(kinds: tuple[str, ...]) -> tuple[Motion, ...]:
    return tuple(motion for kind in kinds for motion in _PLANS[kind])


@cache
def _usual(kinds: tuple[str, ...]) -> tuple[Floats, Floats]:
    """(n,) median and spread of residual statistics without a gap."""
    campaign, motions = _campaign(kinds, None, 99), _motions(kinds)
    plans = [plan_of(parse_array(ARRAY), RATE_HZ, motion.seconds) for motion in motions]
    experiments = [Experiment(plan, motion) for plan, motion in zip(plans, motions, strict=True)]
    bench = bench_of(campaign, _nothing_held_out(campaign), experiments, fit(campaign, motions))
    values = np.array([bench.replicate(bench.models(), number).values for number in range(REPLICATES)])
    spoken = np.isfinite(values).sum(axis=0) > REPLICATES // 2
    location, scale = np.full((2, values.shape[1]), np.nan)
    location[spoken], scale[spoken] = np.nanmedian(values[:, spoken], axis=0), np.nanstd(values[:, spoken], axis=0)
    return location, np.maximum(_pooled(bench.keys, scale), 1e-9 * (1 + np.abs(location)))


def _pooled(keys: Sequence[Key], scale: Floats) -> Floats:
    """Root mean square over all phases and axes of a sensor's probe, since few replicates determine a single scale
    poorly.
    """
    members: dict[tuple[str, str], list[int]] = {}
    for place, key in enumerate(keys):
        members.setdefault((key.sensor, key.probe), []).append(place)
    pooled = scale.copy()
    for places in members.values():
        known = scale[places][np.isfinite(scale[places])]
        pooled[places] = np.sqrt(np.mean(known**2)) if len(known) else np.nan
    return pooled


def _nothing_held_out(campaign: Campaign) -> Split:
    phases = [tuple(part.phase for part in log.phases) for log in campaign.logs]
    return Split(tuple(Share(own, tuple(range(len(own))), (False,) * len(own), False) for own in phases))


def _seen(raw: Campaign, left: Campaign, sensor: str) -> tuple[PhaseEvidence, ...]:
    pairs = [
        (number, log.kind, phase, other)
        for number, (log, less) in enumerate(zip(raw.logs, left.logs, strict=True))
        for phase, other in zip(log.phases, less.phases, strict=True)
        if sensor in phase.sensors
    ]
    return tuple(
        PhaseEvidence(number, kind, phase.is_still, phase.sensors[sensor], other.sensors[sensor], phase.cross)
        for number, kind, phase, other in pairs
    )


def _logs_of(keys: Sequence[Key], sensor: str) -> dict[str, tuple[int, ...]]:
    """The log of each row of `_by_probe`."""
    rows: dict[str, dict[tuple[int, str, int], int]] = {}
    for key in keys:
        if key.sensor == sensor:
            rows.setdefault(key.probe, {})[key.log, key.phase, key.phase_number] = key.log
    return {probe: tuple(places.values()) for probe, places in rows.items()}


def _by_probe(keys: Sequence[Key], values: Floats, sensor: str) -> dict[str, Floats]:
    """(m, 3) or (m, 1) for each probe, one row for every place of a value."""
    rows: dict[str, dict[tuple[int, str, int], list[float]]] = {}
    for key, value in zip(keys, values, strict=True):
        if key.sensor == sensor:
            rows.setdefault(key.probe, {}).setdefault((key.log, key.phase, key.phase_number), []).append(float(value))
    return {probe: np.array(list(places.values())) for probe, places in rows.items()}
