"""Rows in memory in the place of a log: what reads a log reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.log import Log, SensorLog
from imuarray.log.column import Column, LiveGroup
from imuarray.monitor.window import Rows

Attributes = Mapping[str, Any]


class _Stored:
    """The part of a column that stands in a file, where there is none."""

    chunks = None

    def __init__(self, name: str, rows: npt.NDArray[Any]) -> None:
        self.name, self.attrs = name, cast(Attributes, {})
        self._rows = rows[:0]

    def __getitem__(self, key: Any) -> npt.NDArray[Any]:
        return np.asarray(self._rows[key])


class _Group:
    """A group's name and attributes."""

    def __init__(self, name: str, attributes: Attributes) -> None:
        self.name, self.attrs = name, attributes


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
        """There is nothing to close."""


class HeldLog(Log):
    """A log of rows that are held in memory: `sensors` gives attributes and columns by name; LogError where the
    attributes are no sensor's. It has no phases, no events and no truth, and can't be sent to another process.
    """

    def __init__(self, path: Path, sensors: Mapping[str, tuple[Attributes, Rows]]) -> None:
        self.path = path
        groups = {name: _held(name, attributes, rows) for name, (attributes, rows) in sensors.items()}
        self._file = cast(h5py.File, _File(groups))
        self.sensors = {
            name: SensorLog(group, f"{path}, sensor {name}", self, _not_sent) for name, group in groups.items()
        }


def _held(name: str, attributes: Attributes, rows: Rows) -> LiveGroup:
    """A sensor's group."""
    columns = {column: np.ascontiguousarray(values) for column, values in rows.items()}
    group = cast(h5py.Group, _Group(f"/sensors/{name}", attributes))
    return LiveGroup(group, {key: Column(_Stored(key, values), 0, values) for key, values in columns.items()})


def _not_sent(path: Path) -> Log:
    raise LogError(f"{path}: its last rows are in the memory of another process")
