"""The page of a validation run: every figure with its mark, plots, no external resource, escaped names."""

from __future__ import annotations

import re
from math import nan
from pathlib import Path

import numpy as np
import pytest

from imuarray import figures as figures_module
from imuarray.errors import OutputExistsError
from imuarray.report.validation_figures import (
    alarms_figure,
    closure_figure,
    confusion_figure,
    detection_figure,
    reliability_figure,
)
from imuarray.report.validation_page import NO_FIGURES, markdown, write_validation_page
from imuarray.validation.rates import Bin, RateEstimate
from imuarray.validation.score_rows import Closure, Confusion, DetectionCurve, ScoreRow
from imuarray.validation.scoring import Figures, format_row, score_folder
from tests.html_page import Page
from tests.validation.run_folder import NO_GAP, THERE_OR_NOT, RunFolder, cause, gap_diagnosis, put

EVIL = "<script>alert('x')</script>\"&--><img src=http://evil.example/x.png> $\\frac{$ `|` \x1b[2J"
COMMAND = "imuarray gap validate --half sealed <here>"
ORDER = [
    "Figures and their bars",
    "Where a bar is missed",
    "False alarms",
    "Detection",
    "Causes",
    "Probabilities",
    "Closure",
    "Settings of the run",
]


def filled(run: RunFolder, name: str = "mains_ripple", effect: str = "tone") -> Figures:
    """40 controls, 2 of them alarms; 10 of a mechanism, 9 of them right, one of them taken for `effect`."""
    for number in range(40):
        run.both("none", gap_diagnosis(cause(effect, 0.3)) if number < 2 else NO_GAP)
    for number in range(10):
        diagnosis = gap_diagnosis(cause("tone" if number else "scale", 0.85), closed=0.8 if number else 0.1)
        run.both("single", diagnosis, put(name, 5.0), resembles=[("tone",)], oracle=0.82)
    run.both("single", NO_GAP, put(name, 2.0), resembles=[("tone",)], plan=EVIL if effect == EVIL else "static")
    run.both("single", gap_diagnosis(cause(effect, 0.1)), put("torn_reads", THERE_OR_NOT), resembles=[("scale",)])
    run.answer(run.case("none"), {}, error=f"ValueError: {effect}")
    return score_folder(run.folder)


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> Figures:
    return filled(RunFolder(tmp_path_factory.mktemp("run")))


