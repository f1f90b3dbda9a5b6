"""Quantities inferred from the values of columns: gravity has a constant length and turns in agreement with a
gyroscope, quaternions have length 1, labels are constant. The specific forces of a box that is turned slowly lie on a
sphere with a radius of 1 g and the biases as its centre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.units import STANDARD_GRAVITY

TriadIndices = tuple[int, int, int]
"""The indices of three columns."""

NamedTriad = tuple[str, TriadIndices]
"""A quantity ("" if unknown) and its columns."""

_GRAVITIES = (1.0, STANDARD_GRAVITY, 1000.0, *(2.0**power for power in range(8, 15)))
"""1 g in g, m/s2, mg, and in counts of the usual ranges."""
NEAR_GRAVITY = 0.15


def is_computed_gravity(columns: Sequence[Floats], indices: TriadIndices) -> bool:
    """Return whether a triad is gravity from a filter: its length is 1 or g to a thousandth while it turns."""
    lengths = _lengths(columns, indices)
    if not len(lengths) or not keeps_its_length(columns, indices):
        return False
    low, middle, high = np.quantile(lengths, (0.05, 0.5, 0.95))
    return bool(high - low < 2 * _UNIT_LENGTH * middle)


_MOST_LABELS = 64
_KNOWN_SHARE = 0.5
_UNIT_LENGTH = 2e-3
"""Largest relative scatter of the length of a quaternion, or of gravity from a filter; that of any sensor's readings is
larger.
"""

_FOLLOWS_GRAVITY = 0.35
"""Least correlation of the changes of gravity with those computed from a rate at which it is a gyroscope's."""

_SMOOTHED_ROWS = 5


def triads_by_values(columns: Sequence[Floats], free: Sequence[int]) -> Iterator[NamedTriad]:
    """Yield the triads that behave like gravity, and the triads next to them that behave like rates and fields."""
    candidates = [index for index in free if not is_label(columns[index])]
    forces: list[TriadIndices] = []
    runs: list[list[int]] = [[]]
    first = 0
    while first < len(candidates):
        if first + 4 <= len(candidates) and has_unit_length(columns, candidates[first : first + 4]):
            runs.append([])
            first += 4
        elif first + 3 <= len(candidates) and is_steady_gravity(columns, candidates[first : first + 3]):
            forces.append((candidates[first], candidates[first + 1], candidates[first + 2]))
            runs.append([])
            first += 3
        else:
            runs[-1].append(candidates[first])
            first += 1
    if not forces:
        return
    yield from (("specific_force", force) for force in forces)
    rest = [
        (run[first], run[first + 1], run[first + 2])
        for number, run in enumerate(runs)
        for first in range(0 if number else len(run) % 3, len(run) - 2, 3)
    ]
    rates = [triad for triad in rest if any(_turns_gravity(columns, triad, force) for force in forces)]
    if not rates:  # at rest, the first triad after a force is assumed to be a rate, and the second a field
        firsts = {run[0] for run in runs[1:] if len(run) >= 3}
        seconds = {run[3] for run in runs[1:] if len(run) >= 6}
        yield from (("angular_rate", triad) for triad in rest if triad[0] in firsts)
        yield from (("magnetic_field", triad) for triad in rest if triad[0] in seconds)
        return
    yield from (("angular_rate", triad) for triad in rates)
    fields = (triad for triad in rest if triad not in rates and keeps_its_length(columns, triad))
    yield from (("magnetic_field", triad) for triad in fields)


def is_label(values: Floats) -> bool:
    """Return whether a column is constant, mostly empty, or has few different whole numbers, like activity labels."""
    finite = values[np.isfinite(values)]
    if len(finite) < _KNOWN_SHARE * len(values):
        return True
    is_discrete = len(np.unique(finite)) <= _MOST_LABELS and bool((finite == np.rint(finite)).all())
    return float(np.ptp(finite)) == 0 or (is_discrete and float(np.mean(np.diff(finite) == 0)) > 1 - _KNOWN_SHARE)


def _lengths(columns: Sequence[Floats], indices: Sequence[int]) -> Floats:
    """Return the lengths (n,) of the rows without missing values."""
    values = np.stack([columns[index] for index in indices], axis=1)
    return np.asarray(np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1))


def has_unit_length(columns: Sequence[Floats], indices: Sequence[int]) -> bool:
    """Return whether vectors have length 1 to a thousandth, as quaternions have."""
    lengths = _lengths(columns, indices)
    return len(lengths) > 0 and bool(np.quantile(np.abs(lengths - 1), 0.95) < _UNIT_LENGTH)


