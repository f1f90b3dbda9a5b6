"""HMC5883 and HMC5883L magnetometers: Honeywell Form 900405 Rev A (2010), Rev E; HMC-01 ... HMC-53, DEC-30 ... DEC-32.

In continuous mode it measures on a grid that begins with the last write to a configuration register (HMC-37), in single
mode once. The delay of a measurement by bus traffic is not modelled (HMC-39). The pointer increments after bytes that
are read, not after those that are written (HMC-05).
"""

from __future__ import annotations

from functools import partial
from struct import Struct
from types import ModuleType
from typing import ClassVar, NamedTuple

from firmware_emulator.chip import NEVER_NS, Chip, Element, Triple
from imuarray.facts import hmc5883 as facts

CONTINUOUS, SINGLE, IDLE, IDLE_TOO = range(4)
PERIODS_NS = tuple(round(1e9 / rate_hz) for rate_hz in (0.75, 1.5, 3.0, 7.5, 15.0, 30.0, 75.0, 75.0))
"""Periods by rate code (HMC-28); the reserved code 111 is treated as 75 Hz."""
BANDWIDTH_HZ = 80.0
"""Bandwidth of one measurement: half the fastest rate, 160 Hz (HMC-29)."""
INVALID = -4096
"""Code for values outside the span of the 12-bit converter (HMC-32)."""
DATA = range(facts.DATA_X_MSB.address, facts.DATA_Y_LSB.address + 1)
ALL_SIX = 0b111111
WORDS = Struct(">3h")


class Variant(NamedTuple):
    """The differences between the two parts; `gains` in codes per gauss and `fields` in gauss are by gain code."""

    gains: tuple[int, ...]
    fields: tuple[float, ...]
    ready_ns: int
    conversion_ns: int
    writing_ns: int
    self_test_gauss: Triple
    averages: bool
    mode_read_locks: bool
    regulator: int


VARIANTS = {
    "hmc5883l": Variant(
        gains=(1370, 1090, 820, 660, 440, 390, 330, 230),  # HMC-20 ... HMC-27
        fields=(0.88, 1.3, 1.9, 2.5, 4.0, 4.7, 5.6, 8.1),
        ready_ns=50_000_000,  # HMC-51
        conversion_ns=6_000_000,  # HMC-29
        writing_ns=250_000,  # HMC-35
        self_test_gauss=(1.16, 1.16, 1.08),  # HMC-41
        averages=True,
        mode_read_locks=True,  # DEC-32
        regulator=0,
    ),
    "hmc5883": Variant(
        gains=(1280, 1024, 768, 614, 415, 361, 307, 219),
        fields=(0.9, 1.2, 1.9, 2.5, 4.0, 4.6, 5.5, 7.9),
        ready_ns=8_300_000,
        conversion_ns=8_300_000,
        writing_ns=5_000,
        self_test_gauss=(0.64, 0.64, -0.59),  # HMC-42
        averages=False,
        mode_read_locks=False,
        regulator=facts.REGULATOR.mask,
    ),
}


def word(code: int) -> int:
    """Return the output register's content for a converter code (HMC-31, HMC-32)."""
    return code if -2048 <= code <= 2047 else INVALID


