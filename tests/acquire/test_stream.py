"""An array that a microcontroller streams: the log equals the bytes on its wire, for any failure of the line.

Expected values are decoded here from the bytes on the emulated wire, as in the data sheets (ADX-45, BMA-60, L3G-60,
HMC-31, BMP-47), and timed by the emulated clock.
"""

from __future__ import annotations

import errno
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_emulator import serial_firmware
from imuarray.acquire import connect
from imuarray.acquire.stream import streams
from imuarray.acquire.stream_plan import plan
from imuarray.array import ArrayConfig, load_array, parse_array
from imuarray.bus.serial_bus import SerialBus
from imuarray.errors import BusUrlError
from imuarray.log import open_log
from imuarray.log.health import StartVerdict
from tests.acquire.streams import LOST, OVERRUN, RECONFIGURED, SUSPECT, S, events, logged, on_the_wire, stream
from tests.bus.serial_bench import Bench
from tests.firmware.kinds import both_kinds
from tests.selection import some

SHIPPED = Path(__file__).parents[2] / "configs" / "martin2013.toml"


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
def test_the_log_of_the_papers_array_equals_the_bytes_on_the_wire(tmp_path: Path) -> None:
    array = load_array(SHIPPED)
    bench = Bench(array, "world=shaking&still_s=0.5&motion_s=5", drift=2e-3, counter_us=(1 << 32) - 4_000_000)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=200, seconds=4)
    assert (summary.frames, set(summary.lost.values())) == (800, {0})
    for sensor in array.sensors:
        if sensor.chip == "bmp180":
            continue
        time, counts, status = logged(tmp_path / "r.h5", sensor.name)
        wire_time, wire_counts = on_the_wire(bench, array, sensor.name)
        np.testing.assert_array_equal(counts, wire_counts[: len(counts)])
        assert len(wire_counts) - len(counts) <= 5  # frames that began before the microcontroller received STOP
        assert np.abs(time + start_ns - wire_time[: len(time)]).max() < 20_000
        assert not (status & (LOST | SUSPECT | RECONFIGURED | OVERRUN)).any()
    assert len(logged(tmp_path / "r.h5", "Gyro3")[0]) == 800
    assert len(logged(tmp_path / "r.h5", "HMC1")[0]) == pytest.approx(4 * 200 / 12, abs=1)  # 15 Hz, and not missed
    assert events(tmp_path / "r.h5") == []


@pytest.mark.slow
def test_the_barometer_is_read_after_its_conversions(tmp_path: Path) -> None:
    array = load_array(SHIPPED).only(("BMP180", "ADXL1"))
    bench = Bench(array, "world=heating&scale=0.01")
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=150, seconds=3)
    time, counts, status = logged(tmp_path / "r.h5", "BMP180")
    asked = [tap for tap in bench.taps if tap.address == 0x77 and tap.at_ns >= start_ns]
    temperatures = [tap for tap in asked if tap.write == b"\xf4" and len(tap.answer or b"") == 4]
    pressures = [tap for tap in asked if tap.write == b"\xf4" and len(tap.answer or b"") == 5]
    assert len(counts) == 12  # four a second
    for row, (warm, high) in enumerate(zip(temperatures, pressures, strict=False)):
        if row < len(counts):
            assert warm.answer is not None and high.answer is not None
            assert warm.answer[0] & 0x20 == high.answer[0] & 0x20 == 0  # the conversion was over (BMP-46)
            assert counts[row].tolist() == [
                int.from_bytes(warm.answer[2:], "big"),
                int.from_bytes(high.answer[2:], "big") >> 5,
            ]
            assert abs(time[row] + start_ns - high.at_ns) < 20_000
    assert not status.any()
    assert summary.lost == {"BMP180": 0, "ADXL1": 0}


