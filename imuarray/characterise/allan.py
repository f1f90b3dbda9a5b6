"""Overlapping Allan deviation of a series sampled at a fixed interval, with confidence intervals; of a whole series,
of runs between gaps, and of a series that arrives in blocks, in memory that does not grow with it.

With the running sum x of a series y of n values, at averaging factor m and so tau = m * interval::

    adev(tau)^2 = 1 / (2 m^2 M) * sum over i of (x[i+2m] - 2 x[i+m] + x[i])^2,     M = n + 1 - 2m terms

(IEEE Std 952, annex C; Riley, NIST SP 1065, "Overlapping Allan variance"). The running sum of whole numbers is that of
their differences from the first one, in float64: it is exact while it is below 2^53, and so are its differences. All
other steps use float64 too, so that no conversion is needed for the sum of squares. In addition to the running sum (8
bytes per value, one column at a time) only small blocks are needed.

The decimated estimator starts its second differences not at every row but at every `stride_of(m)`-th, an eighth of the
averaging factor m. Neighbouring differences are so strongly correlated that this costs one or two hundredths of the
degrees of freedom (which `AllanCurve.freedom` counts), and is several times faster. The running sum is then needed at
multiples of the stride alone: a pyramid of increasingly coarse running sums, which keep their latest values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats, Integers
from imuarray.characterise.allan_curve import (
    CONFIDENCE,
    IDENTIFY,
    AllanCurve,
    ChangeMoments,
    DifferenceMoments,
    SeriesShape,
    make_curve,
    octaves,
    stride_of,
)
from imuarray.series import second_difference_sums

Values = npt.NDArray[Any]


class CountColumn(Protocol):
    """Whole numbers (n,) that are read on demand, such as a column of a log."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Their type."""
        ...

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> Values: ...


EXACT = 1 << 53
"""Whole numbers below this are exact in float64."""

_BLOCK = 32768
"""Number of second differences that are processed at once, for every distance in turn, so that they remain in the
cache."""

_DOT = 8192
"""Number of products that are summed at once: up to 10,000 OpenBLAS does not start threads."""


def running_sum(values: Values) -> Floats:
    """Return 0 and the running sum (n + 1,) of the distance of `values` (n,) from a reference; ValueError if not
    finite.

    The reference does not change second differences. For whole numbers with an exact sum in float64 it is a whole
    number; otherwise it is the mean, which keeps the sum small.
    """
    reference = values[0] if _fits(values) else values.mean(dtype=np.float64)
    phase = np.zeros(len(values) + 1)
    for start in range(0, len(values), _BLOCK):
        part = phase[start + 1 : start + 1 + _BLOCK]
        add_up(values[start : start + _BLOCK], reference, float(phase[start]), part)
    return phase


def compact_running_sum(values: CountColumn) -> Values:
    """Return the `running_sum` of counts of at most two bytes, block by block, as int32 where it stays below 2^31."""
    reference, phase, total = values[:1][0], np.zeros(len(values) + 1, np.int32), 0.0
    work = np.empty(min(_BLOCK, len(values)))
    for start in range(0, len(values), _BLOCK):
        part = work[: len(values) - start]
        add_up(values[start : start + _BLOCK], reference, total, part)
        if np.abs(part).max() > np.iinfo(np.int32).max:
            return running_sum(values[: len(values)])
        phase[start + 1 : start + 1 + len(part)] = part
        total = float(part[-1])
    return phase


