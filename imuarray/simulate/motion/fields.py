"""A magnetic field that is known in the box frame, phase by phase, in the place of the earth's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imuarray.arrays import Integers, Reals


class PhaseField(NamedTuple):
    """A magnetic field `field_box` in gauss that holds from `start_ns` until the next one begins."""

    start_ns: int
    field_box: tuple[float, float, float]


def field_at(fields: Sequence[PhaseField], time_ns: Integers) -> Reals:
    """Return the field (n, 3) in gauss at times (n,), as one broadcast row (read-only) if it is constant. `fields` has
    at least one; before the first of them, the first holds.
    """
    starts_ns = np.array([field.start_ns for field in fields])
    number = np.clip(np.searchsorted(starts_ns, time_ns, side="right") - 1, 0, None)
    box = np.array([field.field_box for field in fields])
    if len(number) == 0 or (number == number[0]).all():
        return np.broadcast_to(box[number[0] if len(number) else 0], (len(number), 3))
    return np.asarray(box[number])
