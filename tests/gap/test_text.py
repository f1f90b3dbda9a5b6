"""What the terminal shows of a diagnosis, and numbers and parameters as a person reads them."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.findings.text import (
    WIDTH,
    chance,
    closed_text,
    number,
    parameters_text,
    scored,
    share,
    specification_text,
    text_of,
)
from tests.report.made_diagnosis import CAUSES, PULLS, made, made_unexplained, made_without_gap, where


def test_everything_is_said_in_order() -> None:
    text = text_of(made())
    heads = (
        "The simulator misses a lag",
        "Verdict  partly explained (chance alone: p < 0.001)",
        "Gap      14 standard deviations (rms) before, 2.9 after, 1.0 without a gap: 86 % (75 to 94) closed",
        "Unknown  31 %",
        "Causes, most probable first",
        "Parts out of specification, worst first",
        "Where it differs: 55 statistics, the worst 6",
        "Not observable in these recordings",
        "Missing, and therefore not compared",
        "Next experiment: Heat the array",
    )
    places = [text.index(head) for head in heads]
    assert places == sorted(places)
    assert max(map(len, text.splitlines())) <= WIDTH == 120


def test_notes_are_shown_up_to_a_dozen() -> None:
    text = text_of(replace(made(), notes=tuple(f"note {number} " * 20 for number in range(20))))
    assert "Notes\n  note 0 note 0" in text and "  note 11 note 11" in text
    assert "note 12" not in text and "  8 more in gap.json and report.html (-o DIR)" in text
    assert "Notes" not in text_of(replace(made(), notes=()))


def test_causes() -> None:
    lines = text_of(made()).splitlines()
    first = next(place for place, line in enumerate(lines) if "thermal_lag" in line and "add" in line)
    assert lines[first].split() == ["97", "%", "add", "thermal_lag", "Gyro2", "closes", "86", "%", "(75", "to", "94)"]
    assert lines[first + 1].strip() == "time constant 12.3 s. may also be random_walk"
    assert any(line.strip() == "offset 0, 0, 12.3 mg. in the metadata, not in the sensor" for line in lines)
    both = text_of(replace(made(), causes=tuple(replace(cause, needs_both=True) for cause in CAUSES[:1])))
    assert "random_walk. detected on both parts together, none was held out" in both
    starts = {line.index(cause.effect) for cause in CAUSES for line in lines if f" {cause.effect} " in line}
    assert lines[first].index("thermal_lag") in starts


def test_the_worst_of_each_statistic_stand_in_columns() -> None:
    """Six kinds among 55: three statistics, of an axis or of all."""
    lines = text_of(made()).splitlines()
    start = next(place for place, line in enumerate(lines) if line.startswith("Where it differs"))
    rows = lines[start + 1 : start + 8]
    assert lines[start + 8] == ""
    assert rows[1].split() == [
        "Gyro2", "x", "temperature", "thermal_change", "face_0", "50.9", "0", "dps", "s/degC", "+412.3", "103",
        "material",
    ]  # fmt: skip
    ends = {row.index(word) for row, word in zip(rows[1:], ["material"] * 6, strict=True)}
    assert len(ends) == 1


def test_only_parts_out_of_specification_are_listed_worst_first() -> None:
    lines = text_of(made()).splitlines()
    start = next(place for place, line in enumerate(lines) if line.startswith("Parts out of specification"))
    assert [line.split() for line in lines[start + 1 : start + 5]] == [
        ["sensor", "quantity", "value", "tolerance", "unit", "pull", "source"],
        ["Gyro1", "data", "rate", "102", "1", "Hz", "+2.5", "L3G-12"],
        ["BMA2", "z", "scale", "0.964", "0.03", "-1.2", "BMA-20"],
        [],
    ]


@pytest.mark.parametrize(("pull", "outside"), [(0.99, False), (1.0, False), (-1.01, True), (3.0, True), (nan, False)])
def test_a_part_is_out_of_specification_beyond_one_tolerance(pull: float, outside: bool) -> None:
    assert replace(PULLS[0], pull=pull).is_out_of_specification == outside


def test_a_part_out_of_specification_in_a_sentence() -> None:
    said = "BMA2 z: scale is 1.2 tolerances off: this part is out of specification"
    assert specification_text(PULLS[2]) == said
    assert specification_text(PULLS[1]).startswith("Gyro1: data rate is 2.5 tolerances off")


def test_what_is_missing_is_listed() -> None:
    assert "not compared\n  no chip thermometer in tumble.h5\n  no reference temp" in text_of(made())


def test_no_gap() -> None:
    text = text_of(made_without_gap())
    assert "Verdict  no gap (chance alone: p = 0.41)" in text
    assert "Gap      nothing to close; the statistics that differ most are at 1.0 standard deviations (rms)" in text
    for absent in ("Causes", "Where it differs", "Unknown", "Next experiment", "specification", "Missing"):
        assert absent not in text


def test_unexplained() -> None:
    text = text_of(made_unexplained())
    assert "Verdict  unexplained" in text and "Unknown  93 %" in text
    assert "5 % (-6 to 14) closed" in text


@given(st.text(max_size=300), st.floats(), st.floats())
def test_no_text_steers_the_terminal_or_breaks_the_width(name: str, real: float, score: float) -> None:
    hostile = replace(
        made(),
        sentence=name,
        where=(replace(where(0, 1.0), sensor=name, phase=name, unit=name, real=real, significance=score),),
        causes=(replace(CAUSES[0], effect=name, sensors=(name,) * 9, parameters={name: name}),),
        next_experiment=name,
        pulls=(replace(PULLS[1], sensor=name, quantity=name, unit=name, source=name, value=real, tolerance=score),),
        missing=(name,),
    )
    lines = text_of(hostile).split("\n")
    assert all(line.isprintable() for line in lines)
    assert max(map(len, lines)) <= WIDTH


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (-0.0, "0"), (12.345, "12.3"), (999.7, "1000"), (1234.5, "1234"), (123456.0, "123456"),
        (1.2e7, "1.2e+07"), (0.00012345, "0.000123"), (-3.0, "-3"), (nan, "–"), (inf, "–"),
    ],
)  # fmt: skip
def test_numbers(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0.0"), (9.94, "9.9"), (9.96, "10"), (412.3, "412"), (-1.5, "-1.5"), (inf, "∞"), (nan, "–")],
)
def test_scores(value: float, text: str) -> None:
    assert scored(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0 %"), (0.004, "<1 %"), (0.006, "1 %"), (0.994, "99 %"), (0.996, ">99 %"), (1.0, "100 %"), (None, "–"),
        (nan, "–"), (-0.06, "-6 %"), (1.2, "120 %"),
    ],
)  # fmt: skip
def test_shares(value: float | None, text: str) -> None:
    assert share(value) == text


def test_closed_and_chance() -> None:
    assert closed_text(0.86, (0.75, 0.94)) == "86 % (75 to 94)"
    assert closed_text(0.86, None) == "86 %"
    assert closed_text(0.999, (0.996, 1.0)) == ">99 %"
    assert closed_text(1.0, (0.97, 1.0)) == "100 % (97 to 100)"
    assert closed_text(None, None) == "–"
    assert [chance(p) for p in (0.5, 0.0312, 0.00049, nan)] == ["p = 0.5", "p = 0.031", "p < 0.001", "p –"]


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"offset_g": [0.0123, -0.004, 0.0]}, "offset 12.3, -4, 0 mg"),
        ({"limit_g": 1.5}, "limit 1.5 g"),
        ({"slope_dps_per_degc": 0.1, "reference_degc": 25.0}, "slope 0.1 dps/°C; reference 25 °C"),
        ({"quadratic_g_per_degc2": 1e-4}, "quadratic 0.1 mg/°C²"),
        ({"slope_per_degc": 0.0003}, "slope 0.0003 /°C"),
        ({"density_dps_per_sqrt_s": 0.02}, "density 0.02 dps/√s"),
        ({"cubic_per_g2": 0.01}, "cubic 0.01 /g²"),
        ({"response_dps_per_g": [0.1, 0.2, 0.3]}, "response 0.1, 0.2, 0.3 dps/g"),
        ({"error": 0.012, "probability": 0.5}, "error 1.2 %; probability 50 %"),
        ({"error_ppm": 40.0}, "error 40 ppm"),
        ({"drift_hz_per_h": -11.5, "frequency_spread_hz": 2.0}, "drift -11.5 Hz/h; frequency spread 2 Hz"),
        ({"switches_per_s": 0.2, "step_lsb": 2, "phase_deg": 12.0}, "switches 0.2 /s; step 2 LSB; phase 12°"),
        ({"time_constant_s": 12.0, "burst_rows": 3.0}, "time constant 12 s; burst rows 3"),
        ({"axes": "+Y+X+Z", "kind": "torn"}, "axes +Y+X+Z; kind torn"),
        ({}, ""),
        ({"cutoff_hz": 15.5, "spans": [1.0, 97.12, 1e9]}, "cutoff 15.5 Hz; in log 2 from 97.1 s on"),
        (
            {"spans": [0.0, 0.0, 8.5, 0.0, 20.0, 30.0, 2.0, 0.0, 1e9]},
            "in log 1 until 8.5 s; in log 1 from 20 to 30 s; in log 3",
        ),
        (
            {"runs": [0.0, 0.0, 3.0], "moments_s": [12.39, 20.93, 4.0], "lengths_s": [0.48, 0.1, 0.5]},
            "in log 1 at 12.4, 20.9 s for 0.1 to 0.48 s; in log 4 at 4 s for 0.5 s",
        ),
        ({"runs": [1.0] * 11, "moments_s": list(range(11))}, "in log 2 at 0, 1, 2, 3, 4, 5, 6, 7, 8 ... (11 in all) s"),
        ({"range": 2.0, "runs": [1.0, 4.0]}, "range 2; in log 2; in log 5"),
    ],
)
def test_parameters(parameters: dict[str, Any], text: str) -> None:
    assert parameters_text(parameters) == text
