"""`optimal` between aligned frames and the result: as the frames come, or, with all of them there, smoothed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from imuarray.fuse.axes import Axis
from imuarray.fuse.frames import Floats, Frames, FusedBlock
from imuarray.fuse.optimal.error_model import ErrorModel
from imuarray.fuse.optimal.optimal import Optimal
from imuarray.fuse.pipeline import fused_block
from imuarray.fuse.told import Told

Gathered = tuple[Mapping[str, Frames], Mapping[str, Floats]]
"""Frames by quantity, and the temperatures of their elements by sensor."""


class AsTheyCome:
    """A causal `Optimal` as a `Pipeline`: nothing is held back."""

    def __init__(self, axes: Mapping[str, Sequence[Axis]], model: ErrorModel, period_s: float) -> None:
        """FusionError for axes that the model does not know."""
        self._axes = axes
        self._optimal = Optimal(axes, model, period_s=period_s)

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[FusedBlock]:
        """See `Pipeline`."""
        yield fused_block(next(iter(frames.values())).time, self._optimal(frames, degc), self._axes)

    def finish(self) -> Iterator[FusedBlock]:
        """Nothing."""
        return iter(())

    def told(self) -> Told:
        """The slow errors of every axis as they are felt at the last frame."""
        return Told(self._optimal.learned())


class Gathering:
    """A `Pipeline` that gives its frames as they are, for those who want them all."""

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Gathered]:
        """See `Pipeline`."""
        yield frames, degc

    def finish(self) -> Iterator[Gathered]:
        """Nothing."""
        return iter(())


def smoothed(
    blocks: Callable[[], Iterator[Gathered]],
    axes: Mapping[str, Sequence[Axis]],
    model: ErrorModel,
    period_s: float,
    told: Callable[[Told], None] = lambda told: None,
) -> Iterator[FusedBlock]:
    """All frames by what all of them tell; `blocks` gives them from the beginning, and is asked twice. `told` hears at
    the end which slow errors there were. FusionError.
    """
    optimal = Optimal(axes, model, period_s=period_s)
    for time, estimates in optimal.smoothed(blocks):
        yield fused_block(time, estimates, axes)
    told(Told(optimal.learned()))
