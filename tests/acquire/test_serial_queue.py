"""Queues of six-axis chips behind a microcontroller: the host drains them through the link, however full they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from imuarray.acquire import connect
from imuarray.acquire.stream import streams
from imuarray.array import ArrayConfig, parse_array
from imuarray.bus.serial_link import MAX_PAYLOAD
from tests.bus.serial_bench import Bench
from tests.firmware.kinds import both_kinds

MS = 1_000_000
QUEUES = {  # place, register (with the bit that reads of SPI), range of each half, rate, milliseconds that it lasts
    "icm42688": ('bus = "/dev/spidev0.1"', 0xB0, (4, 500), 1000, 120),
    "icm42688 in 20 bits": ('bus = "/dev/spidev0.1"', 0xB0, (16, 2000), 1000, 95),
    "lsm6dso": ("address = 0x6A", 0x78, (4, 500), 416, 500),
    "mpu6050": ("address = 0x68", 0x74, (4, 500), 500, 130),
    "mpu9250": ("address = 0x68", 0x74, (4, 500), 200, 150),
}


def array_of(name: str) -> ArrayConfig:
    place, _, ranges, rate_hz, _ = QUEUES[name]
    text = '[array]\nname = "a"\n'
    for half, full_scale in zip(("acc", "gyro"), ranges, strict=True):
        text += f'[[sensor]]\nname = "{half}"\nchip = "{name.partition(" ")[0]}"\n{place}\nrange = {full_scale}\n'
        text += f"rate_hz = {rate_hz}\nfifo = true\n"
        text += "high_resolution = true\n" if "20 bits" in name else ""
    return parse_array(text)


QUICK = ("icm42688 in 20 bits", "mpu9250")


@both_kinds()
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow, id=name) for name in QUEUES]
)
def test_every_sample_of_a_queue_is_transferred_by_the_link(name: str) -> None:
    """Every row is what went over the wires of the microcontroller, and none is missing from its times."""
    array = array_of(name)
    _, register, _, rate_hz, lasting_ms = QUEUES[name]
    bench = Bench(array, "world=shaking&still_s=0.2&motion_s=5", selects=8)
    with bench.bus() as bus:
        routes = connect(array, bus)
        assert streams(bus, routes)
        for route in routes:
            route.driver.fetch()
        times: list[list[int]] = [[], []]
        for visit in range(8):
            bench.sleep_until(bench.now_ns() + (lasting_ms if visit % 2 else 15) * MS)
            for half, route in enumerate(routes):
                driver: Any = route.driver
                rows = len(driver.fetch()) // driver.burst
                assert rows == len(driver.queue.drained)
                assert not driver.queue.gaps
                times[half] += driver.queue.drained
    drained = [len(tap.answer or b"") for tap in bench.taps if tap.write == bytes([register])]
    assert max(drained) < MAX_PAYLOAD
    assert len(drained) > 8 or name.startswith("mpu")  # full queues take several transactions
    for stamps in times:
        assert len(stamps) > 4 * lasting_ms * rate_hz / 1000
        assert len(stamps) == pytest.approx((stamps[-1] - stamps[0]) * 1e-9 * rate_hz + 1, abs=2)
        assert np.diff(stamps) == pytest.approx(1e9 / rate_hz, rel=0.4)
