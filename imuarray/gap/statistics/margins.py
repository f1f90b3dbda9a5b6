"""Margins: the least differences of statistics that matter.

A difference matters if it changes a figure of use by 5 %. The figure for noise is the error of heading or velocity
after coasting for 60 s (`imuarray.gap.model.downstream`), E = sqrt(2) tau sigma_A(tau). White noise, which every
recording contains, has sigma_A(tau) = noise / sqrt(tau rows_per_s). A level adds in quadrature: it matters if its
integral over these 60 s is 0.32 E, sqrt(1.05^2 - 1), which raises the rms of the error by 5 %.

A change of the log of the noise changes the log of E by the same amount, a change of the log of a variance by half of
it. A correlation r between neighbours, or between three sensors that are averaged, raises the variance of means by the
factor 1 + 2 r, and their rms by 5 % at r = 0.05. The error due to white noise is proportional to the root of the
interval between rows, so the log of the interval has the margin of a log of a variance. Slopes over temperature are
multiplied by a warming of 10 degC, coefficients of dT/dt by that warming within the 60 s, and responses to force by
1 g, the change from a horizontal axis to a vertical one. Scores matter beyond 3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from imuarray.gap.statistics.summary import Grid
from imuarray.log.format import SensorHeader

COASTING_S = 60.0
"""Time of coasting, in s, over which errors are integrated."""

SHARE = 0.05
"""Relative change of a figure of use that matters."""

_QUADRATURE = math.sqrt((1 + SHARE) ** 2 - 1)
"""Contribution, as a share of an rms, that raises the rms by `SHARE` when added in quadrature."""

_GENEROUS_RATIO = 1.25
_SCORE = 3.0
_RUN_ROWS = 2.0
_WARMING_DEGC = 10.0
_THREE_SIGMA = 3.0
_ROWS_SHARE = 0.001
_CODES_SHARE = 0.05
_STIMULUS: Mapping[str, float] = MappingProxyType({"angular_rate": 90.0, "specific_force": 1.0})
"""Stimulus during one second, in the sensor's unit: a quarter turn (90 deg/s), or gravity (1 g)."""


class SensorConditions(NamedTuple):
    """Conditions of one sensor in one log: `noise` of single readings in its unit, rows per second, and length."""

    header: SensorHeader
    noise: float
    rows_per_s: float
    seconds: float

    @property
    def level(self) -> float:
        """Constant error, in the sensor's unit, that raises the rms of E by 5 %: 0.32 sqrt(2) sigma_A(60 s)."""
        return _QUADRATURE * math.sqrt(2) * self.noise / math.sqrt(COASTING_S * self.rows_per_s)


Margin = Callable[[SensorConditions], float]
"""Function that returns the margin of a statistic for given conditions, in the unit of the statistic."""


def fixed(value: float) -> Margin:
    """Return a margin that has the same value for every sensor."""
    return lambda _: value


def coefficient(per: float) -> Margin:
    """Return the margin of a coefficient whose product with `per` is a level."""
    return lambda conditions: conditions.level / per


def response(conditions: SensorConditions) -> float:
    """Return the error of a response to motion, or the delay in s, that raises the rms of E by 5 % when the box makes a
    quarter turn within a second (or is subject to 1 g for one second).
    """
    return conditions.level * COASTING_S / _STIMULUS.get(conditions.header.quantity, 1.0)


def unevenness(conditions: SensorConditions) -> float:
    """Return the change of the log of the variance of the segments' log variances if the noise of segments differs by
    5 %: this adds (2 ln 1.05)^2 to the 2 / (rows - 1) of Gaussian noise.
    """
    rows = conditions.seconds * conditions.rows_per_s
    in_segment = rows / Grid.of(round(rows)).segments
    return math.log1p((2 * math.log1p(SHARE)) ** 2 * max(in_segment - 1, 1.0) / 2)


def share(of_rows: float, usual: float = 0.0) -> float:
    """Return the change of the arcsine of a share that increases by `of_rows` from its `usual` value."""
    return math.asin(math.sqrt(usual + of_rows)) - math.asin(math.sqrt(usual))


LEVEL = coefficient(1.0)
SLOPE, CURVATURE, RATE = (coefficient(per) for per in (_WARMING_DEGC, _WARMING_DEGC**2, _WARMING_DEGC / COASTING_S))
"""Margins of the coefficients of the temperature, of its square, and of its rate of change."""

RMS, VARIANCE = fixed(math.log1p(SHARE)), fixed(2 * math.log1p(SHARE))
"""Margins of the log of a standard deviation, and of the log of a variance."""

VARIANCE_SLOPE = fixed(2 * math.log1p(SHARE) / _WARMING_DEGC)
GENEROUS = fixed(math.log(_GENEROUS_RATIO))
"""Margin, as a log of 1.25, of the density in one band of the spectrum and of other figures that hardly affect the
integral over 60 s.
"""

CORRELATION, SCORE = fixed(SHARE), fixed(_SCORE)
RUN = fixed(_RUN_ROWS)
"""Margin of the length of the longest run of equal rows, in rows."""

ROWS = fixed(share(_ROWS_SHARE))
"""Margin of a share of rows: one reading in a thousand that is late, missing, clipped or invalid."""

CODES, HALF_OF_CODES = fixed(share(_CODES_SHARE)), fixed(share(_CODES_SHARE / 2, usual=0.5))
"""Margins of shares of codes: one reading in twenty on a grid twice as coarse, which changes the code of half of them.
"""

TAILS = fixed(share(_ROWS_SHARE, usual=0.0027))
"""Margin of the share of steps beyond 3 sigma: one in a thousand more than the 0.27 % of Gaussian noise."""

SKEWNESS = fixed(math.asinh(SHARE * _THREE_SIGMA * 6 / (_THREE_SIGMA**2 - 1)))
KURTOSIS = fixed(math.log1p(SHARE * _THREE_SIGMA * 24 / (_THREE_SIGMA**3 - 3 * _THREE_SIGMA) / 3))
"""Skewness, and kurtosis over 3, that move the limit of 3 sigma, beyond which readings are rejected, by 5 % (Cornish
and Fisher 1937, first terms: (z^2 - 1) / 6 of the skewness, (z^3 - 3 z) / 24 of the excess)."""
