"""Replication of a recorded campaign, or of parts of it, with simulated sensors.

A replicate is identified by its number: the same number draws the same parts again, for any models of the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers, Reals
from imuarray.gap.model.base_model import Base, FittedParameters, replicate_seed
from imuarray.gap.model.gravity import mean_force_g
from imuarray.gap.model.rest import REFERENCE_DEGC, FilterDraw
from imuarray.gap.model.room_temperature import HEAT_DEGC, ROOM_DEGC, draw_room_temperature
from imuarray.gap.model.vibration import VibratingBox
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
from imuarray.simulate.motion.stimulus import BoxStimulus, Motion, MotionVariant, temperature_at
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
"""Models by sensor."""


@dataclass(frozen=True)
class RememberedMotion(MotionVariant):
    """A motion that caches its stimuli at the latest times in a `memory`, under the key `owner`."""

    memory: DrawMemory
    owner: Hashable

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimuli of the box at times (n,), as read-only arrays."""
        key = ("stimulus", self.owner, time_ns.tobytes())
        return self.memory.recall(key, lambda: _read_only(self.motion.stimulus(time_ns)), _stimulus_bytes)

    def temperature_at(self, time_ns: Integers) -> Reals:
        """Return the temperature (n,) of the motion at times (n,), which is not cached."""
        return temperature_at(self.motion, time_ns)


def _read_only(stimulus: BoxStimulus) -> BoxStimulus:
    """Make the arrays of the stimuli read-only, and return the stimuli."""
    for item in fields(stimulus):
        getattr(stimulus, item.name).flags.writeable = False
    return stimulus


def _stimulus_bytes(stimulus: BoxStimulus) -> int:
    """Return the size of the stimuli in bytes, including their times as a key; constant columns, which store a single
    row, are not counted.
    """
    columns = [getattr(stimulus, item.name) for item in fields(stimulus)]
    return int(stimulus.time_ns.nbytes + sum(column.nbytes for column in columns if 0 not in column.strides))


Effects = Mapping[str, tuple[Effect, ...]]

ReplicateRequest = tuple[Models, int]
"""Models and number of a replicate."""

_OF_LEVELS = frozenset({"channel_swap", "range_reset"})
"""Kinds of effect that change readings by an amount that depends on their level, offset included."""

TOGETHER = 8
"""Largest number of replicates that one job simulates: common work is done once per job, and there are enough jobs for
many workers.
"""

_JOB_ROWS = 10_000_000
"""Largest number of rows of a job over all sensors: some seconds of work, so that workers finish at about the same time
and progress is shown early.
"""

_ROWS = 8 * CHUNK
"""Largest number of rows of a sensor, over the replicates of a log that are processed together; each replicate keeps
four chunks.
"""

_PHASES_PER_CHUNK = 2
"""Largest mean number of phases in a chunk of rows of which only the rows of the phases are simulated: with more of
them, calls for single phases cost more than the whole chunk.
"""

_MEMORY_BYTES = 1 << 27
"""Size of the cache of draws and motions of a process, in bytes: enough for two sensors in two replicates of an hour at
100 Hz, or in twelve of ten minutes.
"""

_ROWS_BYTES = 1 << 27
"""Size of the cache of rows of sensors that others are compared with, in bytes per process: enough for six sensors in
two replicates of two hours at 40 Hz.
"""

_SIGNALS_BYTES = 1 << 26
"""Size of the cache of signals that several models have in common, in bytes per process: enough for three hours of
three sensors at 28 Hz.
"""

_KEPT_LOGS = 256
"""Number of log summaries that a process caches: enough for a sensor in two replicates of a campaign of a hundred logs.
"""

_KEPT = 128
"""Number of results per replicate that are cached."""

_KEPT_SOURCES = 512
"""Number of simulated sensors, with the summaries of their rows, that are cached: enough for two replicates of nine
sensors in 28 logs.
"""


class LogPart(NamedTuple):
    """The phases of log number `log` that are simulated, their layouts, and which of their rows are needed."""

    log: int
    phases: Sequence[Phase]
    layouts: Sequence[Layout]
    demand: Demand


