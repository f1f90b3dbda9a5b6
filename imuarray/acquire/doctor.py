"""Why does a bus not work? One line a check, with what to do; nothing is changed."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

from imuarray.acquire.doctor_i2c import buses_of, i2c_checks
from imuarray.acquire.doctor_logs import log_checks
from imuarray.acquire.doctor_machine import Check, Machine, permission
from imuarray.array import ArrayConfig
from imuarray.errors import ImuArrayError

__all__ = ["Check", "Machine", "examine", "serial_checks"]


def examine(
    array: ArrayConfig | None,
    url: str,
    logs: Path,
    rate_hz: float,
    *,
    machine: Machine | None = None,
    talk: Callable[[], list[Check]] | None = None,
) -> list[Check]:
    """All checks for `array` on the bus `url` (empty: none is named), recorded into the folder `logs`; without an array
    those that need no sensors. `talk` asks the sensors themselves; it is left out where an earlier check says why it
    can't work.
    """
    machine = machine or Machine()
    scheme, _, rest = url.partition(":")
    if scheme == "i2c":
        checks = i2c_checks(machine, array, buses_of(array, rest), rate_hz)
    elif scheme == "serial":
        checks = serial_checks(machine, rest.partition("?")[0])
    elif scheme == "replay":
        checks = [Check("transcript", Path(rest).is_file(), rest, "name a file that `log --transcript` wrote")]
    elif not url:
        advice = "say --bus i2c:/dev/i2c-1 (or serial:/dev/ttyACM0), or give [array] a bus"
        checks = [Check("bus", False, "none is named", advice)]
    else:
        checks = [Check("bus", scheme == "emulated", "emulated, no hardware" if scheme == "emulated" else url)]
    if talk is not None and scheme != "replay" and all(check.ok for check in checks):
        checks += _heard(talk)
    checks += log_checks(machine, array, logs, rate_hz)
    return [check._replace(advice="") if check.ok else check for check in checks]


def _heard(talk: Callable[[], list[Check]]) -> list[Check]:
    try:
        return talk()
    except ImuArrayError as error:
        return [Check("opening", False, str(error), "end the other program, or see the lines above")]
    except OSError as error:
        held = error.errno in (errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY)
        advice = "somebody holds a wire low: unplug sensors one by one" if held else "look at wires and supply"
        return [Check("talking", False, f"{error.strerror or error} (errno {error.errno})", advice)]


def serial_checks(machine: Machine, device: str) -> list[Check]:
    """A microcontroller's port: is it there, may it be opened, does another program talk to it?"""
    folder = machine.path("/dev")
    there = sorted(f"/dev/{path.name}" for kind in ("ttyACM*", "ttyUSB*") for path in folder.glob(kind))
    if not device or not machine.path(device).exists():
        found = f"{device or 'no port named'}; there are {', '.join(there) or 'none'}"
        return [Check("port", False, found, "plug it in with a cable that carries data; dmesg tells its name")]
    checks = [Check("port", True, device), permission(machine, device)]
    names = (path.read_text(errors="replace").strip() for path in machine.path("/proc").glob("[0-9]*/comm"))
    if "ModemManager" in names:
        advice = "it talks to every new port for some seconds: sudo systemctl disable --now ModemManager"
        checks.append(Check("ModemManager", False, "is running", advice))
    return checks
