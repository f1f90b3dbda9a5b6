"""`misalignment`: the axes of the sensor are misaligned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Reals
from imuarray.simulate.effect import Effect, require
from imuarray.simulate.parameters import numbers, several
from imuarray.simulate.signal import Analog, Place


@dataclass(frozen=True)
class Misalignment(Effect):
    """y = D x, row i of D the unit vector along e_i + sum over j of tan(angle_ij) e_j.

    `angles_deg` in degrees, in the order xy, xz, yx, yz, zx, zy: by how much axis i leans towards axis j. Angles of
    opposite sign for ij and ji turn the triad as a whole (alignment to the package: BMA-119, ADX-66; of the boards:
    less than 5 degrees, the paper's section 5.2.1), equal ones make it oblique (cross-axis sensitivity: BMA-118,
    ADX-66). In data: on each face a share sin(angle) of gravity in the axes that should read none.
    """

    name: ClassVar[str] = "misalignment"
    angles_deg: tuple[float, ...] = several(6)

    def __post_init__(self) -> None:
        """Raise ValueError unless there are six angles below 90 degrees."""
        super().__post_init__()
        object.__setattr__(self, "angles_deg", numbers("angles_deg", self.angles_deg, 6))
        for angle in self.angles_deg:
            require("angles_deg", angle, -80.0, 80.0)

    @property
    def directions(self) -> Reals:
        """Return (3, 3): row i is the unit vector along axis i in the sensor's nominal axes."""
        leaning = np.eye(3)
        leaning[~np.eye(3, dtype=bool)] = np.tan(np.radians(self.angles_deg))
        return np.asarray(leaning / np.linalg.norm(leaning, axis=1, keepdims=True))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Take the components along the misaligned axes."""
        if not any(self.angles_deg):
            return analog
        return replace(analog, value=np.asarray(analog.value @ self.directions.T.astype(analog.value.dtype)))
