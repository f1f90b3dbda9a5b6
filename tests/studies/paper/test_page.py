"""The paper's page: all numbers, marks of large deviations, no external resources, and the page without optional
packages.
"""

from __future__ import annotations

import json
import re
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from imuarray import figures
from imuarray.cli import main
from imuarray.errors import MissingExtraError, OutputExistsError
from imuarray.studies.paper import page as paper_page
from imuarray.studies.paper import recompute
from imuarray.studies.paper.figures import (
    accelerometer_figure,
    gyro_memory_figure,
    opposed,
    opposed_figure,
    temperature_figure,
)
from imuarray.studies.paper.page import NO_FIGURES, PrintedNumber, line_of, recomputed_text, write_paper_page
from imuarray.studies.paper.replica import simulation
from imuarray.studies.paper.replica.comparison import compare
from imuarray.studies.paper.replica.simulation import ExperimentData, observe
from imuarray.studies.paper.replica.statistic import Replica, Statistic
from imuarray.studies.paper.tables import Cell
from tests.html_page import Page


class Made(NamedTuple):
    observed: ExperimentData
    replica: Replica
    text: str


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    observed = observe(1)
    replica = Replica(1, tuple(compare(observed)))
    path = tmp_path_factory.mktemp("paper") / "paper.html"
    write_paper_page(path, replica, observed)
    return Made(observed, replica, path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(made: Made) -> Page:
    return Page(made.text)


@pytest.mark.slow
def test_the_page_has_no_external_resources_and_closes_every_tag(made: Made, page: Page) -> None:
    without_images = re.sub(r"data:image/svg\+xml;base64,[^\"]*", "", made.text)
    assert "//" not in without_images and "url(" not in without_images
    assert "<script" not in made.text
    assert page.open_tags == []
    assert made.text.count("</style>") == 1
    assert "position: sticky" in made.text


@pytest.mark.slow
def test_the_page_has_every_statistic_and_marks_large_deviations(made: Made, page: Page) -> None:
    """Table 11 has no column in another unit: a row per statistic; marks are for |z| > 2 only."""
    rows = page.of("Table 11")
    assert rows[0] == ["channel", "statistic", "paper", "recomputed", "simulated", "difference", "z"]
    assert len(rows) - 1 == 34 * 11
    assert len(page.of("Table 10")) - 1 == 34 * 9
    assert len(page.marked) == sum(abs(row.z) > 2 for row in made.replica.statistics)
    assert [row[:3] for row in rows[1:]][:2] == [["ADXL1 x", "runs_mean", "12.453"], ["ADXL1 x", "runs_sem", "0.047"]]


@pytest.mark.slow
def test_numbers_have_their_printed_digits(page: Page) -> None:
    """Also zeros at the end (Table 2: 0.1240), and scale factors without their sign (Table 3: -261.38)."""
    two = {(row[0], row[1]): row[2:] for row in page.of("Table 2")}
    assert two["Gyro1 x 250dps", "mean_dps"] == ["0.1240", "0.1240", "–", "–", "–"]
    assert two["Gyro1 y 2k dps", "std_lsb"][:2] == ["4.530", "4.530"]
    three = {(row[0], row[1]): row[2:] for row in page.of("Table 3")}
    assert three["ADXL1 x", "scale_lsb_per_g"][:2] == ["261.38", "261.38"]
    assert three["BMA4 x", "scale_lsb_per_g"][:2] == ["5369.79", "5369.7847 ≈"]
    eleven = {(row[0], row[1]): row[2:] for row in page.of("Table 11")}
    assert eleven["BMA1 t", "ratio"][:2] == ["17.86", "6.3778 ≠"]
    assert ["ADXL1", "box_plus_x", "-X", "-X"] in page.of("Table 1")


@pytest.mark.slow
def test_difference_and_z_of_a_row_by_hand(made: Made, page: Page) -> None:
    (result,) = (row for row in made.replica.of("Table 8") if (row.channel, row.statistic[:5]) == ("Gyro1 y", "slope"))
    (row,) = (row for row in page.of("Table 8") if row[:2] == ["Gyro1 y", "slope_lsb_per_degc"])
    assert row[2] == "0.265"
    assert float(row[4]) == pytest.approx(float(row[3]) - 0.265, abs=2e-4)
    assert float(row[5]) == pytest.approx((result.simulated - 0.265) / result.uncertainty, abs=0.06)


@pytest.mark.slow
def test_opposed_gyroscopes_have_a_small_fused_slope(page: Page) -> None:
    """0.002 LSB/degC by Table 8; simulated slopes are known to about 0.008 (in-run wander), so the half-difference to
    0.006: five of that.
    """
    rows = {row[0]: row[1:] for row in page.of("Table 8")}
    relation, recomputed, less, simulated, _ = rows["Gyro1 y, Gyro2 y"]
    assert (relation, recomputed, less) == ("opposed along Y", "0.002", "131.5")
    assert abs(float(simulated)) < 0.03


@pytest.mark.slow
def test_the_summary_states_the_results(made: Made, page: Page) -> None:
    whole = made.replica.summary
    text = " ".join(page.summary)
    assert f"Of the {whole.count} statistics, simulated with seed 1, {whole.within[0]} (" in text
    assert f"inertial axes {made.replica.kinds['axes'].chi_square:.2f}, " in text
    assert f"<dd>{whole.chi_square:.2f}</dd>" in made.text
    assert f"{len(made.replica.beyond())} statistics are more than three" in text
    assert "15 of 18 conclusions hold" in made.text
    result = recompute()
    cells = [count for name, c in result["matches"].items() if name != "stated" for count in c.values()]
    assert f"{sum(total for _, total in cells)} cells of the paper can be computed" in text
    assert len(page.of("Known gaps")) - 1 == len(made.replica.beyond())
    assert len(page.of("The paper's conclusions")) - 1 == 18
    assert len(page.of("The text against the tables")) - 1 == 35


@pytest.mark.slow
def test_only_the_overview_is_open(made: Made) -> None:
    """Fourteen tables, and all results on the text, are collapsed to one line each; one table is open."""
    visible = re.sub(r"<details>.*?</details>", "", made.text, flags=re.DOTALL)
    assert visible.count("<table") == 1
    assert visible.count("<img") == 0
    assert len(re.sub(r"<style>.*?</style>|<[^>]*>", " ", visible, flags=re.DOTALL).split()) < 1200


@pytest.mark.slow
def test_figures_are_next_to_their_tables(page: Page) -> None:
    assert len(page.alternatives) == 10
    assert all(page.alternatives)
    assert NO_FIGURES not in page.summary


@pytest.mark.slow
def test_a_page_without_curves_states_it(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "paper.html"
    write_paper_page(path, made.replica, None)
    bare = Page(path.read_text(encoding="utf-8"))
    assert bare.alternatives == []
    assert bare.summary[-1] == NO_FIGURES
    with pytest.raises(OutputExistsError):
        write_paper_page(path, made.replica, None)


@pytest.mark.slow
def test_axes_have_units_and_lines_their_expected_positions(made: Made) -> None:
    drawn = temperature_figure(made.observed, "Gyro2 x", 0.521, 5.67).axes[0]
    ours, theirs = (line for line in drawn.get_lines() if len(line.get_xdata()) == 2)
    result = made.observed.heated["Gyro2"]
    for line, slope, intercept in ((ours, result.slope[0], result.intercept[0]), (theirs, 0.521, 5.67)):
        np.testing.assert_allclose(line.get_ydata(), slope * np.asarray(line.get_xdata()) + intercept)
    labels = [drawn.get_xlabel(), drawn.get_ylabel()]
    for figure in (opposed_figure(made.observed), gyro_memory_figure(made.observed)):
        labels += [axes.get_ylabel() for axes in figure.axes]
    labels += [axes.get_xlabel() for axes in accelerometer_figure(made.observed, "BMA2").axes]
    assert labels == [
        "temperature (°C)",
        "Gyro2 x (LSB)",
        "output (LSB)",
        "temperature (°C)",
        "autocorrelation",
        "density (dps/√Hz)",
        "averaging time τ (s)",
        "frequency (Hz)",
    ]


@pytest.mark.slow
def test_half_of_the_difference_has_little_thermal_drift(made: Made) -> None:
    """Over 28 degC single gyroscopes change by 7 LSB, half of their difference by 0.06 and its wander (0.1 LSB)."""
    spans = np.ptp(opposed(made.observed).lsb, axis=0)
    assert spans[:2].min() > 6
    assert spans[2] < 0.8


def statistic(published: float, simulated: float, uncertainty: float, scale: str = "linear") -> Statistic:
    return Statistic("Table 0", "a", "b", published, simulated, uncertainty, "", scale)


@pytest.mark.parametrize(
    ("twin", "texts"),
    [
        (statistic(6.0, 7.0, 0.577), ["6", "–", "7.00", "+1.00", "+1.7"]),
        (statistic(6.0, 5.9999, 1.0), ["6", "–", "6.0", "+0.0", "+0.0"]),
        (statistic(100.0, 50.0, 0.1, "log"), ["100", "–", "50", "-50", "-6.9"]),
        (statistic(1.0, 0.0, 0.1, "log"), ["1", "–", "0.00", "-1.00", "-inf"]),
        (statistic(8 / 15, 0.5, 0.04), ["0.533", "–", "0.500", "-0.033", "-0.8"]),
        (statistic(50.0, inf, 5.0), ["50", "–", "–", "–", "+inf"]),
    ],
)
def test_texts_of_a_row(twin: Statistic, texts: list[str]) -> None:
    assert line_of(twin).texts() == ["a", "b", *texts]


def test_deviations_beyond_two_are_marked() -> None:
    assert not line_of(statistic(0.0, 2.0, 1.0)).marked
    assert line_of(statistic(0.0, -2.001, 1.0)).marked
    assert not PrintedNumber("a", "b", "1", None, None).marked


@pytest.mark.parametrize(
    ("cell", "printed", "text"),
    [
        (Cell("x", 1.2, 1.2, True), "1.20", "1.20"),
        (Cell("x", 1.2113, 1.2, True), "1.20", "1.2113 ≈"),
        (Cell("x", 3.5, 1.2, False), "1.20", "3.5 ≠"),
        (Cell("x", -3.5, -1.2, False), "1.20", "3.5 ≠"),
        (Cell("x", "-Y", "+Y", False), "+Y", "-Y ≠"),
    ],
)
def test_texts_of_recomputed_cells(cell: Cell, printed: str, text: str) -> None:
    assert recomputed_text(cell, printed) == text


@pytest.fixture
def quick(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command without its simulation."""
    monkeypatch.setattr(simulation, "observe", lambda seed, progress: made.observed)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_the_command_writes_both_files_and_overwrites_neither(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "place"
    assert main(["paper", "--replica", "-o", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {"replica.json", "paper.html"}
    assert json.loads((out / "replica.json").read_text())["statistics"] == made.replica.as_json()["statistics"]
    captured = capsys.readouterr()
    assert "The paper's experiments on the simulated array, seed 1" in captured.out
    assert "2 files written" in captured.err
    (out / "replica.json").unlink()
    assert main(["paper", "--replica", "-o", str(out)]) == 2
    assert "paper.html: exists already" in capsys.readouterr().err
    assert not (out / "replica.json").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_the_command_works_without_matplotlib_and_jinja2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "find_spec", lambda name: None)
    assert main(["paper", "--replica", "-o", str(tmp_path)]) == 0
    assert "matplotlib" in capsys.readouterr().err
    assert NO_FIGURES in Page((tmp_path / "paper.html").read_text(encoding="utf-8")).summary

    def missing(*_: object, **__: object) -> None:
        raise MissingExtraError("jinja2", "report")

    monkeypatch.setattr(paper_page, "write_page", missing)
    assert main(["paper", "--replica", "-o", str(tmp_path / "bare")]) == 0
    assert "jinja2" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "bare").iterdir()] == ["replica.json"]


def test_an_unwritable_folder_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["paper", "--replica", "-o", str(tmp_path / "file" / "below")]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert str(tmp_path / "file") in error
