"""Where models of sensors are tried: the recorded campaign simulated with them, in part or whole, and its statistics.

A statistic of a part of the campaign is of what the fit to its training part leaves, in the recording and in every
simulation alike: levels of the held-out part are told from the bias that the training part had.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.gap.base_model import Base, Fitted, fit, replicate_seed, residual
from imuarray.gap.campaign import Campaign, Layout, LogSummary, is_at_rest, summarise_logs
from imuarray.gap.pairs import Pairs, pairs_of
from imuarray.gap.probes import PROBES, CrossProbe, Probe
from imuarray.gap.probes.probe import ArrayProbe
from imuarray.gap.recordings import Experiment, temperature_of
from imuarray.gap.source import Source, simulated_sources
from imuarray.gap.split import Split
from imuarray.gap.statistics import Key, Replicated, replicated_statistics, statistics
from imuarray.gap.use import Uses, uses_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.channel_swap import ChannelSwap
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.posed import Posed
from imuarray.simulate.simulation import Simulation
from imuarray.simulate.streams import CHUNK

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

ORDINARY = frozenset({"white_noise", "bias", "thermal_bias"})
"""Kinds of effect whose parameters are fitted to every recording and every replicate."""


@dataclass(frozen=True)
class Modelled:
    """What one sensor has: the ordinary parameters, effects added to those of the base model, kinds taken out of it."""

    fitted: Fitted
    added: tuple[Effect, ...] = ()
    removed: frozenset[str] = frozenset()


Models = Mapping[str, Modelled]
"""By sensor."""

Effects = Mapping[str, tuple[Effect, ...]]

Asked = tuple[Models, int]
"""A replicate: its models and its number."""

TOGETHER = 8
"""So many replicates are simulated in one job, where there are many: what all have in common is done once, and there
are enough jobs for many workers.
"""

_ROWS = 8 * CHUNK
"""Of a sensor in all replicates of a log that are in work together; of so many rows each, it keeps four chunks."""

_KEPT = 64
"""Simulated sensors of logs in which the box moves: eight replicates of eight sensors."""


@dataclass(frozen=True)
class Values:
    """Statistics of a campaign, of its training part first: `values` (n,) under the bench's keys, the ordinary
    parameters that were fitted to the training part, and (if asked for) figures of use.
    """

    values: Floats
    fitted: Mapping[str, Fitted]
    uses: Uses = field(default_factory=dict)


@dataclass(frozen=True)
class Bench:
    """A campaign as it was recorded: how its logs were looked at (`kinds`, `layouts` of every phase of the split), what
    happened in them, how they are split, the base model, and the keys of its statistics: those of the training part,
    `of_train` of them, then those of the held-out part.
    """

    kinds: tuple[str, ...]
    split: Split
    layouts: tuple[tuple[Layout, ...], ...]
    experiments: tuple[Experiment, ...]
    base: Base
    keys: tuple[Key, ...]
    of_train: int
    resolutions: Floats = field(repr=False)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """What the box did in each log."""
        return tuple(experiment.motion for experiment in self.experiments)

    @cached_property
    def held_out(self) -> Bools:
        """(n,) which keys are of the held-out part."""
        return np.arange(len(self.keys)) >= self.of_train

    def columns(self, sensors: Collection[str], *, cross: bool) -> npt.NDArray[np.intp]:
        """The places of these sensors' keys; `cross`: with what they have in common with others at rest."""
        places = self._places(frozenset(sensors))
        return places if cross else places[~self._is_cross[places]]

    def own(self, unit: Collection[str]) -> npt.NDArray[np.intp]:
        """The places of what a unit shows: of one sensor without what it shares with others, of several with it."""
        return self.columns(unit, cross=len(unit) > 1)

    def among(self, unit: Collection[str], sensors: Collection[str]) -> Bools:
        """Which of the statistics of these sensors, as a replicate has them, are what a unit of them shows (`own`)."""
        return np.isin(self.columns(sensors, cross=True), self.own(unit))

    def pairs(self, places: npt.NDArray[np.intp] | None = None) -> Pairs:
        """All statistics, or those at some places, of both parts in pairs."""
        chosen = np.arange(len(self.keys)) if places is None else places
        keys = [self.keys[at] for at in chosen.tolist()]
        return pairs_of(keys, self.held_out[chosen].tolist(), [self._log_numbers[at] for at in chosen.tolist()])

    @cached_property
    def _log_numbers(self) -> list[int]:
        """Of each key: the first log of a kind of the one part belongs to the first of the other."""
        numbers: dict[tuple[str, int], int] = {}
        parts: list[list[int]] = []
        for held_out in (False, True):
            kinds = [kind for kind, own in zip(self.kinds, self.split.phases(held_out), strict=True) if own]
            places = [(kind, kinds[:at].count(kind)) for at, kind in enumerate(kinds)]
            parts.append([numbers.setdefault(place, len(numbers)) for place in places])
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return [key.log if key.log < 0 else parts[out][key.log] for key, out in sides]

    @cached_property
    def alike(self) -> npt.NDArray[np.str_]:
        """(n,) probe, axis and kind of log: keys that have these in common scatter alike."""
        kinds = [
            [kind for kind, own in zip(self.kinds, self.split.phases(held_out), strict=True) if own]
            for held_out in (False, True)
        ]
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return np.array([f"{key.probe} {key.axis} {kinds[out][key.log] if key.log >= 0 else ''}" for key, out in sides])

    def models(self) -> dict[str, Modelled]:
        """Every sensor as the base model has it."""
        return {name: Modelled(fitted) for name, fitted in self.base.fitted.items()}

    def simulated(
        self, models: Models, number: int, *, held_out: bool = True, company: Models = MappingProxyType({})
    ) -> Campaign:
        """Replicate `number` of these sensors: of all that is looked at, or (`held_out` False) the training part.
        Sensors beside them are as `company` has them, or as the base model.
        """
        (found,) = self.campaigns([(models, number)], held_out=held_out, company=company)
        return found

    def campaigns(
        self,
        asked: Sequence[Asked],
        *,
        held_out: bool = True,
        company: Models = MappingProxyType({}),
        logs: Collection[int] | None = None,
    ) -> list[Campaign]:
        """`simulated`, of several replicates of the same sensors, each with its models and its number; only these
        `logs` (None: all), the others without phases.
        """
        chosen = range(len(self.kinds)) if logs is None else logs
        effects = [self._effects({**company, **models}, number) for models, number in asked]
        parts = [
            self._replicated(at, asked, effects, held_out) if at in chosen else [LogSummary(kind, ())] * len(asked)
            for at, kind in enumerate(self.kinds)
        ]
        return [Campaign(replicate) for replicate in zip(*parts, strict=True)]

    def _replicated(
        self, log: int, asked: Sequence[Asked], effects: Sequence[Effects], held_out: bool
    ) -> list[LogSummary]:
        """One log in several replicates, as many at a time as memory is for."""
        kind, (plan, motion) = self.kinds[log], self.experiments[log]
        phases = self.split.phases(None if held_out else False)[log]
        rows = max((line.rows for _, line in plan.sensors.values()), default=0)
        at_once = max(_ROWS // max(rows, 1), 1)
        found: list[LogSummary] = []
        for first in range(0, len(asked), at_once):
            some = slice(first, first + at_once)
            replicates = [self._sources(log, *one, own) for one, own in zip(asked[some], effects[some], strict=True)]
            found += summarise_logs(kind, replicates, phases, temperature_of(motion), self._layouts(log, held_out))
        return found

    def _sources(self, log: int, models: Models, number: int, effects: Effects) -> dict[str, Source]:
        """One replicate of a log: these sensors, and where the box moves all others, as many models have in common."""
        plan, motion = self.experiments[log]
        wanted = [name for name in plan.sensors if name in (effects if self._moves[log] else models)]
        swapped = [name for name in wanted if any(effect.name == ChannelSwap.name for effect in effects[name])]
        seed = replicate_seed(self.base.seed, number)
        array = simulated_sources(Simulation(plan, motion, effects, seed=seed, boot=log)) if swapped else {}
        return {
            name: array[name]
            if name in swapped
            else (self._alone if name in models else self._company)(log, name, effects[name], seed)
            for name in wanted
        }

    @cached_property
    def _company(self) -> Callable[[int, str, tuple[Effect, ...], int], Source]:
        """`_alone`, the same one as long as it is kept."""
        return lru_cache(maxsize=_KEPT)(self._alone)

    def _alone(self, log: int, name: str, effects: tuple[Effect, ...], seed: int) -> Source:
        """A sensor that needs no other."""
        plan, motion = self.experiments[log]
        own = replace(plan, sensors={name: plan.sensors[name]})
        return simulated_sources(Simulation(own, motion, {name: effects}, seed=seed, boot=log))[name]

    @cached_property
    def _drawn(self) -> Callable[[int], Effects]:
        """What isn't fitted, by the replicate's number."""
        return lru_cache(maxsize=_KEPT)(self.base.drawn)

    def __getstate__(self) -> dict[str, Any]:
        """Without what was worked out, and is again where it is wanted."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def replicate(
        self, models: Models, number: int, *, held_out: bool = True, company: Models = MappingProxyType({})
    ) -> Values:
        """Statistics of `simulated`, under the keys of these sensors (`columns`), by its own fit."""
        (found,) = self.replicates([(models, number)], held_out=held_out, company=company)
        return found

    def replicates(
        self, asked: Sequence[Asked], *, held_out: bool = True, company: Models = MappingProxyType({})
    ) -> list[Values]:
        """`replicate`, of several of the same sensors: faster than one after the other."""
        campaigns = self.campaigns(asked, held_out=held_out, company=company)
        return self.each_measured(campaigns, asked[0][0], held_out=held_out)

    def observed(self, campaign: Campaign, sensors: Collection[str]) -> Values:
        """`measured`, with figures of use."""
        (found,) = self.each_observed([campaign], sensors)
        return found

    def each_observed(self, campaigns: Sequence[Campaign], sensors: Collection[str]) -> list[Values]:
        """`observed`, of several replicates."""
        found = self.each_measured(campaigns, sensors)
        bases = [replace(self.base, fitted=one.fitted) for one in found]
        uses = [
            uses_of(campaign, residual(campaign, self.motions, base))
            for campaign, base in zip(campaigns, bases, strict=True)
        ]
        return [replace(one, uses=own) for one, own in zip(found, uses, strict=True)]

    def measured(self, campaign: Campaign, sensors: Collection[str]) -> Values:
        """Statistics of a campaign of these sensors that was looked at as the recorded one, nan where it has none."""
        (found,) = self.each_measured([campaign], sensors)
        return found

    def each_measured(
        self, campaigns: Sequence[Campaign], sensors: Collection[str], *, held_out: bool = True
    ) -> list[Values]:
        """`measured`, of several replicates."""
        told = self._told(campaigns[0])
        sides = [self.split.train(campaign) for campaign in campaigns]
        motions = [told[at] for at in sides[0].logs]
        bases = [fit(side.campaign, motions) for side in sides]
        values = np.full((len(campaigns), len(self.keys)), np.nan)
        for part in (0, 1) if held_out else (0,):
            if part:
                sides = [self.split.held_out(campaign) for campaign in campaigns]
                motions = [told[at] for at in sides[0].logs]
            self._put(values, replicated_statistics([side.campaign for side in sides], motions, bases, sensors), part)
        own = values[:, self._places(frozenset(sensors))]
        return [Values(one, base.fitted) for one, base in zip(own, bases, strict=True)]

    def _told(self, campaign: Campaign) -> tuple[Motion, ...]:
        """What the box did, as the sensors of a campaign can tell: attitudes that its accelerometers are to tell
        together are taken as known where some of these are missing.
        """
        there = {name for log in campaign.logs for phase in log.phases for name in phase.sensors}
        needed = {name for name, header in self.base.headers.items() if header.quantity == "specific_force"}
        return self.motions if needed <= there else tuple(map(_known, self.motions))

    def _effects(self, models: Models, number: int) -> Effects:
        """Of every sensor, those of the base model where nothing else is said."""
        found = {}
        for name, drawn in self._drawn(number).items():
            model = models.get(name) or Modelled(self.base.fitted[name])
            kept = (effect for effect in drawn if effect.name not in model.removed)
            found[name] = (*kept, *model.fitted.effects(), *model.added)
        return found

    def _layouts(self, log: int, held_out: bool) -> tuple[Layout, ...]:
        share = self.split.shares[log]
        return tuple(
            layout for layout, out in zip(self.layouts[log], share.held_out, strict=True) if held_out or not out
        )

    def _put(self, values: Floats, found: Replicated, part: int) -> None:
        """Write statistics (r, m) of one part in their places (r, n); what is new in a simulation has none."""
        own = slice(self.of_train, None) if part else slice(self.of_train)
        if found.keys == self.keys[own]:
            values[:, own] = found.values
            return
        places = np.array([self._index[part].get(key, -1) for key in found.keys], np.intp)
        known = places >= 0
        values[:, places[known]] = found.values[:, known]

    @cached_property
    def _index(self) -> tuple[dict[Key, int], dict[Key, int]]:
        train: dict[Key, int] = {}
        held_out: dict[Key, int] = {}
        for at, key in enumerate(self.keys):
            (train if at < self.of_train else held_out)[key] = at
        return train, held_out

    @cached_property
    def _is_cross(self) -> Bools:
        """Which keys tell, at rest, what sensors share; in motion all are simulated, since all feel it."""
        return np.array([_is_shared(PROBES[key.probe]) for key in self.keys], bool)

    @cached_property
    def is_of_motion(self) -> Bools:
        """(n,) which keys tell how a sensor moves beside the others."""
        probes = [PROBES[key.probe] for key in self.keys]
        return np.array([isinstance(probe, CrossProbe) and probe.in_motion for probe in probes], bool)

    @cached_property
    def _moves(self) -> tuple[bool, ...]:
        """In which logs the box moves while it is looked at."""
        return tuple(not all(map(is_at_rest, share.phases)) for share in self.split.shares)

    @cached_property
    def _of_sensor(self) -> Mapping[str, npt.NDArray[np.intp]]:
        names = np.array([key.sensor for key in self.keys])
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}

    def _places(self, sensors: frozenset[str]) -> npt.NDArray[np.intp]:
        """Of all keys of these sensors, ascending."""
        return np.sort(np.concatenate([np.zeros(0, np.intp), *(self._of_sensor[name] for name in sorted(sensors))]))


def _known(motion: Motion) -> Motion:
    """The motion with estimated attitudes taken as known."""
    if not isinstance(motion, Posed):
        return motion
    return Posed(tuple(attitude._replace(estimated=False) for attitude in motion.attitudes), motion.surroundings)


def _is_shared(probe: Probe) -> bool:
    return isinstance(probe, ArrayProbe) or (isinstance(probe, CrossProbe) and not probe.in_motion)


def bench_of(campaign: Campaign, split: Split, experiments: Sequence[Experiment], base: Base) -> Bench:
    """The bench of a recorded campaign that was summarised in all phases of its split."""
    first, second = (statistics(side.campaign) for side in (split.train(campaign), split.held_out(campaign)))
    return Bench(
        tuple(log.kind for log in campaign.logs),
        split,
        tuple(tuple(phase.layout for phase in log.phases) for log in campaign.logs),
        tuple(experiments),
        base,
        (*first.keys, *second.keys),
        len(first.keys),
        np.concatenate([first.resolutions, second.resolutions]),
    )
