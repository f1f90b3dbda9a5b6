"""Rest and motion of the box in a log: the longest rest if no phase states one, and signs that the box moved.

A calibration at rest refuses stretches in which the box moved, because a figure computed from motion is not a property
of the sensor.

A knock is a short disturbance of a box at rest, detected in windows of half a second: it lies between two rests and
lasts at most `BRIDGED_S`. If the attitude is the same before and after it, the two rests are joined; if the box was
moved a little, the knock states the change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.pose_readings import (
    BRIDGED_S,
    MIN_POSE_S,
    SAME_POSE,
    Indices,
    Pose,
    RestWindows,
    poses_in,
    rest_windows,
    windows_of,
)
from imuarray.characterise.stretch import Stretch, choose_stretch
from imuarray.errors import CalibrationError
from imuarray.log import Log
from imuarray.log.format import SATURATED, STALE, SUSPECT, Phase
from imuarray.units import INERTIAL, READABLE

STRONG = 4.0
"""Least scatter during a knock as a multiple of the scatter at rest; a weaker disturbance may be the noise of windows
with few rows.
"""

_SURE = 5.0
"""Least change of the attitude by a knock, in standard errors."""

_LEAST_SHARE = 0.05
"""Least change of the attitude by a knock, as a share of `SAME_POSE`, however small its standard error is: the noise
may wander, and noise of less than a count is lost by rounding.
"""

LISTED = 5
"""Largest number of knocks that are listed with their times."""

_NEIGHBOURS = 4
"""Number of windows before and after a knock over which the attitude of the box is averaged."""


class Knock(NamedTuple):
    """A disturbance from `start_ns` to `end_ns`; `strong` if it is not noise. `shift` is the change of the readings at
    rest from before to after it, in the unit of the sensors; 0 if that is within their scatter.
    """

    start_ns: int
    end_ns: int
    strong: bool
    shift: float


def find_knocks(windows: RestWindows) -> list[Knock]:
    """Return the disturbances between rests in these windows, in order of time."""
    read_windows = windows.read
    if not len(read_windows):
        return []
    still = windows.still[read_windows]
    edges = np.flatnonzero(still[1:] != still[:-1]) + 1
    min_windows = MIN_POSE_S * 1e9 / windows.width_ns
    rests = [run for run in np.split(read_windows, edges) if windows.still[run[0]] and len(run) >= min_windows]
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
    """Return the disturbance between two rests (indices of windows); None if it is too long or the box was turned."""
    first, last = int(before[-1]) + 1, int(after[0])
    start_ns, end_ns = (windows.begin_ns + place * windows.width_ns for place in (first, last))
    shift = float(
        np.abs(windows.mean[before[-_NEIGHBOURS:]].mean(axis=0) - windows.mean[after[:_NEIGHBOURS]].mean(axis=0)).max()
    )
    same = SAME_POSE[windows.quantity]
    if end_ns - start_ns > BRIDGED_S * 1e9 or shift > same:
        return None
    inside = windows.spread[first:last]
    peak = float(inside[np.isfinite(inside)].max(initial=0.0))
    moved = shift > max(_SURE * error, _LEAST_SHARE * same)
    return Knock(start_ns, end_ns, peak > STRONG * quiet, shift if moved else 0.0)


def _error_of_means(mean: Floats, rests: Sequence[Indices]) -> float:
    """Return the standard error of the difference of two means over `_NEIGHBOURS` windows, for the worst axis, from the
    differences of neighbouring windows (1.48 times the median: the standard deviation of normal numbers).
    """
    changes = np.concatenate([np.abs(np.diff(mean[run], axis=0)) for run in rests])
    return float(1.48 * np.median(changes, axis=0).max() / np.sqrt(_NEIGHBOURS))


def knock_sentence(knocks: Sequence[Knock], unit: str, factor: float) -> str:
    """Describe the strong knocks in a sentence; `factor` converts shifts to `unit`. "" without any."""
    strong = [knock for knock in knocks if knock.strong]
    if not strong:
        return ""
    places = ", ".join(f"{(knock.start_ns + knock.end_ns) * 0.5e-9:.1f}" for knock in strong[:LISTED])
    more = ", ..." if len(strong) > LISTED else ""
    times = "once" if len(strong) == 1 else f"{len(strong)} times"
    moved = max(strong, key=lambda knock: knock.shift)
    shifted = f"; readings at rest changed by up to {moved.shift * factor:.2g} {unit}" if moved.shift else ""
    return f"the box was knocked {times} at rest, at {places}{more} s{shifted}"


_CHOSEN = "the longest rest that the sensors show; no phase is marked as one"


def longest_rest(log: Log, phase: str | None = None) -> Stretch | None:
    """Return the longest rest detected by the sensors, without the knocks in it; None if there is none, if a `phase` is
    given, or if the log marks a phase as a rest.
    """
    if phase is not None or choose_stretch(log, None).phase is not None:
        return None
    try:
        windows = rest_windows(log)
    except CalibrationError:
        return None
    knocks = find_knocks(windows)
    longest = max(_join(poses_in(log, windows), knocks), key=lambda rest: rest.end_ns - rest.start_ns, default=None)
    return None if longest is None else replace(longest, remark=_sentence(log, windows, knocks))


def _join(poses: Sequence[Pose], knocks: Sequence[Knock]) -> list[Stretch]:
    """Return poses as stretches; two poses are joined if a knock between them did not change the attitude."""
    rests: list[Stretch] = []
    for pose in (pose.phase for pose in poses):
        before = rests[-1] if rests else None
        if before is not None and any(
            before.end_ns <= knock.start_ns and knock.end_ns <= pose.start_ns and not knock.shift for knock in knocks
        ):
            left_out = (*before.left_out, (before.end_ns, pose.start_ns))
            rests[-1] = replace(before, end_ns=pose.end_ns, left_out=left_out)
        else:
            rests.append(Stretch(pose.start_ns, pose.end_ns, pose.name, "", _CHOSEN))
    return rests


def _sentence(log: Log, windows: RestWindows, knocks: Sequence[Knock]) -> str:
    unit = next(iter(log.of(windows.quantity))).unit
    factor, readable = READABLE.get(unit, (1.0, unit))
    return knock_sentence(knocks, readable, factor)


STILL: Mapping[str, float] = MappingProxyType({"specific_force": 0.1, "angular_rate": 5.0})
"""Keyed by quantity, in its unit: largest scatter within a second at rest, and largest change of the mean from the
second before. The noise of a sensor is smaller, and a bias drifts by less in a second.
"""

TILTED_G = 0.3
"""Difference, in g, of a mean specific force from the median above which it belongs to another pose, even if the box
was tilted slowly. Heating by 40 degC changes a bias by a third of it (ADX-62, BMA-115).
"""

MOVING_SHARE = 0.1
"""Share of the seconds that may be motion: a rest may contain a knock or begin with the box being set down."""

TURNED_DEG = 10.0
"""Largest angle between two measurements of one pose: a bias of 0.1 g turns the measured direction by six degrees."""

_WINDOW_NS = 1_000_000_000

_YEAR_S = 31_557_600
_MOST_WINDOWS = _YEAR_S
"""Most windows of a log, a year: each takes 32 bytes, and no drift is measured for longer."""


def motion_in(log: Log, start_ns: int, end_ns: int, left_out: Sequence[Phase] = ()) -> str:
    """Describe the signs that the box moved between two times; "" if there are none."""
    for quantity in INERTIAL:
        sensors = [sensor for sensor in log.of(quantity) if len(sensor) and sensor.sensitivity > 0]
        count = (end_ns - start_ns) // _WINDOW_NS
        if not sensors or count < 1:
            continue
        if count > _MOST_WINDOWS:
            raise CalibrationError(
                f"{log.path}: its times span {count / _YEAR_S:.0f} years, and at most {_MOST_WINDOWS / _YEAR_S:.0f} are"
                " allowed: check them for a jump"
            )
        mean, scatter = windows_of(sensors, start_ns, int(count), _WINDOW_NS, STALE | SATURATED | SUSPECT)
        middle_ns = start_ns + _WINDOW_NS * np.arange(count) + _WINDOW_NS // 2
        used = np.isfinite(scatter)
        for phase in left_out:
            used &= (middle_ns < phase.start_ns) | (middle_ns >= phase.end_ns)
        if not used.any():
            continue
        means, change = mean[used], np.maximum(scatter[used], 0.0)
        change[1:] = np.maximum(change[1:], np.abs(np.diff(means, axis=0)).max(axis=1))
        deviation = np.abs(means - np.median(means, axis=0)).max(axis=1)
        moving = change > STILL[quantity]
        if quantity == "specific_force":
            moving |= deviation > TILTED_G
        if moving.mean() > MOVING_SHARE:
            factor, unit = READABLE[sensors[0].unit]
            peak = float(np.maximum(deviation, change)[moving].max())
            size = f"{factor * peak:.3g} {unit}" if peak < 1 else f"{peak:.3g} {sensors[0].unit}"
            share = f"{100 * moving.mean():.0f} %"
            return f"the box must be at rest, but moved or was in other poses for {share} of the time (by up to {size})"
    return ""


def refuse_motion(log: Log, stretches: Sequence[tuple[str, int, int]], left_out: Sequence[Phase] = ()) -> None:
    """Raise CalibrationError for the first of the stretches (name, start and end in ns) in which the box moved."""
    for name, start_ns, end_ns in stretches:
        if words := motion_in(log, start_ns, end_ns, left_out):
            raise CalibrationError(f"{log.path}{name and f', {name}'}: {words}")


def refuse_other_poses(names: Sequence[str], forces_g: Floats) -> None:
    """Raise CalibrationError if the directions of two or more mean specific forces (r, 3), in one frame, differ from
    the median; a single one may be a sensor that started in a wrong state.
    """
    finite = np.isfinite(forces_g).all(axis=1)
    lengths = np.linalg.norm(forces_g, axis=1, keepdims=True)
    directions = forces_g / np.where(lengths > 0, lengths, 1.0)
    median = np.median(directions[finite], axis=0) if finite.any() else np.zeros(3)
    size = float(np.linalg.norm(median))
    cosines = directions @ (median / size) if size > 0.1 else np.full(len(names), -1.0)
    degrees = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    elsewhere = np.flatnonzero(finite & (degrees > TURNED_DEG))
    if len(elsewhere) > 1:
        listed = ", ".join(names[place] for place in elsewhere[:5])
        raise CalibrationError(
            f"{listed}: the box lay {np.median(degrees[elsewhere]):.0f} degrees away from its pose in the"
            " other runs; one pose is required"
        )
