"""Queues of ICM-42688-P that a microcontroller drains by itself: each row is a packet that went over its wires, at the
time that the chip stamped on it, and missing packets are flagged and counted, for any failure of the line.

Packets are decoded here as TDK-81 ... TDK-85 say: flags, count, then 16 bytes each with a time stamp in microseconds of
the chip's own clock, which in these tests is off by up to one percent.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire.bus_segment import routes_of
from imuarray.acquire.recording import RecordingCounts
from imuarray.acquire.stream_plan import plan
from imuarray.array import ArrayConfig, parse_array
from imuarray.log import open_log
from tests.acquire.streams import (
    LOST,
    MS,
    OVERRUN,
    RECONFIGURED,
    SUSPECT,
    BadLine,
    S,
    events,
    logged,
    on_the_wire,
    stream,
)
from tests.bus.serial_bench import Bench
from tests.firmware.kinds import both_kinds
from tests.selection import some

BURST = b"\xad"  # register 2D, flags, with the bit that reads (TDK-70); count and packets follow
PACKET = 16
LONGEST_US = 130_000
"""No packet of 1 kHz is older: there are 128 of 16 bytes in 2048 (TDK-80)."""
WORLD = "world=shaking&still_s=0.2&motion_s=9"
ERRORS = (0.01, -0.0043)


def array_of(
    chips: int,
    *,
    rate_hz: int = 1000,
    halves: tuple[str, ...] = ("acc", "gyro"),
    ranges: tuple[int, int] = (16, 2000),
    sensor: str = "",
) -> ArrayConfig:
    text = '[array]\nname="s"\n'
    for chip in range(chips):
        for half in halves:
            text += f'[[sensor]]\nname="I{chip}_{half}"\nchip="icm42688"\nbus="/dev/spidev0.{chip}"\n'
            text += f"range={ranges[half == 'gyro']}\nrate_hz={rate_hz}\nfifo=true\n"
    return parse_array(text + sensor)


def bench_of(array: ArrayConfig, **firmware: Any) -> Bench:
    """The array, whose chips' oscillators are off by `ERRORS`."""
    bench = Bench(array, WORLD, selects=8, **firmware)
    for name, chip in bench.emulated.chips.items():
        if name.startswith("I"):
            chip._oscillator = 1 + ERRORS[int(name[1]) % 2]  # type: ignore[attr-defined]
    return bench


def packets(bench: Bench, chip: int, size: int = PACKET) -> tuple[np.ndarray, np.ndarray]:
    """When each packet of a chip was taken (ns), by its stamp, and its bytes (n, size), of all that were read."""
    times: list[int] = []
    rows = []
    oscillator = 1 + ERRORS[chip % 2]
    for tap in bench.taps:
        if (tap.address, tap.write) == (0x80 + chip, BURST) and tap.answer:
            for begin in range(3, len(tap.answer), size):
                packet = tap.answer[begin : begin + size]
                if packet[0] & 0x80:  # empty from here on
                    break
                stamp_us = int.from_bytes(packet[14:16], "big")
                now_us = int(tap.at_ns * 1e-3 * oscillator)
                times.append(
                    times[-1] + (stamp_us - times[-1]) % 65536 if times else now_us - (now_us - stamp_us) % 65536
                )
                while now_us - times[-1] > LONGEST_US:
                    times[-1] += 65536
                rows.append(packet)
    return np.array(times) / oscillator * 1e3, np.frombuffer(b"".join(rows), np.uint8).reshape(-1, size)