@pytest.mark.parametrize("seed", some(range(5), 1))
def test_a_bad_line_loses_readings_and_never_invents_any(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, seed: int
) -> None:
    array = an_array(A=0, G=1, B=None)
    bench = Bench(array, "world=shaking&still_s=0.2&motion_s=5", drift=-1e-3)
    draw = np.random.default_rng(seed)

    def spoiled(piece: bytes) -> bytes:
        if piece[4] != 0xD0 or draw.random() > 0.1:
            return piece
        at = int(draw.integers(len(piece)))
        return [
            b"",
            piece[:at],
            bytes(draw.bytes(30)) + piece,
            piece[:at] + bytes([piece[at] ^ 1 << int(draw.integers(8))]) + piece[at + 1 :],
            b"\xa5\x5a\xff\x00" + piece,
        ][int(draw.integers(5))]

    bench.delivered = spoiled
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", seconds=3)
    assert all(5 < lost < 60 for lost in summary.lost.values())
    for name in "AGB":
        time, counts, status = logged(tmp_path / "r.h5", name)
        wire_time, wire_counts = on_the_wire(bench, array, name)
        nearest = np.abs(time[:, None] + start_ns - wire_time[None, :]).argmin(axis=1)
        assert np.abs(time + start_ns - wire_time[nearest]).max() < 200_000
        np.testing.assert_array_equal(counts, wire_counts[nearest])
        np.testing.assert_array_equal((status & LOST) != 0, np.diff(nearest, prepend=-1) > 1)
        assert len(time) + summary.lost[name] == 300
    assert {kind for _, kind, _ in events(tmp_path / "r.h5")} == {"lost"}


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
def test_a_sensor_that_is_unplugged_for_a_while_is_logged_again(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0, G=0)
    bench = Bench(array)

    def unplug(gone: bool) -> None:
        bench.fails = lambda address, write: gone and address == 0x68

    summary, _ = stream(bench, array, tmp_path / "r.h5", at={1.0: lambda: unplug(True), 1.5: lambda: unplug(False)})
    assert 45 <= summary.lost["G"] <= 56
    assert summary.lost["A"] == 0
    assert len(logged(tmp_path / "r.h5", "A")[0]) == 300
    time, _, status = logged(tmp_path / "r.h5", "G")
    gap = int(np.diff(time).argmax())
    assert np.flatnonzero(status & LOST).tolist() == [gap + 1]
    assert np.diff(time).max() / S == pytest.approx(0.5, abs=0.06)
    ours = [(kind, text) for sensor, kind, text in events(tmp_path / "r.h5") if sensor == "G"]
    assert ours[0] == ("lost", "no reading: no acknowledgement (errno 121)")


@pytest.mark.slow
def test_a_lost_channel_discards_its_readings_and_is_reported(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A0=0, A1=1)
    bench = Bench(array)
    fail = iter([False] * 400 + [True] * 6 + [False] * 100_000)
    bench.fails = lambda address, write: address == 0x70 and write == b"\x05" and next(fail)
    summary, _ = stream(bench, array, tmp_path / "r.h5", seconds=6)
    for name in ("A0", "A1"):
        _, counts, _ = logged(tmp_path / "r.h5", name)
        wire_counts = on_the_wire(bench, array, name)[1]
        assert {tuple(row) for row in counts} <= {tuple(row) for row in wire_counts}
    assert 0 < summary.lost["A1"] <= 6
    assert summary.lost["A0"] == 0


@pytest.mark.slow
def test_a_chip_that_lost_its_settings_is_flagged_and_set_up_again(
    tmp_path: Path,
) -> None:
    array = load_array(SHIPPED).only(("ADXL1", "BMA3"))
    bench = Bench(array)

    def reset() -> None:  # as a glitch on the supply would: its soft reset (BMA-53)
        bench.emulated.transfer(0x70, b"\x05")
        bench.emulated.transfer(0x40, b"\x10\xb6")

    reset_s = 2.0
    summary, _ = stream(bench, array, tmp_path / "r.h5", seconds=6, at={reset_s: reset})
    time, _, status = logged(tmp_path / "r.h5", "BMA3")
    suspect = np.flatnonzero(status & SUSPECT)
    (again,) = np.flatnonzero(status & RECONFIGURED)
    assert time[suspect[0]] <= (reset_s + 0.05) * S  # from the last good check on
    assert time[again] <= (reset_s + 1.5) * S
    assert suspect[-1] == again - 1
    np.testing.assert_array_equal(suspect, np.arange(suspect[0], again))
    assert not (status[again:] & SUSPECT).any()
    reports = [(kind, text) for sensor, kind, text in events(tmp_path / "r.h5") if sensor == "BMA3"]
    assert reports[0][0] == "configuration"
    assert ("reconfigured", "set up again") in reports
    other, _, other_status = logged(tmp_path / "r.h5", "ADXL1")
    assert not (other_status & SUSPECT).any()
    assert np.diff(other).max() < 0.3 * S  # while the other was set up
    assert len(other) + summary.lost["ADXL1"] == summary.frames == 600


