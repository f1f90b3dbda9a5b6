"""Every chip gives its rows at any frame rate, from one frame in ten seconds on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire.bus_segment import connect
from imuarray.acquire.recorder import record
from imuarray.acquire.sample_buffer import HELD_S
from imuarray.array import load_array, parse_array
from imuarray.bus import open_bus
from imuarray.drivers import OnDemandDriver
from imuarray.log import open_log
from imuarray.log.health import StartVerdict
from imuarray.log.writer import Block, LogWriter
from tests.acquire.streams import stream
from tests.bus.serial_bench import Bench
from tests.selection import some

SHIPPED = Path(__file__).parents[2] / "configs" / "martin2013.toml"
MS = 1_000_000
RATES_HZ = some([10.0, 0.1, 0.3, 1.0, 2.0, 5.0, 9.0, 11.0, 50.0], 1, 3)
ALONE = {
    "adxl345": "address=0x53\nrange=2\n",
    "bma180": "address=0x40\nrange=2\n",
    "l3g4200d": "address=0x68\nrange=250\n",
    "bmp180": "address=0x77\n",
    "bmp280": "address=0x76\n",
    "bmp388": "address=0x76\n",
    "hmc5883l": "address=0x1E\nrange=1.3\n",
    "lis3mdl": "address=0x1C\nrange=4\n",
    "mmc5983": "address=0x30\nrange=8\n",
    "ak8963": "address=0x0C\nrange=49.12\n",
    "ak8975": "address=0x0C\nrange=12.29\n",
}


def pressure_rows(rate_hz: float, seconds: float, chip_rate_hz: float = 4.0) -> float:
    """A reading takes three frames, one to begin with, and one each for temperature and pressure. At less than 9.5
    frames a second the temperature's result would be older than 0.1 s by then, at less than 7.4 the pressure's too, and
    does not wait for the next frame (BMP-40, BMP-44: 4.5 and 25.5 ms).
    """
    period_ms = 1000 / rate_hz
    frames = 3 if period_ms - 4.5 <= 100 else 2 if period_ms - 30 <= 100 else 1
    return seconds * min(chip_rate_hz, rate_hz / frames)


def forced_rows(rate_hz: float, seconds: float, chip_rate_hz: float = 4.0) -> float:
    """A reading takes two frames, one to begin with; fewer than seven a second fetch it in between (BMP-109)."""
    return seconds * min(chip_rate_hz, rate_hz / (2 if 1000 / rate_hz - 43.2 <= 100 else 1))


ON_DEMAND = {"bmp180": pressure_rows, "bmp280": forced_rows, "bmp388": forced_rows}


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_every_chip_of_the_papers_array_gives_its_rows(tmp_path: Path, rate_hz: float) -> None:
    array = load_array(SHIPPED)
    frames = max(40, round(20 * rate_hz))
    with open_bus("emulated:", array) as bus:
        summary = record(array, bus, tmp_path / "r.h5", rate_hz=rate_hz, seconds=frames / rate_hz)
    assert (summary.frames, summary.missed, summary.late) == (frames, 0, 0)
    assert set(summary.lost.values()) == {0}
    with open_log(tmp_path / "r.h5") as log:
        rows = {name: len(sensor) for name, sensor in log.sensors.items()}
        assert not [event for event in log.events if event.kind != "stale"]
    pressure = rows.pop("BMP180")
    magnetic = {rows.pop("HMC1"), rows.pop("HMC2")}
    assert set(rows.values()) == {frames}
    assert magnetic == {frames} if rate_hz < 15 else {round(frames / 3)}  # 15 Hz (HMC-31): of 50 every third is enough
    assert pressure == pytest.approx(pressure_rows(rate_hz, frames / rate_hz), abs=2)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", some([0.1, 0.3, 1.0, 2.0, 5.0, 9.0, 10.0, 11.0, 50.0], 2, 0))
@pytest.mark.parametrize("chip", some(ALONE, 1))
def test_every_chip_alone_without_a_multiplexer_gives_its_rows(tmp_path: Path, chip: str, rate_hz: float) -> None:
    array = parse_array(f'[array]\nname="a"\n[[sensor]]\nname="S"\nchip="{chip}"\n{ALONE[chip]}')
    frames = max(20, round(20 * rate_hz))
    with open_bus("emulated:?world=shaking&still_s=0.1&motion_s=600", array) as bus:
        summary = record(array, bus, tmp_path / "r.h5", rate_hz=rate_hz, seconds=frames / rate_hz)
    with open_log(tmp_path / "r.h5") as log:
        rows, events = len(log["S"]), list(log.events)
    expected = ON_DEMAND[chip](rate_hz, frames / rate_hz) if chip in ON_DEMAND else float(frames)
    if chip == "hmc5883l" and rate_hz == 50:
        expected = frames / 3
    if chip == "hmc5883l":  # at rest its few codes of noise can be taken for a frozen reading
        assert rows + summary.lost["S"] == pytest.approx(expected, abs=2)
        return
    assert rows == pytest.approx(expected, abs=2 if chip in ON_DEMAND else 0)
    assert summary.lost == {"S": 0}
    assert events == []


@pytest.mark.parametrize("rate_hz", some([0.1, 1.0, 5.0, 10.0, 50.0], 1))
@pytest.mark.parametrize("chip", some(["adxl345", "l3g4200d"], 1))
def test_queues_give_every_sample_or_overrun(tmp_path: Path, chip: str, rate_hz: float) -> None:
    """A queue of 32 gives every sample of 50 Hz from two frames a second; at fewer an overrun is reported."""
    array = parse_array(
        f'[array]\nname="a"\n[[sensor]]\nname="S"\nchip="{chip}"\nrate_hz=100\nfifo=true\n{ALONE[chip]}'
    )
    frames = max(20, round(10 * rate_hz))
    with open_bus("emulated:", array) as bus:
        summary = record(array, bus, tmp_path / "r.h5", rate_hz=rate_hz, seconds=frames / rate_hz)
    with open_log(tmp_path / "r.h5") as log:
        times = log["S"].time[:]
        assert {event.kind for event in log.events} == ({"overrun"} if rate_hz < 4 else set())
    assert (np.diff(times) > 0).all()
    whole = min(100 / rate_hz, 32)
    assert len(times) == pytest.approx((frames - 1) * whole, rel=0.02, abs=12)
    assert summary.lost == {"S": 0}


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", some([0.1, 1.0, 7.0, 9.0, 20.0], 1))
def test_a_pressure_is_read_soon_after_its_conversion(board: Callable[..., Any], rate_hz: float) -> None:
    made = board(A=0, P=1, M=2)
    made.record(rate_hz, seconds=30 / rate_hz)
    begun_ns, ages_ns = 0, []
    for call in made.bus.calls:
        if call.address == 0x77 and call.write == b"\xf4\xf4":
            begun_ns = call.at_ns
        if call.address == 0x77 and call.write == b"\xf4" and call.read == 5:
            ages_ns.append(call.at_ns - begun_ns)
    assert len(ages_ns) >= 9
    assert min(ages_ns) >= 25.5 * MS  # BMP-44
    assert max(ages_ns) <= (25.5 + 100) * MS
    with made.log() as log:
        assert len(log["P"]) == len(ages_ns)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", some([0.1, 0.5, 1.0, 50.0], 1))
def test_no_row_waits_longer_than_the_limit(
    board: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, rate_hz: float
) -> None:
    """The limit of the rows that a killed recording loses, and of the wait of a service's watchdog."""
    waits_s: list[float] = []
    made, append = board(A=0, G=0, P=1), LogWriter.append
    begun_ns = made.bus.clock.now_ns()

    def timed(writer: LogWriter, sensor: str, block: Block) -> None:
        waits_s.append((made.bus.clock.now_ns() - begun_ns - int(block.time[0])) * 1e-9)
        append(writer, sensor, block)

    monkeypatch.setattr(LogWriter, "append", timed)
    summary = made.record(rate_hz, seconds=max(60 / rate_hz, 60), batch_s=1.0)
    assert HELD_S == 10.0
    assert len(waits_s) > 30
    assert max(waits_s) <= HELD_S + 2 / rate_hz + 1.5
    assert set(summary.lost.values()) == {0}


