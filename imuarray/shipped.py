"""The files that come with the package, in `configs/`: arrays, models and import maps, by their names."""

from __future__ import annotations

from pathlib import Path

from imuarray.errors import ConfigError
from imuarray.spelling import guess, guess_file


def configs() -> Path:
    """Return the folder of the shipped configurations: inside an installed package, next to it in a checkout."""
    package = Path(__file__).parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def find_config(name: Path) -> Path:
    """Return `name` itself if it is a file, otherwise the configuration of this name in the package ("martin2013")."""
    return _find(name, configs(), "array", "[array]")


def find_model(name: Path) -> Path:
    """Return `name` itself if it is a file, otherwise the model of this name in the package ("datasheet")."""
    return _find(name, configs() / "models", "model", "[model]")


def find_map(name: Path) -> Path:
    """Return `name` itself if it is a file, otherwise the import map of this name in the package ("mimu4444")."""
    return _find(name, configs() / "imports", "map", "")


def _find(name: Path, folder: Path, kind: str, table: str) -> Path:
    """Return a file, or the one of that name in `folder`; ConfigError lists the available names (of files that contain
    `table`).
    """
    if name.exists() or name.suffix:
        return name
    shipped = folder / f"{name}.toml"
    if shipped.is_file():
        return shipped
    names = sorted(path.stem for path in folder.glob("*.toml") if table in path.read_text(encoding="utf-8"))
    near = guess(str(name), names) or guess_file(name)
    raise ConfigError(
        f"{name}: no such file, and no {kind} of that name comes with the package ({', '.join(names)}){near}"
    )
