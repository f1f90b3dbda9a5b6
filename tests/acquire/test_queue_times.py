"""Times of samples from the queues of six-axis chips, against the instants at which the emulated chips took them.

The world is a clock: the specific force along x is the share of the present second that has passed, so that each row
shows when it was taken, to 31 us at 16 g. Oscillators are off by up to one percent, the host is milliseconds late.
"""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.board import Board
from firmware_emulator.mechanisms.host import LatentWire
from imuarray.acquire import record
from imuarray.array import parse_array
from imuarray.log import open_log
from tests.acquire.clock_world import SPAN_G, ClockElement, array_text

SECONDS = 16.0
STARTS_S = 5.0
"""The first seconds, in which the period is still being found, are judged apart."""


class LateBoard(Board):
    """Every other transaction waits for the host, exponentially with a mean of 2 ms."""

    def wire(self, clock: Any, bit_rate_hz: int, nack_errno: int, host_ns: int) -> LatentWire:
        drawn = random.Random(5)
        waits = [lambda: round(drawn.expovariate(1 / 2e6)) if drawn.random() < 0.5 else 0]
        return LatentWire(clock, bit_rate_hz, nack_errno, host_ns, waits)

    def element(self, sensor: Any) -> ClockElement:
        return ClockElement()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("die", "rate_hz", "error", "on_spi"),
    [
        pytest.param("icm42688", 1000, 0.01, True, marks=pytest.mark.slow),
        pytest.param("icm42688", 1000, -0.01, True, marks=pytest.mark.campaign),
        pytest.param("icm42688", 1000, 0.0, False, marks=pytest.mark.slow),
        pytest.param("icm42688", 200, -0.004, True, marks=pytest.mark.campaign),
        pytest.param("lsm6dso", 416, 0.01, False, marks=pytest.mark.slow),
        pytest.param("mpu6500", 500, -0.01, False, marks=pytest.mark.campaign),
        ("mpu6050", 500, 0.0033, False),
    ],
)
def test_the_time_of_a_row_is_within_50_us_rms_of_its_sample(
    die: str, rate_hz: int, error: float, on_spi: bool, tmp_path: Path
) -> None:
    array = parse_array(array_text(die, rate_hz, on_spi=on_spi))
    with open_array(array, board=LateBoard, switches={"acc": {"rate_error": error}}) as bus:
        starts_ns: list[int] = []  # time 0 of the log on the clock of the world
        summary = record(
            array,
            bus,
            tmp_path / "run.h5",
            rate_hz=40.0,
            seconds=SECONDS,
            on_headers=lambda *_: starts_ns.append(bus.clock.now_ns()),
        )
        assert not any(summary.lost.values())
        assert summary.uncertain == 0  # the times of a queue have bounds of their own
        chip = bus.chips["acc"]
        assert chip is bus.chips["gyro"]
    with open_log(tmp_path / "run.h5") as log:
        acc, gyro = log["acc"], log["gyro"]
        assert not np.asarray(acc.status[:]).any()
        share = acc.counts[:][:, 0] / acc.sensitivity / (SPAN_G * 0.999) + 0.5
        felt_ns = np.asarray(acc.time[:]) - acc.delay_ns  # the input passes the filter of the chip
        time_s = felt_ns * 1e-9 + starts_ns[0] * 1e-9
        off_s = (time_s - share + 0.5) % 1.0 - 0.5
        settled = acc.time[:] > STARTS_S * 1e9
        assert np.sqrt(np.mean(off_s[settled] ** 2)) < 50e-6
        assert np.abs(off_s[settled]).max() < 400e-6
        assert np.abs(off_s).max() < 1.3 / rate_hz
        stated_s = np.asarray(acc.time_uncertainty[:], float)
        clock_step_s = 1 / acc.sensitivity / SPAN_G  # the resolution of the world's clock
        assert (np.abs(off_s) <= stated_s + clock_step_s).all()  # a bound, also before the period is known
        assert np.median(stated_s[settled]) < 200e-6
        assert stated_s.max() < 2.0 / rate_hz
        assert len(acc.time) == pytest.approx(SECONDS * rate_hz * (1 + error), rel=0.01)
        assert abs(len(acc.time) - len(gyro.time)) <= 0.05 * rate_hz  # the samples in the queue at the end
