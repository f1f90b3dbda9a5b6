"""Sensors whose readings the log's own flags rule out, or that are not there at all, for long enough to be told."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imuarray.fuse.faults.telling import Telling

Flags = npt.NDArray[np.bool_]

SILENT_S = 1.0


class Silence:
    """Counts windows without valid readings, by sensor."""

    def __init__(self, sensors: int, window_s: float) -> None:
        self._window_s = window_s
        self._patience = max(1, round(SILENT_S / window_s))
        self._absent = np.zeros(sensors, int)
        self._heard = np.zeros(sensors, int)
        self._told = np.zeros(sensors, bool)

    @property
    def anybody(self) -> bool:
        """Whether anybody is silent."""
        return bool(self._told.any())

    def all_heard(self) -> None:
        """A window in which every sensor has enough readings, none being silent."""
        self._absent[:] = 0
        self._heard += 1

    def __call__(self, present: Flags, time_ns: int, telling: Telling) -> None:
        """Takes the axes (m,) that have enough readings in the next window."""
        there = present.reshape(-1, 3).any(axis=1)
        self._absent = np.where(there, 0, self._absent + 1)
        self._heard = np.where(there, self._heard + 1, 0)
        for sensor in np.flatnonzero(~self._told & (self._absent >= self._patience)).tolist():
            telling.silent(sensor, self._patience * self._window_s, time_ns)
            self._told[sensor] = True
        for sensor in np.flatnonzero(self._told & (self._heard >= self._patience)).tolist():
            telling.back(sensor, time_ns)
            self._told[sensor] = False
