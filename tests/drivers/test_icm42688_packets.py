"""The packets of an ICM-42688-P's queue, from the layout that TDK-81, -82, -88 and -89 state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.array import SensorConfig, parse_array
from imuarray.drivers import driver_of
from imuarray.drivers.icm42688_packets import header_of, high_resolution_rows, packet_size, widened
from imuarray.errors import ConfigError

SATURATED, SUSPECT = 4, 32
RANGES = {"acc": 16.0, "gyro": 2000.0}

FORCE = st.integers(-(1 << 17), (1 << 17) - 1)
RATE = st.integers(-(1 << 18), (1 << 18) - 1)
WORD = st.integers(-32768, 32767)
SAMPLES = st.lists(st.tuples(st.tuples(FORCE, FORCE, FORCE), st.tuples(RATE, RATE, RATE), WORD), max_size=20)


class NoBus:
    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        raise AssertionError("decoding touched the bus")


def packet(force: tuple[int, ...], rate: tuple[int, ...], temperature: int, stamp: int = 0x1234) -> bytes:
    """A packet of 20 bytes from counts of 18 and 19 bits, written digit by digit."""
    forces = [f"{count * 4 & 0xFFFFF:05x}" for count in force]
    rates = [f"{count * 2 & 0xFFFFF:05x}" for count in rate]
    upper = "".join(digits[:4] for digits in forces + rates)
    lower = "".join(first[4] + second[4] for first, second in zip(forces, rates, strict=True))
    return bytes.fromhex(f"78{upper}{temperature & 0xFFFF:04x}{stamp:04x}{lower}")


def decoded(half: str, rows: bytes, *, fine: bool = True) -> object:
    sensor = SensorConfig(
        name="S",
        chip=f"icm42688_{half}",
        address=0x68,
        range=RANGES[half],
        rate_hz=1000.0,
        fifo=True,
        high_resolution=fine,
    )
    driver = driver_of(sensor)(NoBus(), sensor, None)  # type: ignore[arg-type]
    return driver.decode(np.frombuffer(rows, np.uint8).reshape(-1, driver.burst))


def status(counts: list[int], lowest: int) -> int:
    if lowest in counts:
        return SUSPECT
    return SATURATED if any(abs(count) == -lowest - 1 for count in counts) else 0


@given(SAMPLES)
def test_counts_of_18_and_19_bits_are_decoded(samples: list[tuple[tuple[int, ...], tuple[int, ...], int]]) -> None:
    packets = b"".join(packet(*sample) for sample in samples)
    for half, place, lowest in (("acc", 0, -(1 << 17)), ("gyro", 1, -(1 << 18))):
        reading = decoded(half, high_resolution_rows(packets, half))
        assert reading.counts.dtype == np.int32
        assert reading.counts.tolist() == [list(sample[place]) for sample in samples]
        assert reading.temperature_counts.tolist() == [sample[2] for sample in samples]
        assert reading.status.tolist() == [status(list(sample[place]), lowest) for sample in samples]


@given(st.lists(st.tuples(WORD, WORD, WORD, st.integers(-128, 127)), max_size=20), st.sampled_from(["acc", "gyro"]))
def test_packets_with_one_triad_are_decoded(samples: list[tuple[int, ...]], half: str) -> None:
    packets = b"".join(
        bytes([0x40 if half == "acc" else 0x20])
        + b"".join(count.to_bytes(2, "big", signed=True) for count in counts)
        + temperature.to_bytes(1, "big", signed=True)
        for *counts, temperature in samples
    )
    reading = decoded(half, widened(packets, half), fine=False)
    assert reading.counts.tolist() == [list(sample[:3]) for sample in samples]
    assert reading.temperature_counts.tolist() == [-32768 if last == -128 else 64 * last for *_, last in samples]
    assert reading.status.tolist() == [status(list(sample[:3]), -32768) for sample in samples]


@pytest.mark.parametrize("half", ["acc", "gyro"])
def test_the_lowest_code_is_suspect_and_the_end_codes_are_saturated(half: str) -> None:
    """TDK-88: -524288 of 20 bits, on any axis; TDK-89: of 20 bits two or one are always 0."""
    step = {"acc": 4, "gyro": 2}[half]
    lowest = -524288 // step
    invalid = [[lowest, 0, 0], [0, lowest, -1], [1, 2, lowest]]
    samples = [*invalid, [lowest + 1, 0, 0], [0, 524288 // step - 1, 0], [0, 0, 0]]
    packets = b"".join(
        packet(*(((*sample,), (0, 0, 0)) if half == "acc" else ((0, 0, 0), (*sample,))), 0) for sample in samples
    )
    reading = decoded(half, high_resolution_rows(packets, half))
    assert reading.status.tolist() == [SUSPECT, SUSPECT, SUSPECT, SATURATED, SATURATED, 0]


@pytest.mark.parametrize(
    ("header", "size"),
    [
        *((0x40, 8), (0x43, 8), (0x20, 8), (0x68, 16), (0x6B, 16), (0x78, 20), (0x7B, 20)),
        *((0xFF, 0), (0x80, 0), (0x00, 0), (0x0F, 0), (0x50, 0), (0x30, 0), (0xF8, 0)),
    ],
)
def test_the_header_gives_the_size(header: int, size: int) -> None:
    """TDK-81."""
    assert packet_size(header) == size


@given(st.integers(0, 255))
def test_the_size_of_a_packet_matches_the_halves_of_its_header(header: int) -> None:
    halves = [half for half, bit in (("acc", 0x40), ("gyro", 0x20)) if header & bit]
    size = packet_size(header)
    assert size in (0, 8, 16, 20)
    if size:
        assert header_of(halves, high_resolution=size == 20) == header & 0xF0
        assert (size == 8) == (len(halves) == 1)


def entry(half: str, **keys: object) -> str:
    settings = {"address": "0x68", "range": int(RANGES[half]), "fifo": "true", "high_resolution": "true"} | keys
    lines = [f"{key} = {value}" for key, value in settings.items()]
    return "\n".join(["[[sensor]]", f'name = "{half}"', *lines, ""])


@pytest.mark.parametrize(
    ("entries", "complaint"),
    [
        ([entry("acc", chip='"icm42688"', range=4)], "range 4: allowed are 16 with high_resolution"),
        ([entry("gyro", chip='"icm42688"', range=500)], "range 500: allowed are 2000 with high_resolution"),
        ([entry("acc", chip='"icm42688"', fifo="false")], "high_resolution: only with fifo = true"),
        (
            [entry("acc", chip='"mpu6500"')],
            "high_resolution true: the mpu6500_acc has no such queue; allowed for icm42688_acc, icm42688_gyro",
        ),
        (
            [entry("acc", chip='"icm42688"'), entry("gyro", chip='"icm42688"', high_resolution="false")],
            "are one icm42688: high_resolution is the same for both",
        ),
    ],
)
def test_unsupported_configurations_are_refused(entries: list[str], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_array('[array]\nname = "a"\n' + "".join(entries))


def test_high_resolution_counts_have_their_sensitivity() -> None:
    """TDK-89: 8192 a g in 18 bits, 131 a dps in 19."""
    text = '[array]\nname = "a"\n' + entry("acc", chip='"icm42688"') + entry("gyro", chip='"icm42688"')
    acc, gyro = parse_array(text).sensors
    assert (acc.sensitivity, acc.count_bits) == (8192.0, 18)
    assert (gyro.sensitivity, gyro.count_bits) == (131.0, 19)
