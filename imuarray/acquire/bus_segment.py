"""The route to each sensor: its segment of the bus (a multiplexer channel, or a separate bus), its adapter and its
identity; and the order in which a frame visits the segments.

`connect` identifies and configures every sensor; `SensorRoute` is its driver and the key of its segment.

`Pca9544a` is the multiplexer, and each of its four channels a `Bus` (NXP data sheet Rev 5). It has one control byte and
no register address (PCA-02): bit 2 enables, bits 1:0 choose the channel (PCA-03). The new channel is connected from the
STOP on (PCA-06), so that selecting is a transaction of its own. The chip has no reset (PCA-09).

`AdapterState` is the state of an I2C adapter in the poll loop: whether it hangs, whether it is plugged in, and the
duration of one of its clocks. A hung bus (a wire held low) costs a time-out per transaction. Two time-outs in a row
without an answer in between are attributed to the bus and not to a sensor; the bus is then tried at growing intervals
until a chip answers. With an unplugged adapter every transaction fails with ENODEV, and the adapter is searched for at
constant intervals.

`Channel` verifies that the selected channel is the one that is connected. A multiplexer that missed its command keeps
the old channel connected, and chips that share an address would answer for each other. The readings of a chip with a
twin (the same address on another channel) are accepted only after a witness was read in the same visit: a register
whose configured value differs between the twins, or a chip that has no twin. Without a witness, the multiplexer's
control byte is read back, which does not detect a switch that is stuck.

`ConfigurationReadback` reads the configuration registers of all chips back, a few per frame in turn; two wrong reads in
a row count. A chip that a supply glitch has reset continues with its default settings and does not report it (the
paper's BMA1, run 10). Each register is read at least once in `SWEEP_S`, so that a reset is noticed within a second; the
rows since the last good check are flagged, and an event states what was read. The bit that keeps the two bytes of a
reading together is one of the settings. A check uses the segment that is already selected: it costs one read, never a
switch. Registers that also identify the connected channel are read there and not here. Once per sweep the kernel is
asked whether one of its drivers has claimed the address.
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

from imuarray.acquire.fault_episode import FaultEpisodes
from imuarray.acquire.sample_buffer import RegisterCheck, SampleBuffer, SensorRoute
from imuarray.array import IIO, ArrayConfig, SensorConfig
from imuarray.bus.iio import IioBus, IioDevice
from imuarray.bus.protocol import Bus, OpenBus
from imuarray.bus.spi import SpiChip
from imuarray.chips import die_of
from imuarray.clock import Clock
from imuarray.drivers import driver_of
from imuarray.drivers.iio import IioCapture, iio_sensor
from imuarray.drivers.six_axis import QueuedHalf
from imuarray.errors import BusUrlError, SensorError
from imuarray.facts import pca9544a
from imuarray.facts.registers import Setting


def control_byte(channel: int) -> int:
    """Return the control byte that connects `channel`."""
    return (pca9544a.ENABLE(1) | pca9544a.CHANNEL(channel)).value


class Pca9544a:
    """One multiplexer; remembers what is selected, and forgets it whenever a transaction fails."""

    def __init__(self, bus: Bus, address: int) -> None:
        self.bus = bus
        self.address = address
        self.selected: int | None = None
        """The selected channel; None if it is not known."""

    def select(self, channel: int) -> None:
        """Select `channel` if it is not selected; OSError if the multiplexer does not answer."""
        if channel == self.selected:
            return
        self.selected = None
        self.bus.transfer(self.address, bytes([control_byte(channel)]))
        self.selected = channel

    def forget(self) -> None:
        """Select the channel again before the next transaction."""
        self.selected = None

    def is_connected(self, channel: int) -> bool:
        """Return whether the control byte, read back, names `channel`; False if the multiplexer does not answer."""
        try:
            control = self.bus.transfer(self.address, read=1)[0]
        except OSError:
            return False
        return control & (pca9544a.ENABLE.mask | pca9544a.CHANNEL.mask) == control_byte(channel)

    def channel(self, channel: int) -> MuxChannel:
        """Return the bus behind one channel."""
        return MuxChannel(self, channel)


class MuxChannel:
    """One channel of a multiplexer: a bus that selects itself before a transaction."""

    def __init__(self, mux: Pca9544a, channel: int) -> None:
        self.mux = mux
        self.number = channel

    def select(self) -> None:
        """Connect this channel now, so that the next transaction starts at once; OSError if the multiplexer fails."""
        self.mux.select(self.number)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer as `Bus.transfer`; after a failed transaction the next one selects the channel again."""
        mux = self.mux
        if mux.selected != self.number:
            mux.select(self.number)
        try:
            return mux.bus.transfer(address, write, read)
        except OSError:
            mux.forget()
            raise


