"""The generator of cases: a program that shares no code with the diagnosis. It is called, never imported."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from imuarray.errors import ConfigError
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.validation.bench import ARRAY, CHIPS, PLANS
from imuarray.validation.case import Put

PROGRAM = (sys.executable, "-m", "firmware_emulator.cases")


@cache
def mechanisms() -> dict[str, dict[str, Any]]:
    """Return the generator's description of each mechanism: the chips that it `touches`, its `place` ("sensor", "pair",
    "design" or "host"), the effects that it `resembles`, whether it is `graded`. Mechanisms that resemble only nuisance
    quantities are omitted, because no diagnosis reports these as causes.
    """
    described: dict[str, dict[str, Any]] = json.loads(_run_generator("--mechanisms"))
    named = {}
    for name, facts in described.items():
        resembles = [effect for effect in facts["resembles"] if effect in CANDIDATES]
        if resembles or not facts["resembles"]:
            named[name] = {**facts, "resembles": resembles}
    return named


def record(folder: Path, plan: str, puts: Sequence[Put], seed: int) -> tuple[list[Path], dict[str, Any]]:
    """Record a case of a fixed plan below `folder`. Returns its logs and its truth, which are in separate folders."""
    return _record(folder, [ARRAY, "--experiments", ",".join(PLANS[plan]), "--only", ",".join(CHIPS)], puts, seed)


def record_in(
    world: Mapping[str, Any], folder: Path, puts: Sequence[Put], seed: int
) -> tuple[list[Path], dict[str, Any]]:
    """Record a case in a world, which is a table in the form of `imuarray.validation.worlds.World.table`."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "world.json"
    table.write_text(json.dumps(world), encoding="utf-8")
    return _record(folder, [str(table)], puts, seed)


def _record(folder: Path, words: list[str], puts: Sequence[Put], seed: int) -> tuple[list[Path], dict[str, Any]]:
    truth = folder / "sealed" / "truth.json"
    words = [*words, "-o", str(folder / "logs"), "--truth", str(truth), "--seed", str(seed)]
    for put in puts:
        words += ["--mechanism", put.mechanism, "--severity", repr(put.severity), "--sensor", ",".join(put.sensors)]
    logs = [Path(line) for line in _run_generator(*words).splitlines()]
    return logs, json.loads(truth.read_text())


def _run_generator(*words: str) -> str:
    """Return the standard output of the generator; ConfigError with the last line of its errors if it fails."""
    done = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError(f"the generator of cases: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
    return done.stdout
