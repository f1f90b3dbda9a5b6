"""MPU-6050 accelerometer and gyroscope: InvenSense RM-MPU-6000A rev. 4.2, PS-MPU-6000A rev. 3.4; INV-*, DEC-40 to -43.

Samples fall on the die's own grid from the moment at which it wakes. Not modelled: auxiliary bus, motion
detection, the low-power cycle, standby of single axes, and the settling of the zero-rate level.
"""

from __future__ import annotations

import math
from collections import deque
from struct import Struct
from types import ModuleType
from typing import Any, ClassVar

from firmware_emulator.chip import Element, Triple
from firmware_emulator.six_axis import ACCELEROMETER, GYROSCOPE, Die, Grid, SixAxis, clipped
from firmware_emulator.tolerances import NONE, Tolerances, typical
from imuarray.facts import mpu6050 as facts
from imuarray.facts.registers import Field, Register

RESET_NS = 100_000_000  # INV-25
CODES_PER_G = (16384.0, 8192.0, 4096.0, 2048.0)  # INV-40
CODES_PER_DPS = (131.0, 65.5, 32.8, 16.4)  # INV-41
RANGES_G = (2.0, 4.0, 8.0, 16.0)
RANGES_DPS = (250.0, 500.0, 1000.0, 2000.0)
ACCEL_BANDWIDTHS_HZ = (260.0, 184.0, 94.0, 44.0, 21.0, 10.0, 5.0, 260.0)  # by DLPF_CFG: INV-12, DEC-42
GYRO_BANDWIDTHS_HZ = (256.0, 188.0, 98.0, 42.0, 20.0, 10.0, 5.0, 256.0)
UNFILTERED = (0, 7)  # the gyroscope then delivers 8 kHz: INV-11
BASE_PERIOD_NS, UNFILTERED_PERIOD_NS = 1_000_000, 125_000
FIFO_BYTES = 1024  # INV-27
WORDS = Struct(">7h")
TRIM_CODE = 17
"""Of every axis, unless told otherwise: the middle of the codes (DEC-43)."""

_DATA = range(facts.ACCEL_XOUT_H.address, facts.GYRO_ZOUT_L.address + 1)
_FIFO = facts.FIFO_R_W.address


