"""Frames to triads, with what is believed of the slow errors: generalised least squares with a covariance that follows
the signal, and bounds where axes are clipped.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.optimal.censoring import Clipped, censored
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.readings import Bounds, Readings, patterns
from imuarray.fuse.optimal.view import View

Places = npt.NDArray[np.intp]


class Solution:
    """n frames: `unknowns` (n, k), NaN where the axes in use don't span space, `covariance` (n, k, k), `used`."""

    def __init__(self, frames: int, geometry: Geometry) -> None:
        unknowns = geometry.rows.shape[1]
        self.unknowns = np.full((frames, unknowns), np.nan)
        self.covariance = np.full((frames, unknowns, unknowns), np.nan)
        self.used = np.zeros((frames, geometry.axes), bool)


def solve(view: View, readings: Readings, into: Solution, frames: slice) -> None:
    """The triads of `readings`, which are `frames` of `into`."""
    unknowns, covariance, used = into.unknowns[frames], into.covariance[frames], into.used[frames]
    every = np.arange(len(readings.time))
    for valid, which in patterns(readings.valid):
        usual = view.usual(valid)
        if usual is None:
            continue
        solved = readings.values[which] @ usual.gain.T - usual.expected
        unknowns[which], used[which] = solved, valid[: view.geometry.axes]
        covariance[which] = view.usual_spreads(usual, solved[:, :3])
        odd = np.linalg.norm(solved[:, :3] - view.stimulus, axis=1) > view.reach
        if readings.bounds is not None:
            odd |= (readings.bounds.ends[which] != 0).any(axis=1)
        if odd.any():
            _solve_odd(view, readings, valid, every[which][odd], unknowns, covariance)


def _solve_odd(
    view: View, readings: Readings, valid: Flags, frames: Places, unknowns: Floats, covariance: Floats
) -> None:
    """Frames with a gain of their own, and with what their clipped axes say."""
    terms = view.terms(unknowns[frames, :3])
    gains = view.gains(valid, terms)
    unknowns[frames] = np.einsum("nkp,np->nk", gains, (readings.values[frames] - view.offset)[:, valid])
    covariance[frames] = view.spreads(valid, gains, terms)
    if readings.bounds is None:
        return
    for clipped, which in patterns(readings.bounds.ends[frames] != 0):
        if clipped.any():
            at = frames[which]
            beyond = _beyond(view, readings.bounds, valid, np.flatnonzero(clipped), at, terms[which], gains[which])
            unknowns[at], covariance[at] = censored(unknowns[at], covariance[at], beyond)


def _beyond(
    view: View, bounds: Bounds, valid: Flags, axes: Places, frames: Places, terms: Floats, gains: Floats
) -> Clipped:
    """What the clipped `axes` say in `frames`, whose gains and terms these are."""
    slow = view.slow(terms)
    return Clipped(
        rows=view.rows[axes],
        known=gains @ slow[:, valid][:, :, axes],
        own=slow[:, axes][:, :, axes] + np.diag(view.geometry.noise[axes] ** 2),
        bounds=bounds.at[frames][:, axes] - view.offset[axes],
        signs=bounds.ends[frames][:, axes].astype(float),
    )
