"""What does not go with the stimulus but with its change: no reading's time is known exactly.

A reading that is late by t errs by t times the stimulus's change in a second. While a box is moved to and fro that
comes and goes as noise does: where the change is fast frames teach less about slow errors, what is told of their own
errors is wider, and gains are those of noise that is larger by the mean square of the change over the segment before.
"""

from __future__ import annotations

import numpy as np

from imuarray.fuse.frames import Floats, Times
from imuarray.fuse.optimal.geometry import Geometry
from imuarray.fuse.optimal.readings import Readings, held, patterns
from imuarray.fuse.optimal.solve import Solution
from imuarray.fuse.optimal.view import View

OVER_S = 0.05
"""Over which a change is looked at: noise of a frame is little beside it, and shaking by hand is slower."""


class Dynamics:
    """The change of consecutive triads, block after block."""

    def __init__(self, geometry: Geometry, period_s: float) -> None:
        self._geometry = geometry
        self._back = max(1, round(OVER_S / period_s))
        self._time, self._triad = np.zeros(0, np.int64), np.zeros((0, 3))
        self._sum, self._frames, self._mean = 0.0, 0, 0.0

    def recent(self) -> float:
        """Mean square of the change per second since this was asked before; then begins anew."""
        if self._frames:
            self._mean = self._sum / self._frames
        self._sum, self._frames = 0.0, 0
        return self._mean

    def __call__(self, view: View, readings: Readings, solution: Solution, frames: slice) -> Floats | None:
        """(n,) how much the frames still teach, None where all do fully; widens their covariances."""
        if not self._geometry.timing.any() or not len(readings.time):
            return None
        changes = self._changes(readings.time, solution.unknowns[frames, :3])
        self._sum, self._frames = self._sum + float(changes.sum()), self._frames + len(changes)
        for valid, which in patterns(readings.valid):
            usual = view.usual(valid)
            if usual is not None:
                solution.covariance[frames][which] += changes[which][:, None, None] * usual.timing
        worst = float((self._geometry.timing / self._geometry.noise).max())
        return np.asarray(1 / (1 + worst**2 * changes))

    def _changes(self, time: Times, triad: Floats) -> Floats:
        """(n,) squares of the change per second; 0 where nothing is known yet."""
        times, triads = np.concatenate([self._time, time]), held(np.concatenate([self._triad, triad]))
        now = np.arange(len(self._time), len(times))
        then = np.maximum(now - self._back, 0)
        self._time, self._triad = times[-self._back :], triads[-self._back :]
        seconds = np.maximum((times[now] - times[then]) * 1e-9, 1e-9)
        return np.asarray(np.nan_to_num(((triads[now] - triads[then]) ** 2).sum(axis=1) / seconds**2))
