"""Common parts of the chips of the MPU family: ranges and codes, one grid of samples, flags, a queue of bytes, the
auxiliary bus' bypass.

Facts INV-26, INV-27 and INV-98 (queue), INV-97 (bypass). A full queue loses its oldest bytes, one by one, so that it
may afterwards begin within a record; an empty queue repeats its last byte.

The master of the auxiliary bus (MPU-6500, MPU-9250; INV-110 ... INV-116) reads and writes registers of the devices on
that bus at each sample, by four slots, and stores the bytes that it read in EXT_SENS_DATA. Not modelled: the fifth
slot, except for the delay that the other slots share; other masters; the duration of transfers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from struct import Struct
from types import ModuleType
from typing import Any, ClassVar

from firmware_emulator.chip import Target, Triple
from firmware_emulator.six_axis import ACCELEROMETER, GYROSCOPE, SampleGrid, SixAxis, clipped
from imuarray.facts import mpu6500 as facts

SLOTS = 4
EXTERNAL = range(facts.EXT_SENS_DATA_00.address, facts.EXT_SENS_DATA_00.address + 24)
BYTE_NS = 22_500  # of a bus of 400 kHz, nine clocks
_READ, _ON, _SWAP, _NO_REGISTER, _ODD_PAIRS = 0x80, 0x80, 0x40, 0x20, 0x10
_FIRST, _STEP = facts.I2C_SLV0_ADDR.address, 3
_DATA_OUT = facts.I2C_SLV0_DO.address
_STATUS, _DELAYS, _LAST = (
    facts.I2C_MST_STATUS.address,
    facts.I2C_MST_DELAY_CTRL.address,
    facts.I2C_SLV4_CTRL.address,
)


class AuxiliaryMaster:
    """The master; `devices` are on its bus, `page` holds the registers of the die."""

    def __init__(self) -> None:
        self.devices: list[Target] = []

    def transfer(self, page: bytearray, index: int, at_ns: int) -> None:
        """Carry out every transfer of sample number `index`, at `at_ns`."""
        place, delay = EXTERNAL.start, delay_of(page)
        for slot in range(SLOTS):
            address, register, control = page[_FIRST + slot * _STEP : _FIRST + (slot + 1) * _STEP]
            if not control & _ON:
                continue
            is_reading, count = bool(address & _READ), control & 0x0F
            is_due = not (page[_DELAYS] >> slot & 1 and index % (1 + delay))
            device = next((device for device in self.devices if device.address == address & 0x7F), None)
            if is_due and device is None:
                page[_STATUS] |= 1 << slot
            elif is_due and device is not None:
                command = b"" if control & _NO_REGISTER else bytes([register])
                if is_reading:
                    data = _read_device(device, command, count, at_ns)
                    if control & _SWAP:
                        data = swapped(data, (register + bool(control & _ODD_PAIRS)) & 1)
                    stop = min(place + count, EXTERNAL.stop)
                    page[place:stop] = data[: stop - place]
                else:
                    device.write(command + page[_DATA_OUT + slot : _DATA_OUT + slot + 1], at_ns, BYTE_NS)
                device.stop(at_ns)
            place += count if is_reading else 0

    @staticmethod
    def recorded(page: bytearray, slots: int) -> bytes:
        """Return the bytes for the queue that were read by the slots with a set bit in `slots`."""
        data, place = b"", EXTERNAL.start
        for slot in range(SLOTS):
            address, _, control = page[_FIRST + slot * _STEP : _FIRST + (slot + 1) * _STEP]
            if control & _ON and address & _READ:
                count = control & 0x0F
                data += bytes(page[place : place + count]) if slots >> slot & 1 else b""
                place += count
        return data


def delay_of(page: bytearray) -> int:
    """Return the number of samples between two transfers of a slot with delay, minus one (INV-115)."""
    return facts.MASTER_DELAY.of(page[_LAST])


def _read_device(device: Target, command: bytes, count: int, at_ns: int) -> bytes:
    if command:
        device.write(command, at_ns, BYTE_NS)
    return device.read(count, at_ns, BYTE_NS)


def swapped(data: bytes, first_is_alone: int) -> bytes:
    """Return the bytes with each pair swapped. With `first_is_alone`, the first byte stays, as does a last byte without
    a partner.
    """
    turned = bytearray(data)
    for index in range(first_is_alone, len(data) - 1, 2):
        turned[index], turned[index + 1] = turned[index + 1], turned[index]
    return bytes(turned)


CODES_PER_G = (16384.0, 8192.0, 4096.0, 2048.0)  # INV-40, INV-77
CODES_PER_DPS = (131.0, 65.5, 32.8, 16.4)  # INV-41, INV-77
RANGES_G = (2.0, 4.0, 8.0, 16.0)
RANGES_DPS = (250.0, 500.0, 1000.0, 2000.0)
RESET_NS = 100_000_000  # INV-25, INV-71
BASE_PERIOD_NS, UNFILTERED_PERIOD_NS = 1_000_000, 125_000  # INV-11, INV-72
WORDS = Struct(">7h")
DATA = range(0x3B, 0x49)  # INV-20, INV-75
INT_PIN_CFG, BYPASS, MASTER = 0x37, 0x02, 0x20  # INV-97
FIFO_EN, INT_STATUS, USER_CTRL, COUNT_HIGH, COUNT_LOW, FIFO = 0x23, 0x3A, 0x6A, 0x72, 0x73, 0x74
OVERFLOW, DATA_READY = 0x10, 0x01
CONFIG = facts.CONFIG.address
PULSE_MARKS = (None, 0x42, 0x44, 0x46, 0x48, 0x3C, 0x3E, 0x40)
"""The register whose lowest bit marks the first sample after a pulse, by EXT_SYNC_SET (INV-38)."""
ON, RESET = 0x40, 0x04
MASTER_CONTROL, MASTER_STATUS = facts.I2C_MST_CTRL.address, facts.I2C_MST_STATUS.address
MOST_TRANSFERS = 64
"""Limit of the number of past samples for which transfers on the auxiliary bus are carried out, in multiples of the
delay in samples.
"""


def _codes(sample: Triple, scale: float, push: Triple, ratio: float, pushed: int) -> list[int]:
    """Return three codes; bit 2 of `pushed` deflects x, bit 0 z, by `push` times `ratio` (INV-13, INV-14, INV-75)."""
    return [
        clipped(round(value * scale + change * ratio * (pushed >> bit & 1)))
        for value, change, bit in zip(sample, push, (2, 1, 0), strict=True)
    ]


class MpuFamily(SixAxis):
    """A die with one grid of samples, a queue of `fifo_bytes`, and one `trim_code` of the factory for every axis."""

    fifo_bytes: ClassVar[int]
    default_trim_code: ClassVar[int]
    accel_push_range: ClassVar[int]
    """Range code at which `accel_push` gives the change of the accelerometer by its self-test."""
    reset_ns: ClassVar[int] = RESET_NS
    on_bypass: Callable[[], None] | None = None
    """Function that is called when the bypass opens or closes."""

    @property
    def bypass_open(self) -> bool:
        """True while the auxiliary bus is connected to the array's (INV-97)."""
        return bool(self.page[INT_PIN_CFG] & BYPASS) and not self.page[USER_CTRL] & MASTER

    def __init__(self, *arguments: Any, trim_code: int | None = None, **switches: Any) -> None:
        self._trim_code = self.default_trim_code if trim_code is None else trim_code
        self._queue: deque[int] = deque(maxlen=self.fifo_bytes)
        self.auxiliary = AuxiliaryMaster()
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Set the reset values and empty the queue."""
        super().power_on(at_ns)
        self._queue.clear()
        self._last_byte = self._count = self._flags = 0
        self._grid = SampleGrid(period_ns=BASE_PERIOD_NS)
        self._queued = -1

    def low_passes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return bandwidth (Hz) and delay (s) of the accelerometer's and of the gyroscope's filter."""
        raise NotImplementedError

    def temperature_code(self, degc: float) -> int:
        """Return the code of a temperature."""
        raise NotImplementedError

    def accel_push(self) -> Triple:
        """Return the change of the accelerometer by the self-test, in codes."""
        raise NotImplementedError

    def gyro_push(self) -> Triple:
        """Return the change of the gyroscope by the self-test, in codes at the smallest range."""
        raise NotImplementedError

    def _convert(self, at_ns: int) -> None:
        table: ModuleType = self.table
        accel, gyro = self.page[table.ACCEL_CONFIG.address], self.page[table.GYRO_CONFIG.address]
        accel_filter, gyro_filter = self.low_passes()
        scale = table.ACCEL_RANGE.of(accel)
        force = self.sample(ACCELEROMETER, at_ns, RANGES_G[scale], *accel_filter)
        ratio = CODES_PER_G[scale] / CODES_PER_G[self.accel_push_range]
        ax, ay, az = _codes(force, CODES_PER_G[scale], self.accel_push(), ratio, table.ACCEL_SELF_TEST.of(accel))
        scale = table.GYRO_RANGE.of(gyro)
        rate = self.sample(GYROSCOPE, at_ns, RANGES_DPS[scale], *gyro_filter)
        ratio = CODES_PER_DPS[scale] / CODES_PER_DPS[0]
        gx, gy, gz = _codes(rate, CODES_PER_DPS[scale], self.gyro_push(), ratio, table.GYRO_SELF_TEST.of(gyro))
        temperature = clipped(self.temperature_code(self.degc(at_ns)))
        self.page[DATA.start : DATA.stop] = WORDS.pack(ax, ay, az, temperature, gx, gy, gz)

    def _sync(self, at_ns: int) -> None:
        """Store the samples up to `at_ns` in the queue, and the latest one in the data registers."""
        latest = self._grid.latest(at_ns)
        if latest <= self._grid.index:
            return
        self._flags |= DATA_READY
        if self.page[USER_CTRL] & ON and self.page[FIFO_EN]:
            size = len(self._record())
            capacity = self.fifo_bytes // max(size, 1) + 2
            if size and len(self._queue) + size * (latest - self._queued) > self.fifo_bytes:
                self._flags |= OVERFLOW
            for index in range(max(self._queued + 1, latest - capacity), latest + 1):
                self._sample(index)
                self._queue.extend(self._record())
        elif self.page[USER_CTRL] & MASTER:
            longest = MOST_TRANSFERS * (1 + delay_of(self.page))
            for index in range(max(self._queued + 1, latest - longest), latest):
                self.auxiliary.transfer(self.page, index, self._grid.time_ns(index))
        if self._grid.index != latest:
            self._sample(latest)
        self._queued = latest

    def _sample(self, index: int) -> None:
        at_ns = self._grid.time_ns(index)
        self._convert(at_ns)
        if (place := PULSE_MARKS[facts.EXT_SYNC.of(self.page[CONFIG])]) is not None:
            self.page[place] = self.page[place] & 0xFE | self.is_marked(self._grid, at_ns)
        if self.page[USER_CTRL] & MASTER:
            self.auxiliary.transfer(self.page, index, self._grid.time_ns(index))
        self._grid.index = index

    def _record(self) -> bytes:
        """Return the data bytes that FIFO_EN selects, in the order of their registers: bit 7 temperature, 6 ... 4
        gyroscope x to z, 3 accelerometer, then the bytes that the slots of the auxiliary bus read: bits 2 ... 0 and bit
        5 of I2C_MST_CTRL.
        """
        enabled = self.page[FIFO_EN]
        data = bytes(self.page[DATA.start : DATA.stop])
        selected = data[:6] if enabled & 0x08 else b""
        selected += data[6:8] if enabled & 0x80 else b""
        for axis, mask in enumerate((0x40, 0x20, 0x10)):
            selected += data[8 + 2 * axis : 10 + 2 * axis] if enabled & mask else b""
        slots = enabled & 0x07 | (0x08 if self.page[MASTER_CONTROL] & 0x20 else 0)
        return selected + self.auxiliary.recorded(self.page, slots) if slots else selected

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte. Reading flags clears them; reading the high byte of the count latches both."""
        if address == INT_STATUS:
            flags, self._flags = self._flags, 0
            return flags
        if address == MASTER_STATUS:
            status, self.page[address] = self.page[address], 0
            return status
        if address == COUNT_HIGH:
            self._count = len(self._queue)
            return self._count >> 8
        if address == COUNT_LOW:
            return self._count & 0xFF
        if address == FIFO:
            if self._queue:
                self._last_byte = self._queue.popleft()
            return self._last_byte
        return self.page[address]

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next register; the pointer stays at the register of the queue."""
        return pointer if pointer == FIFO else super().advance(pointer, reading)

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Write a byte to a register; `on_bypass` is called when the bypass is opened or closed."""
        was_open = self.bypass_open
        self._store(address, value, at_ns)
        if self.on_bypass is not None and was_open != self.bypass_open:
            self.on_bypass()

    def _store(self, address: int, value: int, at_ns: int) -> None:
        """Write to a register, and apply the effect on the queue."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        if self.begin_reset(address, value, at_ns):
            return
        if address == FIFO:
            return  # bytes written to the queue are not modelled: DEC-251
        super().store(address, value, at_ns)
        if address == USER_CTRL:
            if value & RESET:
                self._queue.clear()
            self.page[address] &= ~0x07 & 0xFF  # the bits that reset something clear themselves
        self._restart(address, at_ns)
        self._queued = self._grid.index

    def _restart(self, address: int, at_ns: int) -> None:
        """Restart the grid if the write of this register changed the rate or woke the die."""
        raise NotImplementedError
