"""`ranges`: low and high measuring ranges blended, of one design or several, without a trace of the low one's end.

`fading` says how far a low-range sensor may be trusted (off the end of its range, its filter settled), `relative`
tracks what the sensors read differently while all of them are trusted, `blend` puts the two together.
"""

from imuarray.fuse.techniques.ranges.blend import RangeBlend, changes, range_weights, ranges
from imuarray.fuse.techniques.ranges.fading import TAPER, Fading
from imuarray.fuse.techniques.ranges.relative import Relative, Tracker

__all__ = ["TAPER", "Fading", "RangeBlend", "Relative", "Tracker", "changes", "range_weights", "ranges"]
