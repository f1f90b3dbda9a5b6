"""Failures between the chips at given times: the multiplexer, the wires, the program itself.

Instants are in ns since power-on.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence

from firmware_emulator.chip import Chip, Target
from firmware_emulator.faulty_parts import FaultyDevice, Times
from firmware_emulator.mux import NO_CHANNEL, Pca9544a
from firmware_emulator.wire import Wire

TIME_OUT_NS = 30_000_000
"""What a program sets that does not want to wait for the kernel's second."""


class FaultyMux(Pca9544a):
    """A multiplexer that sometimes takes no order, or another; or says so and does not switch (`reads_right`)."""

    def __init__(
        self,
        address: int,
        channels: Mapping[int, Sequence[Target]],
        powered_on_ns: int,
        orders: Sequence[tuple[Times, int | None, bool]],
    ) -> None:
        self._orders = orders
        self._powered_on_ns = powered_on_ns
        self._kept: int | None = None
        super().__init__(address, channels, powered_on_ns)

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Acknowledged whatever becomes of it."""
        self._kept = None
        for times, channel, reads_right in self._orders:
            if times.during(at_ns - self._powered_on_ns):
                if reads_right:
                    self._kept = self.route if channel is None else channel
                else:
                    other = bytes([self.control if channel is None else 0x04 | channel])
                    return super().write(other, at_ns, byte_ns)
        return super().write(data, at_ns, byte_ns)

    def stop(self, at_ns: int) -> None:
        """Switch, or stay."""
        super().stop(at_ns)
        if self._kept is not None:
            self.route = self._kept

    def reset(self) -> None:
        """Reset it, since its supply failed: nothing is connected."""
        self.power_on(0)
        self._kept, self.route = None, NO_CHANNEL


class FaultyWires:
    """Wires with failures between transactions: held clocks, a stalled program, a multiplexer that is reset, an adapter
    that is unplugged. `chips` lose their supply with the adapter.
    """

    def __init__(
        self,
        hangs: Sequence[Times],
        stalls: Sequence[Times],
        mux_resets: Sequence[Times],
        removals: Sequence[Times],
        powered_on_ns: int,
    ) -> None:
        self._hangs, self._stalls, self._mux_resets, self._removals = hangs, stalls, mux_resets, removals
        self._powered_on_ns = powered_on_ns
        self.chips: list[Chip] = []
        self._returned = [0] * len(removals)
        self._stalled = [0] * len(stalls)
        self._reset = [0] * len(mux_resets)
        self.mux: FaultyMux | None = None

    def __call__(self, wire: Wire, devices: Sequence[Target]) -> None:
        """Before a transaction with these devices."""
        clock = wire.clock
        since_ns = clock.now_ns() - self._powered_on_ns
        for index, times in enumerate(self._removals):
            if times.ended(since_ns) > self._returned[index]:
                self._returned[index] = times.ended(since_ns)
                self._plug_in(wire, times.start_ns(self._returned[index]) + times.length_ns)
        if any(times.during(since_ns) for times in self._removals):
            raise OSError(errno.ENODEV, "the emulated adapter is unplugged")
        for index, times in enumerate(self._stalls):
            if times.begun(since_ns) > self._stalled[index]:
                self._stalled[index] = times.begun(since_ns)
                clock.advance(times.length_ns)
        for index, times in enumerate(self._mux_resets):
            if self.mux is not None and times.begun(since_ns) > self._reset[index]:
                self._reset[index] = times.begun(since_ns)
                self.mux.reset()
                wire.reroute()
        held = any(isinstance(device, FaultyDevice) and device.hangs(clock.now_ns()) for device in devices)
        if held or any(times.during(since_ns) for times in self._hangs):
            clock.advance(TIME_OUT_NS)
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))

    def _plug_in(self, wire: Wire, since_ns: int) -> None:
        """Everything has its supply again, since then."""
        for chip in self.chips:
            chip.power_on(self._powered_on_ns + since_ns)
        if self.mux is not None:
            self.mux.reset()
        wire.reroute()
