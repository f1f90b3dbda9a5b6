"""Relation of a sensor's readings in motion to what it should feel, with rotation and with force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imuarray.arrays import Floats, Indices
from imuarray.gap.inference.evidence import Evidence
from imuarray.gap.statistics.cross import CUBES, KINEMATIC, Cross

OWN, REFERENCE, ROTATION = slice(0, 3), slice(3, 6), slice(6, 6 + KINEMATIC)
FORCE = slice(6 + KINEMATIC, 9 + KINEMATIC)
CUBED = slice(9 + KINEMATIC, 9 + KINEMATIC + CUBES)
CHANGE = slice(CUBED.stop, CUBED.stop + 3)


@dataclass(frozen=True)
class Moments:
    """Mean products (24, 24) of window means in motion, about their segments' means: the sensor's readings (`OWN`),
    those of its reference along its nominal axes (`REFERENCE`; `Cross.reference`), products of angular
    rates and angular accelerations in the box (`ROTATION`, rad^2/s^2), the mean force in the sensor's nominal axes
    in g (`FORCE`), cubes of angular rates in the box (`CUBED`, rad^3/s^3), the reference's change per second
    (`CHANGE`); over `windows` windows.
    """

    products: Floats
    windows: int

    def beyond_reference(self, columns: slice | Indices) -> tuple[Floats, Floats, Floats]:
        """Return products that the reference doesn't explain: (c, c) of these columns, (c, 3) of them with the sensor's
        readings, and (3,) squares of the readings.
        """
        reference_products = self.products[REFERENCE, REFERENCE]
        solved = np.linalg.pinv(reference_products, rcond=1e-9, hermitian=True) @ self.products[REFERENCE]
        remaining = self.products - self.products[:, REFERENCE] @ solved
        return remaining[columns][:, columns], remaining[columns, OWN], np.diag(remaining[OWN, OWN])


def moments(evidence: Evidence) -> Moments | None:
    """Moments over all phases in motion; None without one, or without a reference."""
    total, windows = np.zeros((CHANGE.stop, CHANGE.stop)), 0
    for phase in evidence.phases:
        if phase.is_still or phase.cross is None or not phase.cross.windows or not takes_part(evidence, phase.cross):
            continue
        weights = _weights(phase.cross, evidence.header.name)
        if weights is None:
            return None
        total += phase.cross.windows * _products(phase.cross, weights)
        windows += phase.cross.windows
    return Moments(total / windows, windows) if windows else None


def _products(cross: Cross, weights: Floats) -> Floats:
    """Return the mean products (24, 24) of the columns `weights` (21, p) and of the reference's change per second,
    whatever the length of the windows; no window has a neighbour where the changes are nan.
    """
    products = np.zeros((CHANGE.stop, CHANGE.stop))
    products[: CHANGE.start, : CHANGE.start] = weights @ cross.fast @ weights.T
    if np.isfinite(cross.changes).all():
        products[: CHANGE.start, CHANGE] = weights @ cross.turning @ weights[REFERENCE].T / cross.window_s
        products[CHANGE, : CHANGE.start] = products[: CHANGE.start, CHANGE].T
        products[CHANGE, CHANGE] = weights[REFERENCE] @ cross.changes @ weights[REFERENCE].T / cross.window_s**2
    return products


def takes_part(evidence: Evidence, cross: Cross) -> bool:
    """Return whether the sensor is among those whose readings are compared: inertial ones, as long as they read."""
    return any(item.name == evidence.header.name for item in cross.sensors)


def _weights(cross: Cross, sensor: str) -> Floats | None:
    """Return (21, p) what each column is made of."""
    reference = cross.reference(sensor)
    if reference is None:
        return None
    weights = np.zeros((CUBED.stop, cross.fast.shape[0]))
    weights[OWN, cross.columns(sensor)] = np.eye(3)
    turn = np.array(cross.header(sensor).orientation).T
    weights[REFERENCE] = reference
    weights[ROTATION, cross.kinematic] = np.eye(KINEMATIC)
    feel = tuple(item.name for item in cross.sensors if item.quantity == "specific_force")
    weights[FORCE] = turn @ cross.mean_box(feel)
    weights[CUBED, cross.cubes] = np.eye(CUBES)
    return weights
