"""The recording on a page: envelopes that contain every value, marks where readings are clipped, missing or silent, and
a page that is whole without scripts.
"""

from __future__ import annotations

import asyncio
import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, SATURATED, Event, SensorHeader
from imuarray.report import recording as recording_module
from imuarray.report.files import write_report
from imuarray.report.recording import RecordingFigure, SignalSpan, recording_of, scripts
from tests.fuse.conftest import Part, calibration
from tests.monitor.chromium import CHROMIUM, browser
from tests.selection import some

EPOCH = "2026-01-01T00:00:00Z"
ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 4.0, 2048.0, axes="+Y-X+Z")
GYRO = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 100.0)
BARO = SensorHeader(
    "Baro", "bmp180", "pressure", "Pa", 0.0, 0.0, 4.0, columns=("ut", "up"), compensated=("temperature", "pressure")
)


def write_log(path: Path, *, rows: int = 1000, period_ns: int = 10_000_000) -> Path:
    """Acc: a spike along its x in row 700, clipped in rows 5 to 7, nothing from row 300 to 399. Gyro: silent in the
    second half. Baro: four readings a second.
    """
    with LogWriter(path, [ACC, GYRO, BARO], source="imported", epoch=EPOCH) as log:
        counts, status = np.zeros((rows, 3), np.int16), np.zeros(rows, np.uint16)
        counts[700, 0], status[5:8] = 2048, 4
        kept = np.ones(rows, bool)
        kept[300:400] = False
        time = np.arange(rows) * period_ns
        log.append("Acc", Block(time[kept], counts[kept], status[kept]))
        log.append("Gyro", Block(time[: rows // 2], counts[: rows // 2], np.zeros(rows // 2, np.uint16)))
        slow = np.arange(0, rows * period_ns, 250_000_000)
        air = {"temperature": np.full(len(slow), 21.5), "pressure": np.full(len(slow), 100_250.0)}
        log.append("Baro", Block(slow, np.ones((len(slow), 2), np.int32), np.zeros(len(slow), np.uint16), None, air))
    return path


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_log(tmp_path / "run.h5")


def recording(path: Path, known: Calibration | None = None) -> RecordingFigure:
    with open_log(path) as log:
        shown = recording_of(log, known or Calibration())
    assert shown is not None
    return shown


@pytest.mark.slow
@pytest.mark.parametrize("most", [4000, 60])
def test_out_of_bounds_stretches_are_marked(run: Path, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(recording_module, "_MOST_OF_ONE", most)
    acc, baro, gyro = recording(run).traces
    assert acc.spans == (SignalSpan("clipped", 0.05, pytest.approx(0.08)), SignalSpan("missing", 2.99, 4.0))  # type: ignore[arg-type]
    assert acc.note == "3 readings clipped; readings missing in 1 pause, 1 s in all"
    assert gyro.spans == (SignalSpan("silent", 4.99, 9.99),) and gyro.note == "silent for 5 s at the end"
    assert baro.spans == () and baro.note == "" and (baro.columns, baro.unit) == (("pressure",), "Pa")
    inside = (acc.time_s > 2.99) & (acc.time_s < 4.0)
    assert np.isnan(acc.low[inside]).all() and inside.sum() == 1  # the curve is broken where nothing was read


def test_a_calibration_scales_the_curves(run: Path) -> None:
    """With half the nominal response the input was twice as large."""
    known = calibration([Part("Acc", "+Y-X+Z", sensitivity=1024.0)])
    assert np.nanmax(recording(run, known).traces[0].high) == pytest.approx(2.0)


def test_sensors_without_rows_at_the_start_or_at_all_are_silent(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "run.h5", [ACC, GYRO, BARO], source="imported", epoch=EPOCH) as log:
        time = np.arange(1000) * 10_000_000
        for header, first in ((ACC, 0), (GYRO, 400)):
            kept = time[first:]
            log.append(header.name, Block(kept, np.zeros((len(kept), 3)), np.zeros(len(kept), np.uint16)))
    acc, baro, gyro = recording(tmp_path / "run.h5").traces
    assert (acc.note, gyro.note, baro.note) == ("", "silent for 4 s at the beginning", "silent for 10 s at the end")
    assert gyro.spans == (SignalSpan("silent", 0.0, 4.0),)


def test_alternating_poll_order_is_not_shown_as_missing(tmp_path: Path) -> None:
    """The first sensor of one frame is the last of the next: readings are 2 ms and 18 ms apart in turn."""
    time = np.arange(1000) * 10_000_000 + np.where(np.arange(1000) % 2, 8_000_000, 0)
    with LogWriter(tmp_path / "run.h5", [ACC], source="imported", epoch=EPOCH) as log:
        log.append("Acc", Block(time, np.zeros((1000, 3)), np.zeros(1000, np.uint16)))
    assert recording(tmp_path / "run.h5").traces[0].spans == ()


def test_a_log_without_readings_has_no_recording(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "run.h5", [ACC], source="imported", epoch=EPOCH):
        pass
    with open_log(tmp_path / "run.h5") as log:
        assert recording_of(log, Calibration()) is None


@pytest.mark.parametrize("sensors", some([1, 100], 1))
def test_the_page_of_a_long_log_stays_small(tmp_path: Path, sensors: int) -> None:
    """BokehJS has 1.4 MB; an hour's page may have 5."""
    headers = [_named(number) for number in range(sensors)]
    rows = 200_000 // sensors
    rng = np.random.default_rng(1)
    with LogWriter(tmp_path / "run.h5", headers, source="imported", epoch=EPOCH) as log:
        for header in headers:
            counts = rng.normal(0, 100, (rows, 3)).astype(np.int16)
            log.append(header.name, Block(np.arange(rows) * 10_000_000, counts, np.zeros(rows, np.uint16)))
    shown = recording(tmp_path / "run.h5")
    paths = sum(len(path) for drawing in shown.drawings for path in drawing.paths)
    assert len(json.dumps(shown.data)) < 2_600_000
    assert paths < 60_000 * sensors


def _named(number: int) -> SensorHeader:
    return SensorHeader(f"Acc{number}", "bma180", "specific_force", "g", 4.0, 2048.0)


def test_tables_are_shown_without_scrolling(tmp_path: Path) -> None:
    """Forty different events are forty rows; a thousand of one kind are one. No box scrolls up and down."""
    with LogWriter(tmp_path / "run.h5", [ACC], source="imported", epoch=EPOCH) as log:
        log.append("Acc", Block(np.arange(100) * 10_000_000, np.zeros((100, 3)), np.zeros(100, np.uint16)))
        for number in range(40):
            log.event(Event(number, "Acc", "lost", f"number {number}"))
        for number in range(1000):
            log.event(Event(number * 1_000_000_000, "Acc", "late", "behind"))
    write_report([tmp_path / "run.h5"], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert all(f">number {number}<" in text for number in range(40))
    row = next(row for row in text.split("<tr>") if ">behind<" in row)
    assert re.findall(r"<t[hd][^>]*>([^<]*)<", row) == ["0.000", "999.000", "1000", "Acc", "late", "behind"]
    style = text.split("</style>")[0]
    assert re.findall(r"([a-z]+) {[^{}]*max-height", style) == ["img"]  # a printed figure fits a sheet
    assert "overflow-y" not in style


@pytest.mark.slow
def test_a_recording_too_short_for_an_allan_curve_has_a_sentence(run: Path, tmp_path: Path) -> None:
    """Ten seconds less a pause of one; half a second is cut off at either end of a rest."""
    write_report([run], tmp_path / "page.html")
    assert (
        "The Allan deviation is not drawn: 8 s are too short, at least 30 s are needed."
        in (tmp_path / "page.html").read_text()
    )


def test_names_are_escaped_in_drawings_and_data(tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)>"  # a slash would be a group of HDF5
    header = SensorHeader(evil, "bma180", "specific_force", "g", 4.0, 2048.0)
    with LogWriter(tmp_path / "run.h5", [header], source="imported", epoch=EPOCH) as log:
        log.append(evil, Block(np.arange(100) * 10_000_000, np.zeros((100, 3)), np.zeros(100, np.uint16)))
    write_report([tmp_path / "run.h5"], tmp_path / "page.html")
    assert "<img src=x" not in (tmp_path / "page.html").read_text()


def test_the_data_of_the_script_equal_those_of_the_log(run: Path) -> None:
    shown = recording(run)
    trace = shown.data["traces"][0]
    low, high = (np.frombuffer(base64.b64decode(trace[name][1]), "<f4") for name in ("low", "high"))
    np.testing.assert_array_equal(high, shown.traces[0].high[:, 1].astype(np.float32))
    assert len(low) == len(np.frombuffer(base64.b64decode(trace["time"]), "<f4")) == len(shown.traces[0].time_s)
    assert (shown.data["start"], shown.data["end"], shown.data["time_unit"]) == (0.0, pytest.approx(9.99), "s")


ROWS, PERIOD_NS = 20_000, 10_000_000
SPIKE_AT, SPIKE = 12_345, 700


def header(name: str, **changes: object) -> SensorHeader:
    facts: dict[str, object] = {"quantity": "specific_force", "unit": "g", "range": 16.0, "sensitivity": 256.0}
    return SensorHeader(name, "adxl345", **{**facts, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def long_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """200 s of two sensors: A has a spike of one reading, and 50 clipped ones; B lacks 3 s, and ends 20 s early."""
    path = tmp_path_factory.mktemp("recording") / "run.h5"
    time = np.arange(ROWS, dtype=np.int64) * PERIOD_NS
    counts = np.random.default_rng(1).integers(-3, 4, (ROWS, 3)).astype(np.int16)
    counts[SPIKE_AT, 1] = SPIKE
    status = np.zeros(ROWS, np.uint16)
    status[5000:5050] = SATURATED
    kept = np.r_[0:8000, 8300:18_000]
    flags = np.where(kept == 8300, np.uint16(LOST_BEFORE), np.uint16(0))
    with LogWriter(path, [header("A"), header("B", axes="+Y+X-Z")], source="imported", epoch=EPOCH) as writer:
        writer.append("A", Block(time, counts, status, None))
        writer.append("B", Block(time[kept], np.tile(np.array([1, 2, 3], np.int16), (len(kept), 1)), flags, None))
    return path


@pytest.fixture(scope="module")
def shown(long_run: Path) -> RecordingFigure:
    with open_log(long_run) as log:
        shown = recording_of(log, Calibration())
    assert shown is not None
    return shown


def test_a_spike_of_one_reading_is_in_the_envelope(shown: RecordingFigure) -> None:
    first, _ = shown.traces
    assert len(first.time_s) < ROWS / 4
    assert float(np.nanmax(first.high[:, 1])) == pytest.approx(SPIKE / 256)
    at = int(np.nanargmax(first.high[:, 1]))
    assert first.time_s[at] == pytest.approx(SPIKE_AT * 0.01, abs=0.1)
    assert float(np.nanmax(first.high[:, [0, 2]])) == pytest.approx(3 / 256)


def test_clipped_missing_and_silent_stretches_are_marked_and_described(shown: RecordingFigure) -> None:
    first, second = shown.traces
    assert first.spans == (SignalSpan("clipped", 50.0, pytest.approx(50.5)),)
    assert first.note == "50 readings clipped"
    missing, silent = second.spans
    assert missing == SignalSpan("missing", pytest.approx(79.99), pytest.approx(83.0))
    assert silent == SignalSpan("silent", pytest.approx(179.99), pytest.approx(199.99))
    assert second.note == "readings missing in 1 pause, 3 s in all; silent for 20 s at the end"


def test_a_sensor_is_drawn_along_the_axes_of_the_box(shown: RecordingFigure) -> None:
    """+Y+X-Z: the sensor's x lies along the box's Y."""
    second = shown.traces[1]
    np.testing.assert_allclose(np.nanmax(second.high, axis=0), np.array([2.0, 1.0, -3.0]) / 256)


def test_the_curve_is_interrupted_where_readings_are_missing(shown: RecordingFigure) -> None:
    paths = shown.drawings[1].paths
    assert [path.count("M") for path in paths] == [2, 2, 2]


def test_the_page_is_complete_without_scripts(long_run: Path, tmp_path: Path) -> None:
    """And stays small; with Bokeh installed it has the scripts that zoom."""
    page = tmp_path / "report.html"
    write_report([long_run], page)
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


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_a_browser_draws_and_zooms_every_sensor(run: Path, tmp_path: Path) -> None:
    """A zoom of one figure moves all, and the y axis follows the visible part."""
    pytest.importorskip("bokeh")
    write_report([run], tmp_path / "page.html")
    figures = "Bokeh.documents[0].roots()"
    seen = "[...document.querySelectorAll('.{}')].filter((one) => one.getClientRects().length).length"

    async def visit() -> None:
        async with browser(tmp_path / "profile", (tmp_path / "page.html").as_uri()) as page:
            await page.until("document.querySelectorAll('.live').length === 1")
            for width, dark in ((1366, False), (390, False), (1366, True)):
                await page.screen(width, 900, dark=dark)
                await page.until(f"document.documentElement.scrollWidth <= {width}")  # figures follow in time
            assert (await page.value(seen.format("zoom")), await page.value(seen.format("static"))) == (3, 0)
            assert await page.value(f"{figures}.length") == 3
            assert await page.value(f"{figures}[0].y_range.end") > 1
            await page.value(f"{figures}[0].x_range.setv({{start: 5, end: 6}})")  # no spike there
            assert await page.value(f"{figures}[2].x_range.start") == 5
            assert await page.value(f"{figures}[0].y_range.end") <= 1
            await page.call("Emulation.setEmulatedMedia", media="print")
            assert (await page.value(seen.format("zoom")), await page.value(seen.format("static"))) == (0, 3)
            assert (
                await page.value(
                    "performance.getEntriesByType('resource').filter((one) => !one.name.startsWith('data:')).length"
                )
                == 0
            )
            assert page.said == []

    asyncio.run(visit())
