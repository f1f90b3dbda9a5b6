"""Snapshots of a log that is written, ended, interrupted, cut into parts, or replaced."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

import imuarray.log.writer as writing
from imuarray.acquire import sample_buffer
from imuarray.calibrate import Calibration
from imuarray.fuse import FusedBlock, write_fused
from imuarray.fuse.fused_file import LiveFused
from imuarray.log import LogWriter, RotatingWriter
from imuarray.log.format import Event, Phase
from imuarray.log.writer import recover
from imuarray.monitor import LogMonitor, SensorView, Snapshot, composition
from imuarray.monitor.snapshot import KEPT
from tests.monitor.conftest import EPOCH, HEADERS, Logger, rows
from tests.selection import some

GRAVITY = 9.80665


def sensor(snapshot: Snapshot, name: str) -> SensorView:
    return next(view for view in snapshot.sensors if view.name == name)


@pytest.mark.slow
def test_the_monitor_waits_for_a_log_that_does_not_exist_yet(log_path: Path) -> None:
    with LogMonitor(log_path) as watch:
        first = watch.refresh(0.0)
        assert (first.state, first.sensors) == ("waiting", ())
        assert "does not exist yet" in first.remark
        with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
            writer.keep()
            Logger(writer).go_on(1.0)
            assert watch.refresh(1.0).state == "being written"


@pytest.mark.slow
def test_sensors_are_shown_in_their_units_while_they_are_written(logger: Logger, log_path: Path) -> None:
    logger.go_on(4.0)
    with LogMonitor(log_path) as watch:
        seen = watch.refresh(100.0)
    assert (seen.state, seen.source, seen.epoch) == ("being written", "emulated", EPOCH)
    assert [view.name for view in seen.sensors] == ["Acc", "Turned", "Gyro", "Baro"]
    acc, gyro, baro = (sensor(seen, name) for name in ("Acc", "Gyro", "Baro"))
    np.testing.assert_allclose(acc.mean, [0.25, -0.5, 1.0], atol=1e-5)
    np.testing.assert_allclose(gyro.mean, [10.0, -5.0, 2.5], atol=1e-3)
    np.testing.assert_allclose(acc.sd, 1 / 2048, rtol=2e-3)  # a count up and down
    assert (acc.unit, gyro.unit, baro.unit) == ("g", "dps", "hPa")
    np.testing.assert_allclose(baro.mean, [1002.5])
    assert acc.use is not None and acc.peak_use is not None
    np.testing.assert_allclose(acc.use, [513 / 8192, 1025 / 8192, 2049 / 8192])
    np.testing.assert_allclose(acc.peak_use, acc.use)
    assert (acc.temperature_degc, acc.relative) == (28.0, False)  # BMA-63: 24 degC, half a degree a count
    assert (gyro.temperature_degc, gyro.relative) == (-20.0, True)
    assert (baro.temperature_degc, baro.relative, baro.use) == (21.5, False, None)
    assert acc.rate_hz == pytest.approx(100) and baro.rate_hz == pytest.approx(4)
    assert (acc.rows, baro.rows) == (400, 16)


@pytest.mark.slow
def test_the_integral_of_the_spectrum_is_the_variance(logger: Logger, log_path: Path) -> None:
    logger.go_on(10.0)
    with LogMonitor(log_path) as watch:
        spectrum = sensor(watch.refresh(0.0), "Acc").spectrum
    assert spectrum is not None
    assert spectrum.frequency_hz[-1] == pytest.approx(50)
    power = spectrum.density.sum(axis=0) * spectrum.resolution_hz  # Parseval: a count squared, all of it at 50 Hz
    np.testing.assert_allclose(power, 1 / 2048**2, rtol=0.35)
    assert (spectrum.density.argmax(axis=0) == len(spectrum.frequency_hz) - 1).all()


@pytest.mark.slow
def test_sensors_of_a_quantity_are_fused_by_their_mean(logger: Logger, log_path: Path) -> None:
    logger.go_on(3.0)
    with LogMonitor(log_path) as watch:
        fused = watch.refresh(0.0).fused
    assert fused is not None and not fused.calibrated and fused.technique == "mean"
    np.testing.assert_allclose(fused.mean["specific_force"], np.array([0.25, -0.5, 1.0]) * GRAVITY, atol=5e-3)
    np.testing.assert_allclose(fused.mean["angular_rate"], np.radians([10.0, -5.0, 2.5]), atol=2e-4)
    swing = np.radians(0.02)  # a count of 0.01 dps up and down: neighbours differ by two
    np.testing.assert_allclose(fused.noise["angular_rate"], swing / math.sqrt(2), rtol=0.01)


def test_a_fused_file_of_the_log_is_shown_instead_of_the_mean(logger: Logger, log_path: Path) -> None:
    logger.go_on(3.0)
    time = np.arange(300, dtype=np.int64) * 10_000_000
    block = FusedBlock(time, {"angular_rate": np.tile([1.0, 2.0, 3.0], (300, 1))})
    fused_path = log_path.with_name("run_fused.h5")
    write_fused(fused_path, [block], epoch=EPOCH, technique="optimal", log="run.h5")
    with LogMonitor(log_path, span_s=2.0) as watch:
        fused = watch.refresh(0.0).fused
        assert fused is not None and fused.technique == "optimal"
        assert fused.mean["angular_rate"].tolist() == [1.0, 2.0, 3.0]
        assert fused.time[0] == 990_000_000
        write_fused(fused_path, [block], epoch="2020-01-01T00:00:00Z", technique="optimal", log="x.h5", force=True)
        other = watch.refresh(1.0).fused
        assert other is not None and other.technique == "mean"  # that file is of another log


@pytest.mark.slow
def test_a_fused_file_is_shown_while_it_is_written(logger: Logger, log_path: Path) -> None:
    logger.go_on(3.0)
    time = np.arange(300, dtype=np.int64) * 10_000_000
    with LiveFused(log_path.with_name("run_fused.h5"), epoch=EPOCH, technique="optimal", log="run.h5") as live:
        live.append(FusedBlock(time, {"angular_rate": np.tile([1.0, 2.0, 3.0], (300, 1))}))
        with LogMonitor(log_path, span_s=2.0) as watch:
            fused = watch.refresh(0.0).fused
    assert fused is not None and fused.technique == "optimal"
    assert fused.mean["angular_rate"].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.slow
def test_a_calibration_that_does_not_fit_is_reported(logger: Logger, log_path: Path) -> None:
    from imuarray.calibrate.model import nominal
    from imuarray.log import open_log

    logger.go_on(1.0)
    with open_log(log_path) as log:
        wrong = Calibration({"Acc": nominal(log["Gyro"])})
    with LogMonitor(log_path, calibration=wrong) as watch:
        seen = watch.refresh(0.0)
    assert seen.fused is None
    assert seen.not_fused == f"{log_path}, sensor Acc: calibrated as angular_rate in dps, logged as specific_force"
    assert len(seen.sensors) == 4


@pytest.mark.slow
def test_missed_frames_and_missed_readings_are_counted_separately(logger: Logger, log_path: Path) -> None:
    logger.go_on(5.0)
    logger.now_s += 0.05  # five frames
    logger.go_on(2.0)
    with LogMonitor(log_path, span_s=3.0) as watch:
        assert watch.refresh(0.0).missed == 5
        logger.go_on(0.1, without=("Gyro",))
        logger.go_on(2.0)
        seen = watch.refresh(1.0)
    assert (seen.missed, seen.delayed, seen.counted) == (5, 0, 1.0)
    assert [view.missed for view in seen.sensors] == [5, 5, 15, 0]
    assert seen.rate_hz == pytest.approx(100, rel=1e-3)


@pytest.mark.slow
def test_a_refresh_reads_only_new_rows(log_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that begins late does not read the journal from its start, but counts all rows, gaps and events."""
    monkeypatch.setattr(writing, "CHUNK", 256)
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        logger = Logger(writer)
        writer.begins(Phase(0, 1 << 60, "static"))
        writer.event(Event(1, "Acc", "lost", "no reading"))
        logger.go_on(20.0)
        logger.now_s += 0.03
        for _ in range(20):
            logger.go_on(1.0)
        decoded: list[int] = []
        from imuarray.log.journal import JournalReader

        whole = JournalReader.records

        def counted(self, start=None, newest_ns=None):  # type: ignore[no-untyped-def]
            for record in whole(self, start, newest_ns):
                decoded.append(record.rows)
                yield record

        monkeypatch.setattr(JournalReader, "records", counted)
        with LogMonitor(log_path, span_s=5.0) as watch:
            seen = watch.refresh(0.0)
            assert sum(decoded) < 3 * 1100
            decoded.clear()
            logger.go_on(1.0)
            seen = watch.refresh(1.0)
            assert sum(decoded) == 3 * 100 + 4
    assert [view.rows for view in seen.sensors] == [4100, 4100, 4100, 164]
    assert (seen.missed, seen.counted, seen.begins_ns) == (3, 1.0, 0)
    assert (dict(seen.events or {}), seen.problems, seen.phase) == ({"lost": 1}, 1, "static")
    assert len(sensor(seen, "Acc").time) == 501


