"""A log whose rows are in memory, for functions that read a log."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np

from imuarray.errors import LogError
from imuarray.log import Log, SensorLog
from imuarray.log.columns import Column, LiveGroup
from imuarray.monitor.window import Rows

Attributes = Mapping[str, Any]


class _File:
    """A file that has sensors and nothing beside them."""

    def __init__(self, sensors: Mapping[str, Any]) -> None:
        self.attrs: Attributes = {"source": "imported"}
        self._items = {"sensors": sensors}

    def get(self, name: str) -> Any:
        """A part, None if it is not there."""
        return self._items.get(name)

    def __getitem__(self, name: str) -> Any:
        return self._items[name]

    def close(self) -> None:
        """Do nothing: there is nothing to close."""


class MemoryLog(Log):
    """A log of rows that are held in memory: `sensors` gives attributes and columns by name; LogError where the
    attributes are no sensor's. It has no phases, no events and no truth, and can't be sent to another process.
    """

    def __init__(self, path: Path, sensors: Mapping[str, tuple[Attributes, Rows]]) -> None:
        self.path = path
        groups = {name: _held(name, attributes, rows) for name, (attributes, rows) in sensors.items()}
        self._file, self._damaged = cast(h5py.File, _File(groups)), []
        self.sensors = {
            name: SensorLog(group, f"{path}, sensor {name}", self, _not_sent) for name, group in groups.items()
        }


def _held(name: str, attributes: Attributes, rows: Rows) -> LiveGroup:
    """A sensor's group."""
    columns = {key: Column(key, np.ascontiguousarray(values)) for key, values in rows.items()}
    return LiveGroup(f"/sensors/{name}", attributes, columns)


def _not_sent(path: Path) -> Log:
    raise LogError(f"{path}: its last rows are in the memory of another process")