def check(
    bench: Bench, array: ArrayConfig, path: Path, start_ns: int, summary: RecordingCounts, settled_s: float = 1.5
) -> None:
    """Each row is a packet of the wire at its true time, in order, once; gaps are flagged, and the sum is right."""
    for sensor in array.sensors:
        if not sensor.fifo:
            continue
        chip, half = int(sensor.name[1]), sensor.name[3:]
        time, counts, status = logged(path, sensor.name)
        true_ns, rows = packets(bench, chip)
        first = 1 if half == "acc" else 7
        wire = np.ascontiguousarray(rows[:, first : first + 6]).view(">i2").astype(np.int16)
        period_ns = 1e9 / sensor.chip_rate_hz / (1 + ERRORS[chip % 2])
        places: dict[tuple[int, ...], list[int]] = {}
        for place, values in enumerate(map(tuple, wire.tolist())):
            places.setdefault(values, []).append(place)
        which = np.array(
            [
                min(places[tuple(values)], key=lambda place: abs(true_ns[place] - start_ns - at_ns))
                for at_ns, values in zip(time.tolist(), counts.tolist(), strict=True)
            ]
        )
        assert (np.diff(which) > 0).all()
        is_after_gap = np.diff(true_ns[which]) > 1.5 * period_ns
        flagged = (status & (LOST | OVERRUN)) != 0
        np.testing.assert_array_equal(flagged[1:], is_after_gap)
        assert not (status & SUSPECT).any()
        off_ns = time + start_ns - true_ns[which]
        assert np.abs(off_ns).max() < 1.3 * period_ns
        settled = time > settled_s * S
        since_gap = np.arange(len(time)) - np.maximum.accumulate(np.where(flagged, np.arange(len(time)), 0))
        settled &= (since_gap > 0.5 * sensor.chip_rate_hz) | (np.maximum.accumulate(flagged) == 0)
        assert np.sqrt(np.mean(off_ns[settled] ** 2)) < 50e3
        with open_log(path) as log:
            stated_ns = np.asarray(log[sensor.name].time_uncertainty[:], float) * 1e9
        assert (np.abs(off_ns) <= stated_ns).all()  # the host keeps the time of the wires here: no error of a link
        spanned = round((true_ns[which[-1]] - true_ns[which[0]]) / period_ns) + 1
        missing = round(np.sum(np.rint(np.diff(true_ns[which]) / period_ns) - 1))
        assert len(time) + missing == spanned
        assert summary.lost[sensor.name] == pytest.approx(missing, abs=1 + int(is_after_gap.sum()))


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize(
    ("frames_hz", "drift"), some([(20, -1e-3), (10, 0.0), (50, 2e-4), (1000, -2e-4), (33, 1e-3)], 1, 1)
)
def test_each_row_is_a_packet_at_the_time_of_its_stamp(frames_hz: float, drift: float, tmp_path: Path) -> None:
    array = array_of(2)
    bench = bench_of(array, drift=drift, counter_us=(1 << 32) - 1_500_000)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=frames_hz, seconds=3)
    assert set(summary.lost.values()) == {0}
    assert events(tmp_path / "r.h5") == []
    check(bench, array, tmp_path / "r.h5", start_ns, summary)
    for sensor in array.sensors:
        time, _, status = logged(tmp_path / "r.h5", sensor.name)
        assert len(time) > 3 * 1000 * (1 + ERRORS[int(sensor.name[1])]) - 120
        assert not status.any()


@pytest.mark.campaign
def test_eight_chips_at_1_khz_are_streamed(tmp_path: Path) -> None:
    array = array_of(8)
    bench = bench_of(array)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=2)
    assert set(summary.lost.values()) == {0}
    check(bench, array, tmp_path / "r.h5", start_ns, summary)


@pytest.mark.slow
@pytest.mark.parametrize("half", ["gyro", "acc"])
def test_one_half_alone_is_streamed_in_packets_without_stamps(half: str, tmp_path: Path) -> None:
    array = array_of(1, halves=(half,))
    bench = bench_of(array)
    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=2)
    time, counts, status = logged(tmp_path / "r.h5", f"I0_{half}")
    assert not (status & (LOST | OVERRUN | SUSPECT)).any()
    answers = [tap.answer or b"" for tap in bench.taps if tap.write == BURST]
    rows = [answer[at : at + 8] for answer in answers for at in range(3, len(answer), 8)]
    wire = [np.frombuffer(row[1:7], ">i2").tolist() for row in rows if not row[0] & 0x80]
    begin = wire.index(counts[0].tolist())
    assert counts.tolist() == wire[begin : begin + len(counts)]
    assert set(summary.lost.values()) == {0}
    assert not status.any()
    assert np.abs(np.diff(time[500:]) - 1e6 / (1 + ERRORS[0])).max() < 1e5


