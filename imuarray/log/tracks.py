"""What a log has beside its sensors: what the box really felt, what a reference saw, what clocks said."""

from __future__ import annotations

from typing import Any, NamedTuple

import h5py

from imuarray.errors import LogError
from imuarray.log.column import DATASET, GROUP
from imuarray.log.layout import CLOCKS


class Track(NamedTuple):
    """`/truth` or `/reference`: datasets time (n,) ns, specific_force (n, 3) m/s2 and angular_rate (n, 3) rad/s in
    the box frame, temperature (n,) degC; None for what the log does not have.
    """

    time: h5py.Dataset
    specific_force: h5py.Dataset | None
    angular_rate: h5py.Dataset | None
    temperature: h5py.Dataset | None


class ClockTrack(NamedTuple):
    """`/clocks`: datasets (n,) ns of the log's own time and of four clocks of the machine (`imuarray.log.format`)."""

    time: h5py.Dataset
    monotonic: h5py.Dataset
    monotonic_raw: h5py.Dataset
    boottime: h5py.Dataset
    realtime: h5py.Dataset


def track_of(group: Any, where: str) -> Track:
    """The track that is a group of the file; LogError, with `where` it is, if it isn't one."""
    if not isinstance(group, GROUP) or "time" not in group:
        raise LogError(f"{where} has no time")
    columns = [group.get(column) for column in ("specific_force", "angular_rate", "temperature")]
    for column, tail in zip(columns, ((3,), (3,), ()), strict=True):
        if column is not None and column.shape != (*group["time"].shape, *tail):
            raise LogError(f"{where}: a column has another shape than time")
    return Track(group["time"], *columns)


def clocks_of(group: Any, where: str) -> ClockTrack:
    """The clocks that are a group of the file; LogError, with `where` it is, if it isn't that."""
    columns = [group.get(column) for column, _, _ in CLOCKS]
    if any(not isinstance(column, DATASET) or column.dtype.kind != "i" for column in columns) or (
        len({column.shape for column in columns}) != 1
    ):
        raise LogError(f"{where} lacks a column, or they differ in length")
    return ClockTrack(*columns)
