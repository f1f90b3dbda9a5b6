"""Triads whose readings don't change: stuck, or so coarse that their noise has vanished."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.kinds import QUIET
from imuarray.fuse.faults.normal import Normal
from imuarray.fuse.faults.window import Window

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_KNOWN_WINDOWS = 20
"""So many windows tell what is normal for a sensor."""

_RARE = 1e-3
"""A sensor is judged by its changes only if no more than this share of its windows was quiet by itself: where noise is
less than a count, windows without a change are normal; so are stale ones where a chip is slower than the frames."""

_SHORT = 3
"""Runs of no more windows may be what a sensor does by itself."""

QUIETEST = 0.2
"""A window with less than this share of the usual changes may hold the begin or the end of a standstill: nothing is
learnt of noise from it."""


class Stillness:
    """Which sensors stand still, by two windows in a row; what is normal is learnt of the windows before."""

    def __init__(self, sensors: int) -> None:
        self._quiet, self._stale = _Runs(sensors), _Runs(sensors)

    @property
    def standing(self) -> Flags:
        """(s,) the sensors that show no change in the last window."""
        return np.asarray((self._quiet.length > 0) | (self._stale.length > 0))

    def __call__(self, window: Window, normal: Normal) -> Flags:
        """(s,) the sensors that stood still in this window and in the one before."""
        share = (window.changes / normal.change).reshape(-1, 3).mean(axis=1)
        whole: Flags = np.asarray(window.valid.reshape(len(window.valid), -1, 3).all(axis=(0, 2)))
        stale: Flags = np.zeros(len(share), bool)
        if window.stale is not None:
            stale = np.asarray(window.stale.reshape(len(window.valid), -1, 3).all(axis=(0, 2)))
        return self._quiet(whole & (share < QUIET), whole) | self._stale(whole & stale, whole)

    def moves(self, changes: Floats, normal: Normal) -> bool:
        """Whether no sensor stood still in the window before nor does in this one, of which every reading is there and
        none is stale: its mean squares of `changes` (m,).
        """
        if self._quiet.any or self._stale.any:
            return False
        share = (changes / normal.change).reshape(-1, 3).sum(axis=1)
        return bool(share.min() >= 3 * QUIET)

    def moved(self) -> None:
        """Counts such a window."""
        self._quiet.pass_by()
        self._stale.pass_by()


class _Runs:
    """Runs of windows that show something unusual, by sensor; and how usual it is."""

    def __init__(self, sensors: int) -> None:
        self.length = np.zeros(sensors, int)
        self.any = False
        self._windows = np.zeros(sensors)
        self._by_itself = np.zeros(sensors)

    def pass_by(self) -> None:
        """A window that shows it of no sensor, after one that did not either."""
        self._windows += 1

    def __call__(self, shows: Flags, judged: Flags) -> Flags:
        """(s,) the sensors for which this window and the one before show it, though that is unusual."""
        usual = self._by_itself > _RARE * self._windows
        ended = ~shows & judged
        self._by_itself += np.where(ended & ((self.length <= _SHORT) | usual), self.length, 0)
        self.length = np.where(shows, self.length + 1, np.where(judged, 0, self.length))
        self.any = bool(self.length.any())
        self._windows += judged & ~shows
        return np.asarray(~usual & (self._windows >= _KNOWN_WINDOWS) & (self.length == 2))
