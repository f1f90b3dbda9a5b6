"""The page has no external resource, escapes names, and has texts for its figures."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import numpy as np
import pytest

from imuarray.errors import OutputExistsError
from imuarray.report import Figure, Section, Table, write_page
from imuarray.report.fused_page import ratio_figure
from imuarray.studies.demo import drift_figure, motion_figure
from tests.html_page import Page

EVIL = "<script>alert('x')</script>\"&--><img src=http://evil.example/x.png>"


def figures(name: str) -> list[Figure]:
    time = np.linspace(0, 10, 50)
    curve = np.sin(time)
    return [
        Figure(drift_figure(time, {name: curve}, {name: curve}, "dps", (time, curve)), name, f"drift of {name}"),
        Figure(drift_figure(time, {}, {"a": curve}, "dps", None), "no thermometer", "drift"),
        Figure(motion_figure((time, curve), {name: time}, {name: curve}, 1.5), name, f"motion by {name}"),
        Figure(ratio_figure([name, "other"], [0.5, 1.1], [0.01, 0.02]), name, f"ratios of {name}"),
    ]


def written(path: Path, name: str = "BMA1") -> str:
    sections = [
        Section(f"Drift of {name}", name, figures(name)),
        Section("Table", "Numbers.", [Table([name, "mg"], [[name, "1.5"], ["b", "2"]], f"caption {name}")]),
    ]
    write_page(path, f"Report on {name}", [f"summary of {name}"], sections)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def evil(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("page") / "report.html", EVIL)


def drawings(page: Page) -> list[str]:
    """The SVG texts inside the data URLs."""
    sources = [str(image["src"]) for image in page.attributes("img")]
    head = "data:image/svg+xml;base64,"
    assert all(source.startswith(head) for source in sources)
    return [base64.b64decode(source[len(head) :]).decode("utf-8") for source in sources]


def test_the_page_has_no_external_resource(text: str) -> None:
    page = Page(text)
    assert "://" not in re.sub(r"data:[^\"]*", "", text)
    assert "//" not in re.sub(r"data:[^\"]*", "", text)
    assert not page.attributes("script") and not page.attributes("link") and not page.attributes("iframe")
    for _, attributes in page.tags:
        for key in ("src", "href"):
            assert str(attributes.get(key, "#")).startswith(("#", "data:image/svg+xml;base64,"))
    assert "url(" not in text and "@import" not in text


def test_drawings_have_no_external_resource(text: str) -> None:
    """Addresses in them are names of namespaces or vocabularies; references lead to the drawing itself."""
    svgs = drawings(Page(text))
    assert len(svgs) == 4
    for drawing in svgs:
        assert "<script" not in drawing and "<image" not in drawing
        assert all(target.startswith("#") for target in re.findall(r"(?<![:\w])(?:xlink:)?href=\"([^\"]*)\"", drawing))
        body = re.sub(r"<metadata>.*?</metadata>", "", drawing, flags=re.DOTALL)
        body = re.sub(r"<!DOCTYPE[^>]*>", "", body)
        body = re.sub(r"xmlns(:\w+)?=\"[^\"]*\"", "", body)
        assert "://" not in body


def test_every_image_has_a_text_and_every_section_a_heading(text: str) -> None:
    page = Page(text)
    assert [image["alt"] for image in page.attributes("img")] == [
        "drift of BMA1",
        "drift",
        "motion by BMA1",
        "ratios of BMA1",
    ]
    assert page.headings == ["Report on BMA1", "Drift of BMA1", "Table"]
    assert [tag for tag, _ in page.tags].count("h1") == 1
    ids = [heading["id"] for heading in page.attributes("h2")]
    assert [section["aria-labelledby"] for section in page.attributes("section")] == ids
    assert [link["href"] for link in page.attributes("a")] == [f"#{anchor}" for anchor in ids]
    assert page.attributes("html")[0]["lang"] == "en"
    assert all(cell.get("scope") in ("col", "row") for cell in page.attributes("th"))
    assert page.open_tags == []


@pytest.mark.slow
def test_names_are_escaped(evil: str) -> None:
    page = Page(evil)
    assert "<script" not in evil
    assert len(page.attributes("img")) == 4
    assert page.attributes("img")[0]["alt"] == f"drift of {EVIL}"
    assert page.headings[0] == f"Report on {EVIL}"
    assert page.open_tags == []
    assert all(set(image) == {"src", "alt"} for image in page.attributes("img"))
    for drawing in drawings(page):
        assert "<script" not in drawing
        assert "<img" not in drawing


def test_numbers_are_in_the_table(text: str) -> None:
    cells = re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", text)
    assert cells == ["BMA1", "mg", "BMA1", "1.5", "b", "2"]
    assert "<caption>caption BMA1</caption>" in text


def test_a_page_is_overwritten_only_with_force(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("mine")
    with pytest.raises(OutputExistsError, match="exists already"):
        write_page(path, "t", [], [])
    assert path.read_text() == "mine"
    write_page(path, "new", [], [], force=True)
    assert Page(path.read_text()).headings == ["new"]


def test_sections_of_one_title_have_distinct_anchors(tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", "t", [], [Section("Noise", ""), Section("Noise", "")])
    ids = [heading["id"] for heading in Page((tmp_path / "report.html").read_text()).attributes("h2")]
    assert len(set(ids)) == 2


def test_control_characters_are_escaped(tmp_path: Path) -> None:
    """Texts of a log may come from any program; line breaks are kept."""
    table = Table(("\x1b[1m",), (("\x9b31m",),), "\u202eb")
    write_page(tmp_path / "report.html", "a\x1b[2J", ["one\ntwo\r"], [Section("\x07", "\x00", [table])])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.replace("\n", "").isprintable()
    assert all(text in page for text in (r"a\x1b[2J", r"\x9b31m", r"\u202eb", r"\x07", r"\x00", "one\ntwo\\r"))


def test_a_fold_hides_parts_behind_a_line(tmp_path: Path) -> None:
    table = Table(("a",), (("b",),), "c")
    write_page(tmp_path / "page.html", "t", [], [Section("s", "words", [table], fold="one <row>"), Section("u", "")])
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert Page(page).open_tags == []
    assert page.count("<details>") == 1
    before, inside = page.split("<details>")
    assert "<p>words</p>" in before
    assert inside.startswith("<summary>one &lt;row&gt;</summary>")
    assert "<caption>c</caption>" in inside.split("</details>")[0]
