"""Remarks of techniques on the sensors, once a log is fused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol, runtime_checkable


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
