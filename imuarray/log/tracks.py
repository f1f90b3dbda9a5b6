"""What a log has beside its sensors: what the box really felt, what a reference saw, what clocks said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from imuarray.errors import LogError
from imuarray.log.columns import DATASET, GROUP, NamedColumn
from imuarray.log.layout import CLOCKS


class Track(NamedTuple):
    """`/truth` or `/reference`: columns time (n,) ns, specific_force (n, 3) m/s2 and angular_rate (n, 3) rad/s in
    the box frame, temperature (n,) degC; None for what the log does not have.
    """

    time: NamedColumn
    specific_force: NamedColumn | None
    angular_rate: NamedColumn | None
    temperature: NamedColumn | None


class ClockTrack(NamedTuple):
    """`/clocks`: columns (n,) ns of the log's own time and of four clocks of the machine (`imuarray.log.format`)."""

    time: NamedColumn
    monotonic: NamedColumn
    monotonic_raw: NamedColumn
    boottime: NamedColumn
    realtime: NamedColumn


def track_of(group: Any, where: str) -> Track:
    """The track that is a group of the file; LogError, with `where` it is, if it isn't one."""
    if not isinstance(group, GROUP) or "time" not in group:
        raise LogError(f"{where} has no time")
    columns = [group.get(column) for column in Track._fields]
    for column, tail in zip(columns, ((), (3,), (3,), ()), strict=True):
        if column is not None and column.shape != (*group["time"].shape, *tail):
            raise LogError(f"{where}: a column has another shape than time")
    return Track(*_named(columns, where))


def clocks_of(group: Any, where: str) -> ClockTrack:
    """The clocks that are a group of the file; LogError, with `where` it is, if it isn't that."""
    columns = [group.get(column) for column, _, _ in CLOCKS]
    if any(not isinstance(column, DATASET) or column.dtype.kind != "i" for column in columns) or (
        len({column.shape for column in columns}) != 1
    ):
        raise LogError(f"{where} lacks a column, or they differ in length")
    return ClockTrack(*_named(columns, where))


def _named(columns: Sequence[Any], where: str) -> Iterator[Any]:
    """The columns that there are, None for the others."""
    return (None if one is None else NamedColumn(one, f"{where}: {one.name.rsplit('/', 1)[-1]}") for one in columns)
