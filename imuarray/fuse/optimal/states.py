"""Slow errors of an array as the states of a Kalman filter, with the steps of the filter and of its smoother.

There is one state for each error whose standard deviation is not zero: bias, drift, slope and response of every axis,
common wander and slope of every design. Each state decays independently. A priori they are independent, except for
biases and responses that were calibrated together.

Measurements are whitened: ``values = rows @ states + errors`` of unit variance. The smoother is that of Bierman ("Fixed
interval smoothing with discrete measurements", International Journal of Control 18, 1973): it processes the innovations
backwards and inverts no covariance of states, so that states with zero variance are allowed. States that do not decay
have the same smoothed distribution throughout a log, that of the filter at its end, so that the smoother computes only
those of the states that drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Booleans, Floats
from imuarray.fuse.frames import Axis
from imuarray.fuse.optimal import compiled
from imuarray.fuse.optimal.prior import AxisErrors, DesignErrors, ErrorModel


class Gaussian(NamedTuple):
    """Distribution of n states: mean (n,) and covariance (n, n)."""

    mean: Floats
    covariance: Floats


class Innovation(NamedTuple):
    """The result of one step of p measurements: their rows `whitened` (p, n), the `gain` (p, n) and the innovations
    `values` (p,), all multiplied by the inverse of the lower triangular root of the innovations' covariance.
    """

    whitened: Floats
    gain: Floats
    values: Floats


class Adjoint(NamedTuple):
    """The information of all later measurements on a predicted state: ``smoothed = predicted - covariance @ vector``,
    and its covariance less ``covariance @ matrix @ covariance``.
    """

    vector: Floats
    matrix: Floats


def predict_states(prior: Gaussian, remaining: Floats, added: Floats) -> Gaussian:
    """Return the predicted states: the share `remaining` (n,) of each, and the variance `added` (n,)."""
    mean, covariance = np.empty(prior.mean.shape), np.empty(prior.covariance.shape)
    if not compiled.COMPILED or not compiled.predict((remaining, added, *prior, mean, covariance), len(mean)):
        covariance = prior.covariance * (remaining[:, None] * remaining)
        covariance.ravel()[:: len(remaining) + 1] += added  # the diagonal
        mean = prior.mean * remaining
    return Gaussian(mean, covariance)


def correct_states(prior: Gaussian, rows: Floats, values: Floats) -> tuple[Gaussian, Innovation]:
    """Return the states after measurements `values` (p,) by `rows` (p, n), with errors of unit variance."""
    posterior = Gaussian(np.empty(prior.mean.shape), np.empty(prior.covariance.shape))
    step = Innovation(np.empty(rows.shape), np.empty(rows.shape), np.empty(values.shape))
    inputs = (*prior, np.ascontiguousarray(rows), np.ascontiguousarray(values))
    if compiled.COMPILED and compiled.correct((*inputs, *posterior, *step), (rows.shape[1], len(rows))):
        return posterior, step
    covariances = rows @ prior.covariance
    innovations = covariances @ rows.T
    innovations.ravel()[:: len(rows) + 1] += 1.0  # the diagonal
    inverse_root = np.linalg.inv(np.linalg.cholesky(innovations))
    step = Innovation(inverse_root @ rows, inverse_root @ covariances, inverse_root @ (values - rows @ prior.mean))
    return update_states(prior, step), step


def update_states(prior: Gaussian, step: Innovation) -> Gaussian:
    """Return the states after the measurements of a known step."""
    gain = step.gain
    return Gaussian(prior.mean + gain.T @ step.values, prior.covariance - gain.T @ gain)


def step_back(later: Adjoint, step: Innovation) -> Adjoint:
    """Return the information of these and all later measurements on the state as predicted before them.

    With ``kept = 1 - gain' whitened`` the vector is ``kept' vector - whitened' values`` and the matrix ``kept' matrix
    kept + whitened' whitened``. There are few measurements compared with states, so products with `kept` are not
    formed.
    """
    before = Adjoint(np.empty(later.vector.shape), np.empty(later.matrix.shape))
    if compiled.COMPILED and compiled.turn_back((*later, *step, *before), (len(later.vector), len(step.values))):
        return before
    across = step.gain @ later.matrix
    vector = later.vector - step.whitened.T @ (step.gain @ later.vector + step.values)
    inner = across @ step.gain.T + np.eye(len(across))
    half = step.whitened.T @ (inner / 2 @ step.whitened - across)
    return Adjoint(vector, later.matrix + (half + half.T))


class Drift(NamedTuple):
    """The part of the smoothed effect on r rows that is due to drifting states: its mean `offset` (r,), and its part
    `errors` (r, terms, r) of the covariances of the first term with all of them.
    """

    offset: Floats
    errors: Floats


class StateResponse:
    """The response of r rows to n states, as terms that go with (1, stimulus): `dense` (terms, r, n). A row responds to
    two or three states and a term of its response to one, so that products skip the zeros.
    """

    def __init__(self, dense: Floats) -> None:
        self.dense = dense
        self._flat = dense.reshape(dense.shape[0] * dense.shape[1], dense.shape[2])
        rows, columns = np.nonzero(self._flat)
        starts = np.searchsorted(rows, np.arange(len(self._flat) + 1)).astype(np.int64)
        self.sparse = (starts, columns.astype(np.int64), self._flat[rows, columns])
        """The rows of all terms of `dense`: where the entries of each start, and column and value of every entry."""
        self._sizes = (dense.shape[2], dense.shape[0], dense.shape[1], len(columns))

    def of(self, belief: Gaussian) -> tuple[Floats, Floats]:
        """Return mean (terms, r) and covariance (terms, terms, r, r) of the effect of the states on the rows."""
        terms, rows, _ = self.dense.shape
        mean, covariance = np.empty((terms, rows)), np.empty((terms, terms, rows, rows))
        if not compiled.COMPILED or not compiled.effect((*belief, *self.sparse, mean, covariance), self._sizes):
            mean = (self._flat @ belief.mean).reshape(terms, rows)
            product = self._flat @ belief.covariance @ self._flat.T
            covariance = np.ascontiguousarray(product.reshape(terms, rows, terms, rows).transpose(0, 2, 1, 3))
        return mean, covariance

    def drift(self, belief: Gaussian, adjoint: Adjoint, drifting: Booleans) -> Drift:
        """Return the part of the smoothed effect that is due to the `drifting` states (n,), which act on the first term
        only. `adjoint` is the information of later measurements on the predicted `belief`.
        """
        terms, rows, _ = self.dense.shape
        drift = Drift(np.empty(rows), np.empty((rows, terms, rows)))
        inputs = (*belief, *adjoint, drifting, *self.sparse)
        if compiled.COMPILED and compiled.drifts((*inputs, *drift), self._sizes):
            return drift
        moving = np.where(drifting, self.dense[0], 0.0)
        cross = moving @ belief.covariance
        smoothed = cross - cross @ adjoint.matrix @ belief.covariance
        errors = (smoothed @ self._flat.T).reshape(rows, terms, rows)
        errors[:, 0] += (self.dense[0] - moving) @ smoothed.T
        return Drift(moving @ belief.mean - cross @ adjoint.vector, errors)


class StateStep(NamedTuple):
    """A step of the filter: the share `remaining` (n,) of each state after the time since the step before, and the
    variance `added` (n,), as `ErrorStates.transition` returns them; the `innovation`; and the response of the rows.
    """

    remaining: Floats
    added: Floats
    innovation: Innovation
    response: StateResponse


def smoothed_drifts(
    belief: Gaussian, steps: Sequence[StateStep], later: Adjoint, drifting: Booleans
) -> tuple[list[Drift], Adjoint]:
    """Return the part of the smoothed effect that is due to the `drifting` states (n,) at each of consecutive steps.

    `belief` is that before the steps, `later` the information of all measurements after them. Also return the
    information of these and all later measurements on the states before the steps.
    """
    response = steps[0].response
    if compiled.COMPILED and all(step.response is response for step in steps):
        smoothed = _smooth_alike(belief, steps, later, drifting)
        if smoothed is not None:
            return smoothed
    beliefs: list[Gaussian] = []
    for step in steps:
        beliefs.append(predict_states(belief, step.remaining, step.added))
        belief = update_states(beliefs[-1], step.innovation)
    drifts: list[Drift] = []
    for at, step in zip(beliefs[::-1], steps[::-1], strict=True):
        later = step_back(later, step.innovation)
        drifts.append(step.response.drift(at, later, drifting))
        later = Adjoint(*predict_states(Gaussian(*later), step.remaining, np.zeros(len(drifting))))
    return drifts[::-1], later


def _smooth_alike(
    belief: Gaussian, steps: Sequence[StateStep], later: Adjoint, drifting: Booleans
) -> tuple[list[Drift], Adjoint] | None:
    """Return the result for steps with the same response by compiled code; None if that is not possible."""
    response, count = steps[0].response, len(steps)
    terms, rows, _ = response.dense.shape
    measurements = np.array([len(step.innovation.values) for step in steps], np.int64)
    inputs = (
        *belief,
        np.array([step.remaining for step in steps]),
        np.array([step.added for step in steps]),
        measurements,
        *(np.concatenate(parts) for parts in zip(*(step.innovation for step in steps), strict=True)),
        drifting,
        *response.sparse,
    )
    before = Adjoint(later.vector.copy(), later.matrix.copy())
    offsets, errors = np.empty((count, rows)), np.empty((count, rows, terms, rows))
    sizes = (len(drifting), terms, rows, len(response.sparse[1]), count, int(measurements.sum()))
    if not compiled.smooth((*inputs, *before, offsets, errors), sizes):
        return None
    return [Drift(*parts) for parts in zip(offsets, errors, strict=True)], before


_KEPT = 16
"""Number of cached responses at different temperatures."""


@dataclass(frozen=True)
class ErrorStates:
    """n states of m axes: the prior covariance `prior` (n, n), `time_constants_s` (n,), infinite for constants, and the
    effect on each axis: `steady` (m, n), `thermal` (m, n) per degree, `response` (3, m, n) per unit of the stimulus
    along a box axis ((0, m, n) without such states).
    """

    names: tuple[str, ...]
    prior: Floats
    time_constants_s: Floats
    steady: Floats
    thermal: Floats
    response: Floats
    _responses: dict[bytes, StateResponse] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def drifting(self) -> Booleans:
        """Flags (n,) of the states that decay; responses don't."""
        return np.isfinite(self.time_constants_s)

    @property
    def terms(self) -> int:
        """1, or 4 if the states include responses: an axis's error is its terms times (1, stimulus)."""
        return 1 + len(self.response)

    @cached_property
    def follow_temperature(self) -> bool:
        """True if an effect depends on the temperature."""
        return bool(self.thermal.any())

    def response_at(self, warmer_degc: Floats) -> StateResponse:
        """Return the response to the states of axes at temperatures (m,) above those of their biases."""
        key = warmer_degc.tobytes() if self.follow_temperature else b""
        if key not in self._responses:
            if len(self._responses) >= _KEPT:
                self._responses.clear()
            steady = self.steady + warmer_degc[:, None] * self.thermal
            self._responses[key] = StateResponse(np.concatenate([steady[None], self.response]))
        return self._responses[key]

    def transition(self, seconds: float) -> tuple[Floats, Floats]:
        """Return the share (n,) of each state that remains after a time, and the variance (n,) that is added."""
        remaining = np.exp(-seconds / self.time_constants_s)
        return remaining, self.prior.diagonal() * (1 - remaining**2)


