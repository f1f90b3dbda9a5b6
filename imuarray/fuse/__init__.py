"""One specific force and one angular rate from all sensors of an array: the simple average and the paper's three
techniques.
"""

from imuarray.fuse.evaluate import Error, errors_of, evaluate
from imuarray.fuse.fuse import FusedBlock, fuse
from imuarray.fuse.store import write_fused
from imuarray.fuse.techniques import NEEDS_NOISE, TECHNIQUES

__all__ = ["NEEDS_NOISE", "TECHNIQUES", "Error", "FusedBlock", "errors_of", "evaluate", "fuse", "write_fused"]
