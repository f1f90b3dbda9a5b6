"""Power spectral density by Welch's method, block by block: memory does not grow with the log.

Segments of N rows overlap by half, lose their mean and are weighted with a Hann window w; the one-sided density of
segment j at frequency k / N * rate is |DFT(w x_j)_k|^2 * 2 / (rate * sum w^2) (no factor 2 at 0 and at half the rate),
and the estimate is the mean over all segments (Welch, IEEE Trans. Audio Electroacoust. 15, 1967). No segment extends
beyond the end of a run, so that a gap is never used as a normal interval.

The mean is removed after the transform: only the bins 0 and 1 of the periodic Hann window are not zero, N/2 and -N/4.
That also removes part of the power of bin 1 (a sixth of it, for white noise).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import fft

from imuarray.arrays import Floats
from imuarray.products import multiply_rows

Values = npt.NDArray[np.floating] | npt.NDArray[np.integer]
Precision = Literal["single", "double"]

SEGMENT = 4096
"""Rows of a segment: 0.1 Hz between bins at 400 Hz."""

NOISE_BANDWIDTH = 1.5
"""Equivalent noise bandwidth of the Hann window in bins (Harris, Proc. IEEE 66, 1978, table I)."""

OVERLAP_CORRELATION = 1 / 6
"""Correlation of the Hann window with itself at a shift of half its length (Harris, table I: 16.7 %)."""

_WEIGHTED = 3 / 8
"""Mean square of the Hann window."""

_ROWS_AT_ONCE = 1 << 18
"""Number of rows of all columns that are processed at once: with windowed segments and transforms 5 MB in single
precision."""


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of k columns at m frequencies, 0 to half the rate.

    `frequency_hz` (m,), `density` (m, k) in squared units of the series per Hz (nan without a segment) and `freedom`
    (m,), the equivalent degrees of freedom of each. `segments` is the number of averaged segments, `runs` the number of
    runs with at least one, `segment_rows` the length of a segment, `rows` the number of all rows, and `left_over` the
    number of rows in no segment: ends of runs and short runs.
    """

    frequency_hz: Floats
    density: Floats
    freedom: Floats
    rate_hz: float
    segment_rows: int
    segments: int
    runs: int
    rows: int
    left_over: int

    @property
    def resolution_hz(self) -> float:
        """Distance of neighbouring bins."""
        return self.rate_hz / self.segment_rows


