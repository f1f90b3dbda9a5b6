"""Mechanisms from the parameters of a bus URL.

``emulated:?units=drawn&seed=7&mechanism=mains_ripple,log_creep&severity=2,1&sensor=Gyro1|Gyro2,BMA1&run=3``: lists are
separated by commas, with one entry for each mechanism. The sensors of one mechanism are separated by ``|``; an empty
entry means all on which it can act.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from firmware_emulator.array import number, whole_number
from firmware_emulator.board import named
from firmware_emulator.mechanisms import MECHANISMS
from firmware_emulator.mechanisms.mechanism import FittedBoard, Fitting, sites_of

if TYPE_CHECKING:
    from firmware_emulator.board import ArrayLike, BoardKind
    from firmware_emulator.world import World


def fittings_from(query: Mapping[str, str], array: ArrayLike) -> tuple[Fitting, ...]:
    """Return the mechanisms of the parameters `mechanism`, `severity` and `sensor`; ValueError if one is impossible."""
    names = split(query.get("mechanism", ""), ",")
    severities = split(query.get("severity", ""), ",") or ["1"] * len(names)
    groups = split(query.get("sensor", ""), ",") or [""] * len(names)
    if not len(names) == len(severities) == len(groups):
        raise ValueError("mechanism, severity, sensor: allowed are lists of equal length")
    return tuple(
        fitting_of(array, name, number("severity", severity), tuple(split(group, "|")))
        for name, severity, group in zip(names, severities, groups, strict=True)
    )


def fitting_of(array: ArrayLike, name: str, severity: float, sensors: tuple[str, ...] = ()) -> Fitting:
    """Return one mechanism on these sensors, or on all on which it can act; ValueError for an impossible name, severity
    or sensor.
    """
    if not severity > 0:
        raise ValueError(f"severity={severity}; allowed is anything above 0")
    mechanism = named(name, MECHANISMS, "mechanism").at(severity)
    fitting = Fitting(mechanism, sensors or mechanism.wherever(array.sensors))
    sites_of(array, fitting)
    return fitting


def board_from(query: Mapping[str, str], array: ArrayLike) -> BoardKind:
    """Return the kind of board of the query."""
    fittings = fittings_from(query, array)
    run, units = whole_number(query, "run", 0), query.get("units", "paper")

    def board(name: str, world: World, seed: int) -> FittedBoard:
        return FittedBoard(array, world, seed, fittings, run=run, units=units)

    return board


def split(text: str, separator: str) -> list[str]:
    """Return the parts of a list; an empty text has no parts."""
    return text.split(separator) if text else []
