"""The paper's page: printed, recomputed and simulated numbers side by side.

Every table of the paper is a section, with the figures that belong to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor, inf, isfinite, log10
from os import PathLike
from typing import TYPE_CHECKING, Any

from imuarray.report.page import NO_FIGURES, Figure, Section, Table, Verdict, highlight, write_page
from imuarray.studies.paper import figures
from imuarray.studies.paper.replica.statistic import within
from imuarray.studies.paper.results import SOURCE, recompute, recomputed_rows
from imuarray.studies.paper.systematic import AxisPair, pairs
from imuarray.studies.paper.tables import Cell, RecomputedRow, Row, number_in, row_of, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from imuarray.studies.paper.replica.simulation import ExperimentData
    from imuarray.studies.paper.replica.statistic import AgreementSummary, Replica, Statistic

COLUMNS: Mapping[str, str] = {
    "paper": "the number that the paper prints",
    "recomputed": (
        "its value calculated from other printed numbers: unmarked if equal in every digit, ≈ if within "
        "the rounding of those numbers, ≠ if beyond"
    ),
    "simulated": "the same statistic, measured on the simulated array",
    "difference": "simulated minus printed",
    "z": (
        "the difference divided by its uncertainty; of deviations, ranges and ratios the logarithms are compared. The "
        "uncertainty is the disagreement of the paper's own tables where two of them state the same figure. Beyond 2 "
        "it is marked"
    ),
}
"""The description of each column of the tables."""

TABLE_WORDS: Mapping[int, tuple[str, str]] = {
    1: (
        "orientation of the sensors",
        "The sensor axis along each axis of the box. Recomputed from Table 10 for accelerometers. It is an input "
        "of the simulation.",
    ),
    2: ("one gyroscope at its fastest", "Gyro1 alone at 350 Hz. Columns in dps are the same numbers in another unit."),
    3: (
        "accelerometers on six faces",
        "Bias, scale factor and drift, recomputed from Table 10; scale factors are simulated without a sign.",
    ),
    4: ("gyroscopes on six faces", "Bias and response to gravity, recomputed from Table 10."),
    5: (
        "in-run variation",
        "Standard deviation of fifteen five-minute means in a row, averaged over axes; recomputed from Table 11.",
    ),
    6: ("BMA1 switched on fifteen times", "Means of each run; run 10 started in the wrong range."),
    7: ("Gyro3 switched on fifteen times", "Means of each run; two sets of biases."),
    8: (
        "output against temperature",
        "Straight lines through readings while the box was heated twice. Slopes can't be recomputed without the "
        "readings; what two sensors keep together can, below the table.",
    ),
    9: ("one gyroscope's noise", "The logs of Table 2, with standard errors and the chip's thermometer."),
    10: ("six faces, every channel", "Fifteen minutes on each face and the first once more; BMA180 and ADXL345 noise."),
    11: (
        "run to run and within a run",
        "Fifteen runs of five minutes, and fifteen such windows of one run: mean, standard error, deviation of "
        "readings, deviation and range of the means, and the ratio of the two deviations.",
    ),
}
"""Keyed by the number of the table: the rest of the heading, and a description."""

FIGURE_WORDS: Mapping[str, tuple[str, str]] = {
    "6": (
        "Like Figure 6, simulated: a continuous run averaged over five minutes, less its mean. Gyro3 is at ±250 dps, "
        "where a count is eight times smaller. Curves wander by as much as Table 5 says, each in its own way.",
        "Smoothed outputs of two ADXL345, two BMA180 and three L3G4200D over 75 minutes",
    ),
    "7": (
        "Like Figure 7: the temperature that the simulated box was given. Times and peaks are the paper's, the curves "
        "between them are ours.",
        "Temperature over 110 minutes with two peaks",
    ),
    "8": (
        "Like Figure 8, simulated: ADXL1 z against temperature. The slope is small compared with the noise of one "
        "reading; only even codes occur.",
        "Scatter of ADXL1 z against temperature with the simulated and the printed line",
    ),
    "9": (
        "Like Figure 9, simulated: Gyro2 x against temperature. The slope stands out, and the lines differ by what the "
        "bias does from one day to another.",
        "Scatter of Gyro2 x against temperature with the simulated and the printed line",
    ),
    "10": (
        "Like Figure 10, simulated: two gyroscopes about box Y that point in opposite directions, means of half a "
        "minute. Each follows the temperature, half of their difference hardly does.",
        "Outputs of Gyro1 y and Gyro2 y and half of their difference while the box is heated",
    ),
    "11": (
        "Like Figure 11, simulated: Allan deviation of Gyro1 alone. Both ranges are alike; the curves are straight "
        "(grey: white noise) but for the shortest times, where neighbours correlate, and the longest, where the bias "
        "wanders.",
        "Allan deviation of three axes of a gyroscope at two ranges",
    ),
    "13": (
        "Like Figures 13 and 14, simulated: neighbours correlate by 0.4; the y axis has a line at 50 Hz, whose period "
        "at 350 Hz is seven samples.",
        "Autocorrelation and spectrum of three axes of a gyroscope at 250 dps",
    ),
    "15": (
        "Like Figure 15, simulated: codes of Gyro1 x at both ranges and the normal curve of the same deviation. A "
        "count at ±2000 dps is small compared with the noise.",
        "Histograms of Gyro1 x at two ranges",
    ),
    "16": (
        "Like Figures 16 and 17, simulated: ADXL1, from the continuous run at 48 Hz (the paper's own log was faster). "
        "White on all axes, z twice as noisy.",
        "Allan deviation and spectrum of three axes of an ADXL345",
    ),
    "18": (
        "Like Figures 18 and 19, simulated: BMA2 at ±16 g, from the same run. White on all axes, no line.",
        "Allan deviation and spectrum of three axes of a BMA180",
    ),
}
"""Keyed by the number of the paper's figure: caption and alternative text."""


