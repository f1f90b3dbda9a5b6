"""A schedule of faults of the emulated array, from a TOML file.

``emulated:?faults=night.toml`` applies it. Each fault is a table; times are seconds since the array was powered on::

    [[fault]]
    kind = "unplugged"     # see FAULTS
    sensor = "BMA2"        # the affected sensor; not for faults of the bus
    at_s = 600.0
    for_s = 5.0            # its duration; an instantaneous fault has none
    every_s = 60.0         # the period of its repetition; without it: once
    times = 10             # the number of occurrences; without it: unlimited
    until_set_up = true    # frozen, stale, start_up: ends as soon as the program configures the chip
    channel = 1            # wrong_channel: the connected channel; without it: the previous one
    reads_right = true     # wrong_channel: the control byte nevertheless reads back as written
    bias = [4.0, 0.0, 0.0] # start_up: the error of the bias after power-up, in g, dps or gauss

The file does not state how the program that reads the array should respond.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from firmware_emulator.board import ArrayLike, allowed_text
from firmware_emulator.faulty_parts import LAYOUTS, TEARS, Times

CHIP_FAULTS = MappingProxyType(
    {
        "no_acknowledge": "silent",
        "unplugged": "unplugged",
        "reset": "reset",
        "torn": "torn",
        "frozen": "frozen",
        "stale": "stale",
        "start_up": "start_up",
        "kernel_driver": "owned",
        "clock_held": "hangs",
    }
)
"""Faults of one sensor: it does not acknowledge; it is unplugged and plugged in again; it resets to its defaults; it
loses the setting that keeps the bytes of a reading together; it repeats a reading, as a new one or as an old one; it
starts with another bias; a driver of the kernel takes its address; it holds the clock whenever it is addressed.
"""
BUS_FAULTS = ("stuck_bus", "wrong_channel", "mux_reset", "stall", "adapter_unplugged")
"""Faults of all sensors: a device holds a wire; the multiplexer ignores a command, or loses the last one; the program
is not run; the adapter, which supplies the chips, is unplugged and plugged in again.
"""
FAULTS = (*CHIP_FAULTS, *BUS_FAULTS)
MOMENTARY = ("reset", "torn", "mux_reset")
TRIADS = ("frozen", "stale", "start_up")
OWN_KEYS = MappingProxyType(
    {
        "until_set_up": TRIADS,
        "channel": ("wrong_channel",),
        "reads_right": ("wrong_channel",),
        "bias": ("start_up",),
    }
)
FOR_GOOD_S = 1e9
KEYS = ("kind", "sensor", "at_s", "for_s", "every_s", "times", *OWN_KEYS)


@dataclass(frozen=True)
class Fault:
    """One table of the file."""

    kind: str
    times: Times
    sensor: str = ""
    until_set_up: bool = False
    channel: int | None = None
    reads_right: bool = False
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)


def read_faults(path: str, array: ArrayLike) -> tuple[Fault, ...]:
    """Return the faults in the file at `path`; ValueError (one line) if it is unreadable or does not fit this array."""
    try:
        text = Path(path).read_text(encoding="utf-8")
        tables = tomllib.loads(text)
    except OSError as error:
        raise ValueError(f"faults={path}: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(f"faults={path}: not TOML: {error}") from None
    return faults_from(tables, array, text, path)


_HEADER = re.compile(r"\s*\[\[\s*fault\s*\]\]")


def _line_of(text: str, number: int, key: str) -> int:
    """Return the line of a key of fault `number`, or that of its header; 0 if neither exists."""
    lines = text.splitlines()
    headers = [place for place, line in enumerate(lines) if _HEADER.match(line)]
    if number > len(headers):
        return 0
    start, end = headers[number - 1], [*headers, len(lines)][number]
    of_key = (place for place in range(start, end) if re.match(rf"\s*{re.escape(key)}\s*=", lines[place]))
    return next(of_key, start) + 1


def faults_from(tables: Mapping[str, Any], array: ArrayLike, text: str = "", path: str = "") -> tuple[Fault, ...]:
    """Return the faults of a parsed file; ValueError as `read_faults`, with the line if the file's `text` is given."""
    listed = tables.get("fault", [])
    if set(tables) - {"fault"} or not isinstance(listed, list) or not all(isinstance(table, dict) for table in listed):
        raise ValueError("faults: allowed are tables [[fault]] only")
    faults = []
    for number, table in enumerate(listed, 1):
        try:
            faults.append(_fault(table, array))
        except ValueError as error:
            line = _line_of(text, number, str(error).partition(" ")[0].strip(":"))
            raise ValueError(f"{f'{path}:{line}: ' if line else ''}fault {number}: {error}") from None
    return tuple(faults)


