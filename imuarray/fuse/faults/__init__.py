"""Fault detection and isolation: sensors that fail are detected, reported and left out while the others go on.

::

    frames -> window -> look (parity residuals of those in use, beside the normal model of each axis)
                     -> hypotheses (one axis? a whole sensor? by likelihood ratio) -> judge -> masked frames, events
"""

from imuarray.fuse.faults.exclusions import FaultEvent
from imuarray.fuse.faults.kinds import Ranges
from imuarray.fuse.faults.monitor import ExclusionMasks, FaultMonitor

__all__ = ["ExclusionMasks", "FaultEvent", "FaultMonitor", "Ranges"]
