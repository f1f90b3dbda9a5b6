"""How a recorded campaign is simulated again, in part or whole, with its sensors as models have them.

A replicate is told by its number: the same number draws the same again, whatever models the sensors have.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any

from imuarray.gap.model.base_model import Base, FittedParameters, replicate_seed
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recordings import Experiment, temperature_of
from imuarray.gap.recording.source import Source, simulated_sources
from imuarray.gap.statistics.campaign import Campaign, Layout, LogSummary, summarise_logs
from imuarray.gap.statistics.split import Split
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.channel_swap import ChannelSwap
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.simulation import Simulation
from imuarray.simulate.streams import CHUNK

ORDINARY = frozenset({"white_noise", "bias", "thermal_bias"})
"""Kinds of effect whose parameters are fitted to every recording and every replicate."""


@dataclass(frozen=True)
class SensorModel:
    """What one sensor has: the ordinary parameters, effects added to those of the base model, kinds taken out of it."""

    fitted: FittedParameters
    added: tuple[Effect, ...] = ()
    removed: frozenset[str] = frozenset()


Models = Mapping[str, SensorModel]
"""By sensor."""

Effects = Mapping[str, tuple[Effect, ...]]

ReplicateRequest = tuple[Models, int]
"""A replicate: its models and its number."""

TOGETHER = 8
"""So many replicates are simulated in one job, where there are many: what all have in common is done once, and there
are enough jobs for many workers.
"""

_JOB_ROWS = 10_000_000
"""Fewer of long logs, up to so many rows of all sensors, some seconds' work: so workers end at about the same time, and
who waits hears soon how fast it goes.
"""

_ROWS = 8 * CHUNK
"""Of a sensor in all replicates of a log that are in work together; of so many rows each, it keeps four chunks."""

_KEPT = 64
"""Simulated sensors of logs in which the box moves: eight replicates of eight sensors."""


@dataclass(frozen=True)
class Stage:
    """What replicates of a campaign have in common: how its logs were looked at (`kinds`, `layouts` of every phase of
    the split), how they are split, what happened in them, and the base model. Their boots are numbered from
    `first_boot`: stages of one array with other numbers have the same units, and noise of their own.
    """

    kinds: tuple[str, ...]
    split: Split
    layouts: tuple[tuple[Layout, ...], ...]
    experiments: tuple[Experiment, ...]
    base: Base
    first_boot: int = field(default=0, kw_only=True)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """What the box did in each log."""
        return tuple(experiment.motion for experiment in self.experiments)

    @property
    def together(self) -> int:
        """How many replicates of all sensors one job simulates."""
        rows = sum(line.rows for plan, _ in self.experiments for _, line in plan.sensors.values())
        return min(max(_JOB_ROWS // max(rows, 1), 1), TOGETHER)

    def models(self) -> dict[str, SensorModel]:
        """Every sensor as the base model has it."""
        return {name: SensorModel(fitted) for name, fitted in self.base.fitted.items()}

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
        asked: Sequence[ReplicateRequest],
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
        self, log: int, asked: Sequence[ReplicateRequest], effects: Sequence[Effects], held_out: bool
    ) -> list[LogSummary]:
        """One log in several replicates, as many at a time as memory is for."""
        kind, (plan, motion) = self.kinds[log], self.experiments[log]
        phases = self.split.phases(None if held_out else False)[log]
        rows = max((line.rows for _, line in plan.sensors.values()), default=0)
        at_once = max(_ROWS // max(rows, 1), 1)
        found: list[LogSummary] = []
        for first in range(0, len(asked), at_once):
            some = slice(first, first + at_once)
            replicates = [
                self._sources(log, *one, own, alone=not held_out)
                for one, own in zip(asked[some], effects[some], strict=True)
            ]
            found += summarise_logs(kind, replicates, phases, temperature_of(motion), self._layouts(log, held_out))
        return found

    def _sources(self, log: int, models: Models, number: int, effects: Effects, *, alone: bool) -> dict[str, Source]:
        """One replicate of a log: these sensors, and where the box moves all others, as many models have in common.
        `alone`: only parts of the log are wanted.
        """
        plan, motion = self.experiments[log]
        wanted = [name for name in plan.sensors if name in (effects if self._moves[log] else models)]
        swapped = [name for name in wanted if any(effect.name == ChannelSwap.name for effect in effects[name])]
        seed = replicate_seed(self.base.seed, number)
        array = (
            simulated_sources(Simulation(plan, motion, effects, seed=seed, boot=self.first_boot + log))
            if swapped
            else {}
        )
        return {
            name: array[name]
            if name in swapped
            else (self._lone if name in models else self._company)(log, name, effects[name], seed, alone)
            for name in wanted
        }

    @cached_property
    def _company(self) -> Callable[[int, str, tuple[Effect, ...], int, bool], Source]:
        """`_lone`, the same one as long as it is kept."""
        return lru_cache(maxsize=_KEPT)(self._lone)

    def _lone(self, log: int, name: str, effects: tuple[Effect, ...], seed: int, alone: bool) -> Source:
        """A sensor that needs no other."""
        plan, motion = self.experiments[log]
        own = replace(plan, sensors={name: plan.sensors[name]})
        simulation = Simulation(own, motion, {name: effects}, seed=seed, boot=self.first_boot + log)
        return simulated_sources(simulation, alone=alone)[name]

    @cached_property
    def _drawn(self) -> Callable[[int], Effects]:
        """What isn't fitted, by the replicate's number."""
        return lru_cache(maxsize=_KEPT)(self.base.drawn)

    def _effects(self, models: Models, number: int) -> Effects:
        """Of every sensor, those of the base model where nothing else is said."""
        found = {}
        for name, drawn in self._drawn(number).items():
            model = models.get(name) or SensorModel(self.base.fitted[name])
            kept = (effect for effect in (*drawn, *model.fitted.effects()) if effect.name not in model.removed)
            found[name] = (*kept, *model.added)
        return found

    def _layouts(self, log: int, held_out: bool) -> tuple[Layout, ...]:
        share = self.split.shares[log]
        return tuple(
            layout for layout, out in zip(self.layouts[log], share.held_out, strict=True) if held_out or not out
        )

    @cached_property
    def _moves(self) -> tuple[bool, ...]:
        """In which logs the box moves while it is looked at."""
        return tuple(not all(map(is_at_rest, share.phases)) for share in self.split.shares)

    def __getstate__(self) -> dict[str, Any]:
        """Without what was worked out, and is again where it is wanted."""
        return {item.name: getattr(self, item.name) for item in fields(self)}
