"""The master of the auxiliary bus of an MPU-6500 or MPU-9250 (INV-110 ... INV-116).

At each sample it reads and writes registers of the devices behind it, by four slots, and shows the bytes that it read
in EXT_SENS_DATA. Not modelled: the fifth slot, except for the delay that all others share; other masters; the time that
transfers take.
"""

from __future__ import annotations

from firmware_emulator.chip import Target
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
    """The master; `devices` are what is on its bus, `page` the registers of the die."""

    def __init__(self) -> None:
        self.devices: list[Target] = []

    def transfer(self, page: bytearray, index: int, at_ns: int) -> None:
        """Every transfer that belongs to sample number `index`, at `at_ns`."""
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
                begin = b"" if control & _NO_REGISTER else bytes([register])
                if is_reading:
                    data = _read(device, begin, count, at_ns)
                    if control & _SWAP:
                        data = swapped(data, (register + bool(control & _ODD_PAIRS)) & 1)
                    stop = min(place + count, EXTERNAL.stop)
                    page[place:stop] = data[: stop - place]
                else:
                    device.write(begin + page[_DATA_OUT + slot : _DATA_OUT + slot + 1], at_ns, BYTE_NS)
                device.stop(at_ns)
            place += count if is_reading else 0

    @staticmethod
    def recorded(page: bytearray, slots: int) -> bytes:
        """Return what the slots whose bits are set in `slots` have read, for the queue."""
        data, place = b"", EXTERNAL.start
        for slot in range(SLOTS):
            address, _, control = page[_FIRST + slot * _STEP : _FIRST + (slot + 1) * _STEP]
            if control & _ON and address & _READ:
                count = control & 0x0F
                data += bytes(page[place : place + count]) if slots >> slot & 1 else b""
                place += count
        return data


def delay_of(page: bytearray) -> int:
    """Samples between two transfers of a slot whose delay is on, less one (INV-115)."""
    return facts.MASTER_DELAY.of(page[_LAST])


def _read(device: Target, begin: bytes, count: int, at_ns: int) -> bytes:
    if begin:
        device.write(begin, at_ns, BYTE_NS)
    return device.read(count, at_ns, BYTE_NS)


def swapped(data: bytes, first_is_alone: int) -> bytes:
    """Bytes with each pair turned round; the first is alone if its pair began before it, so may be the last."""
    turned = bytearray(data)
    for at in range(first_is_alone, len(data) - 1, 2):
        turned[at], turned[at + 1] = turned[at + 1], turned[at]
    return bytes(turned)
