"""A transcript played back (`imuarray.bus.transcript`)."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import IO, Any, Self

from imuarray.bus.protocol import Bus, SpiPort
from imuarray.bus.transcript import LONGEST_LINE
from imuarray.clock import Clock
from imuarray.errors import BusUrlError, SensorError
from imuarray.printable import printable

_MOST_NS = 1 << 63
_MOST_ERRNO = 4095


class ReplayClock:
    """A clock that shows the times that were recorded in the transcript."""

    def __init__(self) -> None:
        self._now_ns = 0
        self._seen_ns: deque[int] = deque()

    def now_ns(self) -> int:
        """Return the recorded reading of the clock; without one, the end of the last transaction or sleep."""
        if self._seen_ns:
            self._now_ns = max(self._now_ns, self._seen_ns.popleft())
        return self._now_ns

    def sleep_until(self, at_ns: int) -> None:
        """Do nothing: a replay needs no wait."""
        self._now_ns = max(self._now_ns, at_ns)

    def stand(self, at_ns: int, seen_ns: list[int]) -> None:
        """Note the end of a transaction, and the readings of the clock before the next one."""
        self._now_ns = max(self._now_ns, at_ns)
        self._seen_ns = deque(seen_ns)


class ReplayBus:
    """A bus that returns the answers of a transcript and refuses other requests. `epoch` is the wall time at which its
    log began, once the replay has reached it; `stopped` is True once it has reached the end of the recorded program.
    """

    source = "replay"

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = Path(path)
        self._clock = ReplayClock()
        self.clock: Clock = self._clock
        self._played = 0
        self._at_line = 0
        self._asked = 0
        self.epoch: datetime | None = None
        self.stopped = False
        self._failure: SensorError | BusUrlError | None = None
        try:
            self._file: IO[str] = self.path.open(encoding="utf-8")
        except OSError as error:
            raise BusUrlError(f"replay:{path}: {error.strerror or error}") from None
        try:
            self._next = self._read()
        except (OSError, UnicodeDecodeError) as error:
            self._file.close()
            raise BusUrlError(f"replay:{path}: {getattr(error, 'strerror', None) or 'is not a transcript'}") from None
        self._show_ahead(0)
        if self._next and "claim" in self._next:  # otherwise the transcript has no owners of addresses
            self.claim = self._claim

    def _read(self) -> dict[str, Any] | None:
        """Return the next line after an epoch, which is noted; None after the last line, empty for a line that is not a
        transaction.
        """
        while text := self._file.readline(LONGEST_LINE):
            self._at_line += 1
            try:
                line = json.loads(text)
                if "epoch" not in line:
                    return _parse_line(line)
                self.epoch = datetime.fromisoformat(line["epoch"])
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
                return {}
        return None

    def _show_ahead(self, end_ns: int) -> None:
        self._clock.stand(end_ns, self._next.get("seen_ns", []) if self._next else [])

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """Transfer as `Bus.transfer`; SensorError at the first transaction that differs from the recorded one."""
        return self._play("", address, write, read)

    def stopping(self, stopped: Callable[[], bool]) -> Callable[[], bool]:
        """Return a function that is True if `stopped` is, or if the recorded program was stopped at this line."""

        def asked() -> bool:
            self._asked += 1
            wanted = self._next.get("stopped") if self._next else None
            if wanted is not None and self._next and self._asked >= wanted:
                self._go_on(self._next["end_ns"])
                self.stopped = True
            return self.stopped or stopped()

        return asked

    def channel_bus(self, path: str) -> Bus:
        """Return the replayed traffic of another bus that was recorded into the same transcript."""
        return _ReplayedChannel(self, path)

    def spi_port(self, path: str, mode: int, clock_hz: int) -> SpiPort:
        """Return the replayed traffic of a chip select."""
        return _ReplayedPort(self, path)

    def _play(self, path: str, address: int, write: bytes, read: int) -> bytes:
        asked = _words(path, address, write, read)
        recorded = self._line(asked)
        if recorded["errno"]:
            raise OSError(recorded["errno"], recorded.get("error") or os.strerror(recorded["errno"]))
        answer: bytes = recorded["read"]
        return answer

    def _claim(self, address: int, path: str | None = None) -> None:
        recorded = self._line(_read_claim(path or "", address))
        if "error" in recorded:
            raise SensorError(recorded["error"])
        if recorded["errno"]:
            raise OSError(recorded["errno"], os.strerror(recorded["errno"]))

    def _line(self, asked: str) -> dict[str, Any]:
        """Return the next line if it equals the present request. Raises the first difference, and the same again at
        later requests.
        """
        if self._failure is None:
            try:
                return self._check_line(asked)
            except (SensorError, BusUrlError) as error:
                self._failure = error
        raise self._failure

    def _check_line(self, asked: str) -> dict[str, Any]:
        recorded = self._next
        if recorded is None or (recorded and "words" not in recorded):
            raise SensorError(
                f"{self.path}: the transcript ends after {self._played} transactions, but more were requested"
            )
        self._played += 1
        if not recorded:
            raise BusUrlError(f"{self.path}, line {self._at_line}: not a transaction of a transcript")
        if asked != recorded["words"]:
            raise SensorError(
                f"{self.path}, line {self._at_line}: recorded {recorded['words']}, now {asked};"
                " replay with the configuration and the options of the recording"
            )
        self._go_on(recorded["end_ns"])
        return recorded

    def _go_on(self, end_ns: int) -> None:
        """Advance to the next line; the previous transaction ended at `end_ns`."""
        self._asked = 0
        try:
            self._next = self._read()
        except (OSError, UnicodeDecodeError):
            self._next = {}
        self._show_ahead(end_ns)

    def finished(self) -> None:
        """Raise SensorError if part of the transcript was not requested."""
        remaining = 0
        while self._next is not None:
            remaining += not self._next or "words" in self._next
            self._next = self._read()
        if remaining:
            raise SensorError(f"{self.path}: {remaining} recorded transactions were not repeated")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()


class _ReplayedChannel:
    """A kernel-driven channel of a replayed bus."""

    def __init__(self, replay: ReplayBus, path: str) -> None:
        self._replay, self._path = replay, path

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        return self._replay._play(self._path, address, write, read)


class _ReplayedPort:
    """A chip select of a replayed bus."""

    def __init__(self, replay: ReplayBus, path: str) -> None:
        self._replay, self._path = replay, path

    def exchange(self, sent: bytes) -> bytes:
        return self._replay._play(self._path, 0, sent, len(sent))


def _parse_line(line: dict[str, Any]) -> dict[str, Any]:
    """Return a line with its numbers; ValueError, KeyError, TypeError, AttributeError or OverflowError if invalid."""
    at_ns = _time(line.get("at_ns", 0))
    call = {
        "end_ns": _time(line.get("end_ns", at_ns)),
        "seen_ns": [at_ns - _time(stamp) for stamp in line.get("seen", [])],
    }
    if "stopped" in line:
        return call | {"stopped": _time(line["stopped"])}
    if "seen" in line and "to" not in line and "claim" not in line:
        return call
    path, number = line.get("bus", ""), int(line.get("errno", 0))
    if "error" in line:
        call["error"] = printable(str(line["error"]))
    if not isinstance(path, str) or not 0 <= number <= _MOST_ERRNO:
        raise ValueError(line)
    call["errno"] = number
    if "claim" in line:
        words = _read_claim(path, int(line["claim"], 16))
        return call | {"claim": True, "words": words}
    answer = bytes.fromhex(line.get("read", ""))
    count = int(line.get("count", len(answer)))
    words = _words(path, int(line["to"], 16), bytes.fromhex(line["write"]), count)
    return call | {"words": words, "read": answer}


def _time(value: Any) -> int:
    time_ns = int(value)
    if abs(time_ns) >= _MOST_NS:
        raise OverflowError(value)
    return time_ns


def _words(path: str, address: int, write: bytes, read: int) -> str:
    where = f"{path} " if path else ""
    return f"{where}{address:#04x} write {write.hex() or 'nothing'} read {read}"


def _read_claim(path: str, address: int) -> str:
    where = f"{path} " if path else ""
    return f"{where}{address:#04x}: owner query"
