"""Allan deviation of a series that arrives in blocks, in memory that does not grow with it.

The decimated estimator starts its second differences not at every row but at every `stride_of(m)`-th, an eighth of the
averaging factor m. Neighbouring differences are so strongly correlated that this costs one or two hundredths of the
degrees of freedom (which `AllanCurve.freedom` counts), and the running sum is then needed at multiples of the stride
alone: a pyramid of coarser and coarser running sums, each of which keeps its latest values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.characterise.allan_curve import (
    CONFIDENCE,
    IDENTIFY,
    AllanCurve,
    ChangeMoments,
    DifferenceMoments,
    SeriesShape,
    make_curve,
    stride_of,
)
from imuarray.characterise.second_differences import Values, add_up, sums_of_squares

Estimator = Literal["overlapping", "decimated"]
""""overlapping": second differences start at every row; "decimated": at least eight times in an averaging time."""

_ROWS = 32768
"""Number of values that are collected before they are processed; half as many at coarser strides."""

_OCTAVES = tuple(1 << power for power in range(36))
"""Averaging factors of a series of unknown length: up to five years at 400 Hz."""


class AllanStream:
    """Collects a series (n,) or (n, k) block by block; `curve` is its Allan deviation so far.

    `factors` are averaging factors, octaves if None: a column then needs 200 KiB a factor, however long the series.
    The decimated estimator keeps 2 m / `stride_of(m)` values of a factor m, 16 if 8 divides it. The overlapping one
    keeps 4 values per row of its longest factor, and its factors are to be named. Whole numbers are summed exactly
    while their distances from the first add up to less than 2^53. ValueError for anything else.
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

        Octaves end at a third of the rows, named factors at half of them.
        """
        if self._rows < 2:
            raise ValueError(f"{self._rows} rows have no Allan deviation, at least 2 are required")
        longest = self._rows // 2 if self._is_named else max(self._rows // 3, 1)
        chosen = [index for index, m in enumerate(self._factors) if m <= longest]
        if not chosen:
            raise ValueError(f"{self._rows} rows are too few for the averaging factors {self._factors}")
        factors, strides = [self._factors[at] for at in chosen], [self._strides[at] for at in chosen]
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
            finer = max((known for known in self._levels if stride % known == 0), default=None)
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
        held, new = self._phase[: self._filled], self._phase[self._done : self._filled]
        for distance, total in zip(self.sums, sums_of_squares(held, list(self.sums), self._done), strict=True):
            self.sums[distance] += total
        lacking = IDENTIFY + 1 - sum(map(len, self._first))
        if lacking > 0 and len(new):
            self._first.append(new[:lacking].copy())
        for link in self.coarser:
            link.pass_on(new)
            if through:
                link.level.work(through)
        kept = min(self._kept, self._filled)
        self._phase[:kept] = self._phase[self._filled - kept : self._filled].copy()
        self._filled = self._done = kept

    def averages(self) -> npt.NDArray[np.float64]:
        """Sums over one stride, the first ones."""
        return np.diff(np.concatenate(self._first))
