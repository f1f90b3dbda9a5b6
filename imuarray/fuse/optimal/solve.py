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

_CERTAIN = 5.0
"""Standard deviations beyond its bound at which a clipped axis says nothing new: it moves the mean by 1.5e-6 of one."""

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
        telling = None
        if readings.bounds is not None:
            telling = _telling(view, readings.bounds, which, unknowns, covariance)
            odd |= telling.any(axis=1)
        if odd.any():
            bounds = None if telling is None or readings.bounds is None else (readings.bounds, telling[odd])
            _solve_odd(view, readings, valid, every[which][odd], unknowns, covariance, bounds)


def _solve_odd(
    view: View,
    readings: Readings,
    valid: Flags,
    frames: Places,
    unknowns: Floats,
    covariance: Floats,
    bounds: tuple[Bounds, Flags] | None,
) -> None:
    """Frames with a gain of their own, and with `bounds` of those axes that are marked (n, m)."""
    terms = view.terms(unknowns[frames, :3])
    gains = view.gains(valid, terms)
    unknowns[frames] = np.einsum("nkp,np->nk", gains, (readings.values[frames] - view.offset)[:, valid])
    covariance[frames] = view.spreads(valid, gains, terms)
    if bounds is None:
        return
    for clipped, which in patterns(bounds[1]):
        if clipped.any():
            at = frames[which]
            beyond = _beyond(view, bounds[0], valid, np.flatnonzero(clipped), at, terms[which], gains[which])
            unknowns[at], covariance[at] = censored(unknowns[at], covariance[at], beyond)


def _telling(view: View, bounds: Bounds, which: Places | slice, unknowns: Floats, covariance: Floats) -> Flags:
    """(n, m) the clipped axes of these frames whose bounds say anything: not those that are expected far beyond."""
    ends = bounds.ends[which]
    telling: Flags = np.asarray(ends != 0)
    frames = np.flatnonzero(telling.any(axis=1))
    if len(frames):
        solved, spread = unknowns[which][frames], covariance[which][frames]
        rows, noise = view.rows[: ends.shape[1]], view.geometry.noise[: ends.shape[1]]
        known = np.einsum("mk,nkl,ml->nm", rows, spread, rows, optimize=True)
        variance = 2 * (known + view.own(view.terms(solved[:, :3]))[:, : len(noise)] + noise**2)
        short = ends[frames] * (bounds.at[which][frames] - solved @ rows.T - view.offset[: len(noise)])
        telling[frames] &= short > -_CERTAIN * np.sqrt(variance)
    return telling


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
