"""README.md keeps its word: every command in it runs, and the Python example does too."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import imuarray as ia
from imuarray.cli import main
from imuarray.fuse import read_fused

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^ *```(\w+(?: slow)?)\n(.*?)^ *```", README, flags=re.MULTILINE | re.DOTALL)
SHELL = [line.strip() for kind, block in BLOCKS if kind == "sh" for line in block.splitlines()]
COMMANDS = [line for line in SHELL if line.startswith("imuarray ")]
SLOW = [line for kind, block in BLOCKS if kind == "sh slow" for line in block.splitlines()]


def expanded(arguments: list[str], folder: Path) -> list[str]:
    """As a shell would: names with * in place of the patterns."""
    found = [sorted(path.name for path in folder.glob(item)) if "*" in item else [item] for item in arguments]
    return [name for names in found for name in names]


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the README's commands have been run, one after the other, as from the root of a checkout."""
    folder = tmp_path_factory.mktemp("readme")
    for name in ("tests", "configs"):
        (folder / name).symlink_to(ROOT / name)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in COMMANDS:
            assert main(expanded(shlex.split(line)[1:], folder)) == 0, line
    return folder


@pytest.mark.slow
def test_the_first_steps_write_what_it_says(walked: Path) -> None:
    written = {path.name for path in walked.iterdir()}
    assert {"tumble.h5", "cal.toml", "noise", "heating.h5", "fused.h5", "board.h5", "board.toml"} <= written
    assert {"report.html", "fused.mcap", "tumble.csv", "mine.toml", "live_fused.h5", "causal.h5", "gap"} <= written


@pytest.mark.slow
def test_an_export_comes_back_as_it_was(walked: Path) -> None:
    with ia.open_log(walked / "tumble.h5") as log, ia.open_log(walked / "tumble_again.h5") as again:
        assert all(np.array_equal(log[name].counts[:], again[name].counts[:]) for name in log.sensors)


@pytest.mark.slow
def test_the_axes_are_found_by_hand(walked: Path) -> None:
    """As configs/martin2013.toml has them of the board that is emulated; by place, for names are the proposal's own."""
    wired, found = (ia.load_array(path) for path in (ROOT / "configs" / "martin2013.toml", walked / "mine.toml"))
    axes = {(sensor.channel, sensor.address): sensor.axes for sensor in wired.sensors}
    assert {(sensor.channel, sensor.address): sensor.axes for sensor in found.sensors} == axes


@pytest.mark.slow
def test_fusing_afterwards_is_fusing_while_it_records(walked: Path) -> None:
    live, causal = (list(read_fused(walked / name)) for name in ("live_fused.h5", "causal.h5"))
    for quantity in ("specific_force", "angular_rate"):
        one, other = (np.concatenate([block.triads[quantity] for block in blocks]) for blocks in (live, causal))
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("line", SLOW)
def test_what_takes_longer(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(line)[1:]) == 0


def test_other_programs_that_are_called_are_there() -> None:
    called = [line for line in SHELL if line not in COMMANDS and not line.startswith("python3 -m venv")]
    assert called == ["python configs/examples/new_chip.py"]  # tests/test_examples.py runs it


@pytest.mark.slow
def test_the_python_example_runs(walked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(walked)
    names: dict[str, object] = {}
    (example,) = [block for kind, block in BLOCKS if kind == "python"]
    exec(compile(example, "README.md", "exec"), names)  # noqa: S102  the example is ours
    assert names["rate_box"].shape == (1000, 3)  # type: ignore[attr-defined]


def test_set_up_commands_are_those_that_ci_runs() -> None:
    demo, tests = [line for line in SHELL if line.startswith("python3 -m venv")]
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert tests in ci
    assert demo.endswith(".venv/bin/imuarray demo")


def test_every_command_is_explained_or_shown() -> None:
    from imuarray.cli import COMMANDS as KNOWN

    assert {name for name in KNOWN if f"imuarray {name}" not in README} == set()


def test_the_array_example_is_an_array(tmp_path: Path) -> None:
    (example,) = [block for kind, block in BLOCKS if kind == "toml"]
    path = tmp_path / "mine.toml"
    path.write_text(example, encoding="utf-8")
    assert [sensor.name for sensor in ia.load_array(path).sensors] == ["Front"]