@pytest.mark.parametrize("commits", some([1, 2, 64, 65, 66], 1))
def test_a_log_is_read_after_any_number_of_commits(
    log_path: Path, monkeypatch: pytest.MonkeyPatch, commits: int
) -> None:
    monkeypatch.setattr(writing, "CHUNK", 8)
    with LogWriter(log_path, HEADERS[:1], source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        for number in range(commits):
            writer.append("Acc", rows("Acc", number * 0.1, 0.1))
            writer.flush()
        with LogMonitor(log_path, span_s=0.1) as watch:
            seen = watch.refresh(0.0)
    assert (seen.state, seen.remark, seen.sensors[0].rows, seen.missed) == ("being written", "", 10 * commits, 0)


@pytest.mark.slow
def test_events_are_counted_and_the_last_are_kept(logger: Logger, log_path: Path) -> None:
    logger.go_on(0.5)
    with LogMonitor(log_path) as watch:
        watch.refresh(0.0)
        for number in range(KEPT + 20):
            logger.writer.event(Event(number, "Acc", "stale", f"number {number}"))
        logger.writer.event(Event(99, "Acc", "back", "answers again"))
        logger.writer.flush()
        seen = watch.refresh(1.0)
    assert dict(seen.events or {}) == {"stale": KEPT + 20, "back": 1}
    assert seen.problems == KEPT + 20
    assert len(seen.recent) == KEPT and seen.recent[0].kind == "back"


@pytest.mark.slow
def test_missed_frames_of_a_permanently_slow_machine_are_counted_from_events(logger: Logger, log_path: Path) -> None:
    """Its rows have a constant interval: only the events contain the count."""
    logger.go_on(4.0)
    why = "frames missed: the one before ended too late"
    for number, text in enumerate((f"3 {why}", "in all 40 frames missed in 2.1 s", f"2 {why}", "1 frame missed: so")):
        logger.writer.event(Event(number, "", "late", text))
    logger.writer.event(Event(9, "Acc", "late", f"7 {why}"))
    logger.writer.flush()
    with LogMonitor(log_path) as watch:
        seen = watch.refresh(0.0)
    assert (seen.missed, sensor(seen, "Acc").missed) == (43, 0)


@pytest.mark.slow
def test_missed_frames_are_counted_from_the_configured_frame_rate(log_path: Path) -> None:
    """A machine that needs 1.4 periods for every frame: its rows have a constant interval, and no event has counted the
    missed frames yet.
    """
    writer = LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH, frame_rate_hz=100.0)
    writer.keep()
    with writer, LogMonitor(log_path) as watch:
        for part in range(5):
            for name in ("Acc", "Turned", "Gyro"):
                writer.append(name, rows(name, part * 1.4, 1.4, 14_000_000))
            writer.flush()
            seen = watch.refresh(part)
            frames = 100 * (part + 1)
            assert (seen.frame_rate_hz, seen.rate_hz) == (100.0, pytest.approx(71.43, abs=0.01))
            assert seen.missed == pytest.approx((frames - 1) * 0.4, abs=1)
        fresh = LogMonitor(log_path)
        assert fresh.refresh(9.0).missed == seen.missed
        fresh.close()


