"""The paper's conclusions, slips and stated figures, each of which is checked against the paper's own tables.

A `Statement` is a claim with the evidence and the verdict; the verdict is always computed from the tables.
`conclusions` checks those of sections 5.2.4, 6 and 7 by criteria that the evidence states. Two criteria recur: a sign
is common if an exact two-sided sign test gives p < 0.05 (axes assumed to be independent); a figure is significantly
lower, or halved, if its ratio is at most 0.6, because the paper calls a ratio of 0.56 "half". `slips` are the places at
which text, formula or column disagree with the tables. `stated` recomputes the figures in the text; a figure has the
precision of its printed digits: "around 50" is 50 with one digit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from math import atan2, comb, degrees, dist
from typing import NamedTuple

from imuarray.studies.paper.systematic import (
    READINGS,
    as_text,
    count_reproductions,
    determinant,
    main_axis,
    measured_axes,
    mirrored,
    pair_of,
    pairs,
    printed_axes,
    printed_azimuth_deg,
    response_of,
    slopes,
    table4,
)
from imuarray.studies.paper.tables import (
    BMA180_LSB_PER_G,
    Formula,
    RecomputedRow,
    channels,
    dps,
    is_inertial,
    mean,
    number_in,
    numbers_in,
    numeric_cell,
    physical,
    row_of,
    table,
)
from imuarray.studies.paper.variation import (
    FACE_SECONDS,
    HIGH_RATE_HZ,
    TRIADS,
    bias_states,
    bma180_blend,
    boot_faults,
    impossible_deviations,
    number_row,
    plane_ratio,
    readings,
    table10_rates,
    table11_rates,
    unexplained_cells,
)


@dataclass(frozen=True)
class Statement:
    """A claim of the paper (beginning with its place), the evidence from its own tables, and the verdict."""

    claim: str
    evidence: str
    holds: bool


def figure(value: float | Decimal, digits: int) -> str:
    """Return a number for an evidence sentence, with a fixed number of decimals and no negative zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


_SIGN_LEVEL = 0.05
_HALVED = Decimal("0.6")
_ADXL = ("ADXL1", "ADXL2")
_GYROS = ("Gyro1", "Gyro2", "Gyro3")
_STEADY_BMA = ("BMA2", "BMA3", "BMA4")
"""The sensors of turn-on figures. BMA1 is omitted, as in the paper, because one of its runs is a boot fault."""
_STATED_STATES = (("0", "69", "2"), ("-13", "75", "0"))
"""Section 5.2.4, Gyro3's two sets of biases in counts."""
_RANGES = {"BMA": ("1.5g", "16g"), "Gyro": ("250dps", "2k dps")}


def sign_test(positive: int, total: int) -> float:
    """Return the exact two-sided probability of a split at least as uneven as `positive` of `total` under equal
    probabilities.
    """
    tail = sum(comb(total, k) for k in range(min(positive, total - positive) + 1))
    return min(1.0, 2.0 * tail / (1 << total))


def range_ratio(design: str, number: int, columns: Sequence[str], leave_out: str = "") -> Decimal:
    """Return the mean |column| of a design's low range over that of its high range, in physical units, from Table
    `number`.
    """
    low, high = (
        mean(
            [
                abs(physical(row, number_in(row, column)))
                for row in channels(number, design, name)
                for column in columns
                if row["channel"].split()[0] != leave_out
            ]
        )
        for name in _RANGES[design]
    )
    return low / high


def _gyro_sign() -> Statement:
    values = slopes("Gyro")
    positive = sum(slope > 0 for slope in values)
    chance = sign_test(positive, len(values))
    return Statement(
        "6.1: the gyroscopes' temperature drift has a common sign",
        f"{positive} of {len(values)} slopes are positive, sign test p = {figure(chance, 3)}; "
        f"criterion p < {_SIGN_LEVEL}",
        chance < _SIGN_LEVEL,
    )