class Hmc5883Chip(Chip):
    """An HMC5883 or HMC5883L, by `variant`; after a read of register `wrap` (8 or 9) the pointer is 3 (DEC-30)."""

    table: ClassVar[ModuleType] = facts

    def __init__(
        self, address: int, element: Element, powered_on_ns: int = 0, *, variant: str = "hmc5883", wrap: int = 8
    ) -> None:
        if variant not in VARIANTS or wrap not in (8, 9):
            raise ValueError(f"variant {variant!r}, wrap {wrap}: allowed are {', '.join(VARIANTS)} and 8, 9")
        self.variant = VARIANTS[variant]
        self.wrap = wrap
        super().__init__(address, element, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Start up: the reset value of the mode requests one measurement when the part is ready (HMC-12, HMC-51)."""
        super().power_on(at_ns)
        self._gain = self._gain_now()
        self._read = 0
        self._locked = self._ready = False
        self._begin(at_ns)

    def advance(self, pointer: int, reading: bool) -> int:
        """Return the next register. Writes do not move the pointer; reads increment it, and return it from register
        `wrap` to 3, and from the identity to 0 (HMC-05, DEC-30).
        """
        if not reading:
            return pointer
        if pointer >= facts.IDENTITY_C.address:
            return 0
        return DATA.start if pointer == self.wrap else pointer + 1

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Read byte by byte, except for all six data bytes, which are read in one step: the first locks the others
        (HMC-33).
        """
        if count != len(DATA) or self.pointer != DATA.start:
            return super().read(count, at_ns, byte_ns)
        self._convert(at_ns)
        self._all_read()
        self.pointer = self.advance(DATA[-1], reading=True)
        return bytes(self.page[DATA.start : DATA.stop])

    def load(self, address: int, at_ns: int) -> int:
        """Return a byte: data bytes lock the output until all six are read; on the HMC5883L, reading the mode also
        locks it (HMC-33, HMC-34).
        """
        self._convert(at_ns)
        if address in DATA:
            self._note_read(address)
        elif address == facts.STATUS.address:
            return self._status(at_ns)
        elif address == facts.MODE.address:
            self._locked |= self.variant.mode_read_locks
        return self.page[address]

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Write a register: the mode restarts the measurement, registers A and B do so in continuous operation;
        register A and the mode also unlock the output (HMC-34, HMC-37).
        """
        self._convert(at_ns)
        super().store(address, value, at_ns)
        if address in (facts.CONFIG_A.address, facts.MODE.address):
            self._read, self._locked = 0, False
        if address == facts.MODE.address or (address < facts.MODE.address and self._operation() == CONTINUOUS):
            self._begin(at_ns)

    def _operation(self) -> int:
        return facts.OPERATION.of(self.page[facts.MODE.address])

    def _gain_now(self) -> int:
        return facts.GAIN.of(self.page[facts.CONFIG_B.address])

    def _begin(self, at_ns: int) -> None:
        start_ns = max(at_ns, self.powered_on_ns + self.variant.ready_ns)
        self._period_ns = PERIODS_NS[facts.OUTPUT_RATE.of(self.page[facts.CONFIG_A.address])]
        self._due_ns = NEVER_NS
        operation = self._operation()
        if operation == CONTINUOUS:
            self._due_ns = start_ns + 2 * self._period_ns
        elif operation == SINGLE:
            self._due_ns = start_ns + self.variant.conversion_ns
        self._ready = self._ready and operation in (IDLE, IDLE_TOO)

    def _convert(self, at_ns: int) -> None:
        due_ns = self._due_ns
        if at_ns < due_ns:
            return
        if self._operation() == SINGLE:
            self.page[facts.MODE.address] = IDLE_TOO  # HMC-38, DEC-31
            self._due_ns = NEVER_NS
        else:
            finished = (at_ns - due_ns) // self._period_ns + 1
            self._due_ns = due_ns + finished * self._period_ns
            due_ns = self._due_ns - self._period_ns
            if finished > 1:
                self._gain = self._gain_now()
        if not (self._locked or self._read):
            self._put(self._field(due_ns))
        self._gain = self._gain_now()  # a new gain takes effect with the measurement after the next (HMC-36)

    def _put(self, field: Triple) -> None:
        gain = self.variant.gains[self._gain]
        x, y, z = [word(round(component * gain)) for component in field]
        self.page[DATA.start : DATA.stop] = WORDS.pack(x, z, y)  # this order (HMC-31)
        self._ready = True

    def _field(self, at_ns: int) -> Triple:
        # Averaging 8 halves the noise of HMC-53's graph, hence the exponent 1/3 (of the bandwidth: 2/3).
        config = self.page[facts.CONFIG_A.address]
        averages = 1 << facts.AVERAGING.of(config) if self.variant.averages else 1
        setting = self.variant.fields[self._gain], BANDWIDTH_HZ / averages ** (2 / 3)
        x, y, z = self.element.sample(at_ns, *setting)
        sign = (0, 1, -1, 0)[facts.MEASUREMENT_BIAS.of(config)]
        if sign:  # the output is a biased measurement less an unbiased one (HMC-41)
            plain_x, plain_y, plain_z = self.element.sample(at_ns, *setting)
            bias_x, bias_y, bias_z = self.variant.self_test_gauss
            return sign * bias_x + x - plain_x, sign * bias_y + y - plain_y, sign * bias_z + z - plain_z
        return x, y, z

    def _note_read(self, address: int) -> None:
        self._read |= 1 << address - DATA.start
        if self._read == ALL_SIX:
            self._all_read()

    def _all_read(self) -> None:
        self._read, self._locked = 0, False
        if self._operation() != CONTINUOUS:
            self._ready = False  # HMC-35

    def _status(self, at_ns: int) -> int:
        locked = bool(self._locked or self._read)
        writing = not locked and self._operation() == CONTINUOUS and at_ns >= self._due_ns - self.variant.writing_ns
        return self.variant.regulator | locked << 1 | (self._ready and not writing)


Hmc5883lChip = partial(Hmc5883Chip, variant="hmc5883l")
