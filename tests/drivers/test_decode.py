"""Bytes into counts, from the literal test vectors of the data sheets; and the flags that a burst contains."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.array import SensorConfig
from imuarray.chips import CHIPS
from imuarray.drivers import DRIVERS, DecodedBursts

STALE, SATURATED = 1, 4
OVERRUN = 2

ADDRESSES = {"bma180": 0x40, "adxl345": 0x53, "l3g4200d": 0x68, "hmc5883": 0x1E, "hmc5883l": 0x1E, "bmp180": 0x77}


class NoBus:
    """Decoding is pure: it makes no transfer."""

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        raise AssertionError("decoding touched the bus")


def decoded(chip: str, *bursts: str, **settings: Any) -> DecodedBursts:
    """The decoded values of bursts, written as hexadecimal digits."""
    settings = settings or {
        "range": {"bma180": 2, "adxl345": 16, "l3g4200d": 250, "hmc5883": 1.2, "hmc5883l": 1.3}.get(chip)
    }
    sensor = SensorConfig(name="S", chip=chip, address=ADDRESSES[chip], **settings)
    driver = DRIVERS[chip](NoBus(), sensor, None)  # type: ignore[arg-type]
    block = np.array([list(bytes.fromhex(burst)) for burst in bursts], np.uint8)
    assert block.shape[1] == driver.burst
    return driver.decode(block)


class TestBma180:
    def test_vectors_of_bma_65(self) -> None:
        plus_g, minus_g, minus_one, most, zero = "01 40", "01 C0", "FD FF", "FD 7F", "01 00"
        reading = decoded("bma180", f"{plus_g}{minus_g}{minus_one} 00", f"{most}{zero}{plus_g} 00")
        np.testing.assert_array_equal(reading.counts, [[4096, -4096, -1], [8191, 0, 4096]])
        assert reading.counts.dtype == np.int16

    def test_temperature_of_bma_63(self) -> None:
        reading = decoded(
            "bma180", "01 00 01 00 01 00 00", "01 00 01 00 01 00 80", "01 00 01 00 01 00 02", "01 00 01 00 01 00 FF"
        )
        assert reading.temperature_counts is not None
        assert reading.temperature_counts.dtype == np.int16
        np.testing.assert_array_equal(reading.temperature_counts, [0, -128, 2, -1])

    def test_the_new_data_flag_does_not_change_the_code(self) -> None:
        with_flag, without = decoded("bma180", "01 40 01 40 01 40 00"), decoded("bma180", "00 40 00 40 00 40 00")
        np.testing.assert_array_equal(with_flag.counts, without.counts)

    @pytest.mark.parametrize(
        ("burst", "stale"),
        [("00 10 00 10 00 10 00", True), ("01 10 00 10 00 10 00", False), ("00 10 00 10 01 10 00", False)],
    )
    def test_a_burst_without_a_new_axis_is_stale(self, burst: str, stale: bool) -> None:
        assert decoded("bma180", burst).status[0] == (STALE if stale else 0)

    @pytest.mark.parametrize(
        ("word", "saturated"), [("FD 7F", True), ("01 80", True), ("F9 7F", False), ("05 80", False)]
    )
    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_saturated_at_either_end(self, word: str, axis: int, saturated: bool) -> None:
        words = ["01 00"] * 3
        words[axis] = word
        assert decoded("bma180", " ".join([*words, "00"])).status[0] == (SATURATED if saturated else 0)


class TestAdxl345:
    def test_vectors_of_adx_48(self) -> None:
        reading = decoded("adxl345", "82 0B 00 01 00 FF 00 F0", "82 0B FF 0F 00 00 FF FF")
        np.testing.assert_array_equal(reading.counts, [[256, -256, -4096], [4095, 0, -1]])
        assert reading.counts.dtype == np.int16
        assert reading.temperature_counts is None

    def test_stale_without_data_ready(self) -> None:
        reading = decoded("adxl345", "02 0B 00 01 00 FF 00 00", "82 0B 00 01 00 FF 00 00", "83 0B 00 01 00 FF 00 00")
        np.testing.assert_array_equal(reading.status & STALE, [STALE, 0, 0])

    @pytest.mark.parametrize(
        ("range_g", "low", "inside_low", "inside_high", "high"),
        [  # ADX-46
            (2, "00 FE", "01 FE", "FE 01", "FF 01"),
            (4, "00 FC", "01 FC", "FE 03", "FF 03"),
            (8, "00 F8", "01 F8", "FE 07", "FF 07"),
            (16, "00 F0", "01 F0", "FE 0F", "FF 0F"),
        ],
    )
    def test_saturated_at_the_ends_of_each_span(
        self, range_g: int, low: str, inside_low: str, inside_high: str, high: str
    ) -> None:
        bursts = [f"82 0B 00 00 {word} 00 00" for word in (low, inside_low, inside_high, high)]
        reading = decoded("adxl345", *bursts, range=range_g, rate_hz=800.0)
        np.testing.assert_array_equal(reading.status, [SATURATED, 0, 0, SATURATED])

    @pytest.mark.parametrize("rate_hz", [1600, 3200])
    def test_saturated_where_only_even_codes_occur(self, rate_hz: int) -> None:
        # ADX-47: at 1600 and 3200 Hz the lowest bit is 0, so that +4094 is the top of the span.
        reading = decoded(
            "adxl345", "82 0B FE 0F 00 00 00 00", "82 0B FC 0F 00 00 00 00", range=16, rate_hz=float(rate_hz)
        )
        np.testing.assert_array_equal(reading.status, [SATURATED, 0])


class TestL3g4200d:
    def test_vectors_of_l3g_45(self) -> None:
        reading = decoded("l3g4200d", "14 0F A5 2C 6B FA 00 00")
        np.testing.assert_array_equal(reading.counts, [[11429, -1429, 0]])
        assert reading.counts.dtype == np.int16

    def test_temperature_is_a_signed_byte(self) -> None:
        reading = decoded("l3g4200d", "14 0F" + "00" * 6, "FF 0F" + "00" * 6, "80 0F" + "00" * 6)
        assert reading.temperature_counts is not None
        np.testing.assert_array_equal(reading.temperature_counts, [20, -1, -128])

    def test_stale_without_zyxda(self) -> None:
        # L3G-18: bit 3 means that all three axes are new.
        reading = decoded(
            "l3g4200d", *(f"14 {status} 00 00 00 00 00 00" for status in ("0F", "08", "07", "00", "F0", "FF"))
        )
        np.testing.assert_array_equal(reading.status & ~np.uint16(OVERRUN), [0, 0, STALE, STALE, STALE, 0])

    def test_overrun_with_zyxor(self) -> None:
        # L3G-18, L3G-52: bit 7 means that all three axes were replaced unread.
        reading = decoded("l3g4200d", *(f"14 {status} 00 00 00 00 00 00" for status in ("0F", "8F", "7F", "FF")))
        np.testing.assert_array_equal(reading.status, [0, OVERRUN, 0, OVERRUN])

    def test_saturated(self) -> None:
        reading = decoded("l3g4200d", "14 0F FF 7F 00 00 00 00", "14 0F 00 00 00 80 00 00", "14 0F FE 7F 01 80 00 00")
        np.testing.assert_array_equal(reading.status, [SATURATED, SATURATED, 0])


@pytest.mark.parametrize("chip", ["hmc5883", "hmc5883l"])
class TestHmc5883:
    def test_vector_of_hmc_40_in_the_order_x_z_y(self, chip: str) -> None:
        reading = decoded(chip, "02 21 FF FF 00 10")
        np.testing.assert_array_equal(reading.counts, [[545, 16, -1]])
        assert reading.counts.dtype == np.int16
        assert reading.status[0] == 0

    @pytest.mark.parametrize(
        "burst",
        ["F0 00 00 00 00 00", "00 00 F0 00 00 00", "00 00 00 00 F0 00", "F8 00 00 00 00 00", "00 00 00 00 07 FF"],
    )
    def test_overflow_is_flagged(self, chip: str, burst: str) -> None:
        assert decoded(chip, burst).status[0] == SATURATED

    def test_the_last_codes_inside_the_range_are_not_saturated(self, chip: str) -> None:
        assert decoded(chip, "F8 01 07 FE 00 00").status[0] == 0


@given(st.lists(st.binary(min_size=7, max_size=7), min_size=1, max_size=20))
def test_many_bursts_at_once_are_the_same_as_one_by_one(bursts: list[bytes]) -> None:
    for chip, length in (("bma180", 7), ("hmc5883", 6)):
        together = decoded(chip, *(burst[:length].hex() for burst in bursts))
        single = [decoded(chip, burst[:length].hex()) for burst in bursts]
        np.testing.assert_array_equal(together.counts, np.concatenate([entry.counts for entry in single]))
        np.testing.assert_array_equal(together.status, np.concatenate([entry.status for entry in single]))


@given(st.tuples(*[st.integers(-8192, 8191)] * 3), st.integers(-128, 127))
def test_a_bma180_burst_round_trips_all_14_bit_codes(codes: tuple[int, int, int], temperature: int) -> None:
    burst = b"".join(((code & 0x3FFF) << 2 | 1).to_bytes(2, "little") for code in codes) + temperature.to_bytes(
        1, "big", signed=True
    )
    reading = decoded("bma180", burst.hex())
    np.testing.assert_array_equal(reading.counts, [codes])
    assert reading.temperature_counts is not None
    assert reading.temperature_counts[0] == temperature


def test_the_burst_length_of_a_spec_is_that_of_its_driver() -> None:
    """The simulated bus time of a reading (`burst_bytes`) is that of the transaction which the driver makes."""
    lengths = {chip: spec.burst_bytes for chip, spec in CHIPS.items() if not spec.on_demand}
    assert lengths == {chip: DRIVERS[chip].burst for chip in lengths}
