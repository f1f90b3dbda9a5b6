"""A log that is being written, read through its journal.

The reader goes on from where it was, so that a look costs what came since, however long the log is. What was before it
began is known from the last commits of the HDF5 file, whose rows are read as far as they were committed.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py

from imuarray.errors import LogError
from imuarray.log.commits import COMMITS, Commit, read_commits
from imuarray.log.hdf5_superblock import UnclosedFile
from imuarray.log.inspection import refuse_hostile
from imuarray.log.interrupted import stored_preamble
from imuarray.log.journal import JournalReader, is_running, journal_of
from imuarray.log.layout import NOTES, Group, sensor_attributes
from imuarray.log.preamble import Preamble
from imuarray.log.untrusted_input import DAMAGE
from imuarray.monitor.backlog import Backlog
from imuarray.monitor.held import Attributes
from imuarray.monitor.snapshot import FINISHED, INTERRUPTED, WRITTEN
from imuarray.monitor.source import Seen, identity
from imuarray.units import INERTIAL

_SENSORS = "sensors/"
_MOST_BYTES = 1 << 25
"""Of the journal that are read at one look: after a long sleep it takes several to catch up."""


class Growing:
    """A log that is being written. LogError, OSError if it can't be read (yet)."""

    def __init__(self, path: Path, seen: Seen) -> None:
        """Of the rows from before the last `seen.span_ns` at least are read at the first `read`."""
        self.path, self.state, self.seen = path, WRITTEN, seen
        self._journal_file = identity(journal_of(path))
        self._reader = JournalReader(path)
        try:
            self._begin()
        except BaseException:
            self._reader.close()
            raise

    def _begin(self) -> None:
        seen, preamble = self.seen, self._reader.preamble
        seen.expect(header.name for header in preamble.sensors)
        self.source, self.epoch, self.frame_rate_hz = preamble.source, preamble.epoch, preamble.frame_rate_hz
        groups = self._reader.groups
        self.row_bytes = {group.path: group.row_bytes for group in groups}
        file = _opened(self.path, preamble)
        try:
            self.attributes: dict[str, Attributes] = {
                header.name: sensor_attributes(header) for header in preamble.sensors
            }
            commits = read_commits(file[COMMITS][:], preamble.identity, groups)
            commit = _before(file, groups, commits, seen.span_ns)
            rows = commit.rows if commit else (0,) * len(groups)
            self._mark = commit.mark if commit else self._reader.start
            columns = {}
            for group, count in zip(groups, rows, strict=True):
                name = group.path.removeprefix(_SENSORS)
                if group.path == NOTES:
                    seen.told.take_stored(file[NOTES]["text"], count)
                elif name in seen.windows and count:
                    seen.windows[name].begins_behind(count, file[group.path]["time"])
                    if self.attributes[name].get("quantity") in INERTIAL:
                        columns[name] = (file[group.path]["time"], count)
            self.backlog = Backlog(columns, file.close)
        except BaseException as error:
            file.close()
            if isinstance(error, DAMAGE):
                raise LogError(f"{self.path}: damaged or malformed") from None
            raise

    def read(self) -> int:
        """What came into the journal since; where nothing did, whether anybody writes it still."""
        count = self._drain()
        if not count and not (self._is_ours() and is_running(self.path)):
            count = self._drain()  # what was written between the two looks
            if not count:
                self.state = INTERRUPTED if self._is_ours() else FINISHED
        return count

    def _drain(self) -> int:
        rows, most = 0, self._mark.position + _MOST_BYTES
        for record in self._reader.records(self._mark):
            self._mark = record.after
            group = self._reader.groups[record.group]
            if group.path == NOTES:
                self.seen.told.take(group.decode(record.payload, record.rows)["text"])
            elif group.path.startswith(_SENSORS):
                window = self.seen.windows[group.path.removeprefix(_SENSORS)]
                rows += window.add(group.decode(record.payload, record.rows))
            if record.after.position > most:
                break
        return rows

    def _is_ours(self) -> bool:
        """Whether the journal by that name is the one that is read."""
        return identity(journal_of(self.path)) == self._journal_file

    def close(self) -> None:
        """Let go of the files."""
        self.backlog.close()
        self._reader.close()


def _opened(path: Path, preamble: Preamble) -> h5py.File:
    """The HDF5 file of a log with that preamble; LogError."""
    try:
        file = h5py.File(UnclosedFile(path, check_heaps=False), "r")
    except DAMAGE:
        raise LogError(f"{path}: is not there yet, or damaged") from None
    try:
        with h5py.File(UnclosedFile(path), "r") as inspected:
            refuse_hostile(file, inspected, str(path))
        known = stored_preamble(path)
        if known is not None and known.identity != preamble.identity:
            raise LogError(f"{path}: its journal is another log's")
        return file
    except BaseException as error:
        file.close()
        if isinstance(error, DAMAGE):
            raise LogError(f"{path}: is no log that is being written") from None
        raise


def _before(file: h5py.File, groups: Sequence[Group], commits: list[Commit], span_ns: int) -> Commit | None:
    """The last commit behind which there are `span_ns` at least; None: all of the journal is wanted."""
    sensors = [(number, group.path) for number, group in enumerate(groups) if group.path.startswith(_SENSORS)]

    def newest_ns(commit: Commit) -> int:
        times = (file[path]["time"][commit.rows[number] - 1] for number, path in sensors if commit.rows[number])
        return max((int(time) for time in times), default=0)

    if not commits:
        return None
    end_ns = newest_ns(commits[-1])
    return next((commit for commit in reversed(commits[:-1]) if end_ns - newest_ns(commit) >= span_ns), None)
