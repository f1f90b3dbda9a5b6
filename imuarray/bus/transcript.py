"""Transcripts: every transaction of a bus as one line of JSON, and a bus that records them.

A line is ``{"to": "53", "write": "00", "read": "e5", "at_ns": 1200, "end_ns": 94950}``, bytes as hexadecimal digits. A
transaction that failed has ``"errno": 121`` in place of ``"read"``, and ``"error"`` if the bus has its own message. A
query for the owner of an address (`claim`) is ``{"claim": "53", ...}``, with the answer as ``"errno"`` or ``"error"``
if it was not "yours". ``"seen"`` are the times at which the program read the clock before that line, in ns before its
``at_ns``: a replay returns the same times, so that the program makes the same decisions. ``{"epoch":
"2026-03-01T00:00:00+00:00"}`` is the wall time at which a log began; ``{"stopped": 2, ...}`` means that the second
query for a stop since the previous line was answered with yes. A replayed bus refuses the first transaction that
differs, and names its line, so that a user's transcript can become a test.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from imuarray.bus.protocol import Bus, OpenBus, SpiPort
from imuarray.clock import Clock, MonotonicClock
from imuarray.errors import BusUrlError, OutputExistsError, SensorError

LONGEST_LINE = 1 << 17
"""Largest length of a line in characters; a message carries at most 8192 bytes (LNX-05)."""
_MOST = 1 << 63


def open_output(path: Path, force: bool) -> IO[str]:
    """Open `path` for writing text; FileExistsError unless `force`."""
    return path.open("w" if force else "x", encoding="utf-8")


class _Notes:
    """The readings of the clock since the last line, and the time at which a replayed clock would stand still."""

    def __init__(self) -> None:
        self.standing_ns = -_MOST
        self._seen: list[int] = []
        self._moved = False

    def saw(self, now_ns: int) -> None:
        self._seen.append(now_ns)
        self._moved |= now_ns != self.standing_ns

    def stand(self, at_ns: int) -> None:
        self.standing_ns = max(self.standing_ns, at_ns)

    def take(self, at_ns: int) -> list[int]:
        """Return the readings in ns before `at_ns`; none if a clock that stands still would have returned the same."""
        seen = [at_ns - stamp for stamp in self._seen] if self._moved else []
        self._seen, self._moved = [], False
        return seen


class _NotedClock:
    """A clock that records each reading of another one. It is not virtual: it is replayed as a clock of real time, and
    the recording that replays it has to read it as often.
    """

    is_virtual = False

    def __init__(self, clock: Clock, notes: _Notes) -> None:
        self._clock, self._notes = clock, notes

    def now_ns(self) -> int:
        """See `Clock`."""
        now_ns = self._clock.now_ns()
        self._notes.saw(now_ns)
        return now_ns

    def sleep_until(self, at_ns: int) -> None:
        """See `Clock`."""
        self._clock.sleep_until(at_ns)
        self._notes.stand(at_ns)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._clock, name)


class _NotedMonotonicClock(_NotedClock, MonotonicClock):
    """The machine's own clock, recorded."""


