"""A campaign simulated again without a bench: whole, or some of its logs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from imuarray.gap.model import replication
from imuarray.gap.model.replication import Models, RememberedMotion, SensorModel, Stage
from imuarray.gap.recording.recordings import Experiment
from imuarray.gap.statistics import campaign
from imuarray.gap.statistics.campaign import LogSummary
from imuarray.simulate import Motion
from imuarray.simulate.effects.noise import Tone
from imuarray.simulate.effects.readings import ChannelSwap
from imuarray.simulate.motion.faces import Still
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.sensor import Chunk, SimulatedSensor
from imuarray.simulate.streams import DrawMemory
from tests.gap.small_bench import prepared


def test_only_the_requested_logs_are_simulated() -> None:
    logs: list[tuple[str, Motion]] = [("static", Still(seconds=5)), ("motion", HandShake(still_s=2, motion_s=2))]
    bench, _ = prepared(logs, ["G1", "G2"])
    stage = Stage(bench.kinds, bench.split, bench.layouts, bench.experiments, bench.base)
    whole, (part,) = stage.simulated(stage.models(), 0), stage.campaigns([(stage.models(), 0)], logs=[1])
    assert [len(log.phases) for log in part.logs] == [0, len(whole.logs[1].phases)]
    for one, other in zip(whole.logs[1].phases, part.logs[1].phases, strict=True):
        np.testing.assert_array_equal(one.sensors["G1"].segments.mean, other.sensors["G1"].segments.mean)


def test_long_logs_are_simulated_few_at_a_time() -> None:
    """Ten million rows in one job, and eight replicates at most; one of two sensors of 2 million rows has 4 million."""
    short, _ = prepared([("static", Still(seconds=20))], ["G1", "G2"])
    assert short.together == 8
    plan, motion, *_ = short.experiments[0]
    rows = [SimpleNamespace(rows=2_000_000)] * 2
    sensors = {name: (header, line) for (name, (header, _)), line in zip(plan.sensors.items(), rows, strict=True)}
    long = replace(short, experiments=(Experiment(replace(plan, sensors=cast(Any, sensors)), motion),))
    assert long.together == 2
    assert replace(long, experiments=long.experiments * 9).together == 1


def test_only_the_rows_of_a_training_part_are_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three phases of 200 s or less, of which each has its first half in the training part, in a log of four chunks;
    chunks would be three quarters more.
    """
    bench, _ = prepared([("motion", HandShake(still_s=400, motion_s=20))], ["G1"])
    stage = Stage(bench.kinds, bench.split, bench.layouts, bench.experiments, bench.base)
    (phases,) = bench.split.phases(False)
    simulated: list[int] = []
    evaluate = SimulatedSensor._evaluate

    def count(self: SimulatedSensor, begin: int, end: int, swapped: bool = True) -> Chunk:
        simulated.append(end - begin)
        return evaluate(self, begin, end, swapped)

    monkeypatch.setattr(SimulatedSensor, "_evaluate", count)
    stage.simulated(stage.models(), 0, held_out=False)
    used = sum((phase.end_ns - phase.start_ns) * 1e-9 for phase in phases) * 100
    assert sum(simulated) == pytest.approx(used, abs=2 * len(phases))


@pytest.mark.slow
def test_exchanged_sensors_read_the_recorded_levels_of_each_other() -> None:
    """Scale and misalignment are drawn for each replicate, some hundredths of g; the level of either was recorded.

    Before the exchange a replicate has the recorded level, afterwards that of the other: to a tenth of the scatter of
    the levels of replicates without an exchange.
    """
    bench, recorded_campaign = prepared([("static", Still(seconds=40))], ["A1", "A2"])
    stage = Stage(bench.kinds, bench.split, bench.layouts, bench.experiments, bench.base)
    spans = {"spans": (0.0, 20.0, 1e9)}
    swaps = {
        "A1": SensorModel(bench.base.fitted["A1"], (ChannelSwap(**spans, sensor="A2"),)),
        "A2": SensorModel(bench.base.fitted["A2"], (ChannelSwap(**spans, sensor="A1"),)),
    }

    def levels(models: Models, sensor: str) -> np.ndarray:
        """(8, 2, 3) mean counts of replicates in the first and in the last 10 s."""
        logs = (stage.simulated(models, number).logs[0] for number in range(8))
        means = np.array([np.concatenate([part.sensors[sensor].segments.mean for part in log.phases]) for log in logs])
        quarter = means.shape[1] // 4
        return np.stack([means[:, :quarter].mean(axis=1), means[:, -quarter:].mean(axis=1)], axis=1)

    recorded = {
        name: np.mean(
            [part.sensors[name].segments.mean.mean(axis=0) for part in recorded_campaign.logs[0].phases], axis=0
        )
        for name in swaps
    }
    usual = levels(stage.models(), "A1").std(axis=0).max()
    exchanged = levels(swaps, "A1")
    assert usual > 10.0
    np.testing.assert_allclose(exchanged[:, 0], np.tile(recorded["A1"], (8, 1)), atol=0.2 * usual)
    np.testing.assert_allclose(exchanged[:, 1], np.tile(recorded["A2"], (8, 1)), atol=0.2 * usual)


