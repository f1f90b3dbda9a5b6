"""A motion from a text file: comma-separated, one header row, times in seconds.

::

    time_s                                            increasing; the first row becomes time 0
    x_m, y_m, z_m                                     place in a level frame, z up, and its attitude:
        roll_deg, pitch_deg, yaw_deg                      Rz(yaw) Ry(pitch) Rx(roll), or
        qw, qx, qy, qz                                    vector_level = R(q) vector_box
    force_x_mps2, force_y_mps2, force_z_mps2          or what the box felt, along its own axes:
        rate_x_dps, ...  or  rate_x_radps, ...            specific force, and angular rate
    temperature_degc                                  optional; 25 without

Lines that begin with # are comments.
"""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import SourceError
from imuarray.importers.cells import Column, Table, nanoseconds
from imuarray.importers.mapping import FileTable
from imuarray.simulate.motion.trajectory import FeltRows, Trajectory
from imuarray.units import SI_PER_UNIT

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

TIME = "time_s"
PLACE = ("x_m", "y_m", "z_m")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
FORCE = ("force_x_mps2", "force_y_mps2", "force_z_mps2")
RATE_DPS = ("rate_x_dps", "rate_y_dps", "rate_z_dps")
RATE = ("rate_x_radps", "rate_y_radps", "rate_z_radps")
TEMPERATURE = "temperature_degc"

LAYOUTS = (PLACE + ANGLES, PLACE + QUATERNION, FORCE + RATE_DPS, FORCE + RATE)
"""The columns of a file besides its times."""

ROOM_DEGC = 25.0
_UNIT_WITHIN = 0.01
_LARGEST = 1e9
"""No place, angle or force is further from 0; keeps splines from running over."""


class _Cells(NamedTuple):
    """A file's columns by name, with the line of every row."""

    source: str
    lines: tuple[int, ...]
    text: dict[str, tuple[str, ...]]

    def column(self, name: str) -> Column:
        return Column(self.source, name, self.lines, self.text[name])

    def numbers(self, *names: str) -> Floats:
        """(n, number of names); SourceError for a cell that is not a number."""
        return np.array([[_number(self.column(name), row) for name in names] for row in range(len(self.lines))])


def load_trajectory(path: str | PathLike[str]) -> Trajectory | FeltRows:
    """The motion that the file describes; SourceError, one line, names the line and column that can't be read."""
    cells = _read(Path(path))
    layout = _layout(cells)
    time_ns = nanoseconds(cells.column(TIME), 1_000_000_000, None)
    time_ns = time_ns - time_ns[0]
    degc = cells.numbers(TEMPERATURE)[:, 0] if TEMPERATURE in cells.text else np.full(len(time_ns), ROOM_DEGC)
    if layout[:3] == FORCE:
        factor = SI_PER_UNIT["dps"] if layout[3:] == RATE_DPS else 1.0
        return FeltRows(time_ns, degc, cells.numbers(*FORCE), cells.numbers(*layout[3:]) * factor)
    return Trajectory(time_ns, degc, cells.numbers(*PLACE), _attitudes(cells))


def _read(path: Path) -> _Cells:
    """The whole file; SourceError unless it is a table of two rows or more."""
    try:
        file = path.open("rb")
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    with file:
        table = Table(file, str(path), FileTable(), named=True)
        names = table.names
        blocks = list(table.blocks())
    for name in names:
        table.index(name)  # refuses a name that comes twice
    lines = tuple(line for block in blocks for line in block.lines)
    if len(lines) < 2:
        raise SourceError(f"{path}: {len(lines)} data rows; a motion has two at least, below a header row")
    columns = [tuple(text for block in blocks for text in block.columns[index]) for index in range(len(names))]
    return _Cells(str(path), lines, dict(zip(names, columns, strict=True)))


def _layout(cells: _Cells) -> tuple[str, ...]:
    """Return the layout of the columns; SourceError unless they are exactly one of `LAYOUTS`."""
    columns = cells.text.keys() - {TIME, TEMPERATURE}
    for layout in LAYOUTS:
        if columns == set(layout) and TIME in cells.text:
            return layout
    choice = " or ".join(", ".join(layout) for layout in LAYOUTS)
    header = repr(", ".join(cells.text))[:200]
    raise SourceError(
        f"{cells.source}: header {header}: allowed are {TIME} with {choice}; {TEMPERATURE} if it is known"
    )


def _attitudes(cells: _Cells) -> Rotation:
    """From angles or quaternions; SourceError for a quaternion that is none."""
    from scipy.spatial.transform import Rotation  # its weight is for those who turn anything

    if ANGLES[0] in cells.text:
        return Rotation.from_euler("ZYX", cells.numbers(*ANGLES[::-1]), degrees=True)
    numbers = cells.numbers(*QUATERNION)
    length = np.linalg.norm(numbers, axis=1)
    wrong = np.abs(length - 1) > _UNIT_WITHIN
    if wrong.any():
        row = int(np.argmax(wrong))
        raise SourceError(
            f"{cells.source}: line {cells.lines[row]}: qw, qx, qy, qz have length {length[row]:.4g}; 1 is required"
        )
    return Rotation.from_quat(np.roll(numbers, -1, axis=1))


def _number(column: Column, row: int) -> float:
    try:
        value = float(column.texts[row])
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:
        raise column.refuse(row, f"{column.texts[row][:40]!r} is not a number between {-_LARGEST:g} and {_LARGEST:g}")
    return value
