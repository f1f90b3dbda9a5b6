"""TOML files are read into models; error messages state the place, the invalid value and the allowed values.

The line of a key is determined from the text (TOML 1.0.0, toml.io), because `tomllib` does not state it.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from imuarray.errors import ConfigError
from imuarray.spelling import closest, guess_file

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

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
"""Number of parts of a dotted key; a longer key is assumed to be an attack, because its places alone would fill the
memory.
"""


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
        """Move past the text that matches the pattern at this position, and return it."""
        match = pattern.match(self._text, self._at)
        if match is None:
            return ""
        self._at = match.end()
        return match.group()

    def _line(self) -> int:
        return bisect_left(self._breaks, self._at) + 1


File = TypeVar("File", bound="BaseModel")

_TOLD = 12
"""Maximum number of mistakes that are listed; a file with more is another kind of file."""

_IN_OTHER_WORDS = {
    "int_type": "{value}: a whole number without quotes is required (0x40 is one)",
    "float_type": "{value}: a number without quotes is required",
    "string_type": "{value}: a text in quotes is required",
    "list_type": "a list is required; an array of tables is written with two brackets, as in [[sensor]]",
    "bool_type": "{value}: true or false is required",
    "missing": "is missing",
    "model_type": "{value}: a table is required",
    "dict_type": "{value}: a table is required",
    "literal_error": "{value}: allowed are {expected}",
    "greater_than": "{value}: allowed is anything above {gt:g}",
    "greater_than_equal": "{value}: allowed is {ge:g} or more",
    "less_than": "{value}: allowed is anything below {lt:g}",
    "less_than_equal": "{value}: allowed is {le:g} or less",
    "finite_number": "{value}: a finite number is required",
    "too_short": "{actual_length} entries: {min_length} or more are required",
    "too_long": "{actual_length} entries: {max_length} or fewer are required",
    "string_too_short": "{value}: a text of {min_length} or more characters is required",
    "string_too_long": "{value}: a text of {max_length} or fewer characters is required",
    "string_pattern_mismatch": "{value}: allowed are a letter, then letters, digits and _, 32 characters at most",
}
"""The messages of pydantic that name its own types."""


def read_text(path: str | PathLike[str]) -> str:
    """Return the text of a file, without the byte order mark that editors on Windows write; ConfigError names the file
    if it can't be read as text.
    """
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        near = guess_file(path) if isinstance(error, FileNotFoundError) else ""
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or no_text(path)}{near}") from None


def no_text(path: str | PathLike[str]) -> str:
    """Describe a file that is not text; an HDF5 file may be a log that was given instead of a calibration."""
    try:
        with Path(path).open("rb") as file:
            begin = file.read(len(_HDF5))
    except OSError:
        begin = b""
    return (
        "is an HDF5 file, not a text file; are the arguments in the right order?"
        if begin == _HDF5
        else "is not a text file"
    )


_HDF5 = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file (HDF5 File Format Specification, superblock signature)."""


@dataclass(frozen=True)
class Mistake:
    """An error in a TOML text: its place, the subject in words ("sensor 1 'A'", or ""), and the complaint.

    A complaint about a key of the table at `place` begins with this key.
    """

    place: Place
    subject: str
    complaint: str


def refusal(text: str, where: str, mistakes: Iterable[Mistake]) -> ConfigError:
    """Return the error, one line, that lists mistakes, each with file and line.

    `where` is the file's name: "array.toml:7: sensor 1 'A': range 17: allowed are 2, 4; array.toml:9: ...". A mistake
    about a missing part of the whole text has no line.
    """
    lines = key_lines(text)
    listed = [
        f"{where}{f':{line}' if (line := _line(mistake, lines)) else ''}: "
        f"{f'{mistake.subject}: ' if mistake.subject else ''}{mistake.complaint}"
        for mistake in mistakes
    ]
    return ConfigError(_join(listed))


def _join(listed: Sequence[str]) -> str:
    """Return the first complaints on one line, and the number of further ones."""
    more = [f"and {len(listed) - _TOLD} more"] if len(listed) > _TOLD else []
    complaints: list[str] = []
    for text in listed[:_TOLD]:
        _, mark, choices = text.partition(_ALLOWED)
        is_known = mark and any(each.endswith(mark + choices) for each in complaints)
        complaints.append(text.removesuffix(mark + choices) if is_known else text)
    return "; ".join([*complaints, *more])


_ALLOWED = "; allowed are "
"""Text before a list of allowed values, which is stated only once."""


def _line(mistake: Mistake, lines: Mapping[Place, int]) -> int:
    """Return the line of the key of a complaint, or of the smallest table around it; 0 if the text has neither."""
    key = _FIRST_WORD.match(mistake.complaint)
    place = mistake.place
    while place:
        if key and (*place, key.group()) in lines:
            return lines[(*place, key.group())]
        if place in lines:
            return lines[place]
        place = place[:-1]
    return 0


_FIRST_WORD = re.compile(r"\w+")


