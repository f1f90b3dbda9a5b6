"""Experiments with an array on a bench: short versions of the experiments of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from firmware_emulator.world import HeatingWorld, PhasedWorld, Shaking, StillWorld, TumbleWorld, WorldPhase


@dataclass(frozen=True)
class BenchExperiment:
    """An experiment of `logs` power-ups of `seconds` each in a `world`, in files called `name`; `phase` is the name of
    a phase that lasts for the whole log.

    The reference instrument is read at `reference_hz`; 0: once in every frame.
    """

    name: str
    world: PhasedWorld
    seconds: float
    logs: int = 1
    phase: str = ""
    reference_hz: float = 0.0

    def file(self, index: int) -> str:
        """Return the name of log number `index`."""
        return f"{self.name}.h5" if self.logs == 1 else f"{self.name}_{index + 1:02d}.h5"

    def phases(self, index: int) -> tuple[WorldPhase, ...]:
        """Return the phases that a person with a stopwatch notes during log number `index`."""
        if not self.phase:
            return self.world.phases
        name = f"{self.phase} {index + 1}" if self.logs > 1 else self.phase
        return (WorldPhase(0, 1 << 62, name, "+Z"),)


EXPERIMENTS: Mapping[str, BenchExperiment] = MappingProxyType(
    {
        "static": BenchExperiment("static", StillWorld(), 120.0, phase="static"),
        "tumble": BenchExperiment("tumble", TumbleWorld(face_s=15.0), 117.0),
        "heating": BenchExperiment("heating", HeatingWorld(scale=0.1), 240.0),
        "turn-on": BenchExperiment("boot", StillWorld(), 12.0, logs=10, phase="run"),
        "motion": BenchExperiment("motion", Shaking(peak_g=0.35, peak_dps=150.0), 50.0, reference_hz=500.0),
    }
)
"""Experiments by the names that the command line uses; together they last nine minutes of emulated time."""


def known_experiment(name: str) -> BenchExperiment:
    """Return an entry of `EXPERIMENTS`; the ValueError for an unknown name lists the known ones."""
    if name not in EXPERIMENTS:
        raise ValueError(f"experiment {name!r}; allowed are {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name]
