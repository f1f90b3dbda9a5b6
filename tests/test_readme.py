"""README.md and the pages in docs/ are correct: every command block runs, and every name in them exists.

Of the code blocks, `sh` is run in order, `sh slow` line by line by the campaigns, `sh setup` installs packages, `sh
hardware` needs a bus. Pages of docs/ continue from the files of docs/tutorials/first_steps.md, each in a copy. The
options of all commands are parsed.
"""

from __future__ import annotations

import importlib
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

import imuarray as ia
from imuarray.cli import COMMANDS, main, program
from imuarray.fuse import read_fused
from imuarray.simulate import load_model

ROOT = Path(__file__).parents[1]
ROOT_PAGES = sorted(ROOT.glob("*.md"))
DOCS = sorted((ROOT / "docs").rglob("*.md"))
PAGES = [*ROOT_PAGES, *DOCS]
KINDS = {"sh", "sh slow", "sh setup", "sh hardware", "python", "toml", "text"}


def blocks(page: Path, kind: str = "") -> list[str]:
    """The code blocks of a page, of one kind or of all."""
    pairs = re.findall(r"^ *```(\w+(?: \w+)?)\n(.*?)^ *```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [text for name, text in pairs if kind in (name, "")]


def lines(page: Path, kind: str) -> list[str]:
    """The lines of the shell blocks of one kind."""
    return [line.strip() for text in blocks(page, kind) for line in text.splitlines() if line.strip()]


README = ROOT / "README.md"
FIRST_STEPS = ROOT / "docs" / "tutorials" / "first_steps.md"
SHELL = lines(README, "sh")
SLOW = [line for page in PAGES for line in lines(page, "sh slow")]
WALKED = [
    page
    for page in PAGES
    if page not in (README, FIRST_STEPS) and lines(page, "sh") and page.name not in ("CONTRIBUTING.md", "VALIDATION.md")
]


def run_line(line: str, folder: Path) -> None:
    """Run one line of a page in `folder`, the current one, as a shell would."""
    words = [
        name
        for word in shlex.split(line)
        for name in (sorted(path.name for path in folder.glob(word)) if "*" in word else [word])
    ]
    if words[0] == "imuarray":
        assert main(words[1:]) == 0, line
    elif words[0] in ("mkdir", "gzip"):
        subprocess.run(line, shell=True, check=True, cwd=folder)  # noqa: S602  the line is ours
    else:
        assert words[0] == "python", line
        subprocess.run([sys.executable, *words[1:]], check=True, capture_output=True)


def with_sources(folder: Path) -> Path:
    """A folder that looks like the root of a checkout."""
    for name in ("tests", "configs"):
        (folder / name).symlink_to(ROOT / name)
    return folder


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the commands of the first steps were run in order, as from the root of a checkout."""
    folder = with_sources(tmp_path_factory.mktemp("readme"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in lines(FIRST_STEPS, "sh"):
            run_line(line, folder)
    return folder


def copied(walked: Path, folder: Path) -> Path:
    """A separate folder with the files of the first steps."""
    for path in walked.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    return with_sources(folder)


@pytest.mark.slow
def test_the_first_steps_write_the_stated_files(walked: Path) -> None:
    assert {path.name for path in walked.iterdir()} >= {
        "tumble.h5",
        "cal.toml",
        "heating.h5",
        "fused.h5",
        "report.html",
    }


@pytest.mark.slow
def test_the_gain_of_fusion_in_the_first_steps_is_reached(walked: Path) -> None:
    """Opposed gyroscopes drift less about box Y, and the optimal specific force along Z is nearer to the truth."""
    drift, error = {}, {}
    for name in ("fused", "optimal"):
        fused = list(read_fused(walked / f"{name}.h5"))
        rate = np.degrees(np.concatenate([block.triads["angular_rate"] for block in fused])[:, 1])
        means = [part.mean() for part in np.array_split(rate, 16)]
        drift[name] = max(means) - min(means)
        force = np.concatenate([block.triads["specific_force"] for block in fused])[:, 2] / 9.80665
        error[name] = 1e3 * float(np.std(force))
    assert drift["fused"] < 0.139 / 2  # of the mean, as the page prints it
    assert error["optimal"] < 13.846 / 1.5


@pytest.mark.slow
@pytest.mark.parametrize("page", WALKED, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page: Path, walked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copied(walked, tmp_path))
    for line in lines(page, "sh"):
        run_line(line, tmp_path)
    if page.stem == "exchange":
        with ia.open_log("tumble.h5") as log, ia.open_log("tumble_again.h5") as again:
            assert all(np.array_equal(log[name].counts[:], again[name].counts[:]) for name in log.sensors)
    if page.stem == "fuse":  # fusing afterwards is fusing while it records
        live, causal = (list(read_fused(tmp_path / name)) for name in ("live_fused.h5", "causal.h5"))
        for quantity in ("specific_force", "angular_rate"):
            first, other = (np.concatenate([block.triads[quantity] for block in fused]) for fused in (live, causal))
            np.testing.assert_allclose(first, other, rtol=0, atol=1e-9)
    if page.stem == "raspberry_pi":  # by place, for names are the proposal's own
        wired, proposed = (
            ia.load_array(path) for path in (ROOT / "configs" / "martin2013.toml", tmp_path / "mine.toml")
        )
        axes = {(sensor.channel, sensor.address): sensor.axes for sensor in wired.sensors}
        assert {(sensor.channel, sensor.address): sensor.axes for sensor in proposed.sensors} == axes


@pytest.mark.campaign
@pytest.mark.parametrize("line", SLOW)
def test_slow_commands_run(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(with_sources(tmp_path))
    run_line(line, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.stem)
def test_the_python_of_a_page_runs(page: Path, walked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copied(walked, tmp_path))
    names: dict[str, object] = {}
    for example in blocks(page, "python"):
        exec(compile(example, page.name, "exec"), names)  # noqa: S102  the example is ours
    if page.stem == "python":
        assert names["rate_box"].shape == (1000, 3)  # type: ignore[attr-defined]


def test_every_block_is_of_a_kind_that_is_tested() -> None:
    for page in PAGES:
        marks = re.findall(r"^ *```(\S.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
        assert set(marks) <= KINDS, page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_paths_names_and_options_of_a_page_exist(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", prose(page))
    assert [target for target in targets if ":" not in target and not (page.parent / target).exists()] == []
    paths = re.findall(r"`((?:imuarray|firmware_emulator|tests|configs|docs|\.ci)/[\w./@-]*)`", prose(page))
    assert [path for path in paths if not (ROOT / path).exists()] == []
    names = set(re.findall(r"\b((?:imuarray|firmware_emulator)(?:\.[A-Za-z_]\w*)+)", prose(page)))
    assert [name for name in sorted(names) if not exists(name)] == []
    for kind in ("sh hardware", "sh slow", "sh"):
        for line in lines(page, kind):
            parse(line)


def parse(line: str) -> None:
    """Parse a command line without running it, since some need hardware or much time."""
    words = shlex.split(line)
    if words[0] != "imuarray":
        assert words[0] in ("python", "python3", "sudo", "echo", "mkdir", "gzip"), line
        return
    command: click.Command = program
    context = click.Context(program, info_name="imuarray")
    rest = words[1:]
    while isinstance(command, click.Group):
        below = command.get_command(context, rest.pop(0))
        assert below is not None, line
        command = below
    command.make_parser(click.Context(command)).parse_args(rest)


def test_set_up_commands_are_those_of_ci() -> None:
    demo, tests = [line for line in SHELL if line.startswith("python3 -m venv")]
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert tests in ci
    assert demo.endswith(".venv/bin/imuarray demo")


def test_readme_has_two_commands() -> None:
    assert len(SHELL) == 2


def test_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 100  # two screens


def test_every_command_is_explained_or_shown() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert {name for name in COMMANDS if f"imuarray {name}" not in text} == set()


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "toml")], ids=lambda page: page.stem)
def test_an_example_of_an_array_or_a_model_is_valid(page: Path, tmp_path: Path) -> None:
    (example,) = blocks(page, "toml")
    path = tmp_path / "mine.toml"
    path.write_text(example, encoding="utf-8")
    if page.stem == "simulate":
        assert load_model(path).name == "mine"
    else:
        assert [sensor.name for sensor in ia.load_array(path).sensors] == ["Front"]


def prose(page: Path) -> str:
    """A page without its code blocks."""
    return re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or something in one; a file of such a name will do."""
    if (ROOT / name).exists() or name.rpartition(".")[2] in ("h5", "toml", "html"):
        return True
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(value, part):
                return False
            value = getattr(value, part)
        return True
    return False


@pytest.mark.slow
def test_the_picture_of_the_architecture_is_up_to_date() -> None:
    """If this fails, imports between packages have changed: run `python docs/architecture.py`."""
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        drawn = importlib.import_module("architecture").picture()
    finally:
        sys.path.remove(str(ROOT / "docs"))
    assert (ROOT / "docs" / "images" / "architecture.svg").read_text(encoding="utf-8") == drawn


def test_every_package_is_in_the_architecture() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    packages = [path.parent.name for path in (ROOT / "imuarray").glob("*/__init__.py")]
    assert [name for name in packages if f"`imuarray/{name}`" not in text] == []
