"""`optimal`: fusion of all readings by the error model of the whole array; the other techniques are special cases.

The differences between the axes, which do not depend on the stimulus, contain their slow errors: a Kalman filter over
segments of frames estimates them (`imuarray.fuse.optimal.filter`, with the states of `imuarray.fuse.optimal.states`).
Each frame is then solved by generalised least squares with the remaining uncertainty of these errors
(`imuarray.fuse.optimal.frame_solution`). With equal noise and no other errors the result is the mean; with noise alone
the weights are inverse variances, as in `planes` and `ranges`; states that a design shares make it `opposed`.

`Optimal` is causal and solves frames as they arrive; `smoothed` solves each frame of a log with the information of all
of them. Biases follow the temperature of the axes relative to that at which they were measured (`BiasTemperature`). The
estimated slow errors are reported as notes.

The size effect is the specific force at accelerometers away from the origin of the box frame while the box turns. A
sensor at r measures f + alpha x r + omega x (omega x r) (rigid-body kinematics). The last term is removed with the
angular rate of the gyroscopes, and the angular acceleration alpha adds three unknowns to every frame; along an axis s
of a sensor it contributes alpha . (r x s). The angular rate of three neighbouring frames gives an additional reading of
alpha: the slope, at the last of them, of the parabola through them, which unlike a plain difference does not lag behind
a steady change of alpha.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Times
from imuarray.errors import FusionError
from imuarray.fuse.frames import Axis, Estimate, Frames, FusedBlock, entries
from imuarray.fuse.least_squares import AxisNoise, gains_of
from imuarray.fuse.optimal.filter import ArrayFilter, Dynamics, SegmentEnds, SegmentSmoother
from imuarray.fuse.optimal.frame_solution import FrameSolution, SegmentView
from imuarray.fuse.optimal.geometry import Bounds, FrameReadings, Geometry, geometry_of, hold_last, readings_of
from imuarray.fuse.optimal.prior import ErrorModel
from imuarray.fuse.optimal.states import states_of
from imuarray.fuse.pipeline import FusionNotes, LearnedBias, Pipeline, fused_block

FASTEST = 300.0
"""Prior standard deviation of the angular acceleration in rad/s2: a turn at 1000 dps reversed in 0.1 s has 350."""

ROWS = 6
"""Number of rows after those of the axes: three of the slopes, and three of the prior `FASTEST`."""

_PARABOLA = 6.5
"""Variance of a parabola's slope at the last of three points, relative to theirs, in periods: 1.5^2 + 2^2 + 0.5^2."""

_JITTER = 0.25
"""Largest relative deviation of the time between neighbouring frames, for which that variance is about right."""


def with_lever(
    geometry: Geometry, axes: Sequence[Axis], rate_covariance: Floats, period_s: float
) -> tuple[Geometry, Lever]:
    """Return the geometry with angular acceleration as unknowns 3 to 5, and the lever for it; `rate_covariance` (3, 3)
    is that of a frame's angular rate by noise alone.
    """
    places = np.array([axis.position_m for axis in axes])
    # the slopes of the angular rate, scaled to unit variance
    whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(_PARABOLA * rate_covariance / period_s**2)))
    rows = np.zeros((len(axes) + ROWS, 6))
    rows[: len(axes), :3] = geometry.rows
    rows[: len(axes), 3:] = np.cross(places, geometry.rows)
    rows[len(axes) : -3, 3:] = whitening
    rows[-3:, 3:] = np.eye(3) / FASTEST
    ones, never = np.ones(ROWS), np.full(ROWS, np.inf)
    extended = Geometry(
        rows,
        np.concatenate([geometry.noise, ones]),
        np.concatenate([geometry.noise_of_means, ones]),
        np.concatenate([geometry.end, never]),
        np.concatenate([geometry.timing, np.zeros(ROWS)]),
        len(axes),
    )
    return extended, Lever(axes, whitening, period_s)


