"""Checksums of the parts of a finished log that HDF5 does not protect: texts, and the tables of phases and events.

HDF5 protects its own structures, and `fletcher32` the chunks of columns. Texts of varying length are stored in heaps
without a checksum, and short tables contiguously in the file. A finished log therefore stores checksums of these parts
as they were written. Attributes that other programs add are ignored.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from imuarray.log.format import THERMOMETER_ATTRIBUTES
from imuarray.log.untrusted_input import DAMAGE, read_texts

CHECK_SUMS = "text_crc32"
"""The root attribute: a CRC-32 for each of `PARTS`."""

_LOG = ("format", "epoch", "source", "config", "software", "Conventions", "NX_class")
_SENSOR = ("chip", "quantity", "unit", "axes", "columns", "NX_class", *THERMOMETER_ATTRIBUTES)
_TABLES: Mapping[str, Sequence[str]] = {
    "phases": ("start", "end", "name", "up"),
    "events": ("time", "sensor", "kind", "message"),
}
PARTS = ("attributes", *_TABLES)


def check_sums(file: Any) -> list[int]:
    """Return the CRC-32 of the attributes, the phases and the events of an open HDF5 file; on damage h5py raises its
    own errors.
    """
    crcs = [0, *(_crc(_column(file[table][name]) for name in names) for table, names in _TABLES.items())]
    attributes = [_attributes(file.attrs, _LOG)]
    for name in sorted(file["sensors"]):
        group = file["sensors"][name]
        attributes += [name.encode(), _attributes(group.attrs, _SENSOR), _column(group["axis"])]
    crcs[0] = _crc(iter(attributes))
    return crcs


def changed_parts(file: Any) -> list[str]:
    """Return the `PARTS` that differ from what was written; none for a log without checksums."""
    written = file.attrs.get(CHECK_SUMS)
    if not isinstance(written, np.ndarray) or written.shape != (len(PARTS),):
        return []
    try:
        return [part for part, crc, was in zip(PARTS, check_sums(file), written.tolist(), strict=True) if crc != was]
    except DAMAGE:
        return ["attributes, phases or events"]


def _crc(parts: Iterator[bytes]) -> int:
    crc = 0
    for part in parts:
        crc = zlib.crc32(part + b"\0", crc)
    return crc


def _attributes(attributes: Mapping[str, Any], names: Sequence[str]) -> bytes:
    """Return the values of the attributes of these names that exist."""
    return b"\0".join(
        b"\1".join([name.encode(), *map(_bytes, np.ravel(attributes[name]))]) for name in names if name in attributes
    )


def _column(column: Any) -> bytes:
    """Read a whole column of numbers or texts."""
    if column.dtype.kind != "O":
        return np.ascontiguousarray(column[:]).tobytes()
    return b"\1".join(map(_bytes, read_texts(column)))


def _bytes(value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogateescape")
