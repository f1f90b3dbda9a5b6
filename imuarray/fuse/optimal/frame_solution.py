"""Solution of frames: triads by generalised least squares, given the estimated slow errors of the current segment.

The covariance of the readings depends on the signal. `SegmentView` contains the effect of the slow errors on the rows
of one segment, `NominalGain` the gain of most of its frames.

A clipped axis is a bound: its reading would have been beyond the end of the range. Without the bound, the unknowns and
the missing reading are jointly normal. Given the bound, the reading is a truncated normal, and the unknowns follow by
linear regression. Mean and covariance are then exact for one clipped axis; several are processed in sequence, each time
with a normal of the same mean and covariance (assumed density filtering; Maybeck, "Stochastic models, estimation and
control", volume 2, 1982, section 12.7).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.fuse.optimal import compiled
from imuarray.fuse.optimal.geometry import Bounds, FrameReadings, Geometry, patterns
from imuarray.fuse.optimal.states import Drift, Gaussian, StateResponse

_TOLERATED = 0.1
"""Largest relative change of the variance of a row by the stimulus in a frame with the nominal gain; the loss by a
slightly wrong gain is of second order.
"""


class NominalGain(NamedTuple):
    """The gain of most frames of a segment, which have the same rows in use: `gain` (k, r), 0 for other rows; its
    product with the expected slow errors (k,); and the covariances of the unknowns by noise (k, k), by the slow errors'
    terms (terms^2, k, k), and, per unit of change in a second, by errors of timing (k, k).
    """

    gain: Floats
    expected: Floats
    noise: Floats
    errors: Floats
    timing: Floats


class SegmentView:
    """Slow errors during one segment: `offset` (r,) is the expected sum of the slow errors of the r rows of a geometry,
    `response` (r, 3) the expected error of each row's direction, `errors` (terms, terms, r, r) the covariances of the
    errors' terms, the factors of (1, stimulus). `final`: they include the information of the frames (a smoother's).
    """

    def __init__(self, geometry: Geometry, offset: Floats, response: Floats, errors: Floats, final: bool) -> None:
        self.geometry, self.final = geometry, final
        self.offset, self.response, self.errors = offset, response, errors
        self.stimulus, self._variance = np.zeros(3), geometry.noise**2
        self.rows = geometry.rows.copy()
        self.rows[:, :3] += response
        self.packed: Floats | None = None
        """The nominal gain in the form of `_segments.frames`; None if NumPy is used."""
        self.packed_rows = b""
        """The rows in use of this gain, as the bytes of their flags."""
        self._usual: dict[bytes, NominalGain | None] = {}

    def begin(self, readings: FrameReadings, before: Floats, change: float) -> None:
        """Set the nominal stimulus to that of the first frame (`before` if that is not determined), and the mean square
        `change` per second by which errors of timing are weighted.
        """
        self._variance = self.geometry.noise**2 + self.geometry.timing**2 * change
        valid, self.stimulus = readings.valid[0], before
        if self.geometry.spans(valid):
            if compiled.COMPILED and readings.same_rows and readings.bounds is None:
                self._pack(readings, change)
                if self.packed is not None:
                    return
            weighed = self.rows[valid] / self.geometry.noise[valid, None] ** 2
            normal, sums = weighed.T @ self.rows[valid], weighed.T @ (readings.values[0] - self.offset)[valid]
            self.stimulus = np.linalg.solve(normal, sums)[:3]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of rows, unknowns and terms."""
        return (*self.rows.shape, len(self.errors))

    def _pack(self, readings: FrameReadings, change: float) -> None:
        """Compute stimulus, nominal gain and reach by compiled code."""
        rows, unknowns, terms = sizes = self.sizes
        packed = np.empty(rows + 3 + unknowns * (rows + 1) + (2 + terms**2) * unknowns**2)
        constants = (self.rows, self.geometry.noise, self.geometry.timing, self.offset, self.errors)
        first = np.ascontiguousarray(readings.values[0], float), readings.valid[0]
        reach = compiled.begin((*constants, *first, packed), sizes, self.final, change, _TOLERATED)
        if reach >= 0:
            self.packed, self.packed_rows, self.reach = packed, readings.valid[0].tobytes(), reach
            self._variance, self.stimulus = packed[:rows], packed[rows : rows + 3]

    def terms(self, stimulus: Floats) -> Floats:
        """Return the factors (n, terms) of the terms of an axis's error at (n, 3)."""
        ones = np.ones((len(stimulus), 1))
        return ones if len(self.errors) == 1 else np.concatenate([ones, stimulus], axis=1)

    def slow(self, terms: Floats) -> Floats:
        """Return (n, r, r) covariances of the slow errors."""
        flat = self.errors.reshape(-1, self.errors[0, 0].size)
        return np.asarray((_pairs(terms) @ flat).reshape(-1, *self.errors.shape[2:]))

    def own(self, terms: Floats) -> Floats:
        """Return (n, r) variances of the slow errors."""
        own = np.einsum("jkrr->jkr", self.errors).reshape(-1, len(self.rows))
        return np.asarray(np.maximum(_pairs(terms) @ own, 0.0))

    def gains(self, valid: Booleans, terms: Floats) -> Floats:
        """Return the best gains (n, k, p) of the p rows in use."""
        rows, noise = self.rows[valid], self._variance[valid]
        if self.final:
            weighed: Floats = np.broadcast_to(rows / noise[:, None], (len(terms), *rows.shape))
        else:
            weighed = np.asarray(np.linalg.solve(self.slow(terms)[:, valid][:, :, valid] + np.diag(noise), rows))
        return np.asarray(np.linalg.solve(rows.T @ weighed, np.swapaxes(weighed, -1, -2)))

    def spreads(self, valid: Booleans, gains: Floats, terms: Floats) -> Floats:
        """Return the covariances (n, k, k) of the unknowns with `gains` (n, k, p) of the rows in use."""
        errors = self.slow(terms)[:, valid][:, :, valid] + np.diag(self.geometry.noise[valid] ** 2)
        return np.asarray(gains @ errors @ np.swapaxes(gains, -1, -2))

    def usual(self, valid: Booleans) -> NominalGain | None:
        """Return the gain at the nominal stimulus; None if the rows in use do not span space."""
        key = valid.tobytes()
        if key not in self._usual:
            self._usual[key] = self._nominal_gain(valid) if self.geometry.spans(valid) else None
        return self._usual[key]

    def _nominal_gain(self, valid: Booleans) -> NominalGain:
        gain = np.zeros(self.rows.shape[::-1])
        (gain[:, valid],) = self.gains(valid, self.terms(self.stimulus[None]))
        noise = (gain * self.geometry.noise**2) @ gain.T
        products = (gain[:, None, :, None] * gain[None, :, None, :]).reshape(noise.size, -1)
        errors = (self.errors.reshape(-1, products.shape[1]) @ products.T).reshape(-1, *noise.shape)
        timing = (gain * self.geometry.timing**2) @ gain.T
        return NominalGain(gain, gain @ self.offset, noise, errors, timing)

    def usual_spreads(self, usual: NominalGain, stimulus: Floats) -> Floats:
        """Return the covariances (n, k, k), or (1, k, k) for all, of frames of (n, 3) with the nominal gain."""
        if len(self.errors) == 1:
            return np.asarray(usual.noise + usual.errors)
        flat = usual.errors.reshape(len(usual.errors), -1)
        return np.asarray(usual.noise + (_pairs(self.terms(stimulus)) @ flat).reshape(-1, *usual.noise.shape))

    @cached_property
    def reach(self) -> float:
        """Largest distance of the stimulus from the nominal one at which the nominal gain is used."""
        if len(self.errors) == 1 or self.final:
            return np.inf
        own = np.einsum("jkrr->rjk", self.errors)
        usual = self.terms(self.stimulus[None])[0]
        tolerated = _TOLERATED * (self._variance + np.maximum(own @ usual @ usual, 0.0))
        slope = 2 * np.linalg.norm(own[:, 1:] @ usual, axis=1)
        curvature = np.maximum(np.trace(own[:, 1:, 1:], axis1=1, axis2=2), 0.0)
        # A row stays within its tolerance up to a distance d: the root of curvature d^2 + slope d = tolerated.
        return float((2 * tolerated / (slope + np.sqrt(slope**2 + 4 * curvature * tolerated) + 1e-300)).min())


