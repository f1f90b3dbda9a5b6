"""The group `/events` of a fused file: which sensors failed, were left out and came back.

Texts have fixed lengths: others can't be read while a file is written (SWMR).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import h5py
import numpy as np

from imuarray.errors import LogError
from imuarray.fuse.faults import FaultEvent
from imuarray.log.guard import DAMAGE, MAX_TEXT_BYTES, read_texts

_TEXTS = {"sensor": 256, "kind": 32, "state": 32, "message": 1024}
"""The columns of text, and how many bytes of each are kept."""

_CHUNK = 16


class FusedEvent(NamedTuple):
    """One thing that became of a sensor: `kind` of fault and `state` ("isolated", "readmitted", ...) as `FaultEvent`
    has them, `message` the same for a person.
    """

    time_ns: int
    sensor: str
    kind: str
    state: str
    message: str


class StoredEvents:
    """The events of an open file, empty at first."""

    def __init__(self, file: h5py.File, epoch: str) -> None:
        self._group = file.create_group("events")
        self._group.create_dataset("time", (0,), np.int64, maxshape=(None,), chunks=(_CHUNK,))
        self._group["time"].attrs["units"] = f"nanoseconds since {epoch}"
        for name, length in _TEXTS.items():
            text = h5py.string_dtype("utf-8", length)
            self._group.create_dataset(name, (0,), text, maxshape=(None,), chunks=(_CHUNK,))

    def append(self, event: FaultEvent) -> None:
        """One more. OSError."""
        texts = (event.sensor, event.kind, event.state, event.sentence)
        kept = [_shortened(text, length) for text, length in zip(texts, _TEXTS.values(), strict=True)]
        for name, value in zip(("time", *_TEXTS), (event.time_ns, *kept), strict=True):
            column = self._group[name]
            column.resize(column.shape[0] + 1, axis=0)
            column[-1] = value
            column.flush()


def events_in(file: h5py.File, where: str) -> tuple[FusedEvent, ...]:
    """The events of a file, as far as every column has them: a writing that was cut short leaves some longer than
    others. LogError where they can't be read.
    """
    group = file.get("events")
    if group is None:
        return ()
    try:
        rows = zip(*(_column(group[name]) for name in ("time", *_TEXTS)), strict=False)
        return tuple(FusedEvent(int(time), *(_plain(text) for text in texts)) for time, *texts in rows)
    except DAMAGE:
        raise LogError(f"{where}: its events can't be read") from None


def _column(column: h5py.Dataset) -> list[Any]:
    """All of a column; ValueError for more than anybody has of events, before it is read."""
    if column.ndim != 1 or column.nbytes > MAX_TEXT_BYTES:
        raise ValueError("no column of events")
    return read_texts(column)


def _shortened(text: str, length: int) -> bytes:
    """The first bytes of a text, no character cut through."""
    return text.encode()[:length].decode(errors="ignore").encode()


def _plain(text: object) -> str:
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)