def add_up(values: Values, reference: Any, total: float, out: Floats) -> None:
    """Write to `out` (b,) `total` plus the running sum of `values` (b,) less `reference`; ValueError if not finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        if values.dtype.itemsize == 8 and isinstance(reference, np.integer) and _near(values, reference):
            out[:] = (values - reference).view(np.int64)  # float64 would be rounded before the subtraction
        else:
            np.subtract(values, reference, out=out, dtype=np.float64)
        out[0] += total
        np.cumsum(out, out=out)
    if not np.isfinite(out[-1]):
        raise ValueError("the series contains values that are not finite")


def _near(values: Values, reference: np.integer[Any]) -> bool:
    """Return whether whole numbers minus the reference are exact in float64; the difference may overflow."""
    return max(int(values.max()) - int(reference), int(reference) - int(values.min())) < EXACT


def _fits(values: Values) -> bool:
    """Return whether the running sum of the differences from one of the values is certain to be exact."""
    if values.dtype.kind not in "biu":
        return False
    span = 1 << 8 * values.dtype.itemsize if values.dtype.itemsize <= 2 else int(values.max()) - int(values.min())
    return span * len(values) < EXACT


def sums_of_squares(phase: Values, distances: Sequence[int], first: int = 0) -> list[float]:
    """Return for each distance m the sum of (x[e] - 2 x[e-m] + x[e-2m])^2 over the ends e from `first` on, as far as x
    reaches; x is float64 or int32; the differences are float64 in both cases.
    """
    compiled = second_difference_sums(phase, distances, first)
    if compiled is not None:
        return compiled
    totals = [0.0] * len(distances)
    work = np.empty((2, min(2 * _BLOCK, len(phase))))
    for start in range(first, len(phase), _BLOCK):
        stop = min(start + _BLOCK, len(phase))
        for index, m in enumerate(distances):
            if stop > 2 * m:
                totals[index] += _square(_second_differences(phase, m, max(start, 2 * m), stop, work))
    return totals


def sums_of_squares_within(phase: Values, place: npt.NDArray[np.int32], distances: Sequence[int]) -> list[float]:
    """Return the same sums for a series with gaps: over ends e whose `place` (n + 1,) in their run is at least 2m."""
    totals = [0.0] * len(distances)
    work = np.empty((2, min(2 * _BLOCK, len(phase))))
    for start in range(0, len(phase), _BLOCK):
        stop = min(start + _BLOCK, len(phase))
        for index, m in enumerate(distances):
            begin = max(start, 2 * m)
            in_run = place[begin:stop] >= 2 * m
            if in_run.any():
                block = _second_differences(phase, m, begin, stop, work)
                block *= in_run
                totals[index] += _square(block)
    return totals


def _second_differences(phase: Values, m: int, start: int, stop: int, work: Floats) -> Floats:
    """Return the second differences that end from `start` to `stop`; at a short distance each first difference serves
    twice.
    """
    count = stop - start
    block, middle = work[0, :count], phase[start - m : stop - m]
    if 4 * m <= count:
        first = work[1, : count + m]
        np.subtract(phase[start - m : stop], phase[start - 2 * m : stop - m], out=first, dtype=np.float64)
        return np.subtract(first[m:], first[:count], out=block)
    np.subtract(phase[start:stop], middle, out=block, dtype=np.float64)
    np.subtract(block, middle, out=block)
    return np.add(block, phase[start - 2 * m : stop - 2 * m], out=block)


def _square(block: Floats) -> float:
    parts = (block[at : at + _DOT] for at in range(0, len(block), _DOT))
    return sum(float(np.dot(part, part)) for part in parts)


Estimator = Literal["overlapping", "decimated"]
""""overlapping": second differences start at every row; "decimated": at least eight times in an averaging time."""


def allan_deviation(
    values: npt.ArrayLike,
    interval_s: float,
    factors: Sequence[int] | None = None,
    confidence: float = CONFIDENCE,
    estimator: Estimator = "overlapping",
) -> AllanCurve:
    """Return the Allan deviation of `values` (n,) or (n, k), column by column, sampled every `interval_s` seconds.

    `factors` are averaging factors from 1 to n // 2; octaves if None. `confidence` is the share of intervals that
    contain the true deviation. `estimator`: "overlapping" uses every term, "decimated" one term in m / 8 or fewer rows.
    ValueError for any other argument: fewer than two values, values that are not real and finite, an interval that is
    not positive.
    """
    series = _check_series(values, interval_s)
    used_factors = _factors(len(series), factors)
    if estimator not in get_args(Estimator):
        raise ValueError(f"estimator is {estimator!r}, one of {', '.join(get_args(Estimator))} is required")
    if estimator == "decimated":
        stream = AllanStream(interval_s, used_factors)
        stream.feed(series)
        return stream.curve(confidence)
    moments = [_moments(running_sum(column), used_factors) for column in series.reshape(len(series), -1).T]
    return make_curve(
        moments,
        used_factors,
        [1] * len(used_factors),
        SeriesShape(len(series), interval_s, series.shape[1:]),
        confidence,
    )


def allan_deviation_of_runs(columns: Sequence[CountColumn], interval_s: float, lengths: Sequence[int]) -> AllanCurve:
    """Return the overlapping Allan deviation, at octaves of the longest run, of k equally long columns of counts that
    are read block by block. They consist of runs of these `lengths`, one after the other with gaps between them: the
    mean is over all terms within runs. The result for a single run is identical to that of `allan_deviation`.

    The noise type is estimated from the longest run. One column's running sum is held in memory, 4 bytes per count if
    counts of 16 bits do not drift too far, and with several runs the position of every row in its run. ValueError for
    fewer than two counts.
    """
    sizes = np.asarray(lengths, np.int64)
    used_factors = _factors(int(sizes.max()), None)
    moments = []
    for column in columns:
        short = column.dtype.itemsize <= 2
        phase = compact_running_sum(column) if short else running_sum(column[: len(column)])
        whole = len(sizes) == 1
        moments.append(_moments(phase, used_factors) if whole else _moments_of_runs(column, phase, sizes, used_factors))
    kinds, number = np.unique(sizes, return_counts=True)
    runs = tuple(zip(kinds.tolist(), number.tolist(), strict=True)) if len(sizes) > 1 else ()
    shape = SeriesShape(int(sizes.sum()), interval_s, (len(columns),), runs)
    return make_curve(moments, used_factors, [1] * len(used_factors), shape, CONFIDENCE)


def _moments_of_runs(column: CountColumn, phase: Values, sizes: Integers, factors: Sequence[int]) -> DifferenceMoments:
    """Return the moments of a column of runs of these `sizes` (r,) with the running sum `phase` (n + 1,)."""
    starts = np.cumsum(sizes) - sizes
    place = np.arange(len(phase), dtype=np.int32)  # for each running sum, the number of values of its run
    place[1:] -= np.repeat(starts, sizes).astype(np.int32)
    changes = ChangeMoments()
    for start in range(0, len(column), _BLOCK):
        stop = min(start + _BLOCK, len(column))
        changes.feed_pairs(np.asarray(column[max(start - 1, 0) : stop]), place[max(start, 1) + 1 : stop + 1] > 1)
    longest = int(sizes.argmax())
    run = phase[starts[longest] : starts[longest] + sizes[longest] + 1]
    averages = [_averages(run, m) for m in factors]
    return DifferenceMoments(sums_of_squares_within(phase, place, factors), averages, changes.kurtosis())


def _check_series(values: npt.ArrayLike, interval_s: float) -> npt.NDArray[Any]:
    """Return the series as an array; ValueError."""
    series = np.asarray(values)
    if series.ndim not in (1, 2) or len(series) < 2 or series.size == 0 or series.dtype.kind not in "biuf":
        required = "an (n,) or (n, k) series of at least 2 real numbers is required"
        raise ValueError(f"{required}, not {series.dtype} {series.shape}")
    if not 0 < interval_s < np.inf:
        raise ValueError(f"interval_s is {interval_s}, a positive number is required")
    return series


def _factors(rows: int, factors: Sequence[int] | None) -> list[int]:
    """Return the averaging factors, octaves if None; ValueError."""
    candidates = np.asarray(octaves(rows) if factors is None else factors)
    if (
        candidates.ndim != 1
        or candidates.dtype.kind not in "iu"
        or candidates.min() < 1
        or candidates.max() > rows // 2
    ):
        raise ValueError(
            f"averaging factors are whole numbers from 1 to {rows // 2} (half of {rows} values), not {factors}"
        )
    return [int(m) for m in candidates]


def _moments(phase: npt.NDArray[Any], factors: Sequence[int]) -> DifferenceMoments:
    """Return the sums of squares, averages and kurtosis of the column with this running sum."""
    changes = ChangeMoments()
    for start in range(0, len(phase) - 1, _BLOCK):
        changes.feed(np.diff(phase[start : start + _BLOCK + 1]))
    return DifferenceMoments(
        sums_of_squares(phase, factors), [_averages(phase, m) for m in factors], changes.kurtosis()
    )


def _averages(phase: npt.NDArray[Any], m: int) -> npt.NDArray[np.float64]:
    """Return consecutive averages over m values; the middle ones if there are very many."""
    count = (len(phase) - 1) // m
    first = max(0, (count - IDENTIFY) // 2)
    ends = phase[first * m : (min(count, first + IDENTIFY)) * m + 1 : m].astype(float)
    return np.asarray(np.diff(ends) / m)


_ROWS = 32768
"""Number of values that are collected before they are processed; half as many at coarser strides."""

_OCTAVES = tuple(1 << power for power in range(36))
"""Averaging factors of a series of unknown length: up to five years at 400 Hz."""


class AllanStream:
    """Collects a series (n,) or (n, k) block by block; `curve` is its Allan deviation so far.

    `factors` are averaging factors, octaves if None: a column then needs 200 KiB a factor, however long the series. The
    decimated estimator keeps 2 m / `stride_of(m)` values of a factor m, 16 if 8 divides it. The overlapping one keeps 4
    values per row of its longest factor, and its factors must be given. Whole numbers are summed exactly while their
    distances from the first add up to less than 2^53. ValueError for anything else.
    """

    def __init__(
        self, interval_s: float, factors: Sequence[int] | None = None, estimator: Estimator = "decimated"
    ) -> None:
        if not 0 < interval_s < np.inf:
            raise ValueError(f"interval_s is {interval_s}, a positive number is required")
        if estimator == "overlapping" and factors is None:
            raise ValueError("the overlapping estimator needs its averaging factors beforehand")
        self._factors = tuple(int(m) for m in (_OCTAVES if factors is None else factors))
        self._strides = tuple(stride_of(m) if estimator == "decimated" else 1 for m in self._factors)
        if min(self._factors, default=0) < 1:
            raise ValueError(f"averaging factors are whole numbers from 1 on, not {factors}")
        self._is_named = factors is not None
        self._interval_s = interval_s
        self._rows = 0
        self._shape: tuple[int, ...] = ()
        self._columns: list[_Pyramid] = []

    def feed(self, values: npt.ArrayLike) -> None:
        """Add the next rows (n,) or (n, k); ValueError unless they are real, finite and of the same shape as before."""
        block = np.asarray(values)
        if block.ndim not in (1, 2) or block.dtype.kind not in "biuf" or 0 in block.shape[1:]:
            raise ValueError(f"(n,) or (n, k) real numbers are required, not {block.dtype} {block.shape}")
        if len(block) == 0:
            return
        if not self._columns:
            self._shape = block.shape[1:]
            columns = block.shape[1] if block.ndim == 2 else 1
            self._columns = [_Pyramid(self._factors, self._strides) for _ in range(columns)]
        if block.shape[1:] != self._shape:
            raise ValueError(f"rows of shape {self._shape} are required as before, not {block.shape[1:]}")
        for pyramid, column in zip(self._columns, block.reshape(len(block), -1).T, strict=True):
            pyramid.feed(column)
        self._rows += len(block)

    def curve(self, confidence: float = CONFIDENCE) -> AllanCurve:
        """Return the Allan deviation of all rows so far, at the factors for which they suffice; ValueError for fewer
        than two rows.

        Octaves end at a third of the rows, given factors at half of them.
        """
        if self._rows < 2:
            raise ValueError(f"{self._rows} rows have no Allan deviation, at least 2 are required")
        longest = self._rows // 2 if self._is_named else max(self._rows // 3, 1)
        indices = [index for index, m in enumerate(self._factors) if m <= longest]
        if not indices:
            raise ValueError(f"{self._rows} rows are too few for the averaging factors {self._factors}")
        factors, strides = [self._factors[at] for at in indices], [self._strides[at] for at in indices]
        moments = [pyramid.moments(factors, strides) for pyramid in self._columns]
        return make_curve(moments, factors, strides, SeriesShape(self._rows, self._interval_s, self._shape), confidence)


class _Pyramid:
    """Running sums of one column at every stride that is needed."""

    def __init__(self, factors: Sequence[int], strides: Sequence[int]) -> None:
        distances: dict[int, set[int]] = {stride: set() for stride in {1, *strides, *factors}}
        for m, stride in zip(factors, strides, strict=True):
            distances[stride].add(m // stride)
        self._levels: dict[int, _Stride] = {}
        for stride in sorted(distances):
            level = _Stride(sorted(distances[stride]), _ROWS if stride == 1 else _ROWS // 2)
            finer = max((other for other in self._levels if stride % other == 0), default=None)
            if finer is not None:
                self._levels[finer].coarser.append(_Link(stride // finer, level))
            self._levels[stride] = level
        self._total = 0.0
        self._reference: Any = None
        self._changes = ChangeMoments()
        self._levels[1].add(np.zeros(1))

    def feed(self, values: Values) -> None:
        """Add the next values (n,); ValueError if one is not finite."""
        if self._reference is None:
            self._reference = values[0] if values.dtype.kind in "biu" else values[:_ROWS].mean(dtype=np.float64)
        self._changes.feed(values)
        root, start = self._levels[1], 0
        while start < len(values):
            free = root.free()
            part = values[start : start + len(free)]
            add_up(part, self._reference, self._total, free[: len(part)])
            self._total = float(free[len(part) - 1])
            root.grow(len(part))
            start += len(part)

    def moments(self, factors: Sequence[int], strides: Sequence[int]) -> DifferenceMoments:
        """Return the moments of all values so far."""
        self._levels[1].work(through=True)
        sums = [self._levels[stride].sums[m // stride] for m, stride in zip(factors, strides, strict=True)]
        return DifferenceMoments(sums, [self._levels[m].averages() / m for m in factors], self._changes.kurtosis())


class _Link:
    """Passes every `ratio`-th value to a coarser level, the next one after `skip` others."""

    def __init__(self, ratio: int, level: _Stride) -> None:
        self.ratio, self.level, self.skip = ratio, level, 0

    def pass_on(self, phase: Floats) -> None:
        self.level.add(phase[self.skip :: self.ratio])
        self.skip = (self.skip - len(phase)) % self.ratio


class _Stride:
    """The running sum at one stride: its latest values, its first, and the sums of squares at its distances."""

    def __init__(self, distances: Sequence[int], rows: int) -> None:
        self.sums = dict.fromkeys(distances, 0.0)
        self.coarser: list[_Link] = []
        self._kept = 2 * max(distances, default=0)
        self._phase = np.empty(max(rows, self._kept) + self._kept)
        self._filled = self._done = 0
        self._first: list[Floats] = []

    def free(self) -> Floats:
        """Return the free part of the buffer, for the next values; at least one."""
        return self._phase[self._filled :]

    def grow(self, count: int) -> None:
        """Add the first `count` values of `free`."""
        self._filled += count
        if self._filled == len(self._phase):
            self.work()

    def add(self, phase: Floats) -> None:
        """Add the next values (n,)."""
        while len(phase):
            free = self.free()
            count = min(len(free), len(phase))
            free[:count] = phase[:count]
            self.grow(count)
            phase = phase[count:]

    def work(self, through: bool = False) -> None:
        """Process the new values, pass them on, and keep those that later second differences need.

        `through`: process the coarser levels as well, even if their buffers are not full.
        """
        phase, new = self._phase[: self._filled], self._phase[self._done : self._filled]
        for distance, total in zip(self.sums, sums_of_squares(phase, list(self.sums), self._done), strict=True):
            self.sums[distance] += total
        lacking = IDENTIFY + 1 - sum(map(len, self._first))
        if lacking > 0 and len(new):
            self._first.append(new[:lacking].copy())
        for link in self.coarser:
            link.pass_on(new)
            if through:
                link.level.work(through)
        count = min(self._kept, self._filled)
        self._phase[:count] = self._phase[self._filled - count : self._filled].copy()
        self._filled = self._done = count

    def averages(self) -> npt.NDArray[np.float64]:
        """Return the sums over one stride, the first ones."""
        return np.diff(np.concatenate(self._first))