def _opposed_gyros() -> Statement:
    opposed = [pair for pair in pairs() if pair.opposed and pair.first["channel"].startswith("Gyro")]
    parallel = [pair for pair in pairs() if not pair.opposed and pair.first["channel"].startswith("Gyro")]
    listed = ", ".join(_remainder(pair.first["channel"], pair.second["channel"]) for pair in opposed)
    remainders = ", ".join(_remainder(pair.first["channel"], pair.second["channel"]) for pair in parallel)
    return Statement(
        "6.1, 7: opposed L3G4200D axes cancel temperature drift",
        f"opposed pairs keep {listed}; parallel ones keep {remainders}; criterion: every opposed pair at "
        "least halves the drift",
        bool(opposed) and all(pair.reduction >= 2 for pair in opposed),
    )


def _remainder(first: str, second: str) -> str:
    pair = pair_of(first, second)
    return f"{first}/{second} {figure(abs(pair.fused_slope), 3)} LSB/degC ({figure(pair.reduction, 0)} times less)"


def _not_every_pair() -> Statement:
    y, z = pair_of("Gyro1 y", "Gyro2 y"), pair_of("Gyro1 z", "Gyro2 z")
    return Statement(
        "5.2.5, 6.1: how well a pair cancels is a matter of the pair; not every one is as good as the y axes",
        f"Gyro1/Gyro2 y drift {figure(y.reduction, 0)} times less than one alone, z "
        f"{figure(z.reduction, 0)} times less; criterion: z cancels less than half as well as y",
        2 * z.reduction < y.reduction,
    )


def _adxl_drift() -> Statement:
    perpendicular, plane = slopes("ADXL", axes="z"), slopes("ADXL", axes="xy")
    ratio = mean([abs(slope) for slope in perpendicular]) / mean([abs(slope) for slope in plane])
    pair = pair_of("ADXL1 z", "ADXL2 z")
    return Statement(
        "6.1: both ADXL345 z axes drift clearly negative with temperature, the others much less",
        f"z {', '.join(map(str, perpendicular))} LSB/degC, mean magnitude {figure(ratio, 1)} times that of x "
        "and y; they are parallel here "
        f"(mean {pair.fused_slope}), turned round they would keep {abs(pair.turned_slope)}; "
        "criterion: both negative, 5 times",
        max(perpendicular) < 0 and ratio >= 5,
    )


def _bma_drift() -> Statement:
    values = slopes("BMA")
    positive = sum(slope > 0 for slope in values)
    chance = sign_test(positive, len(values))
    opposed = [pair.reduction for pair in pairs() if pair.opposed and pair.first["channel"].startswith("BMA")]
    return Statement(
        "6.1: the BMA180's temperature drift has no common sign, so opposing its axes does not help",
        f"{positive} of {len(values)} slopes are positive, sign test p = {figure(chance, 2)}; the "
        f"{len(opposed)} opposed pairs "
        f"drift {figure(min(opposed), 1)} to {figure(max(opposed), 1)} times less; criterion p >= {_SIGN_LEVEL}",
        chance >= _SIGN_LEVEL,
    )


def _adxl_planes() -> Statement:
    noise, drift, in_run = (
        [plane_ratio(name, quantity) for name in _ADXL] for quantity in ("noise", "thermal_slope", "in_run")
    )
    return Statement(
        "6.2: the ADXL345's z axis has about double the noise, far more temperature drift and less stable bias",
        f"z over the mean of x and y: noise {_pair_text(noise)}, temperature slope {_pair_text(drift)}, "
        f"in-run variation {_pair_text(in_run)}; criterion: noise 1.8 to 2.2, slope above 3, in-run above 1.5, on both",
        all(Decimal("1.8") <= n <= Decimal("2.2") for n in noise) and min(drift) > 3 and min(in_run) > Decimal("1.5"),
    )


def _pair_text(values: Sequence[Decimal]) -> str:
    return " and ".join(figure(value, 2) for value in values)


def _bma_turn_on() -> Statement:
    ratios = {name: plane_ratio(name, "turn_on") for name in _STEADY_BMA}
    listed = ", ".join(f"{name} {figure(ratio, 2)}" for name, ratio in ratios.items())
    return Statement(
        "6.2: each BMA180's turn-on bias is about twice as high on z",
        f"run-to-run deviation of z over the mean of x and y: {listed} (BMA1 left out, boot fault): always higher, "
        f"{figure(mean(list(ratios.values())), 1)} times on average; criterion: each between 1.5 and 2.5",
        all(Decimal("1.5") <= ratio <= Decimal("2.5") for ratio in ratios.values()),
    )


