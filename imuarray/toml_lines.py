"""Lines of the keys of a TOML text, for messages that name the place of a mistake (TOML 1.0.0, toml.io)."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from collections import defaultdict

Place = tuple[int | str, ...]
"""Keys, and indices into arrays from 0, from the top of the document: ("sensor", 1, "range")."""


def key_lines(text: str) -> dict[Place, int]:
    """Return the line, counted from 1, of every key, table and array entry of a valid TOML text.

    The result is empty for a text that is nested too deep.

    >>> key_lines('[[sensor]]\\nname = "A"\\nrange = [1,\\n2]')[("sensor", 0, "range", 1)]
    4
    """
    try:
        return _Reader(text).document()
    except RecursionError:
        return {}


_SPACE = re.compile(r"[ \t]*")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}(?!")' r"|'''.*?'{3,5}(?!')" r'|"(?:[^"\\]|\\.)*"' r"|'[^']*'",
    re.DOTALL,
)
_SCALAR = re.compile(r"[^,\]}#\n]*")
_LONGEST_KEY = 100
"""Number of parts of a dotted key; a longer key is an attack, whose places alone would fill the memory."""


class _Reader:
    """Position in a text, and the lines of the keys before it."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._breaks = [match.start() for match in re.finditer("\n", text)]
        self._lines: dict[Place, int] = {}
        self._counts: defaultdict[Place, int] = defaultdict(int)

    def document(self) -> dict[Place, int]:
        """Read statements to the end of the text."""
        table: Place = ()
        self._skip(_BLANK)
        while self._at < len(self._text):
            if self._text[self._at] == "[":
                table = self._header()
            else:
                self._pair(table)
            self._skip(_BLANK)
        return self._lines

    def _header(self) -> Place:
        """Read [table] or [[table]]; return its place, in the last entry of each array of tables above it."""
        line, brackets = self._line(), 2 if self._text.startswith("[[", self._at) else 1
        self._at += brackets
        *above, last = self._key()
        place: Place = ()
        for part in above:
            place = self._last_entry((*place, part))
            self._lines.setdefault(place, line)
        place = (*place, last)
        self._lines.setdefault(place, line)
        if brackets == 2:
            self._counts[place] += 1
            place = self._last_entry(place)
            self._lines[place] = line
        self._at += brackets
        return place

    def _last_entry(self, place: Place) -> Place:
        return (*place, self._counts[place] - 1) if self._counts[place] else place

    def _pair(self, table: Place) -> None:
        """Read key = value."""
        line = self._line()
        place = table
        for part in self._key():
            place = (*place, part)
            self._lines.setdefault(place, line)
        self._at += 1
        self._skip(_SPACE)
        self._value(place)

    def _key(self) -> list[str]:
        """Read a dotted key, and the space around it."""
        parts = []
        while True:
            self._skip(_SPACE)
            quoted = self._text[self._at] in "\"'"
            spelled = self._skip(_STRING if quoted else _BARE_KEY)
            parts.append(tomllib.loads(f"key = {spelled}")["key"] if quoted else spelled)
            self._skip(_SPACE)
            if self._text[self._at] != ".":
                return parts
            if len(parts) > _LONGEST_KEY:
                raise RecursionError
            self._at += 1

    def _value(self, place: Place) -> None:
        character = self._text[self._at]
        if character == "[":
            self._array(place)
        elif character == "{":
            self._inline_table(place)
        else:
            self._skip(_STRING if character in "\"'" else _SCALAR)

    def _array(self, place: Place) -> None:
        index = 0
        self._at += 1
        while True:
            self._skip(_BLANK)
            if self._text[self._at] == "]":
                break
            self._lines[(*place, index)] = self._line()
            self._value((*place, index))
            self._skip(_BLANK)
            self._at += self._text[self._at] == ","
            index += 1
        self._at += 1

    def _inline_table(self, place: Place) -> None:
        self._at += 1
        self._skip(_SPACE)
        while self._text[self._at] != "}":
            self._pair(place)
            self._skip(_SPACE)
            self._at += self._text[self._at] == ","
            self._skip(_SPACE)
        self._at += 1

    def _skip(self, pattern: re.Pattern[str]) -> str:
        """Move past what matches here, and return it."""
        match = pattern.match(self._text, self._at)
        if match is None:
            return ""
        self._at = match.end()
        return match.group()

    def _line(self) -> int:
        return bisect_left(self._breaks, self._at) + 1
