"""Probes of the dependence of readings on gravity, by faces: the odd part, which changes sign with gravity, and the
even part.

The means of the phases on faces are fitted with the sum over the sensor's axes k of odd_k f_k + even_k f_k^2, where f
is the specific force in g along the sensor's nominal axes. If an axis is exactly vertical on its two faces, odd_k is
half the difference of their means, and even_k half their sum. Since f_x^2 + f_y^2 + f_z^2 = 1, a constant is contained
in the even parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from imuarray.arrays import Floats
from imuarray.axes import UP_AXES, up_vector
from imuarray.gap.statistics.margins import LEVEL
from imuarray.gap.statistics.probes.level import mean
from imuarray.gap.statistics.probes.probe import NOTHING, LogProbe, Probes
from imuarray.gap.statistics.summary import Summary
from imuarray.units import INERTIAL

AXES = np.arange(3)

_FACES = frozenset(UP_AXES)

_ALONG = 0.7
"""Least magnitude of the component of a box axis along a sensor axis for which the change on the box axis's faces is
reported.
"""


def response(ahead: int, phases: Sequence[Summary]) -> Floats:
    """Return the response (3,) of each axis to 1 g along it (`ahead` 0), along the next axis (1: y for x, z for y, x
    for z), or along the axis after the next (2), in the sensor's unit per g.
    """
    return np.asarray(_parts(phases)[0][AXES, (AXES + ahead) % 3])


def square(phases: Sequence[Summary]) -> Floats:
    """Return the response (3,) of each axis to 1 g^2 along it, less the mean of its responses to 1 g^2 along the other
    axes, in the sensor's unit per g^2.
    """
    even = _parts(phases)[1]
    others = (even[AXES, (AXES + 1) % 3] + even[AXES, (AXES + 2) % 3]) / 2
    return np.asarray(even[AXES, AXES] - others)


def returned(phases: Sequence[Summary]) -> Floats:
    """Return the change (3,) of each axis's response to 1 g along it, from the first to the last time on its two faces,
    in the sensor's unit per g; nan unless each of the two faces was up at least twice. nan for a magnetometer, since
    the field of a table is not uniform.

    It is the smaller of the changes on the two faces, and 0 if these changes do not have opposite signs: a wandering
    bias changes one of them, or both by the same amount.
    """
    by_face: dict[str, list[Summary]] = {}
    for phase in phases:
        if phase.phase.up in _FACES and phase.rows:
            by_face.setdefault(phase.phase.up, []).append(phase)
    result = NOTHING.copy()
    for axis in "XYZ" if phases[0].header.quantity in INERTIAL else "":
        visits = [by_face.get(up, []) for up in (f"+{axis}", f"-{axis}")]
        if min(map(len, visits)) < 2:
            continue
        upper, lower = (mean(of_face[-1]) - mean(of_face[0]) for of_face in visits)
        along = np.array(phases[0].header.orientation).T @ np.array(up_vector(f"+{axis}"))
        change = np.sign(upper - lower) * np.maximum(np.abs(upper - lower) - np.abs(upper + lower), 0.0) / 2
        result = np.where(np.abs(along) > _ALONG, along * change, result)
    return result


def applied_g(phases: Sequence[Summary]) -> Floats:
    """Return (f, 3) the specific force in g along the sensor's nominal axes in each of f phases, nan where no face is
    noted.
    """
    return np.array([_applied(phase) for phase in phases])


def _applied(phase: Summary) -> Floats:
    up = phase.phase.up
    return np.array(phase.header.orientation).T @ np.array(up_vector(up)) if up in UP_AXES else NOTHING


def _parts(phases: Sequence[Summary]) -> tuple[Floats, Floats]:
    """Return the odd and even parts (3, 3) in the sensor's unit, one row per axis and one column per direction of
    force; nan unless there are phases on all six faces.
    """
    nothing = np.full((3, 3), np.nan)
    if not {phase.phase.up for phase in phases} >= _FACES:
        return nothing, nothing
    applied, means = applied_g(phases), np.array([mean(phase) for phase in phases])
    known = np.isfinite(applied).all(axis=1) & np.isfinite(means).all(axis=1)
    design = np.concatenate([applied, applied**2], axis=1)[known]
    coefficients, _, rank, _ = np.linalg.lstsq(design, means[known], rcond=None)
    return (coefficients.T[:, :3], coefficients.T[:, 3:]) if rank == design.shape[1] else (nothing, nothing)


_CROSS = ("misalignment", "axis_error", "g_sensitivity", "channel_swap")


def _probe(
    about: str, moved_by: tuple[str, ...], statistic: Callable[[Sequence[Summary]], Floats], unit: str = "{u}/g"
) -> LogProbe:
    return LogProbe("force", f"response to {about}", moved_by, LEVEL, statistic, unit=unit)


PROBES: Probes = {
    "force_own": _probe(
        "force along the axis", ("scale", "axis_error", "range_reset", "g_sensitivity"), partial(response, 0)
    ),
    "force_next": _probe("force along the next axis", _CROSS, partial(response, 1)),
    "force_after": _probe("force along the axis after the next", _CROSS, partial(response, 2)),
    "force_return": _probe(
        "force along the axis the last time on its two faces, less that of the first time",
        ("scale", "thermal_scale", "range_reset"),
        returned,
    ),
    "force_square": _probe("the square of force along the axis", ("nonlinearity",), square, "{u}/g^2"),
}
