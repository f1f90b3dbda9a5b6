"""Barometers in forced mode: the worked examples of data sheets, and measurements without blocking."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_emulator.chips import CHIPS
from firmware_emulator.chips.bmp280 import Bmp280Words, fine_of, pascal_of
from firmware_emulator.chips.bmp388 import Bmp388Words as Words388
from firmware_emulator.chips.bmp388 import degc_of
from firmware_emulator.chips.bmp388 import pascal_of as pascal_388
from imuarray.array import SensorConfig
from imuarray.barometer import (
    BAROMETERS,
    compensate_bmp280,
    compensate_bmp388,
    fine_temperature_bmp280,
    pressure_bmp280,
)
from imuarray.chips import CHIPS as SPECS
from imuarray.drivers import DRIVERS
from imuarray.drivers.barometers import Bmp280, Bmp388
from imuarray.errors import SensorError

# The bytes and words of the BMP280's worked example: BMP-120.
BLOCK_280 = bytes.fromhex("706b 4367 18fc 7d8e 43d6 d00b 270b 8c00 f9ff 8c3c f8c6 7017")
WORDS_280 = {
    "T1": 27504,
    "T2": 26435,
    "T3": -1000,
    "P1": 36477,
    "P2": -10685,
    "P3": 3024,
    "P4": 2855,
    "P5": 140,
    "P6": -7,
    "P7": 15500,
    "P8": -14600,
    "P9": 6000,
}
# Bytes and words of a published measurement with a BMP388: BMP-220.
BLOCK_388 = bytes.fromhex("236b 5849 f6 5cff cef4 23 00 ea63 6e79 f3 f6 aa43 12 c4")
WORDS_388 = {
    "T1": 27427,
    "T2": 18776,
    "T3": -10,
    "P1": -164,
    "P2": -2866,
    "P3": 35,
    "P4": 0,
    "P5": 25578,
    "P6": 31086,
    "P7": -13,
    "P8": -10,
    "P9": 17322,
    "P10": 18,
    "P11": -60,
}
FORCED = ("bmp280", "bmp388")
ADDRESSES = {"bmp280": 0x76, "bmp388": 0x76}
ASKED = {"bmp280": b"\xf4\x55", "bmp388": b"\x1b\x13"}
LONGEST_S = {"bmp280": 0.043225, "bmp388": 0.043}  # BMP-109, BMP-209
RESET = {"bmp280": (0xE0, 0xB6), "bmp388": (0x7E, 0xB6)}


def sensor(chip: str, rate_hz: float = 4.0) -> SensorConfig:
    return SensorConfig(name="P", chip=chip, address=ADDRESSES[chip], rate_hz=rate_hz)


# Arithmetic -----------------------------------------------------------------------------------------------------------


def test_calibration_words_of_a_bmp280_are_decoded() -> None:
    assert Bmp280.calibration_words(BLOCK_280) == WORDS_280
    unsigned = {name for name, word in Bmp280.calibration_words(b"\xfe\xff" * 12).items() if word == 65534}
    assert unsigned == {"T1", "P1"}  # BMP-103


def test_the_worked_example_of_the_bmp280_is_reproduced() -> None:
    """BMP-120: t_fine 128422, 25.08 degC, 100653.27 Pa, computed in real numbers; integers deviate a little."""
    ut, up = np.array([519888]), np.array([415148])
    fine = fine_temperature_bmp280(ut, WORDS_280)
    assert fine[0] == 128422
    temperature, pressure = compensate_bmp280(ut, up, WORDS_280)
    assert temperature[0] == 25.08
    assert pressure[0] == pytest.approx(100653.27, abs=0.05)


def test_calibration_words_of_a_bmp388_are_decoded() -> None:
    assert Bmp388.calibration_words(BLOCK_388) == WORDS_388
    unsigned = {name for name, word in Bmp388.calibration_words(b"\xfe\xff" * 10 + b"\xfe").items() if word > 0}
    assert unsigned == {"T1", "T2", "P5", "P6"}  # BMP-203


def test_a_published_measurement_with_a_bmp388_is_reproduced() -> None:
    """BMP-220: bytes 97 9F 6D 73 D8 85 are 30.499314 degC and 100876.0063 Pa in real numbers; integers drop what is
    below 0.01.
    """
    temperature, pressure = compensate_bmp388(np.array([0x85D873]), np.array([0x6D9F97]), WORDS_388)
    assert temperature[0] == 30.49
    assert pressure[0] == 100876.0


def test_the_integers_of_the_bmp388_follow_the_formulas_in_real_numbers() -> None:
    """Over -40 to 85 degC and 300 to 1250 hPa, by the data sheet's chapter 9 (BMP-221)."""
    words, off_degc, off_pascal = Words388(), [], []
    raw = np.arange(0, 1 << 24, 65537)
    for ut in raw.tolist():
        degc = degc_of(words, ut)
        if not -40 <= degc <= 85:
            continue
        temperature, pressure = compensate_bmp388(np.full_like(raw, ut), raw, WORDS_388)
        off_degc.append(temperature[0] - degc)
        exact = np.array([pascal_388(words, degc, up) for up in raw])
        off_pascal.append((pressure - exact)[(exact >= 30_000) & (exact <= 125_000)])
    assert len(np.concatenate(off_pascal)) > 5000
    assert np.abs(off_degc).max() < 0.011
    assert np.abs(np.concatenate(off_pascal)).max() < 0.1


