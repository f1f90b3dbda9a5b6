"""The techniques of fusion in words: for help texts, the report of `imuarray fuse` and the reference.

It imports nothing of the package, because `--help` needs it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class TechniqueDescription(NamedTuple):
    """A description of what a technique does (`about`). For one that changes the average only on some arrays, also the
    beginning of a sentence on the sensors or axes concerned (`effect`), and a sentence on arrays without any
    (`no_effect`).
    """

    about: str
    effect: str = ""
    no_effect: str = ""


TECHNIQUE_DESCRIPTIONS: Mapping[str, TechniqueDescription] = MappingProxyType(
    {
        "mean": TechniqueDescription("gives every axis the same weight"),
        "opposed": TechniqueDescription(
            "cancels the drift that anti-parallel axes of one design share",
            "cancels the common bias of",
            "changes nothing on this array: the axes of a design that point both ways are already balanced",
        ),
        "planes": TechniqueDescription(
            "weights in-plane and out-of-plane axes by their measured noise and stability",
            "weighs the axes of a design differently:",
            "changes nothing on this array: the errors of in-plane and out-of-plane axes of a design are too similar",
        ),
        "ranges": TechniqueDescription(
            "blends low and high measuring ranges; the low one fades out before it clips",
            "relies on wider ranges near the end of the range of",
            "changes nothing on this array: all its sensors of a quantity have one measuring range",
        ),
        "optimal": TechniqueDescription(
            "weights readings by a full error model, tracks slow errors, excludes failing sensors"
        ),
    }
)
"""By name, in the order of `imuarray.fuse.NAMES`."""

TECHNIQUE_NAMES = ", ".join([*TECHNIQUE_DESCRIPTIONS][:-1]) + f" or {[*TECHNIQUE_DESCRIPTIONS][-1]}"
"""All names, for the help of an option."""
NAME_WIDTH = 1 + max(map(len, TECHNIQUE_DESCRIPTIONS))
"""Width of a column of names in the tables of the terminal."""
