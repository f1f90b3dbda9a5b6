"""A small array, five short experiments on it, and blocks made by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from imuarray.array import parse_array
from imuarray.gap.findings.diagnosis import Where
from imuarray.gap.recording.recordings import Recording, reference_of, sources_of
from imuarray.gap.recording.source import simulated_sources
from imuarray.gap.statistics.campaign import Campaign, LogSummary, summarise_log
from imuarray.gap.statistics.probes import PROBES, LogProbe, PhaseProbe
from imuarray.gap.statistics.segments import Temperature
from imuarray.gap.statistics.summary import Grid, Summary, Tally
from imuarray.log.format import Phase, SensorHeader
from imuarray.log.writer import Block
from imuarray.simulate import Motion, Simulation, plan_of
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import Misalignment, Scale
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.tumble import Tumble
from imuarray.simulate.record import phases_within

RATE_HZ = 100.0

SECOND = 10**9

SCALE = 2048.0
"""Counts per g of `header`."""

ARRAY = """
[array]
name = "two of each"
bus = "i2c:/dev/i2c-1"

[[sensor]]
name = "A1"
chip = "bma180"
address = 0x40
range = 4
bandwidth_hz = 150
axes = "+X+Y+Z"

[[sensor]]
name = "A2"
chip = "bma180"
address = 0x41
range = 4
bandwidth_hz = 150
axes = "-X+Y-Z"

[[sensor]]
name = "G1"
chip = "l3g4200d"
address = 0x68
range = 250
rate_hz = 800
bandwidth_hz = 35
axes = "+X+Y+Z"

[[sensor]]
name = "G2"
chip = "l3g4200d"
address = 0x69
range = 250
rate_hz = 800
bandwidth_hz = 35
axes = "+X-Y-Z"
"""

BASE: Mapping[str, tuple[Effect, ...]] = {
    "A1": (WhiteNoise(0.004), Bias(0.02), ThermalBias(0.0005)),
    "A2": (WhiteNoise(0.004), Bias(-0.01), ThermalBias(0.0005)),
    "G1": (WhiteNoise(0.05), Bias(0.5), ThermalBias(0.05)),
    "G2": (WhiteNoise(0.05), Bias(-1.0), ThermalBias(0.05)),
}

PLANS: Mapping[str, tuple[Motion, ...]] = {
    "static": (Still(seconds=60),),
    "tumble": (Tumble(10.0, 1.0),),
    "heating": (Heating(scale=0.02),),
    "turn-on": tuple(turn_on_run(run, 20.0) for run in range(1, 9)),
    "motion": (HandShake(still_s=5, motion_s=20),),
}

Effects = Mapping[str, Sequence[Effect]]


def simulation(motion: Motion, more: Effects, seed: int, boot: int = 0) -> Simulation:
    effects = {name: (*base, *more.get(name, ())) for name, base in BASE.items()}
    return Simulation(plan_of(parse_array(ARRAY), RATE_HZ, motion.seconds), motion, effects, seed=seed, boot=boot)


def phases_of(motion: Motion) -> list[Phase]:
    return phases_within(motion.phases, round(motion.seconds * 1e9))


def campaign_of(kind: str, more: Effects | None = None, seed: int = 0) -> Campaign:
    """One of `PLANS`, simulated with `BASE` and more effects."""
    return Campaign(tuple(_log(kind, motion, more or {}, seed, boot) for boot, motion in enumerate(PLANS[kind])))


def _log(kind: str, motion: Motion, more: Effects, seed: int, boot: int) -> LogSummary:
    sources = simulated_sources(simulation(motion, more, seed, boot))
    return summarise_log(kind, sources, phases_of(motion), reference_of(motion))


def summarised(recording: Recording) -> LogSummary:
    """A recorded log in its own phases."""
    motion = recording.experiment.motion
    return summarise_log(recording.kind, sources_of(recording), recording.phases, reference_of(motion))


def header(name: str = "S", axes: str = "+X+Y+Z", chip: str = "bma180", **changes: Any) -> SensorHeader:
    kinds: dict[str, tuple[str, str, float, float]] = {
        "bma180": ("specific_force", "g", 4.0, 2048.0),
        "adxl345": ("specific_force", "g", 16.0, 256.0),
        "l3g4200d": ("angular_rate", "dps", 250.0, 1 / 0.00875),
    }
    quantity, unit, range_, sensitivity = kinds[chip]
    facts: dict[str, Any] = {"quantity": quantity, "unit": unit, "range": range_, "sensitivity": sensitivity}
    return SensorHeader(name, chip, **{**facts, "axes": axes, **changes})


def block(counts: npt.ArrayLike, interval_ns: int = 10_000_000, start_ns: int = 0, **changes: Any) -> Block:
    """Counts (n, 3) or (n,), the same for all axes, at even times."""
    rows = np.asarray(counts)
    wide = np.asarray(rows if rows.ndim == 2 else np.stack([rows] * 3, axis=1), np.int16)
    times = start_ns + np.arange(len(wide), dtype=np.int64) * interval_ns
    return Block(times, wide, np.zeros(len(wide), np.uint16), None)._replace(**changes)


def summary(
    rows: Block,
    phase: Phase | None = None,
    temperature: Temperature = lambda time_ns: np.full(len(time_ns), 25.0),
    cuts: Sequence[int] = (),
    sensor: SensorHeader | None = None,
) -> Summary:
    """Summary of one block, fed in pieces that end at `cuts`."""
    whole = phase or Phase(0, int(rows.time[-1]) + 10_000_000, "static", "+Z")
    tally = Tally(sensor or header(), whole, Grid.of(len(rows.time)))
    edges = [0, *cuts, len(rows.time)]
    for first, stop in pairwise(edges):
        thermometer = None if rows.temperature_counts is None else rows.temperature_counts[first:stop]
        parts = (rows.time[first:stop], rows.counts[first:stop], rows.status[first:stop], thermometer)
        if stop > first:
            tally.update(Block(*parts))
    return tally.result(temperature)


def value(name: str, subject: Summary | Sequence[Summary]) -> np.ndarray:
    probe = PROBES[name]
    assert isinstance(probe, PhaseProbe | LogProbe)
    return probe.statistic(subject)  # type: ignore[arg-type]


def gaussian(sigma: float = 20.0, rows: int = 20_000, seed: int = 1) -> np.ndarray:
    return np.rint(np.random.default_rng(seed).normal(0, sigma, (rows, 3)))


class OneBlock:
    """A source of one block."""

    def __init__(self, sensor: SensorHeader, rows: Block) -> None:
        self.header, self._rows = sensor, rows

    def rows(self, start_ns: int, end_ns: int) -> int:
        return len(self._rows.time)

    def blocks(self, start_ns: int, end_ns: int):  # type: ignore[no-untyped-def]
        yield self._rows


def where(sensor: str, axis: str, statistic: str = "line") -> Where:
    values = ("static", statistic, "", 30.0, 0.0, "", 30.0, 0.01, 3.0, 1.0)
    return Where("a.h5", sensor, axis, "spectrum", *values, "material")  # type: ignore[arg-type]


def units(seed: int) -> dict[str, tuple[Effect, ...]]:
    """Scales and misalignments within the data sheets, drawn independently of the library."""
    random = np.random.default_rng((99, seed))
    return {
        name: (
            Scale(tuple(np.clip(random.normal(0, 0.01, 3), -0.02, 0.02))),  # type: ignore[arg-type]
            Misalignment(tuple(np.clip(random.normal(0, 0.5, 6), -1, 1))),
        )
        for name in BASE
    }
