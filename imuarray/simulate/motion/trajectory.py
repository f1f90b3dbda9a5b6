"""Motions given row by row and smooth in between: the path of a box, or its force and rate; from arrays or a text file.

The file is comma-separated, with one header row and times in seconds; lines that begin with # are comments::

    time_s                                            increasing; the first row becomes time 0
    x_m, y_m, z_m                                     place in a level frame, z up, and its attitude:
        roll_deg, pitch_deg, yaw_deg                      Rz(yaw) Ry(pitch) Rx(roll), or
        qw, qx, qy, qz                                    vector_level = R(q) vector_box
    force_x_mps2, force_y_mps2, force_z_mps2          or the stimulus along the axes of the box:
        rate_x_dps, ...  or  rate_x_radps, ...            specific force, and angular rate
    temperature_degc                                  optional; 25 without
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imuarray.arrays import Floats, Integers, Reals
from imuarray.errors import SourceError
from imuarray.log.format import Phase
from imuarray.simulate.motion.faces import AIR_PRESSURE_PA, FIELD_LEVEL, GRAVITY_LEVEL, PA_PER_M, ROOM_DEGC
from imuarray.simulate.motion.stimulus import BoxStimulus
from imuarray.splines import cubic_spline
from imuarray.units import SI_PER_UNIT

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    from imuarray.importers.cells import CellColumn


@dataclass(frozen=True, eq=False)
class _TrajectoryRows:
    """Rows at `time_ns` (n,), the first at 0, and `temperature_degc` (n,); one phase, motion."""

    time_ns: Integers
    temperature_degc: Floats

    @property
    def phases(self) -> tuple[Phase, ...]:
        return (Phase(0, int(self.time_ns[-1]), "motion"),)

    @property
    def seconds(self) -> float:
        return int(self.time_ns[-1]) * 1e-9

    @property
    def _row_s(self) -> Reals:
        return self.time_ns * 1e-9

    def _within_s(self, time_ns: Integers) -> Reals:
        """Return the times (n,), limited to those of the first and the last row."""
        return np.clip(time_ns, 0, self.time_ns[-1]) * 1e-9

    def _temperature_degc(self, seconds: Reals) -> Reals:
        return np.interp(seconds, self._row_s, self.temperature_degc)


@dataclass(frozen=True, eq=False)
class Trajectory(_TrajectoryRows):
    """Position `place_m` (n, 3) in the level frame and `attitudes` (n, from the box to the level frame), joined by
    cubic splines (a rotation spline for the attitude: angular acceleration without jumps).

    Less than half a turn may lie between one row and the next. Temperature is linear between rows.
    """

    place_m: Floats
    attitudes: Rotation

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimulus from the second derivatives of position and attitude."""
        if len(time_ns) == 0:  # zero rotations are an error in SciPy below 1.16
            first = self.stimulus(np.zeros(1, np.int64))
            return BoxStimulus(*(getattr(first, item.name)[:0] for item in fields(BoxStimulus)))
        seconds = self._within_s(time_ns)
        to_box = self.attitude(time_ns).inv()
        return BoxStimulus(
            time_ns,
            to_box.apply(self._place(seconds, 2) + GRAVITY_LEVEL),
            self._attitude(seconds, 1),
            self._attitude(seconds, 2),
            to_box.apply(FIELD_LEVEL),
            self._temperature_degc(seconds),
            AIR_PRESSURE_PA - PA_PER_M * self._place(seconds)[:, 2],
        )

    def position(self, time_ns: Integers) -> Reals:
        """Return (n, 3) of the box's origin in the level frame, in m."""
        return np.asarray(self._place(self._within_s(time_ns)))

    def attitude(self, time_ns: Integers) -> Rotation:
        """Return n rotations from the box to the level frame."""
        return self._attitude(self._within_s(time_ns))

    @cached_property
    def _place(self) -> CubicSpline:
        return cubic_spline(self._row_s, self.place_m)

    @cached_property
    def _attitude(self) -> RotationSpline:
        from scipy.spatial.transform import RotationSpline  # imported late because SciPy takes long to load

        return RotationSpline(self._row_s, self.attitudes)


