"""The bench that compares models of sensors by the statistics of the recorded campaign and of its simulations.

The statistics of both parts of a campaign are computed from the residuals of the fit to its training part, in the
recording and in every simulation. Levels of the held-out part are therefore relative to the bias of the training part.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.gap.model.base_model import (
    Base,
    FittedParameters,
    fit,
    number_of_accelerometers,
    replicated_statistics,
    residual,
)
from imuarray.gap.model.downstream import Uses, uses_of
from imuarray.gap.model.replication import Models, ReplicateRequest, Stage
from imuarray.gap.recording.recordings import Experiment
from imuarray.gap.statistics.campaign import Campaign, LogSummary
from imuarray.gap.statistics.catalogue import Key, ReplicateStatistics, statistics
from imuarray.gap.statistics.pairs import Pairs, pairs_of
from imuarray.gap.statistics.probes import PROBES, CrossProbe, Probe
from imuarray.gap.statistics.probes.probe import ArrayProbe
from imuarray.gap.statistics.split import Split
from imuarray.simulate.motion.posed import PoseSequence
from imuarray.simulate.motion.stimulus import Motion


@dataclass(frozen=True)
class StatisticValues:
    """Statistics of a campaign: `values` (n,) of the keys of the bench, those of the training part first, the ordinary
    parameters `fitted` to the training part, and on request figures of use (`uses`).
    """

    values: Floats
    fitted: Mapping[str, FittedParameters]
    uses: Uses = field(default_factory=dict)


@dataclass(frozen=True)
class Bench(Stage):
    """The stage of a recorded campaign with the `keys` of its statistics: `of_train` keys of the training part,
    followed by those of the held-out part.

    `resolutions` (n,): the least meaningful difference of each statistic. `is_refitted`: the base model is fitted again
    to the training part of every campaign; if false, the given parameters of `base` are used for all campaigns.
    """

    keys: tuple[Key, ...]
    of_train: int
    resolutions: Floats = field(repr=False)
    is_refitted: bool = field(default=True, kw_only=True)

    @cached_property
    def held_out(self) -> Booleans:
        """Mask (n,) of the keys of the held-out part."""
        return np.arange(len(self.keys)) >= self.of_train

    def columns(self, sensors: Collection[str], *, cross: bool) -> Indices:
        """Return the places of these sensors' keys; `cross`: include statistics of several sensors at rest."""
        places = self._places(frozenset(sensors))
        return places if cross else places[~self._is_cross[places]]

    def own(self, unit: Collection[str]) -> Indices:
        """Return the places of the statistics of a unit, which is a set of sensors. Those that compare sensors at rest
        are included only if it has several sensors.
        """
        return self.columns(unit, cross=len(unit) > 1)

    def among(self, unit: Collection[str], sensors: Collection[str]) -> Booleans:
        """Return the mask of the statistics of these sensors, in the order of a replicate, that belong to the `unit`
        (`own`).
        """
        return np.isin(self.columns(sensors, cross=True), self.own(unit))

    def pairs(self, places: Indices | None = None) -> Pairs:
        """Return the pairs of corresponding statistics of both parts: of all, or of those at `places`."""
        chosen = np.arange(len(self.keys)) if places is None else places
        keys = [self.keys[at] for at in chosen.tolist()]
        return pairs_of(keys, self.held_out[chosen].tolist(), [self._log_numbers[at] for at in chosen.tolist()])

    @cached_property
    def _log_numbers(self) -> list[int]:
        """Log number of each key, with equal numbers for corresponding logs of both parts: the first of a kind, the
        second, and so on.
        """
        numbers: dict[tuple[str, int], int] = {}
        parts: list[list[int]] = []
        for held_out in (False, True):
            kinds = [kind for kind, phases in zip(self.kinds, self.split.phases(held_out), strict=True) if phases]
            places = [(kind, kinds[:at].count(kind)) for at, kind in enumerate(kinds)]
            parts.append([numbers.setdefault(place, len(numbers)) for place in places])
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return [key.log if key.log < 0 else parts[out][key.log] for key, out in sides]

    def of_keys(self, chosen: Booleans) -> Bench:
        """Return the bench with only the `chosen` (n,) statistics."""
        keys = tuple(key for key, is_chosen in zip(self.keys, chosen.tolist(), strict=True) if is_chosen)
        of_train = int(np.count_nonzero(chosen[: self.of_train]))
        return replace(self, keys=keys, of_train=of_train, resolutions=self.resolutions[chosen])

    @cached_property
    def logs(self) -> Indices:
        """Number (n,) of each key's log in the campaign; -1 for several logs."""
        numbers = [[at for at, phases in enumerate(self.split.phases(out)) if phases] for out in (False, True)]
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return np.array([numbers[out][key.log] if key.log >= 0 else -1 for key, out in sides], np.intp)

    @cached_property
    def log_kinds(self) -> tuple[str, ...]:
        """Kind (n,) of each key's log, "" for a statistic of several logs."""
        kinds = [
            [kind for kind, phases in zip(self.kinds, self.split.phases(held_out), strict=True) if phases]
            for held_out in (False, True)
        ]
        sides = zip(self.keys, self.held_out.tolist(), strict=True)
        return tuple(kinds[out][key.log] if key.log >= 0 else "" for key, out in sides)

    @cached_property
    def scatter_group(self) -> npt.NDArray[np.str_]:
        """Group (n,) of each key by probe, axis and kind of log; statistics of one group are assumed to have the same
        scatter.
        """
        pairs = zip(self.keys, self.log_kinds, strict=True)
        return np.array([f"{key.probe} {key.axis} {kind}" for key, kind in pairs])

    @cached_property
    def is_of_motion(self) -> Booleans:
        """Mask (n,) of the keys that compare a sensor's motion with that of the others."""
        probes = [PROBES[key.probe] for key in self.keys]
        return np.array([isinstance(probe, CrossProbe | ArrayProbe) and probe.in_motion for probe in probes], bool)

    @cached_property
    def _index(self) -> tuple[dict[Key, int], dict[Key, int]]:
        train: dict[Key, int] = {}
        held_out: dict[Key, int] = {}
        for at, key in enumerate(self.keys):
            (train if at < self.of_train else held_out)[key] = at
        return train, held_out

    @cached_property
    def _is_cross(self) -> Booleans:
        """Mask (n,) of the keys that compare sensors at rest. Those in motion are not included, since all inertial
        sensors are simulated in motion.
        """
        return np.array([_is_shared(PROBES[key.probe]) for key in self.keys], bool)

    @cached_property
    def _of_sensor(self) -> Mapping[str, Indices]:
        names = np.array([key.sensor for key in self.keys])
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}

    def _places(self, sensors: frozenset[str]) -> Indices:
        """Return the places of all keys of these sensors in ascending order."""
        return np.sort(np.concatenate([np.zeros(0, np.intp), *(self._of_sensor[name] for name in sorted(sensors))]))

    def replicate(
        self, models: Models, number: int, *, held_out: bool = True, other_models: Models = MappingProxyType({})
    ) -> StatisticValues:
        """Return the statistics of the campaign that `simulated` returns, for the keys of the sensors of `models`
        (`columns`), with its own fit.
        """
        (values,) = self.replicates([(models, number)], held_out=held_out, other_models=other_models)
        return values

    def replicates(
        self,
        requests: Sequence[ReplicateRequest],
        *,
        held_out: bool = True,
        other_models: Models = MappingProxyType({}),
    ) -> list[StatisticValues]:
        """Return what `replicate` returns for several replicates of the same sensors; faster than single calls."""
        campaigns = self.campaigns(requests, held_out=held_out, other_models=other_models)
        return self.each_measured(campaigns, requests[0][0], held_out=held_out)

    def observed(self, campaign: Campaign, sensors: Collection[str]) -> StatisticValues:
        """Return what `measured` returns, with figures of use."""
        (values,) = self.each_observed([campaign], sensors)
        return values

    def each_observed(self, campaigns: Sequence[Campaign], sensors: Collection[str]) -> list[StatisticValues]:
        """Return what `observed` returns for each of several campaigns."""
        measured = self.each_measured(campaigns, sensors)
        bases = [replace(self.base, fitted=values.fitted) for values in measured]
        uses = [
            uses_of(campaign, residual(campaign, self.motions, base))
            for campaign, base in zip(campaigns, bases, strict=True)
        ]
        return [replace(values, uses=replicate_uses) for values, replicate_uses in zip(measured, uses, strict=True)]

    def measured(self, campaign: Campaign, sensors: Collection[str]) -> StatisticValues:
        """Return the statistics of these sensors in a campaign that was summarised like the recorded one; nan for
        statistics that it lacks.
        """
        (values,) = self.each_measured([campaign], sensors)
        return values

    def each_measured(
        self, campaigns: Sequence[Campaign], sensors: Collection[str], *, held_out: bool = True
    ) -> list[StatisticValues]:
        """Return what `measured` returns for each of several campaigns; only the training part unless `held_out`."""
        all_motions = self._known_motions(campaigns[0])
        sides = [self.split.train(campaign) for campaign in campaigns]
        motions = [all_motions[at] for at in sides[0].logs]
        vibrations = [self.experiments[at].vibrations for at in sides[0].logs]
        accelerometers = number_of_accelerometers(self.base.headers.values())
        bases = [
            fit(side.campaign, motions, accelerometers=accelerometers, vibrations=vibrations)
            if self.is_refitted
            else self.base
            for side in sides
        ]
        values = np.full((len(campaigns), len(self.keys)), np.nan)
        for part in (0, 1) if held_out else (0,):
            if part:
                sides = [self.split.held_out(campaign) for campaign in campaigns]
                motions = [all_motions[at] for at in sides[0].logs]
            self._put(values, replicated_statistics([side.campaign for side in sides], motions, bases, sensors), part)
        sensor_values = values[:, self._places(frozenset(sensors))]
        return [StatisticValues(row, base.fitted) for row, base in zip(sensor_values, bases, strict=True)]

    def _known_motions(self, campaign: Campaign) -> tuple[Motion, ...]:
        """Return the motions for the sensors of a campaign. Attitudes that are estimated from all accelerometers of a
        log are used as known attitudes if the campaign lacks one of these accelerometers at rest.
        """
        return tuple(
            _with_known_attitudes(performed.motion) if self._lacks_accelerometers(log, performed) else performed.motion
            for log, performed in zip(campaign.logs, self.experiments, strict=True)
        )

    @property
    def estimates_attitudes(self) -> bool:
        """True if some attitudes are estimated from all accelerometers together."""
        motions = [experiment.motion for experiment in self.experiments]
        return any(
            attitude.estimated
            for motion in motions
            if isinstance(motion, PoseSequence)
            for attitude in motion.attitudes
        )

    def _lacks_accelerometers(self, log: LogSummary, experiment: Experiment) -> bool:
        """Return whether an accelerometer of the log is missing in the phases at rest."""
        there = {name for phase in log.phases if phase.is_still for name in phase.sensors}
        recorded = {name for name in experiment.plan.sensors if name in self.base.headers}
        return any(self.base.headers[name].quantity == "specific_force" for name in recorded - there)

    def _put(self, values: Floats, statistics: ReplicateStatistics, part: int) -> None:
        """Write statistics (r, m) of one part to their places in `values` (r, n); keys that the recording lacks are
        ignored.
        """
        columns = slice(self.of_train, None) if part else slice(self.of_train)
        if statistics.keys == self.keys[columns]:
            values[:, columns] = statistics.values
            return
        places = np.array([self._index[part].get(key, -1) for key in statistics.keys], np.intp)
        known = places >= 0
        values[:, places[known]] = statistics.values[:, known]