def parse_toml(text: str, model: type[File], where: str) -> File:
    """Parse TOML text into a `model`; ConfigError (one line) with the line number of every mistake (`refusal`).

    Numbers that are too long and tables that are nested too deep are refused in the same way.
    """
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        line = _TOML_LINE.search(str(error))
        repeated = _REPEATED_TABLE.match(str(error))
        hint = f"; several tables of one name need two brackets: [[{repeated.group(1)}]]" if repeated else ""
        raise ConfigError(f"{where}{f':{line.group(1)}' if line else ''}: not TOML: {error}{hint}") from None
    try:
        if place := _place_of_nul(table, ()):
            raise refusal(text, where, [Mistake(place, "", f"{place[-1]}: a text without a NUL character is required")])
        return _check(table, model, text, where)
    except RecursionError:
        raise ConfigError(f"{where}: tables nested without end") from None


def _place_of_nul(value: Any, place: Place) -> Place:
    """Return the place of the first text or key with a NUL character, which HDF5 cannot store; () without one."""
    if isinstance(value, str):
        return place if "\0" in value else ()
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        if isinstance(key, str) and "\0" in key:
            return (*place, key)
        if inner := _place_of_nul(part, (*place, key)):
            return inner
    return ()


_REPEATED_TABLE = re.compile(r"Cannot declare \('([A-Za-z0-9_-]+)',\) twice")
_TOML_LINE = re.compile(r"\(at line (\d+), column \d+\)$")


def _check(table: Mapping[str, Any], model: type[File], text: str, where: str) -> File:
    from pydantic import ValidationError  # slow to import

    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise refusal(text, where, _mistakes(error, table, model)) from None


def complaints(error: ValidationError, table: Mapping[str, Any], model: type[BaseModel]) -> str:
    """Return the mistakes in `table`, read as `model`, on one line: "sensor 2 'BMA2': unit: ...; time: ..."."""
    listed = _mistakes(error, table, model)
    return _join([f"{item.subject}: {item.complaint}" if item.subject else item.complaint for item in listed])


def _mistakes(error: ValidationError, table: Mapping[str, Any], model: type[BaseModel]) -> list[Mistake]:
    return [
        Mistake(tuple(item["loc"]), _subject(item["loc"], table), _complaint(item, model))
        for item in _all_mistakes(error, table, model)
    ]


def _all_mistakes(error: ValidationError, table: Mapping[str, Any], model: type[BaseModel]) -> list[Any]:
    """Return the mistakes of a table, including those that pydantic checks only if no key is unknown."""
    from pydantic import ValidationError  # slow to import

    mistakes: list[Any] = list(error.errors())
    unknown = [mistake["loc"] for mistake in mistakes if mistake["type"] == "extra_forbidden"]
    if not unknown:
        return mistakes
    valid_part = deepcopy(dict(table))
    for *path, key in unknown:
        place: Any = valid_part
        for part in path:
            place = _inside(place, part)
        if isinstance(place, dict):
            place.pop(key, None)
    try:
        model.model_validate(valid_part)
    except ValidationError as further:
        listed = {(mistake["loc"], mistake["msg"]) for mistake in mistakes}
        mistakes += [error for error in further.errors() if (error["loc"], error["msg"]) not in listed]
    return mistakes


def _subject(location: Sequence[int | str], table: Mapping[str, Any]) -> str:
    """Return the place of a mistake; entries of an array of tables are numbered from 1 and stated with their name."""
    words: list[str] = []
    value: Any = table
    for part in location:
        value = _inside(value, part)
        if isinstance(part, int) and words:
            name = value.get("name") if isinstance(value, Mapping) else None
            words[-1] += f" {part + 1}" + (f" {name!r}" if isinstance(name, str) else "")
        else:
            words.append(str(part) if str(part).isprintable() else repr(part))
    return ": ".join(words)


def _inside(value: Any, part: int | str) -> Any:
    """Return `value[part]`, or None if it does not exist."""
    try:
        return value[part]
    except (KeyError, IndexError, TypeError):
        return None


def _complaint(mistake: Any, model: type[BaseModel]) -> str:
    """Return one clause: the mistake, and the allowed values."""
    if mistake["type"] == "extra_forbidden":
        *path, key = mistake["loc"]
        choices = list(_model_at(path, model).model_fields)
        near = closest(str(key), choices, cutoff=0.5)
        return f"unknown key{f' (did you mean {near!r}?)' if near else ''}; allowed are {', '.join(choices)}"
    if mistake["type"] in _IN_OTHER_WORDS:
        words = _IN_OTHER_WORDS[mistake["type"]].format(value=repr(mistake["input"])[:40], **mistake.get("ctx", {}))
        is_address = mistake["loc"][-1:] == ("address",) and isinstance(mistake["input"], int)
        return re.sub(r"\b\d+\b", lambda number: f"{int(number[0]):#04x}", words) if is_address else words
    if mistake["type"] == "value_error":
        return str(mistake["ctx"]["error"])
    return str(mistake["msg"])


def _model_at(path: Sequence[int | str], model: type[BaseModel]) -> type[BaseModel]:
    """Return the model of the table at `path` inside `model`."""
    for part in path:
        if isinstance(part, str):
            model = _models_in(model.model_fields[part].annotation)[0]
    return model


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation names: `list[Model]`, `Model | None`, ..."""
    from pydantic import BaseModel  # slow to import

    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
