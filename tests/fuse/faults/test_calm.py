"""The fast path for normal windows decides like the full path."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imuarray.fuse import Frames
from imuarray.fuse.faults import FaultMonitor
from imuarray.fuse.faults.fault_isolation import FaultIsolation
from tests.fuse.faults.conftest import QUANTITIES, Floats, Run, faulty, simulated, watched
from tests.selection import some


def offended(values: Floats, run: Run) -> None:
    """A sensor with an error for three seconds, a drifting sensor, a stuck sensor, and a noisy axis."""
    values[400:700, 4] += 12 * run.noise[4]
    values[900:, 7] += 25 * run.noise[7] * np.clip((np.arange(len(values) - 900)) / 300, 0, 1)
    values[1500:1600, 0:3] = values[1500, 0:3]
    values[2000:2100, 5] += np.random.default_rng(1).normal(0, 8 * run.noise[5], 100)


def cases(quantity: str) -> dict[str, tuple[Run, Frames]]:
    rest, shaken = simulated("static", 25.0)[quantity], simulated("motion", 25.0)[quantity]
    gaps = rest.frames.valid.copy()
    gaps[700:730, 3:6] = False
    return {
        "at rest": (rest, rest.frames),
        "in motion": (shaken, shaken.frames),
        "readings are missing": (rest, replace(rest.frames, valid=gaps)),
        "faults at rest": (rest, faulty(rest, lambda values: offended(values, rest))),
        "faults in motion": (shaken, faulty(shaken, lambda values: offended(values, shaken))),
    }


COMPILED = importlib.util.find_spec("imuarray.fuse.faults._windows") is not None


@pytest.mark.skipif(not COMPILED, reason="installed without a C compiler")
@pytest.mark.parametrize(
    "case", some(["at rest", "in motion", "readings are missing", "faults at rest", "faults in motion"], 1)
)
@pytest.mark.parametrize("quantity", some(QUANTITIES, 1))
def test_fast_and_full_paths_exclude_and_learn_the_same(
    quantity: str, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, fed = cases(quantity)[case]
    passed: list[int] = []
    advance = FaultIsolation.advance

    def counted(*given: Any) -> int:
        passed.append(advance(*given))
        return passed[-1]

    with monkeypatch.context() as patch:
        patch.setattr(FaultIsolation, "advance", counted)
        monitor = run.monitor()
        whole, events = watched(monitor, fed)
    with monkeypatch.context() as patch:
        patch.setattr(FaultIsolation, "stretch", lambda *_: None)
        long = run.monitor()
        wanted, observable = watched(long, fed)
    assert sum(passed) > 30
    assert (whole.valid == wanted.valid).all()
    for event, other in zip(events, observable, strict=True):
        same = {"size_si": other.size_si, "significance": other.significance}
        assert replace(event, **same) == other
        assert [event.size_si, event.significance] == pytest.approx(list(same.values()), rel=1e-6)
    ours, theirs = learnt(monitor), learnt(long)
    for name in ours:
        scale = np.abs(theirs[name]).max()
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-9, atol=1e-11 * scale, err_msg=name)


def test_columns_may_be_contiguous_in_memory() -> None:
    """Like frames that are a slice of a table."""
    run = simulated("static", 25.0)["specific_force"]
    usual, turned = run.monitor(), run.monitor()
    watched(usual, run.frames)
    watched(turned, replace(run.frames, values=np.asfortranarray(run.frames.values)))
    for name, wanted in learnt(usual).items():
        np.testing.assert_array_equal(learnt(turned)[name], wanted, err_msg=name)


@pytest.mark.skipif(not COMPILED, reason="installed without a C compiler")
def test_compiled_windows_refuse_arrays_of_another_size() -> None:
    from imuarray.fuse.faults._windows import advance

    arrays = tuple(np.zeros(1) for _ in range(24))
    with pytest.raises(ValueError, match="array 0: 90 numbers of double precision"):
        advance(arrays, (1, 10, 9, 0, 1, 0, 1), (0.0,) * 14)
    with pytest.raises(ValueError, match="another number of arrays"):
        advance(arrays[1:], (1, 10, 9, 0, 1, 0, 1), (0.0,) * 14)
    assert advance(arrays, (1, 10, 8, 0, 1, 0, 1), (0.0,) * 14) == 0  # 8 axes are not triads


def learnt(monitor: FaultMonitor) -> dict[str, Floats]:
    """The normal model that the monitor has learnt."""
    normal = monitor._isolation._normal
    return {name: getattr(normal, name) for name in ("state", "covariance", "colour", "change", "variance")}


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="installed without a C compiler")
@pytest.mark.parametrize(
    ("kind", "sensors"),
    some([("static", ("Gyro1",)), ("motion", ("Gyro1",)), ("static", ("Gyro1", "Gyro2", "Gyro3"))], 1),
    ids=["one at rest", "one in motion", "two of three left out"],
)
def test_fast_and_full_paths_learn_the_same_without_redundancy(
    kind: str, sensors: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One triad alone, and three triads of which the third steps away and the second is stuck, then has an error."""
    run = simulated(kind, 25.0)["angular_rate"].only(*sensors)
    values = run.frames.values.copy()
    values[400:, 6:] += 40 * run.noise[6:]
    values[900:, 3:6] += 40 * run.noise[3:6]
    values[800:900, 3:6] = values[800, 3:6]
    fed = replace(run.frames, values=values)

    def judged() -> tuple[FaultMonitor, Frames, list[tuple[int, str, str]], int]:
        calls: list[int] = []
        judge = FaultIsolation.__call__
        with monkeypatch.context() as patch:
            patch.setattr(FaultIsolation, "__call__", lambda *given: (calls.append(1), judge(*given)))
            monitor = run.monitor()
            whole, events = watched(monitor, fed)
        return monitor, whole, [(event.time_ns, event.sensor, event.state) for event in events], len(calls)

    monitor, whole, events, long_ones = judged()
    with monkeypatch.context() as patch:
        patch.setattr(FaultIsolation, "stretch", lambda *_: None)
        long, wanted, other_events, windows = judged()
    assert (whole.valid == wanted.valid).all()
    assert events == other_events
    assert any(state == "no redundancy" for *_, state in events) == (len(sensors) > 1)
    assert long_ones < windows / 2
    ours, theirs = learnt(monitor), learnt(long)
    for name in ours:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-6, atol=1e-12, err_msg=name)


