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
    from imuarray.fuse.axes import Axis, axes_of
    from imuarray.fuse.coasting import Coasting, Errors, coasting
    from imuarray.fuse.compare import Comparison, Score, compare, technique_names
    from imuarray.fuse.consistency import Consistency, consistency
    from imuarray.fuse.element_temperature import (
        causal_temperatures,
        element_temperatures,
        mismatch_sentences,
        slopes_of,
        temperature_mismatch,
        with_mismatch,
    )
    from imuarray.fuse.evaluation import (
        Error,
        ErrorFrames,
        Evaluation,
        QuietNoise,
        error_frames,
        error_of,
        errors_of,
        evaluate,
        quiet_noise,
    )
    from imuarray.fuse.faults import FaultEvent
    from imuarray.fuse.frames import Estimate, Frames, FusedBlock
    from imuarray.fuse.fuse import NAMES, NEEDS_NOISE, OPTIMAL, Watch, aligned, fuse, live
    from imuarray.fuse.fused_file import (
        FusedEvent,
        FusedHead,
        read_fused,
        read_fused_events,
        read_fused_head,
        write_fused,
    )
    from imuarray.fuse.fused_result import FusedResult
    from imuarray.fuse.fusion_notes import FusionNotes, notes_of
    from imuarray.fuse.gains import Gain, Ratio, gains, ratio_of
    from imuarray.fuse.pipeline import ComparisonPipeline, Pipeline, PipelineFactory, QuantityPipeline, fused_block
    from imuarray.fuse.stream import FusionStream
    from imuarray.fuse.techniques import TECHNIQUES, changes

_PUBLIC = {
    "Axis": "axes",
    "Coasting": "coasting",
    "Comparison": "compare",
    "ComparisonPipeline": "pipeline",
    "Consistency": "consistency",
    "Error": "evaluation",
    "ErrorFrames": "evaluation",
    "Errors": "coasting",
    "Estimate": "frames",
    "Evaluation": "evaluation",
    "FaultEvent": "faults",
    "Frames": "frames",
    "FusedBlock": "frames",
    "FusedEvent": "fused_file",
    "FusedHead": "fused_file",
    "FusedResult": "fused_result",
    "FusionNotes": "fusion_notes",
    "FusionStream": "stream",
    "Gain": "gains",
    "NAMES": "fuse",
    "NEEDS_NOISE": "fuse",
    "OPTIMAL": "fuse",
    "Pipeline": "pipeline",
    "PipelineFactory": "pipeline",
    "QuantityPipeline": "pipeline",
    "QuietNoise": "evaluation",
    "Ratio": "gains",
    "Score": "compare",
    "TECHNIQUES": "techniques",
    "Watch": "fuse",
    "aligned": "fuse",
    "axes_of": "axes",
    "causal_temperatures": "element_temperature",
    "changes": "techniques",
    "coasting": "coasting",
    "compare": "compare",
    "consistency": "consistency",
    "element_temperatures": "element_temperature",
    "error_frames": "evaluation",
    "error_of": "evaluation",
    "errors_of": "evaluation",
    "evaluate": "evaluation",
    "fuse": "fuse",
    "fused_block": "pipeline",
    "gains": "gains",
    "live": "fuse",
    "mismatch_sentences": "element_temperature",
    "notes_of": "fusion_notes",
    "quiet_noise": "evaluation",
    "ratio_of": "gains",
    "read_fused": "fused_file",
    "read_fused_events": "fused_file",
    "read_fused_head": "fused_file",
    "slopes_of": "element_temperature",
    "technique_names": "compare",
    "temperature_mismatch": "element_temperature",
    "with_mismatch": "element_temperature",
    "write_fused": "fused_file",
}

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


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    return public_name(__name__, _PUBLIC, name)


make_callable(__name__, _PUBLIC)
