"""A log seen while it is written: what there is to see (`Watch`), as a page (`serve`) and as text."""

from imuarray.monitor.snapshot import FusedView, SensorView, Snapshot
from imuarray.monitor.watch import Watch

__all__ = ["FusedView", "SensorView", "Snapshot", "Watch"]
