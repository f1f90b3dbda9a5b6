"""A log seen while it is written: what there is to see (`Watch`); as text (`imuarray.monitor.text`), and as a page
(`imuarray.monitor.server`, which needs the extra `monitor`).
"""

from imuarray.monitor.snapshot import FusedView, SensorView, Snapshot
from imuarray.monitor.watch import Watch

__all__ = ["FusedView", "SensorView", "Snapshot", "Watch"]
