"""The examples in the docstrings of public functions run, in a folder with a log and a calibration."""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import imuarray as ia
from imuarray.acquire import record
from imuarray.calibrate import calibrate_noise

ROOT = Path(__file__).parents[1]
SHOWN = (
    "imuarray.array.load_array",
    "imuarray.bus.open_bus",
    "imuarray.calibrate.load_calibration",
    "imuarray.fuse.evaluate",
    "imuarray.fuse.fuse",
    "imuarray.gap.diagnose.diagnose",
    "imuarray.log.open_log",
)
"""What README.md and the scripts in configs/examples begin with."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the examples find around them: configs/, run.h5 and cal.toml."""
    here = tmp_path_factory.mktemp("doctest")
    (here / "configs").symlink_to(ROOT / "configs")
    array = ia.load_array(ROOT / "configs" / "martin2013.toml")
    with ia.open_bus("emulated:", array) as bus:
        record(array, bus, here / "run.h5", rate_hz=50.0, seconds=5.0, phase="z_up")
    with ia.open_log(here / "run.h5") as log:
        calibrate_noise(log).save(here / "cal.toml")
    return here


@pytest.mark.parametrize("name", SHOWN)
def test_the_example_runs(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    module, _, function = name.rpartition(".")
    shown = getattr(import_module(module), function)
    (found,) = doctest.DocTestFinder(recurse=False).find(shown, function, globs={function: shown})
    assert found.examples
    report: list[str] = []
    assert doctest.DocTestRunner().run(found, out=report.append).failed == 0, "".join(report)


def test_every_public_function_has_one() -> None:
    assert {name.rpartition(".")[2] for name in SHOWN} >= set(ia.__all__) - {"__version__"}
