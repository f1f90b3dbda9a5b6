"""Pipelines from aligned frames to the fused result: objects that process consecutive blocks.

`FusionNotes` are the estimates and remarks of techniques on the sensors after the fusion of a log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

from imuarray.arrays import Floats, Times
from imuarray.errors import FusionError
from imuarray.fuse.frames import Axis, Estimate, Frames, FusedBlock, axis_bits
from imuarray.fuse.techniques import TECHNIQUES, Technique
from imuarray.spelling import guess


@dataclass(frozen=True)
class LearnedBias:
    """The current slow error of one axis in m/s2 or rad/s along the axis, without errors of its response, with its
    standard deviation and the prior one (`sd_before`).
    """

    axis: str
    bias: float
    sd: float
    sd_before: float


@dataclass(frozen=True)
class FusionNotes:
    """The estimated slow errors of every axis, by quantity (of `optimal`), and `remarks`: sentences."""

    biases: Mapping[str, Sequence[LearnedBias]] = field(default_factory=dict)
    remarks: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the notes for JSON, in SI."""
        biases = {quantity: [asdict(bias) for bias in result] for quantity, result in self.biases.items()}
        return {"biases": biases, "remarks": list(self.remarks)}


@runtime_checkable
class RemarkSource(Protocol):
    """A technique with remarks on its axes."""

    def remarks(self, quantity: str) -> list[str]:
        """Return sentences; `quantity` is what the axes measure, as in a log."""
        ...


@runtime_checkable
class NoteSource(Protocol):
    """A pipeline with notes."""

    def notes(self) -> FusionNotes:
        """Return the notes on the frames so far."""
        ...


def notes_of(pipeline: object) -> FusionNotes:
    """Return the notes of a pipeline; empty if it has none."""
    return pipeline.notes() if isinstance(pipeline, NoteSource) else FusionNotes()


Out = TypeVar("Out")
Out_co = TypeVar("Out_co", covariant=True)


class Pipeline(Protocol[Out_co]):
    """An estimator of the whole array. All quantities of a block have the same times; a block may have any length, and
    the result does not depend on it. A pipeline may return frames later, in order.
    """

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Out_co]:
        """Process the next block of frames by quantity, and return the results that are complete. `degc` are
        temperatures (n,) of the elements of sensors with a thermometer, by sensor, NaN if not yet known.
        """
        ...

    def finish(self) -> Iterator[Out_co]:
        """Return the remaining results; there are none unless a pipeline holds frames back."""
        return iter(())


PipelineFactory = Callable[[Mapping[str, Sequence[Axis]], float], Pipeline[FusedBlock]]
"""Creates a pipeline from the axes by quantity and the seconds from frame to frame; FusionError if the axes are not
sufficient.
"""


class QuantityPipeline(Pipeline[FusedBlock]):
    """A technique applied to each quantity separately, and nothing else: a stream may compute the same faster."""

    def __init__(self, axes: Mapping[str, Sequence[Axis]], technique: str) -> None:
        """FusionError if the technique does not exist, or if the axes are not sufficient for it."""
        if technique not in TECHNIQUES:
            allowed = ", ".join(TECHNIQUES)
            raise FusionError(f"technique {technique!r}: allowed are {allowed}{guess(technique, TECHNIQUES)}")
        self.axes: Mapping[str, Sequence[Axis]] = dict(axes)
        self.techniques: Mapping[str, Technique] = {
            quantity: TECHNIQUES[technique](members) for quantity, members in axes.items()
        }

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
        """See `Pipeline`."""
        time = next(iter(frames.values())).time
        yield fused_block(
            time, {quantity: self.techniques[quantity](part) for quantity, part in frames.items()}, self.axes
        )

    def notes(self) -> FusionNotes:
        """Return the remarks of the techniques."""
        remarks: list[str] = []
        for quantity, technique in self.techniques.items():
            source: object = technique
            remarks += source.remarks(quantity) if isinstance(source, RemarkSource) else []
        return FusionNotes(remarks=remarks)


class TechniqueSet(Pipeline[dict[str, FusedBlock]]):
    """A `Pipeline` of several techniques, each applied to each quantity separately: yields blocks by technique."""

    def __init__(self, axes: Mapping[str, Sequence[Axis]], names: Sequence[str]) -> None:
        """FusionError as `QuantityPipeline`."""
        self._each = {name: QuantityPipeline(axes, name) for name in names}

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[dict[str, FusedBlock]]:
        """See `Pipeline`."""
        yield {name: next(each(frames, degc)) for name, each in self._each.items()}


class ObservedPipeline(Pipeline[Out]):
    """A pipeline before which `observe` is called with each block of frames and their temperatures."""

    def __init__(
        self, inner: Pipeline[Out], observe: Callable[[Mapping[str, Frames], Mapping[str, Floats]], None]
    ) -> None:
        self._inner, self._observe = inner, observe

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Out]:
        """See `Pipeline`."""
        self._observe(frames, degc)
        yield from self._inner(frames, degc)

    def finish(self) -> Iterator[Out]:
        """See `Pipeline`."""
        return self._inner.finish()

    def notes(self) -> FusionNotes:
        """Return the notes of the inner pipeline."""
        return notes_of(self._inner)


class ComparisonPipeline(ObservedPipeline[FusedBlock]):
    """A `Pipeline` of a technique applied to each quantity separately, and of another technique on the same frames:
    `observe` is called with the other's block before the technique's is returned.
    """

    def __init__(
        self, axes: Mapping[str, Sequence[Axis]], technique: str, other: str, observe: Callable[[FusedBlock], None]
    ) -> None:
        """FusionError as `QuantityPipeline`."""
        compared = QuantityPipeline(axes, other)
        super().__init__(QuantityPipeline(axes, technique), lambda frames, degc: observe(next(compared(frames, degc))))


def fused_block(time: Times, estimates: Mapping[str, Estimate], axes: Mapping[str, Sequence[Axis]]) -> FusedBlock:
    """Return the fused block of the estimates, by quantity, of frames at `time` (n,) ns."""
    return FusedBlock(
        time,
        {quantity: estimate.triad_box for quantity, estimate in estimates.items()},
        {quantity: estimate.covariance_box for quantity, estimate in estimates.items()},
        {quantity: axis_bits(estimate.used, axes[quantity]) for quantity, estimate in estimates.items()},
    )
