"""A campaign simulated again without a bench: whole, or some of its logs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from imuarray.gap.model.replication import Stage
from imuarray.gap.recording.recordings import Experiment
from imuarray.simulate import Motion
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.still import Still
from tests.gap.small_bench import prepared


def test_only_the_logs_that_are_wanted_are_simulated() -> None:
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