class Witness(NamedTuple):
    """One register of one chip, and its values on the other channels; empty if the chip has no twin."""

    route: SensorRoute
    setting: Setting
    twin_values: frozenset[int]


def routes_of(array: ArrayConfig, bus: OpenBus) -> list[SensorRoute]:
    """Create a route to every sensor of `array`; nothing is sent yet."""
    mux = Pca9544a(bus, array.mux.address) if array.mux else None
    ask: Callable[[int, str | None], None] | None = getattr(bus, "claim", None)
    routes = []
    halves: dict[tuple[int, int | str | None], QueuedHalf] = {}
    captures: dict[str, IioCapture] = {}
    for sensor in array.sensors:
        if sensor.on_iio:
            capture = captures.setdefault(str(sensor.bus), IioCapture(_device(bus, sensor), bus.clock))
            routes.append(SensorRoute(sensor, iio_sensor(sensor, capture), sensor.bus))
            continue
        driver = driver_of(sensor)(_segment_bus(bus, mux, sensor), sensor, bus.clock)
        if isinstance(driver, QueuedHalf):
            first = halves.setdefault((driver.registers.address, sensor.bus or sensor.channel), driver)
            if first is not driver:
                driver.share(first)
        route = SensorRoute(sensor, driver, sensor.bus or sensor.channel)
        routes.append(replace(route, claim=partial(_claim, ask, sensor)) if ask and sensor.on_i2c else route)
    return routes


def _segment_bus(bus: OpenBus, mux: Pca9544a | None, sensor: SensorConfig) -> Bus:
    """Return the bus of a sensor's segment; BusUrlError names the sensor if it can't be opened."""
    try:
        if sensor.on_spi:
            rules = sensor.spi_rules
            return SpiChip(bus.spi_port(str(sensor.bus), rules.mode, rules.clock_hz), rules)
        if sensor.bus is not None:
            return bus.channel_bus(sensor.bus)
    except OSError as error:
        kind = "chip select" if sensor.on_spi else "bus"
        raise BusUrlError(f"{sensor.name}: {kind} {sensor.bus}: {error.strerror or error}") from error
    return bus if mux is None or sensor.channel is None else mux.channel(sensor.channel)


def _device(bus: OpenBus, sensor: SensorConfig) -> IioDevice:
    """Return the kernel device that serves a sensor; BusUrlError for a bus that has none."""
    if not isinstance(bus, IioBus):
        raise BusUrlError(
            f"{sensor.name}: {sensor.bus} is served by the kernel, which --bus iio: reads; it cannot write a transcript"
        )
    return bus.iio_device(str(sensor.bus).removeprefix(IIO))


def connect(array: ArrayConfig, bus: OpenBus) -> list[SensorRoute]:
    """Identify and configure every sensor. SensorError names the first sensor that is owned by a kernel driver,
    missing, wrong, refuses its configuration, or has lost it by the time that the last one is configured.
    """
    routes = routes_of(array, bus)
    ask: Callable[[int, str | None], None] | None = getattr(bus, "claim", None)
    if ask is not None and array.mux is not None:  # a driver of the kernel may own the multiplexer (LNX-12)
        ask(array.mux.address, None)
    for route in routes:
        route.claim()
    for route in routes:
        route.driver.identify()
    mark_twins(routes)
    for route in routes:
        try:
            route.driver.configure()
        except OSError as error:
            name, place = route.sensor.name, route.sensor.place
            raise SensorError(
                f"{name} at {place}: the bus fails while it is configured: {error.strerror or error}"
            ) from error
    return routes


def _claim(ask: Callable[[int, str | None], None], sensor: SensorConfig) -> None:
    """Claim the address of a sensor; behind a multiplexer, on the root bus."""
    try:
        ask(sensor.address, sensor.bus)
    except SensorError as error:
        raise SensorError(f"{sensor.name} ({sensor.chip}): {error}") from error
    except OSError as error:
        if error.errno != errno.EBUSY:
            raise
        raise SensorError(
            f"{sensor.name} ({sensor.chip}): {sensor.place} belongs to a driver of the kernel; unbind that driver"
        ) from error


