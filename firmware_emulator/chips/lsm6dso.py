"""LSM6DSO accelerometer and gyroscope: ST DS12140 Rev 2; LSM-*, DEC-70 to -74.

After power-on both halves are off. Each half has its own grid of samples, which begins when its rate is set; if the
other half is on, it begins at a sample of that half, because both rates are divided from one clock. Not modelled: the
queue's compression and watermark, interrupts, embedded functions, low-power modes, the gyroscope's optional filters,
settling.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from types import ModuleType
from typing import ClassVar

from firmware_emulator.chip import Triple
from firmware_emulator.six_axis import ACCELEROMETER, GYROSCOPE, Die, SampleGrid, SixAxis, clipped
from firmware_emulator.tolerances import Tolerances, typical
from imuarray.facts import lsm6dso as facts
from imuarray.facts.registers import Field, Register

RESET_NS = 50_000  # LSM-16
RATES_HZ = (12.5, 26.0, 52.0, 104.0, 208.0, 416.0, 833.0, 1666.0, 3332.0, 6664.0)  # by code from 1 on: LSM-15
RANGES_G = {0b00: (2.0, 0.061), 0b01: (16.0, 0.488), 0b10: (4.0, 0.122), 0b11: (8.0, 0.244)}  # with mg a code: LSM-30
RANGES_DPS = {  # with mdps a code: LSM-14, LSM-31
    0b000: (250.0, 8.75),
    0b001: (125.0, 4.375),
    0b010: (500.0, 17.5),
    0b100: (1000.0, 35.0),
    0b110: (2000.0, 70.0),
}
ACCEL_FILTER_SHARES = (4, 10, 20, 45, 100, 200, 400, 800)  # of the rate, with LPF2: LSM-19
GYRO_BANDWIDTHS_HZ = {104.0: 33.0, 208.0: 66.8, 416.0: 135.9, 833.0: 295.5, 1666.0: 1108.1}  # LSM-19
PUSH_G, PUSH_DPS = 0.4, 300.0
"""Change of the output by the self-test in g and dps, within the data sheet's limits (DEC-72)."""

FIFO_WORDS = 512  # LSM-40
TAGS = {GYROSCOPE: 0x01, ACCELEROMETER: 0x02}  # LSM-41
TEMPERATURE_TAG = 0x03
TIMESTAMP_TAG = 0x04
TIMESTAMP_NS = 25_000  # LSM-46
TIMESTAMP_RESET = 0xAA  # LSM-46
FREQ_FINE_STEP = 0.0015  # LSM-47
SLOTS_PER_TIMESTAMP = (0, 1, 8, 32)  # LSM-48
TEMPERATURE_RATES_HZ = (0.0, 1.6, 12.5, 52.0)  # LSM-42
CONTINUOUS = 0b110  # LSM-43
LATCHED = 0b011  # LSM-49
_TIMESTAMP = range(facts.TIMESTAMP0.address, facts.TIMESTAMP3.address + 1)
FIFO_OUT = range(facts.FIFO_DATA_OUT_TAG.address, facts.FIFO_DATA_OUT_Z_H.address + 1)

_DATA = range(facts.OUT_TEMP_L.address, facts.OUTZ_H_A.address + 1)


@dataclass
class _Half:
    """One half: the field of its rate, the first register of its triad, and the flag of a new sample."""

    rate: Field
    first: Register
    ready: Field
    grid: SampleGrid


