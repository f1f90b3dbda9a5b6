"""Detection limits: the severity of each mechanism, in units of its reference size, at which the full plan just shows
that something is wrong; measured by `python -m imuarray.validation.detection --seed 1`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from imuarray.validation.generator import CHIPS

LIMITS: Mapping[str, Mapping[str, float]] = MappingProxyType({})
"""On an accelerometer ("BMA1"), on a gyroscope ("Gyro1"; taken to be the same where it is missing), or wherever it goes
("").
"""


def limit(mechanism: str, sensors: Sequence[str]) -> float:
    """Of a mechanism on these sensors (none: wherever it goes); 1.0 for one that is there or not."""
    found = LIMITS.get(mechanism, {})
    family = "" if not sensors else "Gyro1" if CHIPS[sensors[0]] == "l3g4200d" else "BMA1"
    return found.get(family, next(iter(found.values()), 1.0))
