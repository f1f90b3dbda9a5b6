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
_CALM_WINDOWS = 3
"""After a standstill, windows that may hold the end of it."""

QUIETEST = 0.2
"""A sensor is judged by its changes only if it never had a window with less than this share of its usual ones: where
noise is less than a count, windows without a change are normal. Nothing is learnt of noise in such a window."""


class Stillness:
    """Which sensors stand still, by two windows in a row; what is normal is learnt of the windows before."""

    def __init__(self, sensors: int) -> None:
        self._windows = np.zeros(sensors)
        self._least = np.full(sensors, np.inf)
        self._stale_before = np.zeros(sensors, bool)
        self._last_share = np.full(sensors, np.nan)
        self._last_stale = np.zeros(sensors, bool)
        self._since = np.full(sensors, _CALM_WINDOWS)

    @property
    def standing(self) -> Flags:
        """(s,) the sensors that show no change in the last window."""
        return np.asarray((self._last_share < QUIET) | self._last_stale)

    def __call__(self, window: Window, normal: Normal) -> Flags:
        """(s,) the sensors that stood still in this window and in the one before."""
        share = (window.changes / normal.change).reshape(-1, 3).mean(axis=1)
        whole: Flags = np.asarray(window.valid.reshape(len(window.valid), -1, 3).all(axis=(0, 2)))
        stale: Flags = np.zeros(len(share), bool)
        if window.stale is not None:
            stale = np.asarray(window.stale.reshape(len(window.valid), -1, 3).all(axis=(0, 2)) & whole)
        share = np.where(whole, share, np.nan)
        known = self._windows >= _KNOWN_WINDOWS
        quiet = known & (self._least > QUIETEST) & (share < QUIET) & (self._last_share < QUIET)
        held = known & ~self._stale_before & stale & self._last_stale
        going_on = (share < QUIET) | stale
        self._since = np.where(going_on, 0, self._since + 1)
        fine = (self._since >= _CALM_WINDOWS) & np.isfinite(self._last_share)
        self._least = np.where(fine, np.fmin(self._least, self._last_share), self._least)
        self._stale_before |= fine & self._last_stale
        self._windows += np.isfinite(share)
        self._last_share, self._last_stale = share, stale
        return np.asarray(quiet | held)