@dataclass
class Lever:
    """Converts accelerometer readings to those of a geometry `with_lever`, for consecutive blocks."""

    axes: Sequence[Axis]
    whitening: Floats
    period_s: float

    def __post_init__(self) -> None:
        self._places = np.array([axis.position_m for axis in self.axes])
        self._directions = np.array([axis.direction_box for axis in self.axes])
        self.forget()

    def forget(self) -> None:
        """Restart: the rate before the next frame is unknown."""
        self._time, self._rate = np.zeros(2, np.int64), np.full((2, 3), np.nan)
        self._last_rate = np.zeros(3)

    def __call__(self, readings: FrameReadings, rate: Floats) -> FrameReadings:
        """Return `readings` with the centripetal term removed, and the readings of the angular acceleration. Where
        `rate` (n, 3) rad/s is unknown (NaN), the last known one is used, and there is no slope.
        """
        time, rates = np.concatenate([self._time, readings.time]), np.concatenate([self._rate, rate])
        acceleration = self._slopes(time, rates)
        held_rate = hold_last(np.concatenate([self._last_rate[None], rate]))[1:]
        self._time, self._rate, self._last_rate = (
            time[-2:],
            rates[-2:],
            (held_rate[-1] if len(held_rate) else self._last_rate),
        )
        is_finite = np.asarray(np.isfinite(acceleration).all(axis=1))
        turning = self._centripetal(held_rate)
        values = np.where(readings.valid, readings.values - turning, 0.0)
        reported = np.where(is_finite[:, None], acceleration, 0.0) @ self.whitening.T
        valid_columns = np.concatenate(
            [np.repeat(is_finite[:, None], 3, axis=1), np.ones((len(is_finite), 3), bool)], axis=1
        )
        return FrameReadings(
            readings.time,
            np.concatenate([values, reported, np.zeros((len(is_finite), 3))], axis=1),
            np.concatenate([readings.valid, valid_columns], axis=1),
            None if readings.bounds is None else Bounds(readings.bounds.ends, readings.bounds.at - turning),
            readings.same_rows and bool((is_finite == is_finite[:1]).all()),
        )

    def _centripetal(self, rate: Floats) -> Floats:
        """Return (n, m) s . (omega x (omega x r)) = (s . omega) (r . omega) - (s . r) |omega|^2."""
        across = (rate @ self._directions.T) * (rate @ self._places.T)
        return np.asarray(across - (rate**2).sum(axis=1)[:, None] * (self._directions * self._places).sum(axis=1))

    def _slopes(self, time: Times, rate: Floats) -> Floats:
        """Return the slopes (n, 3) in rad/s2 from n + 2 frames; NaN unless the frames are neighbours."""
        steps_s = np.diff(time) * 1e-9
        steps_s[np.abs(steps_s - self.period_s) > _JITTER * self.period_s] = np.nan
        slopes = np.diff(rate, axis=0) / steps_s[:, None]
        share = steps_s[1:] / (steps_s[1:] + steps_s[:-1])
        return np.asarray(slopes[1:] + share[:, None] * np.diff(slopes, axis=0))


def learned_biases(axes: Sequence[Axis], estimator: ArrayFilter) -> list[LearnedBias]:
    """Return the estimated bias of every axis, in order."""
    rows = estimator.states.response_at(estimator.warmer_degc).dense[0][: len(axes)]
    biases = rows @ estimator.belief.mean
    spreads = [
        np.sqrt(np.maximum(np.einsum("in,nk,ik->i", rows, covariance, rows), 0.0))
        for covariance in (estimator.belief.covariance, estimator.states.prior)
    ]
    return [
        LearnedBias(axis.label, float(bias), float(sd), float(sd_before))
        for axis, bias, sd, sd_before in zip(axes, biases, *spreads, strict=True)
    ]


class BiasTemperature:
    """Tracks the temperatures of the sensors over consecutive blocks; an unknown temperature is the last known one, or
    that of the bias before the first.
    """

    def __init__(self, axes: Sequence[Axis], model: ErrorModel, others: int = 0) -> None:
        """`others` rows follow those of the axes, and have no temperature."""
        self._sensors = [axis.sensor for axis in axes]
        degc = [error.bias_degc for error in model.of(axes)]
        self._bias_degc = np.array([np.nan if bias_degc is None else bias_degc for bias_degc in degc])
        self._warmer = np.zeros(len(axes) + others)

    def of(self, degc: Mapping[str, Floats]) -> Callable[[int], Floats]:
        """Return the function from a frame of a block, with temperatures `degc` (n,) by sensor, to the temperatures
        (r,) above those of the biases; it must be called for frames in order.
        """
        return lambda frame: self._temperatures_at({sensor: float(column[frame]) for sensor, column in degc.items()})

    def _temperatures_at(self, degc: Mapping[str, float]) -> Floats:
        if not degc:
            return self._warmer.copy()
        now = np.array([degc.get(sensor, np.nan) for sensor in self._sensors])
        self._bias_degc = np.where(np.isnan(self._bias_degc), now, self._bias_degc)
        warmer = now - self._bias_degc
        self._warmer[: len(now)] = np.where(np.isnan(warmer), self._warmer[: len(now)], warmer)
        return self._warmer.copy()


SEGMENT_S = 1.0
"""Time over which slow errors count as constant: short compared with their time constants."""

Temperatures = Mapping[str, Floats]
"""Temperatures (n,) of elements in degC at the frames, NaN if not known, keyed by sensor."""

_NONE: Temperatures = MappingProxyType({})

_RATE, _FORCE = "angular_rate", "specific_force"


