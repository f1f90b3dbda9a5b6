"""`imuarray.studies.paper.findings`: every frozen figure derived again from tables and data sheets."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import atan2, degrees, exp, log, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2, f

from imuarray.chips import CHIPS
from imuarray.cli import main
from imuarray.simulate.effect import from_table
from imuarray.simulate.effects import EFFECTS
from imuarray.studies.paper.findings import Finding, as_json, findings, render_text
from imuarray.studies.paper.tables import DEGC, FACES_DEGC, number_in, row_of, table

AXES = "xyz"
ARRAY_NOISE = ((10, "std_lsb"), (11, "runs_std"), (11, "cont_std"))
STEADY = [
    row["channel"] for row in table(11) if row["range"] != "int" and not row["channel"].startswith(("BMA1", "Gyro3"))
]


def value(number: int, channel: str, column: str) -> float:
    return float(number_in(row_of(number, channel), column))


def noise(sensors: tuple[str, ...], axes: str = AXES, unit_per_lsb: float = 1.0) -> float:
    """Root mean square of the noise in Tables 10 and 11."""
    columns = [value(number, f"{name} {axis}", at) for name in sensors for axis in axes for number, at in ARRAY_NOISE]
    return float(np.sqrt(np.mean(np.square(columns)))) * unit_per_lsb


def gyro_noise_dps() -> float:
    high = noise(("Gyro1", "Gyro2"), unit_per_lsb=0.07)  # L3G-42
    low = noise(("Gyro3",), unit_per_lsb=0.00875)  # L3G-40
    return sqrt((2 * high**2 + low**2) / 3)


def high_rate_bandwidth_hz() -> float:
    """Bandwidth at which Table 9's noise has the density of L3G-74."""
    deviations = [float(row["std_dps"]) for row in table(9) if not row["output"].endswith("t")]
    return float(np.mean([(deviation / 0.03) ** 2 for deviation in deviations]))


def pole_hz(correlation: float) -> float:
    """Cut-off of one pole whose output, read at 350 Hz, has this correlation of neighbours."""
    return -log(correlation) * 350 / (2 * pi)


def runs(number: int) -> npt.NDArray[np.float64]:
    return np.array([[float(number_in(row, f"{axis}_lsb")) for axis in AXES] for row in table(number)])


def half_difference(channel: str, box_axis: str) -> float:
    """Response to 1 g along an axis of the box, counts."""
    return (value(10, channel, f"{box_axis}_up") - value(10, channel, f"{box_axis}_down")) / 2


def angle_deg(channel: str, towards: str, own: str) -> float:
    """Size of the angle towards a box axis of an axis along the box axis `own`."""
    return degrees(atan2(abs(half_difference(channel, towards)), abs(half_difference(channel, own))))


def milli_g_per_degc(channel: str, lsb_per_g: float) -> float:
    return abs(value(8, channel, "slope_lsb_per_degc")) / lsb_per_g * 1000


def face_difference_shares() -> dict[tuple[str, str], float]:
    """Table 4's differences of opposite faces, two means, over the in-run deviation of such a difference."""
    return {
        (row["channel"], k): float(row[f"dbias_{k}_lsb"]) / (sqrt(2) * value(11, row["channel"], "cont_std_of_means"))
        for row in table(4)
        for k in AXES
    }


def second_set() -> npt.NDArray[np.bool_]:
    """Runs of Table 7 below the widest interval on x."""
    x = runs(7)[:, 0]
    ordered = np.sort(x)
    widest = int(np.argmax(np.diff(ordered)))
    return np.asarray(x <= ordered[widest])


def over_white_noise() -> dict[str, float]:
    rows = [row for row in table(11) if row["range"] != "int"]
    return {row["channel"]: float(row["cont_std_of_means"]) / float(row["cont_sem"]) for row in rows}


def over_in_run() -> dict[str, float]:
    return {
        channel: value(11, channel, "runs_std_of_means") / value(11, channel, "cont_std_of_means") for channel in STEADY
    }


