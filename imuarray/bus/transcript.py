"""Transcripts: every transaction of a bus as one line of JSON, and a bus that plays them back.

A line is ``{"to": "53", "write": "00", "read": "e5", "at_ns": 1200, "end_ns": 94950}``, bytes as hexadecimal digits;
a transaction that failed has ``"errno": 121`` in place of ``"read"``. A replayed bus refuses the first transaction
that differs, naming the line, so that a user's transcript can become a test.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from imuarray.bus.protocol import Bus, OpenBus
from imuarray.clock import Clock
from imuarray.errors import BusUrlError, OutputExistsError, SensorError


def open_output(path: Path, force: bool) -> IO[str]:
    """`path` for writing text; FileExistsError unless `force`."""
    return path.open("w" if force else "x", encoding="utf-8")


class RecordingBus:
    """Any open bus, with everything that passes written to a file."""

    def __init__(self, bus: OpenBus, path: str | PathLike[str], *, force: bool = False) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.source = bus.source
        try:
            self._file: IO[str] = open_output(Path(path), force)
        except FileExistsError:
            raise OutputExistsError(path) from None
        except OSError as error:
            raise BusUrlError(f"transcript {path}: can't be written: {error.strerror or error}") from None

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """See `Bus.transfer`."""
        return self._note("", self.bus, address, write, read)

    def channel_bus(self, path: str) -> Bus:
        """The bus at `path`, recorded into the same file."""
        return _RecordedChannel(self, path, self.bus.channel_bus(path))

    def _note(self, path: str, bus: Bus, address: int, write: bytes, read: int) -> bytes:
        line: dict[str, Any] = {"to": f"{address:02x}", "write": write.hex(), "at_ns": self.clock.now_ns()}
        if path:
            line["bus"] = path
        try:
            answer = bus.transfer(address, write, read)
            line["read"] = answer.hex()
            return answer
        except OSError as error:
            line.update(count=read, errno=error.errno)
            raise
        finally:
            if "read" in line or "errno" in line:  # a request that no adapter can send never went over the wire
                line["end_ns"] = self.clock.now_ns()
                self._file.write(json.dumps(line) + "\n")

    def __getattr__(self, name: str) -> Any:
        """What else the bus offers (an emulated one knows the truth)."""
        return getattr(self.bus, name)

    def __enter__(self) -> Self:
        self.bus.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
        self.bus.__exit__(kind, error, trace)


class _RecordedChannel:
    """A kernel-driven channel of a recorded bus."""

    def __init__(self, recording: RecordingBus, path: str, bus: Bus) -> None:
        self._recording, self._path, self._bus = recording, path, bus

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        return self._recording._note(self._path, self._bus, address, write, read)


class ReplayClock:
    """A clock that stands where the transcript stands."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """When the last transaction was recorded, or when the last sleep ended."""
        return self._now_ns

    def sleep_until(self, at_ns: int) -> None:
        """No need to wait."""
        self._now_ns = max(self._now_ns, at_ns)


class ReplayBus:
    """A transcript played back: gives the recorded answers, refuses whatever was not asked then."""

    source = "replay"

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = Path(path)
        self._clock = ReplayClock()
        self.clock: Clock = self._clock
        try:
            self._lines = self.path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            raise BusUrlError(f"replay:{path}: {getattr(error, 'strerror', None) or 'is not a transcript'}") from None
        self._transactions = self._parsed()
        self._at = 0

    def _parsed(self) -> Iterator[dict[str, Any]]:
        for number, line in enumerate(self._lines, start=1):
            self._at = number
            try:
                parsed = json.loads(line)
                parsed["to"], parsed["write"] = int(parsed["to"], 16), bytes.fromhex(parsed["write"])
                parsed["read"] = bytes.fromhex(parsed.get("read", ""))
                parsed["at_ns"], parsed["errno"] = int(parsed.get("at_ns", 0)), int(parsed.get("errno", 0))
                parsed["end_ns"] = int(parsed.get("end_ns", parsed["at_ns"]))
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
                raise BusUrlError(f"{self.path}, line {number}: not a transaction of a transcript") from None
            yield parsed

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """See `Bus.transfer`; SensorError at the first transaction that differs from the recorded one."""
        return self._play("", address, write, read)

    def channel_bus(self, path: str) -> Bus:
        """The replayed traffic of another bus that was recorded into the same transcript."""
        return _ReplayedChannel(self, path)

    def _play(self, path: str, address: int, write: bytes, read: int) -> bytes:
        recorded = next(self._transactions, None)
        if recorded is None:
            raise SensorError(f"{self.path}: the transcript ends after {len(self._lines)} transactions, more was asked")
        asked = (path, address, write, read)
        then = (
            recorded.get("bus", ""),
            recorded["to"],
            recorded["write"],
            recorded.get("count", len(recorded["read"])),
        )
        if asked != then:
            raise SensorError(f"{self.path}, line {self._at}: recorded {_words(*then)}, now {_words(*asked)}")
        self._clock.sleep_until(recorded["end_ns"])
        if recorded["errno"]:
            raise OSError(recorded["errno"], os.strerror(recorded["errno"]))
        answer: bytes = recorded["read"]
        return answer

    def finished(self) -> None:
        """SensorError if part of the transcript was never asked for."""
        if self._at < len(self._lines):
            raise SensorError(f"{self.path}: {len(self._lines) - self._at} recorded transactions were not repeated")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is held open."""


class _ReplayedChannel:
    """A kernel-driven channel of a replayed bus."""

    def __init__(self, replay: ReplayBus, path: str) -> None:
        self._replay, self._path = replay, path

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        return self._replay._play(self._path, address, write, read)


def _words(path: str, address: int, write: bytes, read: int) -> str:
    """A transaction in words."""
    where = f"{path} " if path else ""
    return f"{where}{address:#04x} write {write.hex() or 'nothing'} read {read}"