def _fault(table: Mapping[str, Any], array: ArrayLike) -> Fault:
    kind = table.get("kind")
    if kind not in FAULTS:
        raise ValueError(f"kind {kind!r}; {allowed_text(str(kind), FAULTS)}")
    for key in table:
        if key not in KEYS or kind not in OWN_KEYS.get(key, (kind,)):
            allowed_keys = [key_name for key_name in KEYS if kind in OWN_KEYS.get(key_name, (kind,))]
            raise ValueError(f"{key}: no such key of {kind}; {allowed_text(key, allowed_keys)}")
    sensor = _sensor(kind, table.get("sensor", ""), array)
    if kind in ("wrong_channel", "mux_reset") and array.mux is None:
        raise ValueError(f"{kind}: array {array.name} has no multiplexer")
    length_s = 0.0 if kind in MOMENTARY else _seconds(table, "for_s", FOR_GOOD_S if kind == "start_up" else None)
    every_s = _seconds(table, "every_s", 0.0)
    times = _whole(table, "times", 0 if every_s else 1, 1_000_000_000)
    return Fault(
        kind,
        Times(round(_seconds(table, "at_s", 0.0) * 1e9), round(length_s * 1e9), round(every_s * 1e9), times),
        sensor,
        _switch(table, "until_set_up"),
        _whole(table, "channel", 0, 3) if "channel" in table else None,
        _switch(table, "reads_right"),
        _triple(table.get("bias", [0.0, 0.0, 0.0])),
    )


def _sensor(kind: str, name: Any, array: ArrayLike) -> str:
    if kind in BUS_FAULTS:
        if name:
            raise ValueError(f"sensor: {kind} concerns the whole array; leave it out")
        return ""
    chips = {sensor.name: sensor.chip for sensor in array.sensors}
    able = TEARS if kind == "torn" else LAYOUTS if kind in TRIADS else set(chips.values())
    sensors = [sensor_name for sensor_name, chip in chips.items() if chip in able]
    if name not in sensors:
        raise ValueError(f"sensor {name!r} for {kind}; allowed are {', '.join(sensors) or 'none of this array'}")
    return str(name)


def _seconds(table: Mapping[str, Any], key: str, default: float | None) -> float:
    value = table.get(key, default)
    if value is None:
        raise ValueError(f"{key} is missing; a number of seconds is required")
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= FOR_GOOD_S:
        raise ValueError(f"{key} = {value!r}; a number of seconds is required")
    return float(value)


def _whole(table: Mapping[str, Any], key: str, default: int, largest: int) -> int:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= largest:
        raise ValueError(f"{key} = {value!r}; allowed is a whole number up to {largest}")
    return value


def _switch(table: Mapping[str, Any], key: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise ValueError(f"{key} = {value!r}; allowed are true and false")
    return value


def _triple(value: Any) -> tuple[float, float, float]:
    if not (isinstance(value, list) and len(value) == 3 and all(isinstance(number, int | float) for number in value)):
        raise ValueError(f"bias = {value!r}; three numbers are required")
    return float(value[0]), float(value[1]), float(value[2])
