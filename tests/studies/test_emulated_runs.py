"""The recordings of the demonstration do not depend on the number of processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.log import open_log
from imuarray.shipped import find_config
from imuarray.studies.emulated_runs import RUNS, DemoOptions, record_all


@pytest.mark.slow
def test_two_processes_record_the_same_as_one(tmp_path: Path) -> None:
    logs: list[dict[str, Path]] = []
    told: list[str] = []
    for workers in (1, 2):
        (folder := tmp_path / str(workers)).mkdir()
        options = DemoOptions(seconds=100.0, seed=3, workers=workers)
        logs.append(record_all(find_config(Path("martin2013")), folder, options, told.append))
    assert list(logs[0]) == list(logs[1]) == list(RUNS)
    assert told[:4] == told[4:]
    for run in RUNS:
        with open_log(logs[0][run]) as alone, open_log(logs[1][run]) as beside:
            assert alone.phases == beside.phases
            for name, sensor in alone.sensors.items():
                np.testing.assert_array_equal(sensor.counts[:], beside[name].counts[:])
                np.testing.assert_array_equal(sensor.time[:], beside[name].time[:])
