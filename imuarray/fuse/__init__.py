"""One specific force and one angular rate from all sensors of an array: the simple average and the paper's three
techniques.
"""

from imuarray.fuse.axes import Axis, axes_of
from imuarray.fuse.evaluate import Error, errors_of, evaluate, quiet_noise
from imuarray.fuse.faults import FaultEvent
from imuarray.fuse.frames import Estimate, Frames, FusedBlock
from imuarray.fuse.fuse import NAMES, NEEDS_NOISE, OPTIMAL, Watch, aligned, fuse, live
from imuarray.fuse.pipeline import EachAlone, Making, Pipeline, fused_block
from imuarray.fuse.running import running_temperatures
from imuarray.fuse.store import FusedHead, read_fused, read_fused_head, write_fused
from imuarray.fuse.stream import FusionStream
from imuarray.fuse.techniques import TECHNIQUES, changes
from imuarray.fuse.thermal import element_temperatures, slopes_of

__all__ = [
    "NAMES",
    "NEEDS_NOISE",
    "OPTIMAL",
    "TECHNIQUES",
    "Axis",
    "EachAlone",
    "Error",
    "Estimate",
    "FaultEvent",
    "Frames",
    "FusedBlock",
    "FusedHead",
    "FusionStream",
    "Making",
    "Pipeline",
    "Watch",
    "aligned",
    "axes_of",
    "changes",
    "element_temperatures",
    "errors_of",
    "evaluate",
    "fuse",
    "fused_block",
    "live",
    "quiet_noise",
    "read_fused",
    "read_fused_head",
    "running_temperatures",
    "slopes_of",
    "write_fused",
]
