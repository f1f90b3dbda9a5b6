"""Blocks of aligned frames in a temporary file, so that a second pass over a log needs neither its rows nor memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.fuse.frames import Frames

_COLUMNS = ("time", "values", "valid", "clipped", "stale", "offsets")


class _ArrayHeader(NamedTuple):
    """Type and shape of an array in the file."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]


class FrameSpool:
    """Frames by quantity and temperatures by sensor, block by block, in a temporary file of 9 bytes per axis and frame,
    which is deleted with the object.
    """

    def __init__(self) -> None:
        self._file = TemporaryFile()  # noqa: SIM115, it lives as long as the spool
        self._blocks: list[tuple[dict[str, dict[str, _ArrayHeader]], dict[str, _ArrayHeader]]] = []
        self.frames = 0
        """Number of frames in all blocks."""

    def add(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> None:
        """Write the next block. OSError."""
        columns = {
            quantity: {name: self._put(column) for name in _COLUMNS if (column := getattr(part, name)) is not None}
            for quantity, part in frames.items()
        }
        self._blocks.append((columns, {sensor: self._put(column) for sensor, column in degc.items()}))
        self.frames += len(next(iter(frames.values())).time)

    def blocks(self) -> Iterator[tuple[dict[str, Frames], dict[str, Floats]]]:
        """Yield all blocks in their order."""
        self._file.seek(0)
        for columns, degc in self._blocks:
            frames = {
                quantity: Frames(**{name: self._get(place) for name, place in part.items()})
                for quantity, part in columns.items()
            }
            yield frames, {sensor: self._get(place) for sensor, place in degc.items()}

    def _put(self, column: npt.NDArray[Any]) -> _ArrayHeader:
        self._file.write(np.ascontiguousarray(column).data)
        return _ArrayHeader(column.dtype, column.shape)

    def _get(self, place: _ArrayHeader) -> npt.NDArray[Any]:
        column = np.empty(place.shape, place.dtype)
        self._file.readinto(column.data)
        return column

    def close(self) -> None:
        """Close the file."""
        self._file.close()
