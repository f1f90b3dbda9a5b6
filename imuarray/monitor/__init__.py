"""Monitoring of a log while it is written (`LogMonitor`): as text (`imuarray.monitor.text`) and as a page
(`imuarray.monitor.server`, which needs the extra `monitor`).
"""

from imuarray.monitor.log_monitor import LogMonitor
from imuarray.monitor.snapshot import FusedView, SensorView, Snapshot

__all__ = ["FusedView", "LogMonitor", "SensorView", "Snapshot"]
