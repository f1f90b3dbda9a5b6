"""Writes cases: the logs of each, and what is true of all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench_world.cases import Case
from tests.bench_world.chain import Unit, record
from tests.bench_world.log_file import Recording, write_log
from tests.bench_world.parts import Part, draw_part
from tests.bench_world.recorder import draw_frames, slots_s
from tests.bench_world.samples import Session

FIRST_EPOCH = datetime(2026, 3, 1, 20, tzinfo=UTC)
BETWEEN_LOGS = timedelta(minutes=30)
SELF_HEATING_K = 0.25
"""Of a chip after a cold start; a fifth of it if the array has been on."""
_PART, _LOG, _ROWS = 5, 9, 11
"""Last words of the keys of random streams: specimens, what belongs to a log, and the rows of a sensor in it."""


def write_cases(cases: Mapping[str, Case], folder: Path, seed_offset: int = 0) -> None:
    """Write these cases to `folder`/NAME/*.h5, and their truth to `folder`/truth.json."""
    truth = []
    for name, case in cases.items():
        write_case(name, case, folder / name, seed_offset)
        truth.append(truth_of(name, case))
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def write_case(name: str, case: Case, folder: Path, seed_offset: int = 0) -> list[Path]:
    """Write the logs of a case, and return their paths. The same seed gives the same data."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("*.h5"):
        path.unlink()
    seed = case.seed + seed_offset
    parts = draw_parts(case, seed)
    paths = []
    for number in range(len(case.experiments)):
        paths.append(folder / f"log{number + 1}.h5")
        stream = np.random.default_rng([seed, number, _LOG])
        write_log(paths[-1], record_log(name, case, parts, (seed, number), stream), stream)
    return paths


def draw_parts(case: Case, seed: int) -> dict[str, Part]:
    """Return the specimens of a case by the names of their sensors."""
    parts = {
        sensor.name: draw_part(sensor, np.random.default_rng([seed, index, _PART]), case.supply_v)
        for index, sensor in enumerate(case.sensors)
    }
    return case.trim(parts)


def record_log(
    name: str, case: Case, parts: Mapping[str, Part], key: tuple[int, int], stream: np.random.Generator
) -> Recording:
    """Return one log of a case; `key` is the seed and the log's number, `stream` draws its motion and its frames."""
    seed, number = key
    motion = case.experiments[number](stream)
    frames = draw_frames(case.recorder, motion.duration_s, stream)
    session = Session(number, motion, frames, SELF_HEATING_K * (1.0 if case.is_cold else 0.2))
    rows = {}
    for index, slot_s in enumerate(slots_s(len(case.sensors), case.recorder.rate_hz)):
        sensor = case.sensors[index]
        faults = tuple(fault for fault in case.faults if fault.sensor == sensor.name)
        unit = Unit(sensor, parts[sensor.name], faults)
        rows[sensor] = record(unit, session, slot_s, np.random.default_rng([seed, number, index, _ROWS]))
    epoch = FIRST_EPOCH + number * BETWEEN_LOGS + timedelta(minutes=seed)
    return Recording(
        epoch=epoch.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
        config=_config(name, case),
        rate_hz=float(case.recorder.rate_hz),
        rows=rows,
        motion=motion,
        misses_ns=tuple(int(time_s * 1e9) for time_s in frames.time_s[frames.follows_loss]),
    )


def truth_of(name: str, case: Case) -> dict[str, Any]:
    """Return what is true of a case, as an object of JSON."""
    return {
        "case": name,
        "kind": case.kind,
        "plan": case.plan,
        "rate_hz": case.recorder.rate_hz,
        "logs": len(case.experiments),
        "sensors": {sensor.name: {"chip": sensor.chip, "range": sensor.range} for sensor in case.sensors},
        "faults": [{"effect": fault.effect, **asdict(fault)} for fault in case.faults],
    }


def _config(name: str, case: Case) -> str:
    array = f'[array]\nname = "{name}"\nmux = {{ chip = "pca9544a", address = 0x70 }}\n\n'
    return array + "\n".join(sensor.toml for sensor in case.sensors)
