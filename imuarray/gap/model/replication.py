"""Replication of a recorded campaign, in part or whole, with its sensors simulated by models.

A replicate is identified by its number: the same number draws the same parts again, whatever models the sensors have.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers
from imuarray.gap.model.base_model import Base, FittedParameters, replicate_seed
from imuarray.gap.model.gravity import mean_force_g
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.gap.model.room_temperature import HEAT_DEGC, ROOM_DEGC, draw_room_temperature
from imuarray.gap.recording.phases import is_at_rest
from imuarray.gap.recording.recordings import Experiment, reference_of, temperature_of
from imuarray.gap.recording.source import Source, simulated_sources
from imuarray.gap.statistics.campaign import Campaign, Layout, LogSummary, summarise_logs
from imuarray.gap.statistics.split import Split
from imuarray.log.format import Phase
from imuarray.simulate.active_spans import effects_in
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias, TurnOnBias
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import GSensitivity, Misalignment, Scale
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.motion.felt import Felt, Motion, MotionVariant
from imuarray.simulate.sensor import Demand, SimulatedSensor
from imuarray.simulate.simulation import Simulation, in_physical_order
from imuarray.simulate.streams import CHUNK, DrawMemory, Streams
from imuarray.units import INERTIAL, SI_PER_UNIT, STANDARD_GRAVITY

ORDINARY = frozenset({"white_noise", "bias", "thermal_bias"})
"""Kinds of effect whose parameters are fitted to every recording and every replicate."""


@dataclass(frozen=True)
class SensorModel:
    """The model of one sensor: its ordinary parameters, effects added to those of the base model, and kinds of effect
    removed.
    """

    fitted: FittedParameters
    added: tuple[Effect, ...] = ()
    removed: frozenset[str] = frozenset()


Models = Mapping[str, SensorModel]
"""By sensor."""


@dataclass(frozen=True)
class RememberedMotion(MotionVariant):
    """A motion that keeps what was felt at the latest times in a memory, by its `owner` there."""

    memory: DrawMemory
    owner: Hashable

    def felt(self, time_ns: Integers) -> Felt:
        """Return what the box feels at times (n,), read-only."""
        key = ("felt", self.owner, time_ns.tobytes())
        return self.memory.recall(key, lambda: _read_only(self.motion.felt(time_ns)), _felt_bytes)


def _read_only(felt: Felt) -> Felt:
    """Return what is felt in arrays that cannot be written to."""
    for item in fields(felt):
        getattr(felt, item.name).flags.writeable = False
    return felt


def _felt_bytes(felt: Felt) -> int:
    """Return the memory of what is felt, whose constant columns are one row, and that of its times as a key."""
    columns = [getattr(felt, item.name) for item in fields(felt)]
    return int(felt.time_ns.nbytes + sum(column.nbytes for column in columns if 0 not in column.strides))


Effects = Mapping[str, tuple[Effect, ...]]

ReplicateRequest = tuple[Models, int]
"""A replicate: its models and its number."""

_OF_LEVELS = frozenset({"channel_swap", "range_reset"})
"""Kinds of effect that change readings by an amount that depends on their level, offset included."""

TOGETHER = 8
"""Replicates that one job simulates if there are many: common work is done once, and there are enough jobs for many
workers.
"""

_JOB_ROWS = 10_000_000
"""Most rows of a job over all sensors, some seconds of work, so that workers end at about the same time and progress
shows soon.
"""

_ROWS = 8 * CHUNK
"""Rows of a sensor in all replicates of a log that are processed together; each replicate keeps four chunks."""

_MEMORY_BYTES = 1 << 26
"""Draws and motions that a process remembers: those of a sensor of an hour at 100 Hz in two replicates, or of ten
minutes in a dozen.
"""

_ROWS_BYTES = 1 << 25
"""Rows that a process remembers of sensors with which others are compared: an hour of six sensors at 40 Hz, or some
motions of minutes in eight replicates.
"""

_SIGNALS_BYTES = 1 << 26
"""Signals that a process remembers, which models have in common: those of three sensors of three hours at 28 Hz."""

_KEPT_LOGS = 256
"""Summaries of logs that a process keeps: of a sensor in two replicates of a campaign of a hundred logs."""

_KEPT = 128
"""Simulated sensors that are cached of logs in which the box moves: eight replicates of eight sensors in two logs."""


class LogPart(NamedTuple):
    """The phases of a log (by its number) that are simulated, their layouts, and which rows of them are required."""

    log: int
    phases: Sequence[Phase]
    layouts: Sequence[Layout]
    demand: Demand


@dataclass(frozen=True)
class Stage:
    """The common part of the replicates of a campaign.

    `kinds` of the logs and `layouts` of every phase of the split; the `split`, the `experiments` and the base model.
    Boots are numbered from `first_boot`: stages of one array with other numbers have the same parts but other noise.
    """

    kinds: tuple[str, ...]
    split: Split
    layouts: tuple[tuple[Layout, ...], ...]
    experiments: tuple[Experiment, ...]
    base: Base
    first_boot: int = field(default=0, kw_only=True)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """The motion of the box in each log."""
        return tuple(experiment.motion for experiment in self.experiments)

    @property
    def together(self) -> int:
        """The number of replicates of all sensors that one job simulates."""
        rows = sum(line.rows for experiment in self.experiments for _, line in experiment.plan.sensors.values())
        return min(max(_JOB_ROWS // max(rows, 1), 1), TOGETHER)

    def models(self) -> dict[str, SensorModel]:
        """Return every sensor with the model of the base model."""
        return {name: SensorModel(fitted) for name, fitted in self.base.fitted.items()}

    def simulated(
        self, models: Models, number: int, *, held_out: bool = True, other_models: Models = MappingProxyType({})
    ) -> Campaign:
        """Return replicate `number` of these sensors: all phases that are used, or (`held_out` False) the training
        part.

        Other sensors are simulated by `other_models`, or by the base model.
        """
        (campaign,) = self.campaigns([(models, number)], held_out=held_out, other_models=other_models)
        return campaign

    def campaigns(
        self,
        requests: Sequence[ReplicateRequest],
        *,
        held_out: bool = True,
        other_models: Models = MappingProxyType({}),
        logs: Collection[int] | None = None,
    ) -> list[Campaign]:
        """`simulated` for several replicates of the same sensors, each with its models and its number; only these
        `logs` (None: all), the others without phases.

        Of sensors without a model only what those with one are compared with is simulated (`_is_compared_with`).
        """
        chosen = range(len(self.kinds)) if logs is None else logs
        effects = [self._effects({**other_models, **models}, number) for models, number in requests]
        phases = self.split.phases(None if held_out else False)
        demand = Demand.ANY if held_out else Demand.APART
        parts = [
            self._replicated(LogPart(at, phases[at], self._layouts(at, held_out), demand), requests, effects)
            if at in chosen
            else [LogSummary(kind, ())] * len(requests)
            for at, kind in enumerate(self.kinds)
        ]
        return [Campaign(replicate) for replicate in zip(*parts, strict=True)]

    def motion_replicates(self, requests: Sequence[ReplicateRequest]) -> list[Campaign]:
        """`campaigns`, only the phases of both parts in which the box moves."""
        effects = [self._effects(models, number) for models, number in requests]
        parts = []
        for log, share in enumerate(self.split.shares):
            moving = [at for at, phase in enumerate(share.phases) if not is_at_rest(phase)]
            phases, layouts = [share.phases[at] for at in moving], [self.layouts[log][at] for at in moving]
            parts.append(self._replicated(LogPart(log, phases, layouts, Demand.FEW), requests, effects))
        return [Campaign(replicate) for replicate in zip(*parts, strict=True)]

    def _replicated(
        self, part: LogPart, requests: Sequence[ReplicateRequest], effects: Sequence[Effects]
    ) -> list[LogSummary]:
        """Return summaries of a part of a log in several replicates. Replicates that are the same are simulated once:
        many hypotheses change some of the logs only.
        """
        if not part.phases:
            return [LogSummary(self.kinds[part.log], ())] * len(requests)
        boot = self.first_boot + part.log
        acting = [
            {name: effects_in(boot, of_sensor) for name, of_sensor in replicate_effects.items()}
            for replicate_effects in effects
        ]
        keys = [
            self._log_key(part, *request, replicate_effects)
            for request, replicate_effects in zip(requests, acting, strict=True)
        ]
        latest = self._latest_logs
        known = {key: latest[key] for key in set(keys) if key in latest}
        first = {key: at for at, key in reversed(list(enumerate(keys))) if key not in known}
        new = sorted(first.values())
        simulated = self._summarised(part, [requests[at] for at in new], [acting[at] for at in new])
        known.update(zip((keys[at] for at in new), simulated, strict=True))
        for at in new:
            if any(len(acting[at][name]) < len(effects[at][name]) for name in requests[at][0]):
                latest[keys[at]] = known[keys[at]]
        while len(latest) > _KEPT_LOGS:
            latest.pop(next(iter(latest)), None)
        return [known[key] for key in keys]

    def _log_key(self, part: LogPart, models: Models, number: int, effects: Effects) -> Hashable:
        """Return all that a part of a log depends on in a replicate; of one log, parts differ by their demand."""
        is_swapped = any(effect.name == ChannelSwap.name for of_sensor in effects.values() for effect in of_sensor)
        names = effects if is_swapped else self._simulated_names(part.log, models, effects)
        return part.log, number, part.demand, frozenset(models), tuple((name, effects[name]) for name in names)

    @cached_property
    def _latest_logs(self) -> dict[Hashable, LogSummary]:
        """The latest logs in which not all effects of the sensors act, by all that they depend on."""
        return {}

    def _summarised(
        self, part: LogPart, requests: Sequence[ReplicateRequest], effects: Sequence[Effects]
    ) -> list[LogSummary]:
        """Simulate and summarise a part of a log in several replicates, as many at a time as memory allows."""
        kind, experiment = self.kinds[part.log], self.experiments[part.log]
        rows = max((line.rows for _, line in experiment.plan.sensors.values()), default=0)
        at_once = max(_ROWS // max(rows, 1), 1)
        reference = reference_of(experiment.motion)
        common = _common_effects([number for _, number in requests], effects)
        summaries: list[LogSummary] = []
        for first in range(0, len(requests), at_once):
            some = slice(first, first + at_once)
            replicates = [
                self._sources(part.log, *request, request_effects, part.demand, common[request[1]])
                for request, request_effects in zip(requests[some], effects[some], strict=True)
            ]
            at_rest = {name for name in replicates[0] if self._is_compared_at_rest(name, requests[0][0])}
            summaries += summarise_logs(kind, replicates, part.phases, reference, part.layouts, at_rest)
        return summaries

    def _sources(
        self, log: int, models: Models, number: int, effects: Effects, demand: Demand, common: Mapping[str, int]
    ) -> dict[str, Source]:
        """One replicate of a log: these sensors and those with which they are compared. Many models share the others,
        and the signal after the first `common` effects of these. Those that are only compared in motion are simulated
        only there.
        """
        experiment = self.experiments[log]
        plan = experiment.plan
        names = self._simulated_names(log, models, effects)
        swapped = [name for name in names if any(effect.name == ChannelSwap.name for effect in effects[name])]
        seed = replicate_seed(self.base.seed, number)
        array = (
            simulated_sources(
                Simulation(plan, self._felt_motion(log, number), effects, seed=seed, boot=self.first_boot + log)
            )
            if swapped
            else {}
        )
        return {
            name: experiment.comparable_rows(name, array[name])
            if name in swapped
            else self._source(
                log, name, effects[name], number, demand, partial(self._share, (log, name, number), common[name])
            )
            if name in models
            else self._cached_source(
                log, name, effects[name], number, demand if self._is_compared_at_rest(name, models) else Demand.FEW
            )
            for name in names
        }

    def _simulated_names(self, log: int, models: Models, effects: Effects) -> list[str]:
        """Return the sensors with these models and those of the log with which they are compared."""
        return [
            name
            for name in self.experiments[log].plan.sensors
            if name in models or (name in effects and self._is_compared_with(log, name, models))
        ]

    def _is_compared_with(self, log: int, name: str, models: Models) -> bool:
        """Return whether statistics of the sensors with these models depend on this sensor: on all inertial ones where
        the box moves.
        """
        if self._moves[log] and self.base.headers[name].quantity in INERTIAL:
            return True
        return self._is_compared_at_rest(name, models)

    def _is_compared_at_rest(self, name: str, models: Models) -> bool:
        """Return whether statistics at rest of the sensors with these models depend on this sensor: one of them, or if
        there are several, one that measures the same.
        """
        if name in models:
            return True
        headers = self.base.headers
        return len(models) > 1 and headers[name].quantity in {headers[model].quantity for model in models}

    @cached_property
    def _cached_source(self) -> Callable[[int, str, tuple[Effect, ...], int, Demand], Source]:
        """`_source`, with a cache of sources, whose rows are remembered too."""

        def source(log: int, name: str, effects: tuple[Effect, ...], number: int, demand: Demand) -> Source:
            owner = (log, name, effects, number)
            return self._source(
                log, name, effects, number, demand, lambda sensor: sensor.remember(self._rows_memory, owner)
            )

        return lru_cache(maxsize=_KEPT)(source)

    @cached_property
    def _memory(self) -> DrawMemory:
        """The latest draws and motions: many models are compared in the same replicates."""
        return DrawMemory(_MEMORY_BYTES)

    @cached_property
    def _rows_memory(self) -> DrawMemory:
        """The latest rows of sensors with which others are compared, apart from draws, of which there are many more."""
        return DrawMemory(_ROWS_BYTES)

    def _share(self, owner: Hashable, common: int, sensor: SimulatedSensor) -> None:
        """Let a sensor remember its signal after the first effects, which several models have in `common`."""
        if common:
            sensor.share(self._signals_memory, owner, common)

    @cached_property
    def _signals_memory(self) -> DrawMemory:
        """The latest signals that several models of a sensor have in common."""
        return DrawMemory(_SIGNALS_BYTES)

    def _felt_motion(self, log: int, number: int) -> Motion:
        """Return the motion of a log in a replicate, which remembers what was felt."""
        shared = RememberedMotion(self.experiments[log].motion, self._memory, log)
        motion = self._motion(log, number, shared)
        return motion if motion is shared else RememberedMotion(motion, self._memory, (log, number))

    def _motion(self, log: int, number: int, recorded: Motion | None = None) -> Motion:
        """Return the motion of a log in a replicate, which is `recorded`, or that of the experiment, in a room of its
        own if nobody recorded the temperature.
        """
        experiment = self.experiments[log]
        motion = recorded or experiment.motion
        if experiment.has_temperature:
            return motion
        units = Streams(replicate_seed(self.base.seed, number))
        usual_degc = HEAT_DEGC if experiment.is_heated else ROOM_DEGC
        return draw_room_temperature(motion, units, self.first_boot + log, usual_degc)

    def _source(
        self,
        log: int,
        name: str,
        effects: tuple[Effect, ...],
        number: int,
        demand: Demand,
        remember: Callable[[SimulatedSensor], None],
    ) -> Source:
        """Return the simulation of a sensor that does not depend on others, which is told what to `remember`."""
        experiment = self.experiments[log]
        plan = replace(experiment.plan, sensors={name: experiment.plan.sensors[name]})
        simulation = Simulation(
            plan,
            self._felt_motion(log, number),
            {name: effects},
            seed=replicate_seed(self.base.seed, number),
            boot=self.first_boot + log,
        )
        simulation.streams.memory = self._memory
        sensor = simulation.sensors[name]
        if isinstance(sensor, SimulatedSensor):
            remember(sensor)
        return experiment.comparable_rows(name, simulated_sources(simulation, demand)[name])

    @cached_property
    def _drawn_effects(self) -> Callable[[int], Effects]:
        """The effects that aren't fitted, by the replicate's number."""
        return lru_cache(maxsize=_KEPT)(self.base.drawn)

    def _effects(self, models: Models, number: int) -> Effects:
        """Return the effects of every sensor, those of the base model where no other model is given."""
        effects = {}
        depends_on_level = any(effect.name in _OF_LEVELS for model in models.values() for effect in model.added)
        for name, base_effects in self._drawn_effects(number).items():
            model = models.get(name) or SensorModel(self.base.fitted[name])
            drawn = [effect for effect in base_effects if effect.name not in model.removed]
            fitted = model.fitted.effects(self.base.cutoff_deviate(name, number))
            remaining = [*drawn, *(effect for effect in fitted if effect.name not in model.removed)]
            if depends_on_level and self.base.headers[name].quantity in INERTIAL:
                if len(self.kinds) == 1:  # the fitted level is that of the only boot
                    remaining = [effect for effect in remaining if effect.name != TurnOnBias.name]
                remaining.append(self._at_fitted_level(name, drawn, number))
            effects[name] = (*remaining, *model.added)
        return effects

    def _at_fitted_level(self, name: str, effects: Sequence[Effect], number: int) -> Bias:
        """Return the bias with which a sensor's level at rest is the fitted one, whatever `effects` were drawn for it.

        Offset, response and slope over temperature can't be told apart in one attitude at one temperature: the level is
        known to a fraction of a code, the offset only to the tolerances of the others. Most statistics don't depend on
        it, since a replicate is fitted anew. If a sensor gives the readings of another one, however, these differ by
        the difference of the two levels, which is known.
        """
        header = self.base.headers[name]
        force_g = np.array(header.orientation).T @ self._mean_force_box_g
        unit_per_g = STANDARD_GRAVITY / SI_PER_UNIT[header.unit] if header.quantity == "specific_force" else 0.0
        shift = np.zeros(3)
        for effect in effects:
            if isinstance(effect, Scale):
                shift += np.array(effect.error) * force_g * unit_per_g
            elif isinstance(effect, Misalignment):
                shift += (effect.directions - np.eye(3)) @ force_g * unit_per_g
            elif isinstance(effect, GSensitivity):
                shift += np.reshape(effect.response, (3, 3)) @ force_g
            elif isinstance(effect, ThermalBias):
                warmer_degc = self._mean_degc(number) - effect.reference_degc
                shift += warmer_degc * (np.array(effect.slope) + warmer_degc * np.array(effect.quadratic))
            elif isinstance(effect, Bias):
                shift += effect.offset
        x, y, z = (-shift).tolist()
        return Bias((x, y, z))

    @cached_property
    def _mean_degc(self) -> Callable[[int], float]:
        """The mean temperature over the phases at rest of the training part, by the replicate's number."""

        def mean_degc(number: int) -> float:
            temperatures = [
                temperature_of(self._motion(log, number))(np.array([(phase.start_ns + phase.end_ns) // 2]))[0]
                for log, phases in enumerate(self.split.phases(False))
                for phase in phases
                if is_at_rest(phase)
            ]
            return float(np.mean(temperatures)) if temperatures else REFERENCE_DEGC

        return lru_cache(maxsize=_KEPT)(mean_degc)

    @cached_property
    def _mean_force_box_g(self) -> Floats:
        """Mean specific force (3,) in g, box frame, over the phases at rest of the training part."""
        forces_g = [
            mean_force_g(experiment.motion, phase)
            for experiment, phases in zip(self.experiments, self.split.phases(False), strict=True)
            for phase in phases
            if is_at_rest(phase)
        ]
        return np.asarray(np.mean(forces_g, axis=0)) if forces_g else np.zeros(3)

    def _layouts(self, log: int, held_out: bool) -> tuple[Layout, ...]:
        share = self.split.shares[log]
        return tuple(
            layout for layout, out in zip(self.layouts[log], share.held_out, strict=True) if held_out or not out
        )

    @cached_property
    def _moves(self) -> tuple[bool, ...]:
        """For each log, true if the box moves in the phases that are used."""
        return tuple(not all(map(is_at_rest, share.phases)) for share in self.split.shares)

    def __getstate__(self) -> dict[str, Any]:
        """The fields without cached results, which are computed again where they are needed."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


def _common_effects(numbers: Sequence[int], effects: Sequence[Effects]) -> dict[int, dict[str, int]]:
    """Return, for each number of a replicate and each sensor, how many effects its models begin with alike, in physical
    order; 0 if there is one model only.
    """
    by_number: dict[int, dict[str, set[tuple[Effect, ...]]]] = {}
    for number, of_replicate in zip(numbers, effects, strict=True):
        chains = by_number.setdefault(number, {})
        for name, of_sensor in of_replicate.items():
            chains.setdefault(name, set()).add(in_physical_order(of_sensor))
    return {
        number: {name: _common_length(list(several)) for name, several in chains.items()}
        for number, chains in by_number.items()
    }


def _common_length(chains: Sequence[tuple[Effect, ...]]) -> int:
    """Return the number of first items that several sequences have in common; 0 for a single one."""
    if len(chains) < 2:
        return 0
    return next(
        (at for at, items in enumerate(zip(*chains, strict=False)) if len(set(items)) > 1), min(map(len, chains))
    )