def segment_view(states: StateResponse, geometry: Geometry, belief: Gaussian) -> SegmentView:
    """Return the effect of the states on the rows of `geometry`."""
    mean, errors = states.of(belief)
    return SegmentView(geometry, mean[0], _response(mean), errors, False)


class SmoothedEffect:
    """The effect of smoothed states on the rows of a `geometry`: `at_end` is the distribution of the states at the end
    of a log, which is that of the constant ones throughout; the others are `drifting` (n,).
    """

    def __init__(self, geometry: Geometry, states: StateResponse, at_end: Gaussian, drifting: Booleans) -> None:
        self._geometry, self.states = geometry, states
        steady = ~drifting
        constant = Gaussian(at_end.mean * steady, at_end.covariance * np.outer(steady, steady))
        self._mean, self._errors = states.of(constant)

    def view(self, drift: Drift) -> SegmentView:
        """Return the view of a segment."""
        errors = self._errors.copy()
        errors[0] += drift.errors.transpose(1, 0, 2)
        errors[1:, 0] += drift.errors.transpose(1, 2, 0)[1:]
        return SegmentView(self._geometry, self._mean[0] + drift.offset, _response(self._mean), errors, True)


def _response(mean: Floats) -> Floats:
    """Return the expected error of each row's direction (r, 3) by the mean (terms, r) of the effect."""
    return mean[1:].T if len(mean) > 1 else np.zeros((mean.shape[1], 3))


