"""Delays of the host: a poll loop in a few lines, whose waits are known, is the other derivation."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import pytest

from imuarray.log import Block, Log, LogWriter, open_log
from imuarray.log.format import LOST_BEFORE, SensorHeader
from imuarray.simulate.host_latency import DelayedTimes, find_delays
from imuarray.simulate.timeline import GapFilledTimes, Timeline, filled
from tests.selection import some

PERIOD_NS = 15_625_000
BURST_NS = 240_000
FRAMES = 400
MS = 1_000_000

Waits = Mapping[tuple[int, int], int]
"""ns that the host waits before the burst of a sensor in a frame, by (frame that is read, sensor)."""


def recorded(path: Path, sensors: int, waits: Waits, *, without: Collection[tuple[int, int]] = ()) -> Log:
    """Frames on a grid, sensors there and back, each burst after the one before; a frame that ends too late costs those
    whose time has passed. Stamps are the middle of the time in which a burst may have begun. `without` are readings
    that fail alone.
    """
    rows: list[list[tuple[int, int]]] = [[] for _ in range(sensors)]
    missing = [False] * sensors
    now = due = 0
    for frame in range(FRAMES):
        now = max(now, due)
        for sensor in range(sensors) if frame % 2 == 0 else reversed(range(sensors)):
            wait = waits.get((frame, sensor), 0)
            if (frame, sensor) in without:
                missing[sensor] = True
            else:
                rows[sensor].append((now + wait // 2, LOST_BEFORE if missing[sensor] else 0))
                missing[sensor] = False
            now += wait + BURST_NS
        due += PERIOD_NS
        if passed := max(now - due, 0) // PERIOD_NS:
            due += passed * PERIOD_NS
            missing = [True] * sensors
    headers = [
        SensorHeader(f"A{at}", "bma180", "specific_force", "g", 4.0, 2048.0, rate_hz=2400.0) for at in range(sensors)
    ]
    with LogWriter(path, headers, source="emulated", epoch="2024-01-01T00:00:00Z", force=True) as log:
        for header, own in zip(headers, rows, strict=True):
            times, status = (np.array(column) for column in zip(*own, strict=True))
            counts = np.zeros((len(own), 3), np.int16)
            log.append(header.name, Block(times.astype(np.int64), counts, status.astype(np.uint16)))
    return open_log(path)


def lines_of(log: Log) -> dict[str, Timeline]:
    return find_delays({name: filled(sensor) for name, sensor in log.sensors.items()}, log.sensors)


def halves_of(line: Timeline) -> dict[int, int]:
    """Half of each wait, by row."""
    assert isinstance(line, DelayedTimes)
    halves, _ = line.waits(0, line.rows)
    return {int(row): int(halves[row]) for row in np.flatnonzero(halves)}


@pytest.mark.parametrize("sensors", some([2, 3, 5], 2))
def test_waits_are_recovered(tmp_path: Path, sensors: int) -> None:
    """Before the first, the last or any sensor of a frame, one in a frame, and so that no frame is missed."""
    rng = np.random.default_rng(sensors)
    frames = rng.choice(np.arange(2, FRAMES, 4), 40, replace=False).tolist()
    waits = {(frame, int(rng.integers(sensors))): int(rng.integers(MS, 12 * MS)) for frame in frames}
    with recorded(tmp_path / "log.h5", sensors, waits) as log:
        lines = lines_of(log)
        for at in range(sensors):
            wanted = {frame: wait // 2 for (frame, sensor), wait in waits.items() if sensor == at}
            assert halves_of(lines[f"A{at}"]) == pytest.approx(wanted, abs=2)


def test_two_waits_in_one_frame_are_recovered(tmp_path: Path) -> None:
    with recorded(tmp_path / "log.h5", 5, {(100, 1): 3 * MS, (100, 3): 4 * MS, (201, 4): 2 * MS, (201, 0): MS}) as log:
        result = [halves_of(line) if isinstance(line, DelayedTimes) else {} for line in lines_of(log).values()]
        assert result == [
            {201: pytest.approx(MS // 2)},
            {100: pytest.approx(1.5 * MS)},
            {},
            {100: pytest.approx(2 * MS)},
            {201: pytest.approx(MS)},
        ]


def test_frames_missed_by_a_wait_are_lost_by_every_sensor(tmp_path: Path) -> None:
    """A wait of three periods before A2 costs two frames, of every sensor; a row lost only by A1 is its own loss."""
    lost_alone = [(250, 1), (251, 1)]
    with recorded(tmp_path / "log.h5", 3, {(100, 2): 3 * PERIOD_NS}, without=lost_alone) as log:
        lines = lines_of(log)
        for name, line in lines.items():
            assert isinstance(line, DelayedTimes)
            assert isinstance(line.own, GapFilledTimes)
            _, missed = line.waits(0, line.rows)
            own = log[name]
            at = int(np.searchsorted(np.asarray(own.time), 100 * PERIOD_NS + 10 * MS))
            assert set(np.flatnonzero(missed)) <= set(range(at, at + 4))
            assert 1 <= missed.sum() <= 2
        lost = lines["A1"]
        assert lost.rows - len(log["A1"]) >= 3  # these and its own
        assert halves_of(lines["A2"]) == {100: pytest.approx(1.5 * PERIOD_NS)}


def test_rows_after_a_hole_are_numbered_as_in_the_filled_line(tmp_path: Path) -> None:
    with recorded(tmp_path / "log.h5", 3, {(300, 1): 4 * MS}, without=[(50, 1), (60, 1)]) as log:
        line = pickle.loads(pickle.dumps(lines_of(log)["A1"]))  # noqa: S301
        assert (line.rows, line.rows_per_s) == (FRAMES, pytest.approx(1e9 / PERIOD_NS, rel=1e-3))
        assert halves_of(line) == {300: pytest.approx(2 * MS)}
        halves, missed = line.waits(298, 302)
        assert halves.tolist() == [0, 0, pytest.approx(2 * MS), 0]
        assert not missed.any()
        np.testing.assert_array_equal(line.stamps(298, 302), log["A1"].time[296:300])


def test_a_host_in_time_gives_no_delays(tmp_path: Path) -> None:
    """Nor does a sensor alone, for any times."""
    with recorded(tmp_path / "log.h5", 4, {}) as log:
        assert not any(isinstance(line, DelayedTimes) for line in lines_of(log).values())
    with recorded(tmp_path / "one.h5", 1, {(100, 0): 5 * MS}) as log:
        assert not any(isinstance(line, DelayedTimes) for line in lines_of(log).values())