def further_words(result: Mapping[str, Any]) -> dict[int, str]:
    """Return descriptions of the recomputation of whole columns, by table."""
    slow, fast, runs, windows = result["readings"]
    ratio = result["range_over_deviation"]
    possible, total = ratio["possible"]
    return {
        9: (
            f"All four standard errors at ±250 dps fit {slow['least']} to {slow['most']} readings "
            f"({slow['seconds']:.0f} s at 350 Hz), all at ±2000 dps {fast['least']} to {fast['most']} "
            f"({fast['seconds']:.0f} s; the text says about 1400 s of both)."
        ),
        11: (
            f"One number of readings explains all {runs['channels']} standard errors of a series: {runs['least']} to "
            f"{runs['most']} for the runs ({runs['rate_hz']:.2f} Hz), {windows['least']} to {windows['most']} for the "
            f"windows ({windows['rate_hz']:.2f} Hz). Fifteen numbers have a range of {ratio['least']:.2f} to "
            f"{ratio['most']:.2f} of their deviations; {possible} of {total} printed pairs do, the others are of "
            f"thermometers. Inertial axes (not of BMA1 and Gyro3) have {ratio['mean']['runs']:.2f} and "
            f"{ratio['mean']['cont']:.2f} on average, normal numbers {ratio['normal']:.2f}."
        ),
    }


HEADING = ("channel", "statistic", "paper", "recomputed", "simulated", "difference", "z")
MARKED_Z = 2.0
"""Size from which on a z score is marked."""

Key = tuple[str, str]
"""Channel and statistic."""
Recomputed = Mapping[str, Sequence[RecomputedRow]]
"""`imuarray.studies.paper.results.recomputed_rows()`."""

NOTHING = "–"
"""The text of a cell without a number."""
_DECIMALS = 6
_PRINTED_DECIMALS = 4
"""Largest number of decimals that the text prints."""
_RUNS = {6: "BMA1", 7: "Gyro3"}


@dataclass(frozen=True)
class PrintedNumber:
    """One number of a table: as printed, its recomputation and its simulated value, if they exist."""

    channel: str
    statistic: str
    printed: str
    cell: Cell | None
    twin: Statistic | None

    @property
    def marked(self) -> bool:
        """Return whether the simulated value disagrees."""
        return self.twin is not None and abs(self.twin.z) > MARKED_Z

    def texts(self) -> list[str]:
        """Return the cells under `HEADING`."""
        recomputed = NOTHING if self.cell is None else recomputed_text(self.cell, self.printed)
        return [self.channel, self.statistic, self.printed, recomputed, *_format_simulated(self.twin, self.printed)]


