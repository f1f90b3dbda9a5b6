"""The compiled parts of `optimal`: frames of a segment in which the same rows are in use (`_segments.c`), and the steps
of the filter of slow errors and of its smoother (`_states.c`).

They compute the same as the NumPy code of `SegmentView`, `solve`, `Dynamics` and `SegmentEvidence` (if no axis is
clipped and the usual gain applies) and of `imuarray.fuse.optimal.states`, to rounding. They are not available if the
package was installed without a C compiler.
"""

from __future__ import annotations

__all__ = ["COMPILED", "begin", "correct", "drifts", "effect", "frames", "measure", "predict", "smooth", "turn_back"]

try:
    from imuarray.fuse.optimal._segments import begin, frames
    from imuarray.fuse.optimal._states import correct, drifts, effect, measure, predict, smooth, turn_back
except ImportError:  # installed without a C compiler
    COMPILED = False
else:
    COMPILED = True
