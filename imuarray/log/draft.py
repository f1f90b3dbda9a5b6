"""A finished log in the making: compressed columns in a file under a temporary name, renamed when it is complete."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from imuarray.log import groups
from imuarray.log.format import CACHE_BYTES, Event, Phase
from imuarray.log.layout import BESIDE, CHUNK, NOTES, Columns, Group, Notes, groups_of
from imuarray.log.preamble import Preamble
from imuarray.log.room import Allowance, unwritable
from imuarray.log.texts import CHECK_SUMS, check_sums

_EMPTY_BYTES = 1 << 14
"""What HDF5 takes for a group and its columns, generously."""

_TEXT_BYTES = 64
_SETTLED_BYTES = 1 << 24
_RENAMED = {"start_ns": "start", "end_ns": "end", "time_ns": "time"}


class Draft:
    """Rows go in by group and are written by whole chunks; `complete` makes the file the log at `path`."""

    def __init__(self, path: Path, preamble: Preamble, chunk: int = CHUNK, *, durable: bool = False) -> None:
        """Begin; LogError if nothing can be written there, ValueError for impossible headers.

        `durable` takes time: room is allocated before it is needed, not just looked for; `close` waits for the disk.
        """
        self.path = path
        self.part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self.groups = groups_of(preamble.sensors)
        self.notes = Notes()
        self._end_ns = 0
        self._epoch, self._chunk = preamble.epoch, chunk
        self._waiting: list[list[Columns]] = [[] for _ in self.groups]
        self._rows = [0] * len(self.groups)
        self._unwritten = [0] * len(self.groups)
        self._asked = 0
        try:
            self.part.unlink(missing_ok=True)
            self.file = h5py.File(self.part, "w", libver=groups.LIBVER, rdcc_nbytes=CACHE_BYTES)
            self._room = Allowance(self.part, path, allocate=durable)
        except OSError as error:
            with contextlib.suppress(OSError):  # a full disk takes the name, and then not the first bytes
                self.part.unlink(missing_ok=True)
            raise unwritable(path, error) from None
        self._durable = durable
        try:
            self._room.ask(len(self.groups) * _EMPTY_BYTES + len(preamble.config) * 4)
            self.file.attrs.update(groups.log_attributes(preamble))
            self.file.create_group("sensors")
            for header in preamble.sensors:
                groups.create_sensor(self.file, header, preamble.epoch, chunk, groups.COMPRESSED)
        except OSError as error:
            self.discard()
            raise unwritable(path, error) from None
        except BaseException:
            self.discard()
            raise

    def append(self, number: int, columns: Columns) -> None:
        """Add rows of the group of this number (`imuarray.log.layout`); LogError."""
        if self.groups[number].path == NOTES:
            self.notes.add(columns)
            return
        self._waiting[number].append(columns)
        self._unwritten[number] += len(columns["time"])
        if self._unwritten[number] >= self._chunk:
            whole = self._unwritten[number] - (self._rows[number] + self._unwritten[number]) % self._chunk
            self._write(number, whole)

    def _write(self, number: int, count: int) -> None:
        """Write the first `count` waiting rows of a group."""
        group = self.groups[number]
        if count == 0:
            return
        if group.path in BESIDE and group.path not in self.file:
            self._room.ask(_EMPTY_BYTES)
            groups.create_beside(self.file, group.path, self._epoch, self._chunk, groups.COMPRESSED)
        self._room.ask(count * group.row_bytes)
        self._asked += count * group.row_bytes
        rows = group.joined(self._waiting[number])
        self._end_ns = max(self._end_ns, int(rows["time"][count - 1]) + 1)
        for name, values in rows.items():
            dataset = self.file[group.path][name]
            dataset.resize(self._rows[number] + count, axis=0)
            dataset[self._rows[number] :] = values[:count]
        self._rows[number] += count
        self._unwritten[number] -= count
        self._waiting[number] = [{name: values[count:] for name, values in rows.items()}]
        if self._asked > _SETTLED_BYTES:
            self.file.flush()
            self._room.settle()
            self._asked = 0

    def flush(self) -> None:
        """Write everything that waits for its chunk to fill."""
        for number, count in enumerate(self._unwritten):
            self._write(number, count)
        self.file.flush()

    def stretches(self, number: int) -> Sequence[Columns]:
        """The rows of a group so far, read back."""
        self.flush()
        group: Group = self.groups[number]
        if self._rows[number] == 0:
            return []
        return [{name: np.asarray(self.file[group.path][name][:]) for name, _, _ in group.columns}]

    def close(self) -> None:
        """Write all there is and close; `part` is then a whole log, and if it is `durable` it is on the disk."""
        self.flush()
        texts = sum(len(event.sensor + event.kind + event.message) * 4 + _TEXT_BYTES for event in self.notes.events)
        self._room.ask(texts + sum(len(phase.name) * 4 + _TEXT_BYTES for phase in self.notes.phases) + 4 * _EMPTY_BYTES)
        for group in self.groups:
            if group.path in self.file:
                groups.attach_scales(self.file[group.path])
        names = [group.path.removeprefix("sensors/") for group in self.groups if "/" in group.path]
        if names:
            groups.write_plots(self.file, names)
        groups.write_table(self.file, "phases", Phase._fields, self.notes.phases_until(self._end_ns), _RENAMED)
        groups.write_table(self.file, "events", Event._fields, self.notes.events, _RENAMED)
        self.file.attrs[CHECK_SUMS] = np.array(check_sums(self.file), np.uint32)
        self.file.close()
        self._room.trim()
        if self._durable:
            self._room.sync()
        self._room.close()

    def publish(self, path: Path) -> None:
        """A closed draft takes its name: from now on it is the log at `path`."""
        self.part.replace(path)

    def discard(self) -> None:
        """Leave nothing behind."""
        with contextlib.suppress(Exception):
            self.file.close()
        self._room.close()
        self.part.unlink(missing_ok=True)
