"""Packages with names that are loaded on first use, and packages that can also be called as a function of the same
name: `imuarray.fuse(log)` as well as `from imuarray.fuse import Watch`. The import of a package sets its name in
`imuarray`, where it would hide a function of that name. The package is therefore given a callable class, which Python
allows for modules (Python Language Reference, 3.3.2.1).
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from inspect import Signature, signature
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package `imuarray.NAME` that can be called like `imuarray.analysis.NAME`, which the first call imports."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the function of the package's name and return its result."""
        return self._function()(*arguments, **options)

    @property
    def __signature__(self) -> Signature:
        return signature(self._function())

    def _function(self) -> Any:
        return getattr(import_module("imuarray.analysis"), self.__name__.rpartition(".")[2])


def public_name(package: str, modules: Mapping[str, str], name: str) -> Any:
    """Import a public name of a package on first use, from the module for which `modules` lists it (names separated by
    spaces); AttributeError if unknown.
    """
    for module, names in modules.items():
        if name in names.split():
            return getattr(import_module(f"{package}.{module}"), name)
    raise AttributeError(f"module {package!r} has no attribute {name!r}")


def make_callable(package: str) -> None:
    """Make a package callable while it is imported."""
    sys.modules[package].__class__ = CallablePackage
