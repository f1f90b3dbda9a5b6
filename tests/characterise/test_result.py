"""The characterisation of a log: stretch, runs, scales, JSON and the table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.characterise import characterise_log, render_text
from imuarray.characterise.stretch import choose_stretch, find_timing
from imuarray.errors import LogError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Phase, SensorHeader
from tests.selection import some


@pytest.fixture(scope="module")
def result(log_path: Path) -> dict[str, Any]:
    with open_log(log_path) as log:
        return characterise_log(log)


def sensor(result: dict[str, Any], name: str) -> dict[str, Any]:
    return {item["name"]: item for item in result["sensors"]}[name]


@pytest.mark.slow
def test_the_result_is_plain_json(result: dict[str, Any]) -> None:
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert [item["name"] for item in result["sensors"]] == ["A", "E", "G"]


@pytest.mark.slow
def test_the_longest_phase_at_rest_is_chosen(result: dict[str, Any]) -> None:
    assert result["stretch"] == {
        "phase": "static",
        "up": "+Z",
        "start_s": 5.0,
        "end_s": 55.0,
        "chosen_by": "longest phase at rest",
        "left_out_s": [],
        "remark": "",
    }


@pytest.mark.slow
def test_a_gap_splits_the_run(result: dict[str, Any]) -> None:
    """Rows 500 ... 1999 and 2020 ... 5499: the Allan deviation pools both; no term spans the gap."""
    outcome = sensor(result, "A")
    assert (outcome["rows"], outcome["gaps"], outcome["flags"]["lost_before"]) == (4980, 1, 1)
    assert outcome["largest_gap_s"] == pytest.approx(0.21)
    assert outcome["rate_hz"] == pytest.approx(100.0)
    assert outcome["median_interval_s"] == pytest.approx(0.01)
    run = outcome["allan_run"]
    longest = {"start_s": 20.2, "end_s": 54.99, "longest_run_rows": 3480, "interval_s": 0.01}
    assert run == pytest.approx(longest | {"rows": 4980, "runs": 2, "left_out_share": 0.0})
    assert outcome["axes"][0]["allan"]["terms"][0] == 1499 + 3479


def test_figures_of_a_white_sensor_in_all_units(result: dict[str, Any]) -> None:
    """Sigma 20 counts at 100 Hz and 5460 counts per g: 2 counts / sqrt(Hz); rounding adds 1/12 to the variance."""
    z = sensor(result, "A")["axes"][2]
    sigma = (20.0**2 + 1 / 12) ** 0.5
    assert z["counts"]["std"] == pytest.approx(sigma, rel=5 / (2 * 4980) ** 0.5)
    assert z["counts"]["noise_density"] == pytest.approx(sigma / 10, rel=0.1)
    assert z["counts"]["noise_density_one_sided"] == pytest.approx(z["counts"]["std"] / 50**0.5, rel=0.1)
    assert z["unit"]["mean"] == pytest.approx(1.0, abs=5 * 20 / 5460 / 4980**0.5)
    for name, value in z["counts"].items():
        assert z["unit"][name] == pytest.approx(value / 5460)
        assert z["si"][name] == pytest.approx(value / 5460 * 9.80665)
    assert abs(z["lag1"]) < 5 / 4980**0.5
    assert z["bias_instability_is_bound"] in (True, False)
    assert sensor(result, "G")["si_per_count"] == pytest.approx(0.00875 * np.pi / 180)


def test_suspect_and_saturated_rows_are_excluded(result: dict[str, Any]) -> None:
    """The suspect row of 30000 counts would make the spread 400; the run begins after it."""
    outcome = sensor(result, "E")
    assert (outcome["rows"], outcome["rows_used"]) == (5000, 4989)
    assert outcome["flags"]["suspect"] == 1
    assert outcome["flags"]["saturated"] == 10
    assert all(axis["counts"]["std"] == pytest.approx(20, rel=0.06) for axis in outcome["axes"])
    assert all(axis["even_share"] == 1 for axis in outcome["axes"])
    run = outcome["allan_run"]
    assert (run["rows"], run["longest_run_rows"], run["start_s"]) == (2400 + 2599, 2599, pytest.approx(29.01))


def test_stale_rows_are_excluded(result: dict[str, Any]) -> None:
    """Half of the rows are stale; the new readings do not correlate."""
    outcome = sensor(result, "G")
    assert outcome["stale_share"] == 0.5
    assert outcome["rows_used"] == 2500
    assert all(abs(axis["lag1"]) < 5 / 2500**0.5 for axis in outcome["axes"])
    assert outcome["allan_run"]["left_out_share"] == 0


@pytest.mark.slow
def test_a_named_phase_and_sensors_are_selected(log_path: Path) -> None:
    calls: list[None] = []
    with open_log(log_path) as log:
        outcome = characterise_log(log, "motion", ["P", "A"], lambda: calls.append(None))
    assert (outcome["stretch"]["phase"], outcome["stretch"]["chosen_by"]) == ("motion", "named")
    assert [item["name"] for item in outcome["sensors"]] == ["P", "A"]
    pressure = outcome["sensors"][0]
    assert [axis["axis"] for axis in pressure["axes"]] == ["ut", "up"]
    assert pressure["unit_per_count"] is None
    assert pressure["axes"][0]["unit"]["std"] is None
    assert pressure["axes"][0]["counts"]["std"] == pytest.approx(20, rel=0.2)
    assert sensor(outcome, "A")["axes"][0]["counts"]["std"] > 1000
    assert len(calls) == 5
    assert " ut " in render_text(outcome)


def test_unknown_names_are_refused(log_path: Path) -> None:
    with open_log(log_path) as log:
        with pytest.raises(LogError, match=r"no phase 'room'; it has static, motion"):
            characterise_log(log, "room")
        with pytest.raises(LogError, match="no sensor 'Q'"):
            characterise_log(log, sensors=["Q"])


def write_log(path: Path, time: np.ndarray, phases: tuple[Phase, ...] = (), status: np.ndarray | None = None) -> Path:
    header = SensorHeader("S", "chip", "angular_rate", "dps", 250.0, 100.0)
    with LogWriter(path, [header], source="emulated", epoch="2024-01-01T00:00:00Z") as writer:
        counts = np.arange(3 * len(time), dtype=np.int16).reshape(-1, 3)
        flags = np.zeros(len(time), np.uint16) if status is None else status
        writer.append("S", Block(time.astype(np.int64), counts, flags))
        for phase in phases:
            writer.phase(phase)
    return path


@pytest.mark.parametrize(
    ("phases", "chosen"),
    some(
        [
            ((), None),
            ((Phase(0, 90, "heat"), Phase(0, 80, "run 3")), "run 3"),
            ((Phase(0, 90, "heat", "+Z"), Phase(0, 80, "cool")), "heat"),
            ((Phase(0, 90, "motion", "+Z"), Phase(0, 80, "run 1"), Phase(80, 90, "run 2")), None),
            ((Phase(0, 90, "heat"), Phase(5, 20, "x_down"), Phase(30, 40, "room")), "x_down"),
            ((Phase(0, 9, "static"), Phase(10, 50, "z_up_check")), "z_up_check"),
            ((Phase(0, 9, "static"), Phase(10, 50, "mine", "-Y")), "mine"),
            ((Phase(0, 90, "warm_up"),), None),
        ],
        2,
    ),
)
def test_the_stretch_is_the_longest_phase_at_rest(
    tmp_path: Path, phases: tuple[Phase, ...], chosen: str | None
) -> None:
    with open_log(write_log(tmp_path / "run.h5", np.arange(100), phases)) as log:
        stretch = choose_stretch(log)
    assert stretch.phase == chosen
    if chosen is None:
        assert (stretch.start_ns, stretch.end_ns) == (0, 100)


@pytest.mark.slow
@pytest.mark.parametrize("block", [1, 2, 7, 1 << 16])
def test_runs_do_not_depend_on_blocks(tmp_path: Path, block: int) -> None:
    """Intervals 10, except 15 (no gap) after row 9, 16 after row 29 and 40 after row 69; row 50 is set up again."""
    intervals = np.full(99, 10)
    intervals[[9, 29, 69]] = 15, 16, 40
    status = np.zeros(100, np.uint16)
    status[50] = 16
    path = write_log(tmp_path / "run.h5", np.concatenate([[0], np.cumsum(intervals)]), status=status)
    with open_log(path) as log:
        timing = find_timing(log["S"], slice(0, 100), block)
    assert (timing.gaps, timing.run) == (2, slice(0, 30))
    assert timing.runs == (slice(0, 30), slice(30, 50), slice(50, 70), slice(70, 100))
    assert timing.interval_s == pytest.approx(10e-9)
    assert timing.largest_gap_s == pytest.approx(40e-9)


def test_the_rate_of_alternating_intervals_is_their_mean(tmp_path: Path) -> None:
    """19 ms and 21 ms alternating are 50 Hz, without a gap."""
    time = np.cumsum(np.tile([19_000_000, 21_000_000], 60))
    with open_log(write_log(tmp_path / "run.h5", time)) as log:
        outcome = characterise_log(log)["sensors"][0]
    assert outcome["rate_hz"] == pytest.approx(50, rel=0.001)
    assert outcome["gaps"] == 0
    assert outcome["axes"][0]["allan"]["tau_s"][:2] == pytest.approx([0.02, 0.04], rel=0.001)


@pytest.mark.parametrize("rows", some([0, 1, 2, 8, 9], 2))
def test_short_logs_are_characterised(tmp_path: Path, rows: int) -> None:
    with open_log(write_log(tmp_path / "run.h5", np.arange(rows) * 10)) as log:
        outcome = characterise_log(log)
    assert (outcome["sensors"][0]["axes"][0]["allan"] is not None) == (rows >= 9)
    assert "S " in render_text(outcome)
    json.dumps(outcome, allow_nan=False)


def test_the_table_fits_the_terminal_and_has_a_title(result: dict[str, Any]) -> None:
    long_name = result | {"log": "folder/" * 30 + "run.h5", "source": "emulated"}
    long_name["sensors"] = [item | {"name": item["name"] * 30, "chip": "chip" * 9} for item in result["sensors"]]
    for text in (render_text(result), render_text(long_name)):
        assert max(map(len, text.splitlines())) <= 110
    text = render_text(result)
    assert "'static', 5.0 s to 55.0 s, +Z up (longest phase at rest)" in text
    assert "4980 rows in 2 runs of <=34.8 s" in text
    assert sum(line.startswith(("A ", "E ", "G ")) for line in text.splitlines()) == 2 * 9 + 3  # readings, fits; rows


def test_the_table_warns_of_a_log_in_motion(tmp_path: Path) -> None:
    with open_log(write_log(tmp_path / "run.h5", np.arange(50) * 10)) as log:
        text = render_text(characterise_log(log))
    assert "any motion counts as noise" in text
    assert "emulated, no hardware" in text


def test_the_scale_of_a_calibration_replaces_that_of_the_data_sheet(log_path: Path) -> None:
    with open_log(log_path) as log:
        outcome = characterise_log(log, sensors=["A"], scales={"A": [5000.0, 5460.0, 6000.0]})
    axes = sensor(outcome, "A")["axes"]
    assert [axis["unit_per_count"] for axis in axes] == [1 / 5000, 1 / 5460, 1 / 6000]
    for axis in axes:
        assert axis["unit"]["std"] == pytest.approx(axis["counts"]["std"] * axis["unit_per_count"])


@pytest.mark.slow
def test_the_decimated_estimator_is_named_and_agrees(log_path: Path) -> None:
    with open_log(log_path) as log:
        exact, fewer = (characterise_log(log, sensors=["G"], estimator=name) for name in ("overlapping", "decimated"))
    for result, name in ((exact, "overlapping"), (fewer, "decimated")):
        assert sensor(result, "G")["allan_estimator"] == name
    ours, theirs = (sensor(result, "G")["axes"][0]["allan"] for result in (fewer, exact))
    # the same squares up to a factor of 8 (every start), a subset of them beyond
    np.testing.assert_allclose(ours["deviation"][:4], theirs["deviation"][:4], rtol=1e-12)
    inside = [
        low < value < high for value, low, high in zip(ours["deviation"], theirs["low"], theirs["high"], strict=True)
    ]
    assert all(inside)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit of rows in memory is below the length of the shorter log, which is long enough for the longest segments
    of both spectra.
    """
    import tracemalloc

    monkeypatch.setattr("imuarray.log.columns.CACHED_BYTES", 1 << 20)
    peaks = []
    for rows in (600_000, 2_400_000):
        path = tmp_path / f"{rows}.h5"
        header = SensorHeader("A", "bma180", "specific_force", "g", 2.0, 4096.0, rate_hz=400.0)
        with LogWriter(path, [header], source="simulated", epoch="2020-01-01T00:00:00Z") as log:
            generator = np.random.default_rng(1)
            for start in range(0, rows, 100_000):
                counts = np.rint(generator.normal(0, 5, (100_000, 3))).astype(np.int16)
                times = np.arange(start, start + 100_000, dtype=np.int64) * 2_500_000
                log.append("A", Block(times, counts, np.zeros(100_000, np.uint16)))
        with open_log(path) as log:
            tracemalloc.start()
            characterise_log(log, estimator="decimated")
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]