def test_the_stimulus_is_cached_for_each_owner() -> None:
    """Read-only, for any number of requests, without another call of the motion."""
    times = np.arange(0, 5_000_000_000, 10_000_000)
    calls = []

    class Counted(Still):
        def stimulus(self, time_ns: Any) -> Any:
            calls.append(len(time_ns))
            return super().stimulus(time_ns)

    memory = DrawMemory(1 << 20)
    first, other = (RememberedMotion(Counted(seconds=5), memory, owner) for owner in (0, (0, 1)))
    for _ in range(3):
        np.testing.assert_array_equal(first.stimulus(times).force_box, Still(seconds=5).stimulus(times).force_box)
    assert (first.seconds, first.phases) == (5, Still(seconds=5).phases)
    assert not first.stimulus(times).temperature_degc.flags.writeable
    first.stimulus(times[:10])
    other.stimulus(times)
    assert calls == [500, 10, 500]


@pytest.mark.slow
def test_replicates_do_not_depend_on_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, _ = prepared([("static", Still(seconds=20)), ("motion", HandShake(still_s=2, motion_s=2))], ["G1", "G2"])
    stage = Stage(bench.kinds, bench.split, bench.layouts, bench.experiments, bench.base)
    remembered = [stage.simulated(stage.models(), number) for number in (0, 1, 0)][-1]
    monkeypatch.setattr(replication, "_MEMORY_BYTES", 0)
    alone = replace(stage).simulated(stage.models(), 0)
    for log, other in zip(remembered.logs, alone.logs, strict=True):
        for phase, other_phase in zip(log.phases, other.phases, strict=True):
            for name, summary in phase.sensors.items():
                np.testing.assert_array_equal(summary.segments.mean, other_phase.sensors[name].segments.mean)
                np.testing.assert_array_equal(summary.segments.fourth, other_phase.sensors[name].segments.fourth)


@pytest.mark.slow
def test_other_sensors_are_simulated_only_where_the_box_moves() -> None:
    """Those of a quantity are compared with a single sensor in motion only, as they are in a replicate of all."""
    bench, _ = prepared([("static", Still(seconds=5)), ("motion", HandShake(still_s=2, motion_s=2))], ["G1", "G2"])
    whole = bench.simulated(bench.models(), 3)
    alone = bench.simulated({"G1": bench.models()["G1"]}, 3)
    for log, other_log in zip(whole.logs, alone.logs, strict=True):
        for phase, other in zip(log.phases, other_log.phases, strict=True):
            assert set(other.sensors) == ({"G1"} if phase.is_still else {"G1", "G2"})
            for name, summary in other.sensors.items():
                np.testing.assert_array_equal(summary.segments.mean, phase.sensors[name].segments.mean)
            if phase.cross is not None and not phase.is_still:
                assert other.cross is not None
                np.testing.assert_array_equal(other.cross.fast, phase.cross.fast)


def test_the_motion_alone_equals_that_of_the_whole_campaign() -> None:
    bench, _ = prepared([("static", Still(seconds=5)), ("motion", HandShake(still_s=2, motion_s=2))], ["G1", "G2"])
    whole, (motion,) = bench.simulated(bench.models(), 1), bench.motion_replicates([(bench.models(), 1)])
    assert [len(log.phases) for log in motion.logs] == [0, 2]  # both halves of the only motion
    moving = [phase for phase in whole.logs[1].phases if not phase.is_still]
    for phase, other in zip(moving, motion.logs[1].phases, strict=True):
        assert phase.cross is not None
        assert other.cross is not None
        np.testing.assert_array_equal(other.cross.turning, phase.cross.turning)


def test_logs_unchanged_by_a_hypothesis_are_simulated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line in the second of two logs does not change the first; the replicate is that of a stage without a cache."""
    bench, _ = prepared([("static", Still(seconds=5)), ("static", Still(seconds=5))], ["G1", "G2"])
    stages = [Stage(bench.kinds, bench.split, bench.layouts, bench.experiments, bench.base) for _ in range(2)]
    calls: list[str] = []
    summarise = campaign.summarise_logs

    def counted(kind: str, *rest: Any) -> list[LogSummary]:
        calls.append(kind)
        return summarise(kind, *rest)

    monkeypatch.setattr(replication, "summarise_logs", counted)

    def models(amplitude: float) -> Models:
        line = Tone((amplitude, 0.0, 0.0), 3.0, spans=(1.0, 0.0, 1e9))
        return {"G1": replace(bench.models()["G1"], added=(line,))}

    for amplitude in (0.1, 0.2):
        remembered = stages[0].simulated(models(amplitude), 0)
    assert len(calls) == 3
    for log, other in zip(remembered.logs, stages[1].simulated(models(0.2), 0).logs, strict=True):
        for phase, other_phase in zip(log.phases, other.phases, strict=True):
            np.testing.assert_array_equal(phase.sensors["G1"].segments.mean, other_phase.sensors["G1"].segments.mean)
