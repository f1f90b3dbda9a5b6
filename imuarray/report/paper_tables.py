"""The sections of the paper's page that compare tables, number by number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import inf
from typing import TYPE_CHECKING, Any

from imuarray.errors import MissingExtraError
from imuarray.paper.tables import number_in, row_of
from imuarray.paper.thermal import AxisPair, pairs
from imuarray.report import paper_figures as figures
from imuarray.report.page import Figure, Section, Table
from imuarray.report.paper_rows import HEADING, NOTHING, Line, Recomputed, line_of, lines_of, plain
from imuarray.report.paper_words import FIGURE_WORDS, TABLE_WORDS, further_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from imuarray.paper.replica import Curves, Replica


def table_sections(
    replica: Replica, curves: Curves | None, recomputed: Recomputed, result: Mapping[str, Any]
) -> Iterator[Section]:
    """A section per table, with the figures that belong to it if there are `curves`; `result` is of `recompute()`."""
    more = further_words(result)
    for number, (title, words) in TABLE_WORDS.items():
        name = f"Table {number}"
        lines = compared(name, replica, recomputed)
        parts: list[Table | Figure] = [*_figures(number, curves)] if curves else []
        parts.append(_table(lines))
        if number == 8:
            parts.append(_pairs(replica))
        text = f"{words} {more[number]}" if number in more else words
        yield Section(f"{name}: {title}", text, parts)


def _table(lines: Sequence[Line], caption: str = "") -> Table:
    rows = [_row(line) for line in lines]
    shown = [i for i in range(len(HEADING)) if any(row[i] != NOTHING for row in rows)]
    count, one, two, three, cells, equal, near, _ = counted(lines)
    caption += f"{count} simulated, within 1, 2, 3 uncertainties: {one}, {two}, {three}. " if count != NOTHING else ""
    caption += f"{cells} recomputed: {equal} equal, {near} more within rounding." if cells != NOTHING else ""
    return Table([HEADING[i] for i in shown], [[row[i] for i in shown] for row in rows], caption, (1,))


def _row(line: Line) -> list[str]:
    texts = line.texts()
    return [*texts[:-1], _marked(texts[-1])] if line.marked else texts


def _marked(text: str) -> str:
    """Escaped and marked; MissingExtraError without jinja2's escaping."""
    try:
        from markupsafe import Markup
    except ImportError:
        raise MissingExtraError("jinja2", "report") from None
    return Markup("<mark>{}</mark>").format(text)


_OF_TABLE: dict[int, dict[str, Callable[[Curves], Drawing]]] = {
    5: {"6": figures.in_run_figure},
    8: {
        "7": figures.profile_figure,
        "8": lambda curves: _against_temperature(curves, "ADXL1 z"),
        "9": lambda curves: _against_temperature(curves, "Gyro2 x"),
        "10": figures.opposed_figure,
    },
    9: {"11": figures.gyro_allan_figure, "13": figures.gyro_memory_figure, "15": figures.histogram_figure},
    10: {
        "16": lambda curves: figures.accelerometer_figure(curves, "ADXL1"),
        "18": lambda curves: figures.accelerometer_figure(curves, "BMA2"),
    },
}


def _figures(number: int, curves: Curves) -> Iterator[Figure]:
    for name, draw in _OF_TABLE.get(number, {}).items():
        yield Figure(draw(curves), *FIGURE_WORDS[name])


def _against_temperature(curves: Curves, channel: str) -> Drawing:
    row = row_of(8, channel)
    slope, intercept = (float(number_in(row, column)) for column in ("slope_lsb_per_degc", "intercept_lsb"))
    return figures.temperature_figure(curves, channel, slope, intercept)


def _pairs(replica: Replica) -> Table:
    slopes = {row.channel: row.simulated for row in replica.of("Table 8") if row.statistic.startswith("slope")}
    heading = ["pair", "relation", "recomputed", "times less", "simulated", "times less"]
    caption = (
        "Temperature slope (LSB/°C) of the mean of two sensors along their box axis, and how many times less it is."
    )
    return Table(heading, [_pair_row(pair, slopes) for pair in pairs()], caption, (1,))


def _pair_row(pair: AxisPair, slopes: dict[str, float]) -> list[str]:
    first, second = pair.first["channel"], pair.second["channel"]
    towards = 1 if pair.axis_first[0] == "+" else -1
    fused = towards * (slopes[first] - slopes[second] if pair.opposed else slopes[first] + slopes[second]) / 2
    alone = (abs(slopes[first]) + abs(slopes[second])) / 2
    simulated = [f"{fused:.4f}", f"{alone / abs(fused) if fused else inf:.1f}"]
    relation = f"{'opposed' if pair.opposed else 'parallel'} along {pair.axis_first[1]}"
    return [f"{first}, {second}", relation, plain(float(pair.fused_slope)), f"{float(pair.reduction):.1f}", *simulated]


def compared(name: str, replica: Replica, recomputed: Recomputed) -> list[Line]:
    """Of a table, a figure or the appendix."""
    twins = replica.of(name)
    return lines_of(name, recomputed, twins) if name.startswith("Table") else [line_of(twin) for twin in twins]


def counted(lines: Sequence[Line]) -> list[str]:
    """How many were simulated, lie within 1, 2, 3 uncertainties, were recomputed, are equal, near, neither."""
    sizes = [abs(line.twin.z) for line in lines if line.twin]
    cells = [line.cell for line in lines if line.cell]
    within = [sum(size <= limit for size in sizes) for limit in (1, 2, 3)]
    equal = sum(cell.matches for cell in cells)
    explained = sum(cell.within_input_rounding for cell in cells)
    simulated = [len(sizes), *within] if sizes else [NOTHING] * 4
    followed = [len(cells), equal, explained - equal, len(cells) - explained] if cells else [NOTHING] * 4
    return [str(count) for count in (*simulated, *followed)]


def others(replica: Replica) -> list[str]:
    """The figures and parts of the appendix that were compared."""
    return [name for name in replica.tables if not name.startswith("Table")]


def elsewhere_section(replica: Replica, recomputed: Recomputed) -> Section:
    """Those figures and parts."""
    parts = [_table(compared(name, replica, recomputed), f"{name}: ") for name in others(replica)]
    return Section(
        "What figures and appendix say of the noise", "Yes is 1, no is 0. “Around” is good to a unit.", parts
    )
