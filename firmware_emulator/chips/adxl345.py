"""ADXL345 accelerometer: Analog Devices data sheet Rev. E (2015); ADX-01 ... ADX-69, DEC-24, DEC-25.

Conversions fall on the chip's own grid: the first 1/ODR + 1.1 ms after measurement is switched on, then one every
1/ODR. They are computed when the chip is read; a value that is read twice within a period is the same. Not modelled:
tap, activity, inactivity and free-fall (their bits read 0) and the wake-up rates of sleep.
"""

from __future__ import annotations

from collections import deque
from struct import Struct
from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chip import NEVER_NS, Chip, Element, Triple
from imuarray.facts import adxl345 as facts

FASTEST_PERIOD_NS = 312_500  # rate code 15 is 3200 Hz, every code below it half the rate of the next (ADX-36)
TURN_ON_NS = 1_100_000  # ADX-38
BYPASS, FIFO, STREAM, TRIGGER = range(4)
SLOTS = 32
MOST_SETS = SLOTS + 1  # one more set is held in the data registers (ADX-51, DEC-24)
OFFSET_STEP_G = 1 / 64  # 15.6 mg (ADX-12)
SELF_TEST_G: Triple = (1.15, -1.15, 1.85)
"""Change of the output by the self-test in g: the middle of the limits at 2.5 V, which is also within those at 3.3 V
(ADX-58).
"""
QUIET_BANDWIDTH_HZ = 50.0  # noise does not fall below that of 100 Hz ODR (ADX-68)
LOW_POWER_BANDWIDTH_HZ = 288.0  # (1.8 / 0.75)**2 times 50 Hz: the noise of low-power mode (ADX-67, ADX-69)
EVEN_ONLY_RATES = (0xE, 0xF)  # ADX-47

DATA = range(facts.DATAX0.address, facts.DATAZ1.address + 1)
_DATA_START, _DATA_END = DATA.start, DATA.stop
OFFSETS = slice(facts.OFSX.address, facts.OFSZ.address + 1)
WORDS = Struct("<3h")
SIGNED_BYTES = Struct("3b")


class Format(NamedTuple):
    """The format of a word: codes per g, step between codes that occur, extreme codes, left shift."""

    codes_per_g: int
    step: int
    lowest: int
    highest: int
    shift: int

    def words(self, force_g: Triple) -> bytes:
        """Return the six data bytes for a force in g: low byte first, clipped, never rolling over (ADX-27, ADX-46)."""
        scale, step, lowest, highest, shift = self
        x, y, z = force_g
        if step == 1:
            x, y, z = round(x * scale), round(y * scale), round(z * scale)
        else:
            x, y, z = round(x * scale / step) * step, round(y * scale / step) * step, round(z * scale / step) * step
        if not (lowest <= x <= highest and lowest <= y <= highest and lowest <= z <= highest):
            x, y, z = [max(lowest, min(highest, code)) for code in (x, y, z)]
        return WORDS.pack(x << shift, y << shift, z << shift)


def format_of(data_format: int, rate_code: int) -> Format:
    """Return the format that register DATA_FORMAT and the rate code select (ADX-40 ... ADX-47).

    With FULL_RES a code is always 1/256 g and the word grows with the range; without FULL_RES, ten bits span every
    range.
    """
    octave, full_resolution = facts.RANGE.of(data_format), bool(facts.FULL_RES.of(data_format))
    half_span = 512 << octave if full_resolution else 512
    codes_per_g = 256 if full_resolution else 256 >> octave
    step = 2 if rate_code in EVEN_ONLY_RATES and (full_resolution or octave == 0) else 1
    left_shift = 6 - (octave if full_resolution else 0)
    return Format(codes_per_g, step, -half_span, half_span - step, left_shift if facts.JUSTIFY.of(data_format) else 0)


