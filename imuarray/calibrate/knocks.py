"""Knocks: short disturbances of a box at rest, by windows of half a second.

A knock is between two rests and lasts `BRIDGED_S` at the most. If the box lies behind it as it lay before, the two
rests are one; if it was pushed a little, the knock says by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.pose_readings import BRIDGED_S, MIN_POSE_S, SAME_POSE, Indices, RestWindows

STRONG = 4.0
"""A disturbance in which readings scatter by this multiple of their scatter at rest is a knock; a weaker one may be the
noise of windows with few rows.
"""

_SURE = 5.0
"""Standard errors by which the box must lie otherwise behind a knock."""

_LEAST_SHARE = 0.05
"""Share of `SAME_POSE` by which it must lie otherwise at the least: noise wanders, and small noise is rounded away."""

LISTED = 5
"""Knocks whose times are listed."""

_NEIGHBOURS = 4
"""Windows on each side whose mean says how the box lies."""


class Knock(NamedTuple):
    """A disturbance from `start_ns` to `end_ns`; `strong` if it is no noise. `shift` is by how much the readings differ
    behind it, in the unit of the sensors, 0 if within their scatter.
    """

    start_ns: int
    end_ns: int
    strong: bool
    shift: float


def find_knocks(windows: RestWindows) -> list[Knock]:
    """Return the disturbances of the rests in these windows, in the order of time."""
    read = windows.read
    if not len(read):
        return []
    still = windows.still[read]
    edges = np.flatnonzero(still[1:] != still[:-1]) + 1
    least = MIN_POSE_S * 1e9 / windows.width_ns
    rests = [run for run in np.split(read, edges) if windows.still[run[0]] and len(run) >= least]
    if not rests:
        return []
    quiet = float(np.median(windows.spread[np.concatenate(rests)]))
    error = _error_of_means(windows.mean, rests)
    return [
        knock
        for before, after in pairwise(rests)
        if (knock := _knock(windows, before, after, quiet, error)) is not None
    ]


def _knock(windows: RestWindows, before: Indices, after: Indices, quiet: float, error: float) -> Knock | None:
    """Return what is between two rests (indices of windows), None if it is too long or the box was turned."""
    first, last = int(before[-1]) + 1, int(after[0])
    start_ns, end_ns = (windows.begin_ns + place * windows.width_ns for place in (first, last))
    shift = float(
        np.abs(windows.mean[before[-_NEIGHBOURS:]].mean(axis=0) - windows.mean[after[:_NEIGHBOURS]].mean(axis=0)).max()
    )
    same = SAME_POSE[windows.quantity]
    if end_ns - start_ns > BRIDGED_S * 1e9 or shift > same:
        return None
    inside = windows.spread[first:last]
    most = float(inside[np.isfinite(inside)].max(initial=0.0))
    moved = shift > max(_SURE * error, _LEAST_SHARE * same)
    return Knock(start_ns, end_ns, most > STRONG * quiet, shift if moved else 0.0)


def _error_of_means(mean: Floats, rests: Sequence[Indices]) -> float:
    """Return the standard error of the difference of two means over `_NEIGHBOURS` windows, of the worst axis, from how
    the means of neighbouring windows differ (1.48 times the median: standard deviation of normal numbers).
    """
    changes = np.concatenate([np.abs(np.diff(mean[run], axis=0)) for run in rests])
    return float(1.48 * np.median(changes, axis=0).max() / np.sqrt(_NEIGHBOURS))


def knock_sentence(knocks: Sequence[Knock], unit: str, factor: float) -> str:
    """Describe the strong knocks in a sentence about the box; `factor` turns shifts into `unit`. "" without any."""
    strong = [knock for knock in knocks if knock.strong]
    if not strong:
        return ""
    places = ", ".join(f"{(knock.start_ns + knock.end_ns) * 0.5e-9:.1f}" for knock in strong[:LISTED])
    more = ", ..." if len(strong) > LISTED else ""
    times = "once" if len(strong) == 1 else f"{len(strong)} times"
    moved = max(strong, key=lambda knock: knock.shift)
    shifted = f"; readings at rest changed by up to {moved.shift * factor:.2g} {unit}" if moved.shift else ""
    return f"the box was knocked {times} at rest, at {places}{more} s{shifted}"