def other_day(channel: str) -> float:
    warm = DEGC[11, "runs_mean"] - FACES_DEGC[0]
    known = value(10, channel, "z_up") + value(8, channel, "slope_lsb_per_degc") * warm
    return value(11, channel, "runs_mean") - known


def days_apart() -> dict[str, float]:
    return {channel: other_day(channel) / value(11, channel, "runs_std_of_means") for channel in STEADY}


def count(shares: dict[Any, float], limit: float) -> int:
    return sum(abs(share) > limit for share in shares.values())


def white_noise_limit() -> float:
    return sqrt(chi2.ppf(0.999, 14) / 14)


PRINTED: dict[str, list[Callable[[], float]]] = {
    "filter of the high-rate gyroscope": [lambda: 0.4, lambda: pole_hz(0.4), high_rate_bandwidth_hz],
    "line on the gyroscope's y axis": [lambda: 1, lambda: 6],
    "even codes": [lambda: noise(("ADXL1", "ADXL2"), "xy"), lambda: noise(("ADXL1", "ADXL2"), "z")],
    "noise of the BMA180": [
        lambda: (noise(("BMA1", "BMA2")) / 512 / 150e-6) ** 2,  # BMA-76, BMA-110
        lambda: (noise(("BMA3", "BMA4")) / 5460 / 150e-6) ** 2,  # BMA-71
    ],
    "filter of the gyroscopes in the array": [lambda: (gyro_noise_dps() / 0.03) ** 2],  # L3G-74
    # Table 10: BMA3 x is along box Y and its z along box Z
    "axes that lean": [lambda: angle_deg("BMA3 x", "z", "y"), lambda: angle_deg("BMA3 z", "y", "z")],
    "force on gyroscopes": [
        lambda: value(10, "Gyro3 x", "y_up") - value(10, "Gyro3 x", "y_down"),
        lambda: face_difference_shares()["Gyro3 x", "y"],
        lambda: count(face_difference_shares(), 3),
    ],
    "boot fault": [lambda: runs(6)[9, 2] / np.median(runs(6)[:, 2]) * 512],
    "two states": [
        lambda: float(np.diff(np.sort(runs(7)[:, 0])).max()),
        lambda: max(runs(7)[part, 0].std(ddof=1) for part in (second_set(), ~second_set())),
        lambda: runs(7)[second_set(), 1].mean() - runs(7)[~second_set(), 1].mean(),
    ],
    "slopes beyond the data sheet": [
        lambda: milli_g_per_degc("BMA2 z", 512),
        lambda: milli_g_per_degc("BMA3 z", 5460),
        lambda: milli_g_per_degc("BMA2 y", 512),
    ],
    "wander within a run": [
        lambda: count(over_white_noise(), white_noise_limit()),
        lambda: max(over_white_noise().values()),
    ],
    "another bias at each switch-on": [
        lambda: count(over_in_run(), sqrt(f.ppf(0.999, 14, 14))),
        lambda: max(value(11, channel, "ratio") for channel in STEADY),
    ],
    "levels of other days": [
        lambda: other_day("BMA4 x"),
        lambda: days_apart()["BMA4 x"],
        lambda: count(days_apart(), 3),
    ],
}
"""By finding, in the order of its figures."""


def finding(name: str) -> Finding:
    return next(one for one in findings() if one.name == name)


def test_every_figure_has_a_derivation_here() -> None:
    assert {one.name: len(one.figures) for one in findings()} == {name: len(some) for name, some in PRINTED.items()}


@pytest.mark.parametrize("name", PRINTED)
def test_figures_equal_those_from_the_published_tables(name: str) -> None:
    derived = [float(work_out()) for work_out in PRINTED[name]]
    assert [figure.printed for figure in finding(name).figures] == pytest.approx(derived, rel=2e-3)


