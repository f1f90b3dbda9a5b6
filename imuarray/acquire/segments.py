"""What is read without switching, and what can go wrong on the way there: a bus that hangs, another channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imuarray.acquire.adapter import HUNG, Adapter
from imuarray.acquire.channels import channel_of
from imuarray.acquire.pending import Pending
from imuarray.acquire.trouble import Tell, Trouble
from imuarray.acquire.watch import Watch, frames_of
from imuarray.bus.mux import MuxChannel
from imuarray.clock import Clock


class Segment:
    """Sensors that are connected together, in their order. `tell` hears of what concerns all of them."""

    def __init__(
        self,
        items: list[Pending],
        everybody: Sequence[Pending],
        adapter: Adapter,
        clock: Clock,
        rate_hz: float,
        tell: Tell,
    ) -> None:
        self.items = items
        self.key = items[0].station.segment
        self.adapter = adapter
        here, everywhere = [item.station for item in items], [item.station for item in everybody]
        self.channel = channel_of(here, everywhere, frames_of(rate_hz))
        doubtful = [id(station) for station in self.channel.twins] if self.channel else []
        self.trouble = Trouble("channel", "visits", tell)
        self._twins = [item for item in items if id(item.station) in doubtful]
        shared = {item.station.sensor.address for item in self._twins if item.queue is not None}
        self._queues = [item for item in everybody if item.queue is not None and item.station.sensor.address in shared]
        self._marks: list[int] = []
        self._clock = clock
        self._tell = tell
        bus = items[0].driver.registers.bus
        self._select: Callable[[], None] | None = bus.select if isinstance(bus, MuxChannel) else None

    def begin(self) -> int:
        """Connect it before the first reading is timed, and the time then; if that fails the reading will fail too,
        and say so.
        """
        if self._select is not None and self._clock.now_ns() >= self.adapter.silent_until_ns:
            try:
                self._select()
            except OSError as error:
                self.failed(error)
        if self.channel is not None:
            self._marks = [len(item.times_ns) for item in self._twins]
        return self._clock.now_ns()

    def failed(self, error: OSError) -> None:
        """What an error says about the bus: that it hangs, or that it works."""
        now_ns = self._clock.now_ns()
        if error.errno not in HUNG:
            self.answered()
        elif self.adapter.timed_out(now_ns):
            self._tell(now_ns, "bus", f"hangs: {error.strerror or error} (errno {error.errno})")

    def answered(self) -> None:
        """The bus works, and did not before, maybe."""
        if self.adapter.answered():
            self._tell(self._clock.now_ns(), "bus", "works again")

    def confirm(self, watch: Watch, lost: dict[str, int]) -> bool:
        """Was it the right channel up to now? If not, what its twins said is thrown away, and counted in `lost`.

        Where a hung bus can't be asked nothing is believed either.
        """
        if self.channel is None:
            return not self.adapter.hangs
        right = not self.adapter.hangs and self.channel.right()
        if right:
            if self.channel.seen:
                watch.saw(self.channel.seen)
            if self.channel.doubted:
                watch.doubts(self.channel.doubted)
            self._marks = [len(item.times_ns) for item in self._twins]
            return True
        for item, mark in zip(self._twins, self._marks, strict=True):
            lost[item.station.sensor.name] += item.cut(mark)
        if not self.adapter.hangs:
            names = ", ".join(item.station.sensor.name for item in self._twins)
            text = f"channel {self.key} was not connected: readings of {names} are thrown away"
            self.trouble.happened(self._clock.now_ns(), text)
        for item in self._queues:  # drained in another's place: what was in them is lost
            item.missing = True
            if item.queue is not None:
                item.queue.restart()
        self.channel.forget()
        return False