@dataclass(frozen=True)
class Stage:
    """The common part of the replicates of a campaign.

    It consists of the `kinds` of the logs, the `split`, the `layouts` of every phase of the split, the `experiments`
    and the base model. Boots are numbered from `first_boot`: stages of one array with different numbers have the same
    parts but different noise.
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
        """Number of replicates of all sensors that one job simulates."""
        rows = sum(line.rows for experiment in self.experiments for _, line in experiment.plan.sensors.values())
        return min(max(_JOB_ROWS // max(rows, 1), 1), TOGETHER)

    def models(self) -> dict[str, SensorModel]:
        """Return, for every sensor, its model in the base model."""
        return {name: SensorModel(fitted) for name, fitted in self.base.fitted.items()}

    def simulated(
        self, models: Models, number: int, *, held_out: bool = True, other_models: Models = MappingProxyType({})
    ) -> Campaign:
        """Return replicate `number` of the sensors of `models`: all phases that are used, or (`held_out` False) only
        the training part.

        Other sensors are simulated with `other_models`, or with the base model.
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
        """Return what `simulated` returns for several replicates of the same sensors, each with its models and its
        number. Only the given `logs` (None: all) are simulated; the others have no phases.

        A sensor without a model is simulated only where the sensors with models are compared with it
        (`_is_compared_with`).
        """
        chosen = range(len(self.kinds)) if logs is None else logs
        effects = [self._effects({**other_models, **models}, number) for models, number in requests]
        phases = self.split.phases(None if held_out else False)
        parts = [
            self._replicated(
                LogPart(at, phases[at], self._layouts(at, held_out), self._demand(at, held_out)), requests, effects
            )
            if at in chosen
            else [LogSummary(kind, ())] * len(requests)
            for at, kind in enumerate(self.kinds)
        ]
        return [Campaign(replicate) for replicate in zip(*parts, strict=True)]

    def motion_replicates(self, requests: Sequence[ReplicateRequest]) -> list[Campaign]:
        """Return what `campaigns` returns, with only those phases of both parts in which the box moves."""
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
        """Return the summaries of a part of a log in several replicates. Equal replicates are simulated only once,
        since many hypotheses change only some of the logs.
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

    def _demand(self, log: int, held_out: bool) -> Demand:
        """Return which rows of a log are needed: all of both parts; of the training part those of its phases, short
        ones with the rest of their chunks if there are many.
        """
        if held_out:
            return Demand.ANY
        rows = max((line.rows for _, line in self.experiments[log].plan.sensors.values()), default=0)
        phases = self.split.phases(False)[log]
        return Demand.FEW if len(phases) <= _PHASES_PER_CHUNK * rows / CHUNK else Demand.APART

    def _log_key(self, part: LogPart, models: Models, number: int, effects: Effects) -> Hashable:
        """Return a key of everything that the summary of a part of a log depends on in a replicate."""
        is_swapped = any(effect.name == ChannelSwap.name for of_sensor in effects.values() for effect in of_sensor)
        names = effects if is_swapped else self._simulated_names(part.log, models, effects)
        return part.log, number, tuple(part.phases), frozenset(models), tuple((name, effects[name]) for name in names)

    @cached_property
    def _latest_logs(self) -> dict[Hashable, LogSummary]:
        """Cache of the latest logs in which not all effects of the sensors act, by `_log_key`."""
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
        """Return one replicate of a log: the sensors of `models` and those with which they are compared. The latter are
        shared between many models, as is the signal of each sensor of `models` after its first `common` effects.
        Sensors that are compared only in motion are simulated only in motion.
        """
        experiment = self.experiments[log]
        plan = experiment.plan
        names = self._simulated_names(log, models, effects)
        swapped = [name for name in names if any(effect.name == ChannelSwap.name for effect in effects[name])]
        seed = replicate_seed(self.base.seed, number)
        array = (
            simulated_sources(
                Simulation(plan, self._stimulus_motion(log, number), effects, seed=seed, boot=self.first_boot + log)
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
        """Return the sensors of a log that have one of these models or that they are compared with."""
        return [
            name
            for name in self.experiments[log].plan.sensors
            if name in models or (name in effects and self._is_compared_with(log, name, models))
        ]

    def _is_compared_with(self, log: int, name: str, models: Models) -> bool:
        """Return whether statistics of the sensors with these models depend on this sensor. If the box moves in the
        log, they depend on all inertial sensors.
        """
        if self._moves[log] and self.base.headers[name].quantity in INERTIAL:
            return True
        return self._is_compared_at_rest(name, models)

    def _is_compared_at_rest(self, name: str, models: Models) -> bool:
        """Return whether statistics at rest of the sensors with these models depend on this sensor: if it is one of
        them, or, with several models, if it measures the same quantity as one of them.
        """
        if name in models:
            return True
        headers = self.base.headers
        return len(models) > 1 and headers[name].quantity in {headers[model].quantity for model in models}

    @cached_property
    def _cached_source(self) -> Callable[[int, str, tuple[Effect, ...], int, Demand], Source]:
        """`_source` with a cache of sources; their rows are cached too."""

        def source(log: int, name: str, effects: tuple[Effect, ...], number: int, demand: Demand) -> Source:
            owner = (log, name, effects, number)
            return self._source(
                log, name, effects, number, demand, lambda sensor: sensor.remember(self._rows_memory, owner)
            )

        return lru_cache(maxsize=_KEPT_SOURCES)(source)

    @cached_property
    def _memory(self) -> DrawMemory:
        """Cache of the latest draws and motions, which many models in the same replicates have in common."""
        return DrawMemory(_MEMORY_BYTES)

    @cached_property
    def _rows_memory(self) -> DrawMemory:
        """Cache of the latest rows of sensors with which others are compared; separate from that of the draws, which
        are far more numerous.
        """
        return DrawMemory(_ROWS_BYTES)

    def _share(self, owner: Hashable, common: int, sensor: SimulatedSensor) -> None:
        """Make a sensor cache its signal after the first `common` effects, which several models share."""
        if common:
            sensor.share(self._signals_memory, owner, common)

    @cached_property
    def _signals_memory(self) -> DrawMemory:
        """Cache of the latest signals that several models of a sensor have in common."""
        return DrawMemory(_SIGNALS_BYTES)

    def _stimulus_motion(self, log: int, number: int, sensor: str = "") -> Motion:
        """Return the motion of a log in a replicate as a sensor measures it, with a cache of its stimuli."""
        shared = RememberedMotion(self.experiments[log].motion, self._memory, log)
        motion = self._motion(log, number, shared)
        owner: Hashable = (log, number)
        if vibrations := self.experiments[log].vibrations:
            seed, private = replicate_seed(self.base.seed, number), any(item.private.any() for item in vibrations)
            motion = VibratingBox(motion, vibrations, Streams(seed), log, sensor if private else "", self._memory)
            owner = (log, number, motion.sensor)
        return motion if motion is shared else RememberedMotion(motion, self._memory, owner)

    def _motion(self, log: int, number: int, recorded: Motion | None = None) -> Motion:
        """Return the motion of a log in a replicate: `recorded`, or by default that of the experiment, with a room
        temperature drawn for the replicate if the temperature was not recorded.
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
        """Return the simulation of a sensor that does not depend on others; `remember` sets what the sensor caches."""
        experiment = self.experiments[log]
        plan = replace(experiment.plan, sensors={name: experiment.plan.sensors[name]})
        simulation = Simulation(
            plan,
            self._stimulus_motion(log, number, name),
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
        """Function that returns the effects that are not fitted, by the number of the replicate, with a cache."""
        return lru_cache(maxsize=_KEPT)(self.base.drawn)

    @cached_property
    def _filter_draws(self) -> Callable[[int], Mapping[str, FilterDraw]]:
        """Function that returns the filters of all sensors, by the number of the replicate, with a cache."""
        return lru_cache(maxsize=_KEPT)(
            lambda number: {name: self.base.filter_draw(name, number) for name in self.base.fitted}
        )

    def _effects(self, models: Models, number: int) -> Effects:
        """Return the effects of every sensor, those of the base model for sensors without a model."""
        effects, filter_draws = {}, self._filter_draws(number)
        depends_on_level = any(effect.name in _OF_LEVELS for model in models.values() for effect in model.added)
        for name, base_effects in self._drawn_effects(number).items():
            model = models.get(name) or SensorModel(self.base.fitted[name])
            drawn = [effect for effect in base_effects if effect.name not in model.removed]
            fitted = model.fitted.effects(filter_draws[name])
            remaining = [*drawn, *(effect for effect in fitted if effect.name not in model.removed)]
            if depends_on_level and self.base.headers[name].quantity in INERTIAL:
                if len(self.kinds) == 1:  # the fitted level is that of the only boot
                    remaining = [effect for effect in remaining if effect.name != TurnOnBias.name]
                remaining.append(self._at_fitted_level(name, drawn, number))
            effects[name] = (*remaining, *model.added)
        return effects

    def _at_fitted_level(self, name: str, effects: Sequence[Effect], number: int) -> Bias:
        """Return the bias that makes a sensor's level at rest the fitted one, for the `effects` that were drawn for it.

        Offset, response and slope over temperature cannot be separated in one attitude at one temperature: the level is
        known to a fraction of a code, the offset only to the tolerances of the others. Most statistics do not depend on
        the offset, since every replicate is fitted again. If a sensor returns the readings of another one, however,
        they change by the difference between the levels of the two sensors, which is known.
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
        """Function that returns the mean temperature, in degC, over the phases at rest of the training part, by the
        number of the replicate, with a cache.
        """

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
        """Return the fields without cached results, which are computed again when needed."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


def _common_effects(numbers: Sequence[int], effects: Sequence[Effects]) -> dict[int, dict[str, int]]:
    """Return, for each replicate number and each sensor, the number of first effects, in physical order, that all its
    models have in common; 0 if there is only one model.
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