class Lsm6dsoChip(SixAxis):
    """The registers and the queue of 512 words."""

    _temperature_due_ns: int
    _slot_ns: int
    _slots: int

    table: ClassVar[ModuleType] = facts
    who_am_i: ClassVar[Register | None] = facts.WHO_AM_I
    reset_bit: ClassVar[Field] = facts.SW_RESET
    reset_ns: ClassVar[int] = RESET_NS

    def power_on(self, at_ns: int) -> None:
        """Switch both halves off and set every register to its reset value (LSM-10)."""
        super().power_on(at_ns)
        self._halves = {
            ACCELEROMETER: _Half(facts.ACCEL_RATE, facts.OUTX_L_A, facts.ACCEL_READY, SampleGrid()),
            GYROSCOPE: _Half(facts.GYRO_RATE, facts.OUTX_L_G, facts.GYRO_READY, SampleGrid()),
        }
        self._held: dict[int, int] = {}
        self._timestamp_from_ns = at_ns
        trim = max(-128, min(127, round((self._oscillator - 1) / FREQ_FINE_STEP)))
        self.page[facts.INTERNAL_FREQ_FINE.address] = (facts.INTERNAL_FREQ_FINE.reset + trim) & 0xFF
        self._clear_queue(at_ns)

    # Sampling -------------------------------------------------------------------------------------------------------

    def _sync(self, at_ns: int) -> None:
        """Store the samples up to `at_ns` in the queue, and the latest one of each half in the data registers."""
        if facts.FIFO_MODE.of(self.page[facts.FIFO_CTRL4.address]):
            for sampled_ns, name in self._due(at_ns):
                self._sample(sampled_ns)
                self._enqueue_timestamp(sampled_ns)
                self._enqueue_temperature(sampled_ns)
                first = self._halves[name].first.address
                self._enqueue(TAGS[name], bytes(self.page[first : first + 6]))
        self._sample(at_ns)

    def _due(self, at_ns: int) -> list[tuple[int, str]]:
        """Return the samples that must be stored in the queue now, in order of time; at most twice its capacity."""
        batched = self.page[facts.FIFO_CTRL3.address]
        due = []
        for name, field in ((GYROSCOPE, facts.GYRO_BATCH_RATE), (ACCELEROMETER, facts.ACCEL_BATCH_RATE)):
            grid = self._halves[name].grid
            latest = grid.latest(at_ns)
            if field.of(batched):
                numbers = range(max(grid.index + 1, latest - 2 * FIFO_WORDS), latest + 1)
                due += [(grid.time_ns(number), name) for number in numbers]
        return sorted(due, key=lambda sample: sample[0])

    def _timestamp(self, at_ns: int) -> int:
        """Return the ticks of the die's oscillator since the count was switched on or last reset (LSM-46)."""
        return int((at_ns - self._timestamp_from_ns) * self._oscillator / TIMESTAMP_NS) & 0xFFFFFFFF

    def _enqueue_timestamp(self, at_ns: int) -> None:
        """Append a time stamp before the samples of every instant, every eighth or every 32nd (LSM-48, DEC-74)."""
        interval = SLOTS_PER_TIMESTAMP[facts.TIMESTAMP_BATCH.of(self.page[facts.FIFO_CTRL4.address])]
        if not interval or not facts.TIMESTAMP_ON.of(self.page[facts.CTRL10_C.address]) or at_ns == self._slot_ns:
            return
        if self._slots % interval == 0:
            self._enqueue(TIMESTAMP_TAG, self._timestamp(at_ns).to_bytes(4, "little") + bytes(2))
        self._slot_ns, self._slots = at_ns, self._slots + 1

    def _enqueue_temperature(self, at_ns: int) -> None:
        rate_hz = TEMPERATURE_RATES_HZ[facts.TEMPERATURE_BATCH_RATE.of(self.page[facts.FIFO_CTRL4.address])]
        if rate_hz and at_ns >= self._temperature_due_ns:
            self._temperature_due_ns = at_ns + self.own_period_ns(1e9 / rate_hz)
            self._enqueue(TEMPERATURE_TAG, bytes(self.page[_DATA.start : _DATA.start + 2]) + bytes(4))

    def _enqueue(self, tag: int, data: bytes) -> None:
        """Append a word to the queue; the oldest is lost if it is full (LSM-43)."""
        if len(self._words) >= FIFO_WORDS:
            self._has_overrun = self._lost_latched = True
            if facts.FIFO_MODE.of(self.page[facts.FIFO_CTRL4.address]) != CONTINUOUS:
                return
            self._words.popleft()
        odd = (tag << 3).bit_count() & 1
        self._words.append(bytes([tag << 3 | odd]) + data)

    def _clear_queue(self, at_ns: int) -> None:
        self._words: deque[bytes] = deque()
        self._word = bytes(len(FIFO_OUT))
        self._has_overrun = self._lost_latched = False
        self._temperature_due_ns = at_ns
        self._slot_ns, self._slots = -1, 0

    def _status(self) -> int:
        """Return the second byte of the queue's status (overrun, full, level above 255), and clear the latched overrun
        (LSM-44).
        """
        level = len(self._words)
        latched, self._lost_latched = self._lost_latched, False
        full = facts.FIFO_FULL.mask if level >= FIFO_WORDS else 0
        overrun_bit = facts.FIFO_OVERRUN.mask if self._has_overrun else 0
        return overrun_bit | full | (facts.FIFO_OVERRUN_LATCHED.mask if latched else 0) | level >> 8

    def _word_byte(self, address: int) -> int:
        """Return a byte of the word that left the queue when its tag was read (LSM-45)."""
        if address == FIFO_OUT.start:
            self._word = self._words.popleft() if self._words else bytes(len(FIFO_OUT))
            self._has_overrun = False
        return self._word[address - FIFO_OUT.start]

    def _sample(self, at_ns: int) -> None:
        for name, half in self._halves.items():
            sampled_ns = half.grid.take(at_ns)
            if sampled_ns is None:
                continue
            self._convert(name, half, sampled_ns)
            self._put(facts.OUT_TEMP_L.address, [clipped(round((self.degc(sampled_ns) - 25.0) * 256.0))])  # LSM-32
            self.page[facts.STATUS_REG.address] |= half.ready.mask | facts.TEMPERATURE_READY.mask

    def _put(self, address: int, codes: list[int]) -> None:
        data = b"".join(code.to_bytes(2, "little", signed=True) for code in codes)
        self.page[address : address + len(data)] = data

    def _convert(self, name: str, half: _Half, at_ns: int) -> None:
        """Write one sample of one half into the data registers, plus or minus the change by the self-test (LSM-20)."""
        rate_hz, page = 1e9 / half.grid.period_ns, self.page
        test = page[facts.CTRL5_C.address]
        if name == ACCELEROMETER:
            control = page[facts.CTRL1_XL.address]
            full_scale, step = RANGES_G[facts.ACCEL_RANGE.of(control)]
            filtered = facts.ACCEL_LPF2_ON.of(control)
            share = ACCEL_FILTER_SHARES[facts.ACCEL_FILTER.of(page[facts.CTRL8_XL.address])] if filtered else 2
            sample = self.sample(ACCELEROMETER, at_ns, full_scale, rate_hz / share)
            push = {0b01: PUSH_G, 0b10: -PUSH_G}.get(facts.ACCEL_SELF_TEST.of(test), 0.0)
        else:
            control = page[facts.CTRL2_G.address]
            full_scale, step = RANGES_DPS.get(facts.GYRO_RANGE.of(control), RANGES_DPS[0])
            bandwidth_hz = min(GYRO_BANDWIDTHS_HZ.items(), key=lambda known: abs(known[0] - rate_hz))[1]
            sample = self.sample(GYROSCOPE, at_ns, full_scale, bandwidth_hz)
            push = {0b01: PUSH_DPS, 0b11: -PUSH_DPS}.get(facts.GYRO_SELF_TEST.of(test), 0.0)
        codes = self._codes(sample, push, step)
        self._put(half.first.address, self._mark_codes(codes, half, at_ns) if name == GYROSCOPE else codes)

    def _mark_codes(self, codes: list[int], half: _Half, at_ns: int) -> list[int]:
        """Return the gyroscope's codes; the lowest bit of the selected axes marks the first sample after a pulse
        (LSM-49). A pulse is high; if the active level is low, the input is always active (DEC-75).
        """
        control = self.page[facts.CTRL9_XL.address]
        if facts.EDGE_MODE.of(self.page[facts.CTRL6_C.address]) != LATCHED or facts.MARK_ACCEL.of(control):
            return codes
        mark = int(self.is_marked(half.grid, at_ns) or not facts.PULSE_ACTIVE_HIGH.of(control))
        axes = (facts.MARK_X, facts.MARK_Y, facts.MARK_Z)
        return [code & ~1 | mark if axis.of(control) else code for code, axis in zip(codes, axes, strict=True)]

    def _codes(self, sample: Triple, push: float, step: float) -> list[int]:
        return [clipped(round((value + push) * 1000.0 / step)) for value in sample]

    # Reading and writing ----------------------------------------------------------------------------------------------

    def load(self, address: int, at_ns: int) -> int:
        """Return a byte with its value at the instant at which it is fetched; with BDU the two bytes of a number belong
        to one sample (LSM-13).
        """
        self.end_reset(at_ns)
        self._sync(at_ns)
        if self.page[facts.FUNC_CFG_ACCESS.address] and address != facts.FUNC_CFG_ACCESS.address:
            return 0  # pages of the embedded functions: DEC-71
        if address == facts.FIFO_STATUS1.address:
            return len(self._words) & 0xFF
        if address == facts.FIFO_STATUS2.address:
            return self._status()
        if address in FIFO_OUT:
            return self._word_byte(address)
        if address in _TIMESTAMP and facts.TIMESTAMP_ON.of(self.page[facts.CTRL10_C.address]):
            return self._timestamp(at_ns) >> 8 * (address - _TIMESTAMP.start) & 0xFF
        if address not in _DATA:
            return self.page[address]
        if address & 1:
            self._clear_flag(address)
            return self._held.pop(address, self.page[address])
        if facts.BLOCK_UPDATE.of(self.page[facts.CTRL3_C.address]):
            self._held[address + 1] = self.page[address + 1]
        return self.page[address]

    def _clear_flag(self, address: int) -> None:
        """Clear the flag of a sensor when the high byte of any of its numbers is read (LSM-11)."""
        if address == facts.OUT_TEMP_H.address:
            mask = facts.TEMPERATURE_READY.mask
        else:
            mask = facts.GYRO_READY.mask if address < facts.OUTX_L_A.address else facts.ACCEL_READY.mask
        self.page[facts.STATUS_REG.address] &= ~mask & 0xFF

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next register with IF_INC, otherwise the same (LSM-12). The end of a word leads back to its tag
        (LSM-45).
        """
        if pointer == FIFO_OUT[-1] and facts.AUTO_INCREMENT.of(self.page[facts.CTRL3_C.address]):
            return FIFO_OUT.start
        return (
            super().advance(pointer, reading) if facts.AUTO_INCREMENT.of(self.page[facts.CTRL3_C.address]) else pointer
        )

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Write a byte to a register; samples before it are unchanged."""
        self.end_reset(at_ns)
        self._sync(at_ns)
        if self.page[facts.FUNC_CFG_ACCESS.address] and address != facts.FUNC_CFG_ACCESS.address:
            return
        if self.begin_reset(address, value, at_ns):
            return
        if address == facts.TIMESTAMP2.address:
            if value == TIMESTAMP_RESET:
                self._timestamp_from_ns = at_ns
            return
        super().store(address, value, at_ns)
        if address == facts.CTRL10_C.address and not facts.TIMESTAMP_ON.of(self.page[address]):
            self._timestamp_from_ns = at_ns
        if address == facts.FIFO_CTRL4.address and not facts.FIFO_MODE.of(self.page[address]):
            self._clear_queue(at_ns)
        if address == facts.CTRL3_C.address:
            self.page[address] &= ~facts.BOOT.mask & 0xFF  # DEC-73
        for half in self._halves.values():
            if address in (half.rate.register.address, facts.CTRL4_C.address):
                self._restart(half, at_ns)

    def _restart(self, half: _Half, at_ns: int) -> None:
        """Restart the grid if the rate changed or the half was switched on (DEC-70)."""
        code = half.rate.of(self.page[half.rate.register.address])
        asleep = half.rate == facts.GYRO_RATE and facts.GYRO_SLEEP.of(self.page[facts.CTRL4_C.address])
        is_on = 1 <= code <= len(RATES_HZ) and not asleep
        running = [other.grid for other in self._halves.values() if other is not half]
        shared = [grid.time_ns(grid.latest(at_ns)) for grid in running if grid.start_ns <= at_ns]
        half.grid.set(max(shared, default=at_ns), self.own_period_ns(1e9 / RATES_HZ[code - 1]) if is_on else 0)