def test_noise_with_even_codes_is_consistent_with_the_data_sheet() -> None:
    # ADX-67, ADX-68: 0.75 and 1.1 LSB at 100 Hz, root 2 an octave; codes 1 or 2 apart add 1/12 or 4/12
    for figure, at_100_hz in zip(finding("even codes").figures, (0.75, 1.1), strict=True):
        assert figure.data_sheet == pytest.approx(sqrt(at_100_hz**2 * 4 + 1 / 12), rel=1e-3)
        assert figure.with_cause == pytest.approx(sqrt(at_100_hz**2 * 32 + 4 / 12), rel=1e-3)
    plane, z = (figure.printed / (figure.with_cause or 0) for figure in finding("even codes").figures)
    assert (plane, z) == pytest.approx((1.4, 1.9), abs=0.05)
    assert finding("even codes").parameters["rate_hz"] == max(CHIPS["adxl345"].rates_hz)


def test_filters_of_the_chips_explain_the_findings() -> None:
    assert max(CHIPS["bma180"].allowed_bandwidths_hz(2400.0)) == 1200.0 < 3943
    assert 35.0 in CHIPS["l3g4200d"].allowed_bandwidths_hz(800.0)
    assert finding("filter of the gyroscopes in the array").parameters == {"bandwidth_hz": 35.0}
    low, high = noise(("BMA3", "BMA4")) / 5460, noise(("BMA1", "BMA2")) / 512
    assert 0.5 < low / high < 0.6


def test_band_limited_noise_explains_the_correlation() -> None:
    band_hz = high_rate_bandwidth_hz()
    one_pole_hz = 2 * band_hz / pi  # noise bandwidth of one pole: pi / 2 times its cut-off
    assert exp(-2 * pi * one_pole_hz / 350) == pytest.approx(0.28, abs=0.005)
    assert np.sinc(2 * band_hz / 350) == pytest.approx(0.44, abs=0.005)
    assert finding("filter of the high-rate gyroscope").parameters == {"cutoff_hz": 51.0}


def test_the_line_does_not_increase_the_noise_observably() -> None:
    x, y, _, high_x, high_y, _ = (float(row["std_dps"]) for row in table(9) if not row["output"].endswith("t"))
    assert y < x
    assert high_y < high_x


def test_only_two_slopes_are_beyond_the_data_sheet() -> None:
    lsb_per_g = {"BMA1": 512, "BMA2": 512, "BMA3": 5460, "BMA4": 5460}
    slopes = {
        f"{name} {axis}": milli_g_per_degc(f"{name} {axis}", lsb) for name, lsb in lsb_per_g.items() for axis in AXES
    }
    assert [name for name, slope in slopes.items() if slope > 0.51] == ["BMA2 z", "BMA3 z"]
    assert sum(slope > 0.5 for slope in slopes.values()) == 3
    dps = {row["channel"]: abs(float(row["slope_lsb_per_degc"])) for row in table(8) if "Gyro" in row["channel"]}
    assert max(slope for name, slope in dps.items() if name[:5] != "Gyro3") * 0.07 < 0.04  # L3G-71
    assert max(slope for name, slope in dps.items() if name[:5] == "Gyro3") * 0.00875 < 0.03


def test_parameters_of_boot_faults_and_states_follow_from_runs() -> None:
    usual = np.delete(runs(6), 9, axis=0).mean(axis=0) / 512
    assert finding("boot fault").parameters["offset_g"] == pytest.approx((runs(6)[9] / 4096 - usual).tolist(), abs=5e-5)
    state = runs(7)[second_set()].mean(axis=0) - runs(7)[~second_set()].mean(axis=0)
    assert finding("two states").parameters["offset_dps"] == pytest.approx((state * 0.00875).tolist(), abs=5e-5)
    assert finding("two states").parameters["probability"] == pytest.approx(second_set().mean(), abs=5e-5)
    assert second_set().sum() == 8