def _gyro_planes() -> Statement:
    noise, in_run = ([plane_ratio(name, quantity) for name in _GYROS] for quantity in ("noise", "in_run"))
    return Statement(
        "6.2: the gyroscopes' z axis differs little from x and y",
        f"z over the mean of x and y: noise {', '.join(figure(n, 2) for n in noise)}; in-run variation "
        f"{', '.join(figure(n, 2) for n in in_run)}; criterion: every ratio between 2/3 and 3/2",
        all(Decimal(2) <= 3 * ratio and 2 * ratio <= 3 for ratio in (*noise, *in_run)),
    )


def _bma_noise() -> Statement:
    blend = bma180_blend()
    ratio = blend.low_mg / blend.high_mg
    return Statement(
        "6.3: at +-1.5 g the BMA180 has half the noise that it has at +-16 g",
        f"{figure(blend.low_mg, 2)} against {figure(blend.high_mg, 2)} mg, ratio "
        f"{figure(ratio, 2)}; criterion: at most {_HALVED}",
        ratio <= _HALVED,
    )


def _bma_bias() -> Statement:
    ratio = range_ratio("BMA", 3, ["bias_lsb"])
    return Statement(
        "6.3: the BMA180's fixed bias is significantly lower at +-1.5 g in physical units",
        f"mean magnitude {figure(ratio, 3)} times that at +-16 g (Table 3); criterion: at most {_HALVED}",
        ratio <= _HALVED,
    )


def _bma_thermal() -> Statement:
    ratio = range_ratio("BMA", 8, ["slope_lsb_per_degc"])
    return Statement(
        "6.3: the BMA180's temperature drift is slightly lower at +-1.5 g in physical units",
        f"mean magnitude {figure(ratio, 2)} times that at +-16 g (Table 8); criterion: between {_HALVED} and 1",
        _HALVED < ratio < 1,
    )


def _bma_stability() -> Statement:
    in_run = range_ratio("BMA", 11, ["cont_std_of_means"])
    turn_on = range_ratio("BMA", 11, ["runs_std_of_means"], leave_out="BMA1")
    return Statement(
        "6.3: the BMA180's biases are slightly more stable at +-1.5 g in physical units",
        f"low over high range: in-run {figure(in_run, 2)}, run-to-run {figure(turn_on, 2)} without "
        "BMA1 (Table 11): no clear difference; criterion: both below 1",
        in_run < 1 and turn_on < 1,
    )


def _gyro_noise() -> Statement:
    by_range = {name: {row["output"]: row for row in table(9) if row["range"] == name} for name in _RANGES["Gyro"]}
    low, high = (
        [dps(name, number_in(row, "std_lsb")) for row in by_range[name].values() if is_inertial(row)]
        for name in _RANGES["Gyro"]
    )
    ratios = [a / b for a, b in zip(low, high, strict=True)]
    return Statement(
        "6.3: the L3G4200D's noise is not affected by the range",
        f"mean {figure(mean(low), 3)} dps at 250 dps, {figure(mean(high), 3)} at 2000 dps; axis by axis "
        f"{', '.join(figure(ratio, 2) for ratio in ratios)} (Table 9); criterion: every ratio within 10 % of 1",
        all(abs(ratio - 1) <= Decimal("0.1") for ratio in ratios),
    )


def _gyro_only_bias() -> Statement:
    bias = range_ratio("Gyro", 4, ["bias_lsb"])
    deviations = {
        "in-run": range_ratio("Gyro", 11, ["cont_std_of_means"]),
        "g-dependence": range_ratio("Gyro", 4, ["dbias_x_lsb", "dbias_y_lsb", "dbias_z_lsb"]),
        "temperature": range_ratio("Gyro", 8, ["slope_lsb_per_degc"]),
    }
    return Statement(
        "6.3: of the L3G4200D's systematic errors only the fixed bias improves at 250 dps",
        f"250 over 2000 dps in physical units: bias {figure(bias, 2)}, "
        + ", ".join(f"{name} {figure(ratio, 2)}" for name, ratio in deviations.items())
        + f" (one sensor against two); criterion: bias at most {_HALVED}, all others above",
        bias <= _HALVED and min(deviations.values()) > _HALVED,
    )


