"""Writes cases: logs of worlds, and apart from them what is true of each.

python -m tests.foreign_world.cases OUT --half development --seed 1 --count 20 --kind control
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.foreign_world.chain import Act, record
from tests.foreign_world.deeds import Placement, When
from tests.foreign_world.effects import ALL, DESIGN_NAMES, EFFECTS, UNKNOWN, Effect
from tests.foreign_world.logfile import write_log
from tests.foreign_world.parts import SI, Sensor, stream
from tests.foreign_world.severity import limit
from tests.foreign_world.world import World, draw_world

HALVES = ("development", "sealed")
KINDS = ("control", "effect", "unknown", "pair")
SEVERITY = 5.0
"""Size of an effect in detection limits, unless another is asked for."""
MOST_SECONDS = 620.0
MOST_ROWS = 120_000
"""What a case has at most, all logs and sensors together, so that a diagnosis takes little time."""
MOST_ATTEMPTS = 200


@dataclass(frozen=True)
class Occurrence:
    """An effect in a case."""

    name: str
    place: Placement
    size: float
    limit: float | None
    severity: float | None

    @property
    def effect(self) -> Effect:
        return EFFECTS[self.name]


@dataclass(frozen=True)
class Case:
    """A world and what is wrong in it."""

    kind: str
    world: World
    occurrences: tuple[Occurrence, ...]


def case_key(half: str, seed: int, kind: str, index: int) -> str:
    """Key of a case's random streams; the half is part of it, so that those of the two halves never meet."""
    if half not in HALVES or kind not in KINDS:
        raise ValueError(f"half is one of {HALVES}, kind one of {KINDS}; got {half}, {kind}")
    return f"{half}:{seed}:{kind}:{index}"


