"""ICM-42688-P accelerometer and gyroscope: TDK InvenSense DS-000347 v1.7; TDK-*, DEC-60 to -65.

After power-on both halves are off and every reading is -32768. Each half has its own grid of samples, which begins when
the half is switched on. Not modelled: interrupts, low-power modes, notch filter, the filters' delay.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

from firmware_emulator.chip import NEVER_NS, Triple, registers_of
from firmware_emulator.six_axis import ACCELEROMETER, GYROSCOPE, Die, SampleGrid, SixAxis, clipped
from firmware_emulator.tolerances import Tolerances, typical
from imuarray.facts import icm42688 as facts
from imuarray.facts.registers import Field, Register

RESET_NS = 1_000_000  # TDK-20
INVALID = b"\x80\x00"  # TDK-13
LOWEST = -32767
FINE_INVALID = -524288  # of 20 bits: TDK-88
FINE_PER_G, FINE_PER_DPS = 8192.0, 131.0  # TDK-89
RANGES_G = (16.0, 8.0, 4.0, 2.0)  # by code: TDK-14
RANGES_DPS = (2000.0, 1000.0, 500.0, 250.0, 125.0, 62.5, 31.25, 15.625)
CODES_PER_G = (2048.0, 4096.0, 8192.0, 16384.0)  # TDK-30
CODES_PER_DPS = (16.4, 32.8, 65.5, 131.0, 262.0, 524.3, 1048.6, 2097.2)  # TDK-31
RATES_HZ = {1: 32000.0, 2: 16000.0, 3: 8000.0, 4: 4000.0, 5: 2000.0, 6: 1000.0, 7: 200.0, 8: 100.0, 9: 50.0, 10: 25.0}
RATES_HZ |= {11: 12.5, 12: 6.25, 13: 3.125, 14: 1.5625, 15: 500.0}  # TDK-15
FILTER_SHARES = {1: 4, 2: 5, 3: 8, 4: 10, 5: 16, 6: 20, 7: 40}  # of the rate, but of 400 Hz at least: TDK-16
TRIM_CODE = 120
"""Trim code of every axis by default (DEC-62): a deflection of 65 dps and of 0.52 g."""
STALL_DPS, STALL_NS = 100.0, 1_500_000  # TDK-18, DEC-63

CLOCK_INPUT, PULSE_INPUT = 0b10, 0b01  # TDK-24
CLOCK_HZ = 32_000.0
"""Frequency of an external clock at which rates equal their codes: TDK-25."""
FIFO_BYTES = 2048  # TDK-80
EMPTY = 0xFF  # TDK-81
STOP_ON_FULL = 0b10

_DATA = range(facts.TEMP_DATA1.address, facts.GYRO_DATA_Z0.address + 1)


@dataclass
class _Half:
    """One half: the fields of its mode and rate, the registers of its triad, and the time from which on its readings
    are valid.
    """

    mode: Field
    rate: Field
    startup_ns: int
    place: slice
    grid: SampleGrid
    zero_bits: int
    """The number of lowest bits of the 20 that are always 0 in packets of high resolution (TDK-89)."""
    valid_ns: int = NEVER_NS
    fine: tuple[int, ...] = (FINE_INVALID,) * 3
    """Its latest reading in 20 bits."""


class Icm42688Chip(SixAxis):
    """The registers of three banks. `trim_code` is the factory's self-test code, `clock_input_hz` the frequency at pin
    9 (0: no clock is connected).
    """

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.WHO_AM_I
    reset_bit: ClassVar[Field] = facts.SOFT_RESET
    reset_ns: ClassVar[int] = RESET_NS

    def __init__(
        self, *arguments: Any, trim_code: int = TRIM_CODE, clock_input_hz: float = 0.0, **switches: Any
    ) -> None:
        self._trim_code, self._clock_input_hz = trim_code, clock_input_hz
        super().__init__(*arguments, **switches)

    def power_on(self, at_ns: int) -> None:
        """Switch both halves off and set every register of every bank to its reset value (TDK-10, TDK-11)."""
        super().power_on(at_ns)
        self.banks = {bank: bytearray(256) for bank in (1, 2)}
        for bank, page in self.banks.items():
            for address, register in registers_of(facts, bank).items():
                page[address] = register.reset
        for register in (facts.XG_ST_DATA, facts.XA_ST_DATA):
            self.banks[register.bank][register.address : register.address + 3] = bytes([self._trim_code] * 3)
        self._halves = {  # start-up times: TDK-21
            ACCELEROMETER: _Half(facts.ACCEL_MODE, facts.ACCEL_RATE, 20_000_000, slice(0x1F, 0x25), SampleGrid(), 2),
            GYROSCOPE: _Half(facts.GYRO_MODE, facts.GYRO_RATE, 60_000_000, slice(0x25, 0x2B), SampleGrid(), 1),
        }
        self._flags = facts.INT_STATUS.reset
        self._clear_queue()
        self._rate_dps: Triple = (0.0, 0.0, 0.0)
        self._stalled_until_ns = 0

    @property
    def _speed(self) -> float:
        """Return the ratio of the actual to the nominal rate of sampling and counting: that of the oscillator, or of
        the clock at pin 9 if both registers select it (TDK-24, TDK-25); 0 if that clock is not connected.
        """
        pin = facts.PIN_9.of(self.banks[1][facts.INTF_CONFIG5.address])
        if pin == CLOCK_INPUT and facts.RTC_MODE.of(self.page[facts.INTF_CONFIG1.address]):
            return self._clock_input_hz / CLOCK_HZ
        return self._oscillator

    def own_period_ns(self, period_ns: float) -> int:
        """Return the same period as `SixAxis.own_period_ns`; 0 without a clock."""
        speed = self._speed
        return round(period_ns / speed) if speed else 0

    # Sampling -------------------------------------------------------------------------------------------------------

    def _sync(self, at_ns: int) -> None:
        """Store the samples up to `at_ns` in the queue, and the latest one of each half in the data registers."""
        mode, packets = facts.FIFO_MODE.of(self.page[facts.FIFO_CONFIG.address]), self._packet_control & 0b11
        if mode and packets:
            name = ACCELEROMETER if packets & 1 and self._halves[ACCELEROMETER].grid.start_ns != NEVER_NS else GYROSCOPE
            grid = self._halves[name].grid
            latest, capacity = grid.latest(at_ns), FIFO_BYTES // self._packet_size
            first = grid.index + 1
            if mode == STOP_ON_FULL:
                latest = min(latest, first + capacity)
            for index in range(max(first, latest - capacity), latest + 1):
                sampled_ns = grid.time_ns(index)
                self._sample(sampled_ns)
                self._enqueue(self._packet(sampled_ns, self.is_marked(grid, sampled_ns)), capacity, mode)
        self._sample(at_ns)

    def _enqueue(self, packet: bytes, capacity: int, mode: int) -> None:
        """Append a packet to the queue; if it is full, the oldest packet or this one is lost (TDK-80)."""
        if len(self._packets) >= capacity:
            self._flags |= facts.FIFO_FULL.mask
            if mode == STOP_ON_FULL:
                return
            self._packets.popleft()
        self._packets.append(packet)
        control = self.page[facts.INTF_CONFIG0.address]
        size = 1 if facts.FIFO_COUNT_RECORDS.of(control) else self._packet_size
        filled, watermark = len(self._packets) * size, self._watermark
        is_reached = filled >= watermark > (0 if facts.FIFO_WATERMARK_EACH.of(self._packet_control) else filled - size)
        if watermark and is_reached:
            self._flags |= facts.FIFO_THRESHOLD.mask

    @property
    def _watermark(self) -> int:
        """Return the watermark in bytes or packets, the unit of the count; 0 means none (TDK-87)."""
        high = facts.FIFO_WATERMARK_HIGH.of(self.page[facts.FIFO_CONFIG3.address])
        return high << 8 | self.page[facts.FIFO_CONFIG2.address]

    def _clear_queue(self) -> None:
        self._packets: deque[bytes] = deque()
        self._part = self._whole = b""
        self._count = 0
        self._is_flushed = True

    @property
    def _packet_control(self) -> int:
        return self.page[facts.FIFO_CONFIG1.address]

    @property
    def _packet_size(self) -> int:
        if self._packet_control & 0b11 != 0b11:
            return 8
        return 20 if self._is_fine else 16

    @property
    def _is_fine(self) -> bool:
        """Return whether packets have high resolution, which needs both triads (DEC-64)."""
        control = self._packet_control
        return control & 0b11 == 0b11 and bool(facts.FIFO_HIGH_RESOLUTION.of(control))

    def _stamp_ns(self, at_ns: int) -> int:
        """Return the time for stamps: since the last pulse with FSYNC on (TDK-90, DEC-66), otherwise since power-on."""
        pulse_ns = self.latest_pulse_ns(at_ns) if self._has_pulse_input else None
        if pulse_ns is None or not facts.TIMESTAMP_FSYNC.of(self.page[facts.TMST_CONFIG.address]):
            return at_ns - self.powered_on_ns
        return at_ns - pulse_ns

    @property
    def _has_pulse_input(self) -> bool:
        return facts.PIN_9.of(self.banks[1][facts.INTF_CONFIG5.address]) == PULSE_INPUT

    def _packet(self, at_ns: int, is_marked: bool) -> bytes:
        """Return a packet: header, triads, temperature of 8 bits, and with both triads a time stamp (TDK-81 ...
        TDK-83), which in the first packet after a pulse is the time since that pulse (TDK-90); in high resolution the
        temperature has 16 bits, and the triads' lowest four bits are last (TDK-88).
        """
        control, page = self._packet_control, self.page
        header, data = 0, b""
        for mask, bit, half in ((1, 0x40, ACCELEROMETER), (2, 0x20, GYROSCOPE)):
            if control & mask:
                header |= bit
                data += self._upper(self._halves[half]) if self._is_fine else page[self._halves[half].place]
        word = bytes(page[_DATA.start : _DATA.start + 2])
        big = facts.DATA_BIG_ENDIAN.of(page[facts.INTF_CONFIG0.address])
        temperature = int.from_bytes(word, "big" if big else "little", signed=True)
        data += word if self._is_fine else max(-128, min(127, round(temperature / 64))).to_bytes(1, "big", signed=True)
        if header == 0x60:
            timestamps = page[facts.TMST_CONFIG.address]
            header |= 0x08 if facts.TIMESTAMP_ON.of(timestamps) and facts.FIFO_TIMESTAMP.of(control) else 0
            is_after_pulse = is_marked and facts.TIMESTAMP_FSYNC.of(timestamps) and self._has_pulse_input
            header |= 0x04 if header & 0x08 and is_after_pulse else 0
            unit_ns = 16_000 if facts.TIMESTAMP_16_US.of(timestamps) else 1_000
            stamp = int(self._stamp_ns(at_ns) * self._speed / unit_ns) & 0xFFFF
            data += stamp.to_bytes(2, "big" if big else "little") if header & 0x08 else b"\x00\x00"
        if self._is_fine:
            header |= 0x10
            pairs = zip(self._halves[ACCELEROMETER].fine, self._halves[GYROSCOPE].fine, strict=True)
            data += bytes((force & 0xF) << 4 | rate & 0xF for force, rate in pairs)
        return bytes([header]) + data

    def _upper(self, half: _Half) -> bytes:
        """Return the upper 16 of the 20 bits of each axis."""
        return b"".join(self._word(code >> 4) for code in half.fine)

    def _take_bytes(self, count: int) -> bytes:
        """Return the next bytes of the queue, followed by filling bytes if it ends before."""
        packet = self._part
        while len(packet) < count and self._packets:
            self._whole = self._packets.popleft()
            packet += self._whole
        self._part = packet[count:]
        return packet[:count] + bytes([EMPTY]) * (count - len(packet))

    def stop(self, at_ns: int) -> None:
        """End the transaction: a partly read packet will be read again from its beginning, unless partial reads are
        enabled (TDK-86).
        """
        if self._part and not facts.FIFO_RESUME.of(self._packet_control):
            self._packets.appendleft(self._whole)
            self._part = b""

    def _sample(self, at_ns: int) -> None:
        for name, half in self._halves.items():
            sampled_ns = half.grid.take(at_ns)
            if sampled_ns is None:
                continue
            self._flags |= facts.DATA_READY.mask
            if sampled_ns < half.valid_ns:
                continue
            codes = self._accelerometer(sampled_ns) if name == ACCELEROMETER else self._gyroscope(sampled_ns)
            if codes is not None:
                self.page[half.place] = b"".join(map(self._word, codes))
            temperature = clipped(round((self.degc(sampled_ns) - 25.0) * 132.48), LOWEST)  # TDK-32
            self.page[_DATA.start : _DATA.start + 2] = self._word(temperature)

    def _word(self, code: int) -> bytes:
        big = facts.DATA_BIG_ENDIAN.of(self.page[facts.INTF_CONFIG0.address])
        return code.to_bytes(2, "big" if big else "little", signed=True)

    def _bandwidth_hz(self, half: _Half, code: int) -> float:
        rate_hz = 1e9 / half.grid.period_ns
        return max(400.0, rate_hz) / FILTER_SHARES[code] if code in FILTER_SHARES else rate_hz / 2

    def _accelerometer(self, at_ns: int) -> list[int]:
        code = facts.ACCEL_RANGE.of(self.page[facts.ACCEL_CONFIG0.address]) & 0b11
        filter_code = facts.ACCEL_FILTER.of(self.page[facts.GYRO_ACCEL_CONFIG0.address])
        bandwidth_hz = self._bandwidth_hz(self._halves[ACCELEROMETER], filter_code)
        force = self.sample(ACCELEROMETER, at_ns, RANGES_G[0 if self._is_fine else code], bandwidth_hz)
        test = self.page[facts.SELF_TEST_CONFIG.address]
        pushed = facts.ACCEL_SELF_TEST.of(test) if facts.ACCEL_SELF_TEST_POWER.of(test) else 0
        if self._is_fine:
            self._convert_finely(self._halves[ACCELEROMETER], force, FINE_PER_G, pushed)
        return self._codes(force, CODES_PER_G[code], code, pushed)

    def _gyroscope(self, at_ns: int) -> list[int] | None:
        """Return the codes of a reading; None while the adaptive range holds the reading (TDK-18)."""
        code = facts.GYRO_RANGE.of(self.page[facts.GYRO_CONFIG0.address])
        filter_code = facts.GYRO_FILTER.of(self.page[facts.GYRO_ACCEL_CONFIG0.address])
        bandwidth_hz = self._bandwidth_hz(self._halves[GYROSCOPE], filter_code)
        previous, rate = (
            self._rate_dps,
            self.sample(GYROSCOPE, at_ns, RANGES_DPS[0 if self._is_fine else code], bandwidth_hz),
        )
        self._rate_dps = rate
        if facts.ADAPTIVE_RANGE.of(self.page[facts.INTF_CONFIG1.address]) != 0b01:
            if any((abs(a) < STALL_DPS) != (abs(b) < STALL_DPS) for a, b in zip(previous, rate, strict=True)):
                self._stalled_until_ns = at_ns + STALL_NS
            if at_ns < self._stalled_until_ns:
                return None
        pushed = facts.GYRO_SELF_TEST.of(self.page[facts.SELF_TEST_CONFIG.address])
        if self._is_fine:
            self._convert_finely(self._halves[GYROSCOPE], rate, FINE_PER_DPS, pushed)
        return self._codes(rate, CODES_PER_DPS[code], code, pushed)

    def _codes(self, sample: Triple, scale: float, range_code: int, pushed: int) -> list[int]:
        """Return three codes; bit 0 of `pushed` deflects x (TDK-41), by the change that was measured at the factory for
        this range (TDK-40).
        """
        push = self._push(range_code)
        return [
            clipped(round(value * scale + push * (pushed >> axis & 1)), LOWEST) for axis, value in enumerate(sample)
        ]

    def _push(self, range_code: int) -> float:
        """Return the change by the self-test that was measured at the factory, in counts of this range; 0 if none is
        stored.
        """
        return 2620.0 / 2.0 ** (3 - range_code) * 1.01 ** (self._trim_code - 1) if self._trim_code else 0.0

    def _convert_finely(self, half: _Half, sample: Triple, scale: float, pushed: int) -> None:
        """Store a reading with 20 bits, the lowest of which are 0; its scale does not depend on the range."""
        highest = (1 << 19 - half.zero_bits) - 1
        push = self._push(0) * (1 << 4 - half.zero_bits)
        codes = (round(value * scale + push * (pushed >> axis & 1)) for axis, value in enumerate(sample))
        half.fine = tuple(max(-highest, min(highest, code)) << half.zero_bits for code in codes)

    # Reading and writing ----------------------------------------------------------------------------------------------

    @property
    def _bank(self) -> int:
        return facts.BANK.of(self.page[facts.REG_BANK_SEL.address])

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read a burst; all its bytes belong to one instant (DEC-60)."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        head_bytes = min(count, facts.FIFO_DATA.address - self.pointer)
        if head_bytes < 0 or self._bank:
            return super().read(count, at_ns, byte_ns)
        return super().read(head_bytes, at_ns, byte_ns) + self._take_bytes(count - head_bytes)

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte in the selected bank; the bank's own register is in all banks (TDK-04)."""
        if address != facts.REG_BANK_SEL.address and self._bank:
            return self.banks[self._bank][address] if self._bank in self.banks else 0
        if address == facts.INT_STATUS.address:
            flags, self._flags = self._flags, 0  # TDK-19
            return flags
        if address in (facts.FIFO_COUNTH.address, facts.FIFO_COUNTL.address):
            return self._count_byte(address == facts.FIFO_COUNTH.address)
        return self.page[address]

    def _count_byte(self, first: bool) -> int:
        """Return a byte of the count of bytes or records; reading the first one latches both. The count is 0 once after
        a flush (TDK-84).
        """
        control = self.page[facts.INTF_CONFIG0.address]
        if first:
            records = facts.FIFO_COUNT_RECORDS.of(control)
            self._count = len(self._packets) if records else len(self._packets) * self._packet_size + len(self._part)
            self._count, self._is_flushed = 0 if self._is_flushed else self._count, False
        high = first == bool(facts.FIFO_COUNT_BIG_ENDIAN.of(control))
        return self._count >> 8 if high else self._count & 0xFF

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Write a byte to a register; samples before it are unchanged."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        bank = self._bank if address != facts.REG_BANK_SEL.address else 0
        if bank:
            register = registers_of(facts, bank).get(address)
            if register is not None and register.access != "r":
                self.banks[bank][address] = value & ~register.reserved & 0xFF
            return
        if self.begin_reset(address, value, at_ns):
            return
        if address == facts.SIGNAL_PATH_RESET.address:
            if value & facts.FIFO_FLUSH.mask:
                self._clear_queue()
            if value & facts.TIMESTAMP_STROBE.mask:
                self._hold_timestamp(at_ns)
            return
        previous = self.page[address]
        super().store(address, value, at_ns)
        if address in (facts.FIFO_CONFIG.address, facts.FIFO_CONFIG1.address) and self.page[address] != previous:
            self._clear_queue()  # DEC-64
        if address in (facts.PWR_MGMT0.address, facts.GYRO_CONFIG0.address, facts.ACCEL_CONFIG0.address):
            for half in self._halves.values():
                self._restart(half, at_ns)

    def _hold_timestamp(self, at_ns: int) -> None:
        """Write the time since power-on (20 bits, low byte first), or 0 if disabled, into its registers (TDK-91)."""
        control = self.page[facts.TMST_CONFIG.address]
        is_read = facts.TIMESTAMP_ON.of(control) and facts.TIMESTAMP_TO_REGISTERS.of(control)
        unit_ns = 16_000 if facts.TIMESTAMP_16_US.of(control) else 1_000
        count = int((at_ns - self.powered_on_ns) * self._speed / unit_ns) & 0xFFFFF if is_read else 0
        first = facts.TMSTVAL0.address
        self.banks[1][first : first + 3] = count.to_bytes(3, "little")

    def _restart(self, half: _Half, at_ns: int) -> None:
        """Restart the grid if the rate changed or the half was switched on (DEC-61); a half that is off has invalid
        readings.
        """
        rate_hz = RATES_HZ.get(half.rate.of(self.page[half.rate.register.address]), 1000.0)
        mode = half.mode.of(self.page[facts.PWR_MGMT0.address])
        is_on = mode == 0b11 or (mode == 0b10 and half.mode == facts.ACCEL_MODE)  # TDK-11
        if half.grid.set(at_ns, self.own_period_ns(1e9 / rate_hz) if is_on else 0):
            half.valid_ns = at_ns + half.startup_ns
        elif not is_on:
            self.page[half.place] = INVALID * 3
            half.fine = (FINE_INVALID,) * 3
            if all(other.grid.start_ns == NEVER_NS for other in self._halves.values()):
                self.page[_DATA.start : _DATA.start + 2] = INVALID


