"""The recording on the page of a log: a log made by hand, in which it is known what is out of bounds."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, SATURATED, SensorHeader
from imuarray.report.files import write_report
from imuarray.report.recording import Recording, Span, recording_of, scripts

ROWS, PERIOD_NS = 20_000, 10_000_000
SPIKE_AT, SPIKE = 12_345, 700


def header(name: str, **changes: object) -> SensorHeader:
    facts: dict[str, object] = {"quantity": "specific_force", "unit": "g", "range": 16.0, "sensitivity": 256.0}
    return SensorHeader(name, "adxl345", **{**facts, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """200 s of two sensors: A has a spike of one reading, and 50 clipped ones; B lacks 3 s, and ends 20 s early."""
    path = tmp_path_factory.mktemp("recording") / "run.h5"
    time = np.arange(ROWS, dtype=np.int64) * PERIOD_NS
    counts = np.random.default_rng(1).integers(-3, 4, (ROWS, 3)).astype(np.int16)
    counts[SPIKE_AT, 1] = SPIKE
    status = np.zeros(ROWS, np.uint16)
    status[5000:5050] = SATURATED
    kept = np.r_[0:8000, 8300:18_000]
    flags = np.where(kept == 8300, np.uint16(LOST_BEFORE), np.uint16(0))
    with LogWriter(
        path, [header("A"), header("B", axes="+Y+X-Z")], source="imported", epoch="2026-01-01T00:00:00Z"
    ) as writer:
        writer.append("A", Block(time, counts, status, None))
        writer.append("B", Block(time[kept], np.tile(np.array([1, 2, 3], np.int16), (len(kept), 1)), flags, None))
    return path


@pytest.fixture(scope="module")
def recording(path: Path) -> Recording:
    with open_log(path) as log:
        recording = recording_of(log, Calibration())
    assert recording is not None
    return recording


def test_a_spike_of_one_reading_is_in_the_envelope(recording: Recording) -> None:
    first, _ = recording.traces
    assert len(first.time_s) < ROWS / 4
    assert float(np.nanmax(first.high[:, 1])) == pytest.approx(SPIKE / 256)
    at = int(np.nanargmax(first.high[:, 1]))
    assert first.time_s[at] == pytest.approx(SPIKE_AT * 0.01, abs=0.1)
    assert float(np.nanmax(first.high[:, [0, 2]])) == pytest.approx(3 / 256)


def test_what_is_out_of_bounds_is_marked_and_said(recording: Recording) -> None:
    first, second = recording.traces
    assert first.spans == (Span("clipped", 50.0, pytest.approx(50.5)),)
    assert first.note == "50 readings clipped"
    missing, silent = second.spans
    assert missing == Span("missing", pytest.approx(79.99), pytest.approx(83.0))
    assert silent == Span("silent", pytest.approx(179.99), pytest.approx(199.99))
    assert second.note == "readings missing in 1 pause, 3 s in all; silent for 20 s at the end"


def test_a_sensor_is_drawn_along_the_axes_of_the_box(recording: Recording) -> None:
    """+Y+X-Z: the sensor's x lies along the box's Y."""
    second = recording.traces[1]
    np.testing.assert_allclose(np.nanmax(second.high, axis=0), np.array([2.0, 1.0, -3.0]) / 256)


def test_the_curve_is_open_where_readings_are_missing(recording: Recording) -> None:
    paths = recording.drawings[1].paths
    assert [path.count("M") for path in paths] == [2, 2, 2]


def test_the_page_has_all_of_it_without_a_script(path: Path, tmp_path: Path) -> None:
    """And stays small; with Bokeh at hand it has the scripts that zoom."""
    page = tmp_path / "report.html"
    write_report([path], page)
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 5e6
    plain = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert plain.count("<svg") == 2
    assert "readings missing in 1 pause" in plain and 'class="clipped"' in plain
    assert ("bokeh" in text.lower()) == bool(scripts())
    if scripts():
        (data,) = re.findall(r'<script type="application/json">(.*?)</script>', text, flags=re.DOTALL)
        assert [len(trace["low"]) for trace in json.loads(data)["traces"]] == [3, 3]
    assert not re.search(r"(src|href)=\"https?:", plain)
