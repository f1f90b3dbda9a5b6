"""The service's unit under systemd, process 1 of a guest: its behaviour, checked from outside.

The guest's systemd is this machine's. The unit is the one of configs/, unchanged; a drop-in shortens its times, so that
no test waits a minute for the watchdog. The array is on the kernel's /dev/i2c-N, over USB/IP. It takes minutes, so it
is a campaign: `tests/acquire/test_service.py` checks the notifications to systemd.
"""

from __future__ import annotations

import re
import shutil
import sys
import sysconfig
from pathlib import Path
from typing import NamedTuple

import pytest

from imuarray.log import open_log
from imuarray.log.journal import journal_of
from tests.system.bench import CONFIG, serve_array
from tests.system.conftest import SHARE, HostGuest, require

pytestmark = pytest.mark.campaign

ROOT = Path(__file__).parents[2]
SYSTEMD = Path("/lib/systemd/systemd")
MODULES = ("vhci-hcd", "i2c-tiny-usb", "i2c-dev")
TIMEOUT_S = 1200.0
"""It takes 3 minutes on a quiet machine."""
WATCHDOG_S = 20
QUICKER = f"[Service]\nWatchdogSec={WATCHDOG_S}s\nRestartSec=1s\nTimeoutStartSec=300s\n"
ONCE = f"[Unit]\nDefaultDependencies=no\n[Service]\nType=oneshot\nExecStart=/bin/sh {SHARE}/check\n"
WITHOUT = "systemd-udev-trigger systemd-tmpfiles-setup systemd-tmpfiles-setup-dev systemd-sysusers modprobe@"
"""What systemd starts first and the service does not need; it takes half a minute there."""
# The steps that the unit's first lines describe. ProtectHome= and the user's rights hide this machine's Python and
# sources from the service in any place: they are mounted where the unit expects them.
PREPARE = f"""#!/bin/sh
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
: > /etc/fstab
getent group i2c >/dev/null || groupadd --system i2c
getent group dialout >/dev/null || groupadd --system dialout
useradd --system --user-group --no-create-home imuarray
version=python{sys.version_info.major}.{sys.version_info.minor}
mkdir -p /etc/imuarray /opt/python /opt/source /opt/imuarray/bin /opt/imuarray/lib/$version/site-packages
mount --bind {sys.base_prefix} /opt/python
mount --bind {ROOT} /opt/source
mount --bind {sysconfig.get_path("purelib")} /opt/imuarray/lib/$version/site-packages
echo "home = /opt/python/bin" > /opt/imuarray/pyvenv.cfg
ln -s /opt/python/bin/$version /opt/imuarray/bin/python
printf '#!/opt/imuarray/bin/python\\nimport sys\\nfrom imuarray.cli import main\\nsys.exit(main())\\n' \\
  > /opt/imuarray/bin/imuarray
chmod 755 /opt/imuarray/bin/imuarray
printf 'RATE_HZ=12.5\\nPYTHONPATH=/opt/source\\nLD_LIBRARY_PATH=/opt/python/lib\\n' > /etc/imuarray/bench.env
units=/etc/systemd/system
cp "{SHARE}/imuarray-log@.service" $units
mkdir "$units/imuarray-log@.service.d"
cp {SHARE}/quicker.conf "$units/imuarray-log@.service.d"
cp {SHARE}/check.service $units
for name in {WITHOUT}; do ln -s /dev/null $units/$name.service; done
exec {SYSTEMD} --unit=check.service
"""
CHECK = f"""
exec > /dev/ttyS1 2>&1
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
unit=imuarray-log@bench.service
value() {{ systemctl show --value -p $1 $unit; }}
show() {{ echo "## $1"; systemctl show -p ActiveState,SubState,Result,NRestarts,MainPID,StatusText,User $unit; }}
until_() {{ for i in $(seq 300); do if "$@"; then return; fi; sleep 1; done; echo "not in time: $*"; finish; }}
finish() {{
  journalctl --no-pager -o short-monotonic -u $unit > {SHARE}/journal.txt
  cp -r /var/lib/imuarray {SHARE}/logs
  echo "## end"
  /run/busybox poweroff -f
}}
name() {{ grep -l i2c-tiny-usb /sys/class/i2c-dev/i2c-*/name 2>/dev/null; }}
plug_in() {{
  usbip --tcp-port PORT attach -r 10.0.2.2 -b 1-1
  until_ name >/dev/null
  adapter=$(basename $(dirname $(name)))
  until_ test -e /dev/$adapter
  chgrp i2c /dev/$adapter  # the rule of Debian's i2c-tools for udev, which need not run here
  chmod 660 /dev/$adapter
}}
restarted() {{ [ "$(value ActiveState)" = active ] && [ "$(value NRestarts)" -ge $1 ]; }}
fed_since() {{ [ "$(value WatchdogTimestampMonotonic)" -gt $1 ]; }}
restarts() {{ [ "$(value NRestarts)" -ge $1 ]; }}

plug_in
sed "s|^name = \\"bench\\"|&\\nbus = \\"i2c:/dev/$adapter\\"|" {SHARE}/bench.toml > /etc/imuarray/bench.toml
systemctl start $unit
show started
echo "DeviceGroup=$(stat -c %G /dev/$adapter)"
grep -E '^(Uid|Seccomp|NoNewPrivs|CapBnd)' /proc/$(value MainPID)/status
until_ fed_since $(value WatchdogTimestampMonotonic)
show fed
kill -KILL $(value MainPID)
until_ restarted 1
show killed
usbip detach -p 0
until_ restarts 2
plug_in
until_ restarted 2
show unplugged
systemctl stop $unit
show stopped
finish
"""


