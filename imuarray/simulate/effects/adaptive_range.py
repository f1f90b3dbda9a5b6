"""`adaptive_range`: the reading is frozen for a moment when the rate passes a threshold."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Booleans, Floats, Indices
from imuarray.simulate.effect import Effect, scalar
from imuarray.simulate.signal import Codes, Counts, Place

LONGEST = 256
"""Limit of consecutive rows that show one reading, however often the threshold is crossed."""

_DENSE = 1.5
"""Interval of rows, in periods of the chip's readings, below which rows show every reading."""


@dataclass(frozen=True)
class AdaptiveRange(Effect):
    """When the reading of any axis crosses `threshold` in size, all three axes repeat the previous reading for `hold_s`
    seconds, and the chip reports these readings as new.

    The gyroscope of an ICM-42688-P changes its full-scale range by itself unless bits 7:6 of INTF_CONFIG1 are 01, and
    delivers no new reading for 1 to 2 ms at each change, near 100 dps (TDK-18). In data: two or three identical triads
    at 1 kHz, then a jump to the current rate; nothing at rest. If rows are less frequent than readings, rows within the
    hold show the reading at the crossing, by linear interpolation. The temperature is not held.
    """

    name: ClassVar[str] = "adaptive_range"
    threshold: float = scalar(math.inf, suffix="_{u}", low=0.0)
    hold_s: float = scalar(0.0, low=0.0, high=1.0)

    def lookback(self, at: Place) -> int:
        """Return the largest number of rows that affect a stretch: a run of held rows, the crossing before it, and one
        row more.
        """
        if not self._acts:
            return 0
        return LONGEST + math.ceil(self.hold_s * at.rows_per_s) + 2

    @property
    def _acts(self) -> bool:
        return math.isfinite(self.threshold) and self.hold_s > 0

    def codes(self, codes: Codes, at: Place) -> Codes:
        """Replace the readings within each hold by the reading before the crossing."""
        if not self._acts or len(codes.counts) < 2:
            return codes
        inside = np.abs(codes.counts) < self.threshold * at.sensor.sensitivity
        passed = np.flatnonzero((inside[1:] != inside[:-1]).any(axis=1)) + 1
        if not len(passed):
            return codes
        period_ns = 1e9 / at.sensor.rate_hz if at.sensor.rate_hz else 0.0
        noticed_ns = self._noticed_ns(codes, passed, period_ns, at.sensor.sensitivity)
        is_held = _held(codes, passed, noticed_ns, self.hold_s * 1e9)
        starts = np.flatnonzero(is_held & ~np.concatenate([[False], is_held[:-1]]))
        if not len(starts):
            return codes
        shown = _shown_at(codes, starts, noticed_ns[np.searchsorted(passed, starts)] - period_ns, period_ns)
        rows = np.arange(len(is_held))
        run = np.searchsorted(starts, rows, side="right") - 1
        is_held &= rows - starts[run] < LONGEST
        return replace(codes, counts=np.where(is_held[:, None], shown[run], codes.counts))

    def _noticed_ns(self, codes: Codes, passed: Indices, period_ns: float, sensitivity: float) -> Floats:
        """Return the time at which the chip detects each crossing: its first reading after the crossing, in a row of
        `passed`.
        """
        before, after = (np.abs(codes.counts[rows]).astype(float) for rows in (passed - 1, passed))
        limit = self.threshold * sensitivity
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where((before < limit) != (after < limit), (limit - before) / (after - before), np.inf)
        begin_ns, end_ns = (codes.instant_ns[rows].astype(float) for rows in (passed - 1, passed))
        at_ns = begin_ns + np.clip(share.min(axis=1), 0, 1) * (end_ns - begin_ns)
        return np.asarray(np.minimum(end_ns, at_ns + period_ns))


def _held(codes: Codes, passed: Indices, noticed_ns: Floats, hold_ns: float) -> Booleans:
    """Return (n,) whether a row falls within the hold of the latest crossing before it."""
    latest = np.searchsorted(passed, np.arange(len(codes.counts)), side="right") - 1
    since_ns = codes.instant_ns - noticed_ns[latest]
    return np.asarray((latest >= 0) & (since_ns < hold_ns))


def _shown_at(codes: Codes, starts: Indices, at_ns: Floats, period_ns: float) -> Counts:
    """Return the readings (m, 3) that are held from rows `starts` on. If every reading has a row, these are the
    previous rows; otherwise they are interpolated between the two rows at `at_ns`.
    """
    begin_ns, end_ns = (codes.instant_ns[rows].astype(float) for rows in (starts - 1, starts))
    share = np.clip((at_ns - begin_ns) / np.maximum(end_ns - begin_ns, 1), 0, 1)
    share[end_ns - begin_ns < _DENSE * period_ns] = 0
    before, after = codes.counts[starts - 1], codes.counts[starts]
    return np.asarray(np.rint(before + share[:, None] * (after - before)), codes.counts.dtype)