def test_sensors_with_a_queue_or_a_low_rate_have_their_own_period(log_path: Path) -> None:
    with LogWriter(log_path, HEADERS, source="i2c", epoch=EPOCH, frame_rate_hz=50.0) as writer:
        writer.append("Acc", rows("Acc", 0.0, 4.0))  # at 100 Hz, with five of them missing
        writer.append("Acc", rows("Acc", 4.05, 2.0))
        writer.append("Turned", rows("Turned", 0.0, 6.0, 20_000_000))
        writer.append("Baro", rows("Baro", 0.0, 6.0, 250_000_000))
    with LogMonitor(log_path) as watch:
        seen = watch.refresh(0.0)
    views = {view.name: (view.framed, view.missed) for view in seen.sensors if view.rows}
    assert views == {"Acc": (False, 5), "Turned": (True, 0), "Baro": (False, 0)}


@pytest.mark.slow
def test_quiet_time_and_free_space_are_reported(logger: Logger, log_path: Path) -> None:
    logger.go_on(2.0)
    with LogMonitor(log_path) as watch:
        watch.refresh(10.0)
        seen = watch.refresh(17.5)
        assert (seen.state, seen.quiet_s) == ("being written", 7.5)
        logger.go_on(1.0)
        seen = watch.refresh(18.0)
        assert seen.quiet_s == 0
    disk = seen.disk
    assert disk is not None and disk.left_s is not None
    # time 8, counts 6, status 2, thermometer 2 bytes: at 100 Hz 18, 16 and 18; the barometer's 34 at 4 Hz; twice
    assert disk.bytes_per_s == pytest.approx(2 * (100 * (18 + 16 + 18) + 4 * 34), rel=1e-3)
    assert disk.left_s == pytest.approx((disk.free_bytes - (64 << 20)) / disk.bytes_per_s)


