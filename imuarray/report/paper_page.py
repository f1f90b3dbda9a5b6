"""The paper's page: what it prints, what follows from its own numbers, what the simulated array gives, side by side.

Every table of the paper is a section; figures stand with the table to which they belong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

from imuarray.paper.results import SOURCE, recompute, recomputed_rows
from imuarray.report.page import Section, Table, write_page
from imuarray.report.paper_rows import Line, Recomputed, plain, recomputed_text
from imuarray.report.paper_tables import compared, counted, elsewhere_section, others, table_sections
from imuarray.report.paper_words import HOW_TO_READ, TABLE_WORDS

if TYPE_CHECKING:
    from imuarray.paper.replica import Curves, Replica, Summary

TITLE = "Martin et al. 2013: printed, recomputed, simulated"
NO_FIGURES = "No figures on this page: they need matplotlib (pip install 'imuarray[report]')."

_FAR = 3.0


def write_paper_page(
    path: str | PathLike[str], replica: Replica, curves: Curves | None, *, force: bool = False
) -> None:
    """Write the page; figures are of `curves`, without them (None) it says so.

    OutputExistsError if it is there and not `force`, MissingExtraError without jinja2 (or matplotlib to draw with).
    """
    recomputed, result = recomputed_rows(), recompute()
    lines = list(_summary(replica, result))
    write_page(
        path,
        TITLE,
        lines if curves else [*lines, NO_FIGURES],
        [
            _overview(replica, recomputed),
            *table_sections(replica, curves, recomputed, result),
            elsewhere_section(replica, recomputed),
            _stated(recomputed),
            _gaps(replica, recomputed),
            _conclusions(result),
            _slips(result),
        ],
        force=force,
    )


def _summary(replica: Replica, result: dict[str, Any]) -> Iterator[str]:
    """In plain words."""
    whole = replica.summary
    one, two, three = (f"{count} ({100 * count / whole.count:.1f} %)" for count in whole.within)
    yield (
        f"Every number of the paper's Tables 2 to 11 was measured once more on a simulated array with the paper's "
        f"parameters (seed {replica.seed}): of {whole.count} statistics {one} agree within one uncertainty, {two} "
        f"within two, {three} within three; normal deviates would give 68.3, 95.4 and 99.7 %."
    )
    axes, thermometers = (_judged(replica.kinds[name]) for name in ("axes", "thermometers"))
    yield f"Chi-square per degree, all statistics that follow from no others: {_judged(whole)}."
    yield f"Of the inertial axes: {axes}. Of the chips' own thermometers: {thermometers}."
    yield _recomputed_words(result)
    held = sum(statement["holds"] for statement in result["conclusions"])
    yield (
        f"{held} of the paper's {len(result['conclusions'])} conclusions hold by the criteria below; "
        f"{sum(not slip['holds'] for slip in result['slips'])} slips were found."
    )
    far = replica.beyond(_FAR)
    odd = sum(" t" in row.channel for row in far)
    yield (
        f"Known gaps: {len(far)} statistics are more than three uncertainties off, {odd} of them of thermometers, "
        f"which in the model follow the room with a fixed slope, an offset and noise."
    )


def _judged(found: Summary) -> str:
    low, high = found.expected
    verdict = (
        "as expected" if low <= found.chi_square <= high else "too large" if found.chi_square > high else "too small"
    )
    return f"{found.chi_square:.2f}, {verdict} (95 % of true models lie between {low:.2f} and {high:.2f})"


def _recomputed_words(result: dict[str, Any]) -> str:
    tables = {name: columns for name, columns in result["matches"].items() if name != "stated"}
    equal = sum(count[0] for columns in tables.values() for count in columns.values())
    total = sum(count[1] for columns in tables.values() for count in columns.values())
    explained = sum(result["within_input_rounding"][name][column][0] for name in tables for column in tables[name])
    said = result["matches"]["stated"]["value"]
    return (
        f"{total} printed cells follow from other printed numbers: {equal} do in every digit, {explained - equal} more "
        f"within the rounding of their inputs, {total - explained} do not. Of {said[1]} figures in the text {said[0]} "
        f"follow from the tables."
    )


def _overview(replica: Replica, recomputed: Recomputed) -> Section:
    names = (*(f"Table {number}" for number in TABLE_WORDS), *others(replica))
    rows = [[name, *counted(compared(name, replica, recomputed))] for name in names]
    heading = ["", "simulated", "within 1", "2", "3", "recomputed", "equal", "within rounding", "neither"]
    caption = "Numbers compared, and how many agree; 1, 2, 3 are uncertainties."
    return Section(
        "How to read it, and all tables at a glance", f"{HOW_TO_READ} {SOURCE}.", [Table(heading, rows, caption)]
    )


def _stated(recomputed: Recomputed) -> Section:
    rows = []
    for row in recomputed["stated"]:
        (cell,) = row.cells
        source = str(row.extra["follows_from"])
        rows.append(
            [
                row.row["channel"],
                row.row["table"],
                plain(cell.printed),
                recomputed_text(cell, plain(cell.printed)),
                source,
            ]
        )
    words = "Figures in the paper's text that its own tables decide, each to the digits that it has."
    heading = ["of", "where", "text", "recomputed", "from"]
    return Section(
        "The text against the tables", words, [Table(heading, rows, "≈ within rounding, ≠ beyond it.", (1, 4))]
    )


def _gaps(replica: Replica, recomputed: Recomputed) -> Section:
    lines = [line for name in replica.tables for line in compared(name, replica, recomputed)]
    rows = [
        [line.channel, line.twin.table, *_without_recomputed(line), line.twin.origin]
        for line in lines
        if line.twin and abs(line.twin.z) > _FAR
    ]
    words = (
        "Everything more than three uncertainties off, and what the uncertainty is made of. Chance alone would put "
        f"about {0.0027 * replica.summary.count:.0f} here. The chips' thermometers: the paper's wandered within a run "
        "more (the L3G4200D) or less (the BMA180) than the room did; the model has the room's temperature, an offset "
        "and noise."
    )
    heading = ["channel", "where", "statistic", "paper", "simulated", "difference", "z", "uncertainty"]
    return Section("Known gaps", words, [Table(heading, rows, "The farthest off.", (1, 2, 7))])


def _without_recomputed(line: Line) -> list[str]:
    """Statistic, paper, simulated, difference, z."""
    _, statistic, printed, _, *simulated = line.texts()
    return [statistic, printed, *simulated]


def _conclusions(result: dict[str, Any]) -> Section:
    words = "Judged from the paper's printed numbers alone; every criterion is stated."
    return Section("The paper's conclusions", words, [_statements(result["conclusions"], "holds")])


def _slips(result: dict[str, Any]) -> Section:
    words = "Where the text, a formula or a column disagrees with the paper's own tables."
    slips = [slip for slip in result["slips"] if not slip["holds"]]
    return Section("Slips of the paper", words, [_statements(slips, "holds")])


def _statements(statements: Sequence[dict[str, Any]], verdict: str) -> Table:
    rows = [[item["claim"], "yes" if item["holds"] else "no", item["evidence"]] for item in statements]
    return Table(["claim", verdict, "evidence"], rows, "From the printed tables.", (2,))