class Welch:
    """Adds up periodograms of `columns` series sampled at `rate_hz`; `segment_rows` is even and at least 16.

    The rounding error of "single" precision is less than 1e-4 of a density, for densities down to 1e-7 of the mean over
    all bins; the relative statistical error, sqrt(2 / freedom), reaches this after 10^8 segments. "double" takes 1.5
    times as long. ValueError for another segment length, rate or number of columns.
    """

    def __init__(
        self, rate_hz: float, segment_rows: int = SEGMENT, columns: int = 1, precision: Precision = "single"
    ) -> None:
        if not 0 < rate_hz < np.inf:
            raise ValueError(f"rate_hz is {rate_hz}, a positive number is required")
        if segment_rows < 16 or segment_rows % 2 or columns < 1:
            raise ValueError(
                f"{segment_rows} rows, {columns} columns: an even number from 16 on, and at least 1, are required"
            )
        self._rate_hz, self._segment_rows = rate_hz, segment_rows
        kind = np.float32 if precision == "single" else np.float64
        self._window = _hann(segment_rows).astype(kind)
        hops = max(2, _ROWS_AT_ONCE // (columns * (segment_rows // 2)))
        self._line = np.empty((columns, hops * segment_rows // 2), kind)
        self._windowed = np.empty((columns, hops - 1, segment_rows), kind)
        self._squares = np.zeros((columns, segment_rows // 2 + 1))
        self._origin = np.zeros(columns)
        self._filled = self._segments = self._runs = self._rows = self._in_segments = 0
        self._run_segments = 0

    def update(self, values: Values) -> None:
        """Add the next rows of the run, (n,) or (n, k); ValueError if k differs or a value is not finite."""
        rows = values[:, np.newaxis] if values.ndim == 1 else values
        if rows.shape[1] != len(self._line):
            raise ValueError(f"values have {rows.shape[1]} columns, {len(self._line)} are required")
        start = 0
        while start < len(rows):
            part = rows[start : start + self._line.shape[1] - self._filled]
            self._append(part)
            start += len(part)
            if self._filled == self._line.shape[1]:
                self._transform()

    def end_run(self) -> None:
        """End a run at a gap."""
        self._transform()
        if self._run_segments:
            self._runs += 1
            self._in_segments += (self._run_segments + 1) * (self._segment_rows // 2)
        self._filled = self._run_segments = 0

    def result(self) -> Spectrum:
        """Return the spectrum of all rows so far; ends the run."""
        self.end_run()
        bins = len(self._squares[0])
        scale = _sides(bins) / (self._rate_hz * self._segment_rows * _WEIGHTED)
        with np.errstate(invalid="ignore"):
            density = (self._squares * scale / np.float64(self._segments)).T
        freedom = _sides(bins) * (degrees_of_freedom(self._segments, self._runs) / 2)
        frequency_hz = np.asarray(np.arange(bins) * (self._rate_hz / self._segment_rows), np.float64)
        left_over = self._rows - self._in_segments
        counts = (self._segment_rows, self._segments, self._runs, self._rows, left_over)
        return Spectrum(frequency_hz, density, freedom, self._rate_hz, *counts)

    def _append(self, part: Values) -> None:
        """Append rows less an origin near them, so that single precision is not lost to a large mean."""
        columns = np.ascontiguousarray(part.T)  # sums are faster along contiguous memory
        means = columns.mean(axis=1, dtype=np.float64)
        if not np.isfinite(means).all():
            raise ValueError("the series contains values that are not finite")
        if self._filled == 0:
            self._origin = means
        filled = slice(self._filled, self._filled + len(part))
        np.subtract(
            columns, self._origin[:, np.newaxis], out=self._line[:, filled], dtype=np.float64, casting="same_kind"
        )
        self._filled += len(part)
        self._rows += len(part)

    def _transform(self) -> None:
        """Add the complete segments of the buffer, and keep the rows of the next segment."""
        hop = self._segment_rows // 2
        segments = self._filled // hop - 1
        if segments < 1:
            return
        self._squares += self._periodograms(segments)
        remaining = slice(segments * hop, self._filled)
        self._filled -= segments * hop
        self._line[:, : self._filled] = self._line[:, remaining].copy()
        self._segments += segments
        self._run_segments += segments

    def _periodograms(self, segments: int) -> Floats:
        """Return the sums (k, m) over the segments of the squared magnitudes of their transforms."""
        hop, windowed = self._segment_rows // 2, self._windowed[:, :segments]
        halves = self._line[:, : (segments + 1) * hop].reshape(len(self._line), -1, hop)
        np.multiply(halves[:, :-1], self._window[:hop], out=windowed[:, :, :hop])
        np.multiply(halves[:, 1:], self._window[hop:], out=windowed[:, :, hop:])
        sums = halves.sum(axis=2)
        means = (sums[:, 1:] + sums[:, :-1]) / (2 * hop)
        transforms = fft.rfft(windowed, axis=2)
        transforms[:, :, 0] -= means * hop
        transforms[:, :, 1] += means * (hop / 2)
        parts = transforms.view(windowed.dtype)
        squares = np.einsum("kij,kij->kj", parts, parts)
        return np.asarray(squares.reshape(len(squares), -1, 2).sum(axis=2), np.float64)


_BLOCKS = 6
"""Length of the low-pass filter of `SlowWelch` in decimated rows."""

_TERMS = (0.35875, -0.48829, 0.14128, -0.01168)
"""Cosines of the filter, Blackman and Harris's window of four terms (Harris, table I): frequencies that fold to less
than a fifth of the decimated rate are attenuated by 90 dB or more."""


class SlowWelch:
    """`Welch` of series of `columns` columns that are low-pass filtered, and decimated by `factor`; densities are
    divided by the filter's response. They are valid up to a fifth of the decimated rate.
    """

    def __init__(self, rate_hz: float, factor: int, segment_rows: int, columns: int = 1) -> None:
        self._factor = factor
        turns = 2 * np.pi * (np.arange(_BLOCKS * factor) + 0.5) / (_BLOCKS * factor)
        window = np.array(_TERMS) @ np.cos(np.outer(np.arange(len(_TERMS)), turns))
        self._filter: Floats = window / window.sum()
        self._welch = Welch(rate_hz / factor, segment_rows, columns, "double")
        self._rest = np.zeros((0, columns))
        self._origin = np.zeros(columns)

    def update(self, values: Values) -> None:
        """Add the next rows (n, k) of the run."""
        if len(self._rest) == 0:
            self._origin = np.asarray(values[:1], np.float64)
        rows = np.concatenate([self._rest, values - self._origin])
        blocks = len(rows) // self._factor
        count = max(0, blocks - _BLOCKS + 1)
        if count:
            columns = np.ascontiguousarray(rows[: blocks * self._factor].T)  # products are faster along rows
            parts = multiply_rows(columns.reshape(-1, self._factor), self._filter.reshape(_BLOCKS, -1).T)
            means = parts.reshape(rows.shape[1], blocks, _BLOCKS)
            filtered = np.sum([means[:, at : at + count, at] for at in range(_BLOCKS)], axis=0).T
            self._welch.update(filtered + self._origin)
        self._rest = rows[count * self._factor :]

    def end_run(self) -> None:
        """End a run at a gap."""
        self._rest = self._rest[:0]
        self._welch.end_run()

    def result(self) -> Spectrum:
        """Return the spectrum of all rows so far; ends the run."""
        self.end_run()
        spectrum = self._welch.result()
        response = np.abs(np.fft.rfft(self._filter, self._factor * spectrum.segment_rows)[: len(spectrum.density)]) ** 2
        return replace(spectrum, density=spectrum.density / response[:, None])


@lru_cache(maxsize=16)
def _hann(rows: int) -> Floats:
    """Return the periodic Hann window; cached, because segments of the same length share it."""
    return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * np.arange(rows) / rows))


@lru_cache(maxsize=16)
def _sides(bins: int) -> Floats:
    """Return the factors of a one-sided density: 2, but 1 at 0 and half the rate, which have no negative frequency."""
    return np.array([1.0, *[2.0] * (bins - 2), 1.0])


def degrees_of_freedom(segments: int, runs: int) -> float:
    """Return the degrees of freedom of the mean of `segments` periodograms in `runs` runs, for noise: two each, reduced
    by the overlap.

    Periodograms of neighbouring segments correlate by 1/36, others don't: 2 K / (1 + 2 (K - R) / K / 36) (Welch 1967).
    0 without a segment.
    """
    if segments == 0:
        return 0.0
    return 2 * segments / (1 + 2 * OVERLAP_CORRELATION**2 * (segments - runs) / segments)


def segment_rows(run_rows: int) -> int:
    """Return a segment length for runs of `run_rows`: the power of two that leaves at least 16 segments; 64 to 4096."""
    return min(SEGMENT, max(64, 1 << max(run_rows * 2 // 17, 1).bit_length() - 1))


_SLOW_SHARE = 1 / 128
"""Decimation factor divided by the rows of a segment of the other spectrum. A segment of that length has 128 decimated
rows, so that its bins up to the 24th are below a fifth of the decimated rate.
"""

_SLOW_SEGMENTS = 5


def slow_welch(rate_hz: float, run_rows: int, columns: int) -> SlowWelch | None:
    """Return the estimator for low frequencies, with few periods in the normal segments for runs of `run_rows`. It uses
    at least five segments per run, of at most `SEGMENT` decimated rows. None if the runs are too short for longer
    segments than the normal ones.
    """
    factor = int(segment_rows(run_rows) * _SLOW_SHARE)
    if factor < 2:
        return None
    slow_rows = min(SEGMENT, 1 << (2 * run_rows // factor // (_SLOW_SEGMENTS + 1)).bit_length() - 1)
    return SlowWelch(rate_hz, factor, slow_rows, columns) if slow_rows * _SLOW_SHARE > 1 else None
