"""From runs to rows, and the command."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import imuarray.studies.fusion_gain.gain_study
from imuarray.cli import main
from imuarray.commands import study as command
from imuarray.fuse import technique_names
from imuarray.gap.model.workers import processes
from imuarray.studies.fusion_gain.gain_study import EXPERIMENTS, RunErrors, Study, render_text, rows_of, study
from imuarray.studies.fusion_gain.page import HeatingErrors, drawings_of
from tests.json_page import documented


def measured(technique: str, seed: int, boot: int, square: float, **more: object) -> RunErrors:
    squares = {("rms", "X"): square}
    return RunErrors("static", "true", "all", technique, "angular_rate", (seed, boot), squares, **more)  # type: ignore[arg-type]


def test_rows_pool_boots_of_a_seed_and_then_seeds() -> None:
    """Mean squares: 4 and 8 of two boots are 6, with 10 of another seed 8; over the average's 16."""
    runs = [measured("mean", seed, boot, 16.0) for seed, boot in ((1, 0), (1, 1), (2, 0))]
    for seed, boot, square in ((1, 0, 4.0), (1, 1, 8.0), (2, 0, 10.0)):
        runs.append(measured("planes", seed, boot, square, bound={"X": 2.0}, normalised=1.5, holds=boot == 0))
    rows = {row.technique: row for row in rows_of(runs)}
    planes = rows["planes"]
    assert planes.value == pytest.approx(math.sqrt(8))
    assert planes.over_mean.ratio == pytest.approx(math.sqrt(0.5))
    # Each of two seeds omitted in turn: sqrt(10 / 16) and sqrt(6 / 16).
    assert planes.over_mean.ratio_se == pytest.approx((math.sqrt(10 / 16) - math.sqrt(6 / 16)) / 2)
    assert planes.over_bound is not None and planes.over_bound.ratio == pytest.approx(2.0)
    assert (planes.normalised, planes.consistent) == (1.5, pytest.approx(2 / 3))
    assert rows["mean"].over_mean.ratio == 1.0 and rows["mean"].over_bound is None


@pytest.mark.slow
def test_a_short_study_has_every_technique(short: Study) -> None:
    for calibration in ("measured", "true"):
        for sensors in ("all", "4 BMA180", "2 ADXL345"):
            rows = short.of(calibration=calibration, sensors=sensors, measure="rms", box_axis="XYZ")
            assert set(technique_names()) <= {row.technique for row in rows}
    bounds = [row for row in short.of(measure="rms") if row.over_bound is not None]
    assert bounds and {row.calibration for row in bounds} == {"true"}
    # 576 frames of three axes determine an rms to 1.7 %, and the posterior mean reaches its bound; four of these.
    for row in bounds:
        if row.technique.startswith("bound") and row.box_axis == "XYZ":
            assert row.over_bound is not None and row.over_bound.ratio == pytest.approx(1.0, abs=4 * 0.017)


@pytest.mark.slow
def test_a_study_is_written_as_text_and_json(short: Study) -> None:
    text = render_text(short)
    assert "static: 2 ADXL345, calibrated" in text and "planes" in text
    whole = json.loads(json.dumps(short.as_json(), allow_nan=False))
    keys, entries = documented()["study"]
    assert (whole.keys(), whole["rows"][0].keys()) == (keys, entries["rows"])
    assert whole["seeds"] == [1] and whole["seconds"] == 12.0
    planes = next(row for row in whole["rows"] if (row["technique"], row["sensors"]) == ("planes", "2 ADXL345"))
    assert planes["over_mean"]["low"] is None  # one seed has no interval
    assert planes["over_mean"]["ratio"] < 1


@pytest.mark.slow
def test_the_command_writes_numbers_figures_and_a_page(
    short: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(imuarray.studies.fusion_gain.gain_study, "study", lambda *_, **__: short)
    arguments = ["study", "--experiments", "static", "--seeds", "1", "--workers", "1", "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert "static: all, calibrated" in capsys.readouterr().out
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"study.json", "study.html", "ratios.png", "bound.png"}  # no coast in twelve seconds, no heating
    page = (tmp_path / "out" / "study.html").read_text()
    assert "What fusion gains" in page and page.count("<img") == 2
    assert main(arguments) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_curves_of_a_heated_box(short: Study, warm: HeatingErrors) -> None:
    """Ten means of ten seconds, minus the first; of the average, and of techniques that differ from it; 24 to 52 degC,
    with a peak of 2200 frames within 0.1 degC. The 0.02 dps/degC of a gyroscope are visible: more than 0.1 dps.
    """
    assert warm.time_s.tolist() == [5.0 + 10 * k for k in range(10)]
    assert {"mean", "opposed"} <= set(warm.errors)
    others = [errors for name, errors in warm.errors.items() if name != "mean"]
    assert not any(np.allclose(errors, warm.errors["mean"], rtol=1e-6, atol=0) for errors in others)
    for errors in warm.errors.values():
        assert errors.shape == (10, 3) and not errors[0].any()
    assert np.degrees(np.abs(warm.errors["mean"]).max()) > 0.1
    assert warm.temperature[1].max() == pytest.approx(52.0, abs=0.1)
    assert "heating.png" in drawings_of(short, warm)


def test_the_command_refuses_unknown_experiments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "--experiments", "static,dropping"]) == 2
    assert "allowed are static, tumble, heating, turn-on, motion, shaking" in capsys.readouterr().err
    assert tuple(EXPERIMENTS) == command.EXPERIMENTS


@pytest.mark.slow
def test_results_do_not_depend_on_workers() -> None:
    with processes(2) as executor:
        apart = study(("static", "motion"), 1, seconds=4.0, executor=executor)
    assert apart.as_json() == study(("static", "motion"), 1, seconds=4.0).as_json()
