"""Words from somewhere else, a file or a chip, as they can be shown to a person."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBERED = re.compile(r"(\D*)(\d{1,9})(\D*)")
_RUN = 3
"""Names with consecutive numbers of which the first and the last are enough."""


def counted(count: int, noun: str) -> str:
    """`1 frame`, `2 frames`."""
    return f"{count} {noun}{'s' * (count != 1)}"


def percent(share: float, decimals: int = 0) -> str:
    """`share` (1 is the whole) as `12 %`, with a space before the sign as the SI Brochure (section 5.4.7) has it."""
    return f"{100 * share:.{decimals}f} %"


def printable(text: str) -> str:
    """`text` with characters that control a terminal escaped: control characters and direction marks."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)


def listed(names: Sequence[str]) -> str:
    """Names with commas; three or more that differ by consecutive numbers alone as `Gyro1 to Gyro4`."""
    texts: list[str] = []
    run: list[str] = []
    for name in [*names, ""]:
        if run and not (name and _follows(run[-1], name)):
            texts += [f"{run[0]} to {run[-1]}"] if len(run) >= _RUN else run
            run = []
        run.append(name)
    return ", ".join(texts)


def _follows(before: str, name: str) -> bool:
    """Return whether a name is another one with the next number."""
    numbers = _NUMBERED.fullmatch(before), _NUMBERED.fullmatch(name)
    if numbers[0] is None or numbers[1] is None:
        return False
    (prefix, number, suffix), following = numbers[0].groups(), numbers[1].groups()
    return following == (prefix, str(int(number) + 1).zfill(len(number)), suffix)