class Adxl345Chip(Chip):
    """The registers and the 32 + 1 sets of its FIFO."""

    table: ClassVar[ModuleType] = facts

    def __init__(self, address: int, element: Element, powered_on_ns: int = 0) -> None:
        self._sets: deque[bytes] = deque(maxlen=MOST_SETS)
        super().__init__(address, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Set standby without data and every register to its reset value; there is no other reset (ADX-31, ADX-38)."""
        super().power_on(at_ns)
        self._sets.clear()
        self._overrun = self._reading = self._triggered = self._measuring = False
        self._due_ns = NEVER_NS
        self._period_ns = 0
        self._configure(at_ns)

    def event(self, pin: int, at_ns: int) -> None:
        """Note an edge on INT1 (`pin` 0) or INT2 (1): in trigger mode, an edge on the selected pin freezes the history
        (ADX-53).
        """
        self._convert(at_ns)
        control = self.page[facts.FIFO_CTL.address]
        if self._mode == TRIGGER and pin == facts.TRIGGER.of(control) and not self._triggered:
            self._triggered = True
            while len(self._sets) > facts.SAMPLES.of(control):
                self._sets.popleft()

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next register; the read of a set ends after the last data byte (ADX-55)."""
        if reading and pointer == DATA[-1]:
            self._reading = False
        return pointer + 1 & 0xFF

    def stop(self, at_ns: int) -> None:
        """End the read of a set with the transaction (ADX-55)."""
        self._reading = False

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read byte by byte, except for a whole set, alone or after INT_SOURCE and DATA_FORMAT, which is read in one
        step because its bytes do not change while they are read (ADX-49).
        """
        head_bytes = _DATA_START - self.pointer
        if count != head_bytes + 6 or head_bytes not in (0, 2) or self._reading:
            return super().read(count, at_ns, byte_ns)
        head = bytes((self._int_source(at_ns), self.page[facts.DATA_FORMAT.address])) if head_bytes else b""
        self._take(at_ns + head_bytes * byte_ns)
        self._reading = False
        self.pointer = _DATA_END
        return head + self.page[_DATA_START:_DATA_END]

    def load(self, address: int, at_ns: int) -> int:
        """Return the data of one set for a whole transaction (ADX-49), with the present INT_SOURCE and FIFO_STATUS."""
        if address in DATA:
            if not self._reading:
                self._take(at_ns)
        elif address == facts.INT_SOURCE.address:
            return self._int_source(at_ns)
        elif address == facts.FIFO_STATUS.address:
            self._convert(at_ns)
            return self._triggered << 7 | self._entries()
        return self.page[address]

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Store a byte; conversions up to now still use the old setting, and bypass empties the FIFO (ADX-57)."""
        self._convert(at_ns)
        mode = self._mode
        super().store(address, value, at_ns)
        self._configure(at_ns)
        if self._mode == BYPASS != mode:
            self._sets.clear()
            self._triggered = self._overrun = False

    def _configure(self, at_ns: int) -> None:
        page = self.page
        control = page[facts.FIFO_CTL.address]
        self._mode, self._watermark = facts.FIFO_MODE.of(control), facts.SAMPLES.of(control)
        rate, data_format = page[facts.BW_RATE.address], page[facts.DATA_FORMAT.address]
        code = facts.RATE.of(rate)
        self._format = format_of(data_format, code)
        self._full_scale_g = float(2 << facts.RANGE.of(data_format))
        tested = facts.SELF_TEST.of(data_format)
        offsets = zip(SIGNED_BYTES.unpack(page[OFFSETS]), SELF_TEST_G, strict=True)
        x, y, z = (offset * OFFSET_STEP_G + tested * force for offset, force in offsets)
        self._added_g = x, y, z
        period_ns = FASTEST_PERIOD_NS << 15 - code
        rate_bandwidth_hz = max(QUIET_BANDWIDTH_HZ, 0.5e9 / period_ns)
        self._bandwidth_hz = LOW_POWER_BANDWIDTH_HZ if facts.LOW_POWER.of(rate) else rate_bandwidth_hz
        self._schedule(period_ns, at_ns)

    def _schedule(self, period_ns: int, at_ns: int) -> None:
        measuring = bool(facts.MEASURE.of(self.page[facts.POWER_CTL.address]))
        if not measuring:
            self._due_ns = NEVER_NS
        elif not self._measuring:
            self._due_ns = at_ns + period_ns + TURN_ON_NS
        elif period_ns != self._period_ns:
            self._due_ns = at_ns + period_ns
        self._measuring, self._period_ns = measuring, period_ns

    def _convert(self, at_ns: int) -> None:
        due_ns = self._due_ns
        if at_ns < due_ns:
            return
        finished = (at_ns - due_ns) // self._period_ns + 1
        self._due_ns = due_ns + finished * self._period_ns
        if self._mode == BYPASS:
            self._overrun |= finished > 1 or bool(self._sets)
            self._sets.clear()
            self._sets.append(self._set(self._due_ns - self._period_ns))
        else:
            self._collect(due_ns, finished)

    def _collect(self, due_ns: int, finished: int) -> None:
        # Stream mode keeps the newest sets (the deque drops the oldest), FIFO mode the first ones that fit.
        filling = self._mode == FIFO or self._triggered
        stored = min(finished, MOST_SETS - len(self._sets) if filling else MOST_SETS)
        first_ns = due_ns if filling else self._due_ns - stored * self._period_ns
        for index in range(stored):
            self._sets.append(self._set(first_ns + index * self._period_ns))
        if len(self._sets) >= SLOTS:
            self._overrun = True

    def _set(self, at_ns: int) -> bytes:
        x, y, z = self.element.sample(at_ns, self._full_scale_g, self._bandwidth_hz)
        more_x, more_y, more_z = self._added_g
        return self._format.words((x + more_x, y + more_y, z + more_z))

    def _take(self, at_ns: int) -> None:
        self._convert(at_ns)
        self._reading = True
        self._overrun = False
        if self._sets:
            self.page[_DATA_START:_DATA_END] = self._sets.popleft()

    def _entries(self) -> int:
        return 0 if self._mode == BYPASS else min(len(self._sets), SLOTS)

    def _int_source(self, at_ns: int) -> int:
        self._convert(at_ns)
        return bool(self._sets) << 7 | (self._entries() >= self._watermark) << 1 | self._overrun