class _State(NamedTuple):
    """One state: `members` are the axes that it affects."""

    name: str
    spread: float
    time_constant_s: float
    members: Sequence[int]
    kind: str = "steady"


def states_of(axes: Sequence[Axis], model: ErrorModel, others: int = 0) -> ErrorStates:
    """Return the states of `axes`; `others` further rows follow them, on which they have no effect."""
    errors = model.of(axes)
    result = [state for index in range(len(axes)) for state in _axis_states(axes, errors, model, index)]
    result += _design_states(axes, model)
    rows = {kind: np.zeros((len(axes) + others, len(result))) for kind in ("steady", "thermal", "X", "Y", "Z")}
    for column, state in enumerate(result):
        rows[state.kind][list(state.members), column] = 1.0
    responses = [rows[kind] for kind in "XYZ"] if any(state.kind in "XYZ" for state in result) else []
    return ErrorStates(
        names=tuple(state.name for state in result),
        prior=_prior(result, axes, model),
        time_constants_s=np.array([state.time_constant_s for state in result]),
        steady=rows["steady"],
        thermal=rows["thermal"],
        response=np.array(responses).reshape(len(responses), len(axes) + others, len(result)),
    )


def _axis_states(axes: Sequence[Axis], errors: Sequence[AxisErrors], model: ErrorModel, index: int) -> list[_State]:
    axis, error = axes[index], errors[index]
    calibrated = model.bias_covariances.get(axis.sensor)
    together = model.response_covariances.get(axis.sensor)
    deviations = [error.response] * 3
    if together is not None:
        deviations = np.sqrt(np.diag(together)[3 * axis.index : 3 * axis.index + 3]).tolist()
    bias = np.sqrt(error.bias**2 + (0.0 if calibrated is None else calibrated[axis.index, axis.index]))
    states = [
        _State(f"{axis.label} bias", float(bias), np.inf, [index]),
        _State(f"{axis.label} drift", error.drift, error.drift_time_constant_s, [index]),
        _State(f"{axis.label} slope", error.slope_per_degc, np.inf, [index], "thermal"),
        *(
            _State(f"{axis.label} response {box}", deviation, np.inf, [index], box)
            for box, deviation in zip("XYZ", deviations, strict=True)
        ),
    ]
    return [state for state in states if state.spread > 0]