class RecordingBus:
    """An open bus that records its traffic in a file. `failed` is the reason why the file could not be written any
    more; the recording continues. `remark` is a remark for the user on the transcript of this bus.

    Through it a microcontroller executes one transaction at a time and does not stream.
    """

    def __init__(self, bus: OpenBus, path: str | PathLike[str], *, force: bool = False) -> None:
        self.bus = bus
        self._notes = _Notes()
        kind = _NotedMonotonicClock if isinstance(bus.clock, MonotonicClock) else _NotedClock
        self.clock: Clock = kind(bus.clock, self._notes)
        self.source = bus.source
        self.path = Path(path)
        self.failed = ""
        self._asked = 0
        try:
            self._file: IO[str] = open_output(self.path, force)
        except FileExistsError:
            raise OutputExistsError(path) from None
        except OSError as error:
            raise BusUrlError(f"transcript {path}: can't be written: {error.strerror or error}") from None

    @property
    def remark(self) -> str:
        """Return one line, or ""."""
        if self.source != "serial":
            return ""
        return (
            f"{self.path}: while a transcript is written, the microcontroller executes one transaction at a time and"
            " does not stream"
        )

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """See `Bus.transfer`."""
        return self._note("", self.bus, address, write, read)

    def channel_bus(self, path: str) -> Bus:
        """Return the bus at `path`, recorded into the same file."""
        return _RecordedChannel(self, path, self.bus.channel_bus(path))

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the chip select at `path`, recorded into the same file as transactions with the address 0."""
        return _RecordedPort(self, path, self.bus.spi_port(path, mode, clock_hz))

    def _note(self, path: str, bus: Bus, address: int, write: bytes, read: int) -> bytes:
        line: dict[str, Any] = {"to": f"{address:02x}", "write": write.hex(), "at_ns": self.bus.clock.now_ns()}
        if path:
            line["bus"] = path
        try:
            answer = bus.transfer(address, write, read)
            line["read"] = answer.hex()
            return answer
        except OSError as error:
            line.update(count=read, errno=error.errno)
            if error.errno and error.strerror != os.strerror(error.errno):
                line["error"] = str(error.strerror)
            raise
        finally:
            if "read" in line or "errno" in line:  # a request that no adapter can send was not transferred
                self._write(line)

    def _claim(self, address: int, path: str | None = None) -> None:
        line: dict[str, Any] = {"claim": f"{address:02x}", "at_ns": self.bus.clock.now_ns()}
        if path:
            line["bus"] = path
        try:
            self.bus.claim(address, path)  # type: ignore[attr-defined]  # checked by `__getattr__`
        except OSError as error:
            line["errno"] = error.errno
            raise
        except SensorError as error:
            line["error"] = str(error)
            raise
        finally:
            self._write(line)

    def begins(self, epoch: datetime) -> None:
        """Note that a log begins now, at this wall time."""
        self._put({"epoch": epoch.astimezone(UTC).isoformat()})

    def stopping(self, stopped: Callable[[], bool]) -> Callable[[], bool]:
        """Return `stopped`, recorded when it is first True."""
        inner = getattr(self.bus, "stopping", None)
        stopped = inner(stopped) if inner else stopped
        is_noted = False

        def asked() -> bool:
            nonlocal is_noted
            self._asked += 1
            if not is_noted and stopped():
                is_noted = True
                self._write({"stopped": self._asked, "at_ns": self.bus.clock.now_ns()})
            return is_noted

        return asked

    def _write(self, line: dict[str, Any]) -> None:
        line["end_ns"] = self.bus.clock.now_ns()
        seen = self._notes.take(line["at_ns"])
        if seen:
            line["seen"] = seen
        self._notes.stand(line["end_ns"])
        self._asked = 0
        self._put(line)

    def _put(self, line: dict[str, Any]) -> None:
        """Write a line; a failure of the file is no failure of the bus."""
        if self.failed:
            return
        try:
            self._file.write(json.dumps(line) + "\n")
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self.failed = f"transcript {self.path}: not complete: {error.strerror or error}"

    def __getattr__(self, name: str) -> Any:
        """Return other attributes of the bus (an emulated one has the truth)."""
        offered = getattr(self.bus, name)
        return self._claim if name == "claim" else offered

    def __enter__(self) -> Self:
        self.bus.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        at_ns = self.bus.clock.now_ns()
        seen = self._notes.take(at_ns)
        try:
            if seen and not self.failed:
                self._file.write(json.dumps({"seen": seen, "at_ns": at_ns}) + "\n")
            self._file.close()
        except OSError as failure:
            self._give_up(failure)
        self.bus.__exit__(kind, error, trace)


class _RecordedChannel:
    """A kernel-driven channel of a recorded bus."""

    def __init__(self, recording: RecordingBus, path: str, bus: Bus) -> None:
        self._recording, self._path, self._bus = recording, path, bus

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        return self._recording._note(self._path, self._bus, address, write, read)


class _RecordedPort:
    """A chip select of a recorded bus; as a `Bus` it writes and reads at the same time."""

    def __init__(self, recording: RecordingBus, path: str, port: SpiPort) -> None:
        self._recording, self._path, self._port = recording, path, port

    def exchange(self, sent: bytes) -> bytes:
        return self._recording._note(self._path, self, 0, sent, len(sent))

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        return self._port.exchange(write)
