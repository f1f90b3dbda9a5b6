"""Frames to triads, with what is believed of the slow errors: generalised least squares with a covariance that follows
the signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.optimal.censoring import Clipped, censored
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.kalman import Normal
from imuarray.fuse.optimal.readings import Bounds, Readings, patterns
from imuarray.fuse.optimal.states import States

_TOLERATED = 0.1
"""Share by which the stimulus may change the variance of a row before a frame gets a gain of its own; what a gain that
is so little off costs is of second order.
"""


@dataclass(frozen=True)
class View:
    """The slow errors as the r rows of a geometry feel them during one segment: `offset` (r,) their expected sum,
    `response` (r, 3) the expected error of each row's direction, `errors` (terms, terms, r, r) the covariances of their
    terms, which (1, stimulus) goes with. `final`: the frames themselves are in them already (a smoother's).
    """

    geometry: Geometry
    offset: Floats
    response: Floats
    errors: Floats
    final: bool

    @property
    def terms(self) -> int:
        """1, or 4 where directions are in doubt."""
        return len(self.errors)

    @cached_property
    def rows(self) -> Floats:
        """(r, k) what the rows see of the unknowns, as far as it is known."""
        rows = self.geometry.rows.copy()
        rows[:, :3] += self.response
        return rows

    def slow(self, terms: Floats) -> Floats:
        """(n, r, r) covariances of the slow errors at (1, stimulus), (n, terms)."""
        pairs = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1)
        flat = self.errors.reshape(pairs.shape[1], -1)
        return np.asarray((pairs @ flat).reshape(-1, *self.errors.shape[2:]))

    def gains(self, valid: Flags, terms: Floats) -> Floats:
        """(n, k, p) best gains of the p rows in use at (1, stimulus), (n, terms)."""
        rows, noise = self.rows[valid], self.geometry.noise[valid] ** 2
        if self.final:
            weighed: Floats = np.broadcast_to(rows / noise[:, None], (len(terms), *rows.shape))
        else:
            weighed = np.asarray(np.linalg.solve(self.slow(terms)[:, valid][:, :, valid] + np.diag(noise), rows))
        return np.asarray(np.linalg.solve(rows.T @ weighed, np.swapaxes(weighed, -1, -2)))

    def spread(self, valid: Flags, gain: Floats, terms: Floats) -> Floats:
        """(n, k, k) covariances of what one `gain` (k, p) makes of the rows in use at (1, stimulus), (n, terms)."""
        fixed = (gain * self.geometry.noise[valid] ** 2) @ gain.T
        errors = gain @ self.errors[:, :, valid][:, :, :, valid] @ gain.T
        pairs = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1)
        return np.asarray(fixed + (pairs @ errors.reshape(pairs.shape[1], -1)).reshape(-1, *fixed.shape))

    def spreads(self, valid: Flags, gains: Floats, terms: Floats) -> Floats:
        """(n, k, k) covariances of what `gains` (n, k, p) make of the rows in use at (1, stimulus), (n, terms)."""
        errors = self.slow(terms)[:, valid][:, :, valid] + np.diag(self.geometry.noise[valid] ** 2)
        return np.asarray(gains @ errors @ np.swapaxes(gains, -1, -2))


def view_of(states: States, geometry: Geometry, belief: Normal, warmer_degc: Floats, *, final: bool = False) -> View:
    """The states as the rows of `geometry` feel them while they are warmer than their biases by (r,)."""
    rows = states.rows(warmer_degc)
    terms, count, _ = rows.shape
    flat = rows.reshape(terms * count, -1)
    felt = (rows @ belief.mean).reshape(terms, count)
    errors = (flat @ belief.covariance @ flat.T).reshape(terms, count, terms, count).transpose(0, 2, 1, 3)
    response = felt[1:].T if terms > 1 else np.zeros((count, 3))
    return View(geometry, felt[0], response, np.ascontiguousarray(errors), final)


class Solution:
    """n frames: `unknowns` (n, k), NaN where the axes in use don't span space, `covariance` (n, k, k), `used`."""

    def __init__(self, frames: int, geometry: Geometry) -> None:
        unknowns = geometry.rows.shape[1]
        self.unknowns = np.full((frames, unknowns), np.nan)
        self.covariance = np.full((frames, unknowns, unknowns), np.nan)
        self.used = np.zeros((frames, geometry.axes), bool)


def solve(view: View, readings: Readings, stimulus: Floats, into: Solution, frames: slice) -> None:
    """The triads of `readings`, which are `frames` of `into`; `stimulus` (3,) is about what they will be."""
    values = readings.values - view.offset
    unknowns, covariance, used = into.unknowns[frames], into.covariance[frames], into.used[frames]
    for valid, which in patterns(readings.valid):
        if not view.geometry.spans(valid):
            continue
        every = np.arange(len(values))[which]
        (gain,) = view.gains(valid, _terms(stimulus[None], view.terms))
        solved = values[which][:, valid] @ gain.T
        follows = solved[:, :3] if view.terms > 1 else stimulus[None]
        covariance[which] = view.spread(valid, gain, _terms(follows, view.terms))
        odd = _odd(view, solved, stimulus)
        if len(odd):
            terms = _terms(solved[odd, :3], view.terms)
            gains = view.gains(valid, terms)
            solved[odd] = np.einsum("nkp,np->nk", gains, values[every[odd]][:, valid])
            covariance[every[odd]] = view.spreads(valid, gains, terms)
        unknowns[which] = solved
        used[which] = valid[: view.geometry.axes]
        if readings.bounds is not None:
            for clipped, among in patterns(readings.bounds.ends[which] != 0):
                if clipped.any():
                    frames_of = every[among]
                    beyond = _beyond(view, readings.bounds, valid, clipped, frames_of, unknowns)
                    unknowns[frames_of], covariance[frames_of] = censored(
                        unknowns[frames_of], covariance[frames_of], beyond
                    )


def stimulus_of(view: View, readings: Readings, before: Floats) -> Floats:
    """(3,) about what the first of the frames felt; `before` if that can't be told."""
    valid = readings.valid[0]
    if not view.geometry.spans(valid):
        return before
    weighed = view.rows[valid] / view.geometry.noise[valid, None] ** 2
    return np.asarray(
        np.linalg.solve(weighed.T @ view.rows[valid], weighed.T @ (readings.values[0] - view.offset)[valid])[:3]
    )


def _terms(stimulus: Floats, terms: int) -> Floats:
    """(n, terms) that go with the terms of an axis's error."""
    ones = np.ones((len(stimulus), 1))
    return ones if terms == 1 else np.concatenate([ones, stimulus], axis=1)


def _odd(view: View, solved: Floats, stimulus: Floats) -> npt.NDArray[np.intp]:
    """The frames whose stimulus makes slow errors differ from those at `stimulus` by more than is tolerated."""
    if view.terms == 1 or view.final:
        return np.zeros(0, np.intp)
    own = np.einsum("jkrr->rjk", view.errors)
    usual = _terms(stimulus[None], view.terms)[0]
    spread = np.maximum(np.einsum("rjk,j,k->r", own, usual, usual), 0.0)
    tolerated = _TOLERATED * (view.geometry.noise**2 + spread)
    away = np.linalg.norm(solved[:, :3] - stimulus, axis=1)
    slope = 2 * np.linalg.norm(own[:, 1:] @ usual, axis=1)
    curvature = np.trace(own[:, 1:, 1:], axis1=1, axis2=2)
    # Each row stays within its tolerance up to a distance: the root of curvature d^2 + slope d = tolerated.
    reach = 2 * tolerated / (slope + np.sqrt(slope**2 + 4 * np.maximum(curvature, 0.0) * tolerated) + 1e-300)
    return np.flatnonzero(away > reach.min())


def _beyond(
    view: View, bounds: Bounds, valid: Flags, clipped: Flags, frames: npt.NDArray[np.intp], unknowns: Floats
) -> Clipped:
    """What the `clipped` axes (m,) say in `frames`."""
    axes = np.flatnonzero(clipped)
    terms = _terms(unknowns[frames, :3], view.terms)
    gains, slow = view.gains(valid, terms), view.slow(terms)
    return Clipped(
        rows=view.rows[axes],
        known=gains @ slow[:, valid][:, :, axes],
        own=slow[:, axes][:, :, axes] + np.diag(view.geometry.noise[axes] ** 2),
        bounds=bounds.at[frames][:, axes] - view.offset[axes],
        signs=bounds.ends[frames][:, axes].astype(float),
    )
