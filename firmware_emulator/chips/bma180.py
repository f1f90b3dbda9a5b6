"""BMA180 accelerometer behind its registers, after the Bosch data sheet v2.5 (facts BMA-01 ... BMA-107).

Three regions: operational registers, the image 0x20 ... 0x3B that acts on the chip, and the EEPROM from which the image
is loaded. It wakes up measuring at +/-2 g, 150 Hz. It models the known pitfalls: image writes that are acknowledged and
dropped while ee_w is 0, the 10 ms download that undoes early writes, trims beside settings, writes in (register, value)
pairs.

Not modelled: the interrupt logic and the offset regulation, so their status bits read 0; wake-up mode; the
thermometer's gain trim.
"""

from __future__ import annotations

from collections.abc import Mapping

from firmware_emulator.chip import Chip, Element, registers_of
from firmware_emulator.chips.bma180_converter import FAR_NS, SELF_TEST_NS, Converter, Settings, Trims
from imuarray.facts import bma180 as facts

IMAGE = range(0x20, 0x3C)  # writable while ee_w = 1 (BMA-51); BMA-48: 0x3C ... 0x3F stay locked
WINDOW = range(0x40, 0x5C)  # the same registers in EEPROM, BMA-49
RESERVED_WINDOW_END = 0x60
DOWNLOAD_NS = 10_000_000  # BMA-53
BURN_NS = 10_000_000  # BMA-55
START_UP_NS = 2_500_000  # BMA-106
WAKE_NS = 2_000_000  # from sleep, BMA-106
VERSION = 0x14  # placeholder, DEC-12
SOFT_RESET = 0xB6  # BMA-24
NO_ADDRESS = -1

_CONTROL = facts.CTRL_REG0.address
_STATUS = facts.STATUS_REG1.address
_RESET = facts.RESET.address
_X_LOW = facts.ACC_X_LSB.address
_Z_HIGH = facts.ACC_Z_MSB.address
_TEMP = facts.TEMP.address
_UNSHADOWED = facts.GAIN_Y.address


def trims_of(page: bytes | bytearray) -> Trims:
    """Return the trim fields in a register page."""
    low1, low2 = page[0x35], page[0x36]  # BMA-43, BMA-44
    return Trims(
        offset=(page[0x38] << 4 | low1 >> 4, page[0x39] << 4 | low2 & 15, page[0x3A] << 4 | low2 >> 4),
        gain=(page[0x32] >> 1, page[0x33] >> 1, page[0x34] >> 1),
        tco=(page[0x2E] >> 2, page[0x2F] >> 2, page[0x30] >> 2),
        tcs=facts.TCS.of(page[0x20]),
        offset_t=page[0x37] >> 1,
    )


def settings_of(page: bytes | bytearray) -> Settings:
    """Return the settings of a conversion that the register page holds."""
    testing = bool(facts.SELF_TEST_0.of(page[_CONTROL]))
    return Settings(
        range_code=facts.RANGE.of(page[0x35]),
        bandwidth_code=0b0111 if testing else facts.BANDWIDTH.of(page[0x20]),  # BMA-104
        mode_code=facts.MODE_CONFIG.of(page[0x30]),
        asleep=bool(facts.SLEEP.of(page[_CONTROL])),
        self_test=testing,
        twelve_bits=bool(facts.READOUT_12BIT.of(page[0x37])),
        trims=trims_of(page),
    )