def alternating_orders(routes: Sequence[SensorRoute]) -> tuple[list[list[SensorRoute]], list[list[SensorRoute]]]:
    """Return the visiting orders of even and of odd frames, in opposite directions: a frame begins with the segment
    with which the previous one ended.

    With k segments behind a multiplexer, a frame then needs k - 1 switches, the fewest possible. Within a segment the
    order of the configuration is kept in both directions. The spacing of a sensor's readings alternates by the time
    that the other segments take, and each reading has its own time.
    """
    segments: dict[int | str | None, list[SensorRoute]] = {}
    for route in routes:
        segments.setdefault(route.segment, []).append(route)
    order = list(segments.values())
    return order, order[::-1]


def twins_of(route: SensorRoute, all_routes: Iterable[SensorRoute]) -> list[SensorRoute]:
    """Return the routes at the same address of other channels."""
    if not isinstance(route.driver.registers.bus, MuxChannel):
        return []
    return [
        other
        for other in all_routes
        if other.segment != route.segment
        and isinstance(other.driver.registers.bus, MuxChannel)
        and other.sensor.address == route.sensor.address
    ]


def mark_twins(routes: Sequence[SensorRoute]) -> None:
    """Give twins with equal configurations different values in a register without effect, before configuration."""
    ambiguous: dict[int, SensorRoute] = {}
    for route in routes:
        twins = twins_of(route, routes)
        if twins and not witnesses_of(route, routes):
            ambiguous.update((id(twin), twin) for twin in (route, *twins))
    for route in ambiguous.values():
        route.driver.mark(int(route.segment or 0) + 1)


def witnesses_of(route: SensorRoute, all_routes: Sequence[SensorRoute]) -> list[Witness]:
    """Return the registers in which this chip differs from all its twins, even if one of them was reset; all its
    registers if it has no twin.
    """
    twins = twins_of(route, all_routes)
    witnesses = []
    for setting in route.driver.watched:
        twin_values = [
            {other.value for other in twin.driver.watched if other.register == setting.register}
            for twin in twins
            if die_of(twin.sensor.chip) == die_of(route.sensor.chip)
        ]
        own_values = {setting.value, setting.register.reset & setting.mask}
        if len(twin_values) == len(twins) and all(values and not values & own_values for values in twin_values):
            witnesses.append(Witness(route, setting, frozenset().union(*twin_values)))
    return witnesses


SWEEP_S = 0.85
"""Longest time in s between two reads of the same register; a wrong register is read again in the next frame."""


def frames_of(rate_hz: float) -> int:
    """Return the number of frames in a sweep, at least one."""
    return max(1, math.floor(SWEEP_S * rate_hz))