def accelerometer_tolerances(range_g: float) -> Tolerances:
    """Return the tolerances LSM-50 ... LSM-52; alignment, cross-axis sensitivity and linearity are not specified."""
    density = {2.0: 70e-6, 4.0: 75e-6, 8.0: 80e-6, 16.0: 110e-6}.get(range_g, 70e-6)
    return Tolerances(
        bias=(typical(0.020),) * 3,
        slope_per_degc=(typical(0.1e-3),) * 3,
        scale=typical(0.01),
        noise=(density * math.sqrt(104.0),) * 3,
        noise_full_scale=range_g or 2.0,
        noise_bandwidth_hz=104.0,
        scale_slope_per_degc=typical(1e-4),
        thermometer_degc=typical(15.0),
    )


GYROSCOPE_TOLERANCES = Tolerances(
    bias=(typical(1.0),) * 3,
    slope_per_degc=(typical(0.01),) * 3,
    scale=typical(0.01),
    noise=(3.8e-3 * math.sqrt(66.8),) * 3,
    noise_full_scale=250.0,
    noise_bandwidth_hz=66.8,
    scale_slope_per_degc=typical(7e-5),
    thermometer_degc=typical(15.0),
)
"""The tolerances LSM-60 ... LSM-62; alignment, linearity and a sensitivity to force are not specified."""


DIE = Die(Lsm6dsoChip, (facts.OUTX_L_A, facts.OUTX_L_G), (accelerometer_tolerances, GYROSCOPE_TOLERANCES))
