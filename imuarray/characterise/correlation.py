"""Autocorrelation of a series at its first lags, computed block by block, and a test for whiteness.

The series is divided into segments of N rows, and the mean of each segment is removed: a change over more than a
segment is drift and is not counted. The removal of the mean changes the correlation of white noise by -1 / N at every
lag, which is corrected. The remaining bias for coloured noise is about its power at frequency 0 over N.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.series import lagged_products

Values = npt.NDArray[np.floating] | npt.NDArray[np.integer]

LAGS = 32
SEGMENT = 8192
"""Rows of a segment, whose mean is removed: 20 s at 400 Hz. Sums of so few products do not start threads of OpenBLAS.
"""

_AT_ONCE = 1 << 15
"""Rows of whole segments that are processed together: for short segments the calls would take longer than the sums."""


@dataclass(frozen=True)
class Autocorrelation:
    """Autocorrelation of k columns at `lag` (l,) = 0, 1, ... rows; nan for a constant column or too few rows.

    `correlation` (l, k); `error` (l, k) the standard error if there is no correlation at this lag or beyond (Bartlett,
    J. Roy. Stat. Soc. Suppl. 8, 1946). `portmanteau` (k,) is the statistic of Ljung and Box (Biometrika 65, 1978) over
    all lags from 1, `p_value` (k,) the chance that white noise has a larger one. `rows` used, `left_over` in no
    segment, in `segments` segments.
    """

    lag: npt.NDArray[np.int64]
    correlation: Floats
    error: Floats
    portmanteau: Floats
    p_value: Floats
    rows: int
    left_over: int
    segments: int


class Autocovariance:
    """Adds up the products of each of `columns` series with itself, up to `lags` rows later. ValueError if a segment is
    not longer than that.
    """

    def __init__(self, lags: int = LAGS, columns: int = 1, segment_rows: int = SEGMENT) -> None:
        if lags < 1 or columns < 1 or segment_rows < 2 * (lags + 1):
            raise ValueError(
                f"{lags} lags in segments of {segment_rows} rows: segments of {2 * (lags + 1)} are required"
            )
        self._line = np.empty((columns, segment_rows))
        self._products = np.zeros((lags + 1, columns))
        self._pairs = np.zeros(lags + 1)
        self._lost = np.zeros(lags + 1)
        self._filled = self._rows = self._seen = self._segments = 0

    def update(self, values: Values) -> None:
        """Add the next rows of the run, (n,) or (n, k); ValueError for another number of columns."""
        rows = values[:, np.newaxis] if values.ndim == 1 else values
        if rows.shape[1] != len(self._line):
            raise ValueError(f"values have {rows.shape[1]} columns, {len(self._line)} are required")
        self._seen += len(rows)
        start, length = 0, self._line.shape[1]
        while start < len(rows):
            whole = min(len(rows) - start, max(length, _AT_ONCE)) // length
            if whole and not self._filled:
                lines = np.array(rows[start : start + whole * length].T, float, order="C")
                self._add(lines.reshape(len(lines), whole, length))
                start += whole * length
                continue
            part = rows[start : start + length - self._filled]
            self._line[:, self._filled : self._filled + len(part)] = part.T
            self._filled += len(part)
            start += len(part)
            if self._filled == length:
                self._add_line()

    def end_run(self) -> None:
        """End a run at a gap. The last segment counts if it is at least twice as long as the lags."""
        if self._filled >= 2 * len(self._pairs):
            self._add_line()
        self._filled = 0

    def result(self) -> Autocorrelation:
        """Return the autocorrelation of all rows so far; ends the run."""
        from scipy.special import chdtrc  # slow to import

        correlation = self.correlation()
        lag = np.arange(len(self._pairs))
        with np.errstate(invalid="ignore", divide="ignore"):
            squares = correlation[1:] ** 2
            before = np.concatenate([np.zeros((1, squares.shape[1])), np.cumsum(squares[:-1], axis=0)])
            error = np.sqrt((1 + 2 * before) / self._pairs[1:, np.newaxis])
            statistic = (1 + 2 / np.float64(self._rows)) * (self._pairs[1:] @ squares)
        error = np.concatenate([np.zeros((1, error.shape[1])), error])
        p_value = np.asarray(chdtrc(len(lag) - 1, statistic))
        counts = (self._rows, self._seen - self._rows, self._segments)
        return Autocorrelation(lag, correlation, error, statistic, p_value, *counts)

    def correlation(self) -> Floats:
        """Return (l, k) the correlation alone, without the statistics of `result`; ends the run."""
        self.end_run()
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = self._products[0] / (self._rows - self._segments)
            variance = np.where(variance > 0, variance, np.nan)
            products = self._products + self._lost[:, np.newaxis] * variance
            return np.asarray(products / self._pairs[:, np.newaxis] / variance)

    def _add_line(self) -> None:
        """Add the rows of the segment that is being filled."""
        self._add(self._line[:, np.newaxis, : self._filled].copy())
        self._filled = 0

    def _add(self, lines: Floats) -> None:
        """Add whole segments (k, s, n): the products of each column less its mean, segment by segment."""
        lines -= lines.mean(axis=2, keepdims=True)
        columns, segments, rows = lines.shape
        lags = len(self._pairs)
        products = np.empty((1 + segments, *self._products.shape))
        products[0] = self._products
        compiled = lagged_products(lines.reshape(-1, rows), lags)
        if compiled is not None:
            products[1:] = compiled.reshape(columns, segments, lags).transpose(1, 2, 0)
        else:
            for lag in range(lags):
                products[1:, lag] = np.einsum("ksn,ksn->sk", lines[:, :, : rows - lag], lines[:, :, lag:])
        self._products = products.sum(axis=0)
        pairs = rows - np.arange(lags)
        self._pairs += segments * pairs
        self._lost += segments * pairs / rows
        self._rows += segments * rows
        self._segments += segments
