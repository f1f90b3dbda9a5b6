"""How far a cause is believed: how often such ones turned out right where somebody knew.

A share among rivals says which effect the data prefer. It says too much: simulated effects have not quite the form of
real ones, and what is at work need not be in the library. So it is tempered, by rates measured on emulated cases whose
mechanisms have forms of their own (`imuarray.validation.calibration`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

_SURE = 1e-4
"""No share counts as nearer to 0 or 1."""


class Rates(NamedTuple):
    """Of being right: `least` of causes without a rival that together close nothing of their sensors' gap, `most` where
    they close all of it; between them it goes with the power `steep` of what is closed. Odds against rivals count with
    the power `rivals`.
    """

    least: float
    most: float
    steep: float
    rivals: float


RATES = Rates(0.02, 0.99, 1.6, 0.33)
"""The likeliest of 160 causes told in cases of two sealed runs that had been opened and of one of the development half,
105 of them right. Of those without a rival that closed 0.98 and more, 30 of 31 were right in the latest; of odds of ten
against a rival every third was wrong.
"""


def believed(share: float, all_closed: float | None, rates: Rates = RATES) -> float:
    """The probability of a cause with such a `share` among its rivals, by what is closed of its sensors' gap in all
    (None: nothing was to be closed).
    """
    closed = min(max(all_closed or 0.0, 0.0), 1.0)
    right = rates.least + (rates.most - rates.least) * math.pow(closed, rates.steep)
    return right * _tempered(share, rates.rivals)


def _tempered(share: float, power: float) -> float:
    """With odds raised to that power."""
    share = min(max(share, _SURE), 1 - _SURE)
    return 1 / (1 + math.exp(-power * math.log(share / (1 - share))))
