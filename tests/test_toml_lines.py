"""Lines of keys in a TOML text: those on which an independent writer (tomli_w) prints each value."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from itertools import count
from typing import Any

import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.toml_files import Mistake, Place, key_lines, refusal
from tests.selection import examples

_TEXTS = st.text(alphabet="a#[]{}=,.'\"\\\n é", max_size=8)
_LEAVES = st.one_of(st.none(), _TEXTS)  # None is replaced by a number that is printed nowhere else
_TABLES = st.recursive(
    _LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_TEXTS, inner, max_size=3),
    max_leaves=12,
)


def numbered(value: Any, numbers: Iterator[int]) -> Any:
    """The value with a distinct number in place of each None."""
    if isinstance(value, dict):
        return {key: numbered(part, numbers) for key, part in value.items()}
    if isinstance(value, list):
        return [numbered(part, numbers) for part in value]
    return next(numbers) if value is None else value


def places(value: Any, above: Place = ()) -> Iterator[tuple[Place, Any]]:
    """Every key, table and entry below a value, with its value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        yield (*above, key), part
        yield from places(part, (*above, key))


@settings(max_examples=examples(200), deadline=None)
@given(st.dictionaries(_TEXTS, _TABLES, max_size=4), st.booleans(), st.booleans())
def test_lines_are_those_of_the_printed_values(table: dict[str, Any], multiline: bool, is_windows: bool) -> None:
    document = numbered(table, count(1_000_000))
    text = tomli_w.dumps(document, multiline_strings=multiline)
    if is_windows:
        text = text.replace("\n", "\r\n")
    parsed = tomllib.loads(text)
    lines = key_lines(text)
    assert set(lines) == {place for place, _ in places(parsed)}
    for place, value in places(parsed):
        if isinstance(value, int):
            printed = next(line for line, words in enumerate(text.split("\n"), 1) if re.search(rf"\b{value}\b", words))
            assert lines[place] == printed, place


@pytest.mark.parametrize(
    ("text", "place", "line"),
    [
        ("a.b.c = 1\na.b.d = 2", ("a", "b", "d"), 2),
        ("a.b.c = 1\na.b.d = 2", ("a",), 1),
        ("[[s]]\n[[s]]\n[s.t]\nu = 1", ("s", 1, "t", "u"), 4),
        ("[[s]]\n[[s]]\n[[s.t]]\n[[s.t]]\nu = 1", ("s", 1, "t", 1, "u"), 5),
        ("x = '''\n[a]\n''''' # [b]\n\"y z\" = {k = [1, {m = 2}]}", ("y z", "k", 1, "m"), 4),
        ('x = """\n\\"""\n"""\ny = 1979-05-27T07:32:00Z # t\nz = 1', ("z",), 5),
        ("[ a . \"b.c\" ]\n\n# d = 1\n'd' = 1", ("a", "b.c", "d"), 4),
    ],
)
def test_dotted_keys_nested_arrays_of_tables_and_strings_have_their_lines(text: str, place: Place, line: int) -> None:
    """Forms that the writer never prints."""
    tomllib.loads(text)
    assert key_lines(text)[place] == line


def test_a_text_nested_without_end_has_no_lines() -> None:
    assert key_lines(f"a{'.a' * 100_000} = 1") == {}
    assert key_lines("a = " + "[" * 100_000 + "]" * 100_000) == {}


def test_what_is_allowed_is_stated_once() -> None:
    mistakes = [Mistake(("a",), "", f"{key}: unknown key; allowed are p, q") for key in "xy"]
    assert str(refusal("a = 1\n", "m.toml", mistakes)) == (
        "m.toml:1: x: unknown key; allowed are p, q; m.toml:1: y: unknown key"
    )
