"""Imperfections of the polling computer and the multiplexer: clock errors, scheduling latency, a switch that hangs.

Instants passed to mechanisms are in ns since power-on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from firmware_emulator.board import NO_CHANNEL, Pca9544aChip
from firmware_emulator.chip import Target
from firmware_emulator.clock import WireClock
from firmware_emulator.wire import Wire

Reading = Callable[[int], int]


class HostClock:
    """The host's clock as a function of the world's `clock`.

    `shown` converts a time of the world to the displayed time, in nanoseconds, and never decreases. `when` returns the
    earliest time of the world at which a given display is reached. Both count from power-on, when the display was
    correct.
    """

    def __init__(self, clock: WireClock, shown: Reading, when: Reading, powered_on_ns: int = 0) -> None:
        self._clock = clock
        self._shown, self._when = shown, when
        self._powered_on_ns = powered_on_ns

    def shown(self, at_ns: int) -> int:
        """Return the displayed time at a time of the world."""
        if isinstance(self._clock, HostClock):
            at_ns = self._clock.shown(at_ns)
        return self._display(at_ns)

    def _display(self, clock_ns: int) -> int:
        return self._powered_on_ns + self._shown(clock_ns - self._powered_on_ns)

    def now_ns(self) -> int:
        """Return the displayed time."""
        return self._display(self._clock.now_ns())

    def advance(self, ns: int) -> None:
        """Advance the world's clock."""
        self._clock.advance(ns)

    def sleep_until(self, ns: int) -> None:
        """Wait until the display is at least `ns`."""
        self._clock.sleep_until(self._powered_on_ns + self._when(ns - self._powered_on_ns))


class LatentWire(Wire):
    """An adapter used by a program with latency: `waits_ns` are drawn before every transaction."""

    def __init__(
        self, clock: WireClock, bit_rate_hz: int, nack_errno: int, host_ns: int, waits_ns: Sequence[Callable[[], int]]
    ) -> None:
        super().__init__(clock, bit_rate_hz, nack_errno, host_ns)
        self._waits_ns = waits_ns

    def delay(self) -> None:
        """Wait for the drawn latencies."""
        self.clock.advance(sum(wait() for wait in self._waits_ns))

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer as `Wire.transfer`, after the latency."""
        self.delay()
        return super().transfer(address, write, read)


class WatchedMux(Pca9544aChip):
    """A multiplexer that switches only if all of `obeys` agree, and calls `switched` after it has switched."""

    def __init__(
        self,
        address: int,
        channels: Mapping[int, Sequence[Target]],
        powered_on_ns: int,
        obeys: Sequence[Callable[[int], bool]],
        switched: Sequence[Callable[[int], None]],
    ) -> None:
        self._obeys, self._switched = obeys, switched
        self._powered_on_ns = powered_on_ns
        super().__init__(address, channels, powered_on_ns)

    @property
    def astray_for(self) -> int:
        """The selected channel while a different one is connected, otherwise `NO_CHANNEL`."""
        return NO_CHANNEL if self.ordered == self.route else self.ordered

    def stop(self, at_ns: int) -> None:
        """Switch the wires, unless the switch hangs; the control register reads back as written in any case."""
        previous = self.route
        super().stop(at_ns)
        if self.route == previous:
            return
        at_ns -= self._powered_on_ns
        if not all(obeys(at_ns) for obeys in self._obeys):
            self.route = previous
            return
        for notify in self._switched:
            notify(at_ns)