def test_the_integers_of_the_bmp280_follow_the_formulas_in_real_numbers() -> None:
    """Over -40 to 85 degC and 300 to 1100 hPa, for which the data sheet's section 8.1 is the reference (BMP-121)."""
    words, off_degc, off_64 = Bmp280Words(), [], []
    for adc_t in range(0, 1 << 20, 4099):
        fine = fine_of(words, adc_t)
        if not -40 <= fine / 5120 <= 85:
            continue
        whole = fine_temperature_bmp280(np.array([adc_t]), WORDS_280)
        off_degc.append(float(whole[0]) / 5120 - fine / 5120)
        adc_p = np.arange(0, 1 << 20, 8191)
        exact = np.array([pascal_of(words, float(whole[0]), adc) for adc in adc_p])
        inside = (exact >= 30_000) & (exact <= 110_000)
        off_64.append((pressure_bmp280(adc_p, whole, WORDS_280) / 256.0 - exact)[inside])
    assert len(np.concatenate(off_64)) > 5000
    assert np.abs(off_degc).max() < 0.01
    assert np.abs(np.concatenate(off_64)).max() < 0.05


@pytest.mark.parametrize("chip", BAROMETERS)
def test_raw_words_round_trip(chip: str) -> None:
    arithmetic = BAROMETERS[chip]
    degc, pascal = np.repeat([-20.0, 0.0, 25.0, 60.0], 3), np.tile([40_000.0, 90_000.0, 105_000.0], 4)
    ut, up = arithmetic.uncompensated(degc, pascal, arithmetic.words)
    back_degc, back_pascal = arithmetic.compensate(ut, up, arithmetic.words)
    assert back_degc == pytest.approx(degc, abs=0.1)  # the BMP180's step
    assert back_pascal == pytest.approx(pascal, abs=1.0)


@pytest.mark.parametrize("chip", FORCED)
def test_impossible_raw_values_give_finite_results(chip: str) -> None:
    """Every raw word gives a finite number, for any value of the other."""
    arithmetic = BAROMETERS[chip]
    bits = {"bmp280": 20, "bmp388": 24}[chip]
    raw = np.arange(0, 1 << bits, (1 << bits) // 1009)
    for other in (0, 1 << bits - 1, (1 << bits) - 1):
        for ut, up in ((raw, np.full_like(raw, other)), (np.full_like(raw, other), raw)):
            temperature, pressure = arithmetic.compensate(ut, up, arithmetic.words)
            assert np.isfinite(temperature).all()
            assert np.isfinite(pressure).all()


# Measurements ---------------------------------------------------------------------------------------------------------


@pytest.fixture(params=FORCED)
def ready(request: Any, bench: Callable[..., Any]) -> Any:
    made = bench(CHIPS[request.param], sensor(request.param))
    made.driver.identify()
    made.driver.configure()
    return made


def reading(made: Any, tries: int = 1000) -> Any:
    """The next reading, decoded."""
    burst = b""
    for _ in range(tries):
        burst = burst or made.driver.fetch()
        made.wait(0.001)
    return made.driver.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))


@pytest.mark.parametrize("chip", FORCED)
def test_settings_and_driver_agree_on_the_measurement_time(chip: str) -> None:
    kind: Any = DRIVERS[chip]
    assert [nanoseconds * 1e-9 for nanoseconds in kind.conversions_ns] == pytest.approx(SPECS[chip].conversions_s)


def test_header_is_the_words(ready: Any) -> None:
    header = ready.driver.header()
    words = BAROMETERS[ready.sensor.chip].words
    assert {name: header[name] for name in words} == words


def test_readings_agree_with_the_world(ready: Any) -> None:
    for degc, pascal in ((25.0, 101325.0), (-15.0, 70000.0), (61.3, 104000.0)):
        ready.chip.element.temperature_degc, ready.chip.element.pressure_pa = degc, pascal
        reading(ready)
        decoded = reading(ready)
        assert decoded.compensated["temperature"][0] == pytest.approx(degc, abs=0.011)
        assert decoded.compensated["pressure"][0] == pytest.approx(pascal, abs=0.5)
        assert decoded.counts.dtype == np.int32


