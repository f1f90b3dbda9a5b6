"""Imperfections of the polling computer and the multiplexer: clocks that err, programs that wait, switches that hang.

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
    """The host's clock, while the world's `clock` passes.

    `shown` turns a time of the world into what is displayed, in nanoseconds, and never falls; `when` is the earliest
    time of the world at which a given display is reached; both count from power-on, when the display was right.
    """

    def __init__(self, clock: WireClock, shown: Reading, when: Reading, powered_on_ns: int = 0) -> None:
        self._clock = clock
        self._shown, self._when = shown, when
        self._powered_on_ns = powered_on_ns

    def shown(self, at_ns: int) -> int:
        """Return the display at a time of the world."""
        if isinstance(self._clock, HostClock):
            at_ns = self._clock.shown(at_ns)
        return self._display(at_ns)

    def _display(self, clock_ns: int) -> int:
        return self._powered_on_ns + self._shown(clock_ns - self._powered_on_ns)

    def now_ns(self) -> int:
        """Return the display."""
        return self._display(self._clock.now_ns())

    def advance(self, ns: int) -> None:
        """Time of the world passes."""
        self._clock.advance(ns)

    def sleep_until(self, ns: int) -> None:
        """Return when the display is at least `ns`."""
        self._clock.sleep_until(self._powered_on_ns + self._when(ns - self._powered_on_ns))


class LatentWire(Wire):
    """An adapter before which the program is kept waiting: `waits_ns` are drawn before every transaction."""

    def __init__(
        self, clock: WireClock, bit_rate_hz: int, nack_errno: int, host_ns: int, waits_ns: Sequence[Callable[[], int]]
    ) -> None:
        super().__init__(clock, bit_rate_hz, nack_errno, host_ns)
        self._waits_ns = waits_ns

    def delay(self) -> None:
        """Wait as long as is drawn."""
        self.clock.advance(sum(wait() for wait in self._waits_ns))

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer as `Wire.transfer`, later."""
        self.delay()
        return super().transfer(address, write, read)


class WatchedMux(Pca9544aChip):
    """A multiplexer whose switch obeys only if all of `obeys` agree, and that tells `switched` when it moved."""

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
        """The channel that was ordered while another one is connected, `NO_CHANNEL` if there is no such."""
        return NO_CHANNEL if self.ordered == self.route else self.ordered

    def stop(self, at_ns: int) -> None:
        """Switch the wires, if the switch moves at all; the control register reads back as written either way."""
        before = self.route
        super().stop(at_ns)
        if self.route == before:
            return
        at_ns -= self._powered_on_ns
        if not all(obeys(at_ns) for obeys in self._obeys):
            self.route = before
            return
        for tell in self._switched:
            tell(at_ns)