class Mpu6050(SixAxis):
    """The registers and the queue of 1024 bytes; `identity` is 0x98 for a clone (INV-03)."""

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register] = facts.WHO_AM_I
    reset_bit: ClassVar[Field] = facts.DEVICE_RESET
    reset_ns: ClassVar[int] = RESET_NS

    def __init__(
        self, address: int, element: Element, powered_on_ns: int = 0, *, trim_code: int = TRIM_CODE, **switches: Any
    ) -> None:
        self._trim_code = trim_code
        self._queue: deque[int] = deque(maxlen=FIFO_BYTES)
        super().__init__(address, element, powered_on_ns, **switches)

    def power_on(self, at_ns: int) -> None:
        """Asleep, every register at its reset value, the queue empty (INV-10, INV-25)."""
        super().power_on(at_ns)
        code = self._trim_code
        high, low = (code >> 2) << 5 | code, code & 0b11
        self.page[facts.SELF_TEST_X.address : facts.SELF_TEST_A.address + 1] = bytes(
            (high, high, high, low << 4 | low << 2 | low)
        )
        self._queue.clear()
        self._last_byte = 0
        self._count = 0
        self._flags = 0
        self._grid = Grid(period_ns=BASE_PERIOD_NS)
        self._queued = -1

    # Sampling -------------------------------------------------------------------------------------------------------

    def _sync(self, at_ns: int) -> None:
        """Take in the samples up to `at_ns`: into the queue, and the latest one into the data registers (INV-30)."""
        latest = self._grid.latest(at_ns)
        if latest <= self._grid.index:
            return
        self._flags |= facts.DATA_READY.mask
        if self._queueing:
            size = len(self._queued_bytes())
            kept = FIFO_BYTES // max(size, 1) + 2
            if size and len(self._queue) + size * (latest - self._queued) > FIFO_BYTES:
                self._flags |= facts.FIFO_OVERFLOW.mask
            for index in range(max(self._queued + 1, latest - kept), latest + 1):
                self._convert(index)
                self._queue.extend(self._queued_bytes())
        if self._grid.index != latest:
            self._convert(latest)
        self._queued = latest

    @property
    def _queueing(self) -> bool:
        return bool(facts.FIFO_ON.of(self.page[facts.USER_CTRL.address]) and self.page[facts.FIFO_EN.address])

    def _queued_bytes(self) -> bytes:
        """The data bytes that FIFO_EN selects, in the order of their registers (INV-27)."""
        enabled = self.page[facts.FIFO_EN.address]
        data = bytes(self.page[_DATA.start : _DATA.stop])
        axes = facts.FIFO_GYRO.of(enabled)
        selected = data[:6] if facts.FIFO_ACCEL.of(enabled) else b""
        selected += data[6:8] if facts.FIFO_TEMPERATURE.of(enabled) else b""
        for axis in range(3):  # bit 6 is x, bit 4 is z
            selected += data[8 + 2 * axis : 10 + 2 * axis] if axes >> (2 - axis) & 1 else b""
        return selected

    def _convert(self, index: int) -> None:
        """Sample number `index` into the data registers."""
        at_ns = self._grid.time_ns(index)
        page = self.page
        accel, gyro = page[facts.ACCEL_CONFIG.address], page[facts.GYRO_CONFIG.address]
        low_pass = facts.DLPF.of(page[facts.CONFIG.address])
        scale = facts.ACCEL_RANGE.of(accel)
        force = self.felt(ACCELEROMETER, at_ns, RANGES_G[scale], ACCEL_BANDWIDTHS_HZ[low_pass])
        push = self._accel_push() * CODES_PER_G[scale] / CODES_PER_G[0b10]
        ax, ay, az = _codes(force, CODES_PER_G[scale], (push, push, push), facts.ACCEL_SELF_TEST.of(accel))
        scale = facts.GYRO_RANGE.of(gyro)
        rate = self.felt(GYROSCOPE, at_ns, RANGES_DPS[scale], GYRO_BANDWIDTHS_HZ[low_pass])
        push = self._gyro_push() * CODES_PER_DPS[scale] / CODES_PER_DPS[0]
        gx, gy, gz = _codes(rate, CODES_PER_DPS[scale], (push, -push, push), facts.GYRO_SELF_TEST.of(gyro))
        temperature = clipped(round((self.degc(at_ns) - 35.0) * 340.0 - 521.0))  # INV-42
        page[_DATA.start : _DATA.stop] = WORDS.pack(ax, ay, az, temperature, gx, gy, gz)
        self._grid.index = index

    def _accel_push(self) -> float:
        """Codes at 8 g that the self-test adds (INV-46)."""
        return 1392.64 * (0.92 / 0.34) ** ((self._trim_code - 1) / 30) if self._trim_code else 0.0

    def _gyro_push(self) -> float:
        """Codes at 250 dps that the self-test adds to x and z and takes from y (INV-47)."""
        return 3275.0 * 1.046 ** (self._trim_code - 1) if self._trim_code else 0.0

    # Reading --------------------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """One burst shows one instant: the data registers stand still until STOP (INV-30)."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        data = bytes(self.page[_DATA.start : _DATA.stop])
        first = self.pointer - _DATA.start
        if first >= 0 and first + count <= len(data):
            self.pointer += count
            sent = data[first : first + count]
        else:
            sent = super().read(count, at_ns, byte_ns)
        if facts.INT_READ_CLEAR.of(self.page[facts.INT_PIN_CFG.address]):
            self._flags = 0  # INV-22
        return sent

    def load(self, address: int, at_ns: int) -> int:
        """A register's byte."""
        if address == facts.INT_STATUS.address:
            flags, self._flags = self._flags, 0
            return flags
        if address == facts.FIFO_COUNT_H.address:
            self._count = len(self._queue)  # both bytes are taken now (INV-26)
            return self._count >> 8
        if address == facts.FIFO_COUNT_L.address:
            return self._count & 0xFF
        if address == _FIFO:
            if self._queue:
                self._last_byte = self._queue.popleft()
            return self._last_byte  # of an empty queue once more the last one (INV-27)
        return self.page[address]

    def advance(self, pointer: int, reading: bool) -> int:
        """The next register; the queue's stays where it is (INV-27)."""
        return pointer if pointer == _FIFO else super().advance(pointer, reading)

    # Writing --------------------------------------------------------------------------------------------------------

    def store(self, address: int, value: int, at_ns: int) -> None:
        """A byte written to a register: what was sampled before stays as it was."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        if self.begin_reset(address, value, at_ns):
            return
        if address == _FIFO:
            return  # bytes written to the queue are not modelled: DEC-41
        super().store(address, value, at_ns)
        if address == facts.USER_CTRL.address:
            if value & facts.FIFO_RESET.mask:
                self._queue.clear()
            once = facts.FIFO_RESET.mask | facts.MASTER_RESET.mask | facts.SIGNAL_RESET.mask
            self.page[address] &= ~once & 0xFF
        if address in (facts.PWR_MGMT_1.address, facts.SMPLRT_DIV.address, facts.CONFIG.address):
            self._restart(at_ns)
        self._queued = self._grid.index

    def _restart(self, at_ns: int) -> None:
        """The grid of samples begins anew with another rate, and when the die wakes (DEC-40)."""
        fast = facts.DLPF.of(self.page[facts.CONFIG.address]) in UNFILTERED
        base_ns = UNFILTERED_PERIOD_NS if fast else BASE_PERIOD_NS
        period_ns = base_ns * (1 + self.page[facts.SMPLRT_DIV.address])
        asleep = facts.SLEEP.of(self.page[facts.PWR_MGMT_1.address])
        self._grid.set(at_ns, 0 if asleep else period_ns)


def _codes(felt: Triple, scale: float, push: Triple, pushed: int) -> tuple[int, int, int]:
    """Three codes; bit 2 of `pushed` deflects x, bit 0 z (INV-13, INV-14)."""
    x, y, z = (
        clipped(round(value * scale + (more if pushed >> bit & 1 else 0.0)))
        for value, more, bit in zip(felt, push, (2, 1, 0), strict=True)
    )
    return x, y, z


def accelerometer_tolerances(_: float) -> Tolerances:
    """INV-50 ... INV-55; alignment is not specified apart from the cross-axis sensitivity."""
    warmer = 45.0  # from 25 degC to the end of the range over which the change is printed
    return Tolerances(
        bias=(typical(0.050), typical(0.050), typical(0.080)),
        slope_per_degc=(typical(0.035 / warmer), typical(0.035 / warmer), typical(0.060 / warmer)),
        scale=typical(0.03),
        cross_axis=typical(0.02),
        alignment_deg=NONE,
        noise=(400e-6 * math.sqrt(44.0),) * 3,
        noise_full_scale=2.0,
        noise_bandwidth_hz=44.0,
        scale_slope_per_degc=typical(2e-4),
        thermometer_degc=typical(1.0),
    )


def gyroscope_tolerances(_: float) -> Tolerances:
    """INV-60 ... INV-66."""
    warmer = 65.0  # from 25 degC to the far end of -40 ... 85 degC
    return Tolerances(
        bias=(typical(20.0),) * 3,
        slope_per_degc=(typical(20.0 / warmer),) * 3,
        scale=typical(0.03),
        cross_axis=typical(0.02),
        alignment_deg=NONE,
        noise=(0.005 * math.sqrt(42.0),) * 3,
        noise_full_scale=250.0,
        noise_bandwidth_hz=42.0,
        scale_slope_per_degc=typical(0.02 / warmer),
        g_sensitivity=typical(0.1),
        thermometer_degc=typical(1.0),
    )


DIE = Die(Mpu6050, (facts.ACCEL_XOUT_H, facts.GYRO_XOUT_H), (accelerometer_tolerances, gyroscope_tolerances))
