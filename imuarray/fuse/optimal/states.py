"""Slow errors of an array as the states of a Kalman filter, with the steps of the filter and of its smoother.

There is one state for each error whose standard deviation is not zero: bias, drift, slope and response of every axis,
common wander and slope of every design. Each state decays independently. They are independent beforehand, except for
biases that were calibrated together.

Measurements are whitened: ``values = rows @ states + errors`` of unit variance. The smoother is that of Bierman ("Fixed
interval smoothing with discrete measurements", International Journal of Control 18, 1973): it goes back over the
innovations and inverts no covariance of states, so that states known without doubt do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.fuse.frames import Axis
from imuarray.fuse.optimal.error_model import AxisErrors, DesignErrors, ErrorModel


class Gaussian(NamedTuple):
    """The belief about n states: mean (n,) and covariance (n, n)."""

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


def predicted(before: Gaussian, remaining: Floats, added: Floats) -> Gaussian:
    """The states a while later: the share `remaining` (n,) of each, and the variance `added` (n,)."""
    covariance = before.covariance * (remaining[:, None] * remaining)
    covariance.ravel()[:: len(remaining) + 1] += added  # the diagonal
    return Gaussian(before.mean * remaining, covariance)


def corrected(before: Gaussian, rows: Floats, values: Floats) -> tuple[Gaussian, Innovation]:
    """The states after measurements `values` (p,) by `rows` (p, n), with errors of unit variance."""
    seen = rows @ before.covariance
    innovations = seen @ rows.T
    innovations.ravel()[:: len(rows) + 1] += 1.0  # the diagonal
    root = np.linalg.cholesky(innovations)
    inverse_root = np.linalg.inv(root)
    gain = inverse_root @ seen
    innovation = inverse_root @ (values - rows @ before.mean)
    after = Gaussian(before.mean + gain.T @ innovation, before.covariance - gain.T @ gain)
    return after, Innovation(rows, inverse_root.T @ inverse_root, inverse_root.T @ innovation)


def backwards(later: Adjoint, at: Gaussian, step: Innovation) -> Adjoint:
    """Return what these and all later measurements say of the state `at`, as predicted before them.

    With ``kept = 1 - covariance rows' inverse rows`` the vector is ``kept' vector - rows' weighted`` and the matrix
    ``kept' matrix kept + rows' inverse rows``. Measurements are few beside states, so products with `kept` are not
    formed.
    """
    weighed = step.inverse @ step.rows
    seen = at.covariance @ step.rows.T
    across = later.matrix @ seen
    vector = later.vector - weighed.T @ (seen.T @ later.vector) - step.rows.T @ step.weighted
    half = weighed.T @ (seen.T @ across @ weighed / 2 - across.T) + step.rows.T @ weighed / 2
    return Adjoint(vector, later.matrix + (half + half.T))


class _Layer(NamedTuple):
    """The k-th entries of a sparse matrix: the `rows` that have one, the `columns` of these entries and the entries
    (p, 1), None where all are one.
    """

    rows: Indices | slice
    columns: Indices
    entries: Floats | None


class FeltStates:
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
            which = place == layer
            entries = flat[rows[which], columns[which]]
            self._layers.append(
                _Layer(
                    slice(None) if which.sum() == len(flat) else rows[which],
                    columns[which],
                    None if (entries == 1).all() else entries[:, None],
                )
            )

    def of(self, belief: Gaussian, adjoint: Adjoint | None = None) -> tuple[Floats, Floats]:
        """(terms, r) and (terms, r, terms, r) mean and covariance of what the rows feel under a belief, with what came
        after it if `adjoint` is given.
        """
        terms, rows, _ = self.dense.shape
        felt = np.zeros(self._flat.shape)
        for places, columns, entries in self._layers:
            part = belief.covariance.take(columns, axis=0)
            felt[places] += part if entries is None else entries * part
        covariance = np.zeros((len(felt), len(felt)))
        for places, columns, entries in self._layers:
            part = felt.take(columns, axis=1)
            covariance[:, places] += part if entries is None else entries.T * part
        mean = self._flat @ belief.mean
        if adjoint is not None:
            mean -= felt @ adjoint.vector
            covariance -= felt @ adjoint.matrix @ felt.T
        return mean.reshape(terms, rows), covariance.reshape(terms, rows, terms, rows)


_KEPT = 16
"""Temperatures of which it is remembered what the axes feel."""


@dataclass(frozen=True)
class ErrorStates:
    """n states of m axes: `prior` (n, n), the covariance they begin with, `time_constants_s` (n,), infinite where
    constant, and what each axis feels of them: `steady` (m, n), `thermal` (m, n) for each degree, `response` (3, m, n)
    for each unit of the stimulus along a box axis ((0, m, n) without such states).
    """

    names: tuple[str, ...]
    prior: Floats
    time_constants_s: Floats
    steady: Floats
    thermal: Floats
    response: Floats
    _felt: dict[bytes, FeltStates] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def terms(self) -> int:
        """1, or 4 where the states include responses: an axis's error is (1, stimulus) times what it feels."""
        return 1 + len(self.response)

    def felt(self, warmer_degc: Floats) -> FeltStates:
        """The response to the states of axes that are warmer than their biases by (m,)."""
        key = warmer_degc.tobytes() if self.thermal.any() else b""
        if key not in self._felt:
            if len(self._felt) >= _KEPT:
                self._felt.clear()
            steady = self.steady + warmer_degc[:, None] * self.thermal
            self._felt[key] = FeltStates(np.concatenate([steady[None], self.response]))
        return self._felt[key]

    def transition(self, seconds: float) -> tuple[Floats, Floats]:
        """(n,) share of each state that remains after a while, and (n,) the variance that is added."""
        remaining = np.exp(-seconds / self.time_constants_s)
        return remaining, self.prior.diagonal() * (1 - remaining**2)


