"""`ranges`: low and high measuring ranges blended, of one design or several, without a step at the low range's end.

`fading` determines how far a low-range sensor may be trusted (away from the end of its range, its filter settled),
`relative` tracks the differences between the sensors while all of them are trusted, `blend` combines the two.
"""

from imuarray.fuse.techniques.ranges.blend import RangeBlend, changes, range_weights, ranges
from imuarray.fuse.techniques.ranges.fading import TAPER, Fading
from imuarray.fuse.techniques.ranges.relative import Relative, Tracker

__all__ = ["TAPER", "Fading", "RangeBlend", "Relative", "Tracker", "changes", "range_weights", "ranges"]
