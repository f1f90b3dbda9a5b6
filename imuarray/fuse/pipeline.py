"""Pipelines between aligned frames and the fused result: one object that is fed with consecutive blocks.

`FusionNotes` are remarks of techniques on the sensors, once a log is fused.
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
    """The slow error of one axis as it is felt now, in m/s2 or rad/s along the axis: all states but those of its
    response. `sd_before`: its standard deviation had the log told nothing.
    """

    axis: str
    bias: float
    sd: float
    sd_before: float


@dataclass(frozen=True)
class FusionNotes:
    """The slow errors that were learnt of every axis, by quantity (`optimal` does), and `remarks`: sentences."""

    biases: Mapping[str, Sequence[LearnedBias]] = field(default_factory=dict)
    remarks: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        """JSON-ready, in SI."""
        biases = {quantity: [asdict(bias) for bias in result] for quantity, result in self.biases.items()}
        return {"biases": biases, "remarks": list(self.remarks)}


@runtime_checkable
class RemarkSource(Protocol):
    """A technique that has something to say of the axes it was given."""

    def remarks(self, quantity: str) -> list[str]:
        """Sentences; `quantity` is what the axes measure, as a log calls it."""
        ...


@runtime_checkable
class NoteSource(Protocol):
    """A pipeline that has found out something."""

    def notes(self) -> FusionNotes:
        """Return the notes on the frames so far."""
        ...


def notes_of(pipeline: object) -> FusionNotes:
    """Return the notes of a pipeline; none if it has none to give."""
    return pipeline.notes() if isinstance(pipeline, NoteSource) else FusionNotes()


Out_co = TypeVar("Out_co", covariant=True)


class Pipeline(Protocol[Out_co]):
    """An estimator of the whole array. All quantities of a block have the same times; a block may have any length, and
    the result does not depend on it. A pipeline may hold frames back, in order.
    """

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Out_co]:
        """Return the frames that are ready after the next block, by quantity; `degc` are the temperatures (n,) of the
        elements of the sensors of which they are known, by sensor, NaN where not yet.
        """
        ...

    def finish(self) -> Iterator[Out_co]:
        """Return the frames that were held back."""
        ...


PipelineFactory = Callable[[Mapping[str, Sequence[Axis]], float], Pipeline[FusedBlock]]
"""The axes by quantity, and the seconds from frame to frame, to a pipeline for them; FusionError if they can't feed it.
"""


@runtime_checkable
class ByQuantity(Protocol):
    """A pipeline that does nothing but apply a technique to each quantity: there may be a shorter way to the same."""

    axes: Mapping[str, Sequence[Axis]]
    techniques: Mapping[str, Technique]


class QuantityPipeline:
    """A technique on each quantity by itself."""

    def __init__(self, axes: Mapping[str, Sequence[Axis]], technique: str) -> None:
        """FusionError if there is no such technique, or the axes can't feed it."""
        if technique not in TECHNIQUES:
            allowed = ", ".join(TECHNIQUES)
            raise FusionError(f"technique {technique!r}: allowed are {allowed}{guess(technique, TECHNIQUES)}")
        self.axes: Mapping[str, Sequence[Axis]] = dict(axes)
        self.techniques: Mapping[str, Technique] = {
            quantity: TECHNIQUES[technique](its) for quantity, its in axes.items()
        }

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
        """See `Pipeline`; nothing is held back."""
        time = next(iter(frames.values())).time
        yield fused_block(
            time, {quantity: self.techniques[quantity](part) for quantity, part in frames.items()}, self.axes
        )

    def finish(self) -> Iterator[FusedBlock]:
        """Return nothing: no frame is held back."""
        return iter(())

    def notes(self) -> FusionNotes:
        """Return the remarks of the techniques."""
        remarks: list[str] = []
        for quantity, technique in self.techniques.items():
            remarking: object = technique
            remarks += remarking.remarks(quantity) if isinstance(remarking, RemarkSource) else []
        return FusionNotes(remarks=remarks)


class TechniqueSet:
    """Several techniques, each on each quantity by itself: blocks by technique. A `Pipeline`."""

    def __init__(self, axes: Mapping[str, Sequence[Axis]], names: Sequence[str]) -> None:
        """FusionError as `QuantityPipeline`."""
        self._each = {name: QuantityPipeline(axes, name) for name in names}

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[dict[str, FusedBlock]]:
        """See `Pipeline`; nothing is held back."""
        yield {name: next(each(frames, degc)) for name, each in self._each.items()}

    def finish(self) -> Iterator[dict[str, FusedBlock]]:
        """Return nothing: no frame is held back."""
        return iter(())


class ComparisonPipeline:
    """A technique on each quantity by itself, and another one on the same frames: `heard` is given the other's block
    before the technique's is. A `Pipeline`.
    """

    def __init__(
        self, axes: Mapping[str, Sequence[Axis]], technique: str, other: str, heard: Callable[[FusedBlock], None]
    ) -> None:
        """FusionError as `QuantityPipeline`."""
        self._technique, self._other = QuantityPipeline(axes, technique), QuantityPipeline(axes, other)
        self._heard = heard

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
        """See `Pipeline`; nothing is held back."""
        self._heard(next(self._other(frames, degc)))
        yield from self._technique(frames, degc)

    def finish(self) -> Iterator[FusedBlock]:
        """Return nothing: no frame is held back."""
        return iter(())

    def notes(self) -> FusionNotes:
        """Return the remarks of the technique."""
        return self._technique.notes()


def fused_block(time: Times, estimates: Mapping[str, Estimate], axes: Mapping[str, Sequence[Axis]]) -> FusedBlock:
    """The estimates, by quantity, of one block of frames at `time` (n,) ns, as the result."""
    return FusedBlock(
        time,
        {quantity: estimate.triad_box for quantity, estimate in estimates.items()},
        {quantity: estimate.covariance_box for quantity, estimate in estimates.items()},
        {quantity: axis_bits(estimate.used, axes[quantity]) for quantity, estimate in estimates.items()},
    )
