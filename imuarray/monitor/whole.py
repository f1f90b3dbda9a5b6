"""A log that nobody writes, read from its file: finished, or interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from imuarray.errors import LogError
from imuarray.log import Log, SensorLog, open_log
from imuarray.monitor.backlog import Backlog
from imuarray.monitor.held import Attributes
from imuarray.monitor.snapshot import FINISHED, INTERRUPTED
from imuarray.monitor.source import Seen
from imuarray.units import INERTIAL


class Whole:
    """A log that nobody writes: finished, or interrupted. LogError."""

    def __init__(self, path: Path, seen: Seen) -> None:
        self.path, self.seen = path, seen
        log = open_log(path)
        try:
            self.state = FINISHED if log.state == "finished" else INTERRUPTED
            self.source, self.epoch, self.frame_rate_hz = log.source, log.epoch, log.frame_rate_hz
            self.attributes: dict[str, Attributes] = {
                name: dict(sensor.attributes) for name, sensor in log.sensors.items()
            }
            self.row_bytes: dict[str, int] = {}
            self.backlog = Backlog({}, lambda: None)
            seen.expect(log.sensors)
            seen.told.take_events(sorted(log.events, key=lambda event: event.time_ns))
        except BaseException:
            log.close()
            raise
        self._log: Log | None = log

    def read(self) -> int:
        """The last rows, once; then nothing is new."""
        if self._log is None:
            return 0
        log, self._log = self._log, None
        ends = [int(sensor.time[-1]) for sensor in log.sensors.values() if len(sensor)]
        start_ns = max(ends, default=0) - self.seen.span_ns
        columns: dict[str, tuple[Any, int]] = {}
        for name, sensor in log.sensors.items():
            if not len(sensor):
                continue
            first = sensor.between(start_ns, start_ns).start
            self.seen.windows[name].begins_behind(first, sensor.time)
            self.seen.windows[name].add(_rows_of(sensor, first))
            if sensor.quantity in INERTIAL:
                columns[name] = (sensor.time, first)
        self.backlog = Backlog(columns, log.close)
        return sum(len(sensor) for sensor in log.sensors.values())

    def close(self) -> None:
        """Let go of the file."""
        self.backlog.close()
        if self._log is not None:
            self._log.close()


def _rows_of(sensor: SensorLog, first: int) -> dict[str, Any]:
    """The columns of a sensor from a row on."""
    columns = {"time": sensor.time, "counts": sensor.counts, "status": sensor.status}
    if sensor.temperature_counts is not None:
        columns["temperature_counts"] = sensor.temperature_counts
    for name in ("temperature", "pressure") if sensor.quantity == "pressure" else ():
        try:
            columns[name] = sensor.compensated(name)
        except LogError:  # imported without it, say
            continue
    return {name: np.asarray(column[first:]) for name, column in columns.items()}
