"""A box tumbled by hand from one attitude to the next, with a rest in each; and its array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from imuarray.array import load_array
from imuarray.log.format import Phase
from imuarray.simulate import BoxStimulus, Simulation, plan_of, write_log
from imuarray.simulate.effect import Effect
from imuarray.simulate.motion.timeline import smooth_step
from tests.calibrate.conftest import Floats

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
G = 9.80665


@dataclass(frozen=True)
class HandTumble:
    """Rests of `rest_s` in every one of `attitudes` (box to level frame), turns of `turn_s` about one axis each."""

    attitudes: Rotation
    rest_s: float = 6.0
    turn_s: float = 2.0
    phases: tuple[Phase, ...] = ()

    @property
    def seconds(self) -> float:
        return len(self.attitudes) * (self.rest_s + self.turn_s) - self.turn_s

    @cached_property
    def turns(self) -> Floats:
        """(k, 3) rotation vectors in the box frame from each attitude to the next; no turn after the last."""
        return np.concatenate([(self.attitudes[:-1].inv() * self.attitudes[1:]).as_rotvec(), np.zeros((1, 3))])

    def stimulus(self, time_ns: np.ndarray) -> BoxStimulus:
        seconds = np.clip(time_ns * 1e-9, 0, self.seconds - 1e-6)
        place = (seconds // (self.rest_s + self.turn_s)).astype(int)
        since = seconds - place * (self.rest_s + self.turn_s) - self.rest_s
        turned, speed, gain, _ = smooth_step(since / self.turn_s)
        attitude = self.attitudes[place] * Rotation.from_rotvec(self.turns[place] * turned[:, None])
        rate = self.turns[place] * speed[:, None] / self.turn_s
        still = np.zeros(len(time_ns))
        return BoxStimulus(
            time_ns,
            attitude.inv().apply([0.0, 0.0, G]),
            rate,
            self.turns[place] * gain[:, None] / self.turn_s**2,
            np.zeros((len(time_ns), 3)),
            still + 25.0,
            still + 101325.0,
        )


def attitudes(count: int, rng: np.random.Generator, least_deg: float = 40.0, most_deg: float = 150.0) -> Rotation:
    """Random attitudes, each at some distance from the previous one."""
    made = [Rotation.random(random_state=rng)]
    while len(made) < count:
        axis = rng.normal(size=3)
        angle = np.radians(rng.uniform(least_deg, most_deg))
        made.append(made[-1] * Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)))
    return Rotation.concatenate(made)


def record(
    path: Path,
    motion: HandTumble,
    effects: Mapping[str, Sequence[Effect]],
    *,
    rate_hz: float = 100.0,
    rates_hz: Mapping[str, float] = MappingProxyType({}),
    seed: int = 1,
    only: tuple[str, ...] = (),
) -> Path:
    """Write a log of the paper's array, or a part of it, in the box, with other rates for some sensors by name."""
    array = load_array(CONFIG)
    array = array.only(only) if only else array
    plan = plan_of(array, rate_hz, motion.seconds)
    others = {name: plan_of(array, rate, motion.seconds).sensors[name] for name, rate in rates_hz.items()}
    plan = replace(plan, sensors={**plan.sensors, **others})
    write_log(Simulation(plan, motion, effects, seed=seed), path)
    return path
