"""`imuarray.paper.gap`: what the printed tables tell of the data sheets' array, and that they tell it, not the code."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.cli import main
from imuarray.paper.gap import PaperGap, boot_fault, diagnose, even_codes, render_text
from imuarray.paper.gap.acting import ACTS
from imuarray.paper.gap.candidate import Discrepancy
from imuarray.paper.gap.sensor import data_sheet_array
from imuarray.paper.model_units import runs_of
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.odr_error import OdrError
from imuarray.simulate.effects.range_reset import RangeReset

RUN_10 = 9


@cache
def gap() -> PaperGap:
    return diagnose(seed=3)


@cache
def report() -> dict[str, Any]:
    return gap().as_json()


def found(name: str) -> Discrepancy:
    return next(cause.found for cause in gap().causes if cause.found.name == name)


def cause(effect: str, discrepancy: str) -> dict[str, Any]:
    return next(
        entry for entry in report()["causes"] if (entry["effect"], entry["discrepancy"]) == (effect, discrepancy)
    )


@pytest.mark.slow
def test_bma1_fell_back_to_2_g_with_another_offset() -> None:
    entry = cause("range_reset", "boot fault")
    assert entry["sensors"] == ["BMA1"]
    assert entry["probability"] > 0.99
    # Table 6: 4308.719 LSB in run 10, 536.455 on average of the others; 4096 and 512 LSB/g
    assert entry["parameters"]["range_g"] == 2.0
    x, y, z = entry["parameters"]["offset_g"]
    assert z == pytest.approx(4308.719 / 4096 - 536.4548 / 512, abs=1e-4)
    assert x == pytest.approx(31.79535 / 4096 + 100.0839 / 512, abs=1e-3)
    assert 0.2 < y < 0.26
    z_scores = [float(str(check["z"])) for check in found("boot fault").held_out]
    assert len(z_scores) == 2
    assert max(map(abs, z_scores)) < 2


@pytest.mark.slow
def test_gyro3_has_two_states_in_three_axes_at_once() -> None:
    entry = cause("bistable_bias", "two states")
    assert entry["sensors"] == ["Gyro3"]
    assert entry["probability"] > 0.99
    offset_lsb = np.array(entry["parameters"]["offset_dps"]) / 0.00875  # L3G-40
    assert offset_lsb == pytest.approx((-13, 6, -2), abs=1.1)  # section 5.2.4: (0, 69, 2) and (-13, 75, 0)
    assert entry["parameters"]["probability"] == pytest.approx(8 / 15)
    shares = [float(str(check["variance_foretold"])) for check in found("two states").held_out]
    assert shares[0] > 0.98
    assert shares[1] > 0.7


def test_odr_error_ranks_above_a_coarser_converter() -> None:
    ranked = found("even codes").ranked
    assert "odr_error" in ranked[0].candidate.names
    first = next(one.bic for one in ranked if one.candidate.names == ("odr_error", "white_noise"))
    other = next(one.bic for one in ranked if one.candidate.names == ("quantisation", "white_noise"))
    assert first < other
    entry = cause("odr_error", "even codes")
    assert entry["confusable_with"] == ["quantisation"]
    assert cause("white_noise", "even codes")["confusable_with"] == []
    assert all(table["rate_hz"] in (1600.0, 3200.0) for table in entry["parameters"].values())
    impossible = [one for one in ranked if one.candidate.impossible]
    assert [one.probability for one in impossible] == [0.0]
    assert sum(one.probability for one in ranked) == pytest.approx(1.0)


def test_gyroscopes_correlate_and_y_has_a_line() -> None:
    bandwidth = cause("bandwidth", "correlation")
    assert bandwidth["parameters"]["Gyro1"]["cutoff_hz"] == pytest.approx(51.04, abs=0.01)  # exp(-2 pi f / 350) = 0.4
    assert bandwidth["confusable_with"] == ["stale_samples"]
    tone = cause("tone", "line")
    assert tone["axes"] == ["y"]
    assert 45 < tone["parameters"]["Gyro1"]["frequency_hz"] < 60
    assert found("correlation").held_out[0]["within"] is True


def test_slopes_beside_what_the_data_sheets_allow() -> None:
    rows: Any = found("slopes").facts["slopes"]
    assert len(rows) == 27
    beyond = {row["channel"]: row["slope_g_per_degc"] for row in rows if row["beyond_limit"]}
    # 0.496 LSB of 512 per g and 4.516 of 5460, against 0.5 mg/K (BMA-115)
    assert beyond == {
        "BMA2 z": pytest.approx(0.496 / 512),
        "BMA3 z": pytest.approx(4.516 / 5460),
    }
    assert cause("thermal_bias", "slopes")["action"] == "replace"


def test_what_is_left_is_said() -> None:
    result = report()
    assert result["verdict"] == "partly explained"
    assert result["unexplained"]
    low, high = result["gap"]["closed_ci95"]
    assert 0 < low < result["gap"]["closed"] < high < 1
    left = [row for row in result["sweep"] if row["verdict"].startswith("not explained")]
    assert len(left) == len(gap().unexplained)
    assert all(abs(row["z_after"]) <= 3 for row in result["sweep"] if row["verdict"].startswith("closed"))
    assert "Table 11" in {row["table"] for row in left}


def test_the_object_is_plain_json_with_the_keys_of_gap_diagnose() -> None:
    result = report()
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    keys = {
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
    }
    assert keys | {"tables"} <= set(result)
    wanted = {"effect", "action", "sensors", "axes", "probability", "parameters", "closed", "closed_ci95"}
    for entry in result["causes"]:
        assert wanted | {"confusable_with"} <= set(entry)
        assert entry["effect"] in EFFECTS
        assert entry["errors"]
    assert set(ACTS) <= set(EFFECTS)
    assert result["where"][0]["sensor"] == "BMA1"
    assert result["where"][0]["phase"] == ""
    assert [abs(row["significance"]) for row in result["where"]] == sorted(
        (abs(row["significance"]) for row in result["where"]), reverse=True
    )


def test_the_page_is_narrow() -> None:
    text = render_text(gap())
    assert max(map(len, text.splitlines())) <= 100
    for words in ("range_reset", "bistable_bias", "odr_error", "BMA2 z 0.97", "Not explained"):
        assert words in text


def test_another_range_in_the_table_is_another_range_found(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = runs_of("BMA1").copy()
    bias_g = np.array([0.02, -0.03, 0.01])
    force_g = np.array([-16.3, -14.8, 1052.4 / 2]) / 512  # half of z_up - z_down, Table 10
    runs[RUN_10] = (force_g + bias_g) * 2048  # BMA-74: 4 g
    monkeypatch.setattr(boot_fault, "runs_of", lambda _: runs)
    best = boot_fault.boot_fault(data_sheet_array()).best
    ((reset,),) = best.adds.values()
    assert isinstance(reset, RangeReset)
    assert reset.range == 4.0


def test_a_run_like_the_others_is_no_boot_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = runs_of("BMA1").copy()
    runs[RUN_10] = np.delete(runs, RUN_10, axis=0).mean(axis=0)
    monkeypatch.setattr(boot_fault, "runs_of", lambda _: runs)
    assert "range_reset" not in boot_fault.boot_fault(data_sheet_array()).best.names


@pytest.mark.parametrize(
    ("factor", "effect"),
    [(1.0, "quantisation"), (2.0, "odr_error"), (2.0 * np.sqrt(2), "odr_error")],
)
def test_even_codes_with_the_noise_of_a_rate_are_that_rate(
    monkeypatch: pytest.MonkeyPatch, factor: float, effect: str
) -> None:
    # ADX-67, ADX-68: 0.75 and 1.1 LSB at 100 Hz, root 2 an octave; even codes add 4/12
    noise = np.sqrt((np.array([0.75, 0.75, 1.1]) * 2 * factor) ** 2 + 1 / 3)
    monkeypatch.setattr(even_codes, "found_noise", lambda _: noise)
    best = even_codes.even_codes(data_sheet_array()).best
    assert best.names == (effect,)
    for one in best.adds["ADXL1"]:
        if isinstance(one, OdrError):
            assert one.rate_hz == pytest.approx(400 * factor**2)


@pytest.mark.slow
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "gap"
    assert main(["paper", "--gap", "--seed", "3", "--json", "-o", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == report() == json.loads((out / "gap.json").read_text())
    assert [path.name for path in out.iterdir()] == ["gap.json"]
    assert main(["paper", "--gap", "-o", str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["paper", "--gap", "--replica"]) == 2
    assert "one at a time" in capsys.readouterr().err