@pytest.mark.slow
def test_a_frozen_chip_is_reported_at_one_frame_in_five_seconds(board: Callable[..., Any]) -> None:
    """24 readings of one frame in five seconds take two minutes, and rows are written meanwhile."""
    made = board("world=shaking&still_s=0.1&motion_s=900", A=0, G=0)
    bus, kept = made.bus, []
    transfer = bus.transfer

    def frozen(address: int, write: bytes = b"", read: int = 0) -> bytes:
        answer = transfer(address, write, read)
        if address == 0x68 and read == 8 and bus.clock.now_ns() > 100_000 * MS:
            kept.append(answer)
            return bytes(kept[0])
        return bytes(answer)

    bus.transfer = frozen
    made.record(0.2, seconds=300)
    with made.log() as log:
        event, end = [event for event in log.events if event.kind == "frozen"]
        status = np.asarray(log["G"].status[:])
    assert event.sensor == "G"
    assert event.message == "the same reading for 115.00 s"  # from the first to the twenty-fourth
    assert "when the log ended" in end.message
    first = np.flatnonzero(status & 32)[0]
    assert first <= 20 + 24  # flagged from the rows that waited on


@pytest.mark.parametrize("chip", ON_DEMAND)
def test_a_conversion_requested_at_a_low_rate_is_read(chip: str) -> None:
    """Also by a program of its own that calls the driver five times a second, or once in ten seconds."""
    array = parse_array(f'[array]\nname="a"\n[[sensor]]\nname="S"\nchip="{chip}"\n{ALONE[chip]}')
    for pause_s in (0.15, 0.2, 10.0):
        with open_bus("emulated:", array) as bus:
            (route,) = connect(array, bus)
            bursts = 0
            for _ in range(30):
                bursts += bool(route.driver.fetch())
                bus.clock.sleep_until(bus.clock.now_ns() + round(pause_s * 1e9))
            assert bursts >= 8


