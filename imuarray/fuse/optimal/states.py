"""Slow errors of an array as the states of a Kalman filter, with the steps of the filter and of its smoother.

There is one state for each error whose standard deviation is not zero: bias, drift, slope and response of every axis,
common wander and slope of every design. Each state decays independently. A priori they are independent, except for
biases and responses that were calibrated together.

Measurements are whitened: ``values = rows @ states + errors`` of unit variance. The smoother is that of Bierman ("Fixed
interval smoothing with discrete measurements", International Journal of Control 18, 1973): it processes the innovations
backwards and inverts no covariance of states, so that states with zero variance are allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.fuse.frames import Axis
from imuarray.fuse.optimal.prior import AxisErrors, DesignErrors, ErrorModel


class Gaussian(NamedTuple):
    """Distribution of n states: mean (n,) and covariance (n, n)."""

    mean: Floats
    covariance: Floats


class Innovation(NamedTuple):
    """The result of one step of measurements: the `rows` (p, n), the inverse of the innovations' covariance (p, p) and
    that times the innovations, (p,).
    """

    rows: Floats
    inverse: Floats
    weighted: Floats


class Adjoint(NamedTuple):
    """The information of all later measurements on a predicted state: ``smoothed = predicted - covariance @ vector``,
    and its covariance less ``covariance @ matrix @ covariance``.
    """

    vector: Floats
    matrix: Floats


def predicted(prior: Gaussian, remaining: Floats, added: Floats) -> Gaussian:
    """Return the predicted states: the share `remaining` (n,) of each, and the variance `added` (n,)."""
    covariance = prior.covariance * (remaining[:, None] * remaining)
    covariance.ravel()[:: len(remaining) + 1] += added  # the diagonal
    return Gaussian(prior.mean * remaining, covariance)


def corrected(prior: Gaussian, rows: Floats, values: Floats) -> tuple[Gaussian, Innovation]:
    """Return the states after measurements `values` (p,) by `rows` (p, n), with errors of unit variance."""
    seen = rows @ prior.covariance
    innovations = seen @ rows.T
    innovations.ravel()[:: len(rows) + 1] += 1.0  # the diagonal
    root = np.linalg.cholesky(innovations)
    inverse_root = np.linalg.inv(root)
    gain = inverse_root @ seen
    innovation = inverse_root @ (values - rows @ prior.mean)
    posterior = Gaussian(prior.mean + gain.T @ innovation, prior.covariance - gain.T @ gain)
    return posterior, Innovation(rows, inverse_root.T @ inverse_root, inverse_root.T @ innovation)


def backwards(later: Adjoint, belief: Gaussian, step: Innovation) -> Adjoint:
    """Return the information of these and all later measurements on the state `belief`, as predicted before them.

    With ``kept = 1 - covariance rows' inverse rows`` the vector is ``kept' vector - rows' weighted`` and the matrix
    ``kept' matrix kept + rows' inverse rows``. There are few measurements compared with states, so products with `kept`
    are not formed.
    """
    weighed = step.inverse @ step.rows
    seen = belief.covariance @ step.rows.T
    across = later.matrix @ seen
    vector = later.vector - weighed.T @ (seen.T @ later.vector) - step.rows.T @ step.weighted
    half = weighed.T @ (seen.T @ across @ weighed / 2 - across.T) + step.rows.T @ weighed / 2
    return Adjoint(vector, later.matrix + (half + half.T))


class _Layer(NamedTuple):
    """The k-th entries of the rows of a sparse matrix: the `rows` with such an entry, their `columns`, and the entries
    (p, 1), None if all are 1.
    """

    rows: Indices | slice
    columns: Indices
    entries: Floats | None


class StateResponse:
    """The response of r rows to n states, as terms that go with (1, stimulus): `dense` (terms, r, n). A row responds to
    two or three states and a term of its response to one, so that products skip the zeros.
    """

    def __init__(self, dense: Floats) -> None:
        self.dense = dense
        self._flat = flat = dense.reshape(dense.shape[0] * dense.shape[1], dense.shape[2])
        self._layers: list[_Layer] = []
        rows, columns = np.nonzero(flat)
        place = np.arange(len(rows)) - np.searchsorted(rows, rows)
        for layer in range(int(place.max(initial=-1)) + 1):
            in_layer = place == layer
            entries = flat[rows[in_layer], columns[in_layer]]
            self._layers.append(
                _Layer(
                    slice(None) if in_layer.sum() == len(flat) else rows[in_layer],
                    columns[in_layer],
                    None if (entries == 1).all() else entries[:, None],
                )
            )

    def of(self, belief: Gaussian, adjoint: Adjoint | None = None) -> tuple[Floats, Floats]:
        """Return mean (terms, r) and covariance (terms, r, terms, r) of the effect of the states on the rows, with the
        information of later measurements if `adjoint` is given.
        """
        terms, rows, _ = self.dense.shape
        cross = np.zeros(self._flat.shape)  # covariance of the effect with the states
        for places, columns, entries in self._layers:
            part = belief.covariance.take(columns, axis=0)
            cross[places] += part if entries is None else entries * part
        covariance = np.zeros((len(cross), len(cross)))
        for places, columns, entries in self._layers:
            part = cross.take(columns, axis=1)
            covariance[:, places] += part if entries is None else entries.T * part
        mean = self._flat @ belief.mean
        if adjoint is not None:
            mean -= cross @ adjoint.vector
            covariance -= cross @ adjoint.matrix @ cross.T
        return mean.reshape(terms, rows), covariance.reshape(terms, rows, terms, rows)


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
    def terms(self) -> int:
        """1, or 4 if the states include responses: an axis's error is its terms times (1, stimulus)."""
        return 1 + len(self.response)

    def response_at(self, warmer_degc: Floats) -> StateResponse:
        """Return the response to the states of axes at temperatures (m,) above those of their biases."""
        key = warmer_degc.tobytes() if self.thermal.any() else b""
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
    result = [state for index in range(len(axes)) for state in _of_axis(axes, errors, model, index)]
    result += _of_designs(axes, model)
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


def _of_axis(axes: Sequence[Axis], errors: Sequence[AxisErrors], model: ErrorModel, index: int) -> list[_State]:
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


def _of_designs(axes: Sequence[Axis], model: ErrorModel) -> list[_State]:
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
    """Return the prior covariance: diagonal, except for biases and responses of one sensor that were calibrated
    together.
    """
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