@pytest.fixture(scope="module")
def source(figures: Figures, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "validation.html"
    write_validation_page(path, figures, command=COMMAND)
    with pytest.raises(OutputExistsError):
        write_validation_page(path, figures)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(source: str) -> Page:
    return Page(source)


@pytest.mark.slow
def test_the_page_has_no_external_resource_and_every_tag_is_closed(source: str, page: Page) -> None:
    without_images = re.sub(r"data:image/svg\+xml;base64,[^\"]*", "", source)
    assert "//" not in without_images and "url(" not in without_images and "<script" not in source
    assert page.open_tags == []
    assert list(page.rows) == ORDER


@pytest.mark.slow
def test_every_figure_has_its_bar_and_its_mark(figures: Figures, page: Page) -> None:
    """2 of 40 are 5 %; right first are 9 of 11, 9 of 10 at 5x: below 0.97, but not surely."""
    rows = {row[0]: row[1:] for row in page.rows["Figures and their bars"][: len(figures.rows) + 1]}
    assert rows["figure"] == ["", "value", "95 %", "cases", "bar"]
    assert rows["false alarms, plan full"] == ["ok", "0.050", "0.014 to 0.165", "40", "0.035 to 0.065"]
    assert rows["right cause first, 5x and above"][:2] == ["FAIL", "0.900"]
    assert rows["removed base effect named"] == ["n.a.", "–", "–", "0", "at least 0.9"]
    assert rows["cases lost"] == ["", "0.019", "0.003 to 0.099", "53", ""]
    assert list(rows)[1:] == [row.name for row in figures.rows]
    by_plan = page.rows["Figures and their bars"][len(figures.rows) + 1 :]
    assert by_plan[0] == ["figure", "full", "static"]
    assert ["detection at 2x the limit", "–", "0.000 (1)"] in by_plan
    assert ["right cause first", "0.818 (11)", "–"] in by_plan
    assert page.marked == ["FAIL"] * len(figures.failed)


@pytest.mark.slow
def test_figures_that_miss_a_bar_are_listed_with_their_cells(figures: Figures, page: Page) -> None:
    rows = page.rows["Where a bar is missed"][1:]
    assert [row[0] for row in rows if row[1] == "all"] == [row.name for row in figures.failed]
    assert ["right cause first", "severity there or not", "0.000", "0.000 to 0.793", "1"] in rows
    assert any(line.startswith("Missed, but the interval reaches the bar: ") for line in page.summary)
    assert any(
        line.startswith("53 cases, 1 of them lost (none, plan full, ValueError: tone: 1)") for line in page.summary
    )


@pytest.mark.slow
def test_the_sections_have_their_numbers(page: Page) -> None:
    assert page.rows["False alarms"][1] == ["full", "0.050", "0.014 to 0.165", "40", "0.035 to 0.065"]
    detection = page.rows["Detection"]
    assert ["mechanism", "5x the limit", "there or not"] in detection
    assert ["mains_ripple", "10 of 10", "–"] in detection and ["torn_reads", "–", "1 of 1"] in detection
    assert ["all", "0.000 (1)", "1.000 (10)"] in detection
    assert ["mains_ripple", "scale", "1"] in page.rows["Causes"]
    assert ["0.8 to 0.9", "0.850", "0.900", "10"] in page.rows["Probabilities"]
    assert page.rows["Closure"][1][:2] == ["closure near the oracle's", "0.900"]


@pytest.mark.slow
def test_settings_of_the_run_are_listed(page: Page) -> None:
    rows = {row[0]: row[1] for row in page.rows["Settings of the run"][1:]}
    assert rows["command"] == COMMAND
    assert (rows["half"], rows["fixed: level"], rows["fixed: version"]) == ("sealed", "0.05", "1.2.3")
    assert (rows["cases"], rows["lost"]) == ("53", "1")


@pytest.mark.slow
def test_plots_have_descriptions(page: Page) -> None:
    assert len(page.alternatives) == 5
    assert "full 5 %" in page.alternatives[0]
    assert "All plans: 2 limits 0 %, 5 limits 100 %" in page.alternatives[1]
    assert "Most often wrong: nothing wrong taken for tone: 2" in page.alternatives[2]
    assert "0.8 to 0.9: 0.900 of 10" in page.alternatives[3]
    assert "9 with the right cause first, 10 in all" in page.alternatives[4]


@pytest.mark.slow
def test_names_are_escaped(tmp_path: Path) -> None:
    hostile = filled(RunFolder(tmp_path / "run", plan={"half": EVIL, "frozen": {EVIL: EVIL}}), EVIL, EVIL)
    path = tmp_path / "page.html"
    write_validation_page(path, hostile, command=EVIL)
    text = path.read_text(encoding="utf-8")
    assert "<script" not in text and "<img src=http" not in text
    page = Page(text)
    assert page.open_tags == [] and len(page.alternatives) == 5
    lines = markdown(hostile, EVIL, EVIL).splitlines()
    outside = [line for line in lines if "alert" in line and line != EVIL]
    assert outside and not any("<" in line for line in outside)
    table = [line for line in lines if line.startswith("| ")]
    assert {len(re.split(r"(?<!\\)\|", line)) for line in table} == {8, 7}


@pytest.mark.slow
def test_without_matplotlib_the_page_has_only_tables(
    figures: Figures, page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures_module, "find_spec", lambda name: None)
    path = tmp_path / "page.html"
    write_validation_page(path, figures, command=COMMAND)
    bare = Page(path.read_text(encoding="utf-8"))
    assert bare.alternatives == [] and bare.summary == [*page.summary, NO_FIGURES]
    assert bare.rows == page.rows


def test_a_run_without_cases_makes_a_page(tmp_path: Path) -> None:
    score = score_folder(RunFolder(tmp_path / "run", plan={}).folder)
    write_validation_page(tmp_path / "page.html", score)
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert page.alternatives == [] and list(page.rows) == ORDER
    assert page.summary[0] == "22 figures have no cases."
    assert [row[0] for row in page.rows["Figures and their bars"][:2]] == ["figure", "figure"]  # no empty rows
    assert "nan" not in (tmp_path / "page.html").read_text(encoding="utf-8").split("<main>")[1]
    assert "No threshold was fixed" in markdown(score, "2026-01-31")


@pytest.mark.slow
def test_markdown_has_every_figure_and_the_failures(figures: Figures) -> None:
    lines = markdown(figures, "2026-01-31", COMMAND).splitlines()
    assert lines[0] == "## Results of 2026-01-31, sealed half"
    assert "- Fixed before the truth was opened: level 0.05; version 1.2.3." in lines
    assert lines[lines.index("```sh") + 1] == COMMAND
    for row in figures.rows:
        mark = "**FAIL**" if row.passes is False else row.mark
        assert f"| {mark} | {row.name} | {' | '.join(format_row(row))} |" in lines
    assert "| right cause first | severity there or not | 0.000 | 0.000 to 0.793 | 1 |" in lines


def test_points_and_whiskers_are_drawn_at_their_values() -> None:
    """Shares in percent, whiskers at the ends of intervals, limits on a logarithmic axis."""
    alarms = alarms_figure([ScoreRow("false alarms, plan full", 0.05, 0.02, 0.09, 100, (0.035, 0.065))]).axes[0]
    band = alarms.patches[0].get_extents().transformed(alarms.transData.inverted())
    assert (band.x0, band.x1) == pytest.approx((3.5, 6.5))
    (whisker,) = alarms.collections[-1].get_segments()  # type: ignore[attr-defined]
    np.testing.assert_allclose(whisker[:, 0], [2, 9])
    assert [text.get_text() for text in alarms.get_yticklabels()] == ["full (100)"]
    points = ((0.5, RateEstimate(0.1, 0.05, 0.2, 20)), (20.0, RateEstimate(1.0, 0.9, 1.0, 20)))
    curves = detection_figure([DetectionCurve("all", points)]).axes[0]
    assert curves.get_xscale() == "log"
    np.testing.assert_allclose(np.asarray(curves.lines[0].get_xydata(), float), np.array([[0.5, 0.1], [20.0, 1.0]]))
    assert [text.get_text() for text in curves.get_xticklabels()] == ["0.5", "20"]


def test_bins_closures_and_confusions_are_drawn() -> None:
    """Nothing of a bin without causes; a closure far below is drawn at the edge; right cells have frames."""
    bins = reliability_figure([Bin(0.0, 0.1, 0, nan, nan), Bin(0.8, 0.9, 4, 0.85, 0.75)]).axes[0]
    assert [text.get_text() for text in bins.texts] == ["4"]
    assert bins.texts[0].xy == (0.85, 0.75)  # type: ignore[attr-defined]
    closures = [Closure("a", "single", -9.0, nan, nan, 0.8, False), Closure("b", "pair", 0.7, 0.6, 0.9, 0.75, True)]
    wrong, right = closure_figure(closures).axes[0].collections[-2:]
    np.testing.assert_allclose(np.asarray(wrong.get_offsets()), [[0.8, -0.25]])
    np.testing.assert_allclose(np.asarray(right.get_offsets()), [[0.75, 0.7]])
    confusion = Confusion(("a", "b"), ("tone", "no gap"), ((3, 1), (0, 2)), ((True, False), (False, True)))
    panel = confusion_figure(confusion).axes[0]
    assert [text.get_text() for text in panel.texts] == ["3", "1", "2"]
    assert len(panel.patches) == 2