@pytest.mark.parametrize("chip", ON_DEMAND)
def test_a_conversion_from_before_a_pause_of_the_program_is_discarded(chip: str) -> None:
    array = parse_array(f'[array]\nname="a"\n[[sensor]]\nname="S"\nchip="{chip}"\n{ALONE[chip]}')
    with open_bus("emulated:", array) as bus:
        (route,) = connect(array, bus)
        for _ in range(20):  # until a pressure is being converted
            route.driver.fetch()
            bus.clock.sleep_until(bus.clock.now_ns() + 6 * MS)
            if isinstance(route.driver, OnDemandDriver) and (route.driver.ready_ns or 0) > bus.clock.now_ns():
                break
        bus.clock.sleep_until(bus.clock.now_ns() + 60_000 * MS)
        assert route.driver.fetch() == b""


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_every_chip_behind_a_microcontroller_gives_its_rows(tmp_path: Path, rate_hz: float) -> None:
    array = load_array(SHIPPED)
    bench = Bench(array)
    frames = max(12, round(4 * rate_hz))
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=rate_hz, seconds=frames / rate_hz)
    assert summary.frames == frames
    assert set(summary.lost.values()) == {0}
    with open_log(tmp_path / "r.h5") as log:
        assert not [event for event in log.events if event.kind != "stale"]
        rows = {name: len(sensor) for name, sensor in log.sensors.items()}
        times = {name: sensor.time[:] + start_ns for name, sensor in log.sensors.items()}
    magnetic = {rows.pop("HMC1"), rows.pop("HMC2")}
    pressure = rows.pop("BMP180")
    assert set(rows.values()) == {frames}
    assert magnetic == {frames} if rate_hz < 15 else {round(frames / 3)}
    # Three periods of at most 0.1 s make a reading, four readings a second and one a frame are enough.
    assert pressure >= (frames - 1) / rate_hz / max(1 / rate_hz, 0.35) - 1
    np.testing.assert_allclose(np.diff(times["BMA1"]), 1e9 / rate_hz, rtol=1e-3)
    ages_ns, begun_ns = [], 0
    for tap in bench.taps:
        if tap.address == 0x77 and tap.write == b"\xf4\xf4":
            begun_ns = tap.at_ns
        if tap.address == 0x77 and tap.write == b"\xf4" and len(tap.answer or b"") == 5:
            ages_ns.append(tap.at_ns - begun_ns)
    assert len(ages_ns) >= pressure
    assert min(ages_ns) >= 25.5 * MS  # BMP-44
    assert max(ages_ns) <= 130 * MS