class Results(NamedTuple):
    """The results of the guest: its logs by name, the unit's properties by the heading under which they were shown."""

    logs: dict[str, Path]
    properties: dict[str, dict[str, str]]
    written: str
    journal: str


@pytest.fixture(scope="module")
def results(host_guest: HostGuest) -> Results:
    require("systemctl", "journalctl", "useradd")
    if not SYSTEMD.exists():
        pytest.skip(f"no {SYSTEMD} (.ci/system-packages installs it)")
    folder = host_guest.share
    (folder / "bench.toml").write_text(CONFIG)
    (folder / "quicker.conf").write_text(QUICKER)
    (folder / "check.service").write_text(ONCE)
    shutil.copy(ROOT / "configs" / "imuarray-log@.service", folder)
    with serve_array(folder / "bench.toml") as port:
        (folder / "check").write_text(CHECK.replace("PORT", str(port)))
        written = host_guest.run(PREPARE, MODULES, TIMEOUT_S)
    parts = (part.partition("\n") for part in written.split("## ")[1:])
    properties = {
        heading: dict(line.split("=", 1) for line in text.splitlines() if "=" in line) for heading, _, text in parts
    }
    journal = folder / "journal.txt"
    logs = {path.name: path for path in sorted((folder / "logs").glob("*.h5"))}
    return Results(logs, properties, written, journal.read_text(errors="replace") if journal.exists() else "")


def test_start_waits_for_the_first_rows(results: Results) -> None:
    """READY=1 is sent with them: sd_notify(3). The user is the unit's, without any capability, behind seccomp."""
    started = results.properties["started"]
    assert (started["ActiveState"], started["SubState"], started["User"]) == ("active", "running", "imuarray")
    assert re.fullmatch(r"recording, [1-9]\d* rows stored", started["StatusText"])
    lines = dict(re.findall(r"^(\w+):\s+(.*)$", results.written, re.MULTILINE))
    assert "0" not in lines["Uid"].split()
    assert (int(lines["CapBnd"], 16), lines["NoNewPrivs"], lines["Seccomp"]) == (0, "1", "2")


def test_only_stored_rows_reset_the_watchdog(results: Results) -> None:
    """It is fed while rows are stored, and without a bus the watchdog ends the service, which starts anew."""
    fed = results.properties["fed"]
    assert (fed["MainPID"], fed["NRestarts"]) == (results.properties["started"]["MainPID"], "0")
    assert "Failed with result 'watchdog'" in results.journal
    assert re.search(r"adapter: the adapter /dev/i2c-\d+ .* was removed", results.journal)
    unplugged = results.properties["unplugged"]
    assert unplugged["ActiveState"] == "active"
    assert int(unplugged["NRestarts"]) >= 2


def test_a_killed_service_restarts_and_recovers(results: Results) -> None:
    killed = results.properties["killed"]
    assert (killed["ActiveState"], killed["NRestarts"]) == ("active", "1")
    assert killed["MainPID"] != results.properties["started"]["MainPID"]
    first = min(results.logs)
    assert re.search(rf"{re.escape(first)}: recovered [1-9]\d* rows of 6 sensors", results.journal)
    with open_log(results.logs[first]) as log:
        assert [event.kind for event in log.events if event.kind == "recovered"] == ["recovered"]


def test_a_stopped_service_leaves_finished_logs(results: Results) -> None:
    """One log of every start, and no journal."""
    stopped = results.properties["stopped"]
    assert (stopped["ActiveState"], stopped["Result"]) == ("inactive", "success")
    assert len(results.logs) >= 3
    for path in results.logs.values():
        assert not journal_of(path).exists()
        with open_log(path) as log:
            assert log.state == "finished"
            assert all(len(log[name].time) > 0 for name in ("Accel", "Bosch", "Compass", "Gyro", "Other"))
