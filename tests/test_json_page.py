"""docs/reference/json.md describes the output of commands with --json: every key that they print, and no other."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import imuarray as ia
from imuarray.cli import main
from imuarray.commands.options import print_json
from tests.json_page import documented
from tests.report.example_diagnoses import partial_diagnosis

RUN, OUT = "{folder}/run.h5", "{folder}/out"
BOOTS = "{folder}/boot_1.h5 {folder}/boot_2.h5 {folder}/boot_3.h5"
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
    "calibrate thermal": f"calibrate thermal {{folder}}/heating.h5 -o {OUT}_thermal.toml",
    "calibrate turn-on": f"calibrate turn-on {BOOTS} -o {OUT}_on.toml",
    "calibrate compare": f"calibrate compare {OUT}.toml {OUT}_again.toml",
    "paper": "paper",
}
IN_OTHER_TESTS = {"demo", "gap diagnose", "study"}
"""Commands that take longer: below, tests/studies/test_demo.py, tests/studies/fusion_gain/test_study.py."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("json")
    for seed, name in enumerate(("run", "again")):
        ia.simulate(
            "martin2013", here / f"{name}.h5", experiment="tumble", seconds=60.0, model="martin2013", seed=seed
        ).close()
    with ia.open_log(here / "again.h5") as log:
        ia.calibrate_tumble(log).calibration.save(here / "out_again.toml")
    ia.simulate("martin2013", here / "heating.h5", experiment="heating", seconds=1200.0, rate_hz=10.0).close()
    for boot in range(3):
        ia.simulate("martin2013", here / f"boot_{boot + 1}.h5", experiment="turn-on", seconds=30.0, boot=boot).close()
    return here


def printed(words: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    force = ["--force"] if " -o " in words else []
    assert main([*words.format(folder=folder).split(), *force, "--json"]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


@pytest.mark.slow
def test_every_key_is_on_the_page(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In this order: a command reads files of earlier commands."""
    sections = documented()
    assert sections.keys() == COMMANDS.keys() | IN_OTHER_TESTS
    for command, words in COMMANDS.items():
        keys, entries = sections[command]
        result = printed(words, folder, capsys)
        assert result.keys() == keys, command
        for name, of_entry in entries.items():
            assert set().union(*(entry.keys() for entry in result[name])) == of_entry, (command, name)
            assert result[name], (command, name)


def test_every_key_of_a_diagnosis_is_on_the_page() -> None:
    """Of a diagnosis made by hand, which has an entry in every list."""
    keys, entries = documented()["gap diagnose"]
    result = partial_diagnosis().as_json()
    assert result.keys() == keys
    for name, of_entry in entries.items():
        assert result[name] and result[name][0].keys() == of_entry, name


@pytest.mark.slow
def test_an_evaluation_has_its_own_keys(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys, _ = documented()["fuse"]
    result = printed(f"fuse {RUN} --evaluate", folder, capsys)
    left_out = {"fused", "frames", "empty", "faults", "learned", "error", "results"}
    assert result.keys() == (keys - left_out) | {"evaluation"}
    assert result["evaluation"].keys() == {"scores", "coasting"}


def test_numbers_that_are_not_finite_are_null(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"a": [float("nan"), 1.0, (float("inf"),)], "b": {"c": -float("inf"), "d": "nan"}})
    assert json.loads(capsys.readouterr().out) == {"a": [None, 1.0, [None]], "b": {"c": None, "d": "nan"}}
