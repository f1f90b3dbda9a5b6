"""Recordings in closed form, in the text formats of other programs."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

G = 9.80665
ROWS = 2000
PER_G, PER_DPS = 4096.0, 131.0


class Walk(NamedTuple):
    """Specific force and angular rate of a box that turns slowly to and fro about two axes: s, g, dps."""

    time_s: np.ndarray
    force_g: np.ndarray
    rate_dps: np.ndarray


@cache
def walk(rows: int = ROWS, rate_hz: float = 100.0, still: bool = False) -> Walk:
    """Noise of 5 mg and 0.1 dps; turns of up to 60 degrees, in closed form, in the second half."""
    rng = np.random.default_rng(22)
    time_s = np.arange(rows) / rate_hz
    begin_s = time_s[rows // 2]
    phase = np.where(time_s < begin_s, 0.0, 0.8 * (time_s - begin_s)) * (not still)
    angle = np.radians(60) * np.sin(phase) ** 2
    rate = np.radians(60) * np.sin(2 * phase) * np.where(time_s < begin_s, 0.0, 0.8) * (not still)
    # About x: gravity, up along +Z at first, turns in the y-z plane, df/dt = -omega x f.
    force = np.stack([0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    turn = np.stack([rate, 0 * rate, 0 * rate], axis=1)
    return Walk(time_s, force + rng.normal(0, 5e-3, force.shape), np.degrees(turn) + rng.normal(0.3, 0.1, turn.shape))


def counts_of(recording: Walk) -> np.ndarray:
    """(n, 6) integers."""
    return np.rint(np.hstack([recording.force_g * PER_G, recording.rate_dps * PER_DPS])).astype(int)


def lines_of(time_s: np.ndarray, values: np.ndarray, form: str = "{:g}") -> list[str]:
    line = ",".join(["{:.6f}", *[form] * values.shape[1]])
    return [line.format(stamp, *row) for stamp, row in zip(time_s.tolist(), values.tolist(), strict=True)]


def joined(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()


def several_tables() -> bytes:
    """Rows of a gyroscope, and of an accelerometer at half its rate, each with its own time."""
    recording, rows = walk(), counts_of(walk())
    lines = []
    for number in range(ROWS):
        stamp = f"{recording.time_s[number]:.6f}"
        lines.append(f"GYR,{stamp}," + ",".join(map(str, rows[number, 3:].tolist())))
        if number % 2 == 0:
            lines.append(f"ACC,{stamp}," + ",".join(map(str, rows[number, :3].tolist())) + ",checked")
    return joined(lines)
