"""The public names of the package, and the documented lines of Python."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import imuarray

ROOT = Path(__file__).parents[1]


def offered() -> set[str]:
    """The public names that `imuarray/__init__.py` brings in for type checkers, assigns or defines."""
    names: set[str] = set()
    for node in ast.parse((ROOT / "imuarray" / "__init__.py").read_text()).body:
        if isinstance(node, ast.If):  # if TYPE_CHECKING
            names |= {
                alias.asname or alias.name
                for line in node.body
                if isinstance(line, ast.ImportFrom)
                for alias in line.names
            }
        elif isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
    return {name for name in names if not name.startswith("_")} | {"__version__"}


PACKAGES = sorted(
    path.parent for name in ("imuarray", "firmware_emulator") for path in (ROOT / name).rglob("__init__.py")
)


def bound_names(init: Path) -> set[str]:
    """The names that a package's `__init__.py` binds at its top, or loads on first use (`__all__`), without modules."""
    names: set[str] = set()
    body = ast.parse(init.read_text()).body
    for node in [*body, *(line for block in body if isinstance(block, ast.If) for line in block.body)]:
        if isinstance(node, ast.ImportFrom) and node.module != ".".join(init.parent.relative_to(ROOT).parts):
            names |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
            if any(isinstance(target, ast.Name) and target.id == "__all__" for target in node.targets):
                names |= set(ast.literal_eval(node.value))
    return names


def test_names_of_a_package_differ_from_its_modules() -> None:
    """The import of such a module would replace the function, or the function would hide the module."""
    for package in PACKAGES:
        modules = {path.stem for path in package.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
        functions = {"characterise", "fuse", "simulate"} if package.name == "imuarray" else set()  # `CallablePackage`
        assert (bound_names(package / "__init__.py") & modules) == functions, package


def test_all_lists_the_public_names() -> None:
    assert set(imuarray.__all__) == offered()
    assert list(imuarray.__all__) == sorted(imuarray.__all__)
    assert dir(imuarray) == sorted(imuarray.__all__)


@pytest.mark.parametrize("name", imuarray.__all__)
def test_every_name_exists_and_is_documented(name: str) -> None:
    value = getattr(imuarray, name)
    assert isinstance(value, str) or value.__doc__


def test_other_names_raise_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'open_sesame'"):
        _ = imuarray.open_sesame  # type: ignore[attr-defined]


def test_importing_loads_no_heavy_package() -> None:
    program = (
        "import sys, imuarray\n"
        "heavy = {'numpy', 'h5py', 'scipy', 'pydantic', 'click', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imports {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_the_library_does_not_import_the_emulator() -> None:
    program = (
        "import sys, imuarray.acquire, imuarray.drivers, imuarray.log, imuarray.bus.transcript\n"
        "sys.exit('firmware_emulator' if 'firmware_emulator' in sys.modules else 0)"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=30).returncode == 0


def test_the_documented_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from imuarray.acquire import record

    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    with imuarray.open_bus("emulated:", imuarray.load_array("configs/martin2013.toml")) as bus:
        record(imuarray.load_array("configs/martin2013.toml"), bus, "run.h5", rate_hz=50, seconds=1)

    import imuarray as ia

    array = ia.load_array("configs/martin2013.toml")
    with ia.open_bus("emulated:?clock=real", array) as bus:  # clock=virtual is the default
        bus.transfer(0x70, b"\x04")  # PCA9544A: channel 0, from the STOP on
        assert bus.transfer(0x53, b"\x00", 1) == b"\xe5"  # ADXL345 DEVID; transfer(address) alone asks for an ACK
        assert bus.transfer(0x53) == b""
    log = ia.open_log("run.h5")
    time, counts = log["Gyro1"].time, log["Gyro1"].counts
    assert time.shape == (50,)
    assert counts.shape == (50, 3)
    assert isinstance(counts[10:20], np.ndarray)
    assert len(log.sensors) == 12
    assert [phase.name for phase in log.phases] == []
    assert log.events == ()
    assert log.truth is not None
    log.close()
