"""The study's page: its verdict, and axes that are not scaled by one long interval."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from imuarray.fuse import Ratio
from imuarray.studies.fusion_gain.gain_study import GainRow, Study
from imuarray.studies.fusion_gain.page import ratios_figure, study_verdict, write_study_page


def row(technique: str, ratio: float, high: float, experiment: str = "heating") -> GainRow:
    over = Ratio(ratio, 0.01, ratio - 0.02, high)
    return GainRow(experiment, "measured", "all", technique, "angular_rate", "rms", "XYZ", 1e-3, over)


def test_the_technique_with_the_largest_gain_is_named() -> None:
    rows = (
        row("mean", 1.0, 1.0),
        row("opposed", 0.4, 0.5),
        row("opposed", 0.9, 1.1, "motion"),
        row("planes", 0.8, 0.9),
    )
    verdict = study_verdict(Study(rows, (1, 2, 3)))
    assert verdict.level == "good"
    assert verdict.sentence == (
        "The technique opposed gains most: at best, its error is 0.40 times that of the simple average"
        " (heating, all, angular rate)."
    )
    assert verdict.figures == (("0.40 ×", "opposed at best: heating"), ("0.80 ×", "planes at best: heating"))


def test_a_gain_within_chance_is_not_reported() -> None:
    verdict = study_verdict(Study((row("opposed", 0.9, 1.3),), (1,)))
    assert (verdict.level, verdict.sentence) == (
        "doubtful", "No technique is better than the simple average beyond chance.",
    )  # fmt: skip
    assert study_verdict(Study((), (1,))).sentence == "No technique was compared with the simple average."


def test_one_long_interval_does_not_scale_the_axis() -> None:
    pytest.importorskip("matplotlib")
    figure = ratios_figure({"heading": [row("opposed", 0.5, 4e9), row("planes", 1.2, 1.4)]}, "over_mean")
    left, right = figure.axes[0].get_xlim()
    assert left == 0
    assert right == pytest.approx(1.05 * 3 * 1.2)


def test_an_error_far_beyond_the_others_is_an_arrow_with_its_number() -> None:
    pytest.importorskip("matplotlib")
    panel = ratios_figure({"heading": [row("opposed", 77.66, 2e9), row("planes", 1.2, 1.4)]}, "over_mean").axes[0]
    assert panel.get_xlim()[1] == pytest.approx(1.05 * 1.4)
    assert [text.get_text() for text in panel.texts] == ["77.7 ×"]


def test_a_lost_heading_is_reported(tmp_path: Path) -> None:
    ends = [replace(row("planes", 2.0, 3.0), quantity="", measure="heading", value=value) for value in (59.0, 61.0)]
    write_study_page(tmp_path / "study.html", Study(tuple(ends), (1, 2)), {})
    page = (tmp_path / "study.html").read_text(encoding="utf-8")
    assert "<td>59</td>" in page and "<td>61 (lost)</td>" in page
