"""Golden conversations, and the two ways to replay one: against the driver, against the emulated chip.

A file's first line describes it; each further line is one transaction with the facts that it follows from, a wait, or
the meaning of the bytes. `mask` marks the bits of an answer that the facts settle: the driver receives `read`
unchanged, the chip has to agree in the masked bits. `after` names a conversation played before, `dirty` the writes by
which an earlier program left the chip changed, `played` the side that a file is for if it is for one alone.
"""

from __future__ import annotations

import errno
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_emulator.board import Pca9544aChip
from firmware_emulator.chips import CHIPS
from firmware_emulator.clock import VirtualClock
from firmware_emulator.wire import Wire
from imuarray.acquire.bus_segment import Pca9544a as MuxDriver
from imuarray.array import SensorConfig
from imuarray.drivers import driver_of
from imuarray.log.format import FLAGS

HERE = Path(__file__).parent
PATHS = sorted(HERE.glob("*.jsonl"))
MS = 1_000_000
POLL_NS = MS // 2
ROUNDING_NS = 1  # a clock counts whole nanoseconds
_PARTS = ("identify", "configure", "fetch", "drain", "select", "chip only")
_FACT = re.compile(r"\b(BMA|ADX|L3G|BMP|HMC|INV|TDK|LSM|LIS|MMC|AKM|PCA|DEC)-\d{2,3}\b")


class DifferenceError(Exception):
    """A driver or chip differs from a golden conversation; the message names file and line."""


@dataclass(frozen=True)
class Line:
    """One line of a file after the first: transaction, wait or meaning."""

    place: str
    content: dict[str, Any]

    @property
    def source(self) -> str:
        return str(self.content["source"])

    @property
    def wait_ns(self) -> int:
        """How long no transaction is made; 0 for a transaction."""
        return round(float(self.content.get("wait_ms", 0)) * MS)

    @property
    def meaning(self) -> bool:
        return "counts" in self.content

    @property
    def asked(self) -> tuple[int, bytes, int]:
        """Address, bytes out, number of bytes in."""
        return int(self.content["to"], 16), bytes.fromhex(self.content["write"]), len(self.read)

    @property
    def read(self) -> bytes:
        return bytes.fromhex(self.content.get("read", ""))

    @property
    def mask(self) -> bytes:
        return bytes.fromhex(self.content.get("mask", "ff" * len(self.read)))

    @property
    def refused(self) -> bool:
        """The address is not acknowledged."""
        return bool(self.content.get("nack"))


@dataclass(frozen=True)
class Conversation:
    """One file."""

    name: str
    head: dict[str, Any]
    lines: tuple[Line, ...]

    @property
    def part(self) -> str:
        return str(self.head["part"])

    @property
    def chip(self) -> str:
        return str(self.head["chip"])

    @property
    def address(self) -> int:
        return int(self.head["sensor"]["address"], 16)

    @property
    def sensor(self) -> SensorConfig:
        """The configuration for which a driver makes these transactions."""
        entry = {**self.head["sensor"], "address": self.address}
        for key in {"range", "rate_hz", "bandwidth_hz"} & entry.keys():
            entry[key] = float(entry[key])
        return SensorConfig(**entry)

    @property
    def transactions(self) -> tuple[Line, ...]:
        """Everything but the meaning."""
        return tuple(line for line in self.lines if not line.meaning)

    @property
    def before(self) -> Conversation | None:
        """The conversation before this."""
        return load(HERE / f"{self.head['after']}.jsonl") if "after" in self.head else None

    def is_for(self, side: str) -> bool:
        """Whether the driver (or the chip) is to replay this."""
        default = ("chip",) if self.part == "chip only" else ("driver", "chip")
        return side in self.head.get("played", default)


