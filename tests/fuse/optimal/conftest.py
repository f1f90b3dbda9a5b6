"""Arrays whose errors are drawn here, by numpy alone, from an error model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.fuse.frames import Axis, Frames
from imuarray.fuse.optimal import AxisErrors, DesignErrors, ErrorModel

Floats = npt.NDArray[np.float64]
FORCE = "specific_force"
PERIOD_S = 0.01


def triad(name: str, axes: Floats, chip: str = "a", **known: object) -> list[Axis]:
    """Three axes along the rows of `axes`."""
    return [
        Axis(name, chip, index, tuple(map(float, row)), **{"range_si": 1e3, "noise_si": 0.1, **known})  # type: ignore[arg-type]
        for index, row in enumerate(axes)
    ]


def model_of(
    axes: Sequence[Axis], designs: Mapping[tuple[str, int], DesignErrors] | None = None, **known: float
) -> ErrorModel:
    """The same errors for every axis, with its stated noise."""
    errors = {(axis.sensor, axis.index): AxisErrors(noise=axis.noise_si or 0.0, **known) for axis in axes}  # type: ignore[arg-type]
    return ErrorModel(errors, designs or {})


def times(count: int, period_s: float = PERIOD_S) -> npt.NDArray[np.int64]:
    return np.round(np.arange(count) * period_s * 1e9).astype(np.int64)


def frames_of(values: Floats, valid: npt.NDArray[np.bool_] | None = None, **known: npt.NDArray[np.bool_]) -> Frames:
    return Frames(times(len(values)), values, np.ones(values.shape, bool) if valid is None else valid, **known)  # type: ignore[arg-type]


def blocks_of(
    frames: Mapping[str, Frames], size: int, degc: Mapping[str, Floats]
) -> Iterator[tuple[dict[str, Frames], dict[str, Floats]]]:
    """The same in blocks of `size` frames."""
    count = len(next(iter(frames.values())).time)
    for start in range(0, count, size):
        part = slice(start, start + size)
        yield (
            {quantity: its.part(part) for quantity, its in frames.items()},
            {sensor: column[part] for sensor, column in degc.items()},
        )


class Log(NamedTuple):
    """n frames of m axes as an error model makes them: `covariance` (n m, n m) of all errors, frame by frame."""

    axes: list[Axis]
    model: ErrorModel
    values: Floats
    truth: Floats
    degc: dict[str, Floats]
    covariance: Floats


def covariance_of(axes: Sequence[Axis], model: ErrorModel, count: int, warmer: Floats) -> Floats:
    """(n m, n m) covariance of all errors of a log except those of response, entry by entry by the definitions of the
    model; `warmer` (n, m).
    """
    errors = [model.axes[axis.sensor, axis.index] for axis in axes]
    frame, which = np.divmod(np.arange(count * len(axes)), len(axes))
    lag_s = np.abs(frame[:, None] - frame) * PERIOD_S
    degrees = warmer.ravel()[:, None] * warmer.ravel()

    def each(values: Sequence[float]) -> Floats:
        return np.array(values)[which]

    covariance = np.diag(each([error.noise for error in errors]) ** 2)
    own = which[:, None] == which
    wander = each([error.drift for error in errors]) ** 2 * np.exp(
        -lag_s / each([e.drift_time_constant_s for e in errors])
    )
    covariance += own * (
        each([e.bias for e in errors]) ** 2 + wander + degrees * each([e.slope_per_degc for e in errors]) ** 2
    )
    for (chip, index), design in model.designs.items():
        member = each([float((axis.chip, axis.index) == (chip, index)) for axis in axes])
        shared = design.common**2 * np.exp(-lag_s / design.common_time_constant_s)
        covariance += np.outer(member, member) * (shared + degrees * design.slope_per_degc**2)
    for sensor, bias in model.bias_covariances.items():
        index = each([axis.index if axis.sensor == sensor else -1 for axis in axes]).astype(int)
        both = (index[:, None] >= 0) & (index >= 0)
        covariance += np.where(both, np.asarray(bias)[index[:, None], index], 0.0)
    return np.asarray(covariance)


def drawn_logs(
    rng: np.random.Generator, axes: list[Axis], model: ErrorModel, count: int, warming_degc: float = 0.0
) -> Iterator[Log]:
    """Logs whose errors are draws of a normal with that covariance; the box moves at random, 5 m/s2 each frame."""
    ramp = np.linspace(0.0, warming_degc, count)
    degc = {axis.sensor: 20.0 + ramp * (1 + 0.1 * int(axis.sensor[-1])) for axis in axes}
    warmer = np.stack([degc[axis.sensor] - 20.0 for axis in axes], axis=1)
    covariance = covariance_of(axes, model, count, warmer)
    root = np.linalg.cholesky(covariance)
    while True:
        truth = rng.normal(0.0, 5.0, (count, 3))
        errors = root @ rng.normal(size=len(covariance))
        values = truth @ np.array([axis.direction_box for axis in axes]).T + errors.reshape(count, -1)
        yield Log(axes, model, values, truth, degc, covariance)


def dense(log: Log, keep: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
    """(3 n,) triads of all frames from the readings `keep` of the log, and their covariance (3 n, 3 n): one generalised
    least squares over the whole log, the triad of every frame unknown. Frames without readings are as good as
    unknown: a prior of 1e4 m/s2.
    """
    count = len(log.values)
    rows = np.kron(np.eye(count), np.array([axis.direction_box for axis in log.axes]))[keep]
    weighed = np.linalg.solve(log.covariance[np.ix_(keep, keep)], rows)
    covariance = np.linalg.inv(rows.T @ weighed + np.eye(3 * count) * 1e-8)
    return covariance @ weighed.T @ log.values.ravel()[keep], covariance


def random_axes(rng: np.random.Generator, count: int = 9) -> list[Axis]:
    """Axes of random directions, three for each sensor, two sensors of design "a", then one of "b", and so on."""
    rows = rng.normal(size=(count, 3))
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return [
        Axis(f"S{index // 3}", "abcd"[index // 6], index % 3, tuple(map(float, rows[index])), 1e3, 0.05 + 0.02 * index)  # type: ignore[arg-type]
        for index in range(count)
    ]


def rich_model(axes: Sequence[Axis], slowness: float = 1.0) -> ErrorModel:
    """Every kind of error at once except those of response, each axis with its own figures."""
    errors = {
        (axis.sensor, axis.index): AxisErrors(
            noise=axis.noise_si or 0.0,
            bias=0.1 * (index + 1),
            drift=0.05 + 0.01 * index,
            drift_time_constant_s=slowness * (0.3 + 0.1 * index),
            slope_per_degc=0.02,
            bias_degc=20.0,
        )
        for index, axis in enumerate(axes)
    }
    designs = {("a", index): DesignErrors(0.2, 0.5 * slowness, 0.03) for index in range(3)}
    together = {axes[0].sensor: np.array([[4.0, 1.0, -1.0], [1.0, 3.0, 0.5], [-1.0, 0.5, 2.0]]) * 1e-2}
    return ErrorModel(errors, designs, together)
