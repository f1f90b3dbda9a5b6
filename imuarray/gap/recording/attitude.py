"""Attitude of a box that was put down by hand, estimated from the array's own accelerometers.

In every pose the specific force has a length of 1 g and is the same for all accelerometers. Poses in many directions
therefore separate the bias that the accelerometers have in common from the direction, if the scale is assumed to be
nominal. The estimate contains the array's own noise and errors. A comparison therefore has to estimate the direction in
simulated logs in the same way, although it is known there.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.log.format import Phase

GROSS_G = 0.25
"""Difference from the median of all accelerometers, in g on any axis in any pose, above which an accelerometer is left
out of the array's mean. Its range is wrong, its axes are exchanged, or the chip is dead.
"""

_OFF_FACE_G = 0.5
"""Difference from a noted face, in g, above which axes are exchanged. A box on a noted face is never tilted by 30
degrees.
"""

LEAN_SIGMA, SCALE_PRIOR, _FORM_G = 0.02, 0.02, 1e-3
"""Standard deviations of the tilt of a box on a noted face (radians), of the scale error of the array's mean reading,
and of the error of a length (g).
"""

_STEPS = 5
"""Number of Gauss-Newton steps. Each step doubles the number of correct digits; biases of 0.1 g need three."""

_LEAST_SHARE = 0.1
"""Singular values below this share of the largest one are ignored: the common bias is assumed to be 0 along directions
in which the poses determine it ten times worse than along the best one.
"""


_TOUCHED_NS = 1_000_000_000
"""Shortest time, in ns, in which a hand turns a box and puts it down."""

_ROUNDING_NS = 2
"""Tolerance of the ends of half phases, in ns: the two halves of a phase differ in length by up to a nanosecond."""


def attitude_numbers(phases: Sequence[Phase]) -> list[int]:
    """Return an attitude number for each phase of a log (or for the same half of each phase), in the order of time.

    A phase has the number of the phase before if the same axis is noted as up in both and the time between them is too
    short to turn the box.
    """
    numbers: list[int] = []
    for at, phase in enumerate(phases):
        is_same = at > 0 and bool(phase.up) and phases[at - 1].up == phase.up and _follows(phases[at - 1], phase)
        numbers.append(numbers[-1] + (not is_same) if numbers else 0)
    return numbers


def shared_readings(attitudes: Sequence[Hashable], readings: Floats) -> Floats:
    """Return the readings (k, s, 3) in k phases, with the readings in phases of one attitude replaced by their mean;
    nan if none of these phases has a reading.
    """
    shared = readings.copy()
    for attitude in set(attitudes):
        members = [at for at, other in enumerate(attitudes) if other == attitude]
        if len(members) > 1:
            has_value = np.isfinite(readings[members])
            with np.errstate(invalid="ignore"):
                shared[members] = np.where(has_value, readings[members], 0.0).sum(axis=0) / has_value.sum(axis=0)
    return shared


def _follows(before: Phase, phase: Phase) -> bool:
    """Return whether a phase (or its half) begins where the phase before ends. If only one half of each phase is used,
    the missing half between them is as long as the other half.
    """
    gap_ns = phase.start_ns - before.end_ns
    missing_ns = (0, before.end_ns - before.start_ns, phase.end_ns - phase.start_ns)
    return any(-_ROUNDING_NS <= gap_ns - between < _TOUCHED_NS for between in missing_ns)


class Ups(NamedTuple):
    """Unit vectors `up_box` (k, 3) of the directions up, (0, 0, 0) where nothing was measured, and `bias_g` (3,), which
    the array's accelerometers have in common; box frame.
    """

    up_box: Floats
    bias_g: Floats


def ups_of(mean_g: Floats, known_g: Floats, noted_g: Floats | None = None) -> Ups:
    """Estimate the directions up from the array's mean readings in k poses.

    `mean_g` (k, 3) in the box frame. `known_g` (k, 3) is the specific force where it is known exactly. `noted_g` (k, 3)
    is the noted face, on which the box may be tilted a little. Both are nan elsewhere.

    Least squares estimate one bias for all poses from two conditions: each corrected reading has a length of 1 g, and
    in known poses it equals the known force on all axes. Noted faces add a scale error for each axis and a tilt, both
    with a normal prior: opposite faces determine the bias whatever their tilt, and for a single face the smallest tilt
    that fits is estimated.
    """
    if noted_g is not None and np.isfinite(noted_g).all(axis=1).any():
        return _with_faces(mean_g, known_g, noted_g)
    bias = np.zeros(3)
    unknown = np.isnan(known_g).any(axis=1)
    for _ in range(_STEPS):
        ups, lengths = directions(mean_g - bias)
        difference = (mean_g - bias - known_g)[~unknown]
        design = np.concatenate([ups[unknown], np.tile(np.eye(3), (len(difference), 1))])
        target = np.concatenate([lengths[unknown] - 1, difference.ravel()])
        bias = bias + np.linalg.lstsq(design, target, rcond=_LEAST_SHARE)[0]
    return Ups(directions(mean_g - bias)[0], bias)


def _with_faces(mean_g: Floats, known_g: Floats, noted_g: Floats) -> Ups:
    known = np.isfinite(known_g).all(axis=1)
    noted = np.isfinite(noted_g).all(axis=1) & ~known
    bias, scale = np.zeros(3), np.zeros(3)
    for _ in range(_STEPS):
        ups, lengths = directions(mean_g - bias)
        free = ~known
        length_rows = np.hstack([ups[free], ups[free] ** 2]) / _FORM_G
        difference = [(lengths[free] - 1 - ups[free] ** 2 @ scale) / _FORM_G]
        rows = [length_rows]
        for at in np.flatnonzero(known):
            rows.append(np.hstack([np.eye(3), np.zeros((3, 3))]) / _FORM_G)
            difference.append((mean_g[at] - bias - known_g[at]) / _FORM_G)
        for at in np.flatnonzero(noted):
            across = np.eye(3) - np.outer(noted_g[at], noted_g[at])
            rows.append(np.hstack([across, np.zeros((3, 3))]) / LEAN_SIGMA)
            difference.append(across @ (mean_g[at] - bias) / LEAN_SIGMA)
        rows.append(np.hstack([np.zeros((3, 3)), np.eye(3)]) / SCALE_PRIOR)
        difference.append(-scale / SCALE_PRIOR)
        step = np.linalg.lstsq(np.vstack(rows), np.concatenate(difference), rcond=None)[0]
        bias, scale = bias + step[:3], scale + step[3:]
    return Ups(directions(mean_g - bias)[0], bias)


def array_mean(readings: Floats, noted_g: Floats | None = None, uncorrected: Floats | None = None) -> Floats:
    """Return the mean reading (k, 3) of s accelerometers from `readings` (k, s, 3), in g in the box frame; nan where no
    accelerometer has a reading.

    This is the median of the accelerometers that have a reading in every pose and are always within `GROSS_G` of the
    median of all (for two accelerometers, their mean). If none is, it is the median of all that have a reading in every
    pose; if none has, the mean of the readings that exist. With a median, an accelerometer whose bias changed does not
    tilt the box for the others.

    If two accelerometers disagree, the noted faces `noted_g` (k, 3), nan where none is noted, determine which of them
    counts; if no accelerometer agrees with them, those count whose readings have a length of 1 g. Both decisions use
    the `uncorrected` readings (k, s, 3) if they are given: errors that were fitted to a sensor with exchanged axes
    bring it halfway to the others.
    """
    whole = np.isfinite(readings).all(axis=(0, 2))
    if not whole.any():
        with np.errstate(invalid="ignore"):
            known = np.isfinite(readings)
            return np.asarray(np.where(known, readings, 0.0).sum(axis=1) / known.sum(axis=1))
    complete = readings[:, whole]
    as_read = complete if uncorrected is None else uncorrected[:, whole]
    counted = _within(complete, np.median(complete, axis=1), GROSS_G)
    if not _within(as_read, np.median(as_read, axis=1), GROSS_G).any():
        counted = np.zeros(len(counted), bool) if noted_g is None else _within(as_read, noted_g, _OFF_FACE_G)
        if not counted.any():
            counted = (np.abs(np.linalg.norm(as_read, axis=2) - 1) < GROSS_G).all(axis=0)
    return np.asarray(np.median(complete[:, counted] if counted.any() else complete, axis=1))


def _within(readings: Floats, reference_g: Floats, most_g: float) -> Booleans:
    """Return the mask (s,) of the accelerometers that are within `most_g` of the reference (k, 3) in all poses in which
    it is known; all False if it is known in no pose.
    """
    known = np.isfinite(reference_g).all(axis=1)
    near = np.abs(readings[known] - reference_g[known][:, None]) < most_g
    return np.asarray(near.all(axis=(0, 2)) & known.any())


def directions(vectors: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (k, 3) and lengths (k,) of `vectors` (k, 3); a zero vector stays zero."""
    lengths = np.linalg.norm(vectors, axis=1)
    units = np.divide(vectors, lengths[:, None], out=np.zeros_like(vectors), where=lengths[:, None] > 0)
    return units, lengths
