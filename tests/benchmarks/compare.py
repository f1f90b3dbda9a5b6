"""Figures beside their peers, both sides measured in one run: `python tests/benchmarks/compare.py [--full] [--json]`.

`--quick` (which goes without saying) takes less than three minutes; `--full` adds what takes longer: diagnoses, and
whole commands on logs of one and of ten hours.

Each row is {name, ours, peer, unit, ratio, target, better}: `ratio` is ours over the peer's, `target` is meant for the
ratio, `better` says which way it should go. Exits 1 if a target is missed. Nothing here is a test: times depend on the
machine.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

Row = dict[str, Any]

HERE = Path(__file__).parent

SOURCES = (
    "bus_arithmetic",
    "emulated_speed",
    "linux_path",
    "simulator_speed",
    "allan_speed",
    "spectrum_speed",
    "fusion_speed",
    "serial_rate",
    "firmware_rate",
    "queue_speed",
    "storage_cost",
    "hostile_files",
    "commands",
)
"""Files beside this one; each has a function `rows() -> list[Row]`."""

FULL = ("gap_cost",)
"""More of them, which take longer."""

BOTH = ("commands",)
"""Those of which `rows(full=True)` has more, or longer, rows."""


def row(name: str, ours: float, peer: float, unit: str, target: float, better: str) -> Row:
    """One row; the ratio is ours over the peer's."""
    return {
        "name": name,
        "ours": ours,
        "peer": peer,
        "unit": unit,
        "ratio": ours / peer,
        "target": target,
        "better": better,
    }


def rows_of(source: str) -> Callable[..., list[Row]]:
    """The `rows` function of a file beside this one."""
    spec = importlib.util.spec_from_file_location(f"benchmark_{source}", HERE / f"{source}.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(HERE / f"{source}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Callable[..., list[Row]] = module.rows
    return found


def met(found: Row) -> bool:
    """Is the target met?"""
    reached: bool = (
        found["ratio"] <= found["target"] if found["better"] == "lower" else found["ratio"] >= found["target"]
    )
    return reached


def main() -> int:
    """Measure everything; exit code."""
    parser = argparse.ArgumentParser(description="measure figures beside their peers")
    parser.add_argument("--json", action="store_true", help="print a list of rows as JSON")
    parser.add_argument("--only", metavar="NAME", choices=(*SOURCES, *FULL), help="one source alone")
    extent = parser.add_mutually_exclusive_group()
    extent.add_argument("--quick", action="store_true", help="what takes less than three minutes (default)")
    extent.add_argument("--full", action="store_true", help="everything")
    arguments = parser.parse_args()
    sys.path.insert(0, str(HERE))
    chosen = (arguments.only,) if arguments.only else (*SOURCES, *FULL) if arguments.full else SOURCES
    rows = [
        found for source in chosen for found in rows_of(source)(**({"full": arguments.full} if source in BOTH else {}))
    ]
    if arguments.json:
        print(json.dumps(rows, indent=1))
    else:
        for found in rows:
            sign = "<=" if found["better"] == "lower" else ">="
            verdict = "ok  " if met(found) else "MISS"
            figures = f"{found['ours']:10.4g} against {found['peer']:10.4g} {found['unit']:16}"
            ratio = f"ratio {found['ratio']:.4g} (target {sign} {found['target']:g})"
            print(f"{verdict} {found['name']:66} {figures} {ratio}")
    return 0 if all(met(found) for found in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
