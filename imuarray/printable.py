"""Text for people: counts, shares, durations and lists of names, and text from files and chips without control
characters.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBERED = re.compile(r"(\D*)(\d{1,9})(\D*)")
_RUN = 3
"""Fewest names with consecutive numbers of which only the first and the last are listed."""


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: `1 frame`, `2 frames`."""
    return f"{count} {noun}{'s' * (count != 1)}"


def percent(share: float, decimals: int = 0) -> str:
    """Return a share of 1 as `12 %`, with a space before the sign as in section 5.4.7 of the SI Brochure."""
    return f"{100 * share:.{decimals}f} %"


def duration(seconds: float, decimals: int = 0) -> str:
    """Return `75 s`, `12 min`, `3.5 h` or `12 d`; `decimals` are those of seconds and minutes."""
    if seconds < 120:
        return f"{seconds:.{decimals}f} s"
    if seconds < 7200:
        return f"{seconds / 60:.{decimals}f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 48 * 3600 else f"{seconds / 86400:.0f} d"


def printable(text: str) -> str:
    """Return `text` with control characters and direction marks escaped, so that it cannot control a terminal."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)


def encodable(text: str) -> str:
    """Return `text` with U+FFFD in the place of lone surrogates, which UTF-8 cannot encode: they represent bytes of a
    file name that are invalid in the encoding of this machine.
    """
    return _SURROGATE.sub("\N{REPLACEMENT CHARACTER}", text)


_SURROGATE = re.compile(r"[\ud800-\udfff]")


def listed(names: Sequence[str]) -> str:
    """Return names with commas; three or more that differ only by consecutive numbers as `Gyro1 to Gyro4`."""
    texts: list[str] = []
    run: list[str] = []
    for name in [*names, ""]:
        if run and not (name and _follows(run[-1], name)):
            texts += [f"{run[0]} to {run[-1]}"] if len(run) >= _RUN else run
            run = []
        run.append(name)
    return ", ".join(texts)


def series(names: Sequence[str]) -> str:
    """Return names as a series in a sentence: `A, B and C`."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _follows(before: str, name: str) -> bool:
    """Return whether a name is another one with the next number."""
    numbers = _NUMBERED.fullmatch(before), _NUMBERED.fullmatch(name)
    if numbers[0] is None or numbers[1] is None:
        return False
    (prefix, number, suffix), following = numbers[0].groups(), numbers[1].groups()
    return following == (prefix, str(int(number) + 1).zfill(len(number)), suffix)