def lines_of(name: str, recomputed: Recomputed, twins: Sequence[Statistic]) -> list[PrintedNumber]:
    """Return every number of a table, `name` "Table 3" for example, channel by channel: first the simulated ones, then
    those that were only recomputed.
    """
    cells = dict(_cells(name, recomputed))
    by_key = {(twin.channel, twin.statistic): twin for twin in twins}
    channels = list(dict.fromkeys(channel for channel, _ in (*by_key, *cells)))
    keys = sorted(dict.fromkeys((*by_key, *cells)), key=lambda key: channels.index(key[0]))
    texts = _texts(int(name.removeprefix("Table ")))
    return [PrintedNumber(*key, _text(key, texts, by_key.get(key)), cells.get(key), by_key.get(key)) for key in keys]


def line_of(twin: Statistic) -> PrintedNumber:
    """Return a number of a figure or of the text."""
    return PrintedNumber(twin.channel, twin.statistic, _format_digits(twin), None, twin)


def _texts(number: int) -> dict[Key, str]:
    """Return every number of a table as it is printed."""
    if number in _RUNS:
        return {
            (f"{_RUNS[number]} {axis}", f"run {row['run']}"): row[column]
            for row in table(number)
            for axis, column in zip("xyzt", ("x_lsb", "y_lsb", "z_lsb", "temp_int"), strict=True)
        }
    rows = table(number)
    texts = {(_channel(row), column): text for row in rows for column, text in row.items()}
    if number == 9:  # the two rows of the thermometer are distinguished by their half of the table
        for index, row in enumerate(rows):
            name = "250dps" if 2 * index < len(rows) else "2k dps"
            texts |= {(f"{row['output']} {name}", column): text for column, text in row.items()}
    return texts


def _text(key: Key, texts: Mapping[Key, str], twin: Statistic | None) -> str:
    """Return a value as printed, without its sign if only its magnitude is compared."""
    text = texts.get(key, "")
    if twin is None:
        return text
    return text.removeprefix("-") if text and twin.published >= 0 else text or _format_digits(twin)


def _format_digits(twin: Statistic) -> str:
    """Return the text of a number that is in no table; a quotient of printed numbers has the digits that its
    uncertainty allows.
    """
    has_few_digits = _decimals(twin.published) <= _PRINTED_DECIMALS
    return plain(twin.published if has_few_digits else round(twin.published, _places(twin, "")))


def _cells(name: str, recomputed: Recomputed) -> Iterator[tuple[Key, Cell]]:
    for row in recomputed[name.lower().replace(" ", "")]:
        yield from (((_channel(row.row), cell.column), cell) for cell in row.cells)
    for row in recomputed["derived"]:
        if row.row["table"] == name:
            yield from (((row.row["channel"], cell.column), cell) for cell in row.cells)


def _channel(row: Row) -> str:
    """Return the channel of a row; Tables 2 and 9 have two of each axis."""
    if "output" in row:
        return f"{row['output']} {row['range'] if row['range'] != 'int' else ''}".strip()
    return next(row[column] for column in ("channel", "sensor", "group", "run") if column in row)


def _format_simulated(twin: Statistic | None, printed: str) -> tuple[str, str, str]:
    """Return simulated value, difference and z."""
    if twin is None:
        return NOTHING, NOTHING, NOTHING
    places, z = _places(twin, printed), f"{round(twin.z, 1) + 0.0:+.1f}"
    if not isfinite(twin.simulated):
        return NOTHING, NOTHING, z
    difference = round(twin.simulated - twin.published, places) + 0.0
    return f"{twin.simulated:.{places}f}", f"{difference:+.{places}f}", z


def recomputed_text(cell: Cell, printed: str) -> str:
    """Return the recomputed value, as printed if it is equal; "≈" after a value within its inputs' rounding, "≠" after
    any other.

    The sign is omitted if the printed number is shown without a sign.
    """
    if cell.matches:
        return printed
    value = cell.value
    unsigned = isinstance(value, float) and isinstance(cell.printed, float) and cell.printed < 0 <= float(printed)
    text = plain(value).removeprefix("-") if unsigned else plain(value)
    return f"{text} ≈" if cell.within_input_rounding else f"{text} ≠"


def plain(value: float | str) -> str:
    """Return a number with its digits, or words unchanged."""
    return value if isinstance(value, str) else f"{value:.{_decimals(value)}f}"


def _decimals(value: float) -> int:
    return next((n for n in range(_DECIMALS) if round(value, n) == value), _DECIMALS)


def _places(twin: Statistic, printed: str) -> int:
    """Return the decimals that show the printed number and two digits of the uncertainty."""
    size = twin.uncertainty * (abs(twin.published) if twin.scale == "log" else 1.0)
    decimals = 1 - floor(log10(size)) if size > 0 else 0
    return min(_DECIMALS, max(len(printed.partition(".")[2]), decimals, 0))