@pytest.mark.slow
def test_packets_of_high_resolution_are_decoded(tmp_path: Path) -> None:
    array = parse_array(
        "".join(
            f'[[sensor]]\nname="I0_{half}"\nchip="icm42688"\nbus="/dev/spidev0.0"\nrange={full_scale}\nrate_hz=1000\n'
            "fifo=true\nhigh_resolution=true\n"
            for half, full_scale in (("acc", 16), ("gyro", 2000))
        )
        + '[array]\nname="s"\n'
    )
    bench = bench_of(array)
    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=2)
    time, counts, status = logged(tmp_path / "r.h5", "I0_acc")
    assert set(summary.lost.values()) == {0}
    assert not status.any()
    assert len(time) > 1900
    rows = []
    for tap in bench.taps:
        if tap.write == BURST and tap.answer:
            rows += [tap.answer[at : at + 20] for at in range(3, len(tap.answer), 20) if not tap.answer[at] & 0x80]
    x = [(int.from_bytes(row[1:3], "big", signed=True) << 4 | row[17] >> 4) >> 2 for row in rows]  # TDK-88, TDK-89
    begin = x.index(int(counts[0, 0]))
    assert counts[:, 0].tolist() == x[begin : begin + len(counts)]


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(4), 1, 0))
def test_a_bad_line_loses_packets_and_never_invents_any(seed: int, tmp_path: Path) -> None:
    array = array_of(2)
    bench = bench_of(array, drift=-1e-3)
    line = bench.delivered = BadLine(seed, 0.03, repeats=True)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=4)
    assert line.damaged > 5
    check(bench, array, tmp_path / "r.h5", start_ns, summary)


@pytest.mark.slow
def test_an_interruption_of_the_link_is_a_gap_of_known_length(tmp_path: Path) -> None:
    """As long as two turns of the chips' time stamps, which alone would show no gap."""
    array = array_of(2)
    bench = bench_of(array)
    begun_ns: list[int] = []

    def dead(piece: bytes) -> bytes:
        return b"" if begun_ns and bench.now_ns() - begun_ns[0] < 131 * MS else piece

    bench.delivered = dead
    summary, start_ns = stream(
        bench, array, tmp_path / "r.h5", rate_hz=20, seconds=3, at={1.5: lambda: begun_ns.append(bench.now_ns())}
    )
    check(bench, array, tmp_path / "r.h5", start_ns, summary)
    for sensor in array.sensors:
        assert np.count_nonzero(logged(tmp_path / "r.h5", sensor.name)[2] & LOST) == 1


@both_kinds()
@pytest.mark.slow
@pytest.mark.parametrize(("held_ms", "is_lost"), [(90, False), (400, True)])
def test_the_queue_bridges_a_short_pause_of_the_microcontroller(held_ms: int, is_lost: bool, tmp_path: Path) -> None:
    """A queue of 128 packets bridges a pause; a longer one loses samples, which the chip reports."""
    array = array_of(2)
    bench = bench_of(array)
    held: list[int] = []

    def late(address: int, write: bytes, answer: bytes) -> bytes:
        if held and held.pop():
            bench.clock.advance(held_ms * MS)
        return answer

    bench.answered = late
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=4, at={1.5: lambda: held.append(1)})
    check(bench, array, tmp_path / "r.h5", start_ns, summary)
    statuses = [logged(tmp_path / "r.h5", sensor.name)[2] for sensor in array.sensors]
    assert [bool((status & OVERRUN).any()) for status in statuses] == [is_lost] * 4
    assert all((lost > 0) == is_lost for lost in summary.lost.values())
    if is_lost:
        assert ("I0_acc", "lost", "no reading: the chip's queue ran over") in events(tmp_path / "r.h5")


