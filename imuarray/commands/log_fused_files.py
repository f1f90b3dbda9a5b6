"""The files of `log --fuse`: one result, or one for each part of a log that is cut into parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from imuarray.fuse import FaultEvent, FusedBlock
from imuarray.fuse.fused_file import LiveFused
from imuarray.log.rotate import part_of, runs_of


def beside(log: Path) -> Path:
    """Where the result of a log goes if nobody says it: where `imuarray monitor` looks for it."""
    return log.with_name(f"{log.stem}_fused.h5")


def names_of(path: Path, log: Path, number: int, rotate_s: float | None) -> tuple[Path, Path]:
    """The fused file and the log of a part, counted from 0, of which the whole would be called `path` and `log`."""
    if rotate_s is None:
        return path, log
    part = part_of(log, number + 1)
    return beside(part) if path == beside(log) else part_of(path, number + 1), part


class FusedFiles:
    """Fused frames as they come, each in the file of the part in which its time lies.

    Of a log RUN.h5 in parts RUN_001.h5, RUN_002.h5, ... the results are RUN_001_fused.h5, ..., or where another name
    was given, FUSED_001.h5, ...
    """

    def __init__(
        self,
        path: Path,
        log: Path,
        *,
        epoch: str,
        technique: str,
        calibration: str,
        sensors: Mapping[str, Sequence[str]],
        rotate_s: float | None = None,
        force: bool = False,
    ) -> None:
        """`rotate_s`: the length of a part. OutputExistsError, OutputError."""
        self._path, self._log, self._force = path, log, force
        self._epoch, self._technique, self._calibration, self._sensors = epoch, technique, calibration, sensors
        self._rotate_s, self._every_ns = rotate_s, None if rotate_s is None else round(rotate_s * 1e9)
        self.origin_ns = 0
        """When the first part begins."""
        self.paths: list[Path] = []
        self.frames = 0
        self._number = 0
        self._file = self._begun(0)

    def append(self, block: FusedBlock) -> None:
        """More frames. OSError, OutputExistsError, OutputError."""
        for number, rows in self._split(block):
            if number > self._number:
                self._file.close()
                self._number, self._file = number, self._begun(number)
            self._file.append(_part(block, rows))
            self.frames += rows.stop - rows.start

    def event(self, event: FaultEvent) -> None:
        """What became of a sensor, into the file of the last frames. OSError."""
        self._file.event(event)

    def _begun(self, number: int) -> LiveFused:
        path, log = names_of(self._path, self._log, number, self._rotate_s)
        made = LiveFused(
            path,
            sensors=self._sensors,
            force=self._force,
            epoch=self._epoch,
            technique=self._technique,
            log=str(log),
            calibration=self._calibration,
        )
        self.paths.append(path)
        return made

    def _split(self, block: FusedBlock) -> list[tuple[int, slice]]:
        """The number of a part, and the frames in it; what is before the first one is of the first one."""
        if self._every_ns is None or not len(block.time):
            return [(0, slice(0, len(block.time)))]
        return runs_of(np.maximum((block.time - self.origin_ns) // self._every_ns, 0))

    def close(self) -> None:
        """Complete the last file."""
        self._file.close()


def _part(block: FusedBlock, rows: slice) -> FusedBlock:
    return FusedBlock(
        block.time[rows],
        {quantity: values[rows] for quantity, values in block.triads.items()},
        {quantity: values[rows] for quantity, values in block.covariances.items()},
        {quantity: values[rows] for quantity, values in block.used.items()},
    )
