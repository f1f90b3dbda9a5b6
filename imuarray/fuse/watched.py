"""A pipeline that is given frames without the axes that failed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.consensus import consensus
from imuarray.fuse.faults import FaultEvent, FaultMonitor, LeftOut, Ranges
from imuarray.fuse.frames import Floats, Frames
from imuarray.fuse.pipeline import Pipeline
from imuarray.fuse.told import Told, told_by

Out = TypeVar("Out")

_RATE = "angular_rate"


class Watched(Generic[Out]):
    """A fault monitor of each quantity before another pipeline; both monitors judge in the same windows, so that they
    give back the same frames. `found` hears each event as it is found.
    """

    def __init__(
        self,
        inner: Pipeline[Out],
        axes: Mapping[str, Sequence[Axis]],
        period_s: float,
        ranges: Ranges,
        found: Callable[[FaultEvent], None],
    ) -> None:
        self._inner = inner
        self._monitors = {
            quantity: FaultMonitor(its, quantity, period_s=period_s, ranges=ranges) for quantity, its in axes.items()
        }
        self._found, self._told = found, dict.fromkeys(axes, 0)
        self._gyroscopes = directions(axes.get(_RATE, []))
        self._apart = any(axis.position_m != its[0].position_m for its in axes.values() for axis in its)
        self._degc: dict[str, Floats] = {}
        """Temperatures of the frames that the monitors hold back."""

    @property
    def left_out(self) -> dict[str, LeftOut]:
        """Which axes were left out of the frames so far, by quantity."""
        return {quantity: monitor.left_out for quantity, monitor in self._monitors.items()}

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Out]:
        """See `Pipeline`."""
        rate_box = self._rate_box(frames)
        done = {quantity: self._monitors[quantity](part, rate_box) for quantity, part in frames.items()}
        self._tell()
        self._degc = {name: np.concatenate([self._degc.get(name, values[:0]), values]) for name, values in degc.items()}
        yield from self._passed(done)

    def _rate_box(self, frames: Mapping[str, Frames]) -> Floats | None:
        """(n, 3) how fast the box turns, which sensors that sit apart feel; None where nobody tells."""
        if _RATE not in frames or not self._apart:
            return None
        part = frames[_RATE]
        return np.nan_to_num(consensus(part.values, part.valid, self._gyroscopes, _RATE))

    def finish(self) -> Iterator[Out]:
        """See `Pipeline`."""
        last = {quantity: monitor.finish() for quantity, monitor in self._monitors.items()}
        self._tell()
        yield from self._passed({quantity: part for quantity, part in last.items() if part is not None})
        yield from self._inner.finish()

    def told(self) -> Told:
        """What the pipeline behind it tells."""
        return told_by(self._inner)

    def _passed(self, frames: Mapping[str, Frames]) -> Iterator[Out]:
        """Frames that are done with, and their temperatures."""
        count = max((len(part.time) for part in frames.values()), default=0)
        if count:
            now = {name: values[:count] for name, values in self._degc.items()}
            self._degc = {name: values[count:] for name, values in self._degc.items()}
            yield from self._inner(frames, now)

    def _tell(self) -> None:
        for quantity, monitor in self._monitors.items():
            for event in monitor.events[self._told[quantity] :]:
                self._found(event)
            self._told[quantity] = len(monitor.events)


class WatchedAgain(Generic[Out]):
    """A pipeline that is given the frames of a log again, without the axes that were left out the first time."""

    def __init__(self, inner: Pipeline[Out], left_out: Mapping[str, LeftOut]) -> None:
        self._inner, self._left_out, self._first = inner, left_out, 0

    def __call__(self, frames: Mapping[str, Frames], degc: Mapping[str, Floats]) -> Iterator[Out]:
        """See `Pipeline`."""
        first = self._first
        self._first += len(next(iter(frames.values())).time)
        yield from self._inner({name: self._left_out[name].of(part, first) for name, part in frames.items()}, degc)

    def finish(self) -> Iterator[Out]:
        """See `Pipeline`."""
        return self._inner.finish()
