"""A page from any mix of files: each is recognised and has its section, and other files are refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration, calibrate_tumble
from imuarray.cli import main
from imuarray.errors import ImuArrayError, LogError, OutputExistsError
from imuarray.fuse import FaultEvent, FusedBlock, fuse, write_fused
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from imuarray.report.files import file_kind, write_report
from imuarray.report.log_page import log_sections
from imuarray.report.page import Table
from tests.fuse.conftest import Part, WriteRun


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short tumble of the emulated array, its calibration and a fused result."""
    folder = tmp_path_factory.mktemp("report")
    run = folder / "tumble.h5"
    url = "emulated:?world=tumble&face_s=2"
    assert main(["log", "martin2013", "--bus", url, "--seconds", "34", "--rate-hz", "25", "-o", str(run)]) == 0
    with open_log(run) as log:
        calibrate_tumble(log).calibration.save(folder / "cal.toml")
        sensors = {quantity: [s.name for s in log.of(quantity)] for quantity in ("specific_force", "angular_rate")}
        blocks = fuse(log, Calibration(), "mean")
        write_fused(folder / "fused.h5", blocks, epoch=log.epoch, technique="mean", log=str(run), sensors=sensors)
    return folder


@pytest.mark.slow
def test_each_file_has_its_section(inputs: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    kinds = write_report([inputs / "fused.h5", inputs / "cal.toml", inputs / "tumble.h5"], page)
    assert list(kinds.values()) == ["fused result", "calibration", "log"]
    text = page.read_text()
    titles = re.findall(r'<h2 id="section-\d+">(.*?)</h2>', text)
    assert titles == [
        "tumble.h5: what was recorded",
        "tumble.h5: the recording",
        "tumble.h5: noise",
        "tumble.h5: residuals of the calibration",
        "tumble.h5: gain of each technique",
        "cal.toml: calibration",
        "fused.h5: fused by mean",
    ]
    assert text.count("<img") == text.count("alt=") == 4  # no Allan curve, no spectrum: a face lasts two seconds
    assert "2 s are too short, at least 30 s are needed" in text
    markup = re.sub(r"(<script[^>]*>).*?</script>", r"\1", text, flags=re.DOTALL)  # BokehJS contains such texts itself
    assert not re.search(r'(src|href)="(?!#|data:)', markup)  # it needs no other file


@pytest.mark.slow
def test_residuals_are_those_of_the_faces(inputs: Path, tmp_path: Path) -> None:
    """The calibration was fitted to these faces: the residual is the noise of their means. An ADXL345's z scatters by
    47 mg, 50 readings a face: 6.7 mg; twice that is beyond every rms over seven faces.
    """
    page = tmp_path / "page.html"
    write_report([inputs / "cal.toml", inputs / "tumble.h5"], page)
    table = page.read_text().split("residuals of the calibration</h2>")[1].split("</table>")[0]
    rms = [float(row.split("<td>")[-1].split("<")[0]) for row in table.split("<tr>")[2:]]
    assert len(rms) == 6
    assert 0 < max(rms) < 13.4


@pytest.mark.slow
def test_failed_sensors_are_reported(inputs: Path, tmp_path: Path) -> None:
    event = FaultEvent(1_500_000_000, "specific_force", "B<1>", ("x",), "range_reset", "isolated", 8.0, 40.0, range=2.0)
    back = replace(event, time_ns=9_000_000_000, state="readmitted")
    frames = FusedBlock(np.arange(50) * 20_000_000, {"specific_force": np.zeros((50, 3))})
    fused, page = tmp_path / "fused.h5", tmp_path / "page.html"
    write_fused(fused, [frames], epoch="2024-01-01T00:00:00Z", technique="optimal", log="r.h5", events=[event, back])
    write_report([fused], page)
    text = page.read_text()
    assert "fused.h5: excluded for part of the time because they failed: B&lt;1&gt;." in text
    assert "1.50 s: B&lt;1&gt; x has 8 times its scale, as if set to a range of 2 g (40 sigma): excluded" in text
    assert "9.00 s: B&lt;1&gt; x agrees with the others again: back in use" in text


@pytest.mark.slow
def test_the_claimed_error_is_that_at_rest(tmp_path: Path) -> None:
    """A third of the frames is motion, whose claimed error of 0.5 m/s2 (uncertain times) does not apply to the rest."""
    rng, motion = np.random.default_rng(1), np.arange(3000) >= 2000
    force = rng.normal(0.0, np.where(motion, 5.0, 0.02)[:, None], (3000, 3))
    claimed = np.repeat(np.where(motion, 0.5, 0.02)[:, None] ** 2, 6, axis=1) * [1, 1, 1, 0, 0, 0]
    frames = FusedBlock(
        np.arange(3000) * 10_000_000, {"specific_force": force}, covariances={"specific_force": claimed}
    )
    fused, page = tmp_path / "fused.h5", tmp_path / "page.html"
    write_fused(fused, [frames], epoch="2024-01-01T00:00:00Z", technique="mean", log="r.h5")
    write_report([fused], page)
    row = page.read_text().split("specific force X")[1].split("</tr>")[0]
    scatter, own = (float(cell) for cell in re.findall(r">([0-9.]+)<", row))
    assert scatter == pytest.approx(2.04, rel=0.1)  # mg
    assert own == pytest.approx(2.039, abs=0.001)


@pytest.mark.slow
def test_a_gap_diagnosis_is_shown_with_escaped_names(inputs: Path, tmp_path: Path) -> None:
    table = {
        "verdict": "unexplained", "sentence": "<script>alert(1)</script>", "p": 0.001,
        "gap": {"before": 3.0, "after": 3.0, "floor": 1.0, "closed": 0.0, "closed_ci95": None, "domains": {}},
        "where": [], "causes": [], "unknown": 0.9, "unexplained": [], "next_experiment": "heat it", "cannot_tell": [],
        "uses": [], "judged": [],
        "map": {"sensors": ["Gyro1"], "domains": ["level"], "before": [[5.0]], "after": [[None]], "limit": 3.5},
        "recorded": [], "notes": [], "held_out": "every second log", "seed": 1, "replicates": 60, "model": "datasheet",
        "software": "imuarray",
    }  # fmt: skip
    folder, page = tmp_path / "gap", tmp_path / "page.html"
    folder.mkdir()
    (folder / "gap.json").write_text(json.dumps(table))
    assert write_report([folder], page) == {str(folder): "gap diagnosis"}
    text = page.read_text()
    assert "<script>" not in text and "&lt;script&gt;" in text
    assert "Where the gap is" in text
    del table["map"]
    (folder / "gap.json").write_text(json.dumps(table))
    with pytest.raises(LogError, match=r"map is missing"):
        write_report([folder], page, force=True)


@pytest.mark.slow
def test_a_folder_is_replaced_by_its_files(inputs: Path, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("cal.toml", "fused.h5"):
        (tmp_path / "in" / name).write_bytes((inputs / name).read_bytes())
    (tmp_path / "in" / "notes.txt").write_text("of no kind")
    kinds = write_report([tmp_path / "in"], tmp_path / "page.html")
    assert {Path(path).name: kind for path, kind in kinds.items()} == {
        "cal.toml": "calibration", "fused.h5": "fused result",
    }  # fmt: skip
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="empty: contains no file that a report can show; allowed are logs"):
        write_report([tmp_path / "empty"], tmp_path / "other.html")


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.json", "[1, 2]"), ("b.toml", "[array]\nname = 'x'"), ("c.csv", "1,2"), ("d.json", "{" * 9999)],
)
def test_other_files_are_refused_with_the_allowed_kinds(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(LogError, match="allowed are logs and fused results"):
        file_kind(tmp_path / name)


@pytest.mark.slow
def test_an_existing_page_is_not_overwritten_and_a_missing_file_is_named(inputs: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("mine")
    with pytest.raises(OutputExistsError):
        write_report([inputs / "cal.toml"], page)
    assert page.read_text() == "mine"
    with pytest.raises(ImuArrayError, match=r"none\.h5: no such file"):
        file_kind(tmp_path / "none.h5")


def test_the_command_writes_a_page(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    assert main(["report", str(inputs / "cal.toml"), "-o", str(page), "--json", "--title", "My array"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == {str(inputs / "cal.toml"): "calibration"}
    assert "<h1>My array</h1>" in page.read_text()
    assert main(["report", str(inputs / "cal.toml"), "-o", str(page)]) == 2


@pytest.mark.slow
def test_a_log_without_rest_has_a_table_of_its_recording(inputs: Path, tmp_path: Path) -> None:
    with open_log(inputs / "tumble.h5") as log:
        rates = [len(sensor) for sensor in log.of("specific_force")]
    page = tmp_path / "page.html"
    write_report([inputs / "tumble.h5"], page)
    row = page.read_text().split(">BMA1</th>")[1].split("</tr>")[0]
    assert f"<td>{rates[0]}</td>" in row
    assert np.isfinite(float(re.findall(r"<td>([\d.]+)</td>", row)[1]))


@pytest.mark.parametrize("frames", [1, 5])
def test_a_log_too_short_for_any_figure_has_a_page(tmp_path: Path, frames: int) -> None:
    """A fit of the Allan deviation requires more."""
    run = WriteRun(tmp_path)([Part("A", sigma=0.01)], frames=frames)
    with open_log(run) as log:
        sections = list(log_sections(log, {}, with_figures=False))
    assert sections[0].title == "run.h5: what was recorded"
    if frames > 1:
        noise = sections[2].parts[0]
        assert isinstance(noise, Table)
        assert [row[-3:] for row in noise.rows] == [["–", "–", "–"]] * 3


def test_noise_is_that_of_the_longest_rest_and_findings_are_listed(tmp_path: Path) -> None:
    """20 s at rest (0.01 g of noise), then shaken by 1 g, without a phase. Each finding has a row, and a
    magnetometer has its noise in the table.
    """
    run, rng, rows = tmp_path / "run.h5", np.random.default_rng(3), 3000
    shaken = np.where(np.arange(rows) < 2000, 0.0, 1.0)[:, None]
    force = [0, 0, 1] + 0.01 * rng.normal(size=(rows, 3)) + shaken * rng.normal(size=(rows, 3))
    field = [0.2, 0, 0.4] + 0.002 * rng.normal(size=(rows, 3))
    headers = [
        SensorHeader("A", "any", "specific_force", "g", 16.0, 2048.0),
        SensorHeader("M", "any", "magnetic_field", "gauss", 8.0, 4000.0),
    ]
    with LogWriter(run, headers, source="imported", epoch="2024-01-01T00:00:00Z") as log:
        time = np.arange(rows) * 10_000_000
        codes = {"A": np.rint(force * 2048), "M": 2 * np.rint(field * 2000)}
        for name, counts in codes.items():
            log.append(name, Block(time, counts.astype(np.int16), np.zeros(rows, np.uint16)))
    with open_log(run) as recorded:
        noise = list(log_sections(recorded, {}, with_figures=False))[-1]
    assert "the longest rest that the sensors show" in noise.text
    unusual, scatter = noise.parts[0], noise.parts[1]
    assert isinstance(scatter, Table) and isinstance(unusual, Table)
    values = {row[0]: (row[1], float(row[2])) for row in scatter.rows}
    assert values["A x"] == ("mg", pytest.approx(10, rel=0.1))
    assert values["M x"] == ("gauss", pytest.approx(0.002, rel=0.1))
    assert ["M x, y, z", "only even codes"] in [list(row) for row in unusual.rows]