@pytest.mark.slow
def test_a_microcontroller_at_one_frame_in_ten_seconds_is_not_reported_lost(
    an_array: Callable[..., Any], tmp_path: Path
) -> None:
    """One frame in ten seconds is no silence, and a reset at that rate is still reported."""
    array = an_array(A=0)
    bench = Bench(array)

    def reset() -> None:
        bench.firmware.__init__(bench, bench.clock)  # type: ignore[misc]

    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=0.1, seconds=300, at={150.0: reset})
    with open_log(tmp_path / "r.h5") as log:
        events = [(event.kind, event.message) for event in log.events if event.sensor == ""]
        rows = len(log["A"])
    assert events == [("link", "the microcontroller is lost: it sends nothing")]
    assert summary.frames == 30
    assert rows + summary.lost["A"] == pytest.approx(30, abs=1)
    assert summary.lost["A"] <= 4


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [0.1, 1.0, 5.0])
def test_a_chip_that_is_set_up_again_loses_three_readings_at_most(board: Callable[..., Any], rate_hz: float) -> None:
    """A chip that lost its settings: a frame to see it twice, one to begin, and the next reading is good."""
    made = board("world=shaking&still_s=0.1&motion_s=900", A=0, G=0)
    bus, begun = made.bus.bus, list[int]()

    def stopped() -> bool:
        begun.append(bus.clock.now_ns())
        if sum(at >= begun[0] + 40e9 / rate_hz for at in begun) == 1:
            bus.transfer(0x70, b"\x04")
            bus.transfer(0x68, b"\x20\x07")  # the data rate of its reset state (L3G-20)
        return False

    summary = made.record(rate_hz, seconds=100 / rate_hz, stopped=stopped)
    _, _, status = made.rows("G")
    assert summary.lost["A"] == 0
    assert 1 <= summary.lost["G"] <= 3
    (again,) = np.flatnonzero(status & 16)
    assert not (status[again:] & 32).any()


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "judged"), some([(0.2, False), (0.8, False), (1.0, True), (50.0, True)], 1))
def test_a_start_is_judged_by_at_least_ten_readings(
    an_array: Callable[..., Any], tmp_path: Path, rate_hz: float, judged: bool
) -> None:
    """The readings of the first ten seconds; two readings are as far from the mean as another state is."""
    array = an_array(A=0, G=0)
    numbers: list[int] = []

    def judge(readings: Mapping[str, Any]) -> dict[str, StartVerdict]:
        numbers.extend(len(counts) for counts in readings.values())
        return {name: StartVerdict(True, "came up wrong") for name in readings}

    with open_bus("emulated:", array) as bus:
        record(array, bus, tmp_path / "r.h5", rate_hz=rate_hz, seconds=30, judge=judge)
    with open_log(tmp_path / "r.h5") as log:
        messages = {event.message for event in log.events if event.kind == "start_up"}
        suspect = bool((np.asarray(log["G"].status[:]) & 32).any())
    assert suspect is bool(numbers) is judged
    assert all(count >= 10 for count in numbers)
    assert judged or all(message.endswith(" readings of at least 10") for message in messages)
