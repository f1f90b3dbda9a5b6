"""A chip whose oscillator stops, its registers as configured: nothing arrives in its queue, which is reported within a
second. A chip whose queue runs over between all frames is distinguished from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.chip import NEVER_NS
from firmware_emulator.six_axis import SampleGrid
from imuarray.acquire import record
from imuarray.array import parse_array
from imuarray.log import open_log
from imuarray.log.format import OVERRUN, RECONFIGURED
from tests.acquire.clock_world import array_text
from tests.acquire.streams import stream
from tests.bus.serial_bench import Bench

WITHIN_S = 1.0


def grids(part: Any, depth: int = 3) -> Iterator[SampleGrid]:
    """The grids of samples of an emulated die, wherever it keeps them."""
    if isinstance(part, SampleGrid):
        yield part
    elif depth:
        inner = part.values() if isinstance(part, dict) else part if isinstance(part, tuple) else ()
        for each in (*inner, *getattr(part, "__dict__", {}).values()):
            yield from grids(each, depth - 1)


def stop(chip: Any) -> None:
    """No more samples, until it is configured again."""
    stopped = list(grids(chip))
    assert stopped
    for grid in stopped:
        grid.start_ns = NEVER_NS


def logged(
    die: str,
    rate_hz: int,
    frames_hz: float,
    stops_s: float | None,
    path: Path,
    accident: Callable[[Any, int], None] = lambda chip, now_ns: stop(chip),
) -> None:
    array = parse_array(array_text(die, rate_hz, on_spi=die == "icm42688"))
    with open_array(array) as bus:
        starts_ns: list[int] = []
        todo = [] if stops_s is None else [stops_s]

        def stopped() -> bool:
            if todo and bus.clock.now_ns() - starts_ns[0] > todo[0] * 1e9:
                todo.clear()
                accident(bus.chips["acc"], bus.clock.now_ns())
            return False

        def begun(*_: Any) -> None:
            starts_ns.append(bus.clock.now_ns())

        record(array, bus, path, rate_hz=frames_hz, seconds=5.0, on_headers=begun, stopped=stopped)
    assert not todo


@pytest.mark.parametrize(
    ("die", "rate_hz", "frames_hz"),
    [
        ("lsm6dso", 104, 20.0),
        pytest.param("icm42688", 1000, 40.0, marks=pytest.mark.slow),
        pytest.param("icm42688", 50, 5.0, marks=pytest.mark.slow),
        pytest.param("mpu6500", 500, 100.0, marks=pytest.mark.slow),
        pytest.param("mpu6050", 500, 40.0, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("stops_s", [2.0, pytest.param(2.13, marks=pytest.mark.slow)])
def test_a_queue_that_stops_is_reported_within_a_second(
    die: str, rate_hz: int, frames_hz: float, stops_s: float, tmp_path: Path
) -> None:
    logged(die, rate_hz, frames_hz, stops_s, tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        frozen = [event for event in log.events if event.kind == "frozen"]
        assert {event.sensor for event in frozen} == {"acc", "gyro"}
        assert "nothing in its queue for 0." in frozen[0].message
        assert stops_s < frozen[0].time_ns * 1e-9 < stops_s + WITHIN_S
        for name in ("acc", "gyro"):  # and it goes on
            assert np.asarray(log[name].time[-1]) > 4.5e9
            assert np.count_nonzero(np.asarray(log[name].status[:]) & RECONFIGURED) == 1


@pytest.mark.slow
def test_the_event_of_a_sleeping_chip_names_its_register(tmp_path: Path) -> None:
    """An MPU-6050 is asleep after power-on, 0x40 in 0x6B (INV-10)."""
    logged("mpu6050", 200, 20.0, 2.0, tmp_path / "run.h5", lambda chip, now_ns: chip.power_on(now_ns))
    with open_log(tmp_path / "run.h5") as log:
        first = min(log.events, key=lambda event: event.time_ns)
        assert first.kind in ("frozen", "configuration")
        assert "register 0x" in first.message
        assert 2.0 < first.time_ns * 1e-9 < 2.0 + WITHIN_S


@pytest.mark.slow
@pytest.mark.parametrize(("die", "rate_hz"), [("icm42688", 1000), ("icm42688", 50)])
def test_a_queue_drained_by_a_microcontroller_that_stops_is_reported(die: str, rate_hz: int, tmp_path: Path) -> None:
    array = parse_array(array_text(die, rate_hz, on_spi=die == "icm42688"))
    bench = Bench(array, "world=shaking&still_s=0.2&motion_s=9", selects=8)
    path = tmp_path / "run.h5"
    stream(bench, array, path, rate_hz=20, seconds=5, at={2.0: lambda: stop(bench.emulated.chips["acc"])})
    with open_log(path) as log:
        frozen = [event for event in log.events if event.kind == "frozen"]
        assert {event.sensor for event in frozen} == {"acc", "gyro"}
        assert 2.0 < frozen[0].time_ns * 1e-9 < 2.0 + WITHIN_S
        for name in ("acc", "gyro"):
            assert np.asarray(log[name].time[-1]) > 4.5e9
            assert not np.asarray(log[name].status[-50:]).any()


@pytest.mark.slow
def test_a_queue_that_always_runs_over_is_not_reported_as_empty(tmp_path: Path) -> None:
    """512 bytes of an MPU-6500 are 36 samples (INV-98), 72 ms at 500 Hz: none can be trusted in frames of 0.2 s."""
    logged("mpu6500", 500, 5.0, None, tmp_path / "run.h5")
    with open_log(tmp_path / "run.h5") as log:
        assert {(event.sensor, event.kind) for event in log.events} == {("acc", "overrun"), ("gyro", "overrun")}
        first = min(log.events, key=lambda event: event.time_ns)
        assert first.message.startswith("its queue runs over between two frames: raise the frame rate")
        assert not (np.asarray(log["acc"].status[:]) & ~np.uint16(OVERRUN)).any()
