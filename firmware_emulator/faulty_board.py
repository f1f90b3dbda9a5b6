"""A board with scheduled faults (`firmware_emulator.faults`); its parts are those of another board.

The multiplexer, the wires and the program can fail as well as the chips. Instants are in ns since power-on.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from firmware_emulator.board import MUXES, NO_CHANNEL, Board, BoardKind, Pca9544aChip, SensorLike, named
from firmware_emulator.chip import Chip, Element, Target
from firmware_emulator.clock import WireClock
from firmware_emulator.faults import BUS_FAULTS, CHIP_FAULTS, Fault
from firmware_emulator.faulty_parts import ChipFault, FaultyDevice, ShiftedElement, Times
from firmware_emulator.wire import Wire
from firmware_emulator.world import DelayedWorld

TIME_OUT_NS = 30_000_000
"""Timeout in ns of a program that does not wait for the kernel's default of one second."""


class FaultyMux(Pca9544aChip):
    """A multiplexer that sometimes ignores a command or carries out another one; with `reads_right` its control byte
    reads back as written, although it had no effect.
    """

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
        """Acknowledge in any case; carry out the command, a different one or none."""
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
        """Switch, or keep the channel."""
        super().stop(at_ns)
        if self._kept is not None:
            self.route = self._kept

    def reset(self) -> None:
        """Reset the multiplexer after a supply failure: no channel is connected."""
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
        """Apply faults before a transaction with these devices."""
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
        for chip in self.chips:
            chip.power_on(self._powered_on_ns + since_ns)
        if self.mux is not None:
            self.mux.reset()
        wire.reroute()


def with_faults(board: BoardKind, faults: Sequence[Fault]) -> BoardKind:
    """Return a board of this kind on which these faults occur."""

    def faulty(name: str, world: Any, seed: int) -> FaultyBoard:
        return FaultyBoard(board(name, world, seed), faults)

    return faulty


class FaultyBoard(Board):
    """Another board with faults; `chip_faults` by sensor."""

    def __init__(self, inner: Board, faults: Sequence[Fault]) -> None:
        super().__init__(inner.array, inner.world, inner.seed)
        self._inner = inner
        self._powered_on_ns = inner.world.start_ns if isinstance(inner.world, DelayedWorld) else 0
        self.chip_faults: dict[str, list[ChipFault]] = {}
        by_kind: dict[str, list[Times]] = {kind: [] for kind in BUS_FAULTS}
        self._orders: list[tuple[Times, int | None, bool]] = []
        for fault in faults:
            if fault.kind == "wrong_channel":
                self._orders.append((fault.times, fault.channel, fault.reads_right))
            elif fault.kind in by_kind:
                by_kind[fault.kind].append(fault.times)
            else:
                action = ChipFault(CHIP_FAULTS[fault.kind], fault.times, fault.until_set_up, fault.bias)
                self.chip_faults.setdefault(fault.sensor, []).append(action)
        self._places: dict[tuple[int, str], list[ChipFault]] = {}
        stalls, resets, removals = by_kind["stall"], by_kind["mux_reset"], by_kind["adapter_unplugged"]
        self._wires = FaultyWires(by_kind["stuck_bus"], stalls, resets, removals, self._powered_on_ns)
        held = any(fault.action == "hangs" for faults in self.chip_faults.values() for fault in faults)
        self._interfering = held or any(by_kind[kind] for kind in BUS_FAULTS)
        self._switching = bool(self._orders or by_kind["mux_reset"] or by_kind["adapter_unplugged"])

    def wire(self, clock: WireClock, bit_rate_hz: int, nack_errno: int, host_ns: int) -> Wire:
        """Return the other board's wire, with the faults that occur between transactions."""
        wire = self._inner.wire(clock, bit_rate_hz, nack_errno, host_ns)
        if self._interfering:
            wire.interference = self._wires
        return wire

    def router(
        self, chip: str, address: int, channels: Mapping[int, Sequence[Target]], powered_on_ns: int
    ) -> Pca9544aChip:
        """Return a multiplexer that carries out wrong commands, if there is such a fault; the multiplexer of a
        mechanism is then not used.
        """
        if not self._switching:
            return self._inner.router(chip, address, channels, powered_on_ns)
        named(chip, MUXES, "mux")
        self._wires.mux = FaultyMux(address, channels, powered_on_ns, self._orders)
        return self._wires.mux

    def element(self, sensor: SensorLike) -> Element:
        """Return the other board's element, with a different bias if a start-up fault changes it."""
        element = self._inner.element(sensor)
        shifts = [fault for fault in self.chip_faults.get(sensor.name, []) if fault.action == "start_up"]
        return ShiftedElement(element, shifts, self._powered_on_ns) if shifts else element

    def kind(self, sensor: SensorLike) -> Callable[..., Chip]:
        """Return the other board's builder."""
        return self._inner.kind(sensor)

    def switches(self, sensor: SensorLike) -> Mapping[str, Any]:
        """Return the other board's switches."""
        return self._inner.switches(sensor)

    def generator_key(self, sensor: SensorLike) -> str:
        """Return the other board's key."""
        return self._inner.generator_key(sensor)

    def device(self, sensor: SensorLike, chip: Chip) -> Target:
        """Return the other board's device, with its faults."""
        device = self._inner.device(sensor, chip)
        self._wires.chips.append(chip)
        faults = self.chip_faults.get(sensor.name, [])
        owned = [fault for fault in faults if fault.action == "owned"]
        self._places.setdefault((sensor.address, sensor.bus or ""), []).extend(owned)
        return FaultyDevice(device, chip, sensor.chip, faults, self._powered_on_ns) if faults else device

    def owned(self, address: int, bus: str, clock: WireClock) -> bool:
        """Return whether a driver of the kernel has that address now."""
        since_ns = clock.now_ns() - self._powered_on_ns
        return any(fault.active(since_ns) for fault in self._places.get((address, bus), []))

    def host_clock(self, clock: WireClock) -> WireClock:
        """Return the other board's clock."""
        return self._inner.host_clock(clock)