@pytest.mark.skipif(not COMPILED, reason="installed without a C compiler")
def test_most_windows_at_rest_take_the_fast_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise it has no use: of 250 windows those of the first seconds, in which noise is learnt, and few others take
    the full path.
    """
    run, calls = simulated("static", 25.0)["specific_force"], []
    judge = FaultIsolation.__call__
    monkeypatch.setattr(FaultIsolation, "__call__", lambda *given: (calls.append(1), judge(*given)))
    watched(run.monitor(), run.frames)
    assert len(calls) < 25


@pytest.mark.skipif(not COMPILED, reason="installed without a C compiler")
def test_compiled_windows_end_before_an_axis_that_has_drifted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The recorded start of an axis is lowered by half a g, which is more than any drift. The full path decides about
    it at the next check, in the same window whether or not the windows before it are compiled.
    """
    run = simulated("static", 25.0)["specific_force"]
    middle, by_way = len(run.frames.time) // 2, []
    for compiled in (True, False):
        with monkeypatch.context() as patch:
            if not compiled:
                patch.setattr(FaultIsolation, "stretch", lambda *_: None)
            monitor = run.monitor()
            monitor(run.frames.part(slice(middle)))
            state = monitor._isolation._baseline._state
            assert state is not None
            assert not monitor.events
            state[4, 0] -= 5.0
            monitor(run.frames.part(slice(middle, None)))
            by_way.append([(event.time_ns, event.axes, event.state) for event in monitor.events])
    assert by_way[0]
    assert by_way[0] == by_way[1]