def table_sections(
    replica: Replica, observed: ExperimentData | None, recomputed: Recomputed, result: Mapping[str, Any]
) -> Iterator[Section]:
    """Yield a section per table, with its figures if there is `observed` data; `result` is that of `recompute()`."""
    further = further_words(result)
    for number, (title, words) in TABLE_WORDS.items():
        name = f"Table {number}"
        lines = compare_numbers(name, replica, recomputed)
        parts: list[Table | Figure] = [*_figures(number, observed)] if observed else []
        parts.append(_table(lines))
        if number == 8:
            parts.append(_pairs(replica))
        text = f"{words} {further[number]}" if number in further else words
        yield Section(f"{name}: {title}", text, parts, fold=_fold_of(lines, len(parts) - 1 - (number == 8)))


def _fold_of(lines: Sequence[PrintedNumber], drawings: int = 0) -> str:
    """Return the line that is shown for a folded table: the number of its entries, and how many of them agree."""
    count, _, two, _, cells, equal, near, _ = count_agreement(lines)
    words = [f"{len(lines)} numbers"]
    words += [f"{drawings} figure{'s' if drawings > 1 else ''}"] if drawings else []
    words += [f"{two} of {count} simulated agree within two uncertainties"] if count != NOTHING else []
    words += [f"{int(equal) + int(near)} of {cells} recomputed agree within rounding"] if cells != NOTHING else []
    return "; ".join(words)


def _table(lines: Sequence[PrintedNumber], caption: str = "") -> Table:
    rows = [_row(line) for line in lines]
    columns = [i for i in range(len(HEADING)) if any(row[i] != NOTHING for row in rows)]
    count, item, two, three, cells, equal, near, _ = count_agreement(lines)
    caption += f"{count} simulated, within 1, 2, 3 uncertainties: {item}, {two}, {three}. " if count != NOTHING else ""
    caption += f"{cells} recomputed: {equal} equal, {near} more within rounding." if cells != NOTHING else ""
    return Table([HEADING[i] for i in columns], [[row[i] for i in columns] for row in rows], caption, (1,))


def _row(line: PrintedNumber) -> list[str]:
    texts = line.texts()
    return [*texts[:-1], highlight(texts[-1])] if line.marked else texts


_OF_TABLE: dict[int, dict[str, Callable[[ExperimentData], Drawing]]] = {
    5: {"6": figures.in_run_figure},
    8: {
        "7": lambda observed: figures.profile_figure(),
        "8": lambda observed: _against_temperature(observed, "ADXL1 z"),
        "9": lambda observed: _against_temperature(observed, "Gyro2 x"),
        "10": figures.opposed_figure,
    },
    9: {"11": figures.gyro_allan_figure, "13": figures.gyro_memory_figure, "15": figures.histogram_figure},
    10: {
        "16": lambda observed: figures.accelerometer_figure(observed, "ADXL1"),
        "18": lambda observed: figures.accelerometer_figure(observed, "BMA2"),
    },
}


def _figures(number: int, observed: ExperimentData) -> Iterator[Figure]:
    for name, draw in _OF_TABLE.get(number, {}).items():
        yield Figure(draw(observed), *FIGURE_WORDS[name])


def _against_temperature(observed: ExperimentData, channel: str) -> Drawing:
    row = row_of(8, channel)
    slope, intercept = (float(number_in(row, column)) for column in ("slope_lsb_per_degc", "intercept_lsb"))
    return figures.temperature_figure(observed, channel, slope, intercept)


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


def compare_numbers(name: str, replica: Replica, recomputed: Recomputed) -> list[PrintedNumber]:
    """Return the comparisons of a table, a figure or the appendix."""
    twins = replica.of(name)
    return lines_of(name, recomputed, twins) if name.startswith("Table") else [line_of(twin) for twin in twins]


def count_agreement(lines: Sequence[PrintedNumber]) -> list[str]:
    """Return the numbers of statistics that were simulated, that are within 1, 2 and 3 uncertainties, that were
    recomputed, and that are equal, near or neither.
    """
    twins = [line.twin for line in lines if line.twin]
    cells = [line.cell for line in lines if line.cell]
    equal = sum(cell.matches for cell in cells)
    explained = sum(cell.within_input_rounding for cell in cells)
    simulated = [len(twins), *within(twins)] if twins else [NOTHING] * 4
    followed = [len(cells), equal, explained - equal, len(cells) - explained] if cells else [NOTHING] * 4
    return [str(count) for count in (*simulated, *followed)]


