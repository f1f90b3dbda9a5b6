"""`size_effect`: force that rotation explains, by where the sensor sits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.inference.effects.candidate import Candidate, Hypothesis
from imuarray.gap.inference.effects.in_motion import ROTATION, moments
from imuarray.gap.inference.effects.removal import with_removal
from imuarray.gap.inference.evidence import Evidence
from imuarray.simulate.effects.response import SizeEffect
from imuarray.units import SI_PER_UNIT

_BEYOND = 2.7
_LARGEST_MM = 5000.0
_TURNS = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(0, 2, 1)
"""(3, 3, 3): matrix k makes e_k x r of r."""


def guesses(evidence: Evidence) -> Iterator[Hypothesis]:
    """Suggest the place, from least squares of what the other accelerometers' mean doesn't explain."""
    yield from with_removal(evidence, SizeEffect.name, _hypotheses(evidence))


def _hypotheses(evidence: Evidence) -> Iterator[Hypothesis]:
    if evidence.header.quantity != "specific_force":
        return
    if not evidence.is_odd("motion_coupling", "motion_residual", "motion_gain", "motion_next", "motion_after"):
        return
    table = moments(evidence)
    if table is None:
        return
    place = _place(evidence, *table.beyond_reference(ROTATION)[:2]) * 1e3
    if place.any() and np.linalg.norm(place) < _LARGEST_MM:
        x, y, z = place.tolist()
        yield Hypothesis((SizeEffect((x, y, z)),), ("position_mm",))


def _place(evidence: Evidence, rotation: Floats, shared: Floats) -> Floats:
    """Return (3,) metres in the box: force = sum of column k times B_k r, B_k (3, 3) along the sensor's axes."""
    turn = np.array(evidence.header.orientation).T / SI_PER_UNIT[evidence.header.unit]
    columns = turn @ rotation_columns()
    normal = np.einsum("kl,kij,lim->jm", rotation, columns, columns)
    return np.asarray(np.linalg.pinv(normal, rcond=1e-6) @ np.einsum("kij,ki->j", columns, shared))


def rotation_columns() -> Floats:
    """Return (9, 3, 3): rate x (rate x r) = (rate rate^T - rate^2) r by the products xx, xy, xz, yy, yz, zz, and
    angular acceleration x r.
    """
    products = []
    for first, second in zip(*np.triu_indices(3), strict=True):
        outer = np.zeros((3, 3))
        outer[first, second] = outer[second, first] = 1.0
        products.append(outer - np.eye(3) * (first == second))
    return np.concatenate([products, _TURNS])


SIZE_EFFECT = Candidate(
    SizeEffect.name,
    guesses,
    {"motion": "turn the box by hand at 200 dps and more about every axis, 1 minute"},
    quantity="specific_force",
)
