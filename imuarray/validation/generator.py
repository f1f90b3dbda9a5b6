"""The generator of cases, a program that shares no code with the diagnosis: it is called, never imported."""

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
    """What the generator can put to work, as it tells of them: chips that a mechanism `touches`, its `place` ("sensor",
    "pair", "design" or "host"), the effects that it `resembles`, whether it is `graded`. Without those that resemble
    nuisance quantities alone, which no diagnosis names as causes.
    """
    told: dict[str, dict[str, Any]] = json.loads(_called("--mechanisms"))
    found = {}
    for name, facts in told.items():
        resembles = [effect for effect in facts["resembles"] if effect in CANDIDATES]
        if resembles or not facts["resembles"]:
            found[name] = {**facts, "resembles": resembles}
    return found


def record(folder: Path, plan: str, puts: Sequence[Put], seed: int) -> tuple[list[Path], dict[str, Any]]:
    """The logs of a case of a fixed plan, in a folder of their own below `folder`, and the truth, which lies in
    another.
    """
    return _record(folder, [ARRAY, "--experiments", ",".join(PLANS[plan]), "--only", ",".join(CHIPS)], puts, seed)


def record_in(
    world: Mapping[str, Any], folder: Path, puts: Sequence[Put], seed: int
) -> tuple[list[Path], dict[str, Any]]:
    """The same in a world, a table as `imuarray.validation.worlds.World` makes it."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "world.json"
    table.write_text(json.dumps(world), encoding="utf-8")
    return _record(folder, [str(table)], puts, seed)


def _record(folder: Path, words: list[str], puts: Sequence[Put], seed: int) -> tuple[list[Path], dict[str, Any]]:
    truth = folder / "sealed" / "truth.json"
    words = [*words, "-o", str(folder / "logs"), "--truth", str(truth), "--seed", str(seed)]
    for put in puts:
        words += ["--mechanism", put.mechanism, "--severity", repr(put.severity), "--sensor", ",".join(put.sensors)]
    logs = [Path(line) for line in _called(*words).splitlines()]
    return logs, json.loads(truth.read_text())


def _called(*words: str) -> str:
    """What it prints; ConfigError with its last line if it fails."""
    done = subprocess.run([*PROGRAM, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError(f"the generator of cases: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
    return done.stdout