def test_the_end_of_a_log_is_shown_with_its_last_rows(log_path: Path) -> None:
    watch = LogMonitor(log_path)
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        logger = Logger(writer)
        logger.go_on(2.0)
        assert watch.refresh(0.0).state == "being written"
        logger.go_on(1.0)
    watch.refresh(1.0)
    ended = watch.refresh(2.0)
    again = watch.refresh(3.0)
    watch.close()
    assert (ended.state, again.state) == ("finished", "finished")
    assert sensor(ended, "Acc").rows == sensor(again, "Acc").rows == 300
    with LogMonitor(log_path) as late:
        fresh = late.refresh(0.0)
    assert (fresh.state, fresh.missed, sensor(fresh, "Acc").rows) == ("finished", 0, 300)
    np.testing.assert_allclose(sensor(fresh, "Acc").values, sensor(ended, "Acc").values)


@pytest.mark.slow
def test_a_new_log_of_the_same_name_starts_anew(log_path: Path) -> None:
    watch = LogMonitor(log_path)
    for number, seconds in enumerate((3.0, 1.0)):
        with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH, force=True) as writer:
            writer.keep()
            Logger(writer).go_on(seconds)
            for step in range(3):
                seen = watch.refresh(10.0 * number + step)
            assert (seen.state, sensor(seen, "Acc").rows) == ("being written", 100 * seconds)
    watch.close()


