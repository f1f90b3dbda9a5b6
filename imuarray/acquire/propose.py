"""A configuration of what answered on a bus, ready to log with; `calibrate axes` finds which way sensors point."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import tomli_w

from imuarray.acquire.detect import MUX, Found
from imuarray.errors import SensorError
from imuarray.printable import printable

_SETTINGS: Mapping[str, tuple[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "adxl345": ("ADXL", {"range": 16, "rate_hz": 400}),  # at 1600 Hz and above only even codes come: ADX-47
        "bma180": ("BMA", {"range": 4, "bandwidth_hz": 150}),
        "l3g4200d": ("Gyro", {"range": 500, "rate_hz": 400, "bandwidth_hz": 50}),
        "bmp180": ("BMP", {}),
        "hmc5883l": ("HMC", {"range": 1.3, "rate_hz": 15}),
    }
)
"""By chip: how its sensors are called, and settings that a hand-held or driven box can live with."""

_TOLD_BY_NAME = {"hmc5883 or hmc5883l": "hmc5883l"}
"""Both say the same of themselves; nearly all that are sold are the later one."""
_REMARKS = {"hmc5883l": "or hmc5883, with range = 1.2: they identify themselves alike; if --self-test fails, try that"}
"""By chip: what stands beside it in the file."""

_HEAD = """\
# What answered on {bus}. Settings can be changed: each chip's are named when one is refused.
# Axes: `imuarray calibrate axes` finds them from three poses held by hand; without a line of axes they are "+X+Y+Z".

[array]
"""


def propose(found: Sequence[Found], bus: str, name: str = "array") -> str:
    """A configuration's text from what `explore` found on a bus; SensorError if there was no chip that we know."""
    chips = [(_TOLD_BY_NAME.get(line.found, line.found), line) for line in found if line.found != MUX]
    if not chips:
        advice = f"try `imuarray detect --bus {printable(bus)} --doctor`"
        raise SensorError(f"{bus}: no chip answered, nothing to write a configuration of; {advice}")
    text = _HEAD.format(bus=printable(bus)) + tomli_w.dumps({"name": name, "bus": bus})
    text += "".join(
        f'mux = {{ chip = "{MUX}", address = {line.address:#04x} }}\n' for line in found if line.found == MUX
    )
    counts = Counter(chip for chip, _ in chips)
    numbers: Counter[str] = Counter()
    for chip, line in chips:
        numbers[chip] += 1
        prefix, settings = _SETTINGS[chip]
        number = str(numbers[chip]) if counts[chip] > 1 or chip != "bmp180" else "180"
        text += _sensor(f"{prefix}{number}", chip, line, settings)
    return text


def _sensor(name: str, chip: str, line: Found, settings: Mapping[str, Any]) -> str:
    """One [[sensor]] table."""
    place = "" if line.channel is None else f"channel = {line.channel}\n"
    own = "".join(f"{key} = {value}\n" for key, value in settings.items())
    remark = f"  # {_REMARKS[chip]}" if chip in _REMARKS else ""
    return f'\n[[sensor]]\nname = "{name}"\nchip = "{chip}"{remark}\n{place}address = {line.address:#04x}\n{own}'
