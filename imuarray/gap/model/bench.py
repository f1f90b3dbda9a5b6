"""Where models of sensors are tried: statistics of the recorded campaign, and of what is simulated in its place.

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

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.model.base_model import Base, FittedParameters, fit, replicated_statistics, residual
from imuarray.gap.model.downstream import Uses, uses_of
from imuarray.gap.model.replication import Models, ReplicateRequest, Stage
from imuarray.gap.recording.recordings import Experiment
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import Key, ReplicateStatistics, statistics
from imuarray.gap.statistics.pairs import Pairs, pairs_of
from imuarray.gap.statistics.probes import PROBES, CrossProbe, Probe
from imuarray.gap.statistics.probes.probe import ArrayProbe
from imuarray.gap.statistics.split import Split
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.posed import Posed


@dataclass(frozen=True)
class StatisticValues:
    """Statistics of a campaign, of its training part first: `values` (n,) under the bench's keys, the ordinary
    parameters that were fitted to the training part, and (if asked for) figures of use.
    """

    values: Floats
    fitted: Mapping[str, FittedParameters]
    uses: Uses = field(default_factory=dict)


@dataclass(frozen=True)
class Bench(Stage):
    """The stage of a recorded campaign, and the keys of its statistics: those of the training part, `of_train` of them,
    then those of the held-out part. `resolutions` (n,): the least difference that means anything in each.
    `is_refitted`: the base model is fitted anew to the training part of every campaign; else all are measured by the
    parameters that it has, which come from elsewhere.
    """

    keys: tuple[Key, ...]
    of_train: int
    resolutions: Floats = field(repr=False)
    is_refitted: bool = field(default=True, kw_only=True)

    @cached_property
    def held_out(self) -> Booleans:
        """(n,) which keys are of the held-out part."""
        return np.arange(len(self.keys)) >= self.of_train

    def columns(self, sensors: Collection[str], *, cross: bool) -> Indices:
        """The places of these sensors' keys; `cross`: with what they have in common with others at rest."""
        places = self._places(frozenset(sensors))
        return places if cross else places[~self._is_cross[places]]

    def own(self, unit: Collection[str]) -> Indices:
        """The places of what a unit shows: of one sensor without what it shares with others, of several with it."""
        return self.columns(unit, cross=len(unit) > 1)

    def among(self, unit: Collection[str], sensors: Collection[str]) -> Booleans:
        """Which of the statistics of these sensors, as a replicate has them, are what a unit of them shows (`own`)."""
        return np.isin(self.columns(sensors, cross=True), self.own(unit))

    def pairs(self, places: Indices | None = None) -> Pairs:
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

    def of_keys(self, chosen: Booleans) -> Bench:
        """The bench of some of the statistics, (n,)."""
        keys = tuple(key for key, wanted in zip(self.keys, chosen.tolist(), strict=True) if wanted)
        of_train = int(np.count_nonzero(chosen[: self.of_train]))
        return replace(self, keys=keys, of_train=of_train, resolutions=self.resolutions[chosen])

    @cached_property
    def logs(self) -> Indices:
        """(n,) the number of each key's log in the campaign; -1 of several logs."""
        numbers = [[at for at, own in enumerate(self.split.phases(out)) if own] for out in (False, True)]
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return np.array([numbers[out][key.log] if key.log >= 0 else -1 for key, out in sides], np.intp)

    @cached_property
    def log_kinds(self) -> tuple[str, ...]:
        """(n,) the kind of the log of each key, "" of a statistic of several logs."""
        kinds = [
            [kind for kind, own in zip(self.kinds, self.split.phases(held_out), strict=True) if own]
            for held_out in (False, True)
        ]
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return tuple(kinds[out][key.log] if key.log >= 0 else "" for key, out in sides)

    @cached_property
    def alike(self) -> npt.NDArray[np.str_]:
        """(n,) probe, axis and kind of log: keys that have these in common scatter alike."""
        pairs = zip(self.keys, self.log_kinds, strict=True)
        return np.array([f"{key.probe} {key.axis} {kind}" for key, kind in pairs])

    @cached_property
    def is_of_motion(self) -> Booleans:
        """(n,) which keys tell how a sensor moves beside the others."""
        probes = [PROBES[key.probe] for key in self.keys]
        return np.array([isinstance(probe, CrossProbe) and probe.in_motion for probe in probes], bool)

    @cached_property
    def _index(self) -> tuple[dict[Key, int], dict[Key, int]]:
        train: dict[Key, int] = {}
        held_out: dict[Key, int] = {}
        for at, key in enumerate(self.keys):
            (train if at < self.of_train else held_out)[key] = at
        return train, held_out

    @cached_property
    def _is_cross(self) -> Booleans:
        """Which keys tell, at rest, what sensors share; in motion all are simulated, since all feel it."""
        return np.array([_is_shared(PROBES[key.probe]) for key in self.keys], bool)

    @cached_property
    def _of_sensor(self) -> Mapping[str, Indices]:
        names = np.array([key.sensor for key in self.keys])
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}

    def _places(self, sensors: frozenset[str]) -> Indices:
        """Of all keys of these sensors, ascending."""
        return np.sort(np.concatenate([np.zeros(0, np.intp), *(self._of_sensor[name] for name in sorted(sensors))]))

    def replicate(
        self, models: Models, number: int, *, held_out: bool = True, company: Models = MappingProxyType({})
    ) -> StatisticValues:
        """Statistics of `simulated`, under the keys of these sensors (`columns`), by its own fit."""
        (found,) = self.replicates([(models, number)], held_out=held_out, company=company)
        return found

    def replicates(
        self, asked: Sequence[ReplicateRequest], *, held_out: bool = True, company: Models = MappingProxyType({})
    ) -> list[StatisticValues]:
        """`replicate`, of several of the same sensors: faster than one after the other."""
        campaigns = self.campaigns(asked, held_out=held_out, company=company)
        return self.each_measured(campaigns, asked[0][0], held_out=held_out)

    def observed(self, campaign: Campaign, sensors: Collection[str]) -> StatisticValues:
        """`measured`, with figures of use."""
        (found,) = self.each_observed([campaign], sensors)
        return found

    def each_observed(self, campaigns: Sequence[Campaign], sensors: Collection[str]) -> list[StatisticValues]:
        """`observed`, of several replicates."""
        found = self.each_measured(campaigns, sensors)
        bases = [replace(self.base, fitted=one.fitted) for one in found]
        uses = [
            uses_of(campaign, residual(campaign, self.motions, base))
            for campaign, base in zip(campaigns, bases, strict=True)
        ]
        return [replace(one, uses=own) for one, own in zip(found, uses, strict=True)]

    def measured(self, campaign: Campaign, sensors: Collection[str]) -> StatisticValues:
        """Statistics of a campaign of these sensors that was looked at as the recorded one, nan where it has none."""
        (found,) = self.each_measured([campaign], sensors)
        return found

    def each_measured(
        self, campaigns: Sequence[Campaign], sensors: Collection[str], *, held_out: bool = True
    ) -> list[StatisticValues]:
        """`measured`, of several replicates."""
        told = self._told(campaigns[0])
        sides = [self.split.train(campaign) for campaign in campaigns]
        motions = [told[at] for at in sides[0].logs]
        bases = [fit(side.campaign, motions) if self.is_refitted else self.base for side in sides]
        values = np.full((len(campaigns), len(self.keys)), np.nan)
        for part in (0, 1) if held_out else (0,):
            if part:
                sides = [self.split.held_out(campaign) for campaign in campaigns]
                motions = [told[at] for at in sides[0].logs]
            self._put(values, replicated_statistics([side.campaign for side in sides], motions, bases, sensors), part)
        own = values[:, self._places(frozenset(sensors))]
        return [StatisticValues(one, base.fitted) for one, base in zip(own, bases, strict=True)]

    def _told(self, campaign: Campaign) -> tuple[Motion, ...]:
        """What the box did, as the sensors of a campaign can tell: attitudes that its accelerometers are to tell
        together are taken as known where some of these are missing.
        """
        there = {name for log in campaign.logs for phase in log.phases for name in phase.sensors}
        needed = {name for name, header in self.base.headers.items() if header.quantity == "specific_force"}
        return self.motions if needed <= there else tuple(map(_known, self.motions))

    def _put(self, values: Floats, found: ReplicateStatistics, part: int) -> None:
        """Write statistics (r, m) of one part in their places (r, n); what is new in a simulation has none."""
        own = slice(self.of_train, None) if part else slice(self.of_train)
        if found.keys == self.keys[own]:
            values[:, own] = found.values
            return
        places = np.array([self._index[part].get(key, -1) for key in found.keys], np.intp)
        known = places >= 0
        values[:, places[known]] = found.values[:, known]


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
