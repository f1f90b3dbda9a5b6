"""The reader for MATLAB (docs/matlab/read_imuarray.m), run by GNU Octave where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from imuarray.export import export
from tests.export.conftest import ACC_COUNTS, EPOCH, GYRO_COUNTS

SCRIPT = Path(__file__).parents[2] / "docs" / "matlab" / "read_imuarray.m"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="GNU Octave is not installed")
def test_octave_reads_counts_and_values(run: Path) -> None:
    export(run, run.with_name("r.mat"))
    ask = f"addpath('{SCRIPT.parent}'); r = read_imuarray('{run.with_name('r.mat')}'); printf('%s\\n', r.epoch);"
    ask += "printf('%d ', r.Acc.counts.'); printf('\\n'); printf('%.17g ', r.Acc.values.'); printf('\\n');"
    done = subprocess.run(["octave-cli", "--eval", ask], capture_output=True, text=True, check=True)
    epoch, counts, values = done.stdout.splitlines()
    assert epoch == EPOCH
    assert np.array(counts.split(), int).reshape(-1, 3).tolist() == ACC_COUNTS
    x, y, z = np.array(ACC_COUNTS, float).T * 9.80665 / 512
    np.testing.assert_allclose(np.array(values.split(), float).reshape(-1, 3), np.stack([y, x, -z], axis=1))


MATLAB = {
    "h5info": "function r = h5info(~, ~)\n  r = load('{mat}').info;\nend\n",
    "h5read": "function r = h5read(~, path)\n  r = load('{mat}').(strrep(['at' path], '/', '_'));\nend\n",
    "h5readatt": "function r = h5readatt(~, path, name)\n"
    "  r = load('{mat}').([strrep(['at' path], '/', '_') '_' name]);\nend\n",
}
"""Functions of MATLAB that Octave lacks: they answer from a .mat file, with the dimensions that MATLAB documents."""


def write_matlab_functions(run: Path, folder: Path) -> None:
    """Write `MATLAB` to `folder`, for the log `run`: h5read reverses the dimensions, and columns are upright."""
    import h5py
    from scipy.io import savemat

    answers: dict[str, object] = {}
    groups = []
    with h5py.File(run) as file:
        answers["at__epoch"] = file.attrs["epoch"]
        for name, group in file["sensors"].items():
            datasets = np.array([(column,) for column in group], [("Name", object)])
            groups.append((f"/sensors/{name}", datasets))
            for column in group:
                answers[f"at_sensors_{name}_{column}"] = np.atleast_2d(np.asarray(group[column])).T
            for key in ("unit", "sensitivity", "orientation"):
                answers[f"at_sensors_{name}_{key}"] = np.asarray(group.attrs[key]).T
    answers["info"] = {"Groups": np.array(groups, [("Name", object), ("Datasets", object)])}
    savemat(folder / "answers.mat", answers, oned_as="column")
    for name, text in MATLAB.items():
        (folder / f"{name}.m").write_text(text.replace("{mat}", str(folder / "answers.mat")))


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="GNU Octave is not installed")
def test_the_branch_for_matlab_reads_the_log(run: Path, tmp_path: Path) -> None:
    write_matlab_functions(run, tmp_path)
    ask = f"addpath('{SCRIPT.parent}'); addpath('{tmp_path}'); r = read_imuarray('{run}'); printf('%s\\n', r.epoch);"
    ask += "printf('%d ', r.Acc.counts.'); printf('\\n'); printf('%.17g ', r.Gyro.values.'); printf('\\n');"
    ask += "printf('%.9f ', r.Gyro.time_s); printf('\\n'); printf('%d ', r.Acc.status); printf('\\n');"
    done = subprocess.run(["octave-cli", "--eval", ask], capture_output=True, text=True, check=True)
    epoch, counts, values, times, status = done.stdout.splitlines()
    assert epoch == EPOCH
    assert np.array(counts.split(), int).reshape(-1, 3).tolist() == ACC_COUNTS
    rates = np.array(GYRO_COUNTS) * np.radians(0.00875)  # along X, Y, Z already
    np.testing.assert_allclose(np.array(values.split(), float).reshape(-1, 3), rates, rtol=1e-12)
    assert times.split() == ["0.010000001", "0.020000001", "0.030000001"]
    assert status.split() == ["0", "4", "1", "8", "0"]


def test_every_block_of_the_script_is_closed() -> None:
    """The only check of its syntax without MATLAB or Octave."""
    lines = [line.split("%")[0] for line in SCRIPT.read_text().splitlines()]
    begun = sum(len(re.findall(r"^\s*(?:function|if|for|switch)\b", line)) for line in lines)
    assert begun == sum(len(re.findall(r"^\s*end\s*$", line)) for line in lines)


def test_names_in_the_script_exist_in_the_files(run: Path) -> None:
    """Groups, columns and attributes that it asks for are in a log and in a .mat file."""
    import h5py
    from scipy.io import loadmat

    text = SCRIPT.read_text()
    with h5py.File(run) as file:
        assert "epoch" in file.attrs
        group = file["sensors/Acc"]
        assert {"time", "counts", "status"} <= set(group)
        asked = set(re.findall(r"h5readatt\(file, path, '(\w+)'\)", text))
        assert asked == {"unit", "sensitivity", "orientation"} <= set(group.attrs)
    export(run, run.with_name("r.mat"))
    saved = loadmat(run.with_name("r.mat"), simplify_cells=True)
    assert set(re.findall(r"saved\.imuarray\.(\w+)", text)) <= set(saved["imuarray"])
    assert set(re.findall(r"table\.(\w+)", text)) <= set(saved["Acc"])