def others(replica: Replica) -> list[str]:
    """Return the figures and parts of the appendix that were compared."""
    return [name for name in replica.tables if not name.startswith("Table")]


def elsewhere_section(replica: Replica, recomputed: Recomputed) -> Section:
    """Return the section on the figures and the parts of the appendix."""
    lines = [compare_numbers(name, replica, recomputed) for name in others(replica)]
    parts = [_table(own, f"{name}: ") for name, own in zip(others(replica), lines, strict=True)]
    return Section(
        "What figures and appendix say of the noise",
        "Yes is 1, no is 0. “Around” is good to a unit.",
        parts,
        fold=_fold_of([line for own in lines for line in own]),
    )


TITLE = "Martin et al. 2013: printed, recomputed, simulated"

_FAR = 3.0


def write_paper_page(
    path: str | PathLike[str], replica: Replica, observed: ExperimentData | None, *, force: bool = False
) -> None:
    """Write the page; figures are those of `observed` data; without them (None) the page states that they are missing.

    OutputExistsError if the file exists and `force` is false; MissingExtraError without jinja2, or with `observed`
    without matplotlib.
    """
    recomputed, result = recomputed_rows(), recompute()
    lines = list(_summary(replica, result))
    write_page(
        path,
        TITLE,
        lines if observed else [*lines, NO_FIGURES],
        [
            _overview(replica, recomputed),
            _columns(),
            _conclusions(result),
            _slips(result),
            _gaps(replica, recomputed),
            *table_sections(replica, observed, recomputed, result),
            elsewhere_section(replica, recomputed),
            _stated_section(recomputed),
        ],
        verdict=paper_verdict(replica, result),
        force=force,
    )


_ENOUGH = 0.9
"""Minimum share of the statistics within two uncertainties for a simulation that reproduces the paper. A perfect model
has 95.4 %; known gaps of the model reduce this share.
"""


def paper_verdict(replica: Replica, result: dict[str, Any]) -> Verdict:
    """Return the share of the paper's numbers that the simulated array reproduces, and how many conclusions hold."""
    whole = replica.summary
    agreeing = whole.within[1] / max(1, whole.count)
    holding, total = sum(statement["holds"] for statement in result["conclusions"]), len(result["conclusions"])
    sentence = (
        f"A simulated array reproduces {100 * agreeing:.0f} % of the paper's numbers within two uncertainties,"
        f" and {holding} of its {total} conclusions hold in its own data."
    )
    figures = (
        (str(whole.count), "statistics of the paper, simulated"),
        (f"{100 * agreeing:.1f} %", "within two uncertainties; normal deviates give 95.4 %"),
        (f"{whole.chi_square:.2f}", "chi-square per degree of freedom"),
        (f"{holding} of {total}", "conclusions that hold"),
        (str(len(replica.beyond(_FAR))), "statistics more than three uncertainties off"),
    )
    return Verdict(sentence, "good" if agreeing >= _ENOUGH else "doubtful", figures)


def _summary(replica: Replica, result: dict[str, Any]) -> Iterator[str]:
    """Yield the summary in words."""
    whole = replica.summary
    item, two, three = (f"{count} ({100 * count / whole.count:.1f} %)" for count in whole.within)
    yield (
        f"Of the {whole.count} statistics, simulated with seed {replica.seed}, {item} agree within one uncertainty, "
        f"{two} within two, {three} within three; normal deviates would give 68.3, 95.4 and 99.7 %."
    )
    axes, thermometers = (_judge_chi_square(replica.kinds[name]) for name in ("axes", "thermometers"))
    yield f"Chi-square per degree of freedom: inertial axes {axes}; the chips' own thermometers {thermometers}."
    yield _recomputed_words(result)
    far = replica.beyond(_FAR)
    odd = sum(" t" in row.channel for row in far)
    yield (
        f"Known gaps: {len(far)} statistics are more than three uncertainties off, {odd} of them of thermometers, "
        f"which in the model follow the room with a fixed slope, an offset and noise."
    )