@pytest.mark.slow
def test_a_killed_logger_leaves_an_interrupted_log(log_path: Path) -> None:
    program = (
        "import sys, time; from pathlib import Path; from tests.monitor.conftest import *\n"
        "writer = LogWriter(Path(sys.argv[1]), HEADERS, source='emulated', epoch=EPOCH); writer.keep()\n"
        "Logger(writer).go_on(2.0); print('written', flush=True); time.sleep(60)\n"
    )
    root = Path(__file__).parents[2]
    child = subprocess.Popen(
        [sys.executable, "-c", program, str(log_path)], cwd=root, stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(root)},
    )  # fmt: skip
    try:
        assert child.stdout is not None and child.stdout.readline() == b"written\n"
        watch = LogMonitor(log_path)
        assert watch.refresh(0.0).state == "being written"
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait(60)
        child.stdout.close() if child.stdout else None
    snapshot = watch.refresh(1.0)
    assert (snapshot.state, sensor(snapshot, "Gyro").rows) == ("interrupted", 200)
    with LogMonitor(log_path) as late:
        fresh = late.refresh(0.0)
        assert (fresh.state, sensor(fresh, "Gyro").rows) == ("interrupted", 200)
    recover(log_path)
    finished = watch.refresh(2.0)
    watch.close()
    assert (finished.state, dict(finished.events or {})) == ("finished", {"recovered": 1})


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", some(["night_fused.h5", "night_00{part}_fused.h5", "elsewhere.h5", "elsewhere_00{part}.h5"], 1)
)
def test_the_fused_file_of_every_part_is_shown(tmp_path: Path, name: str) -> None:
    given = tmp_path / "elsewhere.h5" if name.startswith("elsewhere") else None
    results: dict[str, LiveFused] = {}
    writer = RotatingWriter(tmp_path / "night.h5", HEADERS, every_s=2.0, source="emulated", epoch=EPOCH)
    with writer, ExitStack() as stack:
        writer.keep()
        writer.starts(0)
        watch = stack.enter_context(LogMonitor(tmp_path / "night.h5", result=given))
        for second in range(4):
            for header in HEADERS[:3]:
                writer.append(header.name, rows(header.name, second, 1.0))
            writer.flush()
            path = name.format(part=1 + second // 2)
            if path not in results:
                fused = LiveFused(tmp_path / path, epoch=EPOCH, technique="opposed", log="night.h5")
                results[path] = stack.enter_context(fused)
            results[path].append(fused_rows(second, [0.0, 0.0, 1.0 + second]))
            seen = next(
                seen for step in range(9) if (seen := watch.refresh(step)).ends_ns == int((second + 0.99) * 1e9)
            )
            assert seen.fused is not None and seen.fused.technique == "opposed"
            np.testing.assert_allclose(seen.fused.mean["specific_force"], [0, 0, 1.0 + second], atol=0.02)
        assert seen.path.name == "night_002.h5"
        assert len(seen.fused.time) == 400 // len(results)


def fused_rows(start_s: int, force: list[float]) -> FusedBlock:
    """A second of one fused specific force."""
    at_ns = np.arange(100, dtype=np.int64) * 10_000_000 + start_s * 1_000_000_000
    name = "specific_force"
    columns = np.tile(force, (100, 1)), np.ones((100, 6)), np.ones((100, 6), np.uint8)
    triads, covariances, used = ({name: column} for column in columns)
    return FusedBlock(at_ns, triads, covariances, used)


@pytest.mark.slow
def test_a_log_in_parts_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "night.h5"
    watch = LogMonitor(path)
    names, total = [], 0
    with RotatingWriter(path, HEADERS, every_s=2.0, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        writer.starts(0)
        for second in range(5):
            for header in HEADERS:
                writer.append(
                    header.name, rows(header.name, second, 1.0, 250_000_000 if header.name == "Baro" else 10_000_000)
                )
            writer.flush()
            for _ in range(3):
                seen = watch.refresh(float(second))
            names.append(seen.path.name)
            total += 100
            assert (seen.state, sensor(seen, "Acc").rows, seen.missed) == ("being written", total, 0)
            assert len(sensor(seen, "Acc").time) == total  # the last seconds go on over the cut
    watch.close()
    assert sorted(set(names)) == [f"night_00{number}.h5" for number in (1, 2, 3)]
    assert seen.remark == "continues in night_003.h5"
    with LogMonitor(path) as late:
        assert late.refresh(0.0).path.name == "night_003.h5"
        assert late.refresh(1.0).remark == ""
    with LogMonitor(tmp_path / "night_001.h5") as first:  # no part is being written: the given part is shown
        assert first.refresh(0.0).path.name == "night_001.h5"


@pytest.mark.slow
def test_earlier_missed_frames_are_kept_in_the_next_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "CHUNK", 64)
    path = tmp_path / "night.h5"
    with RotatingWriter(path, HEADERS, every_s=5.0, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        writer.starts(0)
        with LogMonitor(path, span_s=0.5) as watch:
            for start_s, seconds in ((0.0, 0.7), (0.75, 0.75), (1.5, 1.5), (3.0, 1.5), (4.5, 1.5)):  # five are missing
                for header in HEADERS[:3]:
                    writer.append(header.name, rows(header.name, start_s, seconds))
                writer.flush()
                if start_s >= 3:
                    seen = next(seen for step in range(9) if (seen := watch.refresh(step)).counted == 1)
                    assert seen.missed == 5
            assert seen.path.name == "night_001.h5"
            seen = next(seen for step in range(500) if (seen := watch.refresh(step)).path.name == "night_002.h5")
            assert (seen.missed, seen.begins_ns) == (5, 0)


@pytest.mark.slow
def test_the_newest_part_of_a_running_log_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "night.h5"
    with RotatingWriter(path, HEADERS, every_s=1.0, source="emulated", epoch=EPOCH) as writer:
        writer.keep()
        writer.starts(0)
        for second in range(3):
            for header in HEADERS:
                writer.append(header.name, rows(header.name, second, 1.0))
        writer.flush()
        for asked in (path, tmp_path / "night_001.h5"):
            with LogMonitor(asked) as watch:  # the parts before may be being finished just now
                seen = next(seen for step in range(500) if (seen := watch.refresh(step)).path.name == "night_003.h5")
            assert (seen.path.name, seen.state) == ("night_003.h5", "being written")


@pytest.mark.slow
def test_a_part_of_another_recording_is_not_followed(tmp_path: Path) -> None:
    for number, epoch in ((1, EPOCH), (2, "2020-01-01T00:00:00Z")):
        with LogWriter(tmp_path / f"run_00{number}.h5", HEADERS, source="emulated", epoch=epoch) as writer:
            Logger(writer).go_on(1.0)
    with LogMonitor(tmp_path / "run_001.h5") as watch:
        assert watch.refresh(0.0).path.name == "run_001.h5"


def test_a_file_that_is_no_log_is_reported(tmp_path: Path, log_path: Path) -> None:
    log_path.write_bytes(b"no log at all")
    with LogMonitor(log_path) as watch:
        seen = watch.refresh(0.0)
        assert (seen.state, seen.sensors) == ("waiting", ())
        assert "is not an HDF5 file" in seen.remark
        log_path.unlink()
        with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
            Logger(writer).go_on(1.0)
        assert watch.refresh(1.0).state == "finished"
    shutil.rmtree(tmp_path)
    with LogMonitor(log_path) as gone:
        assert gone.refresh(0.0).state == "waiting"


@pytest.mark.slow
@pytest.mark.parametrize("frame_rate_hz", some([100.0, 0.0], 1))
def test_a_dead_sensor_is_shown_without_values(log_path: Path, frame_rate_hz: float) -> None:
    """A monitor from the start shows the same as one that starts late, or after the log is finished."""
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH, frame_rate_hz=frame_rate_hz) as writer:
        writer.keep()
        logger = Logger(writer)
        with LogMonitor(log_path) as along:
            for second in range(20):
                logger.go_on(1.0, without=("Turned",) if second >= 4 else ())
                seen = along.refresh(float(second))
        late = fully_counted(log_path)
    finished = fully_counted(log_path)
    assert [result.state for result in (seen, late, finished)] == ["being written", "being written", "finished"]
    for result in (seen, late, finished):
        dead = sensor(result, "Turned")
        assert dead.silent_s == pytest.approx(16.0)
        assert (dead.rows, dead.rate_hz, dead.missed, len(dead.time)) == (400, 0.0, 1600, 0)
        assert np.isnan(dead.mean).all() and np.isnan(dead.sd).all() and not dead.flags
        assert (result.missed, result.rate_hz, result.ends_ns) == (0, pytest.approx(100.0), 19_990_000_000)
        assert [view.silent_s for view in result.sensors if view.name != "Turned"] == [None, None, None]


def fully_counted(path: Path) -> Snapshot:
    """A snapshot of a monitor that starts late, after it has counted all rows."""
    with LogMonitor(path) as late:
        return next(seen for step in range(5) if (seen := late.refresh(float(step))).counted == 1.0)


def test_a_sensor_is_silent_after_a_second_and_returns(logger: Logger, log_path: Path) -> None:
    logger.go_on(4.0)
    with LogMonitor(log_path) as watch:
        watch.refresh(0.0)
        states = []
        for without in (("Gyro",), ("Gyro",), ("Gyro",), ()):
            logger.go_on(0.9, without=without)
            gyro = sensor(watch.refresh(1.0), "Gyro")
            states.append((gyro.silent_s, gyro.missed, bool(np.isfinite(gyro.mean).all())))
        assert states == [(None, 0, True), (1.8, 180, False), (2.7, 270, False), (None, 270, True)]


@pytest.mark.slow
def test_the_fused_noise_excludes_a_dead_sensor(logger: Logger, log_path: Path) -> None:
    """Its last rows were fused alone, long before those of the others, and made the scatter theirs."""
    with LogMonitor(log_path, span_s=2.0) as watch:
        logger.go_on(3.0)
        watch.refresh(0.0)
        logger.go_on(5.0, without=("Turned",))
        fused = watch.refresh(1.0).fused
    assert fused is not None
    assert fused.time[0] == 5_990_000_000
    np.testing.assert_allclose(fused.noise["specific_force"], GRAVITY * math.sqrt(2) / 2048, rtol=0.02)


def test_a_slow_sensor_is_not_silent_between_its_rows(log_path: Path) -> None:
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer:
        writer.append("Acc", rows("Acc", 0.0, 39.5))
        writer.append("Baro", rows("Baro", 0.0, 39.5, 2_000_000_000))
    with LogMonitor(log_path, span_s=20.0) as watch:
        baro = sensor(watch.refresh(0.0), "Baro")
    assert (baro.silent_s, baro.missed, baro.mean.tolist()) == (None, 0, [1002.5])


@pytest.mark.slow
def test_a_barometer_with_readings_buffered_by_the_logger_is_not_silent(log_path: Path) -> None:
    """The logger writes a row after the check that the sensor is not frozen: 24 readings of 4 Hz are six seconds."""
    seen = []
    with LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH) as writer, LogMonitor(log_path) as watch:
        writer.keep()
        for acc_s, seconds, baro_s in ((0, 5.9, 0), (5.9, 13.9, 14), (19.8, 1, 0)):
            if baro_s:
                writer.append("Baro", rows("Baro", 0.0, baro_s, 250_000_000))
            writer.append("Acc", rows("Acc", acc_s, seconds))
            writer.flush()
            seen.append(watch.refresh(acc_s))
    begin, held, dead = seen
    assert sensor(begin, "Baro").silent_s is None
    assert (sensor(held, "Baro").silent_s, sensor(held, "Baro").missed) == (None, 0)
    assert np.isfinite(sensor(held, "Baro").mean).all()
    assert sensor(dead, "Baro").silent_s == pytest.approx(7.04)


