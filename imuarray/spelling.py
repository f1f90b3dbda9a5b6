"""A misspelt word, and what was meant."""

from __future__ import annotations

from collections.abc import Iterable


def guess(word: str, allowed: Iterable[str]) -> str:
    """The end of a complaint about `word`: which of those that are allowed it is like; "" if it is like none.

    >>> guess("calibrat", ["calibrate", "fuse"])
    '; did you mean calibrate?'
    """
    from difflib import get_close_matches

    near = get_close_matches(word, list(allowed), n=1)
    return f"; did you mean {near[0]}?" if near else ""
