"""A file from elsewhere is looked through before anything in it is believed.

Nothing in a log may lead outside it (links, external storage, virtual datasets), hide behind a filter that would have
to be loaded, or nest without end.
"""

from __future__ import annotations

from pathlib import Path

import h5py

from imuarray.errors import LogError
from imuarray.log.format import FORMAT

_FILTERS = frozenset({"gzip", "lzf", None})
_MAX_DEPTH = 4


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading; LogError if it is missing, truncated or something else."""
    if not path.is_file():
        raise LogError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}")
    try:
        return h5py.File(path, "r")
    except OSError as error:
        kind = "is truncated" if "truncated" in str(error) else "is no HDF5 file or is damaged"
        raise LogError(f"{path}: {kind}; a log is an HDF5 file of format {FORMAT!r}") from None


def refuse_hostile(group: h5py.Group, where: str, depth: int = 0) -> None:
    """LogError for anything that leads outside the file or declares what it does not hold."""
    if depth > _MAX_DEPTH:
        raise LogError(f"{where}: groups nested deeper than {_MAX_DEPTH}")
    for name in group:
        place = f"{where}: {group.name.rstrip('/')}/{name}"
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise LogError(f"{place}: a link that leads elsewhere; a log holds its own data")
        item = group[name]
        if isinstance(item, h5py.Group):
            refuse_hostile(item, where, depth + 1)
        elif not isinstance(item, h5py.Dataset):
            raise LogError(f"{place}: neither group nor dataset")
        elif item.external or item.is_virtual or item.compression not in _FILTERS:
            raise LogError(f"{place}: data stored outside the file or behind an unknown filter")
