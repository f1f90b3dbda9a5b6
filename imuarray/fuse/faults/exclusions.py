"""Which axes are left out, and when they may come back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.hypotheses import AXIS_GAIN, energy_limit
from imuarray.fuse.faults.kinds import Kind
from imuarray.fuse.faults.normal import Normal
from imuarray.fuse.faults.window import Look

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

AGREES_S = 3.0
"""For so long a sensor that was left out has to agree with the others before it is used again; twice as long after
each further time."""

_LONGEST_S = 600.0

AGREES = AXIS_GAIN / 3
"""Gain below which the mean of an axis agrees: well under what leaves it out (hysteresis)."""


@dataclass
class Exclusion:
    """Axes (indices) of one sensor (number) that are left out since `since_ns`, how long they have agreed again and how
    long they have to, in windows. `first` is what it looked like when it was found, `kind` what it is: `named` a window
    later. `drifted_si` for a walk-off.
    """

    sensor: int
    axes: tuple[int, ...]
    since_ns: int
    gain: float
    needs: int
    agreed: int = 0
    named: bool = False
    drifted_si: float = 0.0
    first: Kind | None = None
    kind: Kind | None = None

    def hears(self, agrees: Flags) -> bool:
        """Counts one more window in which its axes agreed, or not; whether they may come back."""
        self.agreed = self.agreed + 1 if agrees[list(self.axes)].all() else 0
        return self.named and self.agreed >= self.needs


def needs(offences: int, window_s: float) -> int:
    """Windows for which a sensor has to agree after it was left out for the `offences`-th time."""
    return max(1, round(min(AGREES_S * 2.0 ** (offences - 1), _LONGEST_S) / window_s))


def agreeing(seen: Look, normal: Normal, present: Flags) -> Flags:
    """(m,) the axes whose readings, included or not, are what the included ones and the normal model say."""
    mean = seen.means**2 < AGREES * seen.spread
    centred = np.where(seen.residual == 0, 0.0, seen.residual - seen.means)
    others = ((seen.rows @ seen.white.spread) * seen.rows).sum(axis=1)
    known = seen.regressors - seen.regressors.mean(axis=1, keepdims=True)
    lasting = normal.doubt_within(known)
    total = normal.variance + others + lasting
    energy = (centred**2).sum(axis=0) / total
    limit = energy_limit(len(seen.triad), normal.colour, lasting / total)
    return np.asarray(mean & (energy < limit / 2) & present)
