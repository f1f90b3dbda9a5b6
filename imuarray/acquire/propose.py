"""Proposes a configuration for the chips that answered on a bus; `calibrate axes` determines the directions of their
axes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import tomli_w

from imuarray.acquire.detect import MUX, Detection
from imuarray.array import IIO, SensorConfig
from imuarray.bus.protocol import Bus, OpenBus, Pca9544a
from imuarray.chips import CHIPS, HALVES
from imuarray.drivers import DRIVERS
from imuarray.errors import SensorError
from imuarray.printable import printable

_ALIKE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"hmc5883 or hmc5883l": ("hmc5883l", "hmc5883"), "ak8963 or ak8975": ("ak8963", "ak8975")}
)
"""Chips that say the same of themselves, the more common one first; what tells them apart is their self-test."""
_REMARKS = {
    "hmc5883 or hmc5883l": "or hmc5883, with range = 1.2: they identify themselves alike; --self-test fails for one",
    "ak8963 or ak8975": "or ak8975 (of an MPU-9150), with range = 12.29: they identify themselves alike",
}
"""Comment in the proposed file, by the chip that was identified."""

_HEAD = """\
# The chips that answered on {bus}. Settings can be changed; an error lists the allowed ones.
# `imuarray calibrate axes` determines the axes from three poses held by hand; without it, axes are "+X+Y+Z".

[array]
"""


def tell_apart(detections: Sequence[Detection], bus: OpenBus) -> list[Detection]:
    """Distinguish chips with the same identity by which of their self-tests they pass; chips that pass none, or can't
    be asked often enough, keep their identity. Their settings are lost.
    """
    mux = next((line.address for line in detections if line.found == MUX), None)
    return [replace(line, found=_passing(line, mux, bus) or line.found) for line in detections]


def _passing(line: Detection, mux: int | None, bus: OpenBus) -> str | None:
    """Return the chip, among those with the same identity, whose self-test this one passes."""
    if line.address is None:
        return None
    segment: Bus = bus if line.channel is None or mux is None else Pca9544a(bus, mux).channel(line.channel)
    for chip in _ALIKE.get(line.found, ()):
        sensor = SensorConfig(name="Unknown", chip=chip, address=line.address, **CHIPS[chip].proposed)
        try:
            if DRIVERS[chip](segment, sensor, bus.clock).self_test().passed:
                return chip
        except (OSError, SensorError):
            continue
    return None


def propose(detections: Sequence[Detection], bus: str, name: str = "array") -> str:
    """Return the text of a configuration for the detections of `explore`; SensorError if there is no known chip."""
    devices = [line for line in detections if line.rates_hz]
    if devices or bus.startswith(IIO):
        return _propose_devices(devices, bus, name)
    chips = [
        (chip, line)
        for line in detections
        if line.found != MUX and not line.owner
        for chip in HALVES.get(line.found, _ALIKE.get(line.found, (line.found,))[:1])
    ]
    if not chips:
        advice = f"try `imuarray detect --bus {printable(bus)} --doctor`"
        raise SensorError(f"{bus}: no chip answered, so there is nothing to configure; {advice}")
    text = _HEAD.format(bus=printable(bus)) + tomli_w.dumps({"name": name, "bus": bus})
    text += "".join(
        f'mux = {{ chip = "{MUX}", address = {line.address:#04x} }}\n' for line in detections if line.found == MUX
    )
    counts = Counter(chip for chip, _ in chips)
    numbers: Counter[str] = Counter()
    for chip, line in chips:
        spec = CHIPS[chip]
        numbers[spec.label] += 1
        lone = counts[chip] == 1 and spec.quantity == "pressure"
        number = chip.removeprefix("bmp") if lone else str(numbers[spec.label])
        text += _sensor(spec.label.format(number), chip, line, spec.proposed)
    return text


_SUFFIXES = MappingProxyType({"specific_force": "acc", "angular_rate": "gyro", "magnetic_field": "mag"})
_POLLED_HZ = 50.0
"""Data rate that is proposed for a device whose driver has none: that of the frames."""
_DEVICES_HEAD = """\
# The devices that the kernel exposes on {bus}. `range` selects another scale. With `fifo = true` every sample comes
# from the kernel's buffer, if the device has one. Without `axes`, those of the device's mounting matrix are used.

[array]
"""


def _propose_devices(devices: Sequence[Detection], bus: str, name: str) -> str:
    """Return a configuration of the triads of kernel devices; SensorError if there is none."""
    if not devices:
        raise SensorError(f"{bus}: the kernel serves no accelerometer, gyroscope or magnetometer: nothing to configure")
    text = _DEVICES_HEAD.format(bus=printable(bus)) + tomli_w.dumps({"name": name, "bus": bus})
    for number, line in enumerate(devices, 1):
        for quantity, rate_hz in line.rates_hz.items():
            chip = line.place.removeprefix(IIO).partition("@")[0]
            table = {"name": f"IIO{number}_{_SUFFIXES[quantity]}", "chip": chip, "quantity": quantity}
            text += "\n[[sensor]]\n" + tomli_w.dumps({**table, "bus": line.place, "rate_hz": rate_hz or _POLLED_HZ})
    return text


def _sensor(name: str, chip: str, line: Detection, settings: Mapping[str, Any]) -> str:
    """Return the text of one [[sensor]] table."""
    place = "" if line.channel is None else f"channel = {line.channel}\n"
    own = "".join(f"{key} = {value}\n" for key, value in settings.items())
    remark = f"  # {_REMARKS[line.found]}" if line.found in _REMARKS else ""
    return f'\n[[sensor]]\nname = "{name}"\nchip = "{chip}"{remark}\n{place}address = {line.address:#04x}\n{own}'
