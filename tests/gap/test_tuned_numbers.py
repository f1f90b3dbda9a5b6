"""Every tuned number of the diagnosis, in one table: a change must be made in both places.

The figures of VALIDATION.md were measured with these. A change of a number changes the table too, and has a reason:
`python tests/gap/test_tuned_numbers.py` writes it anew.
"""

from __future__ import annotations

import ast
import importlib
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomli_w

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "imuarray" / "gap"
SHARED = ("imuarray.log.row_timing",)
"""Modules elsewhere whose numbers the diagnosis uses."""
TABLE = Path(__file__).with_name("tuned_numbers.toml")


def test_no_tuned_number_changes_unnoticed() -> None:
    known = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    numbers = {module: dict(tuned) for module, tuned in tuned_numbers()}
    assert numbers.keys() == known.keys()
    for module, tuned in numbers.items():
        assert tuned == known[module], module


def test_the_table_has_known_tuned_numbers() -> None:
    """Some well-known numbers of the package, listed by hand."""
    known = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    assert known["inference.assessment"]["LEVEL"] == 0.05
    assert known["model.populations"]["TURN_ON_RMS"] == {"g": 1.2e-3, "dps": 0.15}
    assert known["statistics.synthetic_likelihood"]["FREEDOM"] == 5.0
    assert sum(map(len, known.values())) > 300


def tuned_numbers() -> Iterator[tuple[str, Mapping[str, Any]]]:
    """By module, the numbers at its top level with a name in capitals."""
    shared = (ROOT.joinpath(*module.split(".")).with_suffix(".py") for module in SHARED)
    for path in [*sorted(SOURCE.rglob("*.py")), *shared]:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        names = list(_capitals(ast.parse(path.read_text(encoding="utf-8"))))
        if names:
            values = vars(importlib.import_module(module.removesuffix(".__init__")))
            tuned = {name: plain for name in names if (plain := _plain(values[name])) is not None}
            if tuned:
                yield module.removeprefix("imuarray.gap."), tuned


def _capitals(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets:
            for part in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(part, ast.Name) and part.id.isupper():
                    yield part.id


def _plain(value: Any) -> Any:
    """A number, or numbers in a list or a table of texts; None for anything else."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return None if value != value else value  # nan is not a tuned number
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, tuple | list):
        parts = [_plain(part) for part in value]
        return parts if parts and all(part is not None for part in parts) else None
    if isinstance(value, range):
        return [value.start, value.stop, value.step]
    if isinstance(value, dict | MappingProxyType):
        items = {str(key): _plain(part) for key, part in value.items()}
        return items if items and all(part is not None for part in items.values()) else None
    return None


if __name__ == "__main__":
    TABLE.write_text(tomli_w.dumps({module: dict(tuned) for module, tuned in tuned_numbers()}), encoding="utf-8")