@pytest.mark.slow
def test_a_reset_is_reported_within_a_second(tmp_path: Path) -> None:
    array = load_array(SHIPPED)
    bench = Bench(array)
    reset_ns: list[int] = []

    def reset() -> None:
        bench.emulated.transfer(0x70, b"\x04")
        bench.emulated.transfer(0x41, b"\x10\xb6")
        reset_ns.append(bench.now_ns())

    _, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=48, seconds=4, at={2.0: reset})
    with open_log(tmp_path / "r.h5") as log:
        (event,) = [event for event in log.events if event.kind == "configuration"]
    assert event.sensor == "BMA2"
    assert event.time_ns + start_ns - reset_ns[0] < 1.0 * S


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
def test_the_stream_restarts_after_a_reset_of_the_microcontroller(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0, G=0)
    bench = Bench(array, counter_us=2_000_000_000)

    def reset() -> None:
        bench.firmware.__init__(bench, bench.clock)  # type: ignore[misc]  # it restarts and counts from 0

    summary, start_ns = stream(bench, array, tmp_path / "r.h5", seconds=8, at={2.0: reset})
    time, counts, status = logged(tmp_path / "r.h5", "G")
    wire_time, wire_counts = on_the_wire(bench, array, "G")
    nearest = np.abs(time[:, None] + start_ns - wire_time[None, :]).argmin(axis=1)
    assert np.abs(time + start_ns - wire_time[nearest]).max() < 200_000
    np.testing.assert_array_equal(counts, wire_counts[nearest])
    (again,) = np.flatnonzero(status & RECONFIGURED)
    assert status[again] & LOST
    assert 2 * S < np.diff(time).max() < 4 * S
    assert not (status[again:] & SUSPECT).any()
    assert ("", "link", "the microcontroller is lost: it sends nothing") in events(tmp_path / "r.h5")
    assert summary.frames == 800
    assert len(time) + summary.lost["G"] == pytest.approx(800, abs=2)


@both_kinds(pytest.mark.slow)
def test_the_stream_restarts_after_the_port_is_unplugged_and_plugged_in(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0)
    bench = Bench(array)

    def put_back() -> None:
        bench.unplugged = False

    summary, _ = stream(bench, array, tmp_path / "r.h5", seconds=8, at={2.0: bench.unplug, 3.5: put_back})
    time, _, status = logged(tmp_path / "r.h5", "A")
    assert status[int(np.diff(time).argmax()) + 1] & (LOST | RECONFIGURED) == LOST | RECONFIGURED
    assert len([text for _, kind, text in events(tmp_path / "r.h5") if kind == "link"]) <= 2
    assert 1.4 * S < np.diff(time).max() < 3 * S
    assert summary.frames == 800


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
def test_a_recording_ends_also_when_the_port_stays_unplugged(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0)
    bench = Bench(array)
    summary, _ = stream(bench, array, tmp_path / "r.h5", seconds=4, at={2.0: bench.unplug})
    time, _, status = logged(tmp_path / "r.h5", "A")
    assert len(time) + summary.lost["A"] == summary.frames == 400
    assert 195 <= len(time) <= 205
    assert status[-1] & SUSPECT  # the last rows have no later check
    assert not status[0] & SUSPECT
    with open_log(tmp_path / "r.h5") as log:
        noted_s = [event.time_ns / S for event in log.events if event.kind == "link"]
    assert noted_s[0] == pytest.approx(2.0, abs=0.1)  # counted from the epoch of the log, as rows are


