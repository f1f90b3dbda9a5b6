"""A proposed map under construction."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from imuarray.importers.text_layout import TextLayout
from imuarray.printable import printable

_WIDTH = 110


class Item(list[str]):
    """The lines of a table of a map, such as `[[sensor]]`: its head, its name, and its other entries."""

    @property
    def name(self) -> str:
        """The name of the sensor."""
        return self.text("name")

    def call(self, name: str) -> None:
        """Replace the name of the sensor."""
        self.replace("name", f'name = "{name}"')

    def line(self, key: str) -> str:
        """Return the line of an entry; "" without it."""
        return next((line for line in self if line.startswith(f"{key} = ")), "")

    def text(self, key: str) -> str:
        """Return the text that an entry holds; "" without it."""
        return self.line(key).partition('"')[2].partition('"')[0]

    def is_guess(self, key: str) -> bool:
        """Return whether there is such an entry and its comment says that it is guessed."""
        return "# ?" in self.line(key)

    def replace(self, key: str, line: str) -> None:
        """Replace the line of an entry."""
        self[self.index(self.line(key))] = line

    def leave_out(self, *keys: str) -> None:
        """Remove entries."""
        self[:] = [line for line in self if line not in map(self.line, keys)]


@dataclass
class Proposal:
    """A map under construction: its lines, remarks and doubts, and the units of columns that are known."""

    layout: TextLayout
    time: list[str] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    units: Mapping[str, str] = field(default_factory=dict)
    gravity: dict[tuple[int, int, int], tuple[int, int, int]] = field(default_factory=dict)
    """Columns of accelerations without gravity, and those of the gravity that was subtracted."""

    attitudes: list[list[str]] = field(default_factory=list)
    """Columns of quaternions, w first, as a map names them."""
    asides: list[Item] = field(default_factory=list)
    """Items that stand in the map as comments."""

    def name_line(self, stem: str) -> str:
        """Return the line with the next free name that begins with a stem: Acc, Acc2, ..."""
        number = sum(item.name.startswith(stem) for item in self.items)
        return f'name = "{stem}{number + 1 if number else ""}"'

    def add(self, table: str, stem: str, *lines: str) -> None:
        """Add an item with the next free name that begins with a stem."""
        self.items.append(Item([f"[[{table}]]", self.name_line(stem), *lines]))

    def attitude_lines(self, is_comment: bool) -> list[str]:
        """Return the line of a sensor that adds gravity again by the attitude of its rows; none without an attitude."""
        mark = "# " if is_comment else ""
        return [
            f"{mark}attitude_columns = [{', '.join(names)}]   # w, x, y, z: adds 1 g along up again"
            for names in self.attitudes[:1]
        ]

    def text(self, head: Sequence[str]) -> str:
        """Return the map as TOML."""
        comments = [f"# {line}" for line in head]
        for mark, sentences in (("~", self.remarks), ("?", self.doubts)):
            for text in sentences:
                comments += textwrap.wrap(
                    printable(text), _WIDTH, initial_indent=f"# {mark} ", subsequent_indent="#   "
                )
        parts = [*comments, "", *self.layout.lines(), "[time]", *self.time]
        for item in self.items:
            parts += ["", *item]
        for item in self.asides:
            parts += ["", *(f"# {line}" for line in item)]
        return "\n".join(parts) + "\n"
