"""Techniques that combine the axes of an array into one triad: the simple average and the paper's three techniques.

All of them solve ``values = directions @ truth_box`` by weighted least squares, frame by frame. `opposed` corrects the
values first, `planes` chooses the weights, `ranges` does both; each is applied separately. None of them, including the
average, uses a reading that is flagged as clipped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from imuarray.fuse.frames import Axis
from imuarray.fuse.least_squares import Maker, Technique, mean
from imuarray.fuse.techniques import opposed as _opposed
from imuarray.fuse.techniques import planes as _planes
from imuarray.fuse.techniques import ranges as _ranges

TECHNIQUES: Mapping[str, Maker] = MappingProxyType(
    {"mean": mean, "opposed": _opposed.opposed, "planes": _planes.PlaneBlend, "ranges": _ranges.RangeBlend}
)

NEEDS_NOISE = frozenset({"planes", "ranges"})
"""Techniques that need the noise of every axis (`calibrate noise`)."""

CHANGES: Mapping[str, Callable[[Sequence[Axis]], list[str]]] = MappingProxyType(
    {"opposed": _opposed.changes, "planes": _planes.changes, "ranges": _ranges.changes}
)
"""By technique that changes the average only on some arrays: the differences for the axes of an array, in words."""


def changes(technique: str, axes: Sequence[Axis]) -> list[str]:
    """Describe the differences of a technique from the simple average; empty if there are none for this array."""
    return CHANGES[technique](axes) if technique in CHANGES else []


__all__ = ["CHANGES", "NEEDS_NOISE", "TECHNIQUES", "Maker", "Technique", "changes"]
