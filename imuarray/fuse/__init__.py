"""One specific force and one angular rate from all sensors of an array: the simple average, the paper's three
techniques, and the estimator of the whole array that contains them.

`imuarray.fuse(log, calibration, technique)` does all of it and returns a `FusedResult` (`imuarray.analysis.fuse`);
the function `fuse` below gives the frames block by block.
"""

from imuarray.callable_package import make_callable
from imuarray.fuse.axes import Axis, axes_of
from imuarray.fuse.coasting import Coasting, Errors, coasting
from imuarray.fuse.compare import Comparison, Score, compare, technique_names
from imuarray.fuse.element_temperature import (
    causal_temperatures,
    element_temperatures,
    mismatch_sentences,
    slopes_of,
    temperature_mismatch,
    with_mismatch,
)
from imuarray.fuse.evaluation import (
    Consistency,
    Error,
    ErrorFrames,
    Evaluation,
    QuietNoise,
    consistency,
    error_frames,
    error_of,
    errors_of,
    evaluate,
    quiet_noise,
)
from imuarray.fuse.faults import FaultEvent
from imuarray.fuse.frames import Estimate, Frames, FusedBlock
from imuarray.fuse.fuse import NAMES, NEEDS_NOISE, OPTIMAL, Watch, aligned, fuse, live
from imuarray.fuse.fused_file import FusedEvent, FusedHead, read_fused, read_fused_events, read_fused_head, write_fused
from imuarray.fuse.fused_result import FusedResult
from imuarray.fuse.fusion_notes import FusionNotes, notes_of
from imuarray.fuse.gains import Gain, Ratio, gains, ratio_of
from imuarray.fuse.pipeline import ComparisonPipeline, Pipeline, PipelineFactory, QuantityPipeline, fused_block
from imuarray.fuse.stream import FusionStream
from imuarray.fuse.techniques import TECHNIQUES, changes

__all__ = [
    "NAMES",
    "NEEDS_NOISE",
    "OPTIMAL",
    "TECHNIQUES",
    "Axis",
    "Coasting",
    "Comparison",
    "ComparisonPipeline",
    "Consistency",
    "Error",
    "ErrorFrames",
    "Errors",
    "Estimate",
    "Evaluation",
    "FaultEvent",
    "Frames",
    "FusedBlock",
    "FusedEvent",
    "FusedHead",
    "FusedResult",
    "FusionNotes",
    "FusionStream",
    "Gain",
    "Pipeline",
    "PipelineFactory",
    "QuantityPipeline",
    "QuietNoise",
    "Ratio",
    "Score",
    "Watch",
    "aligned",
    "axes_of",
    "causal_temperatures",
    "changes",
    "coasting",
    "compare",
    "consistency",
    "element_temperatures",
    "error_frames",
    "error_of",
    "errors_of",
    "evaluate",
    "fuse",
    "fused_block",
    "gains",
    "live",
    "mismatch_sentences",
    "notes_of",
    "quiet_noise",
    "ratio_of",
    "read_fused",
    "read_fused_events",
    "read_fused_head",
    "slopes_of",
    "technique_names",
    "temperature_mismatch",
    "with_mismatch",
    "write_fused",
]

make_callable(__name__)
