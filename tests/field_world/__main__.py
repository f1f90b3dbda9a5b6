"""`python -m tests.field_world DIR`: writes the cases of the field world."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from tests.field_world.cases import CASES
from tests.field_world.writer import write_case


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the cases that the command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.field_world", description="Write the cases of the field world."
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="writes DIR/CASE/*.h5 and DIR/truth.json")
    parser.add_argument("--seed-offset", type=int, default=0, metavar="N", help="is part of the key of each draw")
    parser.add_argument("--only", nargs="+", choices=CASES, metavar="NAME", help="only these cases")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    path = options.folder / "truth.json"
    truth = json.loads(path.read_text()) if options.only and path.exists() else {}
    for name in options.only or CASES:
        truth[name] = write_case(CASES[name](), options.folder, options.seed_offset)
    path.write_text(json.dumps({name: truth[name] for name in CASES if name in truth}, indent=1))


if __name__ == "__main__":
    main()