def _blending() -> Statement:
    blend = bma180_blend()
    over_plain, over_low = (1 - blend.weighted_mg / other for other in (blend.plain_mg, blend.low_mg))
    return Statement(
        "6.3, 7: weighting low and high range BMA180s brings a considerable benefit",
        f"weights {figure(blend.weight_low, 2)} and {figure(1 - blend.weight_low, 2)}: "
        f"{figure(blend.weighted_mg, 2)} mg, "
        f"{figure(100 * over_plain, 0)} % below the plain average ({figure(blend.plain_mg, 2)}), "
        f"{figure(100 * over_low, 0)} % below the low range alone; criterion: 10 % below both",
        min(over_plain, over_low) >= Decimal("0.1"),
    )


def _boot_fault() -> Statement:
    faults = boot_faults()
    listed = ", ".join(
        f"run {fault.run}: {figure(fault.reading_lsb, 1)} LSB is {figure(fault.ratio, 2)} times the median, which fits "
        f"+-{fault.range_g} ({fault.range_lsb_per_g} LSB/g)"
        for fault in faults
    )
    return Statement(
        "5.2.4: run 10 of BMA1 is what the default range of +-2 g would give",
        f"{listed or 'no run stands out'}; criterion: it is the only run nearest to another range, "
        "and that range is 2g",
        [(fault.run, fault.range_g) for fault in faults] == [(10, "2g")],
    )


def _two_states() -> Statement:
    result = bias_states()
    largest_distance = max(
        dist(state.centre, tuple(map(float, stated))) for state, stated in zip(result, _STATED_STATES, strict=True)
    )
    centres = " and ".join(f"({', '.join(figure(value, 1) for value in state.centre)})" for state in result)
    return Statement(
        "5.2.4: Gyro3 comes up in one of two sets of biases, (0, 69, 2) and (-13, 75, 0) LSB",
        f"best two-way split: {centres}, {len(result[0].runs)} and {len(result[1].runs)} runs, "
        f"{figure(largest_distance, 1)} LSB from those at most; criterion: within 2 LSB",
        largest_distance <= 2,
    )


def _all_three() -> Statement:
    verdicts = {"opposed axes": _opposed_gyros(), "planes": _adxl_planes(), "ranges": _blending()}
    listed = ", ".join(f"{name} {'yes' if verdict.holds else 'no'}" for name, verdict in verdicts.items())
    return Statement(
        "7: for each of the three techniques at least one of the three models could benefit",
        f"{listed} (L3G4200D, ADXL345, BMA180); criterion: all three conclusions above hold",
        all(verdict.holds for verdict in verdicts.values()),
    )


CONCLUSIONS: tuple[Callable[[], Statement], ...] = (
    _boot_fault,
    _two_states,
    _gyro_sign,
    _opposed_gyros,
    _not_every_pair,
    _adxl_drift,
    _bma_drift,
    _adxl_planes,
    _bma_turn_on,
    _gyro_planes,
    _bma_noise,
    _bma_bias,
    _bma_thermal,
    _bma_stability,
    _gyro_noise,
    _gyro_only_bias,
    _blending,
    _all_three,
)


def conclusions() -> tuple[Statement, ...]:
    """Return every conclusion with its verdict, in the order of the paper's sections."""
    return tuple(judge() for judge in CONCLUSIONS)


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
    as_printed = count_reproductions(quotient_corrected=False, sum_corrected=True)
    corrected = count_reproductions(quotient_corrected=True, sum_corrected=True)
    total = len(table(3))
    return Statement(
        "Appendix B: azimuth = arctan(f_x / f_y) is 0 along X and 90 degrees along Y",
        f"{channel} points along box {main_axis(response)}: the formula gives "
        f"{figure(printed_azimuth_deg(channel), 1)} deg, "
        f"atan2(f_y, f_x) {figure(true, 1)} deg; with the quotient as printed {as_printed} of {total} scale factors of "
        f"Table 3 come out, turned over {corrected} of {total}",
        as_printed == total,
    )


