"""This project's commands in a guest, on the kernel's own /dev/i2c-N: their results, checked from outside.

One boot and one Python process for all (`guest_program`): the first import alone takes longer than all the rest
there. The array is plugged in over USB/IP, and pulled out. It takes minutes, so it is a campaign:
`tests/bus/test_linux.py` logs through emulated device files, and in `tests/system/test_kernel_usbip.py` the kernel's
own drivers read the array.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from imuarray.log import Log, open_log
from imuarray.log.format import LOST_BEFORE, RECONFIGURED
from tests.system.bench import CONFIG, serve_array
from tests.system.conftest import SHARE, HostGuest, module_bytes

pytestmark = pytest.mark.campaign

PROGRAM = Path(__file__).with_name("guest_program.py")
MODULES = ("vhci-hcd", "i2c-tiny-usb", "i2c-dev", "i2c-mux", "st_gyro_i2c")
APART = ("i2c-stub", "i2c-mux-pca954x")
"""Modules that are not loaded at boot; the second is not Debian's: `build_kernel_modules` builds it."""
TIMEOUT_S = 900.0
"""It takes 2 minutes on a quiet machine."""
SENSORS = {"Accel", "Bosch", "Gyro", "Baro", "Compass", "Other"}
ROOT = Path(__file__).parents[2]


class Results(NamedTuple):
    """The results of the guest: files in `folder`, exit codes by the command's name, and its output."""

    folder: Path
    codes: dict[str, int]
    written: str

    def report(self, name: str) -> Any:
        """The JSON output of a command."""
        return json.loads((self.folder / f"{name}.out").read_text())

    def errors(self, name: str) -> str:
        return (self.folder / f"{name}.err").read_text()


@pytest.fixture(scope="module")
def results(host_guest: HostGuest) -> Results:
    folder = host_guest.share
    (folder / "bench.toml").write_text(CONFIG)
    for name in APART:
        if (path := host_guest.module(name)) is not None:
            (folder / f"{name}.ko").write_bytes(module_bytes(path))
    with serve_array(folder / "bench.toml") as port:
        script = f"""#!/bin/sh
            export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1
            cd {ROOT}
            {sys.executable} {PROGRAM} {SHARE} {port}
            /run/busybox poweroff -f
        """
        written = host_guest.run(script, MODULES, TIMEOUT_S)
    codes = folder / "codes.json"
    return Results(folder, json.loads(codes.read_text()) if codes.exists() else {}, written)


def test_all_commands_ran(results: Results) -> None:
    assert "Traceback" not in results.written, results.written
    assert {"detect", "self_test", "shared", "unplugged", "killed", "recover", "verify", "lost"} <= set(results.codes)


def rows_of(log: Log, name: str) -> tuple[Any, Any]:
    """Times in s and flags of a sensor's rows."""
    return log[name].time[:] * 1e-9, log[name].status[:]


def test_detect_agrees_with_the_configuration(results: Results) -> None:
    assert (results.codes["detect"], results.codes["self_test"]) == (0, 0)
    verdicts = {entry["sensor"]: entry["ok"] for entry in results.report("detect")["found"]}
    assert verdicts == dict.fromkeys(SENSORS | {"mux"}, True)
    tested = [entry["self_test"] for entry in results.report("self_test")["found"] if entry["self_test"]]
    assert len(tested) >= 3
    assert all(text.startswith("self-test passed") for text in tested), tested


def test_a_kernel_driver_takes_and_releases_a_chip(results: Results) -> None:
    """Only that chip has a gap; it is set up again."""
    assert results.codes["shared"] == 0, results.errors("shared")
    with open_log(results.folder / "shared.h5") as log:
        events = {(event.sensor, event.kind): event for event in log.events}
        assert "the kernel's driver 'st-gyro-i2c'" in events["Gyro", "taken"].message
        taken_s, back_s = (events["Gyro", kind].time_ns * 1e-9 for kind in ("taken", "reconfigured"))
        time, status = rows_of(log, "Gyro")
        assert time[0] < taken_s < back_s < time[-1]
        assert not ((taken_s < time) & (time < back_s)).any()
        first = np.flatnonzero(time > back_s)[0]
        assert status[first] & (LOST_BEFORE | RECONFIGURED) == LOST_BEFORE | RECONFIGURED
        others = log["Accel"].time[:] * 1e-9
        assert ((taken_s < others) & (others < back_s)).sum() > 5
        assert np.diff(others).max() < back_s - taken_s


def test_a_log_continues_when_the_adapter_returns_with_another_number(results: Results) -> None:
    """One log, with rows before and after of every sensor, and events of the interruption."""
    assert results.codes["unplugged"] == 0, results.errors("unplugged")
    before, after = json.loads((results.folder / "numbers.json").read_text())
    assert before != after
    with open_log(results.folder / "unplugged.h5") as log:
        assert log.state == "finished"
        events = [event for event in log.events if event.kind == "adapter"]
        assert len(events) == 2, [event.message for event in events]
        assert f"/dev/i2c-{before}" in events[0].message
        assert f"/dev/i2c-{after}" in events[1].message
        out_s, in_s = (event.time_ns * 1e-9 for event in events)
        for name in SENSORS:
            time, status = rows_of(log, name)
            assert (time < out_s).any(), name
            assert not ((out_s < time) & (time < in_s)).any(), name
            first = np.flatnonzero(time > in_s)[0]
            assert status[first] & (LOST_BEFORE | RECONFIGURED) == LOST_BEFORE | RECONFIGURED, name


def test_a_killed_log_is_recovered(results: Results) -> None:
    """The same rows as the journal has, which is read here by itself."""
    assert [results.codes[name] for name in ("killed", "recover", "verify")] == [-9, 0, 0]
    with open_log(results.folder / "unfinished.h5") as cut, open_log(results.folder / "killed.h5") as log:
        assert (cut.state, log.state) == ("interrupted", "finished")
        for name in SENSORS:
            assert len(log[name].time) > 3
            np.testing.assert_array_equal(log[name].time[:], cut[name].time[:])
            np.testing.assert_array_equal(log[name].counts[:], cut[name].counts[:])


def test_a_multiplexer_of_the_kernel_is_logged_by_channel(results: Results) -> None:
    """Each channel by its own bus; the trunk with our own multiplexer is refused, by the driver's name."""
    if "channels" not in results.codes:
        pytest.skip("no module i2c-mux-pca954x, which Debian does not build; tests/system/build_kernel_modules does")
    assert results.codes["detect_trunk"] == 2
    (mux,) = [entry for entry in results.report("detect_trunk")["found"] if entry["sensor"] == "mux"]
    assert "belongs to the kernel's driver 'pca954x'" in mux["found"]
    assert results.codes["detect_channels"] == 0
    assert results.codes["channels"] == 0, results.errors("channels")
    with open_log(results.folder / "channels.h5") as log:
        assert {name for name in log.sensors if len(log[name].time) > 3} == SENSORS


def test_a_recording_without_any_reading_exits_with_1(results: Results) -> None:
    assert results.codes["lost"] == 1, results.errors("lost")
    with open_log(results.folder / "lost.h5") as log:
        assert log.state == "finished"
        assert [event.kind for event in log.events if event.kind == "adapter"]
