"""The error that all units of one design share along one box axis, as its anti-parallel axes show it.

Axes along the box axis read ``truth + c + own error``, axes against it ``-truth + c + own error``: half the sum C of
the two means is c whatever the truth is. So are even-order terms, for these have no sign (paper, section 2.1), and
odd-order ones are no part of it. c is slow (temperature, supply), so it is low-passed and costs no noise.

It is believed only as far as units that point the same way agree. With `n+` and `n-` axes and a within-way variance s2
of the slow errors, C has an expected square of ``(2 c)^2 + s2 (1/n+ + 1/n-)``: where units share nothing,
``F = C^2 / (s2 (1/n+ + 1/n-))`` follows Fisher's law with 1 and n+ + n- - 2 degrees of freedom. c is used from where F
would be larger by chance with twice the probability `significance`, and in full from where it would be with that
probability; and as C/2 times ``1 - 1/F``, the share of C^2 that the common part has in it. Where units share nothing
this costs the average's drift less than 1 % (three axes).

The level of the errors at the start (what is left of turn-on biases) and their change since then are judged apart:
units that came up with biases of their own may well drift alike. Of the change, C^2 and s2 are variances in time, all
since the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from imuarray.fuse.axes import Axis, directions

Floats = npt.NDArray[np.float64]

SMOOTHING_S = 10.0
"""Time constant of the low-pass."""

_JUDGED = 6.0
"""The change is judged by what is left of it behind a low-pass of so many times that; so noise hardly counts."""

_SIGNIFICANCE = 0.05
_LOST_OF_THREE = 0.125
"""What `significance` reckons with for one axis along and two against."""


@dataclass(frozen=True)
class OpposingGroup:
    """Axes (indices) of one design that point along, and against, one box axis."""

    along: tuple[int, ...]
    against: tuple[int, ...]
    box_axis: str = ""


def opposing_groups(axes: Sequence[Axis]) -> list[OpposingGroup]:
    """Every design and box axis that has axes both ways, but not equally many: those balance each other in the
    average.
    """
    rows = directions(axes)
    main = np.abs(rows).argmax(axis=1)
    groups: dict[tuple[str, int], tuple[list[int], list[int]]] = {}
    for index, axis in enumerate(axes):
        ways = groups.setdefault((axis.chip, int(main[index])), ([], []))
        ways[0 if rows[index, main[index]] > 0 else 1].append(index)
    return [
        OpposingGroup(tuple(along), tuple(against), "XYZ"[axis])
        for (_, axis), (along, against) in groups.items()
        if 0 < len(along) != len(against) > 0
    ]


@cache
def significance(along: int, against: int) -> float:
    """Chance that so many axes each way, which share nothing, are believed to share a drift.

    5 % of three axes; less the more the average would lose by it: a wrong c adds the variance of C/2 times the square
    of the imbalance ``(n- - n+) / n`` to an average that has s2/n.
    """
    lost = (1 / along + 1 / against) * (against - along) ** 2 / (4 * (along + against))
    return _SIGNIFICANCE * min(1.0, _LOST_OF_THREE / lost) ** 2 if lost else _SIGNIFICANCE


@cache
def _limits(along: int, against: int) -> tuple[float, float]:
    """F from which a common error is used, and used in full."""
    from scipy.special import fdtri  # the inverse of Fisher's F without the weight of scipy.stats

    chance = significance(along, against)
    low, high = fdtri(1, along + against - 2, [1 - 2 * chance, 1 - chance])
    return float(low), float(high)


class CommonMode:
    """The running estimate of one group's common error; fed with consecutive blocks."""

    def __init__(self, group: OpposingGroup, seconds: float = SMOOTHING_S) -> None:
        self.members = [*group.along, *group.against]
        self._along = len(group.along)
        self._slow = Smoother(seconds, len(self.members))
        self._slower = Smoother(_JUDGED * seconds, len(self.members))
        self._freedom = len(self.members) - 2
        self._spread = 1 / len(group.along) + 1 / len(group.against)
        self._limits = _limits(len(group.along), len(group.against))
        self._level = np.zeros(len(self.members))
        self._seen = 0
        self._sums = np.zeros((2, 1 + len(self.members)))

    def estimate(self, time: npt.NDArray[np.int64], residual: Floats, valid: npt.NDArray[np.bool_]) -> Floats:
        """(n,) the common error in the unit of `residual` (n, m): axis values less what the average triad explains."""
        errors = np.where(valid[:, self.members], residual[:, self.members], np.nan)
        slow = self._slow(time, errors)
        begin = self._slow.begin  # the level is what the low-pass held first
        if begin < len(slow) and self._seen == 0:
            self._level = slow[begin].copy()
        level = np.concatenate([slow[:begin], np.broadcast_to(self._level, (len(slow) - begin, len(self.members)))])
        parts = self._parts(level)
        common = self._trust(parts**2) * parts[:, 0] / 2
        if begin < len(slow):
            change = slow[begin:] - self._level
            judged = self._parts(self._slower(time[begin:], change))
            common[begin:] += self._trust(self._variances(judged)) * self._parts(change)[:, 0] / 2
        return np.asarray(common)

    def _parts(self, errors: Floats) -> Floats:
        """(n, 1 + m) the sum of both ways' means, and what each axis differs by from its way's."""
        ways = errors[:, : self._along], errors[:, self._along :]
        total = sum((way.mean(axis=1, keepdims=True) for way in ways), np.zeros((len(errors), 1)))
        return np.concatenate([total, *(way - way.mean(axis=1, keepdims=True) for way in ways)], axis=1)

    def _variances(self, parts: Floats) -> Floats:
        """(n, 1 + m) sums of squares about the mean in time, of all rows so far."""
        sums = self._sums[:, None, :] + np.cumsum([parts, parts**2], axis=1)
        number = self._seen + np.arange(1, len(parts) + 1)[:, None]
        if len(parts):
            self._seen, self._sums = int(number[-1, 0]), sums[:, -1]
        return np.asarray(np.maximum(sums[1] - sums[0] ** 2 / number, 0))

    def _trust(self, squares: Floats) -> Floats:
        """(n,) how far the common part is believed, 0 to 1, by the squares (n, 1 + m) of `_parts`."""
        own = squares[:, 1:].sum(axis=1) / self._freedom * self._spread
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(squares[:, 0] > 0, squares[:, 0] / own, 0.0)
            low, high = np.log(self._limits)
            surely = np.clip((np.log(ratio) - low) / (high - low), 0, 1)
        return np.asarray(surely * (1 - 1 / np.maximum(ratio, 1.0)))


