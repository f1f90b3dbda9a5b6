"""A recording of the emulated array with faults into memory: the content of a log, without its file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from firmware_emulator.array import EmulatedBus, open_array
from firmware_emulator.board import Board
from firmware_emulator.faults import faults_from
from firmware_emulator.faulty_board import with_faults
from imuarray.acquire import fault_episode
from imuarray.acquire.bus_segment import connect
from imuarray.acquire.recorder import Poll
from imuarray.acquire.recording import RecordingCounts, RecordingOptions
from imuarray.array import ArrayConfig, parse_array
from imuarray.log.format import Event
from imuarray.log.writer import Block

SENSORS = {
    "A": 'chip="adxl345"\naddress=0x53\nrange=4\nrate_hz=800\n',
    "B": 'chip="bma180"\naddress=0x40\nrange=2\n',
    "C": 'chip="bma180"\naddress=0x40\nrange=16\n',
    "G": 'chip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz=800\nbandwidth_hz=110\n',
    "H": 'chip="l3g4200d"\naddress=0x68\nrange=250\nrate_hz=800\nbandwidth_hz=110\n',
    "M": 'chip="hmc5883"\naddress=0x1E\nrange=1.2\nrate_hz=75\n',
    "P": 'chip="bmp180"\naddress=0x77\nrate_hz=8\n',
    "Q": 'chip="l3g4200d"\naddress=0x69\nrange=250\nrate_hz=100\nbandwidth_hz=25\nfifo=true\n',
}


def array_of(**channels: int | None) -> ArrayConfig:
    """``array_of(A=0, B=1)``: these sensors on these channels (None: on the trunk), named after their kind."""
    text = '[array]\nname="a"\nmux={chip="pca9544a",address=0x70}\n'
    for name, channel in channels.items():
        text += f'[[sensor]]\nname="{name}"\n{SENSORS[name[0]]}' + ("" if channel is None else f"channel={channel}\n")
    return parse_array(text)


@dataclass
class Memory:
    """The calls of a `LogWriter`, kept in memory."""

    blocks: dict[str, list[Block]] = field(default_factory=lambda: defaultdict(list))
    events: list[Event] = field(default_factory=list)
    rows: list[Any] = field(default_factory=list)

    def append(self, sensor: str, block: Block) -> None:
        self.blocks[sensor].append(block)

    def event(self, event: Event) -> None:
        self.events.append(event)

    def clocks(self, row: Any) -> None:
        self.rows.append(row)

    def stimulus(self, name: str, rows: Any) -> None:
        pass

    def keep(self) -> None:
        pass

    def of(self, sensor: str, column: str) -> npt.NDArray[Any]:
        """One column of a sensor, all blocks."""
        return np.concatenate([getattr(block, column) for block in self.blocks[sensor]])

    def times_of(self, kind: str, sensor: str = "") -> npt.NDArray[np.int64]:
        """When events of that kind happened to that sensor."""
        return np.array([event.time_ns for event in self.events if (event.kind, event.sensor) == (kind, sensor)])


@dataclass
class Night:
    """A log, its counts, and the time of power-on of the array, in the log's time."""

    log: Memory
    summary: RecordingCounts
    powered_on_ns: int
    bus: EmulatedBus


def night(
    array: ArrayConfig,
    faults: Sequence[Mapping[str, Any]],
    seconds: float,
    *,
    rate_hz: float = 20.0,
    log: Memory | None = None,
    judge: Any = None,
    stopped: Callable[[], bool] = lambda: False,
    each: bool = False,
    **settings: Any,
) -> Night:
    """Record `array` for `seconds` while `faults` (tables as in their TOML) happen; with `each` every episode of a
    fault is reported that is a second after the last, though it is intermittent.
    """
    board = with_faults(Board, faults_from({"fault": list(faults)}, array))
    memory = Memory() if log is None else log
    with open_array(array, board=board, **settings) as bus:
        stations = connect(array, bus)
        epoch_ns = bus.clock.now_ns()
        wall = datetime(2026, 3, 1, tzinfo=UTC)
        options = RecordingOptions(rate_hz, wall_time=wall, judge=judge)
        poll = Poll(stations, bus, memory, options, epoch_ns)  # type: ignore[arg-type]
        poll.truth = None
        with patch.object(
            fault_episode, "LONGEST_QUIET_NS", fault_episode.QUIET_NS if each else fault_episode.LONGEST_QUIET_NS
        ):
            poll.run(seconds, stopped)
    return Night(memory, poll.summary, -epoch_ns, bus)
