"""The error that all units of one design share along one box axis, as its anti-parallel axes show it.

Axes along the box axis read ``truth + c + own error``, axes against it ``-truth + c + own error``: half the sum of
the two means is c whatever the truth is. c is slow (temperature, supply), so it is low-passed and costs no noise. And
it is believed only as far as units that point the same way agree: with `n+` and `n-` axes and a within-way variance
s2 of the slow errors, a sum C has an expected square of ``(2 c)^2 + s2 (1/n+ + 1/n-)``, so that c is estimated by C/2
times ``1 - s2 (1/n+ + 1/n-) / C^2``, never below zero: the positive-part shrinkage of James and Stein (1961), with
both squares averaged since the log began. Where units share nothing, this costs at most 3.3 % of the average's drift
(three axes, one degree of freedom within the ways).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from imuarray.fuse.axes import Axis, directions

Floats = npt.NDArray[np.float64]

SMOOTHING_S = 10.0
"""Time constant of the low-pass."""


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


class CommonMode:
    """The running estimate of one group's common error; fed with consecutive blocks."""

    def __init__(self, group: OpposingGroup, seconds: float = SMOOTHING_S) -> None:
        self.members = [*group.along, *group.against]
        self._along = slice(0, len(group.along))
        self._against = slice(len(group.along), None)
        self._slow = Smoother(seconds, len(self.members))
        self._spread = 1 / len(group.along) + 1 / len(group.against)
        self._freedom = len(self.members) - 2
        self._energy = np.zeros(2)

    def estimate(self, time: npt.NDArray[np.int64], residual: Floats, valid: npt.NDArray[np.bool_]) -> Floats:
        """(n,) the common error in the unit of `residual` (n, m): axis values less what the average triad explains."""
        errors = np.where(valid[:, self.members], residual[:, self.members], np.nan)
        slow = self._slow(time, errors)
        ways = (slow[:, self._along], slow[:, self._against])
        total = sum((way.mean(axis=1) for way in ways), np.zeros(len(slow)))
        within = sum((((way - way.mean(axis=1, keepdims=True)) ** 2).sum(axis=1) for way in ways), np.zeros(len(slow)))
        energy = self._energy + np.cumsum(np.stack([total**2, within / self._freedom * self._spread], axis=1), axis=0)
        self._energy = energy[-1]
        trust = 1 - energy[:, 1] / np.maximum(energy[:, 0], 1e-300)
        return np.asarray(total / 2 * np.clip(trust, 0, 1))


class Smoother:
    """First-order low-pass over consecutive blocks of rows (n, k); at first, the mean of what there is.

    A running mean becomes the exponential one once it holds as many rows as the time constant: no transient from an
    arbitrary start. NaN keeps the value before it.
    """

    def __init__(self, seconds: float, columns: int) -> None:
        self.seconds = seconds
        self.seen = 0
        self.state = np.zeros(columns)
        self.last = np.zeros(columns)
        self.rows_held = 0

    def __call__(self, time: npt.NDArray[np.int64], rows: Floats) -> Floats:
        """Low-passed `rows`, taken at `time` (n,) ns."""
        if self.rows_held == 0:
            period_s = float(np.median(np.diff(time[:1000]))) * 1e-9 if len(time) > 1 else self.seconds
            self.rows_held = max(1, round(self.seconds / period_s))
        held = self._hold(rows)
        begin = min(max(0, self.rows_held - self.seen), len(held))
        out = np.empty_like(held)
        if begin:
            counts = self.seen + np.arange(1, begin + 1)[:, None]
            out[:begin] = (self.state * self.seen + np.cumsum(held[:begin], axis=0)) / counts
            self.state = out[begin - 1]
        if begin < len(held):
            gain = 1 / self.rows_held
            out[begin:], _ = lfilter([gain], [1, gain - 1], held[begin:], axis=0, zi=(1 - gain) * self.state[None, :])
            self.state = out[-1]
        self.seen += len(held)
        return out

    def _hold(self, rows: Floats) -> Floats:
        """`rows` with the last finite value in place of NaN."""
        known = np.isfinite(rows)
        source = np.maximum.accumulate(np.where(known, np.arange(len(rows))[:, None], -1), axis=0)
        held = np.where(source >= 0, np.take_along_axis(rows, np.maximum(source, 0), axis=0), self.last)
        self.last = held[-1]
        return held
