"""Solution of frames: triads by generalised least squares, given the estimated slow errors of the current segment.

The covariance of the readings follows the signal. `SegmentView` holds the slow errors as the rows of one segment feel
them, `NominalGain` the gain that most of its frames share.

A clipped axis is a bound: its reading would have been beyond the end of the range. The unknowns and the reading that is
missing are jointly normal before that is used. Given that the reading lies beyond a bound it is a truncated normal, and
the unknowns follow it by linear regression. Mean and covariance are then exact for one clipped axis; several are
treated one after the other, each time with a normal of the same mean and covariance (assumed density filtering;
Maybeck, "Stochastic models, estimation and control", volume 2, 1982, section 12.7).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.fuse.optimal import compiled_segments
from imuarray.fuse.optimal.geometry import Bounds, FrameReadings, Geometry, patterns
from imuarray.fuse.optimal.states import Adjoint, FeltStates, Gaussian

_TOLERATED = 0.1
"""Share by which the stimulus may change the variance of a row before a frame gets a gain of its own; what a gain that
is so little off costs is of second order.
"""


class NominalGain(NamedTuple):
    """The gain of most frames of a segment, which have the same rows in use: `gain` (k, r), 0 for the others, what it
    makes of the slow errors expected, (k,), and the covariances of what it makes of noise, (k, k), of the slow errors'
    terms, (terms^2, k, k), and, for a unit of change in a second, of times, (k, k).
    """

    gain: Floats
    expected: Floats
    noise: Floats
    errors: Floats
    timing: Floats


class SegmentView:
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
        self.packed: Floats | None = None
        """The usual gain as `_segments.frames` takes it; None where NumPy does all."""
        self.packed_rows = b""
        """The rows in use that this gain is for, as the bytes of their flags."""
        self._usual: dict[bytes, NominalGain | None] = {}

    def begin(self, readings: FrameReadings, before: Floats, change: float) -> None:
        """Make the stimulus of the first of the frames the usual one (`before` if that can't be told), and `change`,
        the mean square of its change per second, what times in doubt are weighed by.
        """
        self._variance = self.geometry.noise**2 + self.geometry.timing**2 * change
        valid, self.stimulus = readings.valid[0], before
        if self.geometry.spans(valid):
            if readings.alike and readings.bounds is None:
                self._pack(readings, change)
                if self.packed is not None:
                    return
            weighed = self.rows[valid] / self.geometry.noise[valid, None] ** 2
            normal, sums = weighed.T @ self.rows[valid], weighed.T @ (readings.values[0] - self.offset)[valid]
            self.stimulus = np.linalg.solve(normal, sums)[:3]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Rows, unknowns and terms."""
        return (*self.rows.shape, len(self.errors))

    def _pack(self, readings: FrameReadings, change: float) -> None:
        """Compute stimulus, usual gain and reach by compiled code."""
        rows, unknowns, terms = sizes = self.sizes
        packed = np.empty(rows + 3 + unknowns * (rows + 1) + (2 + terms**2) * unknowns**2)
        known = (self.rows, self.geometry.noise, self.geometry.timing, self.offset, self.errors)
        first = np.ascontiguousarray(readings.values[0], float), readings.valid[0]
        reach = compiled_segments.begin((*known, *first, packed), sizes, self.final, change, _TOLERATED)
        if reach >= 0:
            self.packed, self.packed_rows, self.reach = packed, readings.valid[0].tobytes(), reach
            self._variance, self.stimulus = packed[:rows], packed[rows : rows + 3]

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

    def gains(self, valid: Booleans, terms: Floats) -> Floats:
        """(n, k, p) best gains of the p rows in use."""
        rows, noise = self.rows[valid], self._variance[valid]
        if self.final:
            weighed: Floats = np.broadcast_to(rows / noise[:, None], (len(terms), *rows.shape))
        else:
            weighed = np.asarray(np.linalg.solve(self.slow(terms)[:, valid][:, :, valid] + np.diag(noise), rows))
        return np.asarray(np.linalg.solve(rows.T @ weighed, np.swapaxes(weighed, -1, -2)))

    def spreads(self, valid: Booleans, gains: Floats, terms: Floats) -> Floats:
        """(n, k, k) covariances of what `gains` (n, k, p) make of the rows in use."""
        errors = self.slow(terms)[:, valid][:, :, valid] + np.diag(self.geometry.noise[valid] ** 2)
        return np.asarray(gains @ errors @ np.swapaxes(gains, -1, -2))

    def usual(self, valid: Booleans) -> NominalGain | None:
        """The gain at the usual stimulus; None where the rows in use don't span space."""
        key = valid.tobytes()
        if key not in self._usual:
            self._usual[key] = self._nominal_gain(valid) if self.geometry.spans(valid) else None
        return self._usual[key]

    def _nominal_gain(self, valid: Booleans) -> NominalGain:
        gain = np.zeros(self.rows.shape[::-1])
        (gain[:, valid],) = self.gains(valid, self.terms(self.stimulus[None]))
        noise = (gain * self.geometry.noise**2) @ gain.T
        both = (gain[:, None, :, None] * gain[None, :, None, :]).reshape(noise.size, -1)
        errors = (self.errors.reshape(-1, both.shape[1]) @ both.T).reshape(-1, *noise.shape)
        timing = (gain * self.geometry.timing**2) @ gain.T
        return NominalGain(gain, gain @ self.offset, noise, errors, timing)

    def usual_spreads(self, usual: NominalGain, stimulus: Floats) -> Floats:
        """(n, k, k), or (1, k, k) for all, covariances of what the usual gain makes of frames of (n, 3)."""
        if len(self.errors) == 1:
            return np.asarray(usual.noise + usual.errors)
        flat = usual.errors.reshape(len(usual.errors), -1)
        return np.asarray(usual.noise + (_pairs(self.terms(stimulus)) @ flat).reshape(-1, *usual.noise.shape))

    @cached_property
    def reach(self) -> float:
        """Return how far the stimulus may be from the usual one for the usual gain to be as good as the best."""
        if len(self.errors) == 1 or self.final:
            return np.inf
        own = np.einsum("jkrr->rjk", self.errors)
        usual = self.terms(self.stimulus[None])[0]
        tolerated = _TOLERATED * (self._variance + np.maximum(own @ usual @ usual, 0.0))
        slope = 2 * np.linalg.norm(own[:, 1:] @ usual, axis=1)
        curvature = np.maximum(np.trace(own[:, 1:, 1:], axis1=1, axis2=2), 0.0)
        # A row stays within its tolerance up to a distance d: the root of curvature d^2 + slope d = tolerated.
        return float((2 * tolerated / (slope + np.sqrt(slope**2 + 4 * curvature * tolerated) + 1e-300)).min())


def segment_view(felt: FeltStates, geometry: Geometry, belief: Gaussian, adjoint: Adjoint | None = None) -> SegmentView:
    """The states as the rows of `geometry` feel them; final with what came after them, the `adjoint`."""
    mean, covariance = felt.of(belief, adjoint)
    response = mean[1:].T if len(mean) > 1 else np.zeros((mean.shape[1], 3))
    errors = np.ascontiguousarray(covariance.transpose(0, 2, 1, 3))
    return SegmentView(geometry, mean[0], response, errors, adjoint is not None)


def _pairs(terms: Floats) -> Floats:
    """(n, terms^2) products of the terms."""
    return np.asarray((terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1))


_FAR = 50.0
"""Standard deviations beyond which the tail's variance is taken from its asymptotic series."""


class ClippedReadings(NamedTuple):
    """c clipped axes of n frames: `rows` (c, k) of the unknowns; `known` (n, k, c), how the slow errors of the axes in
    use, as the gain turns them into unknowns, go with those of the clipped ones; `own` (n, c, c) covariance of their
    slow errors and noise; `bounds` (n, c) less expected slow errors, and `signs` (n, c) of the end they stand at.
    """

    rows: Floats
    known: Floats
    own: Floats
    bounds: Floats
    signs: Floats


def truncated(distance: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of a standard normal that is known to be above `distance`, any sign.

    Johnson, Kotz, Balakrishnan, "Continuous univariate distributions", volume 1, 1994, section 13.10.1.
    """
    from scipy.special import erfcx  # its weight is for those who ask

    with np.errstate(over="ignore"):
        mean = np.sqrt(2 / np.pi) / erfcx(distance / np.sqrt(2))
    far = np.maximum(distance, _FAR)
    variance = np.where(distance > _FAR, 1 / far**2 - 6 / far**4, 1 - mean * (mean - distance))
    return mean, np.clip(variance, 0.0, 1.0)


def censored(unknowns: Floats, covariance: Floats, clipped: ClippedReadings) -> tuple[Floats, Floats]:
    """`unknowns` (n, k) and their covariance (n, k, k) with what clipped axes say."""
    count = unknowns.shape[1]
    mean = np.concatenate([unknowns, unknowns @ clipped.rows.T], axis=1)
    joint = _joint(covariance, clipped)
    for index in range(len(clipped.rows)):
        place = count + index
        sign, spread = clipped.signs[:, index], np.sqrt(np.maximum(joint[:, place, place], 1e-300))
        distance = sign * (clipped.bounds[:, index] - mean[:, place]) / spread
        moved, remaining = truncated(distance)
        gain = joint[:, :, place] / spread[:, None]
        mean = mean + gain * (sign * moved)[:, None]
        joint = joint - gain[:, :, None] * gain[:, None, :] * (1 - remaining)[:, None, None]
    return mean[:, :count], joint[:, :count, :count]


def _joint(covariance: Floats, clipped: ClippedReadings) -> Floats:
    """(n, k + c, k + c) covariance of the unknowns and of the readings that the clipped axes would have given."""
    rows = clipped.rows
    across = covariance @ rows.T - clipped.known
    shared = rows @ clipped.known
    own = rows @ covariance @ rows.T - shared - np.swapaxes(shared, 1, 2) + clipped.own
    top = np.concatenate([covariance, across], axis=2)
    return np.concatenate([top, np.concatenate([np.swapaxes(across, 1, 2), own], axis=2)], axis=1)


_CERTAIN = 5.0
"""Standard deviations beyond its bound at which a clipped axis says nothing new: it moves the mean by 1.5e-6 of one."""


@dataclass(frozen=True)
class FrameSolution:
    """n frames: `unknowns` (n, k), NaN if the axes don't span space, `covariance` (n, k, k), `used` (n, m)."""

    unknowns: Floats
    covariance: Floats
    used: Booleans

    @classmethod
    def empty(cls, frames: int, geometry: Geometry) -> FrameSolution:
        """Frames that are not solved yet."""
        unknowns = geometry.rows.shape[1]
        return cls(
            np.full((frames, unknowns), np.nan),
            np.full((frames, unknowns, unknowns), np.nan),
            np.zeros((frames, geometry.axes), bool),
        )

    def part(self, frames: slice) -> FrameSolution:
        """Some of the frames: the same memory."""
        return FrameSolution(self.unknowns[frames], self.covariance[frames], self.used[frames])


def solve(view: SegmentView, readings: FrameReadings, into: FrameSolution, frames: slice) -> None:
    """The triads of `readings`, which are `frames` of `into`."""
    into = into.part(frames)
    every = np.arange(len(readings.time))
    for valid, which in readings.patterns():
        usual = view.usual(valid)
        if usual is None:
            continue
        solved = readings.values[which] @ usual.gain.T - usual.expected
        into.unknowns[which], into.used[which] = solved, valid[: view.geometry.axes]
        into.covariance[which] = view.usual_spreads(usual, solved[:, :3])
        odd = np.zeros(len(solved), bool)
        if view.reach < np.inf:
            odd |= np.linalg.norm(solved[:, :3] - view.stimulus, axis=1) > view.reach
        telling = None
        if readings.bounds is not None:
            telling = _telling(view, readings.bounds, which, into)
            odd |= telling.any(axis=1)
        if odd.any():
            _solve_odd(view, readings, valid, every[which][odd], into, None if telling is None else telling[odd])


def _solve_odd(
    view: SegmentView,
    readings: FrameReadings,
    valid: Booleans,
    frames: Indices,
    into: FrameSolution,
    clipped: Booleans | None,
) -> None:
    """Frames with a gain of their own, and with the bounds of those axes that are `clipped` (n, m)."""
    terms = view.terms(into.unknowns[frames, :3])
    gains = view.gains(valid, terms)
    into.unknowns[frames] = np.einsum("nkp,np->nk", gains, (readings.values[frames] - view.offset)[:, valid])
    into.covariance[frames] = view.spreads(valid, gains, terms)
    if clipped is None or readings.bounds is None:
        return
    for axes, which in patterns(clipped):
        if axes.any():
            at = frames[which]
            bounds = Bounds(readings.bounds.ends[at], readings.bounds.at[at])
            beyond = _clipped_readings(view, bounds, valid, np.flatnonzero(axes), terms[which], gains[which])
            into.unknowns[at], into.covariance[at] = censored(into.unknowns[at], into.covariance[at], beyond)


def _telling(view: SegmentView, bounds: Bounds, which: Indices | slice, into: FrameSolution) -> Booleans:
    """(n, m) the clipped axes of these frames whose bounds say anything: not those that are expected far beyond."""
    ends = bounds.ends[which]
    telling: Booleans = np.asarray(ends != 0)
    frames = np.flatnonzero(telling.any(axis=1))
    if len(frames):
        solved, spread = into.unknowns[which][frames], into.covariance[which][frames]
        rows, noise = view.rows[: ends.shape[1]], view.geometry.noise[: ends.shape[1]]
        known = ((rows @ spread) * rows).sum(axis=2)
        variance = 2 * (known + view.own(view.terms(solved[:, :3]))[:, : len(noise)] + noise**2)
        short = ends[frames] * (bounds.at[which][frames] - solved @ rows.T - view.offset[: len(noise)])
        telling[frames] &= short > -_CERTAIN * np.sqrt(variance)
    return telling


def _clipped_readings(
    view: SegmentView, bounds: Bounds, valid: Booleans, axes: Indices, terms: Floats, gains: Floats
) -> ClippedReadings:
    """Return the readings of the clipped `axes` in the frames of `bounds`, whose gains and terms these are."""
    slow = view.slow(terms)
    return ClippedReadings(
        rows=view.rows[axes],
        known=gains @ slow[:, valid][:, :, axes],
        own=slow[:, axes][:, :, axes] + np.diag(view.geometry.noise[axes] ** 2),
        bounds=bounds.at[:, axes] - view.offset[axes],
        signs=bounds.ends[:, axes].astype(float),
    )
