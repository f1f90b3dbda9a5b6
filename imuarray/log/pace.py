"""Frames that a logger missed, told from the times of a log's rows.

A logger begins frames on a grid: frame k is due k periods behind the first one. A frame whose time has passed before
the one before it has ended is missed; the grid stays. So the frames that are missing between two rows of a sensor that
is read once a frame are the periods between them less the rows: however many, and however evenly the others come.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imuarray.log.reader import Log
from imuarray.log.sensor_log import SensorLog
from imuarray.units import INERTIAL

_SAME_CLOCK = frozenset({"i2c", "emulated", "replay"})
"""Sources whose times are of the clock by which the logger begins its frames: a period is exact on it."""
_EARLY = 0.25
"""Of a period, by which a row may come too early for its frame: the first row may have taken a little longer."""
_OWN_PACE = 1.25
"""A sensor that gives more rows than this a frame has a queue, which it fills at a pace of its own."""


def frame_period_ns(source: str, frame_rate_hz: float) -> int:
    """The period of the grid on which the rows of a log from `source` lie; 0 if they lie on none that is known."""
    return round(1e9 / frame_rate_hz) if source in _SAME_CLOCK and frame_rate_hz > 0 else 0


def is_read_once_a_frame(chip_rate_hz: float, rate_hz: float, frame_period_ns: int) -> bool:
    """Whether a sensor that gives `rate_hz` rows a second, of a chip that has `chip_rate_hz` values a second (0: not
    known), gives one in every frame.
    """
    if frame_period_ns <= 0:
        return False
    frame_rate_hz = 1e9 / frame_period_ns
    keeps_up = chip_rate_hz <= 0 or chip_rate_hz >= frame_rate_hz * (1 - 1e-6)
    return bool(keeps_up and rate_hz <= _OWN_PACE * frame_rate_hz)


def missing_rows(first_ns: int, last_ns: npt.NDArray[np.int64], rows: int, frame_period_ns: int) -> int:
    """Of a sensor that is read once a frame and has `rows`: how many are missing between its first and its newest one.

    `last_ns` (1 or 2,) are the times of its newest rows. Sensors are read there and back: a row that has as many before
    it as the first one, or two more, and so on, is a whole number of periods behind it but for what it is late.
    """
    if rows < 2 or frame_period_ns <= 0:
        return 0
    back = min((rows - 1) % 2, len(last_ns) - 1)
    periods = math.floor((int(last_ns[-1 - back]) - first_ns) / frame_period_ns + _EARLY)
    return max(0, periods - (rows - 1 - back))


def missed_by_all(missing: Sequence[tuple[int, int]], frame_period_ns: int) -> int | None:
    """Frames that were missed, from (time of the first row, rows that are missing) of each sensor that is read once a
    frame; None for none of them. What is missing from one alone is a reading that was lost. The first frame may have
    taken several periods: then a sensor that was read late in it has seen the fewer of them pass.
    """
    begins_ns = min((first_ns for first_ns, _ in missing), default=0)
    return min((count + (first_ns - begins_ns) // frame_period_ns for first_ns, count in missing), default=None)


def missed_frames(log: Log) -> int | None:
    """Frames missed between the first row and the last one of `log`; None where its rows do not say: it tells no frame
    rate, or is of another clock.
    """
    period_ns = frame_period_ns(log.source, log.frame_rate_hz)
    sensors = [sensor for sensor in log.sensors.values() if sensor.quantity in INERTIAL and len(sensor) > 1]
    missing = [
        (int(sensor.time[0]), missing_rows(int(sensor.time[0]), sensor.time[len(sensor) - 2 :], len(sensor), period_ns))
        for sensor in sensors
        if is_read_once_a_frame(sensor.rate_hz, _rate_hz(sensor), period_ns)
    ]
    return missed_by_all(missing, period_ns)


def _rate_hz(sensor: SensorLog) -> float:
    rows = len(sensor)
    return (rows - 1) * 1e9 / max(1, int(sensor.time[rows - 1]) - int(sensor.time[0]))
