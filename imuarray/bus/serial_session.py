"""One conversation with a microcontroller: commands and their answers, and whatever else comes in between.

What is read is sorted as it arrives: answers wait for whoever asked, data for whoever collects it, with the counter's
time widened. Every arrival tells something about the microcontroller's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
import numpy.typing as npt

from imuarray.bus import serial_link as link
from imuarray.bus.serial_clock import ClockFit, Widened
from imuarray.bus.serial_link import Capacity, Frame, LinkError
from imuarray.bus.serial_port import Port, port_errors
from imuarray.clock import Clock, sleep_for

ANSWER_S = 0.25
"""A microcontroller that has not answered for so long is asked again."""
TRIES = 3
PATIENCE_S = 4.0
"""Opening the port resets many boards, whose boot loader then waits for two seconds."""
PINGS = 8
PING_S = 0.04
"""Between them: a third of a second tells how fast the microcontroller's clock runs, to a part in ten thousand."""
DRAIN_READS = 64


class Session:
    """With whoever is on the port that `open_port` opens; LinkError if that is nobody who speaks the link.

    `clock` is the host's, `fit` leads to it from the microcontroller's; `skipped` counts bytes that belonged to no
    frame, `started_us` is when the last START was answered.
    """

    def __init__(self, open_port: Callable[[], Port], clock: Clock, patience_s: float) -> None:
        self.clock = clock
        self.fit = ClockFit()
        self.skipped = 0
        self._open_port = open_port
        self._sequence = 0
        self._answers: list[Frame] = []
        self._data: list[Frame] = []
        self._data_us: list[npt.NDArray[np.int64]] = []
        self.port = open_port()
        try:
            self.capacity = self._greet(patience_s)
        except BaseException:
            self.port.close()
            raise

    def reconnect(self, patience_s: float) -> None:
        """Open the port anew and begin from the beginning; LinkError."""
        with suppress(LinkError), port_errors():
            self.port.close()
        with port_errors():
            self.port = self._open_port()
        self.capacity = self._greet(patience_s)

    def _greet(self, patience_s: float) -> Capacity:
        """HELLO until somebody answers, then a few times more to see how long an answer takes."""
        self._deframer = link.Deframer()
        self._forget()
        until_ns = self.clock.now_ns() + round(patience_s * 1e9)
        while True:
            try:
                self.ask(link.HELLO)
                break
            except LinkError:
                if self.clock.now_ns() >= until_ns:
                    raise
                sleep_for(self.clock, PING_S)
        self._forget()
        trips_ns = []
        for _ in range(PINGS):
            sleep_for(self.clock, PING_S)
            begun_ns = self.clock.now_ns()
            answer = self.ask(link.HELLO)
            trips_ns.append(self.clock.now_ns() - begun_ns)
        self.fit.latency_ns = min(trips_ns) // 2
        capacity = link.capacity_of(answer.payload)
        if capacity.version != link.VERSION:
            raise LinkError(f"the microcontroller speaks version {capacity.version} of the link, not {link.VERSION}")
        return capacity

    def _forget(self) -> None:
        """What came before belongs to another session, perhaps to another life of the microcontroller."""
        self._times = Widened(link.TIMES_US)
        self._heard_ns = self.clock.now_ns()
        self.started_us = 0
        self._answers.clear()
        self._data.clear()
        self._data_us.clear()
        self.fit.restart()

    def ask(self, kind: int, payload: bytes = b"") -> Frame:
        """One command and its answer; the same again when none comes; LinkError."""
        self._sequence = (self._sequence + 1) % link.SEQUENCES
        command = link.framed(kind, self._sequence, payload)
        self._answers.clear()
        for _ in range(TRIES):
            with port_errors():
                self.port.write(command)
            until_ns = self.clock.now_ns() + round(ANSWER_S * 1e9)
            while self.clock.now_ns() < until_ns:
                self.read()
                for answer in self._answers:
                    if answer.kind == kind | link.ANSWER and answer.sequence == self._sequence:
                        return answer
            self._take(self._deframer.feed(b"", final=True), self.clock.now_ns(), tight=False)
        raise LinkError("the microcontroller does not answer")

    def drain(self) -> int:
        """Read what waits, since when is not known; how many bytes there were."""
        count = 0
        for _ in range(DRAIN_READS):
            with port_errors():
                waiting = self.port.in_waiting
                data = self.port.read(waiting) if waiting else b""
            if not data:
                break
            count += len(data)
            self._take(self._deframer.feed(data), self.clock.now_ns(), tight=False)
        return count

    def read(self) -> int:
        """Wait a little for bytes; how many frames they completed, just now."""
        with port_errors():
            data = self.port.read(max(1, self.port.in_waiting))
        frames = self._deframer.feed(data)
        self._take(frames, self.clock.now_ns(), tight=True)
        return len(frames)

    def collect(self) -> tuple[list[Frame], npt.NDArray[np.int64]]:
        """The data that has come, and when it was sent, in microseconds of the widened counter."""
        frames = self._data.copy()
        sent_us = np.concatenate(self._data_us) if frames else np.empty(0, np.int64)
        self._data.clear()
        self._data_us.clear()
        self._answers.clear()  # nobody asked
        return frames, sent_us

    def _take(self, frames: Sequence[Frame], arrived_ns: int, *, tight: bool) -> None:
        """Sort out frames that have arrived by now; `tight`: and not much earlier."""
        self.skipped = self._deframer.skipped
        if not frames:
            return
        times = np.fromiter((frame.time_us for frame in frames), np.int64, len(frames))
        sent_us = self._times.widen(times, (arrived_ns - self._heard_ns) / 1000)
        self._heard_ns = arrived_ns
        if tight:
            self.fit.add(int(sent_us[-1]) * 1000, arrived_ns)
        data = [frame.kind == link.DATA for frame in frames]
        if all(data):
            self._data += frames
            self._data_us.append(sent_us)
            return
        for index, frame in enumerate(frames):
            if frame.kind == link.START | link.ANSWER:  # whatever came before it is older
                self._data.clear()
                self._data_us.clear()
                self.started_us = int(sent_us[index])
            if frame.kind == link.DATA:
                self._data.append(frame)
                self._data_us.append(sent_us[index : index + 1])
            else:
                self._answers.append(frame)
