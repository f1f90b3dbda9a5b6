"""The small array put down by hand in unrecorded attitudes, simulated and as a log without truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imuarray.array import parse_array
from imuarray.arrays import Floats
from imuarray.gap.recording.recordings import reference_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, summarise_log
from imuarray.log import LogWriter
from imuarray.log.format import Phase
from imuarray.simulate import Simulation, plan_of
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.posed import PoseAttitude, PoseSequence
from tests.gap.small_campaign import ARRAY, BASE, RATE_HZ, SECOND, Effects

POSE_S, TURN_S = 5, 1


def directions(count: int, seed: int = 0) -> Floats:
    """(k, 3) in all directions, all different."""
    ways = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(ways / np.linalg.norm(ways, axis=1)[:, None])


def posed(ups: Floats, pose_s: int = POSE_S) -> PoseSequence:
    """One attitude after the other."""
    starts = [number * (pose_s + TURN_S) * SECOND for number in range(len(ups))]
    attitudes = [
        PoseAttitude(Phase(start, start + pose_s * SECOND, f"pose {number}"), (x, y, z), estimated=True)
        for number, (start, (x, y, z)) in enumerate(zip(starts, ups.tolist(), strict=True), start=1)
    ]
    return PoseSequence(tuple(attitudes), Still(seconds=len(ups) * (pose_s + TURN_S)))


def simulated(motion: PoseSequence, more: Effects, seed: int = 0) -> Simulation:
    """The box in these attitudes, temperature 25 degC."""
    effects = {name: (*base, *more.get(name, ())) for name, base in BASE.items()}
    return Simulation(plan_of(parse_array(ARRAY), RATE_HZ, motion.seconds), motion, effects, seed=seed)


def campaign_in(motion: PoseSequence, more: Effects | None = None, seed: int = 0) -> Campaign:
    """One log."""
    sources = simulated_sources(simulated(motion, more or {}, seed))
    return Campaign((summarise_log("tumble", sources, motion.phases, reference_of(motion)),))


def written(path: Path, simulation: Simulation, phases: tuple[Phase, ...] = ()) -> Path:
    """A log with no information on the motion except `phases`."""
    sensors = simulation.sensors
    with LogWriter(
        path, [one.header for one in sensors.values()], source="imported", epoch="2024-01-01T00:00:00Z"
    ) as log:
        for name, sensor in sensors.items():
            log.append(name, sensor.block(0, sensor.rows))
        for phase in phases:
            log.phase(phase)
    return path