def _pairs(terms: Floats) -> Floats:
    """Return (n, terms^2) products of the terms."""
    return np.asarray((terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1))


_FAR = 50.0
"""Distance in standard deviations beyond which the variance of the tail is computed from its asymptotic series."""


class ClippedReadings(NamedTuple):
    """c clipped axes of n frames: their `rows` (c, k); `known` (n, k, c), the covariance of the unknowns' slow errors,
    by the gain of the axes in use, with those of the clipped axes; `own` (n, c, c), the covariance of their slow errors
    and noise; `bounds` (n, c) less expected slow errors, and `signs` (n, c) of the ends of the range.
    """

    rows: Floats
    known: Floats
    own: Floats
    bounds: Floats
    signs: Floats


def truncate_normal(distance: Floats) -> tuple[Floats, Floats]:
    """Return mean and variance of a standard normal that is above `distance`, of any sign.

    Johnson, Kotz, Balakrishnan, "Continuous univariate distributions", volume 1, 1994, section 13.10.1.
    """
    from scipy.special import erfcx  # slow to import

    with np.errstate(over="ignore"):
        mean = np.sqrt(2 / np.pi) / erfcx(distance / np.sqrt(2))
    far = np.maximum(distance, _FAR)
    variance = np.where(distance > _FAR, 1 / far**2 - 6 / far**4, 1 - mean * (mean - distance))
    return mean, np.clip(variance, 0.0, 1.0)


def censor(unknowns: Floats, covariance: Floats, clipped: ClippedReadings) -> tuple[Floats, Floats]:
    """Update `unknowns` (n, k) and their covariance (n, k, k) by the bounds of clipped axes."""
    count = unknowns.shape[1]
    mean = np.concatenate([unknowns, unknowns @ clipped.rows.T], axis=1)
    joint = _joint(covariance, clipped)
    for index in range(len(clipped.rows)):
        place = count + index
        sign, deviation = clipped.signs[:, index], np.sqrt(np.maximum(joint[:, place, place], 1e-300))
        distance = sign * (clipped.bounds[:, index] - mean[:, place]) / deviation
        moved, remaining = truncate_normal(distance)
        gain = joint[:, :, place] / deviation[:, None]
        mean = mean + gain * (sign * moved)[:, None]
        joint = joint - gain[:, :, None] * gain[:, None, :] * (1 - remaining)[:, None, None]
    return mean[:, :count], joint[:, :count, :count]


def _joint(covariance: Floats, clipped: ClippedReadings) -> Floats:
    """Return the covariance (n, k + c, k + c) of the unknowns and of the missing readings of the clipped axes."""
    rows = clipped.rows
    across = covariance @ rows.T - clipped.known
    shared = rows @ clipped.known
    own = rows @ covariance @ rows.T - shared - np.swapaxes(shared, 1, 2) + clipped.own
    top = np.concatenate([covariance, across], axis=2)
    return np.concatenate([top, np.concatenate([np.swapaxes(across, 1, 2), own], axis=2)], axis=1)