class ConfigurationReadback:
    """The checks of all routes, and the order in which they take turns."""

    def __init__(
        self,
        buffers: Sequence[SampleBuffer],
        rate_hz: float,
        report: Callable[[SampleBuffer, str, str], None],
        witnesses: Iterable[Witness] = (),
    ) -> None:
        """`buffers` in visiting order; `report` (sensor, kind of event, message) is called when a chip has lost its
        configuration or its address. The registers of `witnesses` are read by `Channel`, which reports them to
        `note_right` and `note_wrong`.
        """
        self._buffers = buffers
        for item in buffers:
            item.checks = [RegisterCheck(item, setting) for setting in (*item.driver.watched, None)]
        self._checks = [check for item in buffers for check in item.checks]
        self._by_setting = {
            (id(check.buffer.route), check.setting): check for check in self._checks if check.setting is not None
        }
        elsewhere = {(id(witness.route), witness.setting) for witness in witnesses}
        self._in_turn = [check for check in self._checks if (id(check.buffer.route), check.setting) not in elsewhere]
        self._report = report
        self._any_wrong = False
        self._next = 0
        reads = sum(check.setting is not None for check in self._in_turn)
        self.per_frame = math.ceil(reads / frames_of(rate_hz))

    def due(self) -> list[RegisterCheck]:
        """Return this frame's checks: those that were wrong last time first, then the next in turn."""
        repeated: list[RegisterCheck] = []
        if self._any_wrong:
            self._any_wrong = any(check.wrong for check in self._checks)
            repeated = [check for check in self._checks if check.wrong == 1 and check.buffer.recovery is None]
        regular: list[RegisterCheck] = []
        reads, index, count = 0, self._next, len(self._in_turn)
        for _ in range(count):
            check = self._in_turn[index]
            if check.setting is not None and reads == self.per_frame:
                break
            reads += check.setting is not None
            index = (index + 1) % count
            if check.wrong != 1 and check.buffer.recovery is None:
                regular.append(check)
        self._next = index
        return repeated + regular

    def note_right(self, witness: Witness) -> None:
        """Note that this register was read elsewhere and is right."""
        self._by_setting[id(witness.route), witness.setting].note_right()

    def note_wrong(self, witness: Witness) -> None:
        """Note that this register was read elsewhere and is not as configured."""
        check = self._by_setting[id(witness.route), witness.setting]
        check.wrong = max(check.wrong, 1)
        self._any_wrong = True

    def run(self, check: RegisterCheck) -> None:
        """Read one register back; a failed transaction is no evidence about the register."""
        if check.setting is None:
            self._ask(check)
            return
        registers = check.buffer.driver.registers
        try:
            value = registers.read_back(check.setting.register)
        except OSError:
            return
        if value & check.setting.mask == check.setting.value:
            check.note_right()
        else:
            self._note_wrong(check, "configuration", check.setting.mismatch(value))

    def _ask(self, check: RegisterCheck) -> None:
        """Ask the kernel who owns the address. One answer is enough."""
        try:
            check.buffer.route.claim()
        except SensorError as error:
            check.wrong = 1
            self._note_wrong(check, "taken", str(error))
            return
        except OSError:
            return
        check.note_right()

    def _note_wrong(self, check: RegisterCheck, kind: str, message: str) -> None:
        self._any_wrong = True
        if check.note_wrong():
            self._report(check.buffer, kind, message)

    def finish(self) -> None:
        """Check everything once more (wrong registers twice), and flag the rows that remain in doubt, so that no row
        stays undecided.
        """
        for check in self._checks:
            if check.buffer.recovery is None:
                self.run(check)
                if check.wrong == 1:
                    self.run(check)
        for buffer in self._buffers:
            self.give_up(buffer)

    def give_up(self, buffer: SampleBuffer) -> None:
        """Flag the waiting rows that no check has verified, and begin its checks again if there are any."""
        if buffer.flag_unverified():
            buffer.note_verified()


HUNG = frozenset({errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY})
"""Errors of Linux adapters while the bus is busy (LNX-43, LNX-44, LNX-47)."""
REMOVED = frozenset({errno.ENODEV})
"""Errors of a bus whose adapter was unplugged (`imuarray.bus.linux`)."""
SEARCH_NS = 250_000_000
"""Interval between two searches for a removed adapter, in ns."""
FIRST_PAUSE_NS = 50_000_000
LONGEST_PAUSE_NS = 400_000_000
SLACK_NS = 1_000_000
"""Excess of the duration of a reading over that of its bits, in ns, above which the machine interrupted it; its time is
uncertain by the excess.
"""


class AdapterState:
    """One adapter. Nothing is sent before `silent_until_ns`; `hangs` and `removed` are True while it hangs or is
    unplugged.
    """

    def __init__(self) -> None:
        self.hangs = False
        self.removed = False
        self.silent_until_ns = -(1 << 62)
        self.time_outs = 0
        """Number of time-outs in a row, without an answer in between."""
        self.all_time_outs = 0
        self.clock_ns = 1e9
        self._pause_ns = FIRST_PAUSE_NS

    @property
    def is_unreachable(self) -> bool:
        """True if no chip on it can be reached."""
        return self.hangs or self.removed

    def note_removal(self, now_ns: int) -> bool:
        """Note that a transaction ended with one of `REMOVED`; return whether the adapter was removed just now."""
        began = not self.removed
        self.removed = True
        self.silent_until_ns = now_ns + SEARCH_NS
        return began

    def note_return(self) -> None:
        """Note that the adapter is present again."""
        self.removed = False
        self.silent_until_ns = -(1 << 62)

    def note_time_out(self, now_ns: int) -> bool:
        """Note that a transaction ended with one of `HUNG`; return whether the bus began to hang just now."""
        self.time_outs += 1
        self.all_time_outs += 1
        if self.time_outs < 2:
            return False
        began = not self.hangs
        self.hangs = True
        self.silent_until_ns = now_ns + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
        return began

    def note_answer(self) -> bool:
        """Note that something was received; return whether that ended a hang."""
        ended = self.hangs
        self.hangs = False
        self.time_outs = 0
        self._pause_ns = FIRST_PAUSE_NS
        return ended

    def start_of(self, begun_ns: int, ended_ns: int, clocks: int) -> tuple[int, bool]:
        """Return when a burst of `clocks` clocks, requested and received between these times, was on the wire, and
        whether that is certain.

        The duration of a clock is that of the quickest burst so far; the rest of the time was spent in the machine. If
        the rest exceeds `SLACK_NS`, the middle of the possible interval may be wrong by half of it.
        """
        took_ns = ended_ns - begun_ns
        if took_ns < clocks * self.clock_ns:
            self.clock_ns = took_ns / clocks
        slack_ns = took_ns - clocks * self.clock_ns
        if slack_ns <= SLACK_NS:
            return begun_ns, True
        return begun_ns + round(slack_ns / 2), False


