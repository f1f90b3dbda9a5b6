"""Words from somewhere else, a file or a chip, as they can be shown to a person."""

from __future__ import annotations


def counted(count: int, noun: str) -> str:
    """`1 frame`, `2 frames`."""
    return f"{count} {noun}{'s' * (count != 1)}"


def printable(text: str) -> str:
    """`text` with what would steer a terminal spelled out: control characters, marks that turn the direction."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)
