"""A campaign simulated again without a bench: whole, or some of its logs."""

from __future__ import annotations

import numpy as np

from imuarray.gap.model.replication import Stage
from imuarray.simulate import Motion
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.still import Still
from tests.gap.test_bench import prepared


def test_only_the_logs_that_are_wanted_are_simulated() -> None:
    logs: list[tuple[str, Motion]] = [("static", Still(seconds=5)), ("motion", HandShake(still_s=2, motion_s=2))]
    bench, _ = prepared(logs, ["G1", "G2"])
    stage = Stage(bench.kinds, bench.split, bench.layouts, bench.experiments, bench.base)
    whole, (part,) = stage.simulated(stage.models(), 0), stage.campaigns([(stage.models(), 0)], logs=[1])
    assert [len(log.phases) for log in part.logs] == [0, len(whole.logs[1].phases)]
    for one, other in zip(whole.logs[1].phases, part.logs[1].phases, strict=True):
        np.testing.assert_array_equal(one.sensors["G1"].segments.mean, other.sensors["G1"].segments.mean)
