"""The versions on which results can depend: Python, HDF5 and the numerical packages."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("numpy", "scipy", "h5py", "smbus2", "pyserial", "matplotlib")


def versions() -> dict[str, str]:
    """Return the version of each installed package by name."""
    import h5py

    numbers = {
        "python": f"{platform.python_version()} on {platform.system()} {platform.release()} {platform.machine()}"
    }
    numbers["HDF5"] = h5py.version.hdf5_version
    for name in _PACKAGES:
        try:
            numbers[name] = version(name)
        except PackageNotFoundError:
            continue
    return numbers
