"""Figures of several worlds, the loss between them, and figures of parts against the rest, in runs made by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from imuarray.report.validation_page import markdown, summary_lines
from imuarray.validation.case import Case
from imuarray.validation.score_answers import read_run
from imuarray.validation.scoring import as_json, format_text, score_folder, split_figures
from tests.validation.run_folder import NO_GAP, RunFolder, cause, gap_diagnosis, put

CHIPS = {"Gyro1": "l3g4200d", "BMA1": "bma180"}


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """Ten of ten first causes are right in the worlds of the emulator, six of ten in the other worlds; these have four
    false alarms in ten, the emulator none.
    """
    run = RunFolder(tmp_path)
    for world, right in (("emulator", 10), ("foreign", 6)):
        for number in range(10):
            first = cause("tone" if number < right else "scale")
            plan = "heating+static" if number % 2 else "static"
            run.both("single", gap_diagnosis(first), put("mains_ripple"), plan=plan, world=world, chips=CHIPS)
        for number in range(4):
            diagnosis = gap_diagnosis() if world == "foreign" and number == 0 else NO_GAP
            run.both("none", diagnosis, plan="static", world=world, chips=CHIPS)
    return run


@pytest.mark.slow
def test_each_world_has_its_figures_and_its_bars(run: RunFolder) -> None:
    score = score_folder(run.folder)
    assert score.world == "emulator"
    assert list(score.worlds) == ["emulator", "foreign"]
    assert score.row("right cause first").value == 1.0
    assert score.row("right cause first").bar == (0.90, None)
    assert score.row("false alarms").value == 0.0
    abroad = {row.name: row for row in score.elsewhere["foreign"]}
    assert abroad["right cause first"].value == 0.6
    assert abroad["right cause first"].bar == (0.80, None)
    assert abroad["false alarms"].value == 0.25
    assert abroad["effects that a plan can't show, reported so"].bar == (None, None)


@pytest.mark.slow
def test_the_loss_between_worlds_is_reported_first(run: RunFolder) -> None:
    figures_ = score_folder(run.folder)
    lost = {transfer.name: transfer.lost for transfer in figures_.transfers}
    assert lost["right cause first"] == pytest.approx(0.4)
    assert lost["detection at 5x the limit"] == 0.0
    assert lost["false alarms"] == pytest.approx(0.25)
    line = "Transfer gap of right cause first: 0.400 (emulator 1.000 (10), foreign 0.600 (10))."
    assert line in list(summary_lines(figures_))
    assert "transfer gap of right cause first: 0.400" in format_text(figures_)
    assert "| right cause first | 1.000 (10) | 0.600 (10) | 0.400 |" in markdown(figures_, "2026-01-01")
    table = as_json(figures_)
    assert table["world"] == "emulator"
    assert {"name": "false alarms", "emulator": 0.0, "foreign": 0.25, "lost": 0.25} in table["transfer"]


def test_parts_are_compared_with_the_rest(run: RunFolder) -> None:
    """Five cases of the emulator with heating, nine without; the sensors of all of them have one chip."""
    answers = [item for item in read_run(run.folder).answers if item.case.world == "foreign"]
    parts = {(item.part, item.figure): item for item in split_figures(answers, {})}
    heated = parts["experiment heating", "right cause first"]
    assert (heated.value, heated.others, heated.cases) == (0.6, 0.6, 5)
    assert answers[0].chips == ("l3g4200d",)
    assert answers[-1].chips == ("bma180", "l3g4200d")


@pytest.mark.slow
def test_causes_of_the_control_are_ignored_in_its_cases(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    control = run.both("none", gap_diagnosis(cause("quantisation", 0.9, "BMA1")), world="real")
    diagnosis = gap_diagnosis(cause("quantisation", 0.95, "BMA1"), cause("tone", 0.7, "BMA1"))
    run.both("single", diagnosis, put("mains_ripple", 5.0, "BMA1"), world="real", control=control.name)
    score = score_folder(tmp_path)
    assert score.row("right cause first").value == 1.0
    assert score.row("right cause first, 5x and above").bar == (0.80, None)


def test_unobservable_mechanisms_are_not_counted_in_detection(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    run.both("single", NO_GAP, put("reference_voltage"), plan="static", world="emulator", is_hidden=True)
    score = score_folder(tmp_path)
    assert score.row("detection at 5x the limit").cases == 0
    assert score.row("effects that a plan can't show, reported so").cases == 1


def test_a_case_of_an_older_version_is_read() -> None:
    """A case of a run of the fixed plans, which has no field of worlds."""
    table = {
        "number": 1,
        "half": "sealed",
        "kind": "none",
        "plan": "full",
        "puts": [],
        "seed": 1,
        "without": [],
        "extra": {},
        "resembles": [],
    }
    assert Case.of_table(table).world == ""


@pytest.mark.slow
def test_defects_of_a_world_are_not_false_alarms(tmp_path: Path) -> None:
    """Two wrongly noted faces are rightly reported, alone and explained; likewise a room with vibration."""
    run = RunFolder(tmp_path)
    labels, shaken = {"labels": "some wrong"}, {"vibration": "fan"}
    for strata, diagnosis in (
        (labels, gap_diagnosis(cause("face_error"))),
        (shaken, gap_diagnosis(cause("common_mode"), cause("tone"))),
        (labels, gap_diagnosis(cause("face_error"), cause("scale"))),
        (shaken, gap_diagnosis(cause("face_error"))),
        (labels, NO_GAP),
    ):
        run.both("none", diagnosis, plan="static", world="emulator", chips=CHIPS, strata=strata)
    row = score_folder(run.folder).row("false alarms")
    assert (row.value, row.cases) == (pytest.approx(2 / 5), 5)


@pytest.mark.slow
def test_defects_of_a_world_are_ignored_before_the_first_cause(tmp_path: Path) -> None:
    """The mechanism is named after wrong labels, and a line in a room with vibration may be that of the mechanism."""
    run = RunFolder(tmp_path)
    for strata, diagnosis in (
        ({"labels": "some wrong"}, gap_diagnosis(cause("face_error"), cause("tone"))),
        ({"vibration": "fan"}, gap_diagnosis(cause("common_mode"), cause("tone"))),
        ({}, gap_diagnosis(cause("face_error"), cause("tone"))),
    ):
        run.both("single", diagnosis, put("mains_ripple"), plan="static", world="emulator", chips=CHIPS, strata=strata)
    row = score_folder(run.folder).row("right cause first")
    assert (row.value, row.cases) == (pytest.approx(2 / 3), 3)
