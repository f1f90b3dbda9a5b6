"""The slow errors as the frames of one segment feel them, and the gains that go with them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from imuarray.fuse.frames import Flags, Floats
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.kalman import Normal
from imuarray.fuse.optimal.readings import Readings
from imuarray.fuse.optimal.states import States

_TOLERATED = 0.1
"""Share by which the stimulus may change the variance of a row before a frame gets a gain of its own; what a gain that
is so little off costs is of second order.
"""


class Usual(NamedTuple):
    """What most frames of a segment with the same rows in use have: `gain` (k, r), 0 for the others, what it makes of
    the slow errors expected, (k,), and the covariances of what it makes of noise, (k, k), of the slow errors' terms,
    (terms^2, k, k), and, for a unit of change in a second, of times, (k, k).
    """

    gain: Floats
    expected: Floats
    noise: Floats
    errors: Floats
    timing: Floats


class View:
    """During one segment: `offset` (r,) the expected sum of the slow errors of the r rows of a geometry, `response` (r,
    3) the expected error of each row's direction, `errors` (terms, terms, r, r) the covariances of the errors' terms,
    which (1, stimulus) goes with. `final`: the frames themselves are in them already (a smoother's).
    """

    def __init__(self, geometry: Geometry, offset: Floats, response: Floats, errors: Floats, final: bool) -> None:
        self.geometry, self.final = geometry, final
        self.offset, self.response, self.errors = offset, response, errors
        self.stimulus, self._variance = np.zeros(3), geometry.noise**2
        self.rows = geometry.rows.copy()
        self.rows[:, :3] += response
        self._usual: dict[bytes, Usual | None] = {}

    def begin(self, readings: Readings, before: Floats, change: float) -> None:
        """Make the stimulus of the first of the frames the usual one (`before` if that can't be told), and `change`,
        the mean square of its change per second, what times in doubt are weighed by.
        """
        self._variance = self.geometry.noise**2 + self.geometry.timing**2 * change
        valid, self.stimulus = readings.valid[0], before
        if self.geometry.spans(valid):
            weighed = self.rows[valid] / self.geometry.noise[valid, None] ** 2
            normal, sums = weighed.T @ self.rows[valid], weighed.T @ (readings.values[0] - self.offset)[valid]
            self.stimulus = np.linalg.solve(normal, sums)[:3]

    def terms(self, stimulus: Floats) -> Floats:
        """(n, terms) that go with the terms of an axis's error at (n, 3)."""
        ones = np.ones((len(stimulus), 1))
        return ones if len(self.errors) == 1 else np.concatenate([ones, stimulus], axis=1)

    def slow(self, terms: Floats) -> Floats:
        """(n, r, r) covariances of the slow errors."""
        flat = self.errors.reshape(-1, self.errors[0, 0].size)
        return np.asarray((_pairs(terms) @ flat).reshape(-1, *self.errors.shape[2:]))

    def own(self, terms: Floats) -> Floats:
        """(n, r) variances of the slow errors."""
        own = np.einsum("jkrr->jkr", self.errors).reshape(-1, len(self.rows))
        return np.asarray(np.maximum(_pairs(terms) @ own, 0.0))

    def gains(self, valid: Flags, terms: Floats) -> Floats:
        """(n, k, p) best gains of the p rows in use."""
        rows, noise = self.rows[valid], self._variance[valid]
        if self.final:
            weighed: Floats = np.broadcast_to(rows / noise[:, None], (len(terms), *rows.shape))
        else:
            weighed = np.asarray(np.linalg.solve(self.slow(terms)[:, valid][:, :, valid] + np.diag(noise), rows))
        return np.asarray(np.linalg.solve(rows.T @ weighed, np.swapaxes(weighed, -1, -2)))

    def spreads(self, valid: Flags, gains: Floats, terms: Floats) -> Floats:
        """(n, k, k) covariances of what `gains` (n, k, p) make of the rows in use."""
        errors = self.slow(terms)[:, valid][:, :, valid] + np.diag(self.geometry.noise[valid] ** 2)
        return np.asarray(gains @ errors @ np.swapaxes(gains, -1, -2))

    def usual(self, valid: Flags) -> Usual | None:
        """The gain at the usual stimulus; None where the rows in use don't span space."""
        key = valid.tobytes()
        if key not in self._usual:
            self._usual[key] = self._worked_out(valid) if self.geometry.spans(valid) else None
        return self._usual[key]

    def _worked_out(self, valid: Flags) -> Usual:
        gain = np.zeros(self.rows.shape[::-1])
        (gain[:, valid],) = self.gains(valid, self.terms(self.stimulus[None]))
        noise = (gain * self.geometry.noise**2) @ gain.T
        errors = (gain @ self.errors @ gain.T).reshape(-1, *noise.shape)
        timing = (gain * self.geometry.timing**2) @ gain.T
        return Usual(gain, gain @ self.offset, noise, errors, timing)

    def usual_spreads(self, usual: Usual, stimulus: Floats) -> Floats:
        """(n, k, k), or (1, k, k) for all, covariances of what the usual gain makes of frames of (n, 3)."""
        if len(self.errors) == 1:
            return np.asarray(usual.noise + usual.errors)
        flat = usual.errors.reshape(len(usual.errors), -1)
        return np.asarray(usual.noise + (_pairs(self.terms(stimulus)) @ flat).reshape(-1, *usual.noise.shape))

    @cached_property
    def reach(self) -> float:
        """How far the stimulus may be from the usual one for the usual gain to be as good as the best."""
        if len(self.errors) == 1 or self.final:
            return np.inf
        own = np.einsum("jkrr->rjk", self.errors)
        usual = self.terms(self.stimulus[None])[0]
        tolerated = _TOLERATED * (self._variance + np.maximum(own @ usual @ usual, 0.0))
        slope = 2 * np.linalg.norm(own[:, 1:] @ usual, axis=1)
        curvature = np.maximum(np.trace(own[:, 1:, 1:], axis1=1, axis2=2), 0.0)
        # A row stays within its tolerance up to a distance d: the root of curvature d^2 + slope d = tolerated.
        return float((2 * tolerated / (slope + np.sqrt(slope**2 + 4 * curvature * tolerated) + 1e-300)).min())


def view_of(states: States, geometry: Geometry, belief: Normal, warmer_degc: Floats, *, final: bool = False) -> View:
    """The states as the rows of `geometry` feel them while they are warmer than their biases by (r,)."""
    rows = states.rows(warmer_degc)
    terms, count, _ = rows.shape
    flat = rows.reshape(terms * count, -1)
    felt = (flat @ belief.mean).reshape(terms, count)
    errors = (flat @ belief.covariance @ flat.T).reshape(terms, count, terms, count).transpose(0, 2, 1, 3)
    response = felt[1:].T if terms > 1 else np.zeros((count, 3))
    return View(geometry, felt[0], response, np.ascontiguousarray(errors), final)


def _pairs(terms: Floats) -> Floats:
    """(n, terms^2) products of the terms."""
    return np.asarray((terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1))