class Smoother:
    """First-order low-pass over consecutive blocks of rows (n, k); at first, the mean of what there is.

    A running mean becomes the exponential one after the time constant: no transient from an arbitrary start. As many
    rows as came until then are the time constant from then on. NaN keeps the value before it.
    """

    def __init__(self, seconds: float, columns: int) -> None:
        from scipy.signal import lfilter  # its weight is for those who ask, and not while rows come

        self._filter = lfilter
        self.begin = 0
        """Row of the last block from which the mean was exponential, its length if none was."""
        self._span_ns = seconds * 1e9
        self._first_ns: int | None = None
        self._rows_held = 0
        self._seen = 0
        self._state = np.zeros(columns)
        self._last = np.zeros(columns)

    def __call__(self, time: npt.NDArray[np.int64], rows: Floats) -> Floats:
        """Low-passed `rows`, taken at `time` (n,) ns."""
        held = self._hold(rows)
        begin = self.begin = self._begin(time)
        out = np.empty_like(held)
        if begin:
            counts = self._seen + np.arange(1, begin + 1)[:, None]
            out[:begin] = (self._state * self._seen + np.cumsum(held[:begin], axis=0)) / counts
            self._state = out[begin - 1]
        if begin < len(held):
            gain = 1 / self._rows_held
            start = (1 - gain) * self._state[None, :]
            out[begin:], _ = self._filter([gain], [1, gain - 1], held[begin:], axis=0, zi=start)
            self._state = out[-1]
        self._seen += len(held)
        return out

    def _begin(self, time: npt.NDArray[np.int64]) -> int:
        """The first row beyond the running mean."""
        if self._rows_held or len(time) == 0:
            return 0
        self._first_ns = int(time[0]) if self._first_ns is None else self._first_ns
        begin = int(np.searchsorted(time, self._first_ns + self._span_ns))
        self._rows_held = self._seen + begin if begin < len(time) else 0
        return begin

    def _hold(self, rows: Floats) -> Floats:
        """`rows` with the last finite value in place of NaN."""
        known = np.isfinite(rows)
        source = np.maximum.accumulate(np.where(known, np.arange(len(rows))[:, None], -1), axis=0)
        if len(rows) == 0:
            return rows
        held = np.where(source >= 0, np.take_along_axis(rows, np.maximum(source, 0), axis=0), self._last)
        self._last = held[-1]
        return held
