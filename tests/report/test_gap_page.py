"""The page of a gap: every cause, the map's numbers, no external resource, escaped names; and without matplotlib."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import FuncNorm
from matplotlib.patches import Rectangle

from imuarray import figures
from imuarray.errors import OutputExistsError
from imuarray.gap.findings.diagnosis import Cause, Diagnosis, Gap, Map, Overlay, Pull
from imuarray.report.gap_figures import farthest, map_figure, outside, overlay_figure, shrink_figure, top_of, use_figure
from imuarray.report.gap_page import (
    MOST_OVERLAYS,
    MOST_ROWS,
    NO_FIGURES,
    curves_section,
    gap_verdict,
    pulls_table,
    write_gap_page,
)
from imuarray.simulate import EFFECTS
from imuarray.simulate.effects import meaning
from tests.html_page import Page
from tests.report.example_diagnoses import (
    CAUSES,
    DOMAINS,
    PULLS,
    SENSORS,
    USES,
    diagnosis_without_gap,
    overlays,
    partial_diagnosis,
    unexplained_diagnosis,
    where,
)
from tests.selection import some

EVIL = "<script>alert('x')</script>\"&--><img src=http://evil.example/x.png> $\\frac{$ \x1b[2J"
ORDER = [
    "Where the gap is",
    "Causes",
    "How much of the gap closes",
    "Parts and their specification",
    "Curves: real, before and after",
    "Where it differs",
    "What is unexplained",
    "What the recordings cannot show",
    "What is missing",
    "Next experiment",
    "Candidates that were examined",
    "Recordings and method",
]


def page_of(diagnosis: Diagnosis, folder: Path) -> Page:
    path = folder / "report.html"
    write_gap_page(path, diagnosis, force=True)
    return Page(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return page_of(partial_diagnosis(), tmp_path_factory.mktemp("gap"))


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return page_of(evil(), tmp_path_factory.mktemp("gap"))


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Page:
    monkeypatch.setattr(figures, "find_spec", lambda name: None)
    return page_of(partial_diagnosis(), tmp_path)


def evil() -> Diagnosis:
    """Every text from a file or a user is hostile."""
    diagnosis = partial_diagnosis()
    names = (EVIL, *SENSORS[1:])
    return replace(
        diagnosis,
        sentence=EVIL,
        where=tuple(
            replace(entry, sensor=EVIL, log=EVIL, phase=EVIL, about=EVIL, unit=EVIL) for entry in diagnosis.where
        ),
        causes=tuple(
            replace(entry, effect=EVIL, sensors=(EVIL,), parameters={EVIL: EVIL}, confusable_with=(EVIL,))
            for entry in diagnosis.causes
        ),
        unexplained=(replace(where(1, 5.0), sensor=EVIL),),
        next_experiment=EVIL,
        pulls=tuple(replace(pull, sensor=EVIL, quantity=EVIL, unit=EVIL, source=EVIL) for pull in diagnosis.pulls),
        missing=(EVIL,),
        unshown=tuple(replace(entry, effect=EVIL, sensors=(EVIL,), record=EVIL) for entry in diagnosis.unshown),
        uses=tuple(replace(entry, name=EVIL, sensor=EVIL, unit=EVIL) for entry in diagnosis.uses),
        judged=tuple(replace(entry, effect=EVIL, sensors=(EVIL,)) for entry in diagnosis.judged),
        map=replace(diagnosis.map, sensors=names, domains=(EVIL, *DOMAINS[1:])),
        overlays=tuple(
            replace(entry, sensor=EVIL, axis=EVIL, phase=EVIL, x_label=EVIL, y_label=EVIL)
            for entry in diagnosis.overlays
        ),
        recorded=tuple(replace(entry, name=EVIL, kind=EVIL) for entry in diagnosis.recorded),
        notes=(EVIL,),
        held_out=EVIL,
        model=EVIL,
        software=EVIL,
    )


def test_all_sections_are_in_order(page: Page) -> None:
    assert 'class="verdict' in page.source.split("<main>")[0]
    assert [heading for heading in page.words if heading in ORDER] == ORDER
    assert page.open_tags == []
    assert [tag for tag, _ in page.tags if tag in ("script", "link", "iframe")] == []
    assert "//" not in re.sub(r"data:image/svg\+xml;base64,[^\"]*", "", page.source)


def test_the_sentence_and_the_verdict_come_first(page: Page) -> None:
    start = page.words[""]
    assert partial_diagnosis().sentence in start
    assert "Gap between recording and simulation: partly explained" in start
    because = "Partly explained: only 86 % of the gap closes (explained from 95 % on). Chance alone: p < 0.0025"
    assert start.index(because) < start.index(partial_diagnosis().sentence)
    assert "14 standard deviations (rms) before, 2.9 after, 1.0 without a gap: 86 % (75 to 94) closed" in start
    assert "probability of 31 %" in start


def test_the_map_is_a_table_of_numbers(page: Page) -> None:
    heading, *rows = page.rows["Where the gap is"]
    assert heading == ["sensor", *(domain.replace("_", " ") for domain in DOMAINS)]
    assert [row[0] for row in rows] == list(SENSORS)
    cells = {(row[0], name): cell for row in rows for name, cell in zip(heading, row, strict=True)}
    assert cells["Gyro2", "temperature"].startswith("412 → ")
    assert cells["Gyro3", "allan"] == "13 → 7.1"
    assert cells["BMA1", "codes"] == "–"
    assert "13 → 7.1" in page.marked
    alternatives = page.images["Where the gap is"]
    assert len(alternatives) == 2
    assert "Largest: Gyro2 temperature 412, ADXL1 codes 88, ADXL2 codes 61" in alternatives[0]
    assert "Largest: Gyro3 allan 7.1" in alternatives[1]


def test_every_cause_has_a_row_with_its_parameters(page: Page) -> None:
    rows = {row[0].partition("\n")[0]: row for row in page.rows["Causes"] if len(row) == 7}
    assert set(rows) == {"effect", "thermal_lag", "tone", "quantisation", "bias other than the simulator's"}
    assert rows["effect"][4] == "would close"
    lag = rows["thermal_lag"]
    assert lag[0].partition("\n")[2] == "the sensing element, or a part of it, warms up later than the box"
    assert lag[1:] == ["97 %", "Gyro2", "time constant 12.3 s", "86 % (75 to 94)", "random_walk", "sensor"]
    assert rows["tone"][1:4] == [">99 %", "Gyro1 (x)", "amplitude 0.25, 0, 0 dps; frequency 13.7 Hz; phase 12°"]
    assert rows["bias other than the simulator's"][2:] == [
        "BMA1, BMA2 (z)",
        "offset 0, 0, 12.3 mg (BMA1; others below)",
        "–",
        "–",
        "metadata",
    ]
    each = [row for row in page.rows["Causes"] if len(row) == 3]
    assert each[1:] == [["BMA1", "bias", "offset 0, 0, 12.3 mg"], ["BMA2", "bias", "offset 0, 0, -45.6 mg"]]


def test_parts_are_listed_with_their_pulls(page: Page) -> None:
    assert page.rows["Parts and their specification"] == [
        ["sensor", "quantity", "value", "tolerance", "pull", "source", "may come from"],
        ["Gyro1", "data rate", "102 Hz", "1 Hz", "+2.5", "L3G-12", "–"],
        ["BMA2 z", "scale", "-3.6 %", "3 %", "-1.2", "BMA-20", "–"],
        ["Gyro2 x", "bias", "9 dps", "8 dps", "+1.12", "L3G-07", "thermal_lag"],
        ["BMA1 x", "scale", "0.4 %", "3 %", "+0.133", "BMA-20", "–"],
    ]
    assert {"+2.5", "-1.2"} <= set(page.marked) and "+1.12" not in page.marked
    words = page.words["Parts and their specification"]
    assert "2 of 4 are out of specification" in words
    assert "Beyond tolerance as fitted without thermal_lag, which may be the reason: Gyro2 x (bias)." in words


def test_missing_data_have_a_table(page: Page) -> None:
    assert [row[1] for row in page.rows["What is missing"]] == ["missing", *partial_diagnosis().missing]


def test_the_closed_share_of_the_gap_is_tabulated(page: Page) -> None:
    rows = page.rows["How much of the gap closes"]
    assert ["all", "14", "2.9", "86 % (75 to 94)"] in rows
    assert ["allan", "5.1", "3.8", "40 %"] in rows
    assert ["level", "1.1", "1.0", "–"] in rows
    heat = next(row for row in rows if row[0] == "drift over the heat pulse (dps)")
    assert heat[1:] == ["Gyro2", "0.42 (0.4 to 0.44)", "0.05 (0.03 to 0.07)", "0.4 (0.37 to 0.45)"]
    assert "0.05 (0.03 to 0.07)" in page.marked and "0.4 (0.37 to 0.45)" not in page.marked
    assert (
        "Gyro2 drift over the heat pulse: 0.12 times before, 0.95 times after"
        in page.images["How much of the gap closes"][1]
    )


def test_a_long_table_is_cut_and_the_rest_counted(page: Page) -> None:
    rows = page.rows["Where it differs"]
    assert len(rows) == 1 + MOST_ROWS
    assert rows[1][:4] == ["Gyro2 x", "temperature", "coefficient of dT/dt", "heating.h5, face_0"]
    assert rows[1][4:] == ["50.9 dps s/°C", "0 dps s/°C", "+412", "< 0.0025", "100, material"]
    assert "15 more are not shown, 8 of them material" in page.words["Where it differs"]
    assert len(page.rows["What is unexplained"]) == 1 + 2


def test_open_questions_and_recordings_are_listed(page: Page) -> None:
    assert ["bistable_bias", "all", "at least eight boots"] in page.rows["What the recordings cannot show"]
    assert partial_diagnosis().next_experiment in page.words["Next experiment"]
    judged = page.rows["Candidates that were examined"]
    assert judged[1] == ["tone", "add", "Gyro1", "0.94", "+120.0", "yes"]
    assert ["placebo", "add", "Gyro2", "0.02", "-0.3", "no"] in judged
    last = page.rows["Recordings and method"]
    assert ["heating.h5", "heating", "30 min", "7", "1", "1 234 567"] in last
    assert ["seed", "7"] in last and ["model", "datasheet"] in last and ["1", partial_diagnosis().notes[0]] in last
    assert partial_diagnosis().held_out in page.words["Recordings and method"]


def test_curves_have_descriptions(page: Page) -> None:
    alternatives = page.images["Curves: real, before and after"]
    assert len(alternatives) == 4
    assert "farthest at frequency 13.8 Hz" in alternatives[0]  # 13.75 Hz is the sample next to the line at 13.7
    assert all("% after" in text for text in alternatives)


@pytest.mark.slow
def test_names_are_escaped(hostile: Page) -> None:
    assert "<script" not in hostile.source
    assert hostile.open_tags == []
    assert len(hostile.attributes("img")) == 8
    assert "evil.example" in hostile.words[""]
    for section in ORDER:
        cells = [cell for row in hostile.rows.get(section, []) for cell in row]
        assert "alert('x')" in "".join([hostile.words[section], *cells]), section


def test_without_matplotlib_the_page_has_only_tables(bare: Page) -> None:
    assert bare.images == {}
    assert NO_FIGURES in bare.words[""]
    assert bare.rows["Curves: real, before and after"][1:][0][:3] == ["Gyro1 x", "spectrum", "z_up"]
    assert len(bare.rows["Where the gap is"]) == 1 + len(SENSORS)


@pytest.mark.slow
def test_a_page_without_a_gap_states_it(tmp_path: Path) -> None:
    page = page_of(diagnosis_without_gap(), tmp_path)
    assert "No gap: no statistic differs beyond chance. Chance alone: p = 0.41." in page.words[""]
    assert "nothing to close" not in page.words[""]
    assert "No cause was found." in page.words["Causes"]
    assert "No statistic differs significantly." in page.words["Where it differs"]
    (alternative,) = page.images["Where the gap is"]
    assert "No cause was added: 0 of 63 cells are above the limit." in alternative
    assert list(page.images) == ["Where the gap is"]
    assert page.rows["Where the gap is"][1] == ["BMA1", *["1.3"] * 9]
    assert [heading for heading in page.words if heading in ORDER] == ORDER


@pytest.mark.parametrize(
    ("causes", "sentence"),
    [
        (
            CAUSES[:1],
            "The simulator is not good enough; with thermal lag (the sensing element, or a part of it, warms",
        ),
        (
            [replace(CAUSES[0], probability=0.2), replace(CAUSES[1], probability=0.1, alternative_to="thermal_lag")],
            "The simulator is not good enough; which effect it lacks remains open (maybe thermal lag or tone).",
        ),
        (
            [replace(CAUSES[0], probability=0.01)],
            "The simulator is not good enough; which effect it lacks remains open.",
        ),
    ],
)
def test_the_verdict_on_a_partly_explained_gap(causes: Sequence[Cause], sentence: str) -> None:
    verdict = gap_verdict(replace(partial_diagnosis(), causes=tuple(causes)))
    assert verdict.sentence.startswith(sentence)
    assert ("1", "cause") in verdict.figures


@pytest.mark.slow
def test_improbable_causes_are_counted(tmp_path: Path) -> None:
    causes = (CAUSES[0], replace(CAUSES[1], probability=0.004))
    page = page_of(replace(partial_diagnosis(), causes=causes, overlays=()), tmp_path)
    assert [row[0].partition("\n")[0] for row in page.rows["Causes"]] == ["effect", "thermal_lag"]
    assert "1 less probable cause: see gap.json." in page.words["Causes"]


@pytest.mark.slow
def test_a_page_of_an_unexplained_gap_states_it(tmp_path: Path) -> None:
    page = page_of(unexplained_diagnosis(), tmp_path)
    assert "Unexplained: no known effect was accepted as a cause." in page.words[""]
    assert "probability of 93 %" in page.words[""]
    assert ["all", "5.1", "4.9", "5 % (below 0 to 14)"] in page.rows["How much of the gap closes"]
    assert page.rows["What is unexplained"][1][0] == "ADXL1 z"


def test_a_page_without_any_statistic_states_it(tmp_path: Path) -> None:
    none = np.full((2, 1), nan)
    silent = replace(diagnosis_without_gap(), map=Map(("a", "b"), ("level",), none, none, 4.0), unshown=(), recorded=())
    page = page_of(silent, tmp_path)
    assert page.images == {}
    assert "No statistic is available for any sensor" in page.words["Where the gap is"]


@pytest.mark.slow
def test_many_curves_are_counted(tmp_path: Path) -> None:
    page = page_of(replace(partial_diagnosis(), overlays=overlays()[3:] * 16), tmp_path)
    assert len(page.images["Curves: real, before and after"]) == MOST_OVERLAYS
    assert "Shown are the 12 of 16 that lay farthest outside before." in page.words["Curves: real, before and after"]


def test_a_page_is_overwritten_only_with_force(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("mine")
    with pytest.raises(OutputExistsError):
        write_gap_page(path, diagnosis_without_gap())
    assert path.read_text() == "mine"


@pytest.mark.parametrize("diagnosis", [partial_diagnosis(), diagnosis_without_gap(), unexplained_diagnosis(), evil()])
def test_as_json_is_strict_json(diagnosis: Diagnosis) -> None:
    read = json.loads(json.dumps(diagnosis.as_json(), allow_nan=False))
    assert read["verdict"] == diagnosis.verdict and read["gap"]["closed"] == diagnosis.gap.closed
    assert [cause["effect"] for cause in read["causes"]] == [cause.effect for cause in diagnosis.causes]
    shown = diagnosis.map.before.tolist()
    assert read["map"]["before"] == [[None if cell != cell else cell for cell in row] for row in shown]
    assert read["where"] == [json.loads(json.dumps(vars(entry))) for entry in diagnosis.where]


def test_every_effect_has_a_meaning() -> None:
    assert all(map(meaning, EFFECTS)) and meaning("other") == ""
    assert meaning("thermal_lag") == "the sensing element, or a part of it, warms up later than the box"


@pytest.mark.slow
def test_both_maps_share_a_scale_with_a_break_at_the_limit() -> None:
    shown = partial_diagnosis().map
    images = [map_figure(scores, shown, "").axes[0].collections[0] for scores in (shown.before, shown.after)]
    before, after = (image.norm for image in images)
    places = np.array([0.0, 2.1, 4.2, 42.0, 412.3])
    halves = np.asarray(before(places), float)
    np.testing.assert_allclose(np.asarray(after(places), float), halves)
    np.testing.assert_allclose(halves[[0, 1, 2, 4]], [0, 0.25, 0.5, 1], atol=1e-9)
    assert halves[3] == pytest.approx(0.5 + 0.5 * np.log(10) / np.log(412.3 / 4.2))
    assert isinstance(before, FuncNorm)
    np.testing.assert_allclose(np.asarray(before.inverse(halves), float), places, atol=1e-9)


def test_a_map_draws_values_that_are_not_finite() -> None:
    shown = Map(("a",), ("x", "y", "z"), np.array([[inf, nan, 0.0]]), np.array([[1.0, nan, 0.0]]), 4.0)
    assert top_of(shown) == 40
    panel = map_figure(shown.before, shown, "before").axes[0]
    assert [text.get_text() for text in panel.texts] == ["∞", "0.0"]
    assert [patch.get_hatch() for patch in panel.patches] == ["////"]


def test_axes_are_logarithmic_where_usual() -> None:
    panels = [overlay_figure(entry).axes[0] for entry in overlays()]
    assert [(panel.get_xscale(), panel.get_yscale()) for panel in panels] == [
        ("log", "log"),
        ("log", "log"),
        ("linear", "linear"),
        ("linear", "linear"),
    ]
    assert panels[0].get_xlabel() == "frequency (Hz)" and panels[0].get_ylabel() == "density (dps/√Hz)"


@pytest.mark.parametrize("diagnosis", [partial_diagnosis(), unexplained_diagnosis()])
def test_bars_begin_at_the_visible_floor(diagnosis: Diagnosis) -> None:
    panel = shrink_figure(diagnosis.gap).axes[0]
    low, high = panel.get_xlim()
    assert panel.get_xscale() == "log"
    bars = [patch.get_bbox() for patch in panel.patches if isinstance(patch, Rectangle)]
    assert {bar.x0 for bar in bars} == {1.02}
    assert low < 1.02 < max(bar.x1 for bar in bars) < high
    assert diagnosis.gap.before in {round(bar.x1, 9) for bar in bars}


def test_a_gap_of_zero_is_drawn_on_a_linear_scale() -> None:
    assert shrink_figure(Gap(3.0, 0.0, 0.0, 1.0, None, {})).axes[0].get_xscale() == "linear"


@pytest.mark.slow
@pytest.mark.parametrize("overlay", some(overlays(), 1))
@pytest.mark.parametrize("points", some([0, 1], 1))
def test_curves_of_no_or_one_point_are_drawn(overlay: Overlay, points: int, tmp_path: Path) -> None:
    short = replace(
        overlay,
        x=overlay.x[:points],
        real=np.zeros(points),
        before=np.full((3, points), nan),
        after=np.zeros((3, points)),
    )
    assert len(curves_section((short,), with_figures=True).parts) == 1
    figure = overlay_figure(short)
    figure.savefig(tmp_path / "curve.svg")


def test_figures_of_use_are_drawn_with_the_recorded_figures() -> None:
    lines = use_figure(USES).axes[0].get_lines()
    drawn = {round(float(x), 4) for line in lines for x in np.atleast_1d(line.get_xdata())}
    assert {round(0.9 / 1.6, 4), round(1.5 / 1.6, 4), round(0.05 / 0.42, 4), 1.0} <= drawn


def test_the_share_outside_a_band_and_its_largest_point_are_computed() -> None:
    """A band of 1 ± 0.1: two of four points are outside, the last by (2 - 1.1) / 0.1 = 9 half widths."""
    band = np.array([[1.0], [0.9], [1.1]]) * np.ones(4)
    curve = replace(overlays()[0], x=np.arange(4.0), real=np.array([1.0, 0.5, 1.05, 2.0]), before=band)
    assert outside(curve, band) == 0.5
    at, distance = farthest(curve, band)
    assert at == 3.0 and distance == pytest.approx(9.0)
    inside = replace(curve, real=np.array([1.0, nan, 1.0, 1.0]))
    assert outside(inside, band) == 0.0
    assert farthest(inside, band)[1] == 0.0
    assert np.isnan(outside(replace(curve, real=np.full(4, nan)), band))


def test_a_quantity_without_a_tolerance_is_listed_last() -> None:
    noise = Pull("noise", "BMA1", "y", 6.5, "dB", nan, nan, "data sheet")
    table = pulls_table([noise, *PULLS])
    assert [row[1] for row in table.rows] == ["data rate", "scale", "bias", "scale", "noise"]
    assert table.rows[-1] == ["BMA1 y", "noise", "6.5 dB", "–", "–", "data sheet", "–"]
