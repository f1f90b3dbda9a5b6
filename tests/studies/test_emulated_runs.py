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
    messages: list[str] = []
    for workers in (1, 2):
        (folder := tmp_path / str(workers)).mkdir()
        options = DemoOptions(seconds=100.0, seed=3, workers=workers)
        logs.append(record_all(find_config(Path("martin2013")), folder, options, messages.append))
    assert list(logs[0]) == list(logs[1]) == list(RUNS)
    assert messages[:4] == messages[4:]
    for run in RUNS:
        with open_log(logs[0][run]) as alone, open_log(logs[1][run]) as other:
            assert alone.phases == other.phases
            for name, sensor in alone.sensors.items():
                np.testing.assert_array_equal(sensor.counts[:], other[name].counts[:])
                np.testing.assert_array_equal(sensor.time[:], other[name].time[:])
