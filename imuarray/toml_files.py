"""Reading a TOML file as a model, and what is wrong with it in words: the place, what came, what is allowed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from imuarray.errors import ConfigError
from imuarray.spelling import closest, guess_file
from imuarray.toml_lines import Place, key_lines

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

File = TypeVar("File", bound="BaseModel")

_TOLD = 12
"""Maximum number of mistakes that are listed; a file with more is another kind of file."""

_IN_OTHER_WORDS = {
    "int_type": "{came}: a whole number without quotes is required (0x40 is one)",
    "float_type": "{came}: a number without quotes is required",
    "string_type": "{came}: a text in quotes is required",
    "list_type": "a list is required; an array of tables is written with two brackets, as in [[sensor]]",
    "bool_type": "{came}: true or false is required",
    "missing": "is missing",
    "model_type": "{came}: a table is required",
    "dict_type": "{came}: a table is required",
    "literal_error": "{came}: allowed are {expected}",
    "greater_than": "{came}: allowed is anything above {gt:g}",
    "greater_than_equal": "{came}: allowed is {ge:g} or more",
    "less_than": "{came}: allowed is anything below {lt:g}",
    "less_than_equal": "{came}: allowed is {le:g} or less",
    "finite_number": "{came}: a finite number is required",
    "too_short": "{actual_length} entries: {min_length} or more are required",
    "too_long": "{actual_length} entries: {max_length} or fewer are required",
    "string_too_short": "{came}: a text of {min_length} or more characters is required",
    "string_too_long": "{came}: a text of {max_length} or fewer characters is required",
    "string_pattern_mismatch": "{came}: allowed are a letter, then letters, digits and _, 32 characters at most",
}
"""The messages of pydantic that name its own types."""


def read_text(path: str | PathLike[str]) -> str:
    """The text of a file; ConfigError names the file if there is none."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        near = guess_file(path) if isinstance(error, FileNotFoundError) else ""
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or no_text(path)}{near}") from None


def no_text(path: str | PathLike[str]) -> str:
    """Describe a file that has no text in it; an HDF5 file may be a log in the place of a calibration."""
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
    about what the text lacks as a whole has no line.
    """
    lines = key_lines(text)
    listed = [
        f"{where}{f':{line}' if (line := _line(mistake, lines)) else ''}: "
        f"{f'{mistake.subject}: ' if mistake.subject else ''}{mistake.complaint}"
        for mistake in mistakes
    ]
    return ConfigError(_joined(listed))


def _joined(listed: Sequence[str]) -> str:
    """The first complaints on one line, and how many more there are."""
    more = [f"and {len(listed) - _TOLD} more"] if len(listed) > _TOLD else []
    return "; ".join([*listed[:_TOLD], *more])


def _line(mistake: Mistake, lines: Mapping[Place, int]) -> int:
    """The line of the key that a complaint is about, else of the smallest table around it; 0 if the text has none."""
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
        raise ConfigError(f"{where}{f':{line.group(1)}' if line else ''}: not TOML: {error}") from None
    try:
        return _checked(table, model, text, where)
    except RecursionError:
        raise ConfigError(f"{where}: tables nested without end") from None


_TOML_LINE = re.compile(r"\(at line (\d+), column \d+\)$")


def _checked(table: Mapping[str, Any], model: type[File], text: str, where: str) -> File:
    from pydantic import ValidationError  # its weight is for those who read such a file

    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise refusal(text, where, _mistakes(error, table, model)) from None


def complaints(error: ValidationError, table: Mapping[str, Any], model: type[BaseModel]) -> str:
    """The mistakes in `table`, read as `model`, on one line: "sensor 2 'BMA2': unit: ...; time: ..."."""
    listed = _mistakes(error, table, model)
    return _joined([f"{item.subject}: {item.complaint}" if item.subject else item.complaint for item in listed])


def _mistakes(error: ValidationError, table: Mapping[str, Any], model: type[BaseModel]) -> list[Mistake]:
    return [
        Mistake(tuple(item["loc"]), _subject(item["loc"], table), _complaint(item, model))
        for item in _all_mistakes(error, table, model)
    ]


def _all_mistakes(error: ValidationError, table: Mapping[str, Any], model: type[BaseModel]) -> list[Any]:
    """The mistakes of a table, also those that are looked for only where no key is unknown."""
    from pydantic import ValidationError  # its weight is for those who read such a file

    mistakes: list[Any] = list(error.errors())
    unknown = [mistake["loc"] for mistake in mistakes if mistake["type"] == "extra_forbidden"]
    if not unknown:
        return mistakes
    known = deepcopy(dict(table))
    for *path, key in unknown:
        place: Any = known
        for part in path:
            place = _inside(place, part)
        if isinstance(place, dict):
            place.pop(key, None)
    try:
        model.model_validate(known)
    except ValidationError as further:
        listed = {(mistake["loc"], mistake["msg"]) for mistake in mistakes}
        mistakes += [error for error in further.errors() if (error["loc"], error["msg"]) not in listed]
    return mistakes


def _subject(location: Sequence[int | str], table: Mapping[str, Any]) -> str:
    """The place of a mistake; entries of an array of tables are counted from 1 and called by their name."""
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
    """`value[part]`, or None if there is no such thing."""
    try:
        return value[part]
    except (KeyError, IndexError, TypeError):
        return None


def _complaint(mistake: Any, model: type[BaseModel]) -> str:
    """Return one clause: the mistake, and what is allowed."""
    if mistake["type"] == "extra_forbidden":
        *path, key = mistake["loc"]
        allowed = list(_model_at(path, model).model_fields)
        near = closest(str(key), allowed, cutoff=0.5)
        return f"unknown key{f' (did you mean {near!r}?)' if near else ''}; allowed are {', '.join(allowed)}"
    if mistake["type"] in _IN_OTHER_WORDS:
        return _IN_OTHER_WORDS[mistake["type"]].format(came=repr(mistake["input"])[:40], **mistake.get("ctx", {}))
    if mistake["type"] == "value_error":
        return str(mistake["ctx"]["error"])
    return str(mistake["msg"])


def _model_at(path: Sequence[int | str], model: type[BaseModel]) -> type[BaseModel]:
    """The model of the table at `path` inside `model`."""
    for part in path:
        if isinstance(part, str):
            model = _models_in(model.model_fields[part].annotation)[0]
    return model


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """The models that an annotation names: `list[Model]`, `Model | None`, ..."""
    from pydantic import BaseModel  # its weight is for those who read such a file

    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
