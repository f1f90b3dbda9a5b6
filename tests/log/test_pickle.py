"""A log is sent to another process as its path, and is opened there once."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.errors import LogError
from imuarray.log import open_log


def sent(what: Any) -> Any:
    return pickle.loads(pickle.dumps(what))  # noqa: S301


def test_a_log_is_sent_as_its_path(small: Path) -> None:
    with open_log(small) as log:
        assert len(pickle.dumps(log)) < 1000
        again = sent(log)
        assert again is not log
        assert again.phases == log.phases
        np.testing.assert_array_equal(again["Acc"].counts[:], log["Acc"].counts[:])
    assert again.is_open
    again.close()


def test_one_log_sent_several_times_is_opened_once(small: Path) -> None:
    with open_log(small) as log:
        first, second, sensor = sent((log, log, log["Acc"]))
        assert first is second
        assert sensor is first["Acc"]
        assert sent(log) is first
        first.close()
        other = sent(log)
        assert other is not first
        assert other.is_open
        other.close()


def test_a_sensor_alone_can_be_sent_after_its_log_is_out_of_scope(small: Path) -> None:
    sensor = open_log(small)["Gyro"]
    again = sent(sensor)
    assert again.name == "Gyro"
    np.testing.assert_array_equal(again.time[:], sensor.time[:])


def test_relative_paths_are_sent_as_absolute_paths(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(small.parent)
    with open_log(small.name) as log:
        pickled = pickle.dumps(log)
    monkeypatch.chdir("/")
    with pickle.loads(pickled) as again:  # noqa: S301
        assert again.source == "simulated"


def test_a_removed_log_is_refused(small: Path) -> None:
    with open_log(small) as log:
        pickled = pickle.dumps(log)
    small.unlink()
    with pytest.raises(LogError, match=r"small\.h5"):
        pickle.loads(pickled)  # noqa: S301
