"""A whole log's frames without what failed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import repeat

from imuarray.fuse.axes import Axis
from imuarray.fuse.faults.events import FaultEvent
from imuarray.fuse.faults.kinds import Ranges
from imuarray.fuse.faults.monitor import NO_RANGES, FaultMonitor
from imuarray.fuse.frames import Floats, Frames


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
        rates_box: Iterable[Floats | None] | None = None,
    ) -> None:
        """As `FaultMonitor`; `rates_box` the box's angular rate (n, 3) in rad/s, block by block beside `frames`."""
        self._frames, self._rates = frames, rates_box
        self._monitor = FaultMonitor(axes, quantity, period_s=period_s, ranges=ranges)

    @property
    def events(self) -> tuple[FaultEvent, ...]:
        """What was found so far, in order."""
        return self._monitor.events

    def __iter__(self) -> Iterator[Frames]:
        """Once: a log is read from its beginning to its end."""
        rates = repeat(None) if self._rates is None else iter(self._rates)
        for block, rate in zip(self._frames, rates, strict=False):  # without rates there is no end of them
            if len((done := self._monitor(block, rate)).time):
                yield done
        if (last := self._monitor.finish()) is not None:
            yield last


def monitored(
    frames: Iterable[Frames],
    axes: Sequence[Axis],
    quantity: str,
    *,
    period_s: float,
    ranges: Ranges = NO_RANGES,
    rates_box: Iterable[Floats | None] | None = None,
) -> Monitored:
    """`frames` (consecutive blocks) through a `FaultMonitor`; iterate it, then read its `events`."""
    return Monitored(frames, axes, quantity, period_s=period_s, ranges=ranges, rates_box=rates_box)