@both_kinds()
def test_packets_that_arrive_during_the_burst_are_kept(tmp_path: Path) -> None:
    """More packets than were counted: the count is lowered by one packet where there is one."""
    array = array_of(1, rate_hz=500)
    bench = bench_of(array)
    changed = 0

    def counted_before(address: int, write: bytes, answer: bytes) -> bytes:
        nonlocal changed
        count = int.from_bytes(answer[1:3], "big") if write == BURST else 0
        if count < PACKET or len(bench.taps) % 3:
            return answer
        changed += 1
        return answer[:1] + (count - PACKET).to_bytes(2, "big") + answer[3:]

    bench.answered = counted_before
    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=0.4)
    assert changed > 5
    assert set(summary.lost.values()) == {0}
    time, _, status = logged(tmp_path / "r.h5", "I0_gyro")
    assert len(time) > 0.4 * 500 - 30
    assert not status.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda burst: burst[:3] + burst[4:] + b"\xff", id="a byte is lost"),
        pytest.param(lambda burst: burst[:3] + bytes(len(burst) - 3), id="the line is low"),
        pytest.param(lambda burst: burst[:19] + burst[35:] + b"\xff" * 16, id="a packet is left out"),
    ],
)
def test_bytes_that_are_no_samples_are_not_stored(spoil: Callable[[bytes], bytes], tmp_path: Path) -> None:
    array = array_of(2)
    bench = bench_of(array)
    todo: list[int] = []

    def glitch(address: int, write: bytes, answer: bytes) -> bytes:
        return spoil(answer) if (address, write) == (0x80, BURST) and todo and todo.pop() else answer

    bench.answered = glitch
    stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=6, at={1.5: lambda: todo.append(1)})
    for half in ("acc", "gyro"):
        time, counts, status = logged(tmp_path / "r.h5", f"I0_{half}")
        _, rows = packets(bench, 0)
        first = 1 if half == "acc" else 7
        wire = np.ascontiguousarray(rows[:, first : first + 6]).view(">i2").astype(np.int16)
        known = {tuple(row) for row in wire.tolist()}
        assert all(tuple(row) in known for row in counts.tolist())
        (again,) = np.flatnonzero(status & RECONFIGURED)
        assert status[again] & LOST
        assert len(time) - again > 500
        assert not (logged(tmp_path / "r.h5", f"I1_{half}")[2] & (SUSPECT | RECONFIGURED)).any()
    assert ("I0_acc", "configuration", "its queue gave no valid samples") in events(tmp_path / "r.h5")


@pytest.mark.slow
def test_an_undriven_line_gives_no_rows(tmp_path: Path) -> None:
    """FF in every byte is an impossible count: no rows meanwhile, and none is invented."""
    array = array_of(1)
    bench = bench_of(array)
    dead: list[int] = []
    bench.answered = lambda address, write, answer: b"\xff" * len(answer) if dead else answer
    stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=8, at={2.0: lambda: dead.append(1), 4.0: dead.clear})
    time, counts, status = logged(tmp_path / "r.h5", "I0_acc")
    assert 2 * S < np.diff(time).max() < 5 * S
    assert not (counts == -1).all(axis=1).any()
    (again,) = np.flatnonzero(status & RECONFIGURED)
    assert len(time) - again > 500
    assert any(kind == "lost" for _, kind, _ in events(tmp_path / "r.h5"))