class Channel:
    """One channel of a multiplexer, and the witnesses on it that prove that it is connected; `twins` are its routes
    that have a twin on another channel.

    Witness registers are read in turn, at most `limit` of them, which also checks their configuration. `right_witness`
    is the one that was right last time, `wrong_witness` one that returned a wrong value.
    """

    def __init__(
        self, bus: MuxChannel, routes: Sequence[SensorRoute], all_routes: Sequence[SensorRoute], limit: int
    ) -> None:
        self._mux, self._number = bus.mux, bus.number
        self.twins = [route for route in routes if twins_of(route, all_routes)]
        witnesses = [witness for route in routes for witness in witnesses_of(route, all_routes)]
        self.witnesses = sorted(witnesses, key=lambda witness: not witness.twin_values)[:limit]  # registers first
        self.right_witness: Witness | None = None
        self.wrong_witness: Witness | None = None
        self._turn = 0

    def is_connected(self) -> bool:
        """Return whether the channel is connected: ask the next witness; unless it confirms, read the multiplexer's
        control byte and the other witnesses.

        A chip that was reset or removed is no evidence against a channel.
        """
        self.right_witness = self.wrong_witness = None
        if self.witnesses:
            self._turn = (self._turn + 1) % len(self.witnesses)
            if self._ask_witness(self.witnesses[self._turn]):
                return True
        if not self._mux.is_connected(self._number):
            return False
        for witness in self.witnesses:
            verdict = self._ask_witness(witness)
            if verdict is not None:
                return verdict
        return True

    def _ask_witness(self, witness: Witness) -> bool | None:
        """Return True if the witness confirms the channel, False if it returns a twin's value, None if the chip is
        silent or returns a value that is neither its own nor a twin's. Without a twin, any answer confirms the channel.
        """
        registers, setting = witness.route.driver.registers, witness.setting
        try:
            register = setting.register
            block = self._mux.bus.transfer(registers.address, register.pointer, register.readback_bytes)
            value = block[0] & setting.mask
        except OSError:
            return None
        if value == setting.value:
            self.right_witness = witness
            return True
        if value in witness.twin_values:
            return False
        self.wrong_witness = witness
        return None if witness.twin_values else True

    def forget(self) -> None:
        """Select the channel again before the next transaction."""
        self._mux.forget()


def channel_of(routes: Sequence[SensorRoute], all_routes: Sequence[SensorRoute], limit: int) -> Channel | None:
    """Return the channel of these routes if a chip on it has a twin on another channel."""
    bus = routes[0].driver.registers.bus
    channel = Channel(bus, routes, all_routes, limit) if isinstance(bus, MuxChannel) else None
    return channel if channel is not None and channel.twins else None


@dataclass(frozen=True)
class Polling:
    """The data that all segments of a poll loop share: its clock and rate, the faults that concern all sensors of a
    segment, and a callback that receives the removed adapter and the time of the removal (ns).
    """

    clock: Clock
    rate_hz: float
    faults: FaultEpisodes
    lose: Callable[[AdapterState, int], None]


