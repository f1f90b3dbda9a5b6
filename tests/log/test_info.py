"""The times of a log's rows in `imuarray info`."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import pytest

from imuarray.cli import main


def test_the_rows_of_a_part_have_their_own_wall_time(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with h5py.File(small, "r+") as file:
        for sensor in file["sensors"].values():
            sensor["time"][:] += 3_600_000_000_000  # the second part of a log that began an hour before
    assert main(["info", str(small), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["epoch"] == "2013-09-16T08:30:00.000000Z"
    assert (report["begins"], report["ends"]) == ("2013-09-16T09:30:00.000Z", "2013-09-16T09:30:00.090Z")
    assert main(["info", str(small)]) == 0
    assert "rows from 2013-09-16T09:30:00.000Z to 2013-09-16T09:30:00.090Z" in capsys.readouterr().out


def test_a_log_without_a_date_has_no_wall_time(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with h5py.File(small, "r+") as file:
        file.attrs["epoch"] = "then"
    assert main(["info", str(small), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["begins"] is None