ACCELEROMETER_TOLERANCES = Tolerances(
    bias=(typical(0.020),) * 3,
    slope_per_degc=(typical(0.15e-3),) * 3,
    scale=typical(0.005),
    cross_axis=typical(0.01),
    noise=(70e-6 * math.sqrt(100.0),) * 3,
    noise_full_scale=2.0,
    noise_bandwidth_hz=100.0,
    scale_slope_per_degc=typical(5e-5),
    thermometer_degc=typical(5.0),
)
"""The tolerances TDK-50 ... TDK-54; apart from the cross-axis sensitivity, alignment is not specified."""


GYROSCOPE_TOLERANCES = Tolerances(
    bias=(typical(0.5),) * 3,
    slope_per_degc=(typical(0.005),) * 3,
    scale=typical(0.005),
    cross_axis=typical(0.0125),
    noise=(2.8e-3 * math.sqrt(100.0),) * 3,
    noise_full_scale=250.0,
    noise_bandwidth_hz=100.0,
    scale_slope_per_degc=typical(5e-5),
    thermometer_degc=typical(5.0),
)
"""The tolerances TDK-60 ... TDK-64; a sensitivity to force is not printed."""


DIE = Die(Icm42688Chip, (facts.ACCEL_DATA_X1, facts.GYRO_DATA_X1), (ACCELEROMETER_TOLERANCES, GYROSCOPE_TOLERANCES))