class Optimal:
    """Causal estimator of the whole array for consecutive blocks of frames; the result does not depend on their length.

    `axes` by quantity; slow errors are constant over `segment_s`; `period_s` is the time between frames.
    """

    def __init__(
        self, axes: Mapping[str, Sequence[Axis]], model: ErrorModel, *, period_s: float, segment_s: float = SEGMENT_S
    ) -> None:
        """FusionError for axes that are not in the model, and for a period that is not positive."""
        if not 0 < period_s < math.inf:
            raise FusionError(f"frames every {period_s:g} s: a positive time is required")
        self._axes = {quantity: list(axes[quantity]) for quantity in (_RATE, _FORCE) if quantity in axes}
        self._model, self._period_s = model, period_s
        self._segment_frames = max(1, round(segment_s / period_s))
        self._groups = self._latest = self._create_groups()
        self.angular_acceleration: Estimate | None = None

    def __call__(self, frames: Mapping[str, Frames], degc: Temperatures | None = None) -> dict[str, Estimate]:
        """Estimate the next frames, of both quantities at the same times, with the information of earlier frames."""
        self._latest = self._groups
        solutions = _solve_groups(self._groups, frames, degc or _NONE)
        self.angular_acceleration = _acceleration(solutions)
        return {quantity: self._groups[quantity].estimate(solutions[quantity], frames[quantity]) for quantity in frames}

    def learned(self) -> dict[str, list[LearnedBias]]:
        """Return the estimated slow errors, by quantity: at the last frame, or, after `smoothed`, at the end of that
        log.
        """
        return {
            quantity: learned_biases(self._axes[quantity], group.filter) for quantity, group in self._latest.items()
        }

    def smoothed(
        self, blocks: Callable[[], Iterator[tuple[Mapping[str, Frames], Temperatures | None]]]
    ) -> Iterator[tuple[Times, dict[str, Estimate]]]:
        """Yield time (n,) and estimates of every block, with the information of all frames; independent of earlier
        calls.

        `blocks` returns the consecutive blocks of a log, frames and temperatures, from its beginning; it is called
        twice.
        """
        groups = self._latest = self._create_groups(recording=True)
        with ExitStack() as spools:
            for group in groups.values():
                spools.callback(group.close)
            for frames, degc in blocks():
                _solve_groups(groups, frames, degc or _NONE)
            for group in groups.values():
                group.turn_back()
            for frames, _ in blocks():
                solutions = _solve_groups(groups, frames, _NONE)
                self.angular_acceleration = _acceleration(solutions)
                time = next(iter(frames.values())).time
                yield (
                    time,
                    {quantity: groups[quantity].estimate(solutions[quantity], frames[quantity]) for quantity in frames},
                )

    def _create_groups(self, *, recording: bool = False) -> dict[str, _Group]:
        groups: dict[str, _Group] = {}
        for quantity, axes in self._axes.items():
            geometry, lever = geometry_of(axes, self._model), None
            has_positions = any(any(axis.position_m) for axis in axes)
            if quantity == _FORCE and _RATE in groups and has_positions and groups[_RATE].spans():
                geometry, lever = with_lever(geometry, axes, groups[_RATE].noise_covariance(), self._period_s)
            groups[quantity] = _Group(
                axes, self._model, geometry, lever, _Timing(self._segment_frames, self._period_s), recording
            )
        return groups


class _Timing(NamedTuple):
    """Number of frames of a segment, and seconds from frame to frame."""

    segment_frames: int
    period_s: float