@pytest.mark.slow
def test_a_chip_that_was_reset_is_set_up_again(tmp_path: Path) -> None:
    """After a reset the chip is off, with no queue: noticed within a second, and nothing after it is stored as good."""
    array = array_of(2, ranges=(4, 500))  # after power-on 16 g and 2000 dps
    bench = bench_of(array)
    stream(
        bench,
        array,
        tmp_path / "r.h5",
        rate_hz=20,
        seconds=8,
        at={2.0: lambda: bench.emulated.chips["I0_acc"].power_on(bench.now_ns())},
    )
    for half in ("acc", "gyro"):
        time, counts, status = logged(tmp_path / "r.h5", f"I0_{half}")
        (again,) = np.flatnonzero(status & RECONFIGURED)
        good = (status & SUSPECT) == 0
        assert not ((time > 2.0 * S) & good)[:again].any()
        assert len(time) - again > 1000
        assert not (counts[good] == -32768).any()
        assert not (logged(tmp_path / "r.h5", f"I1_{half}")[2] & (SUSPECT | RECONFIGURED)).any()
    reports = [(sensor, kind) for sensor, kind, _ in events(tmp_path / "r.h5")]
    assert ("I0_acc", "configuration") in reports or ("I0_gyro", "configuration") in reports


@both_kinds()
@pytest.mark.slow
def test_the_stream_restarts_after_a_reset_of_the_microcontroller(tmp_path: Path) -> None:
    array = array_of(2)
    bench: Any = bench_of(array, counter_us=2_000_000_000)

    def reset() -> None:
        bench.buses.__init__(bench.emulated)
        bench.set_select = bench.buses.set_select
        bench.firmware.__init__(bench, bench.clock, selects=8)

    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=8, at={2.0: reset})
    for sensor in array.sensors:
        time, _, status = logged(tmp_path / "r.h5", sensor.name)
        (again,) = np.flatnonzero(status & RECONFIGURED)
        assert status[again] & LOST
        assert 2 * S < np.diff(time).max() < 4.5 * S
        missing = np.diff(time).max() / 1e6 * (1 + ERRORS[int(sensor.name[1])]) - 1
        assert summary.lost[sensor.name] == pytest.approx(missing, rel=0.012)
        assert not (status[again:] & SUSPECT).any()


@pytest.mark.slow
def test_a_port_that_stays_unplugged_keeps_the_rows_read_before(tmp_path: Path) -> None:
    """Rows read before are stored, and missing rows are counted."""
    array = array_of(1)
    bench = bench_of(array)
    summary, _ = stream(bench, array, tmp_path / "r.h5", rate_hz=20, seconds=5, at={2.0: bench.unplug})
    time, _, _ = logged(tmp_path / "r.h5", "I0_acc")
    assert 1.8 * S < time[-1] < 2.1 * S
    assert summary.lost["I0_acc"] > 2500
    assert summary.silent == ["I0_acc", "I0_gyro"]


@pytest.mark.slow
def test_a_queue_and_polled_sensors_are_streamed_together(tmp_path: Path) -> None:
    array = array_of(1, sensor='[[sensor]]\nname="A"\nchip="adxl345"\naddress=0x53\nrange=4\nrate_hz=400\n')
    bench = bench_of(array)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=40, seconds=2)
    check(bench, array, tmp_path / "r.h5", start_ns, summary)
    time, counts, _ = logged(tmp_path / "r.h5", "A")
    wire_time, wire_counts = on_the_wire(bench, array, "A")
    assert len(time) == 80
    np.testing.assert_array_equal(counts, wire_counts[:80])
    assert np.abs(time + start_ns - wire_time[:80]).max() < 20_000


def test_the_bytes_of_eight_chips_at_1_khz_match_the_calculation() -> None:
    """On paper, at 20 frames a second: visits of 100 Hz, room for ceil(11.5) + 1 packets of 16 bytes behind 3 bytes,
    2 bytes for the age; four chips to a list, with 1 byte for its number and 15 for the frame.
    """
    array = array_of(8)
    with Bench(array, selects=8).bus() as bus:
        planned = plan(routes_of(array, bus), 20.0)
    drains = [asked for asked in planned.lists if asked.requests[0].read > 100]
    assert planned.split == 5
    assert [(len(asked.requests), asked.every, asked.offset) for asked in drains] == [(4, 1, 0), (4, 1, 0)]
    assert {request.read for asked in drains for request in asked.requests} == {3 + 13 * 16}
    assert sum(asked.size + 15 for asked in drains) * 100 == 2 * (15 + 1 + 4 * (2 + 211)) * 100 == 173_600