def _design_states(axes: Sequence[Axis], model: ErrorModel) -> list[_State]:
    members: dict[tuple[str, int], list[int]] = {}
    for index, axis in enumerate(axes):
        members.setdefault((axis.chip, axis.index), []).append(index)
    of_axes = model.of(axes)
    states = []
    for (chip, index), member_axes in members.items():
        errors = model.designs.get((chip, index), DesignErrors())
        label = f"{chip} {'xyz'[index]}"
        wander = [axis for axis in member_axes if of_axes[axis].shares_wander]
        slope = [axis for axis in member_axes if of_axes[axis].shares_slope]
        states.append(_State(f"{label} common", errors.common, errors.common_time_constant_s, wander))
        states.append(_State(f"{label} common slope", errors.slope_per_degc, np.inf, slope, "thermal"))
    return [state for state in states if state.spread > 0 and state.members]


def _prior(states: Sequence[_State], axes: Sequence[Axis], model: ErrorModel) -> Floats:
    """Return the prior covariance: diagonal, except for biases and responses of one sensor calibrated together."""
    prior = np.diag(np.array([state.spread**2 for state in states]))
    place = {state.members[0]: row for row, state in enumerate(states) if state.name.endswith(" bias")}
    for item, row in place.items():
        for name, column in place.items():
            covariance = model.bias_covariances.get(axes[item].sensor)
            if item != name and covariance is not None and axes[item].sensor == axes[name].sensor:
                prior[row, column] = covariance[axes[item].index, axes[name].index]
    turned = [
        (row, axes[state.members[0]], "XYZ".index(state.kind))
        for row, state in enumerate(states)
        if state.kind in "XYZ"
    ]
    for row, axis, box in turned:
        together = model.response_covariances.get(axis.sensor)
        for column, other_axis, other_box in turned if together is not None else ():
            if together is not None and axis.sensor == other_axis.sensor:
                prior[row, column] = together[3 * axis.index + box, 3 * other_axis.index + other_box]
    return prior
