"""A chip that loses its configuration mid-log is detected, flagged back to its last good check, and set up again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray import load_array, open_bus, open_log
from imuarray.acquire import record
from imuarray.array import parse_array
from imuarray.log.format import LOST_BEFORE, RECONFIGURED, SUSPECT
from tests.selection import some

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"


class _Saboteur:
    """An open bus of the emulated array on which `act` is called once, `after_s` into the log."""

    def __init__(self, bus: Any, after_s: float, act: Any) -> None:
        self._bus, self._after_s, self._act = bus, after_s, act
        self.source, self.clock, self.truth = bus.source, bus.clock, bus.truth
        self.armed_ns: int | None = None
        self.acted_ns: int | None = None

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        waiting = self.armed_ns is not None and self.acted_ns is None
        if waiting and self.clock.now_ns() > (self.armed_ns or 0) + self._after_s * 1e9:
            self.acted_ns = self.clock.now_ns()
            self._act(self._bus)
        answer: bytes = self._bus.transfer(address, write, read)
        return answer

    def channel_bus(self, path: str) -> Any:
        return self._bus.channel_bus(path)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing to close."""


def _brown_out(name: str) -> Any:
    def act(bus: Any) -> None:
        bus.chips[name].power_on(bus.clock.now_ns())

    return act


def _recorded(tmp_path: Path, name: str, rate_hz: float, seconds: float = 6.0) -> tuple[Path, int]:
    """A log in which `name` is reset 3 s after the start; and when that was, in ns of the log."""
    array = load_array(CONFIG)
    path = tmp_path / "run.h5"
    with open_bus("emulated:", array) as bus:
        saboteur = _Saboteur(bus, 3.0, _brown_out(name))

        def stopped() -> bool:
            """Asked before every frame: the first time, the log has just begun."""
            if saboteur.armed_ns is None:
                saboteur.armed_ns = saboteur.clock.now_ns()
            return False

        record(array, saboteur, path, rate_hz=rate_hz, seconds=seconds, stopped=stopped)  # type: ignore[arg-type]
    assert saboteur.acted_ns is not None
    assert saboteur.armed_ns is not None
    return path, saboteur.acted_ns - saboteur.armed_ns


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["ADXL2", "BMA1", "Gyro3", "HMC1"], 1))
def test_a_reset_chip_is_detected_within_a_second_and_its_rows_since_are_suspect(tmp_path: Path, name: str) -> None:
    path, reset_ns = _recorded(tmp_path, name, rate_hz=48.0)
    with open_log(path) as log:
        (event,) = [event for event in log.events if event.kind == "configuration"]
        assert event.sensor == name
        assert reset_ns < event.time_ns < reset_ns + 1_000_000_000
        sensor = log[name]
        time, status = np.asarray(sensor.time), np.asarray(sensor.status)
        suspect = (status & SUSPECT) != 0
        (again,) = np.flatnonzero(status & RECONFIGURED)
        assert status[again] & LOST_BEFORE
        assert reset_ns < time[again] < reset_ns + 2_000_000_000
        assert suspect[(time > reset_ns) & (time < time[again])].all()
        assert not suspect[again:].any()
        assert [event.kind for event in log.events] == ["configuration", "reconfigured"]
        # Flagged from its last good check on, which was at most a sweep earlier; the rest of the log is untouched.
        assert not suspect[time < reset_ns - 1_000_000_000].any()
        for other in log.sensors.values():
            if other.name != name:
                assert not (np.asarray(other.status) & SUSPECT).any()


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", some([10.0, 200.0], 1))
def test_a_reset_is_detected_within_a_second_at_other_rates(tmp_path: Path, rate_hz: float) -> None:
    path, reset_ns = _recorded(tmp_path, "BMA4", rate_hz=rate_hz)
    with open_log(path) as log:
        (event,) = [event for event in log.events if event.kind == "configuration"]
        assert event.time_ns < reset_ns + 1_000_000_000


@pytest.mark.slow
def test_a_sound_array_has_no_suspect_row_and_every_row_is_written(tmp_path: Path) -> None:
    array = load_array(CONFIG)
    with open_bus("emulated:", array) as bus:
        summary = record(array, bus, tmp_path / "run.h5", rate_hz=48.0, seconds=3.0)
    with open_log(tmp_path / "run.h5") as log:
        assert len(log["BMA1"]) == len(log["Gyro2"]) == summary.frames
        assert summary.frames in (144, 145)  # 48 Hz is no whole number of nanoseconds
        assert not log.events
        assert not any((np.asarray(sensor.status) & SUSPECT).any() for sensor in log.sensors.values())


@pytest.mark.slow
def test_reading_the_mode_does_not_lock_the_data_of_an_hmc5883l(tmp_path: Path) -> None:
    """Reading its mode alone would lock the data until the next fetch, which then repeats them (HMC-34)."""
    text = "[array]\nname = 'two'\nmux = {chip = 'pca9544a', address = 0x70}\n" + "".join(
        f"[[sensor]]\nname = 'M{number}'\nchip = 'hmc5883l'\nchannel = {number}\naddress = 0x1E\nrange = {range_}\n"
        "rate_hz = 75\naxes = '+X+Y+Z'\n"
        for number, range_ in ((0, 1.3), (1, 8.1))
    )
    path = tmp_path / "two.h5"
    array = parse_array(text)
    with open_bus("emulated:", array) as bus:
        record(array, bus, path, rate_hz=32.0, seconds=60.0)
    with open_log(path) as log:
        counts = np.asarray(log["M0"].counts)

    def equal(lag: int) -> float:
        return float((counts[lag:] == counts[:-lag]).all(axis=1).mean())

    chance = equal(5)
    assert equal(1) < chance + 4 * np.sqrt(chance * (1 - chance) / len(counts))
