"""`python -m tests.bench_world DIR`: writes the cases of the bench world."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tests.bench_world.cases import CASES, KINDS
from tests.bench_world.writer import write_cases


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the cases that the command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench_world", description="Write the cases of the bench world."
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="writes DIR/CASE/*.h5 and DIR/truth.json")
    parser.add_argument("--seed-offset", type=int, default=0, metavar="N", help="is added to the seed of each case")
    parser.add_argument("--kind", choices=KINDS, help="only cases of this kind")
    options = parser.parse_args(arguments)
    chosen = {name: case for name, case in CASES.items() if options.kind in (None, case.kind)}
    write_cases(chosen, options.folder, options.seed_offset)


if __name__ == "__main__":
    main()
