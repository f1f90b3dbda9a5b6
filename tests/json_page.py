"""The keys that docs/reference/json.md documents."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "json.md"
SECTION = re.compile(r"## `imuarray ([a-z -]+)`\n\n(?:[^|#]*\n\n)?\| key \| meaning \|\n\|---\|---\|\n((?:\|.*\n)+)")


def documented() -> dict[str, tuple[set[str], dict[str, set[str]]]]:
    """The keys of each command, and those of the entries of its lists (`sensors[]`)."""
    sections = {}
    for command, rows in SECTION.findall(PAGE.read_text(encoding="utf-8")):
        keys: set[str] = set()
        entries: dict[str, set[str]] = {}
        for row in rows.splitlines():
            names, meaning = (cell.strip() for cell in row.strip("|").split("|"))
            named = re.findall(r"`([^`]+)`", names)
            keys |= {name.removesuffix("[]") for name in named}
            for name in named:
                if name.endswith("[]"):
                    entries[name.removesuffix("[]")] = set(re.findall(r"`([^`]+)`", meaning))
        sections[command] = keys, entries
    return sections