class Bma180Chip(Chip):
    """The chip. `eeprom_writes` counts writes to 0x40 and above, which a driver must never do (BMA-55, DEC-13).

    eeprom: bytes by register address that differ from BMA-58: a part's own trims, a previous owner's settings (BMA-59).
    left_over: registers as an earlier program left them; the part then neither boots nor warms up.
    download_ns: how long the EEPROM takes to be read, 0 for an instantaneous download (DEC-10).
    early_writes_vanish: image writes during the download are dropped at once, not undone at its end (DEC-10).
    rate_error: relative error of the oscillator, within +/-0.1 (BMA-107).
    """

    # The switches are properties that data sheets do not specify, or settings of an earlier program.
    def __init__(  # noqa: PLR0913
        self,
        address: int,
        element: Element,
        powered_on_ns: int = 0,
        *,
        eeprom: Mapping[int, int] | None = None,
        left_over: Mapping[int, int] | None = None,
        download_ns: int = DOWNLOAD_NS,
        early_writes_vanish: bool = False,
        rate_error: float = 0.0,
    ) -> None:
        self.eeprom_writes = 0
        self._strapped = address
        self._download_ns, self._early_writes_vanish = download_ns, early_writes_vanish
        delivered = bytearray(256)
        for register, fact in registers_of(facts).items():
            delivered[register] = fact.reset
        for register, value in (eeprom or {}).items():
            delivered[register] = value
        self.eeprom = delivered[IMAGE.start : IMAGE.stop]
        self._converter = Converter(element, trims_of(delivered), rate_error)
        super().__init__(address, facts, element, powered_on_ns)
        if left_over is not None:
            self._leave(left_over, powered_on_ns)

    def power_on(self, at_ns: int) -> None:
        """Set the registers to their reset values and the image to the EEPROM; the download begins (BMA-52, BMA-57)."""
        super().power_on(at_ns)
        self.address = self._strapped
        self.page[facts.VERSION.address] = VERSION
        self.page[IMAGE.start : IMAGE.stop] = self.eeprom
        self._pending: int | None = None
        self._begin(at_ns)

    def _begin(self, at_ns: int) -> None:
        self._self_test_end_ns = self._burn_end_ns = FAR_NS
        self._ready_ns = at_ns + START_UP_NS
        self._converter.power_on(at_ns, settings_of(self.page), self._ready_ns)
        self._download_end_ns = at_ns + self._download_ns
        self._act(at_ns)
        self._catch_up(at_ns)

    def _leave(self, left_over: Mapping[int, int], at_ns: int) -> None:
        self._download_end_ns, self._ready_ns = FAR_NS, at_ns
        for register, value in left_over.items():
            self.page[register] = value
        self.page[_CONTROL] &= ~(facts.UPDATE_IMAGE.mask | facts.SELF_TEST_0.mask)
        self._act(at_ns)

    # What happens by itself -----------------------------------------------------------------------------------------

    def _catch_up(self, at_ns: int) -> None:
        """Carry out everything that was due by `at_ns`, in order of time."""
        while self._next_ns <= at_ns:
            due = self._next_ns
            if due == self._download_end_ns:
                self.page[IMAGE.start : IMAGE.stop] = self.eeprom
                self.page[_CONTROL] &= ~facts.UPDATE_IMAGE.mask
                self._download_end_ns = FAR_NS
            if due == self._self_test_end_ns:
                self.page[_CONTROL] &= ~facts.SELF_TEST_0.mask
                self._self_test_end_ns = FAR_NS
            if due == self._burn_end_ns:
                self.page[_STATUS] &= ~facts.EE_WRITE.mask
                self._burn_end_ns = FAR_NS
            self._act(due)

    def _act(self, at_ns: int) -> None:
        """Apply changed registers."""
        self._next_ns = min(self._download_end_ns, self._self_test_end_ns, self._burn_end_ns)
        self._converter.apply(at_ns, settings_of(self.page), self._ready_ns)
        if facts.DIS_I2C.of(self.page[facts.HIGH_DUR.address]):
            self.address = NO_ADDRESS  # BMA-33: silent until the supply is switched off and on

    # Reading --------------------------------------------------------------------------------------------------------

    def read(self, count: int, at_ns: int, byte_ns: int) -> bytes:
        """Return `count` bytes from the pointer on; a faster path returns the same bytes for a shadowed burst from
        acc_x_lsb.
        """
        self._pending = None
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if self.address == NO_ADDRESS:
            return b"\xff" * count
        end_ns = at_ns + count * byte_ns
        if self.pointer != _X_LOW or not 6 <= count <= 7 or end_ns >= self._next_ns or self.page[_UNSHADOWED] & 1:
            return super().read(count, at_ns, byte_ns)
        self.pointer = _X_LOW + count
        answer = self._converter.burst(at_ns, byte_ns)
        return answer if count == 6 else answer + bytes((self._converter.temperature(end_ns - byte_ns),))

    def load(self, address: int, at_ns: int) -> int:
        """Return a register's byte; the EEPROM's window shows the image (BMA-54)."""
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if _X_LOW <= address <= _Z_HIGH:
            axis, high = divmod(address - _X_LOW, 2)
            if high:
                return self._converter.high_byte(axis, at_ns, shadowed=not self.page[_UNSHADOWED] & 1)
            return self._converter.low_byte(axis, at_ns)
        if address == _TEMP:
            return self._converter.temperature(at_ns)
        if WINDOW.start <= address < RESERVED_WINDOW_END:
            return self.page[address - 0x20]
        return self.page[address]

    def advance(self, pointer: int, reading: bool) -> int:
        """The pointer has seven bits (BMA-03, BMA-04)."""
        return pointer + 1 & 0x7F

    # Writing --------------------------------------------------------------------------------------------------------

    def write(self, data: bytes, at_ns: int, byte_ns: int) -> int:
        """Write registers and values in turn (BMA-05). Every byte is acknowledged, also where nothing is stored
        (BMA-07).
        """
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if len(data) == 1 and self.address != NO_ADDRESS:  # the usual case
            self.pointer = self._pending = data[0] & 0x7F
            return 1
        for index, byte in enumerate(data):
            if self.address == NO_ADDRESS:
                return index
            if index % 2 == 0:
                self.pointer = self._pending = byte & 0x7F
            else:
                self._pending = None
                self.store(self.pointer, byte, at_ns + index * byte_ns)
        return len(data)

    def stop(self, at_ns: int) -> None:
        """End the transaction: a write to the EEPROM's window needs no data byte (BMA-55), unless a read follows."""
        if self._pending is not None and self._pending in WINDOW and self._pending % 2 == 0:
            self._burn(self._pending, at_ns)
        self._pending = None

    def store(self, address: int, value: int, at_ns: int) -> None:
        """Store a byte in a register, if the register accepts it."""
        if at_ns >= self._next_ns:
            self._catch_up(at_ns)
        if address >= WINDOW.start:
            self._burn(address, at_ns)
        elif address == _RESET:
            self._soft_reset(value, at_ns)
        elif self._burn_end_ns != FAR_NS:
            return  # BMA-17
        elif address == _CONTROL:
            self._control(value, at_ns)
        elif not self.page[_CONTROL] & facts.SLEEP.mask:  # DEC-11
            self._keep(address, value, at_ns)

    def _keep(self, address: int, value: int, at_ns: int) -> None:
        if address in IMAGE:
            locked = not self.page[_CONTROL] & facts.EE_W.mask  # BMA-51
            if locked or (self._early_writes_vanish and self._download_end_ns != FAR_NS):
                return
            self.page[address] = value
            self._act(at_ns)
        elif address == facts.CTRL_REG2.address:
            super().store(address, value, at_ns)  # ctrl_reg1 is one-shot (BMA-22) and reads 0

    def _control(self, value: int, at_ns: int) -> None:
        """Carry out ctrl_reg0 (BMA-21): update_image and st0 last until they clear themselves, reset_int is over at
        once.
        """
        previous = self.page[_CONTROL]
        self.page[_CONTROL] = value & ~(facts.CTRL_REG0.reserved | facts.RESET_INT.mask) & 0xFF
        self.page[_CONTROL] |= previous & facts.UPDATE_IMAGE.mask
        if value & facts.UPDATE_IMAGE.mask and self._download_end_ns == FAR_NS:
            self._download_end_ns = at_ns + self._download_ns
        if previous & facts.SLEEP.mask and not value & facts.SLEEP.mask:
            self._ready_ns = at_ns + WAKE_NS
        if not value & facts.SELF_TEST_0.mask:
            self._self_test_end_ns = FAR_NS
        elif self._self_test_end_ns == FAR_NS:
            self._self_test_end_ns = at_ns + SELF_TEST_NS
        self._act(at_ns)
        self._catch_up(at_ns)

    def _soft_reset(self, value: int, at_ns: int) -> None:
        """Reset as after power-on, but keep the image's contents until the download ends (BMA-56, DEC-10)."""
        if value != SOFT_RESET:
            return
        self.page[_STATUS : _CONTROL + 3] = bytes(_CONTROL + 3 - _STATUS)
        self._begin(at_ns)

    def _burn(self, address: int, at_ns: int) -> None:
        """Copy two bytes of the image into the EEPROM, if the address is even and the EEPROM not busy; count the write
        in any case.
        """
        self.eeprom_writes += 1
        if address not in WINDOW or address % 2 or self._burn_end_ns != FAR_NS or self._download_end_ns != FAR_NS:
            return
        first = address - WINDOW.start
        self.eeprom[first : first + 2] = self.page[address - 0x20 : address - 0x1E]
        self.page[_STATUS] |= facts.EE_WRITE.mask
        self._burn_end_ns = at_ns + BURN_NS
        self._next_ns = min(self._next_ns, self._burn_end_ns)
