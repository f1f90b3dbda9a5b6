"""docs/reference/json.md states what the commands print with --json: every key that they print, and no other."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import imuarray as ia
from imuarray.cli import main
from imuarray.commands.options import print_json

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "json.md"
SECTION = re.compile(r"## `imuarray ([a-z ]+)`\n\n\| key \| meaning \|\n\|---\|---\|\n((?:\|.*\n)+)")
RUN, OUT = "{folder}/run.h5", "{folder}/out"
COMMANDS: dict[str, str] = {
    "info": f"info {RUN}",
    "verify": f"verify {RUN}",
    "recover": f"recover {RUN}",
    "log": f"log martin2013 --bus emulated: --seconds 0.2 -o {OUT}.h5",
    "detect": "detect martin2013 --bus emulated:",
    "simulate": f"simulate martin2013 --seconds 1 -o {OUT}_simulated.h5",
    "export": f"export {RUN} -o {OUT}.npz",
    "import": f"import {OUT}.npz -o {OUT}_again.h5",
    "calibrate tumble": f"calibrate tumble {RUN} -o {OUT}.toml",
    "calibrate noise": f"calibrate noise {RUN} -o {OUT}_noise.toml",
    "characterise": f"characterise {RUN}",
    "fuse": f"fuse {RUN} -o {OUT}_fused.h5",
    "report": f"report {OUT}.toml -o {OUT}.html",
}


def documented() -> dict[str, tuple[set[str], dict[str, set[str]]]]:
    """The keys of each command, and those of the entries of its lists (`sensors[]`)."""
    sections = {}
    for command, rows in SECTION.findall(PAGE.read_text(encoding="utf-8")):
        keys: set[str] = set()
        entries: dict[str, set[str]] = {}
        for row in rows.splitlines():
            names, meaning = (cell.strip() for cell in row.strip("|").split("|"))
            named = re.findall(r"`([^`]+)`", names)
            keys |= {name.removesuffix("[]") for name in named}
            for name in named:
                if name.endswith("[]"):
                    entries[name.removesuffix("[]")] = set(re.findall(r"`([^`]+)`", meaning))
        sections[command] = keys, entries
    return sections


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("json")
    ia.simulate("martin2013", here / "run.h5", experiment="tumble", seconds=60.0, model="martin2013").close()
    return here


def printed(words: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    force = ["--force"] if " -o " in words else []
    assert main([*words.format(folder=folder).split(), *force, "--json"]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


@pytest.mark.slow
def test_every_key_is_on_the_page(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In this order: a command reads what one before it wrote."""
    sections = documented()
    assert sections.keys() == COMMANDS.keys()
    for command, words in COMMANDS.items():
        keys, entries = sections[command]
        result = printed(words, folder, capsys)
        assert result.keys() == keys, command
        for name, of_entry in entries.items():
            assert set().union(*(entry.keys() for entry in result[name])) == of_entry, (command, name)
            assert result[name], (command, name)


@pytest.mark.slow
def test_an_evaluation_has_its_own(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys, _ = documented()["fuse"]
    result = printed(f"fuse {RUN} --evaluate", folder, capsys)
    left_out = {"fused", "frames", "faults", "learned", "error", "results"}
    assert result.keys() == (keys - left_out) | {"evaluation"}
    assert result["evaluation"].keys() == {"scores", "coasting"}


def test_numbers_that_are_not_finite_are_null(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": [float("nan"), 1.0, (float("inf"),)], "b": {"c": -float("inf"), "d": "nan"}})
    assert json.loads(capsys.readouterr().out) == {"a": [None, 1.0, [None]], "b": {"c": None, "d": "nan"}}
