"""Delays of the filters of the MPU family (INV-12, INV-79): a log states them, and the emulated chips have them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.board import Board
from firmware_emulator.world import Shaking
from imuarray.acquire import record
from imuarray.array import parse_array
from imuarray.characterise.alignment import find_alignment
from imuarray.cli import main
from imuarray.fuse import read_fused
from imuarray.log import open_log
from tests.acquire.clock_world import SPAN_G, ClockElement
from tests.selection import some

DELAYS_MS = [
    *(("mpu6050", bandwidths, delays) for bandwidths, delays in (((44, 42), (4.9, 4.8)), ((184, 188), (2.0, 1.9)))),
    *(("mpu6050", bandwidths, delays) for bandwidths, delays in (((10, 10), (13.8, 13.4)), ((5, 5), (19.0, 18.6)))),
    *(("mpu9250", (value, value), delays) for value, delays in ((41, (11.8, 5.9)), (184, (5.8, 2.9)))),
    *(("mpu6500", (value, value), delays) for value, delays in ((92, (7.8, 3.9)), (5, (66.96, 33.48)))),
]
"""By chip and bandwidths (Hz), of accelerometer and gyroscope: the delays (ms) that the register maps print."""


class ClockBoard(Board):
    """The input of every element is the elapsed share of the second."""

    def element(self, sensor: Any) -> Any:
        return ClockElement()


@pytest.mark.parametrize(("die", "bandwidths_hz", "delays_ms"), some(DELAYS_MS, 1))
def test_a_row_shows_the_input_of_one_delay_earlier(
    die: str, bandwidths_hz: tuple[int, int], delays_ms: tuple[float, float], tmp_path: Path
) -> None:
    """The accelerometer's x is the time; it is polled at 200 Hz, so that a reading is up to 1 ms old."""
    text = '[array]\nname = "a"\n'
    for name, full_scale, bandwidth_hz in zip("AG", (16, 2000), bandwidths_hz, strict=True):
        text += f'[[sensor]]\nname = "{name}"\nchip = "{die}"\naddress = 0x68\nrange = {full_scale}\n'
        text += f"rate_hz = 1000\nbandwidth_hz = {bandwidth_hz}\n"
    starts_ns: list[int] = []
    with open_array(parse_array(text), board=ClockBoard) as bus:
        record(
            parse_array(text),
            bus,
            tmp_path / "run.h5",
            rate_hz=200.0,
            seconds=1.0,
            on_headers=lambda *_: starts_ns.append(bus.clock.now_ns()),
        )
    with open_log(tmp_path / "run.h5") as log:
        assert [log[name].delay_ns for name in "AG"] == [round(delay * 1e6) for delay in delays_ms]
        felt_s = log["A"].counts[:][:, 0] / log["A"].sensitivity / (SPAN_G * 0.999) + 0.5
        late_s = (log["A"].time[:] * 1e-9 + starts_ns[0] * 1e-9 - felt_s + 0.5) % 1.0 - 0.5
    late_s = late_s[20:]  # before the filter is full it shows the moment of power-on
    assert late_s.min() > 1e-3 * delays_ms[0] - 0.2e-3
    assert late_s.max() < 1e-3 * delays_ms[0] + 1.3e-3


@pytest.mark.slow
def test_gyroscopes_with_and_without_a_known_delay_agree_in_motion(tmp_path: Path) -> None:
    """Of the emulated L3G4200D no delay is known, and it has none. Polled, readings are up to 1 ms old."""
    text = (
        '[array]\nname = "a"\n[[sensor]]\nname = "L"\nchip = "l3g4200d"\naddress = 0x69\nrange = 500\nrate_hz = 800\n'
    )
    text += '[[sensor]]\nname = "M"\nchip = "mpu6050"\naddress = 0x68\nrange = 500\nrate_hz = 1000\nbandwidth_hz = 20\n'
    with open_array(parse_array(text), world=Shaking(still_s=2.0, motion_s=20.0)) as bus:
        record(parse_array(text), bus, tmp_path / "run.h5", rate_hz=200.0, seconds=22.0)
    with open_log(tmp_path / "run.h5") as log:
        assert (log["L"].delay_ns, log["M"].delay_ns) == (0, 8_300_000)
        alignment = find_alignment(log)
    assert alignment is not None
    (delay_s,) = [sensor.delay_s for sensor in alignment.sensors if sensor.name == "M"]
    assert delay_s == pytest.approx(0.0, abs=1e-3)


def error_in_motion(path: Path, truth_of: Path) -> float:
    """The rms error of the fused specific force in m/s2, less its mean, from 5 s on."""
    fused = path.with_suffix(".fused.h5")
    assert main(["fuse", str(path), "-o", str(fused), "--technique", "mean"]) == 0
    blocks = list(read_fused(fused))
    time_ns = np.concatenate([block.time for block in blocks])
    force = np.concatenate([block.triads["specific_force"] for block in blocks])
    with open_log(truth_of) as log:
        assert log.truth is not None
        at_ns, true = np.asarray(log.truth.time[:]), np.asarray(log.truth.specific_force[:])
    known = np.isfinite(force).all(axis=1) & (time_ns > 5e9) & (time_ns < 18e9)
    felt = np.stack([np.interp(time_ns[known], at_ns, column) for column in true.T], axis=1)
    error = force[known] - felt
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


@pytest.mark.slow
def test_fusion_takes_the_delay_into_account(tmp_path: Path) -> None:
    """An LSM6DSO, whose emulated filter does not delay, and an MPU-9250 that is 11.8 ms late: with a log that does
    not state it, the mean has several times the error.
    """
    config, path, silent = tmp_path / "a.toml", tmp_path / "run.h5", tmp_path / "silent.h5"
    text = '[array]\nname = "a"\n'
    for die, address, rate_hz in (("lsm6dso", 0x6A, 416), ("mpu9250", 0x68, 1000)):
        for half, full_scale in (("acc", 4), ("gyro", 500)):
            text += f'[[sensor]]\nname = "{die}_{half}"\nchip = "{die}"\naddress = {address}\n'
            text += f"range = {full_scale}\nrate_hz = {rate_hz}\n"
    config.write_text(text)
    url = "emulated:?world=shaking&still_s=3&motion_s=20&peak_g=1&peak_dps=200"
    words = ["log", str(config), "--bus", url, "--rate-hz", "100", "--seconds", "20", "-o", str(path)]
    assert main(words) == 0
    shutil.copy(path, silent)
    with h5py.File(silent, "a") as file:
        for group in file["sensors"].values():
            group.attrs.pop("delay_ns", None)
    assert error_in_motion(path, path) < 0.5 * error_in_motion(silent, path)
