"""The paper's conclusions of sections 5.2.4, 6 and 7, each judged from its tables by a criterion stated in the
evidence.

Two criteria recur. A sign is common when an exact two-sided sign test gives p < 0.05 (axes taken as independent). A
figure counts as significantly lower, or halved, when its ratio is at most 0.6: the paper says "half" of a ratio of
0.56.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from math import comb, dist

from imuarray.paper.noise import bma180_blend, plane_ratio
from imuarray.paper.startup import bias_states, boot_faults
from imuarray.paper.statement import Statement, figure
from imuarray.paper.tables import channels, dps, is_inertial, mean, number_in, physical, table
from imuarray.paper.thermal import pair_of, pairs, slopes

_SIGN_LEVEL = 0.05
_HALVED = Decimal("0.6")
_ADXL = ("ADXL1", "ADXL2")
_GYROS = ("Gyro1", "Gyro2", "Gyro3")
_STEADY_BMA = ("BMA2", "BMA3", "BMA4")
"""BMA1 is left out of turn-on figures, as the paper does: one of its runs is a boot fault."""
_STATED_STATES = ((0.0, 69.0, 2.0), (-13.0, 75.0, 0.0))
"""Section 5.2.4, Gyro3's two sets of biases in counts."""
_RANGES = {"BMA": ("1.5g", "16g"), "Gyro": ("250dps", "2k dps")}


def sign_test(positive: int, total: int) -> float:
    """Exact two-sided probability of a split at least as uneven as `positive` of `total`, were both signs as likely."""
    tail = sum(comb(total, k) for k in range(min(positive, total - positive) + 1))
    return min(1.0, 2.0 * tail / (1 << total))


def range_ratio(design: str, number: int, columns: Sequence[str], leave_out: str = "") -> Decimal:
    """Mean |column| of a design's low range over that of its high range, in physical units, from Table `number`."""
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
    kept = ", ".join(_remainder(pair.first["channel"], pair.second["channel"]) for pair in parallel)
    return Statement(
        "6.1, 7: opposed L3G4200D axes cancel temperature drift",
        f"opposed pairs keep {listed}; parallel ones keep {kept}; criterion: every opposed pair at "
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
        f"{figure(z.reduction, 0)} times less; "
        "criterion: z cancels less than half as well as y",
        2 * z.reduction < y.reduction,
    )


def _adxl_drift() -> Statement:
    out, plane = slopes("ADXL", axes="z"), slopes("ADXL", axes="xy")
    ratio = mean([abs(slope) for slope in out]) / mean([abs(slope) for slope in plane])
    pair = pair_of("ADXL1 z", "ADXL2 z")
    return Statement(
        "6.1: both ADXL345 z axes drift clearly negative with temperature, the others much less",
        f"z {', '.join(map(str, out))} LSB/degC, mean magnitude {figure(ratio, 1)} times that of x "
        "and y; they are parallel here "
        f"(mean {pair.fused_slope}), turned round they would keep {abs(pair.turned_slope)}; "
        "criterion: both negative, 5 times",
        max(out) < 0 and ratio >= 5,
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
        [plane_ratio(name, what) for name in _ADXL] for what in ("noise", "thermal_slope", "in_run")
    )
    return Statement(
        "6.2: the ADXL345's z axis has about double the noise, far more temperature drift and less stable bias",
        f"z over the mean of x and y: noise {_both(noise)}, temperature slope {_both(drift)}, "
        f"in-run variation {_both(in_run)}; "
        "criterion: noise 1.8 to 2.2, slope above 3, in-run above 1.5, on both",
        all(Decimal("1.8") <= n <= Decimal("2.2") for n in noise) and min(drift) > 3 and min(in_run) > Decimal("1.5"),
    )


def _both(values: Sequence[Decimal]) -> str:
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
    noise, in_run = ([plane_ratio(name, what) for name in _GYROS] for what in ("noise", "in_run"))
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
        "BMA1 (Table 11): no clear "
        "difference; criterion: both below 1",
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
    others = {
        "in-run": range_ratio("Gyro", 11, ["cont_std_of_means"]),
        "g-dependence": range_ratio("Gyro", 4, ["dbias_x_lsb", "dbias_y_lsb", "dbias_z_lsb"]),
        "temperature": range_ratio("Gyro", 8, ["slope_lsb_per_degc"]),
    }
    return Statement(
        "6.3: of the L3G4200D's systematic errors only the fixed bias improves at 250 dps",
        f"250 over 2000 dps in physical units: bias {figure(bias, 2)}, "
        + ", ".join(f"{name} {figure(ratio, 2)}" for name, ratio in others.items())
        + f" (one sensor against two); criterion: bias at most {_HALVED}, all others above",
        bias <= _HALVED and min(others.values()) > _HALVED,
    )


def _blending() -> Statement:
    blend = bma180_blend()
    over_plain, over_low = (1 - blend.weighted_mg / other for other in (blend.plain_mg, blend.low_mg))
    return Statement(
        "6.3, 7: weighting low and high range BMA180s brings a considerable benefit",
        f"weights {figure(blend.weight_low, 2)} and {figure(1 - blend.weight_low, 2)}: "
        f"{figure(blend.weighted_mg, 2)} mg, "
        f"{figure(100 * over_plain, 0)} % below the plain average ({figure(blend.plain_mg, 2)}), "
        f"{figure(100 * over_low, 0)} % below "
        "the low range alone; criterion: 10 % below both",
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
    found = bias_states()
    apart = max(dist(state.centre, stated) for state, stated in zip(found, _STATED_STATES, strict=True))
    centres = " and ".join(f"({', '.join(figure(value, 1) for value in state.centre)})" for state in found)
    return Statement(
        "5.2.4: Gyro3 comes up in one of two sets of biases, (0, 69, 2) and (-13, 75, 0) LSB",
        f"best two-way split: {centres}, {len(found[0].runs)} and {len(found[1].runs)} runs, "
        f"{figure(apart, 1)} LSB from "
        "those at most; criterion: within 2 LSB",
        apart <= 2,
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
    """Every conclusion, judged, in the order of the paper's sections."""
    return tuple(judge() for judge in CONCLUSIONS)
