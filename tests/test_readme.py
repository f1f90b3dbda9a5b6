"""README.md keeps its word: every command of the first steps runs, and the Python example does too."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from imuarray.cli import main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
SHELL = [line for kind, block in BLOCKS if kind == "sh" for line in block.splitlines()]
COMMANDS = [line for line in SHELL if line.startswith("imuarray ")]


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


def test_the_first_steps_write_what_it_says(walked: Path) -> None:
    written = {path.name for path in walked.iterdir()}
    assert {"tumble.h5", "cal.toml", "noise", "heating.h5", "fused.h5", "board.h5", "board.toml"} <= written


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
    from imuarray import load_array

    (example,) = re.findall(r"```toml\n(.*?)```", README, flags=re.DOTALL)
    path = tmp_path / "mine.toml"
    path.write_text(example, encoding="utf-8")
    assert [sensor.name for sensor in load_array(path).sensors] == ["Front"]