class _State(NamedTuple):
    """One state: `members` are the axes that feel it."""

    name: str
    spread: float
    time_constant_s: float
    members: Sequence[int]
    kind: str = "steady"


def states_of(axes: Sequence[Axis], model: ErrorModel, others: int = 0) -> ErrorStates:
    """The states of `axes`; `others` more rows follow them, which feel none."""
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
    off = [error.response] * 3
    if together is not None:
        off = np.sqrt(np.diag(together)[3 * axis.index : 3 * axis.index + 3]).tolist()
    bias = np.sqrt(error.bias**2 + (0.0 if calibrated is None else calibrated[axis.index, axis.index]))
    states = [
        _State(f"{axis.label} bias", float(bias), np.inf, [index]),
        _State(f"{axis.label} drift", error.drift, error.drift_time_constant_s, [index]),
        _State(f"{axis.label} slope", error.slope_per_degc, np.inf, [index], "thermal"),
        *(
            _State(f"{axis.label} response {box}", spread, np.inf, [index], box)
            for box, spread in zip("XYZ", off, strict=True)
        ),
    ]
    return [state for state in states if state.spread > 0]


def _of_designs(axes: Sequence[Axis], model: ErrorModel) -> list[_State]:
    members: dict[tuple[str, int], list[int]] = {}
    for index, axis in enumerate(axes):
        members.setdefault((axis.chip, axis.index), []).append(index)
    of_axes = model.of(axes)
    states = []
    for (chip, index), its in members.items():
        errors = model.designs.get((chip, index), DesignErrors())
        label = f"{chip} {'xyz'[index]}"
        wander = [axis for axis in its if of_axes[axis].shares_wander]
        slope = [axis for axis in its if of_axes[axis].shares_slope]
        states.append(_State(f"{label} common", errors.common, errors.common_time_constant_s, wander))
        states.append(_State(f"{label} common slope", errors.slope_per_degc, np.inf, slope, "thermal"))
    return [state for state in states if state.spread > 0 and state.members]


def _prior(states: Sequence[_State], axes: Sequence[Axis], model: ErrorModel) -> Floats:
    """Diagonal, but for biases and responses of one sensor that were calibrated together."""
    prior = np.diag(np.array([state.spread**2 for state in states]))
    place = {state.members[0]: row for row, state in enumerate(states) if state.name.endswith(" bias")}
    for item, row in place.items():
        for other, column in place.items():
            covariance = model.bias_covariances.get(axes[item].sensor)
            if item != other and covariance is not None and axes[item].sensor == axes[other].sensor:
                prior[row, column] = covariance[axes[item].index, axes[other].index]
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
