"""A whole simulated array: every sensor's timeline, effects and streams over one motion.

The result depends on the seed and not on the block size or number of workers. No array in memory is as long as the log.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imuarray.array import ArrayConfig
from imuarray.errors import ConfigError, LogError
from imuarray.log import Log
from imuarray.log.format import SATURATED, SensorHeader, header_of
from imuarray.log.missed_frames import frames_in
from imuarray.log.sensor_log import recorded_header
from imuarray.log.writer import Stimulus
from imuarray.simulate.converters import thermometer_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.effects.response import SizeEffect, with_position
from imuarray.simulate.model import Model
from imuarray.simulate.sensor import SimulatedBarometer, SimulatedSensor, Surroundings
from imuarray.simulate.signal import Codes, Motion
from imuarray.simulate.streams import Streams
from imuarray.simulate.timeline import LogTimes, PollTimes, Timeline, poll
from imuarray.spelling import guess

EVERY_FLAG = 0xFFFF
IMPORTED_FLAGS = SATURATED
"""Flags of an imported log (`imuarray.importers`), whose counts alone do not show whether a reading is new."""

_FRAMES_LIKE_HZ = 50.0
"""Rate in Hz of `/truth` in a log that is simulated like a recorded one."""


@dataclass(frozen=True)
class Plan:
    """The sensors and the times at which they are read: what a simulation and a recording of the same run share."""

    sensors: Mapping[str, tuple[SensorHeader, Timeline]]
    frames: PollTimes
    """The times at which frames begin, which are those of `/truth`."""
    config: str = ""
    frame_rate_hz: float = 0.0
    """The requested rate of frames; 0 if unknown."""
    flags: int = EVERY_FLAG
    """Flags that the recorder sets; an imported table has `IMPORTED_FLAGS` only."""


def plan_of(array: ArrayConfig, frame_rate_hz: float, seconds: float) -> Plan:
    """Return the plan of an array polled `frame_rate_hz` times a second for `seconds`."""
    lines = poll(array, frame_rate_hz, seconds)
    sensors = {sensor.name: (header_of(sensor, {}), lines[sensor.name]) for sensor in array.sensors}
    frames = PollTimes(frames_in(seconds, frame_rate_hz), round(1e9 / frame_rate_hz))
    return Plan(sensors, frames, array.text, frame_rate_hz)


def plan_like(log: Log, only: Collection[str] = ()) -> Plan:
    """Return the plan of a recorded log: its sensors (or `only` these), read at the recorded times. The readings of a
    chip's thermometer with an unknown scale are omitted.

    LogError for a sensor that the log does not have.
    """
    chosen = {name: log[name] for name in only or log.sensors}
    chosen = {name: sensor for name, sensor in chosen.items() if sensor.quantity != "temperature"}  # no chip is stated
    headers = {name: recorded_header(sensor) for name, sensor in chosen.items() if len(sensor)}
    sensors = {
        name: (replace(header, has_temperature=thermometer_of(header) is not None), LogTimes(chosen[name]))
        for name, header in headers.items()
    }
    if not sensors:
        raise LogError(f"{log.path}: has no readings")
    end_ns = max(int(sensor.time[-1]) for sensor in chosen.values() if len(sensor))
    period_ns = round(1e9 / _FRAMES_LIKE_HZ)
    flags = IMPORTED_FLAGS if log.source == "imported" else EVERY_FLAG
    return Plan(sensors, PollTimes(end_ns // period_ns + 1, period_ns), log.config, log.frame_rate_hz, flags)


class Simulation:
    """The sensors of a plan over a motion, each through its own effects."""

    def __init__(
        self,
        plan: Plan,
        motion: Motion,
        effects: Mapping[str, Sequence[Effect]],
        *,
        seed: int = 0,
        boot: int = 0,
        dtype: npt.DTypeLike = np.float64,
    ) -> None:
        """Simulate a run. `effects` are the effects of each sensor, in any order; a sensor without an entry is ideal.
        `boot` is the number of the run: at another boot the same units are switched on again.
        """
        self.plan = plan
        self.motion = motion
        self.streams = Streams(seed, boot)
        self.sensors: dict[str, SimulatedSensor | SimulatedBarometer] = {}
        for name, (header, timeline) in plan.sensors.items():
            if header.quantity == "pressure":
                self.sensors[name] = SimulatedBarometer(header, timeline, motion, self.streams)
            else:
                chain = in_physical_order(effects.get(name, ()))
                lies = place_of(header, chain, plan).orientation
                surroundings = Surroundings(motion, self.streams, self._codes_of, dtype)
                self.sensors[name] = SimulatedSensor(header, timeline, chain, surroundings, lies)

    @classmethod
    def of_array(
        cls,
        array: ArrayConfig,
        motion: Motion,
        model: Model,
        *,
        frame_rate_hz: float,
        seed: int = 0,
        boot: int = 0,
    ) -> Simulation:
        """Return the simulation of an array that is polled during the whole motion, with units that `model` defines."""
        plan = plan_of(array, frame_rate_hz, motion.seconds)
        return cls(plan, motion, effects_of(plan, model, seed), seed=seed, boot=boot)

    def truth(self, start: int, stop: int) -> Stimulus:
        """Return rows of `/truth`: the stimulus at the beginning of frames start ... stop - 1."""
        stimulus = self.motion.stimulus(self.plan.frames.stamps(start, stop))
        return Stimulus(
            stimulus.time_ns,
            np.asarray(stimulus.force_box, float),
            np.asarray(stimulus.rate_box, float),
            np.asarray(stimulus.temperature_degc, float),
        )

    def _codes_of(self, name: str, first: int, stop: int) -> Codes:
        sensor = self.sensors.get(name)
        if not isinstance(sensor, SimulatedSensor):
            raise KeyError(f"{name}: no triad of this array; it has {', '.join(self.sensors)}")
        return sensor.codes(first, stop)


def effects_of(
    plan: Plan, model: Model, seed: int, *, population: bool = False, without: Collection[str] = ()
) -> dict[str, tuple[Effect, ...]]:
    """Return the effects of every sensor of a plan: those that `model` defines for its unit, and those that follow from
    its position.

    ConfigError for an unknown effect in `without`.
    """
    if unknown := sorted(set(without) - set(EFFECTS)):
        raise ConfigError(f"effect {unknown[0]!r}: allowed are {', '.join(EFFECTS)}{guess(unknown[0], EFFECTS)}")
    units = Streams(seed)
    effects_by_name: dict[str, tuple[Effect, ...]] = {}
    for name, (header, _) in plan.sensors.items():
        if header.quantity == "pressure":
            continue
        effects = model.effects(header, units, population=population, without=frozenset(without))
        if SizeEffect.name not in without:
            effects = with_position(effects, place_of(header, effects, plan).position_mm)
        effects_by_name[name] = in_physical_order(effects)
    return effects_by_name


def place_of(header: SensorHeader, effects: Sequence[Effect], plan: Plan) -> SensorHeader:
    """Return the position and orientation of a sensor with these effects: those of its header, or of another sensor
    whose place it has. ValueError if there is no such sensor.
    """
    for effect in effects:
        if isinstance(effect, ChannelSwap) and effect.kind == "place" and effect.sensor:
            if effect.sensor not in plan.sensors:
                names = ", ".join(plan.sensors)
                raise ValueError(f"channel_swap of {header.name}: {effect.sensor}: not in this array; it has {names}")
            return plan.sensors[effect.sensor][0]
    return header


def in_physical_order(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects in the order in which they act."""
    order = {name: index for index, name in enumerate(EFFECTS)}
    return tuple(sorted(effects, key=lambda effect: order[effect.name]))
