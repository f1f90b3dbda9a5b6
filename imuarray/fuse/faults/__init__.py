"""Fault detection and isolation: failed sensors are detected, reported and excluded, and the others remain in use.

::

    frames -> decision window -> parity residuals of the sensors in use, less the normal model of each axis
           -> hypotheses (one axis or a whole sensor, by likelihood ratio) -> isolation -> masked frames, events
"""

from imuarray.calibrate.runs import Ranges
from imuarray.fuse.faults.exclusions import FaultEvent
from imuarray.fuse.faults.monitor import ExclusionMasks, FaultMonitor

__all__ = ["ExclusionMasks", "FaultEvent", "FaultMonitor", "Ranges"]