_CERTAIN = 5.0
"""Distance of the expectation beyond the bound, in standard deviations, at which a clipped axis contains no
information: it changes the mean by 1.5e-6 standard deviations.
"""


@dataclass(frozen=True)
class FrameSolution:
    """n frames: `unknowns` (n, k), NaN if the axes do not span space, `covariance` (n, k, k), `used` (n, m)."""

    unknowns: Floats
    covariance: Floats
    used: Booleans

    @classmethod
    def empty(cls, frames: int, geometry: Geometry) -> FrameSolution:
        """Return frames without a solution."""
        unknowns = geometry.rows.shape[1]
        return cls(
            np.full((frames, unknowns), np.nan),
            np.full((frames, unknowns, unknowns), np.nan),
            np.zeros((frames, geometry.axes), bool),
        )

    def part(self, frames: slice) -> FrameSolution:
        """Return some of the frames, sharing memory."""
        return FrameSolution(self.unknowns[frames], self.covariance[frames], self.used[frames])


def solve(view: SegmentView, readings: FrameReadings, into: FrameSolution, frames: slice) -> None:
    """Solve the triads of `readings`, which are `frames` of `into`."""
    into = into.part(frames)
    all_frames = np.arange(len(readings.time))
    for valid, pattern_frames in readings.patterns():
        usual = view.usual(valid)
        if usual is None:
            continue
        solved = readings.values[pattern_frames] @ usual.gain.T - usual.expected
        into.unknowns[pattern_frames], into.used[pattern_frames] = solved, valid[: view.geometry.axes]
        into.covariance[pattern_frames] = view.usual_spreads(usual, solved[:, :3])
        odd = np.zeros(len(solved), bool)
        if view.reach < np.inf:
            odd |= np.linalg.norm(solved[:, :3] - view.stimulus, axis=1) > view.reach
        informative = None
        if readings.bounds is not None:
            informative = _informative(view, readings.bounds, pattern_frames, into)
            odd |= informative.any(axis=1)
        if odd.any():
            clipped = None if informative is None else informative[odd]
            _solve_odd(view, readings, valid, all_frames[pattern_frames][odd], into, clipped)


def _solve_odd(
    view: SegmentView,
    readings: FrameReadings,
    valid: Booleans,
    frames: Indices,
    into: FrameSolution,
    clipped: Booleans | None,
) -> None:
    """Solve frames with gains of their own and with the bounds of the axes that are `clipped` (n, m)."""
    terms = view.terms(into.unknowns[frames, :3])
    gains = view.gains(valid, terms)
    into.unknowns[frames] = np.einsum("nkp,np->nk", gains, (readings.values[frames] - view.offset)[:, valid])
    into.covariance[frames] = view.spreads(valid, gains, terms)
    if clipped is None or readings.bounds is None:
        return
    for axes, pattern_frames in patterns(clipped):
        if axes.any():
            selected = frames[pattern_frames]
            bounds = Bounds(readings.bounds.ends[selected], readings.bounds.at[selected])
            beyond = _clipped_readings(
                view, bounds, valid, np.flatnonzero(axes), terms[pattern_frames], gains[pattern_frames]
            )
            into.unknowns[selected], into.covariance[selected] = censor(
                into.unknowns[selected], into.covariance[selected], beyond
            )


def _informative(view: SegmentView, bounds: Bounds, which: Indices | slice, into: FrameSolution) -> Booleans:
    """Return (n, m) the clipped axes of these frames whose bounds contain information: those that are not expected far
    beyond the bound.
    """
    ends = bounds.ends[which]
    informative: Booleans = np.asarray(ends != 0)
    frames = np.flatnonzero(informative.any(axis=1))
    if len(frames):
        solved, covariances = into.unknowns[which][frames], into.covariance[which][frames]
        rows, noise = view.rows[: ends.shape[1]], view.geometry.noise[: ends.shape[1]]
        variances = ((rows @ covariances) * rows).sum(axis=2)
        variance = 2 * (variances + view.own(view.terms(solved[:, :3]))[:, : len(noise)] + noise**2)
        short = ends[frames] * (bounds.at[which][frames] - solved @ rows.T - view.offset[: len(noise)])
        informative[frames] &= short > -_CERTAIN * np.sqrt(variance)
    return informative


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