def test_findings_name_the_sensors_beyond_the_limits() -> None:
    shown = {
        "wander within a run": [name for name, share in over_white_noise().items() if share > white_noise_limit()],
        "another bias at each switch-on": [name for name, share in over_in_run().items() if share > 2.435],
        "levels of other days": [name for name, share in days_apart().items() if abs(share) > 3],
    }
    for name, channels in shown.items():
        assert sorted({channel.split()[0] for channel in channels}) == list(finding(name).sensors)


def test_statements_on_angles_and_levels_follow_from_the_tables() -> None:
    own = {row["channel"]: max(AXES, key=lambda k: abs(half_difference(row["channel"], k))) for row in table(3)}
    others = [angle_deg(at, k, axis) for at, axis in own.items() for k in AXES if k != axis and at[:4] != "BMA3"]
    assert max(others) == pytest.approx(3.4, abs=0.1)
    # sensor x = -Y and z = -Z: a turn about y moves one towards the other, and the other away
    assert half_difference("BMA3 x", "z") * half_difference("BMA3 z", "y") < 0
    assert half_difference("BMA3 x", "y") < 0
    assert half_difference("BMA3 z", "z") < 0 < half_difference("BMA4 x", "y")
    assert other_day("BMA3 x") > 10
    assert value(10, "Gyro3 y", "z_up") - value(10, "Gyro3 y", "z_up_check") == pytest.approx(2.42, abs=0.01)


@pytest.mark.parametrize("one", findings(), ids=lambda one: one.name)
def test_causes_are_effects_of_the_simulator(one: Finding) -> None:
    assert one.figures
    assert {name for name in (one.effect, *one.confusable_with) if name} <= set(EFFECTS)
    assert set(one.sensors) <= {row["sensor"] for row in table(1)}
    assert one.action in ("add", "remove", "replace")
    if one.effect and one.parameters:
        unit = "dps" if one.sensors[0].startswith("Gyro") else "g"
        from_table(EFFECTS[one.effect], one.parameters, unit, one.name)  # raises where a name or size is wrong


def test_the_object_has_the_keys_of_gap_diagnose() -> None:
    result = as_json()
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    keys = (
        "verdict",
        "gap",
        "where",
        "causes",
        "unknown",
        "unexplained",
        "next_experiment",
        "seed",
        "model",
        "software",
    )
    assert tuple(result) == (*keys, "findings")
    wanted = {"effect", "action", "sensors", "axes", "probability", "parameters", "closed", "closed_ci95"}
    assert all(wanted | {"confusable_with"} <= set(cause) for cause in result["causes"])
    assert result["verdict"] == "partly explained"
    assert {place["statistic"] for place in result["unexplained"]} == {
        figure.of for figure in finding("levels of other days").figures
    }
    lean = next(place for place in result["where"] if (place["sensor"], place["axis"]) == ("BMA3", "x"))
    assert (lean["log"], lean["domain"], lean["significance"]) == ("Table 10", "force", None)
    assert lean["effect_size"] == pytest.approx(4.92 - 1.0)


def test_the_text_fits_its_width_and_is_complete() -> None:
    text = render_text()
    assert max(map(len, text.splitlines())) <= 100
    for words in (
        "range_reset; BMA1",
        "odr_error, or quantisation; ADXL1, ADXL2",
        "unknown; ADXL1",
        "4112 LSB/g (data",
    ):
        assert words in text
    for one in findings():
        assert f"{one.name[1:]} ({one.place})" in text


def test_the_command_prints_and_writes_the_findings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "gap"
    assert main(["paper", "--gap", "--json", "-o", str(out)]) == 0
    assert json.loads(capsys.readouterr().out) == as_json() == json.loads((out / "gap.json").read_text())
    assert [path.name for path in out.iterdir()] == ["gap.json"]
    assert main(["paper", "--gap", "-o", str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["paper", "--gap"]) == 0
    assert capsys.readouterr().out == render_text()
    assert main(["paper", "--gap", "--replica"]) == 2
    assert "give either --replica or --gap" in capsys.readouterr().err
