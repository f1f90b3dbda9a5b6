"""Every floor in pyproject.toml is the version with which .ci/run tests: only tested versions are promised."""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
EXTRAS = ("report", "export", "analysis", "import", "monitor", "cluster", "test")
"""Those with which the tests run."""
INDIRECT = {"pyparsing"}
"""Pinned, and no requirement of ours."""


def promised() -> dict[str, set[tuple[str, Version]]]:
    """Name, operators and versions of every requirement but our own extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *(line for extra in EXTRAS for line in project["optional-dependencies"][extra])]
    requirements = [Requirement(line) for line in lines]
    return {
        canonicalize_name(item.name): {(part.operator, Version(part.version)) for part in item.specifier}
        for item in requirements
        if item.name != project["name"]
    }


def pinned() -> dict[str, set[tuple[str, Version]]]:
    """Name and version of every pin, with the operator that a floor has."""
    lines = (ROOT / ".ci" / "lowest-versions.txt").read_text(encoding="utf-8").splitlines()
    pins = [text for line in lines if (text := line.partition("#")[0].strip())]
    pairs = [pin.split("==") for pin in pins]
    return {canonicalize_name(name): {(">=", Version(version))} for name, version in pairs}


def test_every_floor_is_tested() -> None:
    pins = pinned()
    assert {name: pin for name, pin in pins.items() if name not in INDIRECT} == promised()
    assert set(pins) >= INDIRECT


def test_ci_installs_the_lowest_versions() -> None:
    words = (ROOT / ".ci" / "run").read_text(encoding="utf-8").split()
    assert words.count(".ci/lowest-versions.txt") == 1
