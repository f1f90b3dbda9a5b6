"""Notifications of a service manager, at a socket by path and at an abstract one; and the unit file."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from imuarray.acquire.recording import Service
from imuarray.commands.log import command

UNIT = Path(__file__).parents[2] / "configs" / "imuarray-log@.service"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="systemd is Linux's")


class Manager:
    """The service manager's end."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.socket.setblocking(False)
        self.address = address

    def messages(self) -> list[str]:
        """One string a datagram."""
        messages = []
        while True:
            try:
                messages.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return messages


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@imuarray-test-{os.getpid()}"
    result = Manager(address)
    yield result
    result.socket.close()


class Time:
    now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def service(manager: Manager, time: Time, **more: str) -> Service:
    return Service({"NOTIFY_SOCKET": manager.address, **more}, time, 77)


def test_the_first_stored_rows_report_ready(manager: Manager) -> None:
    notifier = service(manager, Time())
    notifier.stored(0)
    assert manager.messages() == []
    notifier.stored(13)
    notifier.stored(26)
    assert manager.messages() == ["READY=1\nSTATUS=recording, 13 rows stored"]
    notifier.stopping()
    assert manager.messages() == ["STOPPING=1\nSTATUS=finishing the log"]


def test_only_stored_rows_reset_the_watchdog(manager: Manager) -> None:
    time = Time()
    notifier = service(manager, time, WATCHDOG_USEC="30000000", WATCHDOG_PID="77")
    rows, fed = 0, []
    for second in range(100):
        time.now_ns = second * 1_000_000_000
        rows += 500 if second < 40 or second > 90 else 0  # for 50 s nothing is stored
        notifier.stored(rows)
        fed += [second] * any("WATCHDOG=1" in words for words in manager.messages())
    assert fed == [0, 15, 30, 91]  # half of the allowed 30 s apart, and not while nothing was stored


@pytest.mark.parametrize(
    "more",
    [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "1", "WATCHDOG_PID": "78"}],
)
def test_without_a_watchdog_none_is_reset(manager: Manager, more: dict[str, str]) -> None:
    service(manager, Time(), **more).stored(5)
    assert manager.messages() == ["READY=1\nSTATUS=recording, 5 rows stored"]


def test_the_status_is_sent_every_ten_seconds(manager: Manager) -> None:
    time = Time()
    notifier = service(manager, time)
    for second in range(25):
        time.now_ns = second * 1_000_000_000
        notifier.stored(second + 1)
    assert [words.splitlines()[-1] for words in manager.messages()] == [
        f"STATUS=recording, {rows} rows stored" for rows in (1, 11, 21)
    ]


