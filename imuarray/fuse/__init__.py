"""Fusion of all sensors of an array into one specific force and one angular rate.

The techniques are the simple average, the paper's three techniques, and the estimator of the whole array that contains
them. `imuarray.fuse(log, calibration, technique)` does all of it and returns a `FusedResult`
(`imuarray.analysis.fuse`); the function `fuse` below gives the frames block by block. The names below are loaded when
first used, which saves half a second in a command that needs few of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imuarray.callable_package import make_callable, public_name

if TYPE_CHECKING:
    from imuarray.fuse.coasting_errors import Coasting, Errors, coasting
    from imuarray.fuse.comparison import Score, TechniqueComparison, compare, technique_names
    from imuarray.fuse.element_temperature import (
        causal_temperatures,
        element_temperatures,
        mismatch_sentences,
        slopes_of,
        temperature_mismatch,
        with_mismatch,
    )
    from imuarray.fuse.error_consistency import Consistency, consistency
    from imuarray.fuse.evaluation import (
        Error,
        ErrorEvaluation,
        ErrorFrames,
        Gain,
        QuietNoise,
        Ratio,
        error_frames,
        error_of,
        errors_of,
        evaluate,
        gains,
        quiet_noise,
        ratio_of,
    )
    from imuarray.fuse.faults import FaultEvent
    from imuarray.fuse.frames import Axis, Estimate, Frames, FusedBlock, axes_of
    from imuarray.fuse.fused_file import (
        FusedEvent,
        FusedHead,
        read_fused,
        read_fused_events,
        read_fused_head,
        write_fused,
    )
    from imuarray.fuse.fused_result import FusedResult
    from imuarray.fuse.fusion import NAMES, NEEDS_NOISE, OPTIMAL, Watch, aligned, fuse, live
    from imuarray.fuse.pipeline import (
        ComparisonPipeline,
        FusionNotes,
        Pipeline,
        PipelineFactory,
        QuantityPipeline,
        fused_block,
        notes_of,
    )
    from imuarray.fuse.stream import FusionStream
    from imuarray.fuse.techniques import TECHNIQUES, changes

_PUBLIC = {
    "coasting_errors": "Coasting Errors coasting",
    "comparison": "TechniqueComparison Score compare technique_names",
    "error_consistency": "Consistency consistency",
    "element_temperature": (
        "causal_temperatures element_temperatures mismatch_sentences slopes_of temperature_mismatch with_mismatch"
    ),
    "evaluation": (
        "Error ErrorFrames ErrorEvaluation Gain QuietNoise Ratio error_frames error_of errors_of evaluate gains "
        "quiet_noise ratio_of"
    ),
    "faults": "FaultEvent",
    "frames": "Axis Estimate Frames FusedBlock axes_of",
    "fusion": "NAMES NEEDS_NOISE OPTIMAL Watch aligned fuse live",
    "fused_file": "FusedEvent FusedHead read_fused read_fused_events read_fused_head write_fused",
    "fused_result": "FusedResult",
    "pipeline": "ComparisonPipeline FusionNotes Pipeline PipelineFactory QuantityPipeline fused_block notes_of",
    "stream": "FusionStream",
    "techniques": "TECHNIQUES changes",
}

_FORMER_NAMES = {"Comparison": "TechniqueComparison", "Evaluation": "ErrorEvaluation"}

__all__ = [
    "NAMES",
    "NEEDS_NOISE",
    "OPTIMAL",
    "TECHNIQUES",
    "Axis",
    "Coasting",
    "ComparisonPipeline",
    "Consistency",
    "Error",
    "ErrorEvaluation",
    "ErrorFrames",
    "Errors",
    "Estimate",
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
    "TechniqueComparison",
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


def __getattr__(name: str) -> Any:
    """Import a public name, or a former public name, on first use."""
    return public_name(__name__, _PUBLIC, _FORMER_NAMES.get(name, name))


make_callable(__name__)
