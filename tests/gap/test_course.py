"""Intervals of windows whose statistics differ from those of the rest."""

from __future__ import annotations

import tracemalloc
from collections.abc import Hashable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.recording import course
from imuarray.gap.recording.course import changes, stretches_of
from imuarray.log import Block
from imuarray.log.format import Phase, SensorHeader


def test_a_sensor_stuck_for_most_windows_has_no_interval() -> None:
    """Without scatter the significance of a difference is unknown; the other statistic still has it."""
    statistics = np.zeros((40, 2))
    statistics[:5, 0] = 0.1
    assert not list(changes(statistics, np.zeros(2)))
    statistics[:, 1] = np.random.default_rng(3).normal(0, 1, 40)
    statistics[10:20, 1] += 30
    (change,) = changes(statistics, np.zeros(2))
    assert np.flatnonzero(change.inside).tolist() == list(range(10, 20))


def test_normal_windows_within_an_interval_are_excluded() -> None:
    """Windows 10 to 19 and 23 to 34 of 40 are higher: the clearest interval is from 10 to 34, with three normal windows
    in it.
    """
    statistics = np.random.default_rng(3).normal(0, 1, (40, 1))
    statistics[10:35] += 20
    statistics[20:23] -= 20
    first, *_ = changes(statistics, np.zeros(1))
    assert np.flatnonzero(first.inside).tolist() == [*range(10, 20), *range(23, 35)]


@pytest.mark.parametrize(("windows", "columns"), [(4, 1), (9, 11), (64, 3), (200, 2)])
@pytest.mark.parametrize("step", [0.0, 1.0, 20.0])
def test_compiled_code_and_numpy_give_the_same_intervals(
    windows: int, columns: int, step: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where no statistic scatters, so that many intervals explain it equally well."""
    statistics = np.random.default_rng(windows).normal(0, 1, (windows, columns))
    statistics[windows // 3 : windows // 2 + 1] += step
    for values in (statistics, np.where(statistics > step / 2, step, 0.0)):
        kinds = []
        for is_compiled in (course.COMPILED, False):
            monkeypatch.setattr(course, "COMPILED", is_compiled)
            kinds.append([(kind.inside.tolist(), kind.nats) for kind in changes(values, np.full(columns, 0.1))])
        assert kinds[0] == kinds[1]


RATE_HZ = 50.0


def line_source(rows: int, seed: int, amplitude_lsb: float = 0.0, from_row: int = 0) -> MemorySource:
    """Noise of 10 counts, and a line of 11.3 Hz from a row on."""
    time_s = np.arange(rows) / RATE_HZ
    counts = np.random.default_rng(seed).normal(0, 10, (rows, 3))
    counts[from_row:, 1] += amplitude_lsb * np.sin(2 * np.pi * 11.3 * time_s[from_row:])
    return MemorySource(np.rint(time_s * 1e9).astype(np.int64), np.rint(counts).astype(np.int16))


class MemorySource:
    """Rows in memory, as a source."""

    def __init__(self, time_ns: npt.NDArray[np.int64], counts: npt.NDArray[np.int16]) -> None:
        self.header = SensorHeader("G1", "l3g4200d", "angular_rate", "dps", 250.0, 114.3)
        self.cache: dict[Hashable, Any] = {}
        self._time_ns, self._counts = time_ns, counts

    def rows(self, start_ns: int, end_ns: int) -> int:
        return int(np.count_nonzero((self._time_ns >= start_ns) & (self._time_ns < end_ns)))

    def blocks(self, start_ns: int, end_ns: int) -> Iterator[Block]:
        inside = (self._time_ns >= start_ns) & (self._time_ns < end_ns)
        yield Block(self._time_ns[inside], self._counts[inside], np.zeros(int(inside.sum()), np.uint16))


def lines_on(source: MemorySource, rows: int) -> list[tuple[float, float]]:
    phase = Phase(0, round(rows / RATE_HZ * 1e9), "static", "+Z")
    return [stretches[0] for stretches in stretches_of(source, [phase]) if len(stretches) == 1]


def test_a_faint_line_from_a_moment_on_is_detected() -> None:
    """4 counts in a noise of 10: a window of 64 rows has an amplitude of noise of 1.8, and 2600 rows gain 104 nats,
    twice the gain of a line in all 5200 rows.
    """
    for seed in (1, 2, 3):
        (*_, (begin_s, end_s)) = lines_on(line_source(5200, seed, 4.0, 2600), 5200)
        assert begin_s == pytest.approx(52.0, abs=8.0)
        assert end_s == np.inf


@pytest.mark.slow
def test_a_permanent_line_and_noise_have_no_interval() -> None:
    """In one of twenty logs at most: of 60 logs of each kind 6 or more have an interval with a probability of 0.03."""
    assert sum(bool(lines_on(line_source(5200, seed, 3.0), 5200)) for seed in range(60)) <= 5
    assert sum(bool(lines_on(line_source(5200, seed), 5200)) for seed in range(60)) <= 5


@pytest.mark.slow
def test_a_long_phase_needs_little_memory() -> None:
    """A line in the second half of 400,000 rows: 64 windows have 2000 intervals, and windows of 64 rows 20 million."""
    source = line_source(400_000, 1, 1.0, 200_000)
    tracemalloc.start()
    (*_, (begin_s, end_s)) = lines_on(source, 400_000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert begin_s == pytest.approx(4000.0, abs=300.0)
    assert end_s == np.inf
    assert peak < 300e6