class BusSegment:
    """Sensors that are connected at the same time, in visiting order."""

    def __init__(
        self,
        items: list[SampleBuffer],
        all_buffers: Sequence[SampleBuffer],
        adapter: AdapterState,
        polling: Polling,
    ) -> None:
        self.items = items
        self.key = items[0].route.segment
        self.adapter = adapter
        routes, all_routes = [item.route for item in items], [item.route for item in all_buffers]
        self.channel = channel_of(routes, all_routes, frames_of(polling.rate_hz))
        doubtful = [id(route) for route in self.channel.twins] if self.channel else []
        self._misrouted = polling.faults.episode("", "channel")
        self._hang = polling.faults.episode("", "bus", id(adapter))
        self._removal = polling.faults.episode("", "adapter", id(adapter))
        self._lose = polling.lose
        self._twins = [item for item in items if id(item.route) in doubtful]
        shared = {item.route.sensor.address for item in self._twins if item.queue is not None}
        self._queues = [item for item in all_buffers if item.queue is not None and item.route.sensor.address in shared]
        self._marks: list[int] = []
        self._clock = polling.clock
        bus = items[0].driver.registers.bus
        self._select: Callable[[], None] | None = bus.select if isinstance(bus, MuxChannel) else None
        self._root = bus.mux.bus if isinstance(bus, MuxChannel) else bus

    def begin(self) -> int:
        """Connect the segment before the first reading is timed, and return the time. If that fails, the first reading
        fails as well and reports the error.
        """
        if self._select is not None and self._clock.now_ns() >= self.adapter.silent_until_ns:
            try:
                self._select()
            except OSError as error:
                self.note_error(error)
        if self.channel is not None:
            self._marks = [len(item.times_ns) for item in self._twins]
        return self._clock.now_ns()

    def note_error(self, error: OSError) -> None:
        """Conclude from an error that the bus hangs, that its adapter was removed, or that it works."""
        now_ns = self._clock.now_ns()
        if error.errno in REMOVED:
            if self.adapter.note_removal(now_ns):
                self._removal.begin(now_ns, f"{error.strerror or error} (errno {error.errno})")
                self._lose(self.adapter, now_ns)
        elif error.errno not in HUNG:
            self.note_answer()
        else:
            self._note_return(now_ns)
            if self.adapter.note_time_out(now_ns):
                self._hang.begin(now_ns, f"hangs: {error.strerror or error} (errno {error.errno})")

    def note_answer(self) -> None:
        """Note that the bus works."""
        now_ns = self._clock.now_ns()
        self._note_return(now_ns)
        if self.adapter.note_answer():
            self._hang.end(now_ns, "works again")

    def _note_return(self, now_ns: int) -> None:
        """Note that the adapter is present again."""
        if not self.adapter.removed:
            return
        self.adapter.note_return()
        device = getattr(self._root, "where", None)
        place = f" as {device}" if device else ""
        self._removal.end(now_ns, f"the adapter is back{place}, its sensors are configured again")
        for item in self.items:
            bus = item.driver.registers.bus
            if isinstance(bus, MuxChannel):  # the multiplexer may have been without its supply
                bus.mux.forget()

    def has_returned(self, buffer: SampleBuffer) -> bool:
        """Send a request to the sensor's address: any result except `REMOVED` shows that the adapter is present."""
        registers = buffer.driver.registers
        try:
            registers.bus.transfer(registers.address)
        except OSError as error:
            self.note_error(error)
        else:
            self.note_answer()
        return not self.adapter.removed

    def confirm(self, readback: ConfigurationReadback, lost: dict[str, int]) -> bool:
        """Verify that the right channel was connected; if not, discard the readings of its twins and count them in
        `lost`.

        If a hung bus makes this impossible, the readings are discarded as well.
        """
        if self.channel is None:
            return not self.adapter.is_unreachable
        right = not self.adapter.is_unreachable and self.channel.is_connected()
        if right:
            if self.channel.right_witness:
                readback.note_right(self.channel.right_witness)
            if self.channel.wrong_witness:
                readback.note_wrong(self.channel.wrong_witness)
            self._marks = [len(item.times_ns) for item in self._twins]
            return True
        for item, mark in zip(self._twins, self._marks, strict=True):
            lost[item.route.sensor.name] += item.cut(mark)
        if not self.adapter.is_unreachable:
            names = ", ".join(item.route.sensor.name for item in self._twins)
            text = f"channel {self.key} was not connected: readings of {names} are discarded"
            self._misrouted.happened(self._clock.now_ns(), text)
        for item in self._queues:  # another chip's queue was drained: its readings are lost
            item.mark_lost()
            if item.queue is not None:
                item.queue.restart()
        self.channel.forget()
        return False