def _with_known_attitudes(motion: Motion) -> Motion:
    """Return the motion with its estimated attitudes marked as known."""
    if not isinstance(motion, PoseSequence):
        return motion
    known = tuple(attitude._replace(estimated=False) for attitude in motion.attitudes)
    return PoseSequence(known, motion.surroundings, movements=motion.movements)


def _is_shared(probe: Probe) -> bool:
    return isinstance(probe, CrossProbe | ArrayProbe) and not probe.in_motion


def bench_of(campaign: Campaign, split: Split, experiments: Sequence[Experiment], base: Base) -> Bench:
    """Return the bench of a recorded campaign that was summarised in all phases of its split."""
    first, second = (statistics(side.campaign) for side in (split.train(campaign), split.held_out(campaign)))
    return Bench(
        tuple(log.kind for log in campaign.logs),
        split,
        tuple(tuple(phase.layout for phase in log.phases) for log in campaign.logs),
        tuple(_without_waiting(experiment, base.queued) for experiment in experiments),
        base,
        (*first.keys, *second.keys),
        len(first.keys),
        np.concatenate([first.resolutions, second.resolutions]),
    )


def _without_waiting(experiment: Experiment, queued: Collection[str]) -> Experiment:
    """Return the experiment with the rate of sensors with a queue set to 0, so that their readings do not wait for a
    poll: their rows are the chip's own readings.
    """
    sensors = {
        name: (replace(header, rate_hz=0.0) if name in queued else header, line)
        for name, (header, line) in experiment.plan.sensors.items()
    }
    return experiment._replace(plan=replace(experiment.plan, sensors=sensors))
