"""Where models of sensors are tried: the recorded campaign simulated with them, in part or whole, and its statistics.

A statistic of a part of the campaign is of what the fit to its training part leaves, in the recording and in every
simulation alike: levels of the held-out part are told from the bias that the training part had.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.gap.base_model import Base, Fitted, fit, replicate_seed, residual
from imuarray.gap.campaign import Campaign, Layout, is_at_rest, summarise_logs
from imuarray.gap.pairs import Pairs, pairs_of
from imuarray.gap.probes import PROBES, CrossProbe, Probe
from imuarray.gap.probes.probe import ArrayProbe
from imuarray.gap.recordings import Experiment, temperature_of
from imuarray.gap.source import Source, simulated_sources
from imuarray.gap.split import Split
from imuarray.gap.statistics import Key, Statistics, residual_statistics, statistics
from imuarray.gap.use import Uses, uses_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.posed import Posed
from imuarray.simulate.simulation import Simulation

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
        (found,) = self.campaigns(models, (number,), held_out=held_out, company=company)
        return found

    def campaigns(
        self,
        models: Models,
        numbers: Sequence[int],
        *,
        held_out: bool = True,
        company: Models = MappingProxyType({}),
    ) -> list[Campaign]:
        """`simulated`, of several replicates."""
        effects = [self._effects({**company, **models}, number) for number in numbers]
        seeds = [replicate_seed(self.base.seed, number) for number in numbers]
        phases = self.split.phases(None if held_out else False)
        logs = []
        for at, (experiment, kind) in enumerate(zip(self.experiments, self.kinds, strict=True)):
            replicates = [
                self._sources(at, models, own, seed) for own, seed in zip(effects, seeds, strict=True)
            ]
            layouts = self._layouts(at, held_out)
            logs.append(summarise_logs(kind, replicates, phases[at], temperature_of(experiment.motion), layouts))
        return [Campaign(replicate) for replicate in zip(*logs, strict=True)]

    def _sources(
        self, log: int, models: Models, effects: Mapping[str, Sequence[Effect]], seed: int
    ) -> dict[str, Source]:
        """One replicate of a log: these sensors, and where the box moves all others."""
        plan, motion = self.experiments[log]
        simulation = Simulation(plan, motion, effects, seed=seed, boot=log)
        wanted = {*models, *(effects if self._moves[log] else ())}
        return {name: source for name, source in simulated_sources(simulation).items() if name in wanted}

    def replicate(
        self, models: Models, number: int, *, held_out: bool = True, company: Models = MappingProxyType({})
    ) -> Values:
        """Statistics of `simulated`, under the keys of these sensors (`columns`), by its own fit."""
        (found,) = self.replicates(models, (number,), held_out=held_out, company=company)
        return found

    def replicates(
        self,
        models: Models,
        numbers: Sequence[int],
        *,
        held_out: bool = True,
        company: Models = MappingProxyType({}),
    ) -> list[Values]:
        """`replicate`, of several: faster than one after the other."""
        campaigns = self.campaigns(models, numbers, held_out=held_out, company=company)
        return [self.measured(campaign, models, held_out=held_out) for campaign in campaigns]

    def observed(self, campaign: Campaign, sensors: Collection[str]) -> Values:
        """`measured`, with figures of use."""
        found = self.measured(campaign, sensors)
        base = replace(self.base, fitted=found.fitted)
        return replace(found, uses=uses_of(campaign, residual(campaign, self.motions, base)))

    def measured(self, campaign: Campaign, sensors: Collection[str], *, held_out: bool = True) -> Values:
        """Statistics of a campaign of these sensors that was looked at as the recorded one, nan where it has none."""
        train, told = self.split.train(campaign), self._told(campaign)
        motions = [told[at] for at in train.logs]
        base = fit(train.campaign, motions)
        values = np.full(len(self.keys), np.nan)
        self._put(values, residual_statistics(train.campaign, motions, base), 0)
        if held_out:
            other = self.split.held_out(campaign)
            motions = [told[at] for at in other.logs]
            self._put(values, residual_statistics(other.campaign, motions, base), 1)
        return Values(values[self._places(frozenset(sensors))], base.fitted)

    def _told(self, campaign: Campaign) -> tuple[Motion, ...]:
        """What the box did, as the sensors of a campaign can tell: attitudes that its accelerometers are to tell
        together are taken as known where some of these are missing.
        """
        there = {name for log in campaign.logs for phase in log.phases for name in phase.sensors}
        needed = {name for name, header in self.base.headers.items() if header.quantity == "specific_force"}
        return self.motions if needed <= there else tuple(map(_known, self.motions))

    def _effects(self, models: Models, number: int) -> dict[str, tuple[Effect, ...]]:
        """Of every sensor, those of the base model where nothing else is said."""
        found = {}
        for name, drawn in self.base.drawn(number).items():
            model = models.get(name) or Modelled(self.base.fitted[name])
            kept = (effect for effect in drawn if effect.name not in model.removed)
            found[name] = (*kept, *model.fitted.effects(), *model.added)
        return found

    def _layouts(self, log: int, held_out: bool) -> tuple[Layout, ...]:
        share = self.split.shares[log]
        return tuple(
            layout for layout, out in zip(self.layouts[log], share.held_out, strict=True) if held_out or not out
        )

    def _put(self, values: Floats, found: Statistics, part: int) -> None:
        """Write statistics of one part in their places; what is new in a simulation has none."""
        own = slice(self.of_train, None) if part else slice(self.of_train)
        if found.keys == self.keys[own]:
            values[own] = found.values
            return
        known = self._index[part]
        for key, value in zip(found.keys, found.values.tolist(), strict=True):
            at = known.get(key)
            if at is not None:
                values[at] = value

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
