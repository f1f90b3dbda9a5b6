"""The log: raw counts in HDF5, the only interface between acquisition and analysis."""

from imuarray.log.columns import Track
from imuarray.log.reader import Log, open_log, require_distinct, require_logs
from imuarray.log.rotate import RotatingWriter
from imuarray.log.sensor_log import SensorLog, first_at
from imuarray.log.writer import Block, LogWriter, Stimulus

__all__ = [
    "Block",
    "Log",
    "LogWriter",
    "RotatingWriter",
    "SensorLog",
    "Stimulus",
    "Track",
    "first_at",
    "open_log",
    "require_distinct",
    "require_logs",
]
