"""The examples in the docstrings of public functions run, in a folder with a log and a calibration."""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import imuarray as ia
from imuarray.acquire import record
from imuarray.calibrate import calibrate_noise
from tests.selection import some

ROOT = Path(__file__).parents[1]
SHOWN = (
    "imuarray.analysis.calibrate_noise",
    "imuarray.analysis.calibrate_thermal",
    "imuarray.analysis.calibrate_tumble",
    "imuarray.analysis.calibrate_turn_on",
    "imuarray.analysis.characterise",
    "imuarray.analysis.fuse",
    "imuarray.analysis.simulate",
    "imuarray.array.load_array",
    "imuarray.bus.open_bus",
    "imuarray.calibrate.load_calibration",
    "imuarray.fuse.evaluate",
    "imuarray.fuse.fuse",
    "imuarray.fuse.fused_result.load_fused",
    "imuarray.gap.diagnose.diagnose",
    "imuarray.log.open_log",
    "imuarray.log.reader.Log.to_pandas",
    "imuarray.log.reader.Log.to_xarray",
)
"""What README.md and the scripts in configs/examples begin with."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the examples find around them: configs/, run.h5, cal.toml, and logs of the calibrating experiments."""
    here = tmp_path_factory.mktemp("doctest")
    (here / "configs").symlink_to(ROOT / "configs")
    array = ia.load_array(ROOT / "configs" / "martin2013.toml")
    with ia.open_bus("emulated:", array) as bus:
        record(array, bus, here / "run.h5", rate_hz=50.0, seconds=5.0, phase="z_up")
    with ia.open_log(here / "run.h5") as log:
        calibrate_noise(log).save(here / "cal.toml")
        ia.fuse(log, here / "cal.toml", "optimal").save(here / "fused.h5")
    ia.simulate(array, here / "tumble.h5", experiment="tumble", seconds=60.0).close()
    ia.simulate(array, here / "heating.h5", experiment="heating", seconds=1200.0, rate_hz=10.0).close()
    for boot in range(3):
        ia.simulate(array, here / f"boot_{boot + 1}.h5", experiment="turn-on", seconds=60.0, boot=boot).close()
    return here


@pytest.mark.parametrize("name", some(SHOWN, 4))
def test_the_example_runs(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    shown, around = resolved(name)
    (found,) = doctest.DocTestFinder(recurse=False).find(shown, name, globs=around)
    assert found.examples
    report: list[str] = []
    assert doctest.DocTestRunner().run(found, out=report.append).failed == 0, "".join(report)


def resolved(name: str) -> tuple[Any, dict[str, Any]]:
    """A function or a method by its dotted name, and the names that its example may use: its module's functions."""
    parts = name.split(".")
    classes = parts[-2:-1] if parts[-2][:1].isupper() else []
    module = import_module(".".join(parts[: -1 - len(classes)]))
    shown: Any = module
    for part in (*classes, parts[-1]):
        shown = getattr(shown, part)
    around = {"open_log": ia.open_log} if classes else {parts[-1]: shown}
    return shown, around


def test_every_public_function_has_one() -> None:
    assert {name.rpartition(".")[2] for name in SHOWN} >= set(ia.__all__) - {"__version__"}
