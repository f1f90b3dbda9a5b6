"""Where the files that come with the package lie: arrays and models, in `configs/`."""

from __future__ import annotations

from pathlib import Path


def configs() -> Path:
    """The shipped configurations: inside an installed package, beside it in a checkout."""
    package = Path(__file__).parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"
