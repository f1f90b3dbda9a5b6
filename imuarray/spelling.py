"""Suggestions for misspelt words and file names, appended to the error that refuses them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import islice
from os import PathLike
from pathlib import Path

from imuarray.printable import printable

_MOST_FILES = 2000
"""Largest number of names of a folder that are compared, so that an error in a large folder is not slow."""


def guess(word: str, allowed: Iterable[str]) -> str:
    """Return `; did you mean NAME?` for the allowed name most similar to `word`, or "" if none is similar.

    Letter case is ignored.

    >>> guess("calibrat", ["calibrate", "fuse"])
    '; did you mean calibrate?'
    >>> guess("GYRO1", ["Gyro1", "BMA2"])
    '; did you mean Gyro1?'
    """
    return _suggestion(closest(word, allowed))


def guess_file(path: str | PathLike[str]) -> str:
    """Return `; did you mean FILE?` for the file in the same folder with the name most similar to that of `path`, else
    "".
    """
    missing = Path(path)
    try:
        names = [entry.name for entry in islice(missing.parent.iterdir(), _MOST_FILES)]
    except OSError:
        return ""
    name = closest(missing.name, (name for name in names if not name.startswith(".")), cutoff=0.75)
    return _suggestion(str(missing.with_name(name)) if name else "")


def as_names(names: str | Collection[str]) -> tuple[str, ...]:
    """Return names as a tuple; a single text is one name, not its letters.

    >>> as_names("Gyro1"), as_names(["Gyro1", "BMA2"])
    (('Gyro1',), ('Gyro1', 'BMA2'))
    """
    return (names,) if isinstance(names, str) else tuple(names)


def closest(word: str, allowed: Iterable[str], *, cutoff: float = 0.6) -> str:
    """Return the allowed name most similar to `word`; "" if no similarity (0 to 1, `difflib`) reaches `cutoff`. A word
    without a sign matches the name with a plus sign.
    """
    from difflib import get_close_matches

    names = {name.casefold(): name for name in allowed}
    if positive := names.get(f"+{word.casefold()}"):
        return positive
    near = get_close_matches(word.casefold(), list(names), n=1, cutoff=cutoff)
    return names[near[0]] if near else ""


def _suggestion(name: str) -> str:
    return f"; did you mean {printable(name)}?" if name else ""
