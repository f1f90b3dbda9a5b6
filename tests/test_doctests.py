"""The examples in docstrings run, in a folder with a log and a calibration."""

from __future__ import annotations

import ast
import doctest
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import imuarray as ia
from imuarray.acquire import record
from imuarray.calibrate import calibrate_noise
from tests.selection import some

ROOT = Path(__file__).parents[1]


def with_example(tree: ast.Module | ast.ClassDef, name: str) -> Iterator[str]:
    """Dotted names of the functions, classes and methods in `tree` whose docstrings show an example."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            if ">>>" in (ast.get_docstring(node) or ""):
                yield f"{name}.{node.name}"
            if isinstance(node, ast.ClassDef):
                yield from with_example(node, f"{name}.{node.name}")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SHOWN = tuple(
    name
    for path in sorted((ROOT / "imuarray").rglob("*.py"))
    if ">>>" in (text := path.read_text(encoding="utf-8"))  # few have: to parse all takes seconds of each worker
    for name in with_example(ast.parse(text), module_name(path))
)
"""Everything whose documentation shows an example."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that examples use: configs/, run.h5, and cal.toml."""
    here = tmp_path_factory.mktemp("doctest")
    (here / "configs").symlink_to(ROOT / "configs")
    array = ia.load_array(ROOT / "configs" / "martin2013.toml")
    with ia.open_bus("emulated:", array) as bus:
        record(array, bus, here / "run.h5", rate_hz=50.0, seconds=5.0, phase="z_up")
    with ia.open_log(here / "run.h5") as log:
        tumble = ia.simulate(array, here / "tumble.h5", experiment="tumble", seconds=60.0)
        ia.calibrate_tumble(tumble).calibration.merged(calibrate_noise(log)).save(here / "cal.toml")
        tumble.close()
    return here


def make_logs(example: str, folder: Path) -> None:
    """Make the further logs that an example opens."""
    array = ia.load_array(ROOT / "configs" / "martin2013.toml")
    if "fused.h5" in example and not (folder / "fused.h5").exists():
        ia.fuse(folder / "run.h5", folder / "cal.toml", "optimal").save(folder / "fused.h5")
    if "heating.h5" in example and not (folder / "heating.h5").exists():
        ia.simulate(array, folder / "heating.h5", experiment="heating", seconds=1200.0, rate_hz=10.0).close()
    for boot in range(3):
        path = folder / f"boot_{boot + 1}.h5"
        if path.name in example and not path.exists():
            ia.simulate(array, path, experiment="turn-on", seconds=60.0, boot=boot).close()


@pytest.mark.parametrize("name", some(SHOWN, 0))
def test_the_example_runs(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    shown, around = resolved(name)
    (result,) = doctest.DocTestFinder(recurse=False).find(shown, name, globs=around)
    assert result.examples
    make_logs("".join(example.source for example in result.examples), folder)
    report: list[str] = []
    assert doctest.DocTestRunner().run(result, out=report.append).failed == 0, "".join(report)


def resolved(name: str) -> tuple[Any, dict[str, Any]]:
    """A function or a method by its dotted name, and the names in its example: its own, or that of its class."""
    parts = name.split(".")
    classes = parts[-2:-1] if parts[-2][:1].isupper() else []
    module = import_module(".".join(parts[: -1 - len(classes)]))
    shown: Any = module
    for part in (*classes, parts[-1]):
        shown = getattr(shown, part)
    around: dict[str, Any] = {parts[-1]: shown}
    if classes:
        around = {"open_log": ia.open_log, classes[0]: getattr(module, classes[0])}
    return shown, around


def test_every_public_function_has_an_example() -> None:
    assert {name.rpartition(".")[2] for name in SHOWN} >= set(ia.__all__) - {"__version__"}