def _six_term_sum() -> Statement:
    total = len(table(3))
    as_printed = count_reproductions(quotient_corrected=True, sum_corrected=False)
    corrected = count_reproductions(quotient_corrected=True, sum_corrected=True)
    return Statement(
        "Appendix B: the average of six terms is the scale factor",
        f"even with the azimuth corrected the printed sum gives {as_printed} of {total} scale factors "
        f"of Table 3; with the first term's missing cos(azimuth) moved back from the third, {corrected} of {total}",
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
        f"half the difference, and drifts by {figure(pair.fused_slope, 3)} LSB/degC",
        abs(pair.fused_slope) == _STATED_PAIR_SLOPE,
    )


def _gyro_bias() -> Statement:
    six, seven = (
        sum(
            numeric_cell(row, "bias_lsb", mean, numbers_in(row_of(10, row["channel"]), readings)).matches
            for row in table(4)
        )
        for readings in (READINGS[:6], READINGS)
    )
    return Statement(
        "Section 5.2.2: Table 4's bias is the mean of the six orientations",
        f"the mean of six readings gives {six} of {len(table(4))} printed biases, the mean of all "
        f"seven (the check counted) {seven} of {len(table4())}",
        six == len(table(4)),
    )


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
    other_chips = "; ".join(
        f"{channel} {cell.value} for {cell.printed}" for channel, cell in unexplained if cell.column != "ratio"
    )
    affected = {channel for channel, *_ in impossible} | {channel for channel, _ in unexplained}
    return Statement(
        "Table 11: standard deviations, ranges and ratios belong together",
        f"{len(impossible)} standard deviations of 15 means are impossible with their printed "
        f"range: {worst}; the ratio is "
        f"not the quotient of its columns for {ratios}; Tables 6 and 7 give {other_chips}; of the channels so affected "
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
    """Return every statement of `SLIPS` with its verdict; in a paper without slips all would hold."""
    return tuple(judge() for judge in SLIPS.values())


_A3_LSB = (("x", "8.0201", "15.6642"), ("y", "9.8857", "19.3081"), ("z", "9.3002", "18.1645"))
"""Appendix A.3: deviations of a BMA180 at 16 g in counts and in mg."""


class _Figure(NamedTuple):
    """A figure in the text: section, subject, the figure, and its derivation from the inputs."""

    place: str
    what: str
    printed: str
    formula: Formula
    inputs: Sequence[Decimal]
    source: str


def stated() -> tuple[RecomputedRow, ...]:
    """Return every such figure in the order of the sections, in the column `value`."""
    rows = []
    for figure in (*_section_4_and_5_2(), *_section_5_2_4(), *_section_5_2_5(), *_section_6(), *_appendix_a()):
        row = {"value": figure.printed}
        cell = numeric_cell(row, "value", figure.formula, figure.inputs)
        rows.append(number_row(figure.place, figure.what, row, cell, figure.source))
    return tuple(rows)


def _section_4_and_5_2() -> Iterator[_Figure]:
    rate = [mean(table10_rates())]
    slower = "350 Hz over Table 10's rate"
    yield _Figure("Section 4", "whole array logged so much slower", "12", lambda v: HIGH_RATE_HZ / v[0], rate, slower)
    yield _Figure("Section 5.2", "epochs in 15 minutes", "4E+4", lambda v: v[0] * 900, rate, "Table 10's rate")
    for axes, ends in (("xy", ("261", "264")), ("z", ("255", "255"))):
        sizes = [abs(number_in(row, "scale_lsb_per_g")) for row in channels(3, "ADXL", axes=axes)]
        yield from _ends("Section 5.2.1", f"ADXL345 {axes} scale factor, LSB/g", ends, sizes, "Table 3")
    (continuous,) = (reading.middle for reading in readings() if reading.log == "cont")
    yield _Figure("Figure 6", "samples in 5 minutes", "1400", lambda v: v[0], [continuous], "Table 11, (std / sem)^2")


def _section_5_2_4() -> Iterator[_Figure]:
    adxl = [number_in(row, "ratio") for row in channels(11, "ADXL")]
    yield from _ends("Section 5.2.4", "ADXL345 run-to-run over in-run", ("1.2", "1.8"), adxl, "Table 11, ratio")
    gyros = [number_in(row, "ratio") for row in channels(11, "Gyro", "2k dps")]
    yield from _ends("Section 5.2.4", "Gyro1, Gyro2 run-to-run over in-run", ("2.4", "7.7"), gyros, "Table 11, ratio")
    for number, (state, printed) in enumerate(zip(bias_states(), _STATED_STATES, strict=True), start=1):
        for axis, text in zip("xyz", printed, strict=True):
            values = [number_in(table(7)[run - 1], f"{axis}_lsb") for run in state.runs]
            yield _Figure("Section 5.2.4", f"Gyro3 {axis} in state {number}, LSB", text, mean, values, "Table 7, mean")


def _section_5_2_5() -> Iterator[_Figure]:
    section, source = "Section 5.2.5", "Table 8"
    negative = [-slope for slope in slopes("ADXL", axes="xy")]
    yield _Figure(section, "ADXL345 x and y with a negative slope, of 4", "3", _positive, negative, source)
    ratios = [plane_ratio(name, "thermal_slope") for name in _ADXL]
    yield from _ends(section, "ADXL345 z slope over mean of x and y", ("5", "10"), ratios, source)
    yield _Figure(section, "BMA180 z with a positive slope, of 4", "3", _positive, slopes("BMA", axes="z"), source)
    ranges = [*slopes("BMA", "1.5g"), *slopes("BMA", "16g")]
    yield _Figure(section, "BMA180 slope in LSB, 1.5 g over 16 g", "1E+1", _halves, ranges, source)
    yield _Figure(section, "L3G4200D with a positive slope, of 9", "8", _positive, slopes("Gyro"), source)
    but_one = sorted(slopes("Gyro", "2k dps"))[:-1]
    yield from _ends(section, "Gyro1, Gyro2 slope but for one, LSB/degC", ("1.9", "2.6"), but_one, source)
    opposed = [slopes("Gyro", "2k dps", "y")[i] for i in (0, 1)]
    half = "Table 8, half the difference"
    yield _Figure(section, "Gyro1 y, Gyro2 y together, LSB/degC", "0.004", lambda v: (v[0] - v[1]) / 2, opposed, half)


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
    for reading in readings()[:2]:
        what, source = f"seconds at 350 Hz, {reading.log}", "Table 9, (std / sem)^2 / 350 Hz"
        yield _Figure("Appendix A.1", what, "1.4E+3", lambda v: v[0] / HIGH_RATE_HZ, [reading.middle], source)
    per_g = BMA180_LSB_PER_G["16g"]
    for axis, counts, milli_g in _A3_LSB:
        what, source = f"BMA180 {axis} noise, mg", f"{counts} LSB at {per_g} LSB/g"
        yield _Figure("Appendix A.3", what, milli_g, lambda v: 1000 * v[0] / per_g, [Decimal(counts)], source)


def _ends(place: str, what: str, printed: Sequence[str], values: Sequence[Decimal], source: str) -> Iterator[_Figure]:
    """Yield the smallest and the largest of several values, for a text such as "1.2 to 1.8"."""
    yield _Figure(place, f"{what}: least", printed[0], min, values, source)
    yield _Figure(place, f"{what}: most", printed[1], max, values, source)


def _positive(values: Sequence[Decimal]) -> Decimal:
    return Decimal(sum(value > 0 for value in values))


def _halves(values: Sequence[Decimal]) -> Decimal:
    """Return the mean absolute value of the first half divided by that of the second half."""
    sizes = [abs(value) for value in values]
    return mean(sizes[: len(sizes) // 2]) / mean(sizes[len(sizes) // 2 :])
