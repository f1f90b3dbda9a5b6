"""Rest and motion of the box in a log: the longest rest where no phase notes one, and signs that the box moved.

A calibration at rest refuses stretches in which the box moved: a figure computed from motion is not a property of the
sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.knocks import Knock, find_knocks, knock_sentence
from imuarray.calibrate.pose_readings import Pose, RestWindows, poses_in, rest_windows, windows_of
from imuarray.characterise.stretch import Stretch, choose_stretch
from imuarray.errors import CalibrationError
from imuarray.log import Log
from imuarray.log.format import SATURATED, STALE, SUSPECT, Phase
from imuarray.units import INERTIAL, READABLE

_CHOSEN = "the longest rest that the sensors show; no phase is marked as one"


def longest_rest(log: Log, phase: str | None = None) -> Stretch | None:
    """The longest rest that the sensors show, without the knocks in it; None if none shows, or if a `phase` is asked
    for or marked as a rest.
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
    """Return poses as stretches; two poses are one if the box was disturbed between them and lay as before."""
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
"""Keyed by quantity, in its unit: seconds in which readings scatter by more, or whose mean is so far from that of the
second before, are motion. A sensor's own noise is smaller, and a bias drifts by less in a second.
"""

TILTED_G = 0.3
"""A mean specific force that is so far from the median one is that of another pose, however slowly it was taken: what
heating by 40 degC does to a bias is a third of it (ADX-62, BMA-115).
"""

MOVING_SHARE = 0.1
"""Share of the seconds that may be motion: a box that is knocked or set down rests all the same."""

TURNED_DEG = 10.0
"""Poses that differ by more are two: a bias of 0.1 g turns the direction felt by six degrees."""

_WINDOW_NS = 1_000_000_000


def motion_in(log: Log, start_ns: int, end_ns: int, left_out: Sequence[Phase] = ()) -> str:
    """Describe the signs that the box moved between two times; "" if it rested, or without any sign."""
    for quantity in INERTIAL:
        sensors = [sensor for sensor in log.of(quantity) if len(sensor) and sensor.sensitivity > 0]
        count = (end_ns - start_ns) // _WINDOW_NS
        if not sensors or count < 1:
            continue
        mean, scatter = windows_of(sensors, start_ns, int(count), _WINDOW_NS, STALE | SATURATED | SUSPECT)
        middle_ns = start_ns + _WINDOW_NS * np.arange(count) + _WINDOW_NS // 2
        used = np.isfinite(scatter)
        for phase in left_out:
            used &= (middle_ns < phase.start_ns) | (middle_ns >= phase.end_ns)
        if not used.any():
            continue
        means, change = mean[used], np.maximum(scatter[used], 0.0)
        change[1:] = np.maximum(change[1:], np.abs(np.diff(means, axis=0)).max(axis=1))
        off = np.abs(means - np.median(means, axis=0)).max(axis=1)
        moving = change > STILL[quantity]
        if quantity == "specific_force":
            moving |= off > TILTED_G
        if moving.mean() > MOVING_SHARE:
            factor, unit = READABLE[sensors[0].unit]
            most = float(np.maximum(off, change)[moving].max())
            size = f"{factor * most:.3g} {unit}" if most < 1 else f"{most:.3g} {sensors[0].unit}"
            share = f"{100 * moving.mean():.0f} % of it"
            return f"the box moved in {share} or was in other poses (by up to {size}), but must rest"
    return ""


def refuse_motion(log: Log, stretches: Sequence[tuple[str, int, int]], left_out: Sequence[Phase] = ()) -> None:
    """CalibrationError for the first of the stretches (name, start and end in ns) in which the box moved."""
    for name, start_ns, end_ns in stretches:
        if words := motion_in(log, start_ns, end_ns, left_out):
            raise CalibrationError(f"{log.path}{name and f', {name}'}: {words}")


def refuse_other_poses(names: Sequence[str], forces_g: Floats) -> None:
    """CalibrationError if two or more of the mean specific forces (r, 3), in one frame, point elsewhere than most; the
    one that does may be of a sensor that came up wrong.
    """
    known = np.isfinite(forces_g).all(axis=1)
    lengths = np.linalg.norm(forces_g, axis=1, keepdims=True)
    directions = forces_g / np.where(lengths > 0, lengths, 1.0)
    median = np.median(directions[known], axis=0) if known.any() else np.zeros(3)
    size = float(np.linalg.norm(median))
    cosines = directions @ (median / size) if size > 0.1 else np.full(len(names), -1.0)
    degrees = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    elsewhere = np.flatnonzero(known & (degrees > TURNED_DEG))
    if len(elsewhere) > 1:
        listed = ", ".join(names[place] for place in elsewhere[:5])
        raise CalibrationError(
            f"{listed}: the box lay {np.median(degrees[elsewhere]):.0f} degrees away from its pose in the"
            f" other runs; one"
            " pose is required"
        )
