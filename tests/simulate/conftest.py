"""The inputs of effects: a place of one sensor, a motion in closed form, rows made to measure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.chips import CHIPS
from imuarray.log.format import Phase, SensorHeader
from imuarray.simulate.signal import Analog, BoxStimulus, Codes, Instants, Motion, Place
from imuarray.simulate.streams import Streams

Floats = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.int64]
OfTime = Callable[[Floats], Any]
"""Seconds (n,) to a number, a triple, (n,) or (n, 3)."""

G = 9.80665


@dataclass(frozen=True)
class Constant:
    """Every column is constant, unless it is given as a function of the seconds."""

    force_box: Sequence[float] | OfTime = (0.0, 0.0, G)
    rate_box: Sequence[float] | OfTime = (0.0, 0.0, 0.0)
    angular_acceleration_box: Sequence[float] | OfTime = (0.0, 0.0, 0.0)
    field_box: Sequence[float] | OfTime = (0.2, 0.0, -0.4)
    temperature_degc: float | OfTime = 25.0
    pressure_pa: float | OfTime = 101325.0
    seconds: float = 3600.0
    phases: tuple[Phase, ...] = field(default=())

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        seconds = time_ns * 1e-9

        def column(value: Any, *width: int) -> Floats:
            result = value(seconds) if callable(value) else value
            return np.broadcast_to(np.asarray(result, float), (len(seconds), *width))

        return BoxStimulus(
            time_ns,
            column(self.force_box, 3),
            column(self.rate_box, 3),
            column(self.angular_acceleration_box, 3),
            column(self.field_box, 3),
            column(self.temperature_degc),
            column(self.pressure_pa),
        )


def header(chip: str = "bma180", name: str = "S1", range_: float | None = None, **changes: Any) -> SensorHeader:
    """A sensor as its chip's defaults have it, at its largest range unless `range_` is given."""
    spec = CHIPS[chip]
    measured = max(spec.sensitivity, default=0.0) if range_ is None else range_
    made = SensorHeader(
        name,
        chip,
        spec.quantity,
        spec.unit,
        measured,
        spec.sensitivity.get(measured, 0.0),
        rate_hz=spec.rate_hz(None),
        bandwidth_hz=spec.default_bandwidth_hz,
        has_temperature=spec.has_thermometer,
    )
    return replace(made, **changes)


def _no_neighbour(name: str, first: int, stop: int) -> Codes:
    raise KeyError(name)


def _nothing_reaches(effect: str, row: int) -> Codes:
    raise AssertionError(f"{effect} asked for row {row}")


class MakePlace(Protocol):
    def __call__(
        self,
        sensor: SensorHeader | None = None,
        *,
        rows_per_s: float = 100.0,
        motion: Motion | None = None,
        seed: int = 1,
        boot: int = 0,
        neighbour: Callable[[str, int, int], Codes] = ...,
        reaching: Callable[[str, int], Codes] = ...,
        stamps: Callable[[int, int], Integers] | None = None,
        dtype: npt.DTypeLike = np.float64,
    ) -> Place: ...


@pytest.fixture
def place() -> MakePlace:
    """Makes a `Place`; a BMA180 at 16 g called S1, at rest with +Z up, by default."""

    def make(
        sensor: SensorHeader | None = None,
        *,
        rows_per_s: float = 100.0,
        motion: Motion | None = None,
        seed: int = 1,
        boot: int = 0,
        neighbour: Callable[[str, int, int], Codes] = _no_neighbour,
        reaching: Callable[[str, int], Codes] = _nothing_reaches,
        stamps: Callable[[int, int], Integers] | None = None,
        dtype: npt.DTypeLike = np.float64,
    ) -> Place:
        streams = Streams(seed, boot)
        return Place(
            sensor or header(),
            rows_per_s,
            motion or Constant(),
            streams,
            neighbour,
            reaching,
            stamps or (lambda first, stop: times(first, stop, rows_per_s)),
            np.dtype(dtype),
        )

    return make


def times(first: int, stop: int, rows_per_s: float = 100.0) -> Integers:
    """(stop - first,) ns: rows on an even grid, row 0 at the epoch."""
    return np.round(np.arange(first, stop) * (1e9 / rows_per_s)).astype(np.int64)


@pytest.fixture
def instants() -> Callable[..., Instants]:
    """Makes `Instants` of rows [first, stop): stamps and instants on the even grid, every row kept."""

    def make(first: int, stop: int, *, rows_per_s: float = 100.0, **changes: Any) -> Instants:
        grid = times(first, stop, rows_per_s)
        return replace(Instants(first, grid, grid, np.ones(stop - first, bool), 2400.0), **changes)

    return make


@pytest.fixture
def analog() -> Callable[..., Analog]:
    """Makes `Analog` rows [first, stop): value `value` (broadcast to (n, 3)), no noise, 1 g along z, 25 degC, a 14-bit
    converter of 512 counts per unit at 2400 Hz; keywords replace whole fields.
    """

    def make(
        first: int,
        stop: int,
        *,
        value: Any = 0.0,
        noise: Any = 0.0,
        rows_per_s: float = 100.0,
        dtype: npt.DTypeLike = np.float64,
        **changes: Any,
    ) -> Analog:
        rows = stop - first

        def filled(values: Any, *shape: int) -> Floats:
            return np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype), (rows, *shape)))

        made = Analog(
            first,
            times(first, stop, rows_per_s),
            filled(value, 3),
            filled(noise, 3),
            filled((0.0, 0.0, 1.0), 3),
            filled(25.0),
            512.0,
            -8192,
            8191,
            1,
            filled(25.0),
            2400.0,
        )
        return replace(made, **changes)

    return make


@pytest.fixture
def codes() -> Callable[..., Codes]:
    """Makes `Codes` of rows [first, stop): counts k, k + 1, k + 2 in row k unless given, all fresh, no thermometer."""

    def make(first: int, stop: int, counts: Any = None, *, rows_per_s: float = 100.0, **changes: Any) -> Codes:
        rows = np.arange(first, stop)[:, None] + np.arange(3) if counts is None else counts
        filled = np.array(np.broadcast_to(np.asarray(rows, np.int32), (stop - first, 3)))
        made = Codes(first, times(first, stop, rows_per_s), filled, None, np.ones(stop - first, bool))
        return replace(made, **changes)

    return make


@pytest.fixture
def sensor() -> Callable[..., SensorHeader]:
    """Makes a `SensorHeader`: `sensor(chip, name, range_, **changes)`, at its chip's defaults."""
    return header


@pytest.fixture
def constant() -> type[Constant]:
    """A constant motion; each column a constant or a function of the seconds (n,)."""
    return Constant


def furthest(samples: Floats, covariance: Floats) -> float:
    """How many standard errors the mean or covariance of normal `samples` (n, d) is from zero and `covariance`, at the
    worst of its d + d (d + 1) / 2 numbers; each is beyond 5 by chance once in two million.
    """
    free = np.linalg.solve(np.linalg.cholesky(covariance), samples.T)
    count = samples.shape[0]
    off = free @ free.T / count - np.eye(len(free))
    errors = np.where(np.eye(len(free), dtype=bool), np.sqrt(2 / count), np.sqrt(1 / count))
    return float(max(np.abs(off / errors).max(), np.abs(free.mean(axis=1)).max() * np.sqrt(count)))