def load(path: Path) -> Conversation:
    """The conversation in `path`; DifferenceError if it is no such file or a line has no source."""
    contents = [json.loads(text) for text in path.read_text().splitlines()]
    lines = tuple(Line(f"{path.name}, line {number}", content) for number, content in enumerate(contents[1:], 2))
    for line in lines:
        if not _FACT.search(line.source):
            raise DifferenceError(f"{line.place}: the source has no id of a fact, such as LIS-14; a new prefix: _FACT")
        kinds = [kind for kind in ("write", "wait_ms", "counts") if kind in line.content]
        if len(kinds) != 1 or len(line.mask) != len(line.read):
            raise DifferenceError(
                f"{line.place}: neither transaction nor wait nor meaning, or a mask of another length"
            )
    conversation = Conversation(path.stem, contents[0], lines)
    if conversation.part not in _PARTS:
        raise DifferenceError(f"{path.name}: part {conversation.part!r}")
    return conversation


# Against the driver ---------------------------------------------------------------------------------------------------


class Script:
    """A bus that plays a conversation, and the clock of its driver; bus traffic takes no time."""

    def __init__(self, conversation: Conversation) -> None:
        self._at_ns = self._heard_ns = 0
        self.open(conversation)

    def open(self, conversation: Conversation) -> None:
        """Another conversation begins."""
        self._name, self._lines = conversation.name, list(conversation.transactions)

    def now_ns(self) -> int:
        return self._at_ns

    def sleep_until(self, at_ns: int) -> None:
        self._at_ns = max(self._at_ns, at_ns)

    def transfer(self, address: int, write: bytes = b"", read: int = 0) -> bytes:
        """The answer to the next transaction, which has to be this one."""
        asked = address, write, read
        self._waited()
        if not self._lines:
            raise DifferenceError(f"{self._name}: {_words(asked)} after the last line")
        line = self._lines.pop(0)
        if asked != line.asked:
            raise DifferenceError(f"{line.place}: {_words(line.asked)} expected, {_words(asked)} came ({line.source})")
        if line.refused:
            raise OSError(errno.EREMOTEIO, "nobody acknowledges")
        return line.read

    def finish(self) -> None:
        """DifferenceError unless every transaction was made and every wait kept."""
        self._waited()
        if self._lines:
            raise DifferenceError(f"{self._lines[0].place}: not said: {_words(self._lines[0].asked)}")

    def _waited(self) -> None:
        """Take the waits that are next, all of which must have passed since the last transaction."""
        while self._lines and (wait_ns := self._lines[0].wait_ns):
            line = self._lines.pop(0)
            self._heard_ns += wait_ns
            if self._at_ns < self._heard_ns - ROUNDING_NS:
                missing_ms = (self._heard_ns - self._at_ns) / MS
                raise DifferenceError(f"{line.place}: {missing_ms:g} ms too early ({line.source})")
        self._heard_ns = self._at_ns


def play_to_driver(conversation: Conversation) -> None:
    """Let the driver hold this conversation; DifferenceError where a transaction or a decoded value differs."""
    script = Script(conversation)
    if conversation.part == "select":
        mux = MuxDriver(script, conversation.address)
        for channel in conversation.head["channels"]:
            mux.select(channel)
        script.finish()
        return
    sensor = conversation.sensor
    driver = driver_of(sensor)(script, sensor, script)
    if (before := conversation.before) is not None:
        script.open(before)
        driver.configure()
        script.finish()
        script.open(conversation)
    if conversation.part == "identify":
        driver.identify()
    elif conversation.part == "configure":
        driver.configure()
    else:
        _fetch(driver, script, conversation)
    script.finish()


