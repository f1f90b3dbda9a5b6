"""Hostile logs: each kind is a good log that is modified, and the text of its refusal."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np

Spoil = Callable[[h5py.File], Any]
COUNTS = "sensors/Acc/counts"


def instead(name: str, data: Any) -> Spoil:
    """Another object in the place of a column."""

    def spoil(file: h5py.File) -> None:
        del file[name]
        file[name] = data

    return spoil


def made(shape: tuple[int, ...], kind: Any = "i2", name: str = COUNTS, **how: Any) -> Spoil:
    """Another dataset in its place."""

    def spoil(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, shape, kind, **how)

    return spoil


def intermediate(file: h5py.File) -> None:
    """A group on the way is in another file: `get("sensors/Acc", getlink=True)` would call it a plain link."""
    file.flush()
    shutil.copy(file.filename, Path(file.filename).with_name("other.h5"))
    del file["sensors"]
    file["sensors"] = h5py.ExternalLink("other.h5", "/sensors")


def outside(file: h5py.File) -> None:
    del file[COUNTS]
    file.create_dataset(COUNTS, (5, 3), "i2", external=[("/etc/passwd", 0, 30)])


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((5, 3), "i2")
    layout[:] = h5py.VirtualSource("/etc/passwd", "x", (5, 3))
    del file[COUNTS]
    file.create_virtual_dataset(COUNTS, layout)


def filtered(*numbers: int) -> Spoil:
    """A dataset behind filters that need not be there."""

    def spoil(file: h5py.File) -> None:
        del file[COUNTS]
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk((5, 3))
        for number in numbers:
            values = (1,) if number == h5py.h5z.FILTER_DEFLATE else ()
            creation.set_filter(number, h5py.h5z.FLAG_OPTIONAL, values)
        space = h5py.h5s.create_simple((5, 3))
        h5py.h5d.create(file["sensors/Acc"].id, b"counts", h5py.h5t.STD_I16LE, space, creation)

    return spoil


def nested(file: h5py.File) -> None:
    file.create_group("/".join(["a"] * 40))


def circles(file: h5py.File) -> None:
    """A thousand ways back to the beginning: four levels of them are a million million groups."""
    for number in range(1000):
        file[f"again{number}"] = file["/"]


def crowd(file: h5py.File) -> None:
    for number in range(5000):
        file.create_group(f"crowd/{number}")


def many_sensors(file: h5py.File) -> None:
    for number in range(612):
        file["sensors"].create_group(f"S{number}")


def alias(file: h5py.File) -> None:
    file["sensors/Acc/more"] = file[COUNTS]


def references(file: h5py.File) -> None:
    file["sensors/Acc/who"] = np.array([file[COUNTS].ref], h5py.ref_dtype)


def regions(file: h5py.File) -> None:
    file["sensors/Acc/where"] = np.array([file[COUNTS].regionref[:2]], h5py.regionref_dtype)


def varying(file: h5py.File) -> None:
    del file["sensors/Acc/status"]
    file.create_dataset("sensors/Acc/status", (5,), h5py.vlen_dtype(np.uint16))


def attribute(value: Callable[[h5py.File], Any], name: str = "sensors/Acc") -> Spoil:
    def spoil(file: h5py.File) -> None:
        file[name].attrs["extra"] = value(file)

    return spoil


def many_attributes(file: h5py.File) -> None:
    for number in range(300):
        file["sensors/Acc"].attrs[f"a{number}"] = number


def all_one_text(file: h5py.File) -> None:
    """Twenty thousand messages that are the same eight megabytes."""
    count = 20_000
    for name in ("time", "sensor", "kind", "message"):
        del file["events"][name]
    file["events/time"] = np.zeros(count, np.int64)
    for name in ("sensor", "kind"):
        file["events"].create_dataset(name, data=[""] * count, dtype=h5py.string_dtype())
    messages = file["events"].create_dataset("message", (count,), h5py.string_dtype())
    messages[0] = "x" * (1 << 23)
    file.flush()
    start = messages.id.get_offset()
    with Path(file.filename).open("r+b") as raw:
        raw.seek(start)
        first = raw.read(16)
        raw.seek(start)
        raw.write(first * count)


def named(name: bytes) -> Spoil:
    return lambda file: h5py.h5g.create(file.id, name)


KINDS: Mapping[str, tuple[Spoil, str]] = MappingProxyType(
    {
        "external link": (instead(COUNTS, h5py.ExternalLink("/etc/passwd", "/x")), "a link to another place"),
        "intermediate external link": (intermediate, "/sensors: a link to another place"),
        "soft link": (instead(COUNTS, h5py.SoftLink("/sensors/Gyro/counts")), "a link to another place"),
        "external raw storage": (outside, "data stored outside"),
        "virtual dataset": (virtual, "data stored outside"),
        "2 TB in no chunk": (made((1 << 39, 3), chunks=(4096, 3)), "declares 3298534883328 bytes"),
        "2 TB in no chunk, packed": (made((1 << 39, 3), chunks=(4096, 3), compression="gzip"), "declares 32985348"),
        "2 TB in one piece": (made((1 << 39, 3)), "declares 3298534883328 bytes"),
        "a chunk of 2 GB": (made((1 << 27, 3), chunks=(1 << 28, 3), maxshape=(None, 3)), "chunks of 1610612736"),
        "an item of 1 MB": (made((5,), "S1048576"), "1 dimensions of 1048576 bytes"),
        "thirty dimensions": (made((1,) * 30), "30 dimensions"),
        "unknown filter": (filtered(32100), "behind an unknown filter"),
        "a filter twice": (filtered(1, 1), "behind an unknown filter"),
        "deep nesting": (nested, "nested deeper than"),
        "groups in circles": (circles, "reached twice"),
        "a crowd of groups": (crowd, "more than 4096 groups and datasets"),
        "many sensors": (many_sensors, " sensors; at most 512"),
        "the same twice": (alias, "reached twice"),
        "named type": (lambda file: file.__setitem__("type", np.dtype("f8")), "neither group nor dataset"),
        "object references": (references, "sensors/Acc/who: neither numbers nor text"),
        "region references": (regions, "sensors/Acc/where: neither numbers nor text"),
        "rows of varying length": (varying, "sensors/Acc/status: neither numbers nor text"),
        "compound": (instead(COUNTS, np.zeros(5, [("x", "i2"), ("y", "i2")])), "neither numbers nor text"),
        "reference as attribute": (attribute(lambda file: file["/"].ref), "attribute extra: neither numbers nor text"),
        "varying attribute": (
            attribute(lambda file: np.array([np.arange(3), np.arange(2)], h5py.vlen_dtype(int))),
            "attribute extra: neither",
        ),
        "attribute of 32 MB": (attribute(lambda file: np.zeros(1 << 22)), " bytes of attributes; at most 4194304"),
        "attribute of many texts": (
            attribute(lambda file: ["x"] * 300, "/"),
            "/: attribute extra: more than 256 texts",
        ),
        "many attributes": (many_attributes, "attributes; at most 256"),
        "messages that are all one": (all_one_text, "events/message: texts of more than 16777216 bytes"),
        "a name that steers a terminal": (named(b"\x1b[2J"), r"/\x1b[2J: an invalid name"),
        "a name that is no text": (named(b"\xff\xfe"), r"an invalid name"),
        "a name without end": (named(b"x" * 5000), "an invalid name"),
    }
)


def damage_log(path: Path, kind: str) -> str:
    """Modify the good log at `path`; return the text of its refusal."""
    spoil, message = KINDS[kind]
    with h5py.File(path, "r+", libver="latest") as file:
        spoil(file)
    return message
