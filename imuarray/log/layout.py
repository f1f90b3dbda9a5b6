"""Which columns a log has: groups of equally long columns, and how a stretch of rows of a group stands as bytes.

A block of rows is its columns one after the other, little-endian, in the order of the group. The order of the groups is
that of the sensors, then those of `TRACK_COLUMNS` and `notes` (phases and events, a line of JSON each, as bytes).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.errors import LogError
from imuarray.log.format import ClockRow, Event, Phase, SensorHeader
from imuarray.log.untrusted_input import check_note

CHUNK = 4096
"""Rows per chunk: about 40 s at 100 Hz; 24 KiB of counts."""

Columns = Mapping[str, npt.NDArray[Any]]
"""The columns of a stretch of rows."""

NOTES = "notes"
_TEXT = "text"


@dataclass(frozen=True)
class Group:
    """Equally long columns; each is (name, little-endian type, shape of a row)."""

    path: str
    columns: tuple[tuple[str, str, tuple[int, ...]], ...]

    @property
    def row_bytes(self) -> int:
        """Bytes of one row, all columns together."""
        return sum(np.dtype(kind).itemsize * math.prod(tail) for _, kind, tail in self.columns)

    def checked(self, columns: Columns) -> dict[str, npt.NDArray[Any]]:
        """The columns in order and in their types; ValueError unless they are these, of one length."""
        names = {name for name, _, _ in self.columns}
        if columns.keys() != names or len({len(rows) for rows in columns.values()}) != 1:
            came = ", ".join(f"{name} {len(rows)}" for name, rows in columns.items())
            wanted = ", ".join(name for name, _, _ in self.columns)
            raise ValueError(f"/{self.path}: columns {wanted} of one length; came {came}")
        checked = {name: np.ascontiguousarray(columns[name], kind) for name, kind, _ in self.columns}
        for name, _, tail in self.columns:
            if checked[name].shape[1:] != tail:
                raise ValueError(f"/{self.path}: column {name}: rows of shape {tail}; came {checked[name].shape[1:]}")
        return checked

    def encode(self, columns: Columns) -> bytes:
        """`checked` columns as bytes."""
        return b"".join([columns[name].tobytes() for name, _, _ in self.columns])

    def decode(self, payload: bytes | memoryview, rows: int) -> dict[str, npt.NDArray[Any]]:
        """The columns of `rows` rows, without copying."""
        columns, start = {}, 0
        for name, kind, tail in self.columns:
            count = rows * math.prod(tail)
            columns[name] = np.frombuffer(payload, kind, count, start).reshape(rows, *tail)
            start += count * np.dtype(kind).itemsize
        return columns

    def joined(self, parts: Sequence[Columns]) -> dict[str, npt.NDArray[Any]]:
        """Stretches one after the other; empty columns if there is none."""
        return {
            name: np.concatenate([np.empty((0, *tail), kind), *(part[name] for part in parts)])
            for name, kind, tail in self.columns
        }


_Columns = tuple[tuple[str, str, tuple[int, ...]], ...]

STIMULUS: _Columns = (
    ("time", "<i8", ()),
    ("specific_force", "<f8", (3,)),
    ("angular_rate", "<f8", (3,)),
    ("temperature", "<f8", ()),
)
CLOCKS: _Columns = tuple((name.removesuffix("_ns"), "<i8", ()) for name in ClockRow._fields)

TRACK_COLUMNS: Mapping[str, _Columns] = MappingProxyType({"truth": STIMULUS, "reference": STIMULUS, "clocks": CLOCKS})
"""The groups that a log may have besides its sensors; a group exists if it has rows."""

TRACK_UNITS: Mapping[str, str] = MappingProxyType(
    {"specific_force": "m s-2", "angular_rate": "rad s-1", "temperature": "degC"}
    | {name: "ns" for name, _, _ in CLOCKS if name != "time"}
)
"""What the columns of these groups are in; `time` is in ns since the epoch."""

STIMULI = ("truth", "reference")


def sensor_group(header: SensorHeader) -> Group:
    """The columns of `/sensors/<NAME>`."""
    width = (len(header.columns),)
    counts = "<i2" if header.columns == ("x", "y", "z") else "<i4"
    columns: _Columns = (("time", "<i8", ()), ("counts", counts, width), ("status", "<u2", ()))
    if header.has_temperature:
        columns += (("temperature_counts", "<i2", ()),)
    return Group(f"sensors/{header.name}", (*columns, *((name, "<f8", ()) for name in header.compensated)))


def groups_of(sensors: Iterable[SensorHeader]) -> tuple[Group, ...]:
    """All groups of a log with these sensors, in their order."""
    beside = (Group(name, columns) for name, columns in TRACK_COLUMNS.items())
    return (*(sensor_group(header) for header in sensors), *beside, Group(NOTES, ((_TEXT, "<u1", ()),)))


class OpenPhase(NamedTuple):
    """A phase that has begun and whose end is not known yet; `end_ns` is when it ends at the latest."""

    start_ns: int
    end_ns: int
    name: str
    up: str = ""


@dataclass
class Notes:
    """What was noted of a log."""

    phases: list[Phase] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    begun: list[OpenPhase] = field(default_factory=list)

    def add(self, columns: Columns) -> None:
        """Read rows of the group `notes`; LogError."""
        try:
            for line in np.asarray(columns[_TEXT], np.uint8).tobytes().decode("ascii").splitlines():
                ((kind, fields),) = json.loads(line).items()
                check_note(fields, 1 if kind == "event" else 2)
                if kind == "phase":
                    self.phases.append(Phase(*fields))
                elif kind == "event":
                    self.events.append(Event(*fields))
                else:
                    self.begun.append(OpenPhase(*fields))
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
            raise LogError(f"phases and events can't be read: {error}") from None

    def phases_until(self, end_ns: int) -> list[Phase]:
        """All phases of a log that ends at `end_ns`; one that was never ended goes on so far."""
        ended = {(phase.start_ns, phase.name) for phase in self.phases}
        open_ended = (begun for begun in self.begun if (begun.start_ns, begun.name) not in ended)
        lasting = (Phase(*begun)._replace(end_ns=min(begun.end_ns, end_ns)) for begun in open_ended)
        return [*self.phases, *(phase for phase in lasting if phase.end_ns > phase.start_ns)]


def note_columns(note: Phase | Event | OpenPhase) -> dict[str, npt.NDArray[np.uint8]]:
    """A note as rows of the group `notes`."""
    kind = "phase" if isinstance(note, Phase) else "event" if isinstance(note, Event) else "begun"
    line = json.dumps({kind: note}, default=lambda number: number.item()) + "\n"
    return {_TEXT: np.frombuffer(line.encode("ascii"), np.uint8)}