class _Group:
    """One quantity: its filter, or its smoothed views in a second pass."""

    def __init__(
        self,
        axes: Sequence[Axis],
        model: ErrorModel,
        geometry: Geometry,
        lever: Lever | None,
        timing: _Timing,
        recording: bool,
    ) -> None:
        self._geometry, self.lever = geometry, lever
        others = ROWS if lever is not None else 0
        states = states_of(axes, model, others)
        self._recorder = SegmentSmoother(geometry, states) if recording else None
        self.filter = ArrayFilter(
            geometry, states, timing.segment_frames, Dynamics(geometry, timing.period_s), self._recorder
        )
        self._bias_temperature = BiasTemperature(axes, model, others)
        self._other_ends: SegmentEnds | None = None
        self._view: SegmentView | None = None
        self._stimulus = np.zeros(3)
        self._segment_frames, self._dynamics = timing.segment_frames, Dynamics(geometry, timing.period_s)

    def __call__(self, frames: Frames, degc: Temperatures, rate: Floats | None) -> FrameSolution:
        readings = readings_of(frames, self._geometry)
        if self.lever is not None:
            readings = self.lever(readings, np.full((len(frames.time), 3), np.nan) if rate is None else rate)
        if self._other_ends is not None:
            return self._solve_by_views(readings, self._other_ends)
        element_degc = degc if self.filter.states.follow_temperature else _NONE
        return self.filter(readings, self._bias_temperature.of(element_degc))

    def estimate(self, solution: FrameSolution, frames: Frames) -> Estimate:
        """Return the estimate of a solution of `frames`. The noise that the correction of delays added to the readings
        is taken into account with gains by noise alone.
        """
        covariance = entries(solution.covariance[:, :3, :3])
        if frames.delay_noise is not None and len(frames.time):
            axes, rows = self._geometry.axes, self._geometry.rows[: self._geometry.axes, :3]
            noise = AxisNoise(rows, self._geometry.noise[:axes], frames.delay_noise)
            covariance = covariance + noise.by_delays(gains_of(solution.used / noise.rms**2, rows))
        return Estimate(solution.unknowns[:, :3], covariance, solution.used)

    def noise_covariance(self) -> Floats:
        """Return the covariance (3, 3) of the triad by noise alone, with every axis."""
        rows, noise = self._geometry.rows, self._geometry.noise
        return np.asarray(np.linalg.inv(rows.T @ (rows / noise[:, None] ** 2)))

    def spans(self) -> bool:
        """Return whether all axes together span space."""
        return self._geometry.spans(np.ones(len(self._geometry.noise), bool))

    def turn_back(self) -> None:
        """Begin the second pass over the same frames."""
        self.filter.end()
        if self._recorder is not None:
            self._recorder.smooth(self.filter.belief)
        if self.lever is not None:
            self.lever.forget()
        self._other_ends = SegmentEnds(self._segment_frames)

    def close(self) -> None:
        """Delete the temporary files."""
        if self._recorder is not None:
            self._recorder.close()

    def _solve_by_views(self, readings: FrameReadings, segments: SegmentEnds) -> FrameSolution:
        solution = FrameSolution.empty(len(readings.time), self._geometry)
        for frames, starts, _ in segments.parts(len(readings.time)):
            part = readings.part(frames)
            if (starts or self._view is None) and self._recorder is not None:
                self._view = self._recorder.view()
                self._view.begin(part, self._stimulus, self._dynamics.recent())
                self._stimulus = self._view.stimulus
            if self._view is not None:
                self._dynamics.solve(self._view, part, solution, frames)
        return solution


def _solve_groups(
    groups: Mapping[str, _Group], frames: Mapping[str, Frames], degc: Temperatures
) -> dict[str, FrameSolution]:
    """Solve the frames of all groups; angular rate first, because the specific force away from the origin needs it."""
    solutions: dict[str, FrameSolution] = {}
    for quantity, group in groups.items():
        if quantity in frames:
            rate = solutions[_RATE].unknowns if _RATE in solutions else None
            solutions[quantity] = group(frames[quantity], degc, rate)
    return solutions


def _acceleration(solutions: Mapping[str, FrameSolution]) -> Estimate | None:
    """Return the angular acceleration if it is an unknown."""
    solution = solutions.get(_FORCE)
    if solution is None or solution.unknowns.shape[1] == 3:
        return None
    return Estimate(solution.unknowns[:, 3:], entries(solution.covariance[:, 3:, 3:]), solution.used)


FrameBlock = tuple[Mapping[str, Frames], Mapping[str, Floats]]
"""Frames by quantity, and the temperatures of elements by sensor."""


class CausalPipeline(Pipeline[FusedBlock]):
    """A causal `Optimal` as a `Pipeline`."""

    def __init__(self, axes: Mapping[str, Sequence[Axis]], model: ErrorModel, period_s: float) -> None:
        """FusionError for axes that are not in the model."""
        self._axes = axes
        self._optimal = Optimal(axes, model, period_s=period_s)

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
        """See `Pipeline`."""
        yield fused_block(next(iter(frames.values())).time, self._optimal(frames, degc), self._axes)

    def notes(self) -> FusionNotes:
        """Return the slow errors of every axis at the last frame."""
        return FusionNotes(self._optimal.learned())


class FramePipeline(Pipeline[FrameBlock]):
    """A `Pipeline` that returns its frames unchanged."""

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FrameBlock]:
        """See `Pipeline`."""
        yield frames, degc


def smoothed(
    blocks: Callable[[], Iterator[FrameBlock]],
    axes: Mapping[str, Sequence[Axis]],
    model: ErrorModel,
    period_s: float,
    notes: Callable[[FusionNotes], None] = lambda notes: None,
) -> Iterator[FusedBlock]:
    """Yield all frames, each estimated with the information of all; `blocks` returns them from the beginning and is
    called twice. `notes` is called at the end with the estimated slow errors. FusionError.
    """
    optimal = Optimal(axes, model, period_s=period_s)
    for time, estimates in optimal.smoothed(blocks):
        yield fused_block(time, estimates, axes)
    notes(FusionNotes(optimal.learned()))
