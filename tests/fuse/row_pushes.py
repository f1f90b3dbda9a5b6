"""Rows of a log that are pushed into a fusion like arriving rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imuarray.fuse import FusedBlock, FusionStream
from imuarray.fuse.alignment import cut
from imuarray.log import Block, Log
from tests.fuse.conftest import joined

AXES = ("+X+Y+Z", "-Y-X-Z", "+Y+X-Z", "+Y-X+Z")


def read(log: Log) -> dict[str, Block]:
    """All rows of every sensor."""
    result = {}
    for name, sensor in log.sensors.items():
        degrees = sensor.temperature_counts
        compensated = {
            column: np.asarray(sensor.compensated(column)[:])
            for column in ("temperature", "pressure")
            if sensor.quantity == "pressure"
        }
        result[name] = Block(
            np.asarray(sensor.time[:]),
            np.asarray(sensor.counts[:]),
            np.asarray(sensor.status[:]),
            None if degrees is None else np.asarray(degrees[:]),
            compensated,
        )
    return result


def push_rows(stream: FusionStream, rows: dict[str, Block], seed: int, most_s: float) -> Iterator[FusedBlock]:
    """Pieces of random lengths; no sensor more than a piece ahead of the others."""
    rng = np.random.default_rng(seed)
    done, reached = dict.fromkeys(rows, 0), dict.fromkeys(rows, 0)
    while left := [name for name, block in rows.items() if done[name] < len(block.time)]:
        name = min(left, key=lambda name: reached[name])
        time = rows[name].time
        until = int(time[done[name]] + rng.uniform(0, most_s) * 1e9)
        stop = max(done[name] + 1, int(np.searchsorted(time, until)))
        yield from stream.push(name, cut(rows[name], slice(done[name], stop)))
        done[name], reached[name] = stop, int(time[stop - 1])
    yield from stream.finish()


def same(one: list[FusedBlock], other: list[FusedBlock]) -> None:
    """To rounding: 1e-9 of the largest value."""
    for quantity in one[0].triads:
        (time, triad), (again, second) = (joined(blocks, quantity) for blocks in (one, other))
        assert (time == again).all()
        assert (np.isnan(triad) == np.isnan(second)).all()
        assert np.nanmax(np.abs(triad - second)) < 1e-9 * np.nanmax(np.abs(triad))
        used, also = (np.concatenate([block.used[quantity] for block in blocks]) for blocks in (one, other))
        assert (used == also).all()