def _fetch(driver: Any, script: Script, conversation: Conversation) -> None:
    """Poll until every transaction is made, then compare the decoded values; a chip polled too early gives nothing."""
    (meaning,) = [line for line in conversation.lines if line.meaning]
    opening_ns = conversation.lines[0].wait_ns
    if opening_ns:  # the poll loop was late
        script.sleep_until(script.now_ns() + opening_ns)
    wanted = meaning.content["counts"] * meaning.content.get("times", 1)
    bursts = b""
    for _ in range(1000):
        bursts += driver.fetch()
        if len(bursts) >= driver.burst * len(wanted):
            break
        script.sleep_until(script.now_ns() + POLL_NS)
    decoded = driver.decode(np.frombuffer(bursts, np.uint8).reshape(-1, driver.burst))
    result = {"counts": decoded.counts.tolist()}
    result |= {name: ((decoded.status & FLAGS[name]) != 0).tolist() for name in ("stale", "saturated", "suspect")}
    if decoded.temperature_counts is not None:
        result["temperature_counts"] = decoded.temperature_counts.tolist()
    result |= {name: _numbers(values) for name, values in decoded.compensated.items()}
    meant = {key: value for key, value in meaning.content.items() if key not in ("source", "times")}
    for key, value in {**meant, "counts": wanted}.items():
        if result.get(key) != value:
            raise DifferenceError(f"{meaning.place}: {key} {result.get(key)}, expected {value} ({meaning.source})")


def _numbers(values: Any) -> list[float | None]:
    """A column as JSON has it: null for no number."""
    return [None if value != value else value for value in values.tolist()]


# Against the chip -----------------------------------------------------------------------------------------------------


class Still:
    """A sensing element without noise or imperfections with a constant input."""

    def __init__(self, world: dict[str, Any]) -> None:
        vector = next((value for key, value in world.items() if key.startswith("sensor_")), (0, 0, 0))
        self._vector = float(vector[0]), float(vector[1]), float(vector[2])
        self._degc, self._pascal = world.get("temperature_degc", 25.0), world.get("pressure_pa", 101325.0)

    def sample(self, at_ns: int, full_scale: float, bandwidth_hz: float) -> tuple[float, float, float]:
        return self._vector

    def temperature(self, at_ns: int) -> float:
        return float(self._degc)

    def pressure(self, at_ns: int) -> float:
        return float(self._pascal)


def play_to_chip(conversation: Conversation) -> None:
    """Play all transactions to a chip that was just switched on; DifferenceError where its answer differs."""
    clock = VirtualClock()
    wire = Wire(clock)
    element = Still(conversation.head["world"])
    if conversation.chip == "pca9544a":
        behind: dict[int, list[Any]] = {}
        for entry in conversation.head.get("behind", ()):
            behind.setdefault(entry["channel"], []).append(CHIPS[entry["chip"]](int(entry["address"], 16), element, 0))
        wire.connect_router(Pca9544aChip(conversation.address, behind))
    else:
        chip = CHIPS[conversation.chip](conversation.address, element, 0, **conversation.head.get("pins", {}))
        for entry in conversation.head.get("auxiliary", ()):  # on the bus of its own master
            chip.auxiliary.devices.append(CHIPS[entry["chip"]](int(entry["address"], 16), element, 0))
        wire.connect(chip)
    writes = [*(conversation.before or conversation).head.get("dirty", ())]
    if writes:
        clock.sleep_until(100 * MS)
    for text in writes:
        wire.transfer(conversation.address, bytes.fromhex(text))
    if writes:
        clock.sleep_until(1000 * MS)
    for part in (conversation.before, conversation):
        for line in part.transactions if part else ():
            _say(wire, clock, line)


def _say(wire: Wire, clock: VirtualClock, line: Line) -> None:
    if line.wait_ns:
        clock.sleep_until(clock.now_ns() + line.wait_ns)
        return
    try:
        answer = wire.transfer(*line.asked)
    except OSError:
        if line.refused:
            return
        raise DifferenceError(f"{line.place}: {_words(line.asked)}: nobody acknowledges ({line.source})") from None
    if line.refused:
        raise DifferenceError(f"{line.place}: {_words(line.asked)}: acknowledged, and should not be ({line.source})")
    settled = zip(answer, line.read, line.mask, strict=True)
    if any((result ^ expected) & mask for result, expected, mask in settled):
        expected = line.read.hex(" ")
        raise DifferenceError(
            f"{line.place}: {_words(line.asked)}: {answer.hex(' ')}, expected {expected} ({line.source})"
        )


def _words(asked: tuple[int, bytes, int]) -> str:
    address, write, read = asked
    return f"to {address:02x}: write [{write.hex(' ')}] read {read}"