@pytest.mark.slow
def test_unplugging_after_the_last_frame_loses_nothing(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stream can't be stopped any more, but all 400 frames were received."""

    def stop(bus: SerialBus) -> None:
        raise OSError(errno.EIO, "the port is gone")

    monkeypatch.setattr(SerialBus, "stop", stop)
    array = an_array(A=0)
    summary, _ = stream(Bench(array), array, tmp_path / "r.h5", seconds=4)
    assert (summary.frames, summary.lost["A"]) == (400, 0)
    assert len(logged(tmp_path / "r.h5", "A")[0]) == 400


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
def test_readings_missed_until_a_stop_while_unplugged_are_counted(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0)
    bench = Bench(array)
    summary, _ = stream(
        bench, array, tmp_path / "r.h5", seconds=None, at={2.0: bench.unplug, 7.0: lambda: StopIteration}
    )
    assert len(logged(tmp_path / "r.h5", "A")[0]) + summary.lost["A"] == summary.frames
    assert summary.frames == pytest.approx(700, abs=40)  # a stop is checked at intervals


@pytest.mark.slow
def test_readings_missed_until_a_stop_shortly_after_unplugging_are_counted(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    """The silence is shorter than a pause of the microcontroller, but the port is unplugged."""
    array = an_array(A=0)
    bench = Bench(array)
    summary, _ = stream(
        bench, array, tmp_path / "r.h5", seconds=None, at={1.7: bench.unplug, 2.0: lambda: StopIteration}
    )
    rows = len(logged(tmp_path / "r.h5", "A")[0])
    assert rows == pytest.approx(170, abs=6)
    assert summary.lost["A"] == pytest.approx(30, abs=10)
    assert rows + summary.lost["A"] == summary.frames


@pytest.mark.slow
def test_a_stream_without_a_duration_runs_until_the_stop(an_array: Callable[..., ArrayConfig], tmp_path: Path) -> None:
    array = an_array(A=0)
    summary, _ = stream(Bench(array), array, tmp_path / "r.h5", seconds=None, at={1.0: lambda: StopIteration})
    assert summary.frames == pytest.approx(100, abs=6)
    assert len(logged(tmp_path / "r.h5", "A")[0]) == summary.frames


@pytest.mark.slow
def test_rows_are_suspect_where_registers_cannot_be_read_back(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0, G=0)
    bench = Bench(array)

    def deaf() -> None:
        bench.fails = lambda address, write: address == 0x53 and write != b"\x30"

    stream(bench, array, tmp_path / "r.h5", rate_hz=50, seconds=30, at={5.0: deaf})
    time, _, status = logged(tmp_path / "r.h5", "A")
    assert len(time) == 1500  # written all the same, and suspect
    suspect = time[(status & SUSPECT) != 0]
    assert suspect[0] == pytest.approx(5.0 * S, abs=0.9 * S)
    assert len(suspect) == (time >= suspect[0]).sum()
    assert not (logged(tmp_path / "r.h5", "G")[2] & SUSPECT).any()


@pytest.mark.slow
def test_a_frozen_chip_is_flagged_and_set_up_again(an_array: Callable[..., ArrayConfig], tmp_path: Path) -> None:
    array = an_array(A=0, G=0)
    bench = Bench(array)
    kept: list[bytes] = []

    def freeze() -> None:
        def answered(address: int, write: bytes, answer: bytes) -> bytes:
            if address != 0x68 or write != b"\xa6":
                kept.clear() if write == b"\x20\xdf" else None
                return answer
            kept.append(answer)
            return kept[0]

        bench.answered = answered

    def note_frozen() -> None:
        bench.answered = lambda address, write, answer: answer

    stream(bench, array, tmp_path / "r.h5", seconds=10, at={3.0: freeze, 6.0: note_frozen})
    time, counts, status = logged(tmp_path / "r.h5", "G")
    same = np.flatnonzero((counts[1:] == counts[:-1]).all(axis=1)) + 1
    assert len(same) > 100
    assert (status[same[2] : same[-1] + 1] & SUSPECT).mean() > 0.9
    assert ("G", "frozen") in {(sensor, kind) for sensor, kind, _ in events(tmp_path / "r.h5")}
    assert not (status[time > 9 * S] & SUSPECT).any()


@pytest.mark.slow
def test_a_sensor_in_another_start_up_state_is_set_up_again(
    an_array: Callable[..., ArrayConfig], tmp_path: Path
) -> None:
    array = an_array(A=0, G=0)
    asked: list[int] = []

    def judge(readings: Mapping[str, Any]) -> dict[str, StartVerdict]:
        asked.extend(len(counts) for name, counts in readings.items() if name == "G")
        return {"G": StartVerdict(len(asked) == 1, "came up in another state" if len(asked) == 1 else "")}

    stream(Bench(array), array, tmp_path / "r.h5", rate_hz=50, seconds=25, judge=judge)
    _, _, status = logged(tmp_path / "r.h5", "G")
    (again,) = np.flatnonzero(status & RECONFIGURED)
    assert 500 <= again <= 560  # after the first ten seconds
    assert (status[:again] & SUSPECT).all()
    assert not (status[again:] & SUSPECT).any()
    assert ("G", "start_up", "came up in another state") in events(tmp_path / "r.h5")
    assert len(asked) == 2


def test_a_queue_is_not_streamed(an_array: Callable[..., ArrayConfig]) -> None:
    text = '[array]\nname="a"\n[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=2\nfifo=true\n'
    array = parse_array(text)
    with Bench(array).bus() as bus:
        routes = connect(array, bus)
        assert not streams(bus, routes)
        with pytest.raises(ValueError, match="sensor A: a queue is drained by its driver"):
            plan(routes, 50)


def test_more_lists_than_the_firmware_has_room_for_are_refused(
    an_array: Callable[..., ArrayConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_firmware, "LISTS", 3)
    array = an_array(A=0, G=1)
    with pytest.raises(BusUrlError, match=r"the stream can't be started: \d+ lists .* has room for 3 with 1536"):
        stream(Bench(array), array, tmp_path / "r.h5")
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.campaign
def test_times_continue_when_both_counters_wrap(an_array: Callable[..., ArrayConfig], tmp_path: Path) -> None:
    array = an_array(A=0)
    bench = Bench(array, drift=5e-4)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=25, seconds=4500)  # 2^32 us are 4295 s
    assert (summary.frames, summary.lost) == (112_500, {"A": 0})
    time, counts, status = logged(tmp_path / "r.h5", "A")
    wire_time, wire_counts = on_the_wire(bench, array, "A")
    np.testing.assert_array_equal(counts, wire_counts[: len(counts)])
    assert np.abs(time + start_ns - wire_time[: len(time)]).max() < 20_000
    assert not (status & (LOST | SUSPECT)).any()


class TestPlan:
    def the(self, rate_hz: float) -> tuple[Any, SerialBus, ArrayConfig]:
        array = load_array(SHIPPED)
        bus = Bench(array).bus()
        return plan(connect(array, bus), rate_hz), bus, array

    @pytest.mark.parametrize("rate_hz", some([1.0, 48.0, 100.0, 200.0, 400.0], 2))
    def test_the_plan_fits_into_the_papers_microcontroller(self, rate_hz: float) -> None:
        result, bus, _ = self.the(rate_hz)
        bus.start(result.lists, round(1e6 / rate_hz))

    def test_one_list_holds_all_requests_of_every_frame(self) -> None:
        result, _, _ = self.the(50.0)
        assert [len(result.lists[0].requests), result.lists[0].every] == [9 + 2, 1]
        # list number, ages, 4 BMA180 of 7 bytes, 2 ADXL345 and 3 L3G4200D of 8
        assert result.lists[0].size == 1 + 2 * 11 + 4 * 7 + 5 * 8

    def test_every_register_is_read_twice_within_a_second(self) -> None:
        result, _, _ = self.the(48.0)
        places = [watched.place for watched in result.watched]
        assert all(2 * place.every / 48.0 < 1 for place in places)
        per_frame = [sum(frame % place.every == place.offset for place in places) for frame in range(places[0].every)]
        assert max(per_frame) - min(per_frame) <= 1

    @pytest.mark.slow
    @pytest.mark.parametrize("rate_hz", [5.0, 20.0, 48.0, 150.0, 400.0])
    def test_read_backs_are_spread_evenly_over_the_frames_of_a_sweep(self, rate_hz: float) -> None:
        """With more frames than registers they are equally far apart, with fewer they share frames in equal numbers."""
        result, _, _ = self.the(rate_hz)
        places = [watched.place for watched in result.watched]
        (every,) = {place.every for place in places}
        shared = Counter(place.offset for place in places)
        assert len(shared) == min(every, len(places), 64)
        assert max(shared.values()) - min(shared.values()) <= 1
        taken = sorted(shared)
        apart = np.diff([*taken, taken[0] + every])
        assert 0 <= taken[0] <= taken[-1] < every
        assert apart.max() - apart.min() <= 1

    def test_readings_wait_for_their_conversions(self) -> None:
        for rate_hz in (0.1, 1.0, 9.0, 30.0, 100.0, 200.0, 1000.0):
            result, _, array = self.the(rate_hz)
            start, temperature, pressure = result.visits[[sensor.name for sensor in array.sensors].index("BMP180")]
            period_s = 1 / (rate_hz * result.split)
            assert 4.5e-3 < (temperature.offset - start.offset) * period_s <= 0.1 + 4.5e-3  # BMP-40, and not old
            assert 25.5e-3 < (pressure.offset - temperature.offset) * period_s <= 0.1 + 25.5e-3  # BMP-44
            assert pressure.offset < start.every
            assert start.every * period_s <= max(1 / rate_hz, 1 / 4, 3 * period_s) + period_s
