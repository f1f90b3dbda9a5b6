"""A printed number, its recomputation and its simulated twin side by side, as text for the paper's page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor, isfinite, log10
from typing import TYPE_CHECKING

from imuarray.paper.cells import Cell, RecomputedRow
from imuarray.paper.tables import Row, table

if TYPE_CHECKING:
    from imuarray.paper.replica import Statistic

HEADING = ("channel", "statistic", "paper", "recomputed", "simulated", "difference", "z")
MARKED_Z = 2.0
"""From here on a z is marked."""

Key = tuple[str, str]
"""Channel and statistic."""
Recomputed = Mapping[str, Sequence[RecomputedRow]]
"""`imuarray.paper.results.recomputed_rows()`."""

NOTHING = "–"
"""What stands where there is no number."""
_DECIMALS = 6
_PRINTED_DECIMALS = 4
"""The most that the text prints."""
_RUNS = {6: "BMA1", 7: "Gyro3"}


@dataclass(frozen=True)
class Line:
    """One number of a table: as printed, its recomputation and its simulated twin as far as there are such."""

    channel: str
    statistic: str
    printed: str
    cell: Cell | None
    twin: Statistic | None

    @property
    def marked(self) -> bool:
        """Whether the simulation is far off."""
        return self.twin is not None and abs(self.twin.z) > MARKED_Z

    def texts(self) -> list[str]:
        """The cells under `HEADING`."""
        recomputed = NOTHING if self.cell is None else recomputed_text(self.cell, self.printed)
        return [self.channel, self.statistic, self.printed, recomputed, *_simulated(self.twin, self.printed)]


def lines_of(name: str, recomputed: Recomputed, twins: Sequence[Statistic]) -> list[Line]:
    """Every number of "Table 3": channel by channel, what was only recomputed after what was simulated."""
    cells = dict(_cells(name, recomputed))
    by_key = {(twin.channel, twin.statistic): twin for twin in twins}
    channels = list(dict.fromkeys(channel for channel, _ in (*by_key, *cells)))
    keys = sorted(dict.fromkeys((*by_key, *cells)), key=lambda key: channels.index(key[0]))
    texts = _texts(int(name.removeprefix("Table ")))
    return [Line(*key, _text(key, texts, by_key.get(key)), cells.get(key), by_key.get(key)) for key in keys]


def line_of(twin: Statistic) -> Line:
    """A number of a figure or of the text."""
    return Line(twin.channel, twin.statistic, _in_digits(twin), None, twin)


def _texts(number: int) -> dict[Key, str]:
    """Every number of a table as it is printed."""
    if number in _RUNS:
        return {
            (f"{_RUNS[number]} {axis}", f"run {row['run']}"): row[column]
            for row in table(number)
            for axis, column in zip("xyzt", ("x_lsb", "y_lsb", "z_lsb", "temp_int"), strict=True)
        }
    rows = table(number)
    texts = {(_channel(row), column): text for row in rows for column, text in row.items()}
    if number == 9:  # the two rows of the thermometer are told apart by the half that they stand in
        for index, row in enumerate(rows):
            name = "250dps" if 2 * index < len(rows) else "2k dps"
            texts |= {(f"{row['output']} {name}", column): text for column, text in row.items()}
    return texts


def _text(key: Key, texts: Mapping[Key, str], twin: Statistic | None) -> str:
    """As printed, without its sign where only the size is compared."""
    text = texts.get(key, "")
    if twin is None:
        return text
    return text.removeprefix("-") if text and twin.published >= 0 else text or _in_digits(twin)


def _in_digits(twin: Statistic) -> str:
    """A number that stands in no table; a quotient of printed ones in as many digits as its uncertainty has."""
    few = _decimals(twin.published) <= _PRINTED_DECIMALS
    return plain(twin.published if few else round(twin.published, _places(twin, "")))


def _cells(name: str, recomputed: Recomputed) -> Iterator[tuple[Key, Cell]]:
    for row in recomputed[name.lower().replace(" ", "")]:
        yield from (((_channel(row.row), cell.column), cell) for cell in row.cells)
    for row in recomputed["derived"]:
        if row.row["table"] == name:
            yield from (((row.row["channel"], cell.column), cell) for cell in row.cells)


def _channel(row: Row) -> str:
    """What a row is of; Tables 2 and 9 have two of each axis."""
    if "output" in row:
        return f"{row['output']} {row['range'] if row['range'] != 'int' else ''}".strip()
    return next(row[column] for column in ("channel", "sensor", "group", "run") if column in row)


def _simulated(twin: Statistic | None, printed: str) -> tuple[str, str, str]:
    """Simulated, difference, z."""
    if twin is None:
        return NOTHING, NOTHING, NOTHING
    places, z = _places(twin, printed), f"{round(twin.z, 1) + 0.0:+.1f}"
    if not isfinite(twin.simulated):
        return NOTHING, NOTHING, z
    difference = round(twin.simulated - twin.published, places) + 0.0
    return f"{twin.simulated:.{places}f}", f"{difference:+.{places}f}", z


def recomputed_text(cell: Cell, printed: str) -> str:
    """As printed if it is equal; "≈" after a value within its inputs' rounding, "≠" after any other.

    Without a sign if what is printed is shown without.
    """
    if cell.matches:
        return printed
    value = cell.value
    unsigned = isinstance(value, float) and isinstance(cell.printed, float) and cell.printed < 0 <= float(printed)
    text = plain(value).removeprefix("-") if unsigned else plain(value)
    return f"{text} ≈" if cell.within_input_rounding else f"{text} ≠"


def plain(value: float | str) -> str:
    """A number with the digits that it has, words as they are."""
    return value if isinstance(value, str) else f"{value:.{_decimals(value)}f}"


def _decimals(value: float) -> int:
    return next((n for n in range(_DECIMALS) if round(value, n) == value), _DECIMALS)


def _places(twin: Statistic, printed: str) -> int:
    """Decimals that show what is printed and two digits of the uncertainty."""
    size = twin.uncertainty * (abs(twin.published) if twin.scale == "log" else 1.0)
    wanted = 1 - floor(log10(size)) if size > 0 else 0
    return min(_DECIMALS, max(len(printed.partition(".")[2]), wanted, 0))
