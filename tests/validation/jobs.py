"""Cases and their job for tests of the executors; importable in every worker."""

from __future__ import annotations

import os
import random
import sys
import time
from dataclasses import asdict
from pathlib import Path

from imuarray.validation.case import Case, Outcome, write_json


def case_of(number: int, plan: str = "work") -> Case:
    return Case(number=number, half="development", kind="none", plan=plan, puts=(), seed=1000 + number)


def worked(case: Case, folder: Path) -> None:
    """Acts by the case's plan, then writes a result that depends on its seed alone."""
    trace = folder / f"{case.plan}-{case.number}"
    if case.plan == "raise":
        raise ValueError("no\nsuch thing")
    if case.plan == "leave":
        sys.exit(3)
    if case.plan == "nothing":
        return
    if case.plan == "die":
        _count(trace)
        os._exit(1)
    if case.plan == "die once" and not trace.exists():
        _count(trace)
        os._exit(1)
    if case.plan == "wait to be killed" and not trace.exists():
        write_json(trace, os.getpid())
        time.sleep(120)
    if case.plan == "slow":
        time.sleep(0.05)
    drawn = random.Random(case.seed)
    write_json(folder / "sealed" / f"{case.name}.json", {"case": case.table(), "truth": drawn.random()})
    diagnosis = {"p": [drawn.gauss(0, 1) for _ in range(1000)]}
    write_json(folder / "outcomes" / f"{case.name}.json", asdict(Outcome(case.name, diagnosis, {}, 0.25)))


def _count(trace: Path) -> None:
    with trace.open("ab") as file:
        file.write(b".")


def written(folder: Path) -> dict[str, bytes]:
    """Every public file of a run, with its content."""
    return {
        f"{path.parent.name}/{path.name}": path.read_bytes()
        for part in ("outcomes", "sealed")
        for path in (folder / part).iterdir()
    }