def _judge_chi_square(summary: AgreementSummary) -> str:
    low, high = summary.expected
    verdict = (
        "as expected"
        if low <= summary.chi_square <= high
        else "too large"
        if summary.chi_square > high
        else "too small"
    )
    return f"{summary.chi_square:.2f}, {verdict} (95 % of true models lie between {low:.2f} and {high:.2f})"


def _recomputed_words(result: dict[str, Any]) -> str:
    tables = {name: columns for name, columns in result["matches"].items() if name != "stated"}
    equal = sum(count[0] for columns in tables.values() for count in columns.values())
    total = sum(count[1] for columns in tables.values() for count in columns.values())
    explained = sum(result["within_input_rounding"][name][column][0] for name in tables for column in tables[name])
    stated = result["matches"]["stated"]["value"]
    return (
        f"{total} cells of the paper can be computed from other cells: {equal} agree in every digit, "
        f"{explained - equal} more within the rounding of their inputs, {total - explained} do not. Of {stated[1]} "
        f"figures in the text, {stated[0]} follow from the tables."
    )


def _overview(replica: Replica, recomputed: Recomputed) -> Section:
    names = (*(f"Table {number}" for number in TABLE_WORDS), *others(replica))
    rows = [[name, *count_agreement(compare_numbers(name, replica, recomputed))] for name in names]
    heading = ["", "simulated", "within 1", "2", "3", "recomputed", "equal", "within rounding", "neither"]
    caption = "How many numbers were compared, and how many agree; 1, 2, 3 are uncertainties."
    return Section("All tables at a glance", f"The numbers are those of {SOURCE}.", [Table(heading, rows, caption)])


def _columns() -> Section:
    words = "Each row of the tables below is a number that the paper prints. Every section opens with a click."
    rows = [[name, meaning] for name, meaning in COLUMNS.items()]
    return Section(
        "How to read the tables",
        words,
        [Table(["column", "meaning"], rows, "Columns without a number are left out.", (1,))],
        fold="What each column contains",
    )


def _stated_section(recomputed: Recomputed) -> Section:
    rows = []
    for row in recomputed["stated"]:
        (cell,) = row.cells
        printed, source = plain(cell.printed), str(row.extra["follows_from"])
        rows.append([row.row["channel"], row.row["table"], printed, recomputed_text(cell, printed), source])
    words = "Figures in the paper's text that its own tables decide, each to the digits that it has."
    heading = ["of", "where", "text", "recomputed", "from"]
    parts = [Table(heading, rows, "≈ within rounding, ≠ beyond it.", (1, 4))]
    return Section("The text against the tables", words, parts, fold=f"{len(rows)} figures of the text")


def _gaps(replica: Replica, recomputed: Recomputed) -> Section:
    lines = [line for name in replica.tables for line in compare_numbers(name, replica, recomputed)]
    rows = [
        [line.channel, line.twin.table, *line.texts()[1:3], *line.texts()[4:], line.twin.origin]
        for line in lines
        if line.twin and abs(line.twin.z) > _FAR
    ]
    words = (
        "Everything more than three uncertainties off, and what the uncertainty is made of. Chance alone would put "
        f"about {0.0027 * replica.summary.count:.0f} here. Within a run, the paper's thermometers changed more "
        "(L3G4200D) or less (BMA180) than the temperature of the room; the model gives each the room's temperature, "
        "an offset and noise."
    )
    heading = ["channel", "where", "statistic", "paper", "simulated", "difference", "z", "uncertainty"]
    parts = [Table(heading, rows, "Statistics more than three uncertainties off.", (1, 2, 7))]
    return Section("Known gaps", words, parts, fold=f"{len(rows)} statistics")


def _conclusions(result: dict[str, Any]) -> Section:
    words = "Judged from the paper's printed numbers alone; every criterion is stated."
    claims = result["conclusions"]
    holding = f"{sum(claim['holds'] for claim in claims)} of {len(claims)} conclusions hold"
    return Section("The paper's conclusions", words, [_statements(claims)], fold=holding)


def _slips(result: dict[str, Any]) -> Section:
    words = "Where the text, a formula or a column disagrees with the paper's own tables."
    slips = [slip for slip in result["slips"] if not slip["holds"]]
    return Section("Slips of the paper", words, [_statements(slips)], fold=f"{len(slips)} slips")


def _statements(statements: Sequence[dict[str, Any]]) -> Table:
    rows = [[item["claim"], "yes" if item["holds"] else "no", item["evidence"]] for item in statements]
    return Table(["claim", "holds", "evidence"], rows, "From the printed tables.", (2,))
