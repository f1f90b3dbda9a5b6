"""What is read without switching, and what can go wrong on the way there: a bus that hangs, another channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from imuarray.acquire.adapter import HUNG, REMOVED, Adapter
from imuarray.acquire.channels import channel_of
from imuarray.acquire.configuration_readback import ConfigurationReadback, frames_of
from imuarray.acquire.fault_episode import FaultEpisodes
from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.bus.mux import MuxChannel
from imuarray.clock import Clock


class BusSegment:
    """Sensors that are connected together, in their order. `faults` hears of what concerns all of them, `lose` of
    every sensor in it when the adapter was removed.
    """

    def __init__(
        self,
        items: list[SampleBuffer],
        everybody: Sequence[SampleBuffer],
        adapter: Adapter,
        clock: Clock,
        rate_hz: float,
        faults: FaultEpisodes,
        lose: Callable[[Adapter, int], None],
    ) -> None:
        self.items = items
        self.key = items[0].route.segment
        self.adapter = adapter
        here, everywhere = [item.route for item in items], [item.route for item in everybody]
        self.channel = channel_of(here, everywhere, frames_of(rate_hz))
        doubtful = [id(route) for route in self.channel.twins] if self.channel else []
        self._misrouted = faults.of("", "channel")
        self._hang = faults.of("", "bus", id(adapter))
        self._removal = faults.of("", "adapter", id(adapter))
        self._lose = lose
        self._twins = [item for item in items if id(item.route) in doubtful]
        shared = {item.route.sensor.address for item in self._twins if item.queue is not None}
        self._queues = [item for item in everybody if item.queue is not None and item.route.sensor.address in shared]
        self._marks: list[int] = []
        self._clock = clock
        bus = items[0].driver.registers.bus
        self._select: Callable[[], None] | None = bus.select if isinstance(bus, MuxChannel) else None
        self._root = bus.mux.bus if isinstance(bus, MuxChannel) else bus

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
        """What an error says about the bus: that it hangs, that its adapter was removed, or that it works."""
        now_ns = self._clock.now_ns()
        if error.errno in REMOVED:
            if self.adapter.was_removed(now_ns):
                self._removal.begin(now_ns, f"{error.strerror or error} (errno {error.errno})")
                self._lose(self.adapter, now_ns)
        elif error.errno not in HUNG:
            self.answered()
        else:
            self._return(now_ns)
            if self.adapter.timed_out(now_ns):
                self._hang.begin(now_ns, f"hangs: {error.strerror or error} (errno {error.errno})")

    def answered(self) -> None:
        """The bus works, and did not before, maybe."""
        now_ns = self._clock.now_ns()
        self._return(now_ns)
        if self.adapter.answered():
            self._hang.over(now_ns, "works again")

    def _return(self, now_ns: int) -> None:
        """The adapter is there, and was not before, maybe."""
        if not self.adapter.removed:
            return
        self.adapter.returned()
        where = getattr(self._root, "where", None)
        place = f" as {where}" if where else ""
        self._removal.over(now_ns, f"the adapter is there again{place}, its sensors are set up again")
        for item in self.items:
            bus = item.driver.registers.bus
            if isinstance(bus, MuxChannel):  # the multiplexer may have been without its supply
                bus.mux.selected = None

    def has_returned(self, buffer: SampleBuffer) -> bool:
        """Ask whether anybody is at the sensor's address: whatever comes back but `REMOVED`, the adapter is there."""
        registers = buffer.driver.registers
        try:
            registers.bus.transfer(registers.address)
        except OSError as error:
            self.failed(error)
        else:
            self.answered()
        return not self.adapter.removed

    def confirm(self, readback: ConfigurationReadback, lost: dict[str, int]) -> bool:
        """Was it the right channel up to now? If not, what its twins said is thrown away, and counted in `lost`.

        Where a hung bus can't be asked nothing is believed either.
        """
        if self.channel is None:
            return not self.adapter.down
        right = not self.adapter.down and self.channel.right()
        if right:
            if self.channel.seen:
                readback.saw(self.channel.seen)
            if self.channel.doubted:
                readback.doubts(self.channel.doubted)
            self._marks = [len(item.times_ns) for item in self._twins]
            return True
        for item, mark in zip(self._twins, self._marks, strict=True):
            lost[item.route.sensor.name] += item.cut(mark)
        if not self.adapter.down:
            names = ", ".join(item.route.sensor.name for item in self._twins)
            text = f"channel {self.key} was not connected: readings of {names} are thrown away"
            self._misrouted.happened(self._clock.now_ns(), text)
        for item in self._queues:  # drained in another's place: what was in them is lost
            item.missing = True
            if item.queue is not None:
                item.queue.restart()
        self.channel.forget()
        return False