@dataclass(frozen=True, eq=False)
class StimulusRows(_TrajectoryRows):
    """Specific force `force_box` (n, 3) in m/s2 and angular rate `rate_box` (n, 3) in rad/s, joined by cubic splines.

    Attitude and height are not known: field and pressure are those of a box that stands upright.
    """

    force_box: Floats
    rate_box: Floats

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return interpolated rows; the angular acceleration is the derivative of the rate."""
        seconds = self._within_s(time_ns)
        return BoxStimulus(
            time_ns,
            self._force(seconds),
            self._rate(seconds),
            self._rate(seconds, 1),
            np.broadcast_to(FIELD_LEVEL, (len(time_ns), 3)),
            self._temperature_degc(seconds),
            np.broadcast_to(AIR_PRESSURE_PA, (len(time_ns),)),
        )

    @cached_property
    def _force(self) -> CubicSpline:
        return cubic_spline(self._row_s, self.force_box)

    @cached_property
    def _rate(self) -> CubicSpline:
        return cubic_spline(self._row_s, self.rate_box)


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

_UNIT_WITHIN = 0.01
_LARGEST = 1e9
"""Limit of the magnitude of positions, angles and forces; it prevents overflow in splines."""


class _Cells(NamedTuple):
    """A file's columns by name, with the line of every row."""

    source: str
    lines: tuple[int, ...]
    text: dict[str, tuple[str, ...]]

    def column(self, name: str) -> CellColumn:
        from imuarray.importers.cells import CellColumn  # importers are loaded only if a file is read

        return CellColumn(self.source, name, self.lines, self.text[name])

    def numbers(self, *names: str) -> Floats:
        """Return (n, number of names) values; SourceError for a cell that is not a number."""
        return np.array([[_number(self.column(name), row) for name in names] for row in range(len(self.lines))])


def load_trajectory(path: str | PathLike[str]) -> Trajectory | StimulusRows:
    """Return the motion that the file describes; SourceError, in one line, names the unreadable line and column."""
    from imuarray.importers.cells import TimeColumn  # importers are loaded only if a file is read

    cells = _read(Path(path))
    layout = _layout(cells)
    time_ns = TimeColumn("s").nanoseconds(cells.column(TIME))
    time_ns = time_ns - time_ns[0]
    degc = cells.numbers(TEMPERATURE)[:, 0] if TEMPERATURE in cells.text else np.full(len(time_ns), ROOM_DEGC)
    if layout[:3] == FORCE:
        factor = SI_PER_UNIT["dps"] if layout[3:] == RATE_DPS else 1.0
        return StimulusRows(time_ns, degc, cells.numbers(*FORCE), cells.numbers(*layout[3:]) * factor)
    return Trajectory(time_ns, degc, cells.numbers(*PLACE), _attitudes(cells))


def _read(path: Path) -> _Cells:
    """Return the whole file; SourceError unless it is a table of at least two rows."""
    from imuarray.importers.cells import TextTable  # importers are loaded only if a file is read
    from imuarray.importers.mapping import FileTable

    try:
        file = path.open("rb")
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from None
    with file:
        table = TextTable(file, str(path), FileTable(), named=True)
        names = table.names
        blocks = list(table.blocks())
    for name in names:
        table.index(name)  # raises SourceError for a name that occurs twice
    lines = tuple(line for block in blocks for line in block.lines)
    if len(lines) < 2:
        raise SourceError(f"{path}: {len(lines)} data rows; at least two below a header row are required")
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
    """Return attitudes from angles or quaternions; SourceError for an invalid quaternion."""
    from scipy.spatial.transform import Rotation  # imported late because SciPy takes long to load

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


def _number(column: CellColumn, row: int) -> float:
    try:
        value = float(column.texts[row])
    except ValueError:
        value = math.nan
    if not abs(value) <= _LARGEST:
        raise column.refuse(row, f"{column.texts[row][:40]!r} is not a number between {-_LARGEST:g} and {_LARGEST:g}")
    return value
