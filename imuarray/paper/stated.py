"""Figures that the paper's text gives and its tables decide, recomputed.

Only what stands there in figures, not "half" or "slightly" (`conclusions` judges those). A figure counts as printed to
the digits that it has: "around 50" is 50 to one digit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from decimal import Decimal
from typing import NamedTuple

from imuarray.paper.cells import Formula, RecomputedRow, numeric_cell
from imuarray.paper.derived import judged, readings
from imuarray.paper.noise import HIGH_RATE_HZ, table10_rates
from imuarray.paper.startup import bias_states
from imuarray.paper.tables import channels, mean, number_in, table
from imuarray.paper.thermal import slopes

_A3_LSB = (("x", "8.0201", "15.6642"), ("y", "9.8857", "19.3081"), ("z", "9.3002", "18.1645"))
"""Appendix A.3: deviations of a BMA180 at 16 g in counts and in mg."""
_GYRO3_STATED = (("0", "69", "2"), ("-13", "75", "0"))
"""Section 5.2.4."""
_LSB_PER_G_AT_16 = 512


class _Figure(NamedTuple):
    """A figure in the text: section, what it is of, the figure, how it follows from the inputs."""

    place: str
    what: str
    printed: str
    formula: Formula
    inputs: Sequence[Decimal]
    source: str


def stated() -> tuple[RecomputedRow, ...]:
    """Every such figure in the order of the sections, in the column `value`."""
    figures = (*_section_4_and_5_2(), *_section_5_2_4(), *_section_5_2_5(), *_section_6(), *_appendix_a())
    return tuple(_recomputed(figure) for figure in figures)


def _recomputed(figure: _Figure) -> RecomputedRow:
    row = {"value": figure.printed}
    cell = numeric_cell(row, "value", figure.formula, figure.inputs)
    return judged(figure.place, figure.what, row, cell, figure.source)


def _section_4_and_5_2() -> Iterator[_Figure]:
    rate = [mean(table10_rates())]
    slower = "350 Hz over Table 10's rate"
    yield _Figure("Section 4", "whole array logged so much slower", "12", lambda v: HIGH_RATE_HZ / v[0], rate, slower)
    yield _Figure("Section 5.2", "epochs in 15 minutes", "4E+4", lambda v: v[0] * 900, rate, "Table 10's rate")
    for axes, ends in (("xy", ("261", "264")), ("z", ("255", "255"))):
        sizes = [abs(number_in(row, "scale_lsb_per_g")) for row in channels(3, "ADXL", axes=axes)]
        yield from _ends("Section 5.2.1", f"ADXL345 {axes} scale factor, LSB/g", ends, sizes, "Table 3")
    (continuous,) = (found.middle for found in readings() if found.log == "cont")
    yield _Figure("Figure 6", "samples in 5 minutes", "1400", _first, [continuous], "Table 11, (std / sem)^2")


def _section_5_2_4() -> Iterator[_Figure]:
    adxl = [number_in(row, "ratio") for row in channels(11, "ADXL")]
    yield from _ends("Section 5.2.4", "ADXL345 run-to-run over in-run", ("1.2", "1.8"), adxl, "Table 11, ratio")
    gyros = [number_in(row, "ratio") for row in channels(11, "Gyro", "2k dps")]
    yield from _ends("Section 5.2.4", "Gyro1, Gyro2 run-to-run over in-run", ("2.4", "7.7"), gyros, "Table 11, ratio")
    for number, (state, printed) in enumerate(zip(bias_states(), _GYRO3_STATED, strict=True), start=1):
        for axis, text in zip("xyz", printed, strict=True):
            values = [number_in(table(7)[run - 1], f"{axis}_lsb") for run in state.runs]
            yield _Figure("Section 5.2.4", f"Gyro3 {axis} in state {number}, LSB", text, mean, values, "Table 7, mean")


def _section_5_2_5() -> Iterator[_Figure]:
    at, source = "Section 5.2.5", "Table 8"
    yield _Figure(at, "ADXL345 x and y with a negative slope, of 4", "3", _negative, slopes("ADXL", axes="xy"), source)
    ratios = [_out_of_plane(name) for name in ("ADXL1", "ADXL2")]
    yield from _ends(at, "ADXL345 z slope over mean of x and y", ("5", "10"), ratios, source)
    yield _Figure(at, "BMA180 z with a positive slope, of 4", "3", _positive, slopes("BMA", axes="z"), source)
    ranges = [*slopes("BMA", "1.5g"), *slopes("BMA", "16g")]
    yield _Figure(at, "BMA180 slope in LSB, 1.5 g over 16 g", "1E+1", _halves, ranges, source)
    yield _Figure(at, "L3G4200D with a positive slope, of 9", "8", _positive, slopes("Gyro"), source)
    but_one = sorted(slopes("Gyro", "2k dps"))[:-1]
    yield from _ends(at, "Gyro1, Gyro2 slope but for one, LSB/degC", ("1.9", "2.6"), but_one, source)
    opposed = [slopes("Gyro", "2k dps", "y")[i] for i in (0, 1)]
    half = "Table 8, half the difference"
    yield _Figure(at, "Gyro1 y, Gyro2 y together, LSB/degC", "0.004", lambda v: (v[0] - v[1]) / 2, opposed, half)


def _section_6() -> Iterator[_Figure]:
    for design, range_name, axes, text, section in (
        ("ADXL", "16g", "xy", "6", "Section 6.2, A.2"),
        ("ADXL", "16g", "z", "12", "Section 6.2, A.2"),
        ("BMA", "1.5g", "xyz", "5E+1", "Section 6.3"),
        ("BMA", "16g", "xyz", "1E+1", "Section 6.3"),
    ):
        values = [number_in(row, "std_lsb") for row in channels(10, design, range_name, axes)]
        what = f"{design} {range_name} {axes} noise, LSB"
        yield _Figure(section, what.replace("ADXL", "ADXL345").replace("BMA", "BMA180"), text, mean, values, "Table 10")


def _appendix_a() -> Iterator[_Figure]:
    for found in readings()[:2]:
        what, source = f"seconds at 350 Hz, {found.log}", "Table 9, (std / sem)^2 / 350 Hz"
        yield _Figure("Appendix A.1", what, "1.4E+3", lambda v: v[0] / HIGH_RATE_HZ, [found.middle], source)
    for axis, counts, milli_g in _A3_LSB:
        source = f"{counts} LSB at {_LSB_PER_G_AT_16} LSB/g"
        yield _Figure("Appendix A.3", f"BMA180 {axis} noise, mg", milli_g, _milli_g_at_16, [Decimal(counts)], source)


def _ends(place: str, what: str, printed: Sequence[str], values: Sequence[Decimal], source: str) -> Iterator[_Figure]:
    """The least and the most of several, as "1.2 to 1.8"."""
    yield _Figure(place, f"{what}: least", printed[0], min, values, source)
    yield _Figure(place, f"{what}: most", printed[1], max, values, source)


def _out_of_plane(sensor: str) -> Decimal:
    x, y, z = (abs(number_in(row, "slope_lsb_per_degc")) for row in table(8) if row["channel"].split()[0] == sensor)
    return 2 * z / (x + y)


def _positive(values: Sequence[Decimal]) -> Decimal:
    return Decimal(sum(value > 0 for value in values))


def _negative(values: Sequence[Decimal]) -> Decimal:
    return Decimal(sum(value < 0 for value in values))


def _halves(values: Sequence[Decimal]) -> Decimal:
    """Mean size of the first half over that of the second."""
    sizes = [abs(value) for value in values]
    return mean(sizes[: len(sizes) // 2]) / mean(sizes[len(sizes) // 2 :])


def _milli_g_at_16(values: Sequence[Decimal]) -> Decimal:
    return values[0] * 1000 / _LSB_PER_G_AT_16


def _first(values: Sequence[Decimal]) -> Decimal:
    return values[0]