def test_a_result_is_read_after_its_measurement_time(ready: Any) -> None:
    chip = ready.sensor.chip
    seen: list[tuple[int, bytes, int]] = []
    for _ in range(240):
        before, at_ns = len(ready.tap.seen), ready.clock.now_ns()
        ready.driver.fetch()
        seen += [(at_ns, write, read) for _, write, read in ready.tap.seen[before:]]
        ready.wait(0.001)
    asked = [at_ns for at_ns, write, _ in seen if write == ASKED[chip]]
    looks = [at_ns for at_ns, _, read in seen if read]
    assert len(asked) == len(looks) == 1
    assert LONGEST_S[chip] <= (looks[0] - asked[0]) * 1e-9 < LONGEST_S[chip] + 0.002


@pytest.mark.parametrize("chip", FORCED)
@pytest.mark.parametrize(("rate_hz", "frame_s"), [(1, 0.002), (4, 0.02), (8, 0.002), (16, 0.005)])
def test_readings_have_the_configured_rate(bench: Callable[..., Any], chip: str, rate_hz: int, frame_s: float) -> None:
    made = bench(CHIPS[chip], sensor(chip, rate_hz))
    made.driver.configure()
    start_ns = made.clock.now_ns()
    readings, due_ns = 0, start_ns
    while due_ns < start_ns + 10_000_000_000:
        readings += bool(made.driver.fetch())
        due_ns += round(frame_s * 1e9)
        made.clock.sleep_until(due_ns)
    assert abs(readings - 10 * rate_hz) <= 1


def test_a_chip_that_is_reset_during_a_measurement_gives_no_reading(ready: Any) -> None:
    """Its data registers state "skipped" then, which also compensates to a temperature and a pressure."""
    assert ready.driver.fetch() == b""
    ready.write(RESET[ready.sensor.chip])
    ready.wait(LONGEST_S[ready.sensor.chip] + 0.001)
    with pytest.raises(OSError, match=r"P .*not finished in time, or lost") as lost:
        ready.driver.fetch()
    assert lost.value.errno == 5
    assert reading(ready).compensated["pressure"][0] == pytest.approx(101325, abs=0.5)


def test_a_result_is_read_after_an_error_of_the_bus(ready: Any) -> None:
    inner = ready.tap.bus

    class Dead:
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            raise OSError(121, "Remote I/O error")

    assert ready.driver.fetch() == b""
    ready.wait(LONGEST_S[ready.sensor.chip] + 0.001)
    ready.tap.bus = Dead()
    with pytest.raises(OSError, match="Remote"):
        ready.driver.fetch()
    ready.tap.bus = inner
    assert len(ready.driver.fetch()) == 6


def test_an_old_result_is_never_taken_for_a_new_one(ready: Any) -> None:
    ready.driver.fetch()
    for _ in range(10):  # calls come often ...
        ready.wait(0.001)
        ready.driver.fetch()
    ready.wait(0.4)  # ... and then there is a pause
    ready.chip.element.temperature_degc, ready.chip.element.pressure_pa = 40.0, 90000.0
    decoded = reading(ready)
    assert decoded.compensated["temperature"][0] == pytest.approx(40.0, abs=0.011)
    assert decoded.compensated["pressure"][0] == pytest.approx(90000, abs=0.5)


@pytest.mark.parametrize(("chip", "word"), [("bmp280", word) for word in ("T1", "T2", "P1")] + [("bmp388", "P5")])
@pytest.mark.parametrize("value", [0x0000, 0xFFFF])
def test_a_calibration_word_of_0_or_ffff_is_refused(
    bench: Callable[..., Any], chip: str, word: str, value: int
) -> None:
    made = bench(CHIPS[chip], sensor(chip), calibration={word: value})
    with pytest.raises(SensorError, match=rf"P \({chip}\) at trunk address 0x76: calibration word {word} reads "):
        made.driver.configure()


def test_settings_of_an_earlier_program_are_replaced(ready: Any) -> None:
    """The filter (and three-wire SPI) of an earlier program are switched off, its measurements stop."""
    filters, measure = {"bmp280": ((0xF5, 0xFD), (0xF4, 0x27)), "bmp388": ((0x1F, 0x0E), (0x1B, 0x33))}[
        ready.sensor.chip
    ]
    ready.write(filters, measure)
    ready.driver.configure()
    assert ready.register(filters[0]) == 0
    assert reading(ready).compensated["pressure"][0] == pytest.approx(101325, abs=0.5)


@pytest.mark.parametrize(
    ("chip", "identity", "message"),
    [
        ("bmp280", 0x55, "identity 55, a BMP180, expected 58"),
        ("bmp280", 0x60, "identity 60, a BME280, expected 58"),  # BMP-102
        ("bmp280", 0x00, "identity 00, expected 58"),
        ("bmp388", 0x60, "identity 60, a BMP390, expected 50"),  # BMP-202
    ],
)
def test_another_chip_is_named(bench: Callable[..., Any], chip: str, identity: int, message: str) -> None:
    made = bench(CHIPS[chip], sensor(chip), identity=identity)
    with pytest.raises(SensorError, match=rf"P \({chip}\) at trunk address 0x76: {message}"):
        made.driver.identify()
