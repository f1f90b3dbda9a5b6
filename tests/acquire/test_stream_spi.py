"""Six-axis chips on chip selects of a microcontroller: streamed, logged as they went over its wires, set up again."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.acquire import connect
from imuarray.acquire.stream_plan import plan
from imuarray.array import ArrayConfig, parse_array
from imuarray.errors import BusUrlError, SensorError
from tests.acquire.streams import LOST, OVERRUN, RECONFIGURED, SUSPECT, S, logged, stream
from tests.bus.serial_bench import Bench
from tests.firmware.kinds import both_kinds
from tests.selection import some

ICM42688 = 'chip="icm42688"\nrate_hz=1000\nbandwidth_hz=100\n'
BURST = b"\x9d"  # register 1D, temperature, with the bit that reads (TDK-70)


def array_of(chips: int, selects: Callable[[int], int] = lambda chip: chip) -> ArrayConfig:
    text = '[array]\nname="s"\n'
    for chip in range(chips):
        for half, full_scale in (("acc", 4), ("gyro", 500)):
            text += f'[[sensor]]\nname="I{chip}_{half}"\nbus="/dev/spidev0.{selects(chip)}"\nrange={full_scale}\n'
            text += ICM42688
    return parse_array(text)


def bursts(bench: Bench, select: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (ns) of the bursts of a chip, specific force and angular rate (n, 3) as counts: after the temperature,
    the most significant byte first (TDK-52).
    """
    ours = [tap for tap in bench.taps if (tap.address, tap.write) == (0x80 + select, BURST) and tap.answer]
    words = np.array([struct.unpack(">7h", tap.answer or b"") for tap in ours])
    return np.array([tap.at_ns for tap in ours]), words[:, 1:4], words[:, 4:]


def check_as_on_the_wire(bench: Bench, path: Path, start_ns: int, select_of: dict[str, int]) -> None:
    for name, select in select_of.items():
        wire_ns, *wire = bursts(bench, select)
        for half, wire_counts in zip(("acc", "gyro"), wire, strict=True):
            time, counts, status = logged(path, f"{name}_{half}")
            first = int(np.abs(wire_ns - start_ns - time[0]).argmin())
            np.testing.assert_array_equal(counts, wire_counts[first : first + len(counts)])
            assert np.abs(time + start_ns - wire_ns[first : first + len(time)]).max() < 20_000
            assert not (status & (LOST | SUSPECT | RECONFIGURED | OVERRUN)).any()


@both_kinds(pytest.mark.slow)
@pytest.mark.parametrize("selects", some([((0, 1),), ((5, 2),)], 1))
def test_the_log_of_two_chips_equals_the_bytes_on_the_wires(tmp_path: Path, selects: tuple[int, ...]) -> None:
    array = array_of(2, lambda chip: selects[chip])
    bench = Bench(array, "world=shaking&still_s=0.2&motion_s=5", selects=8, drift=-1e-3)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=250, seconds=1)
    assert (summary.frames, set(summary.lost.values())) == (250, {0})
    check_as_on_the_wire(bench, tmp_path / "r.h5", start_ns, {"I0": selects[0], "I1": selects[1]})


@both_kinds(pytest.mark.slow)
@pytest.mark.campaign
def test_eight_chips_at_1_khz_are_streamed(tmp_path: Path) -> None:
    array = array_of(8)
    bench = Bench(array, "world=shaking&still_s=0.2&motion_s=5", selects=8)
    summary, start_ns = stream(bench, array, tmp_path / "r.h5", rate_hz=1000, seconds=0.4)
    assert (summary.frames, set(summary.lost.values())) == (400, {0})
    check_as_on_the_wire(bench, tmp_path / "r.h5", start_ns, {f"I{chip}": chip for chip in range(8)})


def test_both_halves_of_a_chip_are_read_in_one_request() -> None:
    with Bench(array_of(8), selects=8).bus() as bus:
        lists = plan(connect(array_of(8), bus), 1000.0).lists
    assert [len(lists[0].requests), lists[0].every] == [8, 1]
    assert lists[0].size + 15 == 15 + 1 + 8 * (2 + 14)  # 144 bytes in a frame of the link


def test_a_chip_that_is_missing_is_named() -> None:
    array = array_of(2)
    with Bench(array_of(1), selects=8).bus() as bus, pytest.raises(SensorError, match=r"I1_acc.*/dev/spidev0\.1"):
        connect(array, bus)


@pytest.mark.parametrize(("selects", "path"), [(0, "/dev/spidev0.0"), (4, "/dev/spidev0.4"), (8, "/dev/spidev1.0")])
def test_a_chip_select_that_does_not_exist_is_refused(selects: int, path: str) -> None:
    array = parse_array(f'[array]\nname="s"\n[[sensor]]\nname="I0"\nbus="{path}"\nrange=4\n{ICM42688}')
    reason = f"I0: chip select {path}: this microcontroller has {selects} chip selects"
    with Bench(array, selects=selects).bus() as bus, pytest.raises(BusUrlError, match=reason):
        connect(array, bus)


@both_kinds(pytest.mark.slow)
@pytest.mark.slow
def test_after_a_reset_the_chip_selects_are_set_again(tmp_path: Path) -> None:
    array = array_of(1)
    bench: Any = Bench(array, "world=shaking&still_s=0.2&motion_s=9", selects=8, counter_us=2_000_000_000)
    settings: list[tuple[int, int, int]] = []

    def reset() -> None:
        bench.buses.__init__(bench.emulated)
        inner = bench.buses.set_select
        bench.set_select = lambda *setting: (settings.append(setting), inner(*setting))[1]
        bench.firmware.__init__(bench, bench.clock, selects=8)  # it restarts and counts from 0

    summary, _ = stream(bench, array, tmp_path / "r.h5", seconds=7, at={2.0: reset})
    assert settings == [(0, 3, 24_000_000)]
    time, _, status = logged(tmp_path / "r.h5", "I0_gyro")
    (again,) = np.flatnonzero(status & RECONFIGURED)
    assert 2 * S < np.diff(time).max() < 4 * S
    assert not (status[again:] & SUSPECT).any()
    assert len(time) + summary.lost["I0_gyro"] == pytest.approx(summary.frames, abs=2)