def test_the_monitor_waits_longer_than_the_logger_buffers_readings() -> None:
    assert composition._HELD_PERIODS > sample_buffer._FROZEN_READINGS
    assert composition._HELD_BANDWIDTHS >= sample_buffer._FROZEN_BANDWIDTHS
    assert composition._HELD_NS * 1e-9 > sample_buffer.HELD_S


@pytest.mark.slow
def test_a_sensor_without_rows_is_shown_without_values(logger: Logger, log_path: Path) -> None:
    logger.go_on(2.0, without=("Acc", "Baro"))
    with LogMonitor(log_path) as watch:
        seen = watch.refresh(0.0)
    silent = sensor(seen, "Acc")
    assert (silent.rows, silent.rate_hz, silent.use, silent.spectrum) == (0, 0.0, None, None)
    assert np.isnan(silent.mean).all()
    assert seen.fused is not None
    assert sensor(seen, "Baro").rows == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "error", some([OSError("gone"), RuntimeError("Unable to read"), KeyError("commits"), ValueError("x")], 1)
)
def test_a_file_that_changes_during_a_read_is_read_again(
    logger: Logger, log_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """As when a log is being finished: the page reports it, and continues at the next refresh."""
    logger.go_on(1.0)
    with LogMonitor(log_path) as watch:
        assert len(watch.refresh(0.0).sensors) == 4
        with monkeypatch.context() as patch:

            def fail(self: object) -> int:
                raise error

            patch.setattr("imuarray.monitor.log_source.Growing.read", fail)
            spoilt = watch.refresh(1.0)
        assert (spoilt.state, spoilt.sensors) == ("waiting", ())
        assert spoilt.remark.startswith(str(log_path))
        assert len(watch.refresh(2.0).sensors) == 4
