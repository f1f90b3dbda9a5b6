"""The FIFO of the emulated L3G4200D (facts L3G-53 ... L3G-58, choices DEC-20, DEC-21, DEC-23)."""

import pytest

from firmware_emulator.chips.l3g4200d import L3g4200dChip

MS = 1_000_000
BYTE_NS = 22_500
READY = 310 * MS  # of the first conversion; then one every 10 ms
FIFO, STREAM, STREAM_TO_FIFO, BYPASS_TO_STREAM = 0x20, 0x40, 0x60, 0x80


class Counter:
    """Rates that count the conversions: x is 1, 2, 3 ... codes, one more every 10 ms; y twice that; z minus x."""

    def __init__(self):
        self.asked = 0

    def sample(self, at_ns, full_scale, bandwidth_hz):
        self.asked += 1
        n = (at_ns - READY) // (10 * MS) + 1
        return n * 0.00875, 2 * n * 0.00875, -n * 0.00875

    def temperature(self, at_ns):
        return 25.0

    def pressure(self, at_ns):
        return 101325.0


def poke(chip, register, value, at):
    chip.write(bytes((register, value)), at - BYTE_NS, BYTE_NS)
    chip.stop(at)


def peek(chip, register, count=1, at=READY):
    chip.write(bytes((register | 0x80,)), at, BYTE_NS)
    return chip.read(count, at, BYTE_NS)


def sets(chip, number, at):
    """The x, y, z of `number` sets, drained in one burst."""
    data = peek(chip, 0x28, 6 * number, at)
    values = [int.from_bytes(data[i : i + 2], "little", signed=True) for i in range(0, len(data), 2)]
    return [tuple(values[i : i + 3]) for i in range(0, len(values), 3)]


def level(chip, at):
    """Sets stored: FSS + OVRN (L3G-58)."""
    source = peek(chip, 0x2F, at=at)[0]
    return (source & 0x1F) + (source >> 6 & 1)


def queueing(mode, watermark=0, counter=None):
    """ODR 100, first conversion at READY."""
    chip = L3g4200dChip(0x68, counter or Counter(), start_up_ns=300 * MS)
    poke(chip, 0x24, 0x40, at=MS)
    poke(chip, 0x2E, mode | watermark, at=MS)
    poke(chip, 0x20, 0x0F, at=10 * MS)
    return chip


def after(conversions):
    return READY + (conversions - 1) * 10 * MS + MS


def test_a_burst_wraps_and_drains_set_by_set():
    chip = queueing(STREAM)
    assert level(chip, after(5)) == 5
    assert sets(chip, 3, after(5)) == [(1, 2, -1), (2, 4, -2), (3, 6, -3)]  # L3G-05
    assert level(chip, after(5)) == 2
    assert sets(chip, 3, after(5)) == [(4, 8, -4), (5, 10, -5), (5, 10, -5)]  # the last one once more
    assert peek(chip, 0x2F, at=after(5)) == b"\xa0"


def test_byte_by_byte_reading_takes_one_set_per_six_bytes():
    chip = queueing(STREAM)
    for n in (1, 2, 3):
        data = b"".join(peek(chip, register, at=after(4)) for register in range(0x28, 0x2E))
        assert data == b"".join(v.to_bytes(2, "little", signed=True) for v in (n, 2 * n, -n))  # L3G-56


def test_fifo_mode_stops_at_32_until_bypass():
    chip = queueing(FIFO)
    assert peek(chip, 0x2F, at=after(31)) == b"\x9f"
    assert peek(chip, 0x2F, at=after(40)) == b"\xdf"  # OVRN and 31: DEC-23
    assert sets(chip, 32, after(40))[::31] == [(1, 2, -1), (32, 64, -32)]
    assert level(chip, after(60)) == 0
    poke(chip, 0x2E, 0x00, at=after(60))
    assert sets(chip, 1, after(60)) == [(60, 120, -60)]  # bypass: the latest conversion
    poke(chip, 0x2E, FIFO, at=after(60))
    assert sets(chip, 1, after(63)) == [(61, 122, -61)]
    assert level(chip, after(63)) == 2


@pytest.mark.parametrize("mode", [STREAM, STREAM_TO_FIFO])
def test_stream_mode_discards_the_oldest(mode):
    counter = Counter()
    chip = queueing(mode, counter=counter)
    assert peek(chip, 0x2F, at=after(1000)) == b"\xdf"
    assert counter.asked == 32  # samples that would be discarded are never requested
    assert sets(chip, 32, after(1000))[::31] == [(969, 1938, -969), (1000, 2000, -1000)]


def test_a_partly_read_set_is_not_overwritten():
    chip = queueing(STREAM)
    assert peek(chip, 0x28, 2, at=after(32)) == b"\x01\x00"
    assert peek(chip, 0x2A, 4, at=after(40)) == b"\x02\x00\xff\xff"
    assert sets(chip, 1, after(40)) == [(9, 18, -9)]


@pytest.mark.parametrize(("watermark", "source"), [(5, 0x04), (4, 0x84), (3, 0x84), (0, 0x84)])
def test_watermark_is_reached_at_its_level(watermark, source):
    assert peek(queueing(STREAM, watermark), 0x2F, at=after(4))[0] == source  # L3G-55


def test_bypass_and_a_fifo_that_is_not_enabled_store_nothing():
    for chip in (queueing(0x00), queueing(BYPASS_TO_STREAM)):
        assert peek(chip, 0x2F, at=after(7)) == b"\x20"
        assert sets(chip, 1, after(7)) == [(7, 14, -7)]
    chip = queueing(STREAM)
    poke(chip, 0x24, 0x00, at=after(2))
    assert peek(chip, 0x2F, at=after(7)) == b"\x20"
    assert sets(chip, 1, after(7)) == [(7, 14, -7)]


def test_status_follows_the_fifo():
    chip = queueing(STREAM)
    assert peek(chip, 0x27, at=after(0)) == b"\x00"
    assert peek(chip, 0x27, at=after(1)) == b"\x0f"
    assert peek(chip, 0x27, at=after(33)) == b"\xff"
    sets(chip, 32, after(33))
    assert peek(chip, 0x27, at=after(33)) == b"\x00"


def test_a_change_of_rate_keeps_stored_sets():
    counter = Counter()
    chip = queueing(STREAM, counter=counter)
    poke(chip, 0x20, 0x8F, at=after(2))
    assert level(chip, after(2) + 5 * MS) == 4  # two more at 2.5 ms
    assert sets(chip, 2, after(2) + 5 * MS) == [(1, 2, -1), (2, 4, -2)]
    poke(chip, 0x20, 0x07, at=after(5))
    stored = level(chip, after(5))
    assert level(chip, after(50)) == stored


def test_a_full_drain_is_192_bytes():
    chip = queueing(FIFO)
    assert len(set(sets(chip, 32, after(40)))) == 32  # L3G-57
