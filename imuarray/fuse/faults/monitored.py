"""A whole log's frames without what failed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from imuarray.fuse.axes import Axis
from imuarray.fuse.faults.events import FaultEvent
from imuarray.fuse.faults.kinds import Ranges
from imuarray.fuse.faults.monitor import NO_RANGES, FaultMonitor
from imuarray.fuse.frames import Frames


class Monitored:
    """The frames of one quantity, block by block, without the axes that were found faulty; all frames are in it when it
    ends. `events` is complete then, and grows until then.
    """

    def __init__(
        self,
        frames: Iterable[Frames],
        axes: Sequence[Axis],
        quantity: str,
        *,
        period_s: float,
        ranges: Ranges = NO_RANGES,
    ) -> None:
        """As `FaultMonitor`."""
        self._frames = frames
        self._monitor = FaultMonitor(axes, quantity, period_s=period_s, ranges=ranges)

    @property
    def events(self) -> tuple[FaultEvent, ...]:
        """What was found so far, in order."""
        return self._monitor.events

    def __iter__(self) -> Iterator[Frames]:
        """Once: a log is read from its beginning to its end."""
        for block in self._frames:
            if len((done := self._monitor(block)).time):
                yield done
        if (last := self._monitor.finish()) is not None:
            yield last


def monitored(
    frames: Iterable[Frames], axes: Sequence[Axis], quantity: str, *, period_s: float, ranges: Ranges = NO_RANGES
) -> Monitored:
    """`frames` (consecutive blocks) through a `FaultMonitor`; iterate it, then read its `events`."""
    return Monitored(frames, axes, quantity, period_s=period_s, ranges=ranges)
