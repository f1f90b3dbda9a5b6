"""The terminal output of a diagnosis."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imuarray.gap.findings.diagnosis import Cause, Diagnosis, Unobservable
from imuarray.gap.findings.text import WIDTH, text_of
from imuarray.simulate.effects import EFFECTS
from tests.report.example_diagnoses import (
    CAUSES,
    PULLS,
    diagnosis_without_gap,
    partial_diagnosis,
    unexplained_diagnosis,
    where,
)

SIZE_EFFECT = Cause(
    "size_effect", "add", ("ADXL1",), (), 0.4, {"position_mm": [41.5, 0.0, -13.7]}, 0.3, (-0.4, 0.6), ()
)


def said(diagnosis: Diagnosis) -> str:
    """The text in one line, without the indents."""
    return " ".join(text_of(diagnosis).split())


def test_all_sections_are_printed_in_order() -> None:
    """The verdict, differences, causes, the check on held-out data, parts, effects that could not be tested, and what
    to record.
    """
    text = text_of(partial_diagnosis())
    heads = (
        "Verdict  partly explained: only 86 % of the gap closes (explained from 95 % on)",
        "Chance   p < 0.0025: none of 400 simulations without a gap differs as much",
        "Unknown  31 % that something outside the library of effects is present",
        "Where it differs: 55 statistics, the worst of a sensor and domain (sd: standard deviations of chance)",
        "Causes, most probable first",
        "Check on held-out data",
        "Parts out of specification, worst first",
        "Notes",
        "Not observable in these recordings, and what to record",
        "Missing, and therefore not compared",
        "Next experiment: Heat the array",
    )
    places = [text.index(head) for head in heads]
    assert places == sorted(places)
    assert max(map(len, text.splitlines())) <= WIDTH == 120


def test_up_to_a_dozen_notes_are_printed() -> None:
    text = text_of(replace(partial_diagnosis(), notes=tuple(f"note {number} " * 20 for number in range(20))))
    assert "Notes\n  note 0 note 0" in text and "  note 11 note 11" in text
    assert "note 12" not in text and "  8 more in gap.json and report.html (-o DIR)" in text
    assert "Notes" not in text_of(replace(partial_diagnosis(), notes=()))


def test_a_common_note_of_several_logs_is_printed_once() -> None:
    notes = ("heating.h5: 25 degC is assumed", "tumble.h5: 25 degC is assumed", "tumble.h5: it was shaken", "a line")
    text = text_of(
        replace(partial_diagnosis(), notes=notes, missing=("no events in heating.h5", *partial_diagnosis().missing))
    )
    assert "Notes\n  all logs: 25 °C is assumed\n  tumble.h5: it was shaken\n  a line\n" in text
    assert "\n  no events in heating.h5\n  no chip thermometer in tumble.h5\n" in text
    both = tuple(f"no reference temperature in {name}.h5" for name in ("heating", "tumble"))
    assert "compared\n  no reference temperature in all logs\n" in text_of(replace(partial_diagnosis(), missing=both))


def test_causes_are_printed_with_parameters_and_alternatives() -> None:
    lines = text_of(partial_diagnosis()).splitlines()
    first = next(place for place, line in enumerate(lines) if "thermal_lag in" in line)
    about = "the sensing element, or a part of it, warms up later than the box"
    assert lines[first : first + 4] == [
        f"   97 %  thermal_lag in Gyro2: {about}",
        "         time constant 12.3 s",
        "         may also be random_walk",
        "         if this were the cause, it would close 86 % (75 to 94) of the gap of Gyro2 on held-out data",
    ]
    assert "   62 %  bias other than the simulator's in BMA1, BMA2 (z): the reading differs" in text_of(
        partial_diagnosis()
    )
    bias = next(place for place, line in enumerate(lines) if "bias other" in line)
    assert lines[bias + 1 : bias + 4] == [
        "         BMA1: offset 0, 0, 12.3 mg",
        "         BMA2: offset 0, 0, -45.6 mg",
        "         in the metadata, not in the sensor",
    ]
    many = replace(CAUSES[3], each={f"B{at}": {"offset_g": [0.0, 0.0, 0.001 * at]} for at in range(6)})
    text = said(replace(partial_diagnosis(), causes=(many,)))
    assert "B3: offset 0, 0, 3 mg 2 more sensors: see gap.json (-o DIR)" in text and "B4" not in text
    both = said(replace(partial_diagnosis(), causes=tuple(replace(cause, needs_both=True) for cause in CAUSES[:1])))
    assert "of the gap of Gyro2 on the data that showed it" in both
    assert "Check on the data that showed the gap: no part was held out" in both


def test_a_displacement_is_relative_to_the_configured_position() -> None:
    text = said(replace(partial_diagnosis(), causes=(*CAUSES, SIZE_EFFECT)))
    assert "displacement from the configured position (box X, Y, Z) 41.5, 0, -13.7 mm" in text
    assert "if this were the cause, it would close 30 % (below 0 to 60) of the gap of ADXL1" in text


def test_closure_of_a_later_cause_is_relative_to_the_remainder() -> None:
    text = said(replace(partial_diagnosis(), causes=(*CAUSES, replace(SIZE_EFFECT, preceding=1))))
    assert "would close 30 % (below 0 to 60) of what the previous causes leave of the gap of ADXL1" in text


def test_an_alternative_is_marked_as_not_in_the_simulator() -> None:
    other = replace(CAUSES[0], effect="random_walk", probability=0.1, alternative_to="thermal_lag")
    text = said(replace(partial_diagnosis(), causes=(CAUSES[0], other)))
    assert "instead of thermal_lag, not besides it" in text
    assert "With thermal_lag in the simulator: 14 standard" in text
    assert text.count("may also be") == 1


def test_the_only_cause_has_the_closure_of_the_whole_gap() -> None:
    """Its own share has fewer simulations, and would contradict the other figure."""
    text = said(replace(partial_diagnosis(), causes=(replace(CAUSES[0], closed=0.56, closed_ci95=(0.44, 1.0)),)))
    assert "56 %" not in text
    assert text.count("86 % (75 to 94)") == 2


@pytest.mark.parametrize(
    ("probabilities", "head", "rest"),
    [
        ((0.9, 0.004), "Causes, most probable first", "1 less probable: see gap.json (-o DIR)"),
        ((0.02, 0.01), "Causes: none has a probability of 5 % or more", "2 less probable: see gap.json (-o DIR)"),
    ],
)
def test_improbable_causes_are_counted(probabilities: tuple[float, ...], head: str, rest: str) -> None:
    causes = tuple(replace(CAUSES[0], probability=probability) for probability in probabilities)
    text = text_of(replace(partial_diagnosis(), causes=causes))
    assert f"{head}\n" in text and f"\n  {rest}\n" in text
    assert "<1 %" not in text


def test_the_worst_difference_of_each_sensor_and_domain_is_printed() -> None:
    """Three of 55."""
    lines = text_of(partial_diagnosis()).splitlines()
    start = next(place for place, line in enumerate(lines) if line.startswith("Where it differs"))
    assert lines[start + 1] == (
        "  Gyro2 x, coefficient of dT/dt in face_0 of heating.h5: recorded 50.9 dps s/°C, simulated 0 dps s/°C (more "
        "than 100 sd"
    )
    assert lines[start + 2] == "    too high; 100 times what matters)"
    rows = [line for line in lines[start + 1 : lines.index("Causes, most probable first")] if re.match("  [A-Z]", line)]
    assert [row.split(",")[0] for row in rows] == ["  Gyro2 x", "  Gyro1 y", "  ADXL1 z"]


def test_the_check_reports_the_remainder() -> None:
    text = said(partial_diagnosis())
    assert (
        "With thermal_lag, tone, quantisation and bias in the simulator: 14 standard deviations (rms) before, "
        "2.9 after, 1.0 without a gap: 86 % (75 to 94) closed"
    ) in text
    assert "Gyro2, drift over the heat pulse: recorded 0.42 dps, simulated 0.05 dps before and 0.4 dps after" in text
    assert "Still different: 2 statistics ADXL1 z, share of odd codes in face_5" in text
    explained = said(replace(partial_diagnosis(), verdict="explained"))
    assert "Still different, as far as the approximate models of the causes allow: 2 statistics" in explained


def test_only_parts_out_of_specification_are_listed_worst_first() -> None:
    lines = text_of(partial_diagnosis()).splitlines()
    start = next(place for place, line in enumerate(lines) if line.startswith("Parts out of specification"))
    assert lines[start + 1 : start + 5] == [
        "  Gyro1: data rate 102 Hz, 2.5 times its tolerance of 1 Hz (L3G-12)",
        "  BMA2 z: scale -3.6 %, 1.2 times its tolerance of 3 % (BMA-20)",
        "Beyond tolerance as fitted without thermal_lag, which may be the reason: Gyro2 x (bias)",
        "",
    ]
    only = replace(partial_diagnosis(), pulls=PULLS[3:])
    assert "Parts out of specification" not in text_of(only)
    assert "Beyond tolerance as fitted without thermal_lag" in text_of(only)


@pytest.mark.parametrize(
    ("pull", "outside"), [(0.99, False), (1.0, False), (-1.01, True), (3.0, True), (float("nan"), False)]
)
def test_a_part_is_out_of_specification_beyond_one_tolerance(pull: float, outside: bool) -> None:
    assert replace(PULLS[0], pull=pull).is_out_of_specification == outside


def test_missing_statistics_are_listed() -> None:
    assert "not compared\n  no chip thermometer in tumble.h5\n  no reference temp" in text_of(partial_diagnosis())


def test_unobservable_effects_are_sorted_by_experiment_and_sensors() -> None:
    unshown = (
        Unobservable("scale", ("B1", "B2"), "tumble: all six faces"),
        Unobservable("scale", ("G1",), "motion: turns about every axis"),
        Unobservable("misalignment", ("B1", "B2"), "tumble: all six faces"),
        Unobservable("differences of spread", ("B1",), "4 minutes"),
        Unobservable("differences of cross sensor", ("B1",), "a longer log is not enough"),
    )
    text = text_of(replace(partial_diagnosis(), unshown=unshown))
    assert (
        "Not observable in these recordings, and what to record\n"
        "  tumble, B1, B2: scale (all six faces); misalignment (all six faces)\n"
        "  motion, G1: scale (turns about every axis)\n"
        "\n"
        "Too short to exclude differences that matter, and what to record\n"
        "  B1: noise (4 minutes); correlation between axes and sensors (a longer log is not enough)\n"
    ) in text


def test_the_text_without_a_gap() -> None:
    text = text_of(replace(diagnosis_without_gap(), unshown=()))
    assert "Verdict  no gap: no statistic differs beyond chance\nChance   p = 0.41\n" in text
    for absent in ("Causes", "Where it differs", "Unknown", "Check", "Next experiment", "pecification", "Missing"):
        assert absent not in text


def test_what_the_recordings_cannot_show_follows_the_verdict_of_no_gap() -> None:
    """Two effects, one of them in two lines, and two domains."""
    effects = [Unobservable(effect, (name,), "") for effect, name in (("scale", "A"), ("scale", "G"), ("skew", "G"))]
    domains = [Unobservable(f"differences of {domain}", ("A",), "") for domain in ("level", "cross sensor")]
    hidden = (*effects, *domains)
    verdict, limits = "no statistic differs beyond chance", f"2 of {len(EFFECTS)} known effects cannot be observed"
    short = "the recordings are too short to exclude differences of mean reading and correlation between axes and"
    text = said(replace(diagnosis_without_gap(), unshown=hidden))
    assert f"{verdict} Limits only what could be compared agrees; {limits} with every sensor; {short} sensors" in text
    assert "Limits" not in said(replace(partial_diagnosis(), unshown=hidden))


def test_the_text_of_an_unexplained_gap() -> None:
    text = text_of(unexplained_diagnosis())
    assert "Verdict  unexplained: no known effect was accepted as a cause" in text and "Unknown  93 %" in text
    assert "Check on held-out data\n  No cause was accepted, so the simulator is unchanged" in text
    assert "closed" not in text


@given(st.sampled_from([partial_diagnosis(), unexplained_diagnosis()]), st.sampled_from([None, 0.5]))
def test_the_text_of_a_gap_does_not_deny_it(diagnosis: Diagnosis, closed: float | None) -> None:
    text = said(replace(diagnosis, gap=replace(diagnosis.gap, closed=closed, closed_ci95=None)))
    assert "nothing to close" not in text
    assert "no gap" not in text.lower()


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("diagnosis", [partial_diagnosis(), diagnosis_without_gap(), unexplained_diagnosis()])
def test_no_text_is_lost_on_a_narrow_terminal(diagnosis: Diagnosis, width: int) -> None:
    """Lines are broken only between words, not between a number and its unit, and have the same text at every width."""
    text = text_of(diagnosis, width)
    assert max(map(len, text.splitlines())) <= width
    assert text.split() == text_of(diagnosis).split()
    assert "…" not in text
    assert not re.search(r"\d\n\s+(%|sd|mg|dps|Hz|s|times)\b", text)


@given(st.text(max_size=300), st.floats(), st.floats())
def test_control_characters_are_not_printed_and_lines_fit_the_width(name: str, real: float, score: float) -> None:
    hostile = replace(
        partial_diagnosis(),
        sentence=name,
        reason=name,
        where=(replace(where(0, 1.0), sensor=name, phase=name, unit=name, real=real, significance=score),),
        causes=(replace(CAUSES[0], effect=name, sensors=(name,) * 9, parameters={name: name}),),
        next_experiment=name,
        pulls=(replace(PULLS[1], sensor=name, quantity=name, unit=name, source=name, value=real, tolerance=score),),
        missing=(name,),
        unshown=(Unobservable(name, (name,), name),),
        notes=(name,),
    )
    lines = text_of(hostile).split("\n")
    assert all(line.isprintable() for line in lines)
    assert max(map(len, lines)) <= WIDTH
