"""BMP180: the worked example of its data sheet to the last pascal, and conversions without blocking."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_emulator.chips.bmp180 import Bmp180Chip as Chip
from imuarray.array import SensorConfig
from imuarray.barometer import compensate
from imuarray.drivers.barometers import Bmp180
from imuarray.errors import SensorError

# The bytes and words of the worked example, BMP-20 ... BMP-30.
BLOCK = bytes.fromhex("0198 FFB8 C7D1 7FE5 7FF5 5A71 182E 0004 8000 DDF9 0B34")
WORDS = {
    "AC1": 408,
    "AC2": -72,
    "AC3": -14383,
    "AC4": 32741,
    "AC5": 32757,
    "AC6": 23153,
    "B1": 6190,
    "B2": 4,
    "MB": -32768,
    "MC": -8711,
    "MD": 2868,
}


def sensor(rate_hz: float = 4.0) -> SensorConfig:
    return SensorConfig(name="P", chip="bmp180", address=0x77, rate_hz=rate_hz)


def test_calibration_words_are_those_of_the_worked_example() -> None:
    assert Bmp180.calibration_words(BLOCK) == WORDS


def test_only_three_words_are_unsigned() -> None:
    words = Bmp180.calibration_words(b"\xff\xfe" * 11)
    assert {name for name, word in words.items() if word == 65534} == {"AC4", "AC5", "AC6"}
    assert {word for name, word in words.items() if name not in ("AC4", "AC5", "AC6")} == {-2}


@pytest.mark.parametrize(
    ("ut", "up", "oversampling", "degc", "pascal"),
    [
        (27898, 23843, 0, 15.0, 69964),  # BMP-60 ... BMP-63
        (27898, 47686, 1, 15.0, 69962),  # BMP-65
        (27898, 95372, 2, 15.0, 69963),
        (27898, 190744, 3, 15.0, 69963),
        (27898, 46000, 0, 15.0, 136329),  # the upper branch
    ],
)
def test_compensation(ut: int, up: int, oversampling: int, degc: float, pascal: int) -> None:
    temperature, pressure = compensate(np.array([ut]), np.array([up]), WORDS, oversampling)
    assert temperature[0] == degc
    assert pressure[0] == pascal


@pytest.mark.parametrize(("ut", "degc"), [(30000, 31.3), (24000, -24.7), (20000, 372.9)])  # BMP-65, BMP-66
def test_temperature(ut: int, degc: float) -> None:
    temperature, _ = compensate(np.array([ut]), np.array([23843]), WORDS, 0)
    assert temperature[0] == pytest.approx(degc, abs=1e-9)


def test_impossible_raw_values_give_finite_results() -> None:
    # X1 = -MD divides by zero: BMP-66. Every UT must give some number.
    ut = np.arange(0, 65536)
    temperature, pressure = compensate(ut, np.full_like(ut, 300000), WORDS, 3)
    assert np.isfinite(temperature).all()
    assert np.isfinite(pressure).all()


def test_decode_eight_samples() -> None:
    driver = Bmp180(None, sensor(), None)  # type: ignore[arg-type]
    driver.words = WORDS
    # UT 27898 = 0x6CFA, UP 190744 << (8 - 3) = 0x5D2300: BMP-47
    reading = driver.decode(np.array([list(bytes.fromhex("6CFA 5D2300"))], np.uint8))
    np.testing.assert_array_equal(reading.counts, [[27898, 190744]])
    assert reading.counts.dtype == np.int32
    assert reading.compensated["temperature"][0] == 15.0
    assert reading.compensated["pressure"][0] == 69963.0
    assert reading.status[0] == 0


@pytest.fixture
def ready(bench: Callable[..., Any]) -> Any:
    made = bench(Chip, sensor())
    made.driver.identify()
    made.driver.configure()
    return made


def test_header_is_the_words(ready: Any) -> None:
    header = ready.driver.header()
    assert {name: header[name] for name in WORDS} == WORDS


def test_a_reading_takes_the_time_of_both_conversions(ready: Any) -> None:
    start_ns = ready.clock.now_ns()
    times_ns: list[int] = []
    while ready.clock.now_ns() < start_ns + 60_000_000:
        if ready.driver.fetch():
            times_ns.append(ready.clock.now_ns() - start_ns)
        ready.wait(0.0005)
    assert len(times_ns) == 1
    assert times_ns[0] >= 4_500_000 + 25_500_000  # the longest conversions, BMP-40 and BMP-44
    assert times_ns[0] < 34_000_000
    commands = [write for write in ready.tap.writes if write[0] == 0xF4]
    assert commands == [b"\xf4\x2e", b"\xf4\xf4"]


def test_results_are_read_after_their_conversion_time(ready: Any) -> None:
    seen: list[tuple[int, bytes]] = []
    for _ in range(100):
        before, at_ns = len(ready.tap.seen), ready.clock.now_ns()
        ready.driver.fetch()
        seen += [(at_ns, write) for _, write, _ in ready.tap.seen[before:]]
        ready.wait(0.001)
    start = {write: at_ns for at_ns, write in reversed(seen)}
    reads = [at_ns for at_ns, write in seen if write == b"\xf4"]
    assert reads[0] >= start[b"\xf4\x2e"] + 4_500_000
    assert reads[1] >= start[b"\xf4\xf4"] + 25_500_000
    assert len(reads) == 2


@pytest.mark.parametrize(
    ("rate_hz", "frame_s"),
    [
        *((rate_hz, 0.002) for rate_hz in (1, 2, 4, 8)),
        *((rate_hz, 0.02) for rate_hz in (1, 2, 4, 8)),
    ],
)
def test_readings_have_the_configured_rate(bench: Callable[..., Any], rate_hz: int, frame_s: float) -> None:
    made = bench(Chip, sensor(rate_hz))
    made.driver.configure()
    start_ns = made.clock.now_ns()
    readings, due_ns = 0, start_ns
    while due_ns < start_ns + 10_000_000_000:
        readings += bool(made.driver.fetch())
        due_ns += round(frame_s * 1e9)
        made.clock.sleep_until(due_ns)
    assert abs(readings - 10 * rate_hz) <= 1


def test_readings_agree_with_the_world(ready: Any) -> None:
    burst = b""
    while not burst:
        burst = ready.driver.fetch()
        ready.wait(0.002)
    reading = ready.driver.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))
    assert reading.compensated["temperature"][0] == pytest.approx(25.0, abs=0.1)
    assert reading.compensated["pressure"][0] == pytest.approx(101325, abs=2)


def test_an_overdue_conversion_is_an_error(ready: Any) -> None:
    inner = ready.tap.bus

    class Slow:
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            answer = inner.transfer(address, write, read)
            if write == b"\xf4" and read > 1:
                return bytes([answer[0] | 0x20]) + answer[1:]  # sco still 1: BMP-46
            return answer

    ready.tap.bus = Slow()
    assert ready.driver.fetch() == b""
    ready.wait(0.010)
    with pytest.raises(OSError, match=r"P .*not finished in time") as overdue:
        ready.driver.fetch()
    assert overdue.value.errno == 5


def test_readings_restart_after_an_error(ready: Any) -> None:
    inner = ready.tap.bus

    class Dead:
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            raise OSError(121, "Remote I/O error")

    assert ready.driver.fetch() == b""
    ready.wait(0.010)
    ready.tap.bus = Dead()
    with pytest.raises(OSError, match="Remote"):
        ready.driver.fetch()
    ready.tap.bus = inner
    readings = 0
    for _ in range(600):
        readings += bool(ready.driver.fetch())
        ready.wait(0.001)
    assert readings >= 1


def test_an_old_result_is_never_taken_for_a_new_one(ready: Any) -> None:
    """The temperature half of a pair whose pressure was lost is not joined with a later pressure."""
    element = ready.chip.element
    while not ready.driver.fetch():
        ready.wait(0.001)
    inner, failing = ready.tap.bus, [False]

    class Flaky:
        def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
            if failing[0]:
                raise OSError(6, "No such device or address")
            return inner.transfer(address, write, read)

    ready.tap.bus = Flaky()
    ready.wait(0.3)
    ready.driver.fetch()  # temperature begins
    ready.wait(0.006)
    ready.driver.fetch()  # pressure begins
    failing[0] = True
    ready.wait(0.030)
    with pytest.raises(OSError, match="No such"):
        ready.driver.fetch()
    failing[0] = False
    ready.wait(0.2)
    element.temperature_degc, element.pressure_pa = 40.0, 90000.0
    burst = b""
    for _ in range(1000):
        burst = burst or ready.driver.fetch()
        ready.wait(0.001)
    reading = ready.driver.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))
    assert reading.compensated["temperature"][0] == pytest.approx(40.0, abs=0.1)
    assert reading.compensated["pressure"][0] == pytest.approx(90000, abs=2)


@pytest.mark.parametrize("word", ["AC1", "AC4", "MD"])
@pytest.mark.parametrize("value", [0x0000, 0xFFFF])
def test_a_calibration_word_of_0_or_ffff_is_refused(bench: Callable[..., Any], word: str, value: int) -> None:
    made = bench(Chip, sensor(), calibration={word: value})
    with pytest.raises(SensorError, match=rf"P \(bmp180\) at trunk address 0x77: calibration word {word} reads "):
        made.driver.configure()


def test_a_conversion_of_an_earlier_program_is_discarded(bench: Callable[..., Any]) -> None:
    made = bench(Chip, sensor())
    made.write((0xF4, 0xF4))  # the conversion of another program is under way
    made.driver.configure()
    burst = b""
    while not burst:
        burst = made.driver.fetch()
        made.wait(0.001)
    reading = made.driver.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))
    assert reading.compensated["pressure"][0] == pytest.approx(101325, abs=2)


def test_another_chip_is_refused(bench: Callable[..., Any]) -> None:
    made = bench(Chip, sensor())
    made.chip.page[0xD0] = 0x58
    with pytest.raises(SensorError, match=r"P \(bmp180\) at trunk address 0x77: identity 58, expected 55"):
        made.driver.identify()