@pytest.mark.parametrize("address", ["", "/no/such/socket", "@nobody-is-there", "vsock:2:9999", "notify", "@"])
def test_a_missing_or_invalid_socket_is_ignored(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is raised, printed or made in the folder."""
    monkeypatch.chdir(tmp_path)
    notifier = Service({"NOTIFY_SOCKET": address})
    notifier.stored(5)
    notifier.stopping()
    Service({}).stored(5)
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_a_manager_that_does_not_read_does_not_block(manager: Manager) -> None:
    time = Time()
    notifier = service(manager, time, WATCHDOG_USEC="2")
    for rows in range(1, 2000):  # its queue is full long before
        time.now_ns += 1_000_000
        notifier.stored(rows)
    first, *later = manager.messages()
    assert first.startswith("READY=1\n")
    assert len(later) < 1900  # the queue did overflow
    time.now_ns += 1_000_000
    notifier.stored(2000)
    assert any("WATCHDOG=1" in words for words in manager.messages())


def test_a_status_is_one_line(manager: Manager) -> None:
    service(manager, Time()).stopping("no room\nREADY=1")
    assert manager.messages() == ["STOPPING=1\nSTATUS=no room READY=1"]


WANTED = {
    "Type": "notify",
    "User": "imuarray",
    "SupplementaryGroups": "i2c dialout",
    "DevicePolicy": "closed",
    "PrivateNetwork": "yes",
    "ProtectSystem": "strict",
    "StateDirectory": "imuarray",
    "NoNewPrivileges": "yes",
    "MemoryDenyWriteExecute": "yes",
}


def test_the_unit_has_the_expected_settings() -> None:
    lines = [line for line in UNIT.read_text(encoding="utf-8").splitlines() if "=" in line and line[0] not in "#;"]
    settings = dict(line.split("=", 1) for line in lines)
    assert {name: settings.get(name) for name in WANTED} == WANTED
    assert "char-i2c rw" in [line.split("=", 1)[1] for line in lines if line.startswith("DeviceAllow=")]
    assert int(settings["WatchdogSec"].removesuffix("s")) >= 20


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    """No complaint about a line of it; and by systemd's own measure it exposes little."""
    unit = tmp_path / "imuarray-log@martin2013.service"
    text = UNIT.read_text(encoding="utf-8").replace("/opt/imuarray/bin/imuarray", sys.executable)
    unit.write_text(text, encoding="utf-8")
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", unit], capture_output=True, text=True, timeout=30)
    assert [line for line in done.stderr.splitlines() if "imuarray-log" in line] == []
    offline = ["systemd-analyze", "security", "--offline=yes", "--threshold=20", "--no-pager", unit]
    done = subprocess.run(offline, capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stdout[-500:]


def test_the_unit_restarts_without_limit() -> None:
    lines = UNIT.read_text(encoding="utf-8").splitlines()
    assert "StartLimitIntervalSec=0" in lines  # systemd.unit(5): no limit
    assert "Restart=on-failure" in lines
    assert not any(line.startswith("StartLimitBurst") for line in lines)


def test_the_unit_recovers_logs_with_a_journal(tmp_path: Path) -> None:
    """Each log of this array that has a journal, though the first can't be recovered; and no log of another array."""
    (line,) = [line for line in UNIT.read_text(encoding="utf-8").splitlines() if line.startswith("ExecStartPre=-")]
    program, logs = tmp_path / "imuarray", tmp_path / "logs of arrays"
    program.write_text('#!/bin/sh\necho "$@"\nexit 2\n')
    program.chmod(0o755)
    logs.mkdir()
    line = line.replace("%%", "%").replace("%i", "bench").replace("$$", "$")
    line = line.replace("/opt/imuarray/bin/imuarray", str(program))
    environment = {"STATE_DIRECTORY": str(logs), "PATH": os.environ["PATH"]}
    command = shlex.split(line.removeprefix("ExecStartPre=-"))

    def commands() -> list[str]:
        done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=20)
        assert done.stderr == ""
        return done.stdout.splitlines()

    assert commands() == []
    for name in ("bench-a_001.h5", "bench-a_002.h5", "other-a_001.h5"):
        (logs / name).touch()
        (logs / f"{name}.journal").touch()
    (logs / "bench-a_003.h5").touch()
    assert commands() == [f"recover {logs}/bench-a_001.h5", f"recover {logs}/bench-a_002.h5"]


def test_the_program_accepts_the_command_of_the_unit(tmp_path: Path) -> None:
    """Its shell line with the substitutions of systemd (systemd.service(5): $$, %%, %i), and a program that prints
    them.
    """
    (line,) = [line for line in UNIT.read_text(encoding="utf-8").splitlines() if line.startswith("ExecStart=")]
    program = tmp_path / "imuarray"
    program.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    program.chmod(0o755)
    line = line.replace("%%", "%").replace("%i", "bench").replace("$$", "$")
    line = line.replace("/opt/imuarray/bin/imuarray", str(program))
    shell, option, script = shlex.split(line.removeprefix("ExecStart="))
    environment = {"RATE_HZ": "50", "ROTATE": "1h", "STATE_DIRECTORY": "/var/lib/imuarray", "PATH": os.environ["PATH"]}
    done = subprocess.run([shell, option, script], capture_output=True, text=True, env=environment, timeout=20)
    *words, output = done.stdout.splitlines()
    assert words == ["log", "/etc/imuarray/bench.toml", "--rate-hz", "50", "--rotate", "1h", "-o"]
    assert re.fullmatch(r"/var/lib/imuarray/bench-\d{8}T\d{6}Z\.h5", output)
    known = {name for option in command.params for name in option.opts}
    assert {"--rate-hz", "--rotate", "-o"} <= known