def draw_case(
    half: str, seed: int, kind: str, index: int, severity: float = SEVERITY, only: tuple[str, ...] = ()
) -> Case:
    """The case of this key. Effects take turns, so that a run of cases has all of them; `only` limits which."""
    key = case_key(half, seed, kind, index)
    rng = stream(key, "case")
    if kind == "control":
        return Case(kind, small_world(key), ())
    names = list(only or (UNKNOWN if kind == "unknown" else DESIGN_NAMES))
    order = stream(half, seed, kind, "order", index // len(names)).permutation(names)
    wanted = [str(order[index % len(names)])]
    if kind == "pair":
        others = [name for name in names if DESIGN_NAMES[name] != DESIGN_NAMES[wanted[0]]] or names
        wanted.append(str(rng.choice(others)))
    for attempt in range(MOST_ATTEMPTS):
        world = small_world(f"{key}:{attempt}")
        places = [draw_placement(world, name, f"{world.key}:{name}") for name in wanted]
        if all(place is not None for place in places):
            placed = tuple(
                occurrence(world, name, place, severity) for name, place in zip(wanted, places, strict=True) if place
            )
            if all(item is not None for item in placed):
                return Case(kind, world, tuple(item for item in placed if item is not None))
    raise RuntimeError(f"no world shows {wanted}")


def small_world(key: str) -> World:
    """The first world of this key that is no longer than a case may be."""
    for attempt in range(MOST_ATTEMPTS):
        world = draw_world(f"{key}/{attempt}")
        rows = world.duration_s * world.recorder.frame_rate_hz * len(world.sensors)
        if world.duration_s <= MOST_SECONDS and rows <= MOST_ROWS:
            return world
    raise RuntimeError("no world is small enough")


def draw_placement(world: World, name: str, key: str) -> Placement | None:
    """A place for the effect in this world; None if this world can't show it."""
    effect, rng = EFFECTS[name], stream(key, "placement")
    able = [sensor for sensor in world.inertial if can_show(world, effect, sensor)]
    if not able:
        return None
    sensor = able[int(rng.integers(len(able)))]
    names = [sensor.name]
    if effect.span in ("pair", "twins"):
        same = [
            s for s in able if s != sensor and s.facts.quantity == sensor.facts.quantity and s.divider == sensor.divider
        ]
        same = [s for s in same if effect.span == "pair" or (s.chip, s.range) == (sensor.chip, sensor.range)]
        if not same:
            return None
        names.append(same[int(rng.integers(len(same)))].name)
    elif effect.span == "array":
        names = [sensor.name for sensor in world.inertial]
    axes = (0, 1, 2) if effect.span != "axis" or rng.random() < 0.3 else (int(rng.integers(3)),)
    if name == "flipped_axis":
        axes = axes[:1]
    if name == "leak_of_last_reading":
        names = names[:1]
    when = draw_when(world, effect, rng)
    return None if when is None else Placement(tuple(names), axes, when, key)


def can_show(world: World, effect: Effect, sensor: Sensor) -> bool:
    """Whether the plan has experiments that show the effect on this sensor, and the sensor's settings allow it."""
    if sensor.chip not in effect.chips:
        return False
    if not any(needed <= world.kinds for needed in effect.shows.get(sensor.facts.quantity, ())):
        return False
    poll_rate = world.recorder.frame_rate_hz / sensor.divider
    if effect is EFFECTS["half_data_rate"]:
        return poll_rate > 0.6 * sensor.rate_hz
    if effect is EFFECTS["low_passed_output"]:
        return sensor.bandwidth_hz > 0.4 * poll_rate
    return True


def draw_when(world: World, effect: Effect, rng: np.random.Generator) -> When | None:
    """When the effect acts; logs and moments are such that it can be seen both with and without."""
    kind = str(rng.choice(effect.whens))
    alternatives = [a for sets in effect.shows.values() for a in sets]
    showing = [i for i, e in enumerate(world.experiments) if any(e.kind in needed for needed in alternatives)]
    at = showing[int(rng.integers(len(showing)))]
    length = world.experiments[at].stimulus.duration_s
    if kind == "logs":
        if len(showing) < 2:
            return None
        chosen = rng.choice(showing, int(rng.integers(1, len(showing))), replace=False)
        return When(kind, logs=tuple(sorted(int(i) for i in chosen)))
    if kind == "from":
        return When(kind, stretches=((at, float(rng.uniform(0.25, 0.7)) * length, float("inf")),))
    if kind == "stretches":
        starts = rng.uniform(0.05, 0.8, int(rng.integers(1, 4))) * length
        return When(
            kind, stretches=tuple((at, float(s), float(s + rng.uniform(0.05, 0.2) * length)) for s in sorted(starts))
        )
    if kind == "moments":
        times = np.sort(rng.uniform(0.05, 0.95, int(rng.integers(1, 8))) * length)
        return When(kind, stretches=tuple((at, float(t), float(t)) for t in times))
    return When(kind)


def occurrence(world: World, name: str, place: Placement, severity: float) -> Occurrence | None:
    """The effect at so many detection limits; None if it would have to be absurdly large."""
    effect = EFFECTS[name]
    smallest = limit(world, effect, place)
    if smallest is None:
        return Occurrence(name, place, effect.start, None, None)
    sensor = next(s for s in world.sensors if s.name == place.sensors[0])
    size = max(severity * smallest, effect.least(sensor))
    if not is_sane(world, effect, place, size):
        return None
    return Occurrence(name, place, size, smallest, size / smallest)


def is_sane(world: World, effect: Effect, place: Placement, size: float) -> bool:
    """Whether a real array could have the effect at this size: none larger than a fifth of a sensor's range, no delay
    of half a second, no displacement of a third of a metre, no clock off by a percent.
    """
    sensor = next(s for s in world.sensors if s.name == place.sensors[0])
    if effect.unit == "SI":
        return size < 0.2 * sensor.range * SI[sensor.facts.unit]
    most = {"s": 60.0 if effect.limit == "count" else 0.5, "m": 0.3, "rad": 0.6}
    most |= {"half poll rate over cut-off": 40.0, "rows": 1e9}
    if effect.design_name == "clock_error":
        return size < 0.01
    return size < most.get(effect.unit, float("inf"))


def write_case(case: Case, folder: Path) -> list[Path]:
    """Its logs, in the order in which they were recorded."""
    folder.mkdir(parents=True, exist_ok=True)
    acts: dict[str, list[Act]] = {}
    for item in case.occurrences:
        for name, deeds in item.effect.acts(item.place, item.size).items():
            acts.setdefault(name, []).extend(deeds)
    paths = []
    for log, experiment in enumerate(case.world.experiments):
        signals = [record(case.world, sensor, log, acts.get(sensor.name, ())) for sensor in case.world.sensors]
        paths.append(folder / f"{experiment.name}.h5")
        write_log(paths[-1], case.world, experiment, signals)
    return paths


def truth_of(case: Case, half: str, seed: int, index: int) -> dict[str, Any]:
    """What is true of a case, for JSON."""
    world = case.world
    logs = [f"{e.name}.h5" for e in world.experiments]
    effects = [
        {
            "effect": item.name,
            "design_name": item.effect.design_name,
            "sensors": list(item.place.sensors),
            "axes": ["xyz"[a] for a in item.place.axes],
            "when": when_of(item.place.when, logs),
            "size": item.size,
            "unit": item.effect.unit,
            "limit": item.limit,
            "limit_kind": item.effect.limit,
            "severity": item.severity,
            "shown_by": "any"
            if item.effect.shows is ALL
            else {quantity: [sorted(s) for s in sets] for quantity, sets in item.effect.shows.items()},
        }
        for item in case.occurrences
    ]
    parts = {
        name: {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in asdict(part).items()}
        for name, part in world.parts.items()
    }
    return {
        "case": index,
        "kind": case.kind,
        "half": half,
        "seed": seed,
        "effects": effects,
        "logs": logs,
        "experiments": sorted(world.kinds),
        "sensors": {s.name: s.chip for s in world.sensors},
        "seconds": round(world.duration_s, 1),
        "strata": world.strata
        | {
            "largest_position_mm": max(max(map(abs, s.position_mm)) for s in world.sensors),
            "power_cycles": len({e.power_cycle for e in world.experiments}),
        },
        "recorder": asdict(world.recorder),
        "site": asdict(world.site),
        "parts": parts,
    }


def when_of(when: When, logs: list[str]) -> dict[str, Any]:
    """For JSON; an end that never comes is null."""
    stretches = [[logs[i], a, b if np.isfinite(b) else None] for i, a, b in when.stretches]
    return {"kind": when.kind, "logs": [logs[i] for i in when.logs], "stretches": stretches}


def main(arguments: list[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.foreign_world.cases", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--half", choices=HALVES, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--kind", choices=KINDS, default="control")
    parser.add_argument("--severity", type=float, default=SEVERITY, help="size in detection limits")
    parser.add_argument("--effect", action="append", default=[], choices=sorted(EFFECTS), help="only this; repeatable")
    options = parser.parse_args(arguments)
    sealed = options.out / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    for index in range(options.count):
        case = draw_case(options.half, options.seed, options.kind, index, options.severity, tuple(options.effect))
        write_case(case, options.out / f"{index:03d}")
        truth = truth_of(case, options.half, options.seed, index)
        (sealed / f"{index:03d}.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