def is_steady_gravity(columns: Sequence[Floats], indices: Sequence[int]) -> bool:
    """Return whether a triad has the length of gravity in most rows."""
    triad = (indices[0], indices[1], indices[2])
    if not is_gravity(columns, triad) or min(float(np.nanstd(columns[index])) for index in triad) == 0:
        return False
    low, middle, high = np.quantile(_lengths(columns, triad), (0.1, 0.5, 0.9))
    return bool(high - low < 0.6 * middle)


def _turns_gravity(columns: Sequence[Floats], rate: TriadIndices, force: TriadIndices) -> bool:
    """Return whether gravity turns in agreement with a rate, df/dt = -omega x f, for any unit of both."""
    w, f = (np.stack([columns[index] for index in triad], axis=1) for triad in (rate, force))
    finite = np.isfinite(w).all(axis=1) & np.isfinite(f).all(axis=1)
    kernel = np.ones(_SMOOTHED_ROWS) / _SMOOTHED_ROWS
    if finite.sum() < 10 * _SMOOTHED_ROWS:
        return False
    w, f = (np.stack([np.convolve(axis, kernel, "valid") for axis in values[finite].T], axis=1) for values in (w, f))
    change = (f[2 * _SMOOTHED_ROWS :] - f[: -2 * _SMOOTHED_ROWS]).ravel()
    middle = slice(_SMOOTHED_ROWS, -_SMOOTHED_ROWS)
    turned = -np.cross(w[middle], f[middle]).ravel()
    size = float(np.linalg.norm(change) * np.linalg.norm(turned))
    return size > 0 and float(change @ turned) / size > _FOLLOWS_GRAVITY


def keeps_its_length(columns: Sequence[Floats], triad: TriadIndices) -> bool:
    """Return whether a triad turns at constant length, like gravity in a sensor that is turned."""
    values = np.stack([columns[index] for index in triad], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return False
    length = np.linalg.norm(values, axis=1)
    low, middle, high = np.quantile(length, (0.1, 0.5, 0.9))
    turned = np.linalg.norm(np.quantile(values, 0.9, axis=0) - np.quantile(values, 0.1, axis=0))
    return bool(high - low < NEAR_GRAVITY * middle and turned > 0.5 * middle)


def is_gravity(columns: Sequence[Floats], triad: TriadIndices) -> bool:
    """Return whether the median length of a triad is 1 g in some unit."""
    lengths = np.sqrt(sum(columns[index] ** 2 for index in triad))
    if np.isnan(lengths).all():
        return False
    length = float(np.nanmedian(lengths))
    return any(abs(length / gravity - 1) < NEAR_GRAVITY for gravity in _GRAVITIES)


MOST_POINTS = 4000
FEWEST_POINTS = 40
SPANS_DIRECTIONS = 0.1
"""Least variance of the directions along any axis (a third if all directions are equally frequent)."""

ON_SPHERE = 0.03
"""Greatest deviation from the sphere (rms), as a share of its radius."""


class Sphere(NamedTuple):
    """Centre (3,) and radius in the unit of the forces."""

    centre: Floats
    radius: float


def fit_sphere(forces: Floats) -> Sphere | None:
    """Return the sphere of forces (n, 3) with any offsets; None if their directions do not determine one.

    |f|^2 = 2 f . c + r^2 - |c|^2 is linear in the centre c and in r^2 - |c|^2.
    """
    if len(forces) < FEWEST_POINTS:
        return None
    points = forces[:: max(1, len(forces) // MOST_POINTS)]
    scale = float(np.median(np.linalg.norm(points, axis=1))) or 1.0
    f = points / scale
    solution = np.linalg.lstsq(np.column_stack([2 * f, np.ones(len(f))]), (f**2).sum(axis=1), rcond=None)[0]
    squared = float(solution[3] + solution[:3] @ solution[:3])
    if squared <= 0:
        return None
    radius = squared**0.5
    rays = (f - solution[:3]) / radius
    deviation = float(np.sqrt(np.mean((np.linalg.norm(rays, axis=1) - 1) ** 2)))
    spans = float(np.linalg.eigvalsh(np.cov(rays.T))[0]) > SPANS_DIRECTIONS
    return Sphere(solution[:3] * scale, radius * scale) if spans and deviation < ON_SPHERE else None
