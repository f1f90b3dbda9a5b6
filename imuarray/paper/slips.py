"""Where the paper's words or columns disagree with its own tables, each found by computing.

What the text states (a slope range, a rate) stands here as a constant with its section; everything it is compared
with is recomputed. `holds` would turn true by itself if the tables agreed after all.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from math import atan2, degrees

from imuarray.paper.accelerometers import READINGS, main_axis, response_of
from imuarray.paper.appendix_b import printed_azimuth_deg, reproduced
from imuarray.paper.cells import Cell, numeric_cell
from imuarray.paper.gyroscopes import table4
from imuarray.paper.noise import FACE_SECONDS, HIGH_RATE_HZ, TRIADS, table10_rates, table11_rates
from imuarray.paper.orientation import as_text, determinant, measured_axes, mirrored, printed_axes
from imuarray.paper.stability import impossible_deviations, unexplained_cells
from imuarray.paper.statement import Statement, figure
from imuarray.paper.tables import channels, is_inertial, mean, number_in, numbers_in, row_of, table
from imuarray.paper.thermal import pair_of, slopes

_STATED_SLOPES = (Decimal("1.9"), Decimal("2.6"))
"""Section 5.2.5, counts per degree Celsius, "in every case but one"."""
_STATED_PAIR_SLOPE = Decimal("0.004")
"""Section 5.2.5, the combined drift of the two opposed y axes, counts per degree Celsius."""
_STATED_ADXL_RATIOS = (Decimal("1.2"), Decimal("1.8"))
"""Section 5.2.4, run-to-run over in-run variation of the ADXL345."""
_STATED_SAMPLES = 40_000
"""Section 5.2: more than this many epochs in 15 minutes."""
_RATE_TOLERANCE = Decimal("0.1")
_SLOPE_DIGITS = Decimal("0.1")


def _sign_of_scale() -> Statement:
    rows = table(3)
    as_box_x = as_main_axis = 0
    for row in rows:
        response, negative = response_of(row["channel"]), number_in(row, "scale_lsb_per_g") < 0
        as_box_x += (response[0] < 0) == negative
        as_main_axis += (main_axis(response)[0] == "-") == negative
    return Statement(
        "Table 3: the sign of a scale factor says which way its sensitive axis points",
        f"the printed sign is that of the half-difference along box X on {as_box_x} of {len(rows)} channels, whatever "
        f"the axis; it is that of the channel's own main axis on {as_main_axis} (arctan loses the quadrant)",
        as_main_axis == len(rows),
    )


def _azimuth() -> Statement:
    channel = "ADXL1 x"
    response = response_of(channel)
    true = degrees(atan2(float(response[1]), float(response[0])))
    as_printed = reproduced(quotient_mended=False, sum_mended=True)
    mended = reproduced(quotient_mended=True, sum_mended=True)
    total = len(table(3))
    return Statement(
        "Appendix B: azimuth = arctan(f_x / f_y) is 0 along X and 90 degrees along Y",
        f"{channel} points along box {main_axis(response)}: the formula gives "
        f"{figure(printed_azimuth_deg(channel), 1)} deg, "
        f"atan2(f_y, f_x) {figure(true, 1)} deg; with the quotient as printed {as_printed} of {total} scale factors of "
        f"Table 3 come out, turned over {mended} of {total}",
        as_printed == total,
    )


def _six_term_sum() -> Statement:
    total = len(table(3))
    as_printed = reproduced(quotient_mended=True, sum_mended=False)
    mended = reproduced(quotient_mended=True, sum_mended=True)
    return Statement(
        "Appendix B: the average of six terms is the scale factor",
        f"even with the azimuth mended the printed sum gives {as_printed} of {total} scale factors "
        "of Table 3; with the "
        f"first term's missing cos(azimuth) moved back from the third, {mended} of {total}",
        as_printed == total,
    )


def _orientation() -> Statement:
    accelerometers = [row for row in table(1) if not row["sensor"].startswith("Gyro")]
    parts = [
        f"{row.row['sensor']} printed {as_text(printed_axes(row.row))} has determinant "
        f"{determinant(printed_axes(row.row)):+d}, Table 10 says {as_text(measured_axes(row.row['sensor']))} with "
        f"{determinant(measured_axes(row.row['sensor'])):+d}"
        for row in mirrored()
    ]
    names = " and ".join(row.row["sensor"] for row in mirrored())
    agree = sum(printed_axes(row) == measured_axes(row["sensor"]) for row in accelerometers)
    return Statement(
        "Table 1: the orientations of the triads",
        f"{names or 'none'} left-handed as printed, {agree} of {len(accelerometers)} accelerometer triads agree with "
        f"Table 10's largest responses; as the box axes of the sensor's x, y, z: {'; '.join(parts)}",
        not parts and agree == len(accelerometers),
    )


def _logging_rate() -> Statement:
    rates, turn_on = table10_rates(), mean(table11_rates())
    stated, rate = Decimal(HIGH_RATE_HZ) / TRIADS, mean(rates)
    return Statement(
        f"Section 4: logging the whole array is slower by about a factor of {TRIADS} "
        f"({HIGH_RATE_HZ} Hz to {figure(stated, 0)} Hz)",
        f"(std / sem)^2 over {FACE_SECONDS} s is {figure(min(rates), 2)} to {figure(max(rates), 2)} "
        f"Hz on the {len(rates)} "
        f"inertial channels of Table 10 and {figure(turn_on, 1)} Hz on average in Table 11: a factor of "
        f'{figure(HIGH_RATE_HZ / rate, 1)}; section 5.2\'s own "more than {_STATED_SAMPLES}" epochs a face need over '
        f"{figure(_STATED_SAMPLES / FACE_SECONDS, 1)} Hz; criterion: within {figure(100 * _RATE_TOLERANCE, 0)} %",
        abs(rate / stated - 1) <= _RATE_TOLERANCE,
    )


def _slope_range() -> Statement:
    *usual, largest = sorted(slopes("Gyro", "2k dps"))
    low, high = _STATED_SLOPES
    return Statement(
        f"Section 5.2.5: 2000 dps gyroscopes drift by {low} to {high} LSB/degC in every case but one",
        f"Table 8: {usual[0]} to {usual[-1]} LSB/degC, the one being {largest}: a factor of "
        f"{figure(mean([low, high]) / mean([usual[0], usual[-1]]), 1)} less",
        (usual[0].quantize(_SLOPE_DIGITS), usual[-1].quantize(_SLOPE_DIGITS)) == _STATED_SLOPES,
    )


def _pair_slope() -> Statement:
    pair = pair_of("Gyro1 y", "Gyro2 y")
    first, second = pair.slopes
    return Statement(
        f"Section 5.2.5: the opposed y axes have a combined drift of {_STATED_PAIR_SLOPE} LSB/degC",
        f"{first} - {second} = {first - second} is the difference; the combination of Figure 10 is "
        "half the difference, "
        f"and drifts by {figure(pair.fused_slope, 3)} LSB/degC",
        abs(pair.fused_slope) == _STATED_PAIR_SLOPE,
    )


def _gyro_bias() -> Statement:
    six, seven = (
        sum(_bias_matches(row["channel"], readings).matches for row in table(4))
        for readings in (READINGS[:6], READINGS)
    )
    return Statement(
        "Section 5.2.2: Table 4's bias is the mean of the six orientations",
        f"the mean of six readings gives {six} of {len(table(4))} printed biases, the mean of all "
        "seven (the check counted) "
        f"{seven} of {len(table4())}",
        six == len(table(4)),
    )


def _bias_matches(channel: str, readings: tuple[str, ...]) -> Cell:
    return numeric_cell(row_of(4, channel), "bias_lsb", mean, numbers_in(row_of(10, channel), readings))


def _adxl_ratio() -> Statement:
    ratios = [number_in(row, "ratio") for row in channels(11, "ADXL")]
    low, high = _STATED_ADXL_RATIOS
    return Statement(
        f"Section 5.2.4: the ADXL345's run-to-run variation is {low} to {high} times the in-run variation",
        f"Table 11's ratio column: {min(ratios)} to {max(ratios)}",
        low <= min(ratios).quantize(low) and max(ratios).quantize(high) <= high,
    )


def _thermometers() -> Statement:
    impossible, unexplained = impossible_deviations(), unexplained_cells()
    worst = ", ".join(
        f"{channel} {deviation} (at most {figure(bound, 3)})" for channel, _, deviation, bound in impossible
    )
    ratios = ", ".join(channel for channel, cell in unexplained if cell.column == "ratio")
    others = "; ".join(
        f"{channel} {cell.value} for {cell.printed}" for channel, cell in unexplained if cell.column != "ratio"
    )
    affected = {channel for channel, *_ in impossible} | {channel for channel, _ in unexplained}
    return Statement(
        "Table 11: standard deviations, ranges and ratios belong together",
        f"{len(impossible)} standard deviations of 15 means are impossible beside their printed "
        f"range: {worst}; the ratio is "
        f"not the quotient of its columns for {ratios}; Tables 6 and 7 give {others}; of the channels so affected "
        f"{sum(is_inertial(row_of(11, channel)) for channel in affected)} are inertial, all others thermometers",
        not affected,
    )


SLIPS: dict[str, Callable[[], Statement]] = {
    "sign of the scale factors": _sign_of_scale,
    "azimuth formula": _azimuth,
    "six-term sum": _six_term_sum,
    "orientation table": _orientation,
    "logging rate": _logging_rate,
    "temperature slopes": _slope_range,
    "combined slope": _pair_slope,
    "gyroscope bias": _gyro_bias,
    "ADXL345 ratios": _adxl_ratio,
    "thermometers": _thermometers,
}


def slips() -> tuple[Statement, ...]:
    """Every statement of `SLIPS`, judged; in a paper without slips all would hold."""
    return tuple(judge() for judge in SLIPS.values())
