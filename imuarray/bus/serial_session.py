"""One session with a microcontroller: commands and their answers, and the data that arrives in between.

Received frames are sorted as they arrive: answers are kept for the caller of the command, data for `receive`, with the
counter's time extended by the host's clock. A frame that this boot of the microcontroller can't have sent yet is
rejected, and so are data that are not of the running stream (`Admission`). Every accepted frame contributes to the
estimate of the microcontroller's clock. Missing data are requested again before later data are returned, if the
firmware keeps them.

Admission decides which frames of the link belong to the running stream, by their numbers, times and lists. A complete
frame with a valid checksum may still be old, repeated, out of order or of an earlier boot of the microcontroller: a
driver or a hub may send a buffer twice, a buffer may survive a reset. Four properties identify the frames of the
stream:

* Time. A frame arrives after it was sent, and the host has an estimate of the microcontroller's counter. A frame with a
  count that the counter can't have reached yet was not sent by this boot.
* Number. Frame k begins k periods after START and never earlier, so a number that is ahead of its own time belongs to
  another stream. It may be behind: a microcontroller that waits for its bus sends late and omits frames.
* List. In frame k the lists with ``k mod every == offset`` are sent, with a known length.
* Order. Number and list increase from frame to frame. Frames that arrive together are put in order first.

A frame of an earlier boot is admitted only if all of this agrees: START of its stream was answered at the same count of
the microcontroller as START of this stream, from `EARLY_US` before to one period (at least 10 ms, `EARLY_NS`) after it,
and the frame has a number that is due now. The same holds for a frame that is exactly one turn of the counter (71.6
minutes) old, if the frame numbers also make whole turns in that time (a period of 65536 us divided by a whole number).
Nothing on the link distinguishes a frame of this kind from the true one; the second of them to arrive is refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers, Times
from imuarray.bus import serial_link as link
from imuarray.bus.serial_clock import MAX_DRIFT, ClockFit, nearest
from imuarray.bus.serial_link import Capacity, Frame, LinkError, PollList
from imuarray.bus.serial_port import Port, port_errors
from imuarray.clock import Clock, sleep_for

EARLY_US = 5_000
"""Largest time in us by which a frame may precede the time of its number, because an interrupt is sometimes late."""
PERIOD_ERROR = 0.01
"""Relative error of the period of a timer that can't count it exactly (a coarse tick)."""
MEMORY_US = 300_000_000
"""Interval in us. The grid of frames is determined by the earliest frame of the current interval and that of the
previous one: longer than a bus is held, and short enough for `PERIOD_ERROR` to stay below the wrap of the frame numbers
at any rate.
"""

OUT_OF_ORDER = "old, repeated or out of order"
ANOTHER_TIME = "from before the microcontroller was last connected"
MEANINGLESS = "of an unknown kind or list"
UNASKED = "an unrequested answer"


class FrameSelection(NamedTuple):
    """Data frames of the running stream in its order: their widened `numbers` (n,) and their `places` (n,) among those
    that arrived.
    """

    numbers: Integers
    places: Integers


class Admission:
    """The order of one stream of `lists` every `period_us`, whose START was answered at `started_us`.

    `refused` counts frames by reason.
    """

    def __init__(self, lists: Sequence[PollList], period_us: int, started_us: int, refused: Counter[str]) -> None:
        self.refused = refused
        self._period_us = period_us
        self._size, self._every, self._offset = np.full((3, 256), -1, np.int64)
        for name, asked in enumerate(lists):
            self._size[name], self._every[name], self._offset[name] = asked.size, asked.every, asked.offset
        self._newest = -1
        """The position of the newest admitted frame: its number and its list as one number."""
        self._newest_us = started_us
        self._grid_us = self._earlier_grid_us = started_us
        """Time at which frame 0 would have been sent, from the earliest frame of the current and of the previous
        `MEMORY_US`.
        """
        self._grid_since_us = started_us
        self._usual_us = started_us
        """Time at which frame 0 would have been sent, from the newest frame."""

    @property
    def newest_us(self) -> int:
        """Return when the newest admitted frame was sent; before the first frame, the time of START's answer."""
        return self._newest_us

    def admit(self, frames: Sequence[Frame], sent_us: Integers) -> FrameSelection:
        """Return the frames that belong to the stream, of those that were sent at `sent_us` (n,) of the widened
        counter; the others are counted in `refused`.

        Numbers with their lists strictly increase, their times do not decrease, over all calls."""
        names, numbers, due = self._due(frames, sent_us)
        if not due.all():
            sizes = np.fromiter((len(frame.payload) for frame in frames), np.int64, len(frames))
            known = self._size[names] == sizes
            self.refused[MEANINGLESS] += int(np.count_nonzero(~known))
            self.refused[OUT_OF_ORDER] += int(np.count_nonzero(known & ~due))
        places = np.flatnonzero(due)
        order = numbers[places] << 8 | names[places]
        unusual_us = np.abs(sent_us[places] - numbers[places] * self._period_us - self._usual_us)
        ranks = np.lexsort((unusual_us, order))  # of two frames with one number, take the one with the usual delay
        places = self._increasing(order[ranks], sent_us[places[ranks]], places[ranks])
        if len(places):
            self._usual_us = int(sent_us[places[-1]] - numbers[places[-1]] * self._period_us)
            self._remember(sent_us[places] - numbers[places] * self._period_us, int(sent_us[places[-1]]))
        return FrameSelection(numbers[places], places)

    def missing(self, frames: Sequence[Frame], sent_us: Integers) -> list[tuple[int, int]]:
        """Return the runs, (first, count), of frame numbers that lack a list between the newest admitted frame and the
        newest of these, which were sent at `sent_us` (n,). This call admits no frame.
        """
        names, numbers, due = self._due(frames, sent_us)
        keys = np.unique(numbers[due] << 8 | names[due])
        keys = keys[keys > self._newest]
        if not len(keys):
            return []
        newest, last = int(keys[-1]), max(self._newest, int(keys[-1]) - (link.SEQUENCES // 2 << 8))
        lists = np.flatnonzero(self._every > 0)
        first = (last >> 8) + (lists <= last & 0xFF)
        end = (newest >> 8) + (lists <= newest & 0xFF)
        every, offset = self._every[lists], self._offset[lists]
        required = (end - 1 - offset) // every - (first - 1 - offset) // every
        present = np.bincount(keys[keys > last] & 0xFF, minlength=256)[lists]
        absent: set[int] = set()
        for place in np.flatnonzero(required > present).tolist():
            begins = int(first[place] + (offset[place] - first[place]) % every[place])
            wanted = np.arange(begins, end[place], every[place])
            absent.update(np.setdiff1d(wanted, keys[keys & 0xFF == lists[place]] >> 8).tolist())
        return _runs(sorted(absent))

    def _due(self, frames: Sequence[Frame], sent_us: Integers) -> tuple[Integers, Integers, npt.NDArray[np.bool_]]:
        """Return (n,) each: list and widened number of a frame, and whether this list with this length is due in it."""
        names = np.fromiter((frame.payload[0] if frame.payload else 0 for frame in frames), np.int64, len(frames))
        sizes = np.fromiter((len(frame.payload) for frame in frames), np.int64, len(frames))
        sequences = np.fromiter((frame.sequence for frame in frames), np.int64, len(frames))
        numbers = self._numbers(sequences, sent_us)
        known = self._size[names] == sizes
        due = known & (numbers >= 0)
        due &= np.where(due, numbers % np.abs(self._every[names]) == self._offset[names], False)
        return names, numbers, due

    def _numbers(self, sequences: Integers, sent_us: Integers) -> Integers:
        """Return (n,) the largest frame numbers that can have been begun by `sent_us` and are sent as `sequences`."""
        early_us = EARLY_US + (PERIOD_ERROR * np.maximum(sent_us - self._newest_us, 0)).astype(np.int64)
        begun = (sent_us - min(self._grid_us, self._earlier_grid_us) + early_us) // self._period_us
        numbers: Integers = begun - (begun - sequences) % link.SEQUENCES
        return numbers

    def _increasing(self, order: Integers, sent_us: Integers, places: Integers) -> Integers:
        """Return those of `places` (n,), sorted by `order` (n,), whose frames follow each other and the newest earlier
        frame.
        """
        follows = (np.diff(order, prepend=self._newest) > 0) & (np.diff(sent_us, prepend=self._newest_us) >= 0)
        if not follows.all():  # a frame that does not follow may precede others that do
            newest, newest_us = self._newest, self._newest_us
            for row, (at, at_us) in enumerate(zip(order.tolist(), sent_us.tolist(), strict=True)):
                follows[row] = at > newest and at_us >= newest_us
                if follows[row]:
                    newest, newest_us = at, at_us
            self.refused[OUT_OF_ORDER] += int(np.count_nonzero(~follows))
        kept = np.flatnonzero(follows)
        if len(kept):
            self._newest, self._newest_us = int(order[kept[-1]]), int(sent_us[kept[-1]])
        return places[kept]

    def _remember(self, grid_us: Integers, sent_us: int) -> None:
        """Store the position of the grid, from frames; the newest of them was sent at `sent_us`."""
        earliest_us = int(grid_us.min())
        if sent_us - self._grid_since_us > MEMORY_US:
            self._earlier_grid_us, self._grid_us, self._grid_since_us = self._grid_us, earliest_us, sent_us
        self._grid_us = min(self._grid_us, earliest_us)


def _runs(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """Return increasing numbers as runs (first, count)."""
    runs: list[tuple[int, int]] = []
    for number in numbers:
        if runs and number == sum(runs[-1]):
            runs[-1] = runs[-1][0], runs[-1][1] + 1
        else:
            runs.append((number, 1))
    return runs


ANSWER_S = 0.25
"""Time in s without an answer after which a command is sent again."""
TRIES = 3
PATIENCE_S = 4.0
"""Time in s to wait for a first answer: opening the port resets many boards, and their boot loader takes 2 s."""
PINGS = 8
PING_S = 0.04
"""Time in s between two greetings; all greetings take a third of a second, which determines the rate of the
microcontroller's clock to a part in ten thousand.
"""
DRAIN_READS = 64
EARLY_NS = 10_000_000
"""Time in ns by which a delivery may be quicker than the quickest of the last seconds. Even an adapter that collects
bytes for 16 ms delivers the quickest of some seconds in less than 1 ms. A frame that seems to arrive earlier than that
was sent by another boot.
"""
LEARNT_NS = 1_000_000
"""Largest shift in ns that one observation may cause in the fit of the microcontroller's clock; it limits the effect of
a false frame.
"""

RESENDS = 3
"""Number of attempts to get missing frames; frames that are sent again are lost as often as others."""
RUNS = 8
"""Largest number of gaps that one attempt requests."""
MAX_PAUSE = 64
"""Largest number of pieces of data without a request for missing frames, after requests to which the microcontroller
sent nothing: it has omitted these frames.
"""

_ANEW_NS = 2 * round(TRIES * ANSWER_S * 1e9)
"""Time in ns for a repeated greeting after a first answer."""

_NONE: Times = np.empty(0, np.int64)


class Data(NamedTuple):
    """Data of the running stream, in its order: frames, their widened numbers (n,), and the times (n,) at which they
    were sent, in microseconds of the widened counter.
    """

    frames: list[Frame]
    numbers: Times
    sent_us: Times


class _Answer(NamedTuple):
    frame: Frame
    sent_us: int
    arrived_ns: int


class _Piece(NamedTuple):
    """Data frames that were read together, and the times (n,) at which they were sent: they had arrived by
    `arrived_ns`, and not much earlier if it is `tight`.
    """

    frames: Sequence[Frame]
    sent_us: Times
    arrived_ns: int
    tight: bool

    def since(self, sent_us: int) -> _Piece:
        """Return the frames that were sent from `sent_us` on; their arrival does not determine the transit time."""
        places = np.flatnonzero(self.sent_us >= sent_us)
        frames = [self.frames[place] for place in places.tolist()]
        return _Piece(frames, self.sent_us[places], self.arrived_ns, False)

    def between(self, after_us: int, until_us: int, known: set[Frame]) -> _Piece:
        """Return the frames that were sent after `after_us`, by `until_us`, and are not `known`."""
        places = [
            place
            for place, (frame, at_us) in enumerate(zip(self.frames, self.sent_us.tolist(), strict=True))
            if after_us < at_us <= until_us and frame not in known
        ]
        return _Piece([self.frames[place] for place in places], self.sent_us[places], self.arrived_ns, False)


class Session:
    """A session with the device at the port that `open_port` opens; LinkError if it does not use the protocol.

    `clock` is the host's, `fit` converts the microcontroller's to it; `skipped` counts bytes that belonged to no frame,
    `refused` rejected frames by reason.
    """

    def __init__(self, open_port: Callable[[], Port], clock: Clock, patience_s: float) -> None:
        self.clock = clock
        self.fit = ClockFit()
        self.skipped = 0
        self.refused: Counter[str] = Counter()
        self._open_port = open_port
        self._sequence = 0
        self._pause = self._fruitless = 0
        self.port = open_port()
        try:
            self.capacity = self._greet(patience_s)
        except BaseException:
            self.port.close()
            raise

    def reconnect(self, patience_s: float) -> None:
        """Open the port again and start a new session; LinkError."""
        with suppress(LinkError), port_errors():
            self.port.close()
        with port_errors():
            self.port = self._open_port()
        self.capacity = self._greet(patience_s)

    def _greet(self, patience_s: float) -> Capacity:
        """Send HELLO until there is an answer, then a few times more to measure the delay of an answer. An old answer
        to an earlier program does not match the answers that follow; then the greeting starts again.
        """
        self._deframer = link.Deframer()
        until_ns = self.clock.now_ns() + round(patience_s * 1e9)
        answered = False
        while True:
            self._forget()
            try:
                capacity = link.capacity_of(self.ask(link.HELLO).payload)
                until_ns, answered = until_ns if answered else max(until_ns, self.clock.now_ns() + _ANEW_NS), True
                if capacity.version == link.VERSION:
                    self._measure_trip()
                break
            except LinkError:
                if self.clock.now_ns() >= until_ns:
                    raise
                sleep_for(self.clock, PING_S)
        if capacity.version != link.VERSION:
            raise LinkError(f"the microcontroller speaks version {capacity.version} of the link, not {link.VERSION}")
        return capacity

    def _measure_trip(self) -> None:
        """Estimate the quickest way from the microcontroller as half of the quickest round trip."""
        self._forget()
        trips_ns = []
        for _ in range(PINGS):
            sleep_for(self.clock, PING_S)
            begun_ns = self.clock.now_ns()
            self.ask(link.HELLO)
            trips_ns.append(self.clock.now_ns() - begun_ns)
        self.fit.latency_ns = min(trips_ns) // 2

    def _forget(self) -> None:
        """Discard data of another session, perhaps of another boot of the microcontroller."""
        self._answers: list[_Answer] = []
        self._pieces: list[_Piece] = []
        self._newest: tuple[int, int] | None = None
        """Time at which the newest frame of the running stream was sent (us), and by which it had arrived (ns)."""
        self._admission: Admission | None = None
        self.fit.restart()

    def start(self, lists: Sequence[PollList], period_us: int) -> bytes:
        """Send START: data from its answer on are those of these lists. Return the payload of the answer; LinkError."""
        answer = self._ask(link.START, link.start_payload(period_us))
        self._pieces = [piece.since(answer.sent_us) for piece in self._pieces]
        self._newest = None
        self._admission = Admission(lists, period_us, answer.sent_us, self.refused)
        return answer.frame.payload

    def ask(self, kind: int, payload: bytes = b"") -> Frame:
        """Send one command and return its answer; send it again without an answer; LinkError."""
        return self._ask(kind, payload).frame

    def _ask(self, kind: int, payload: bytes) -> _Answer:
        self._sequence = (self._sequence + 1) % link.SEQUENCES
        command = link.frame_payload(kind, self._sequence, payload)
        self.refused[UNASKED] += len(self._answers)
        self._answers.clear()
        asked_ns = self.clock.now_ns()
        for _ in range(TRIES):
            with port_errors():
                self.port.write(command)
            until_ns = self.clock.now_ns() + round(ANSWER_S * 1e9)
            while self.clock.now_ns() < until_ns:
                self.read()
                answer = self._answer_to(kind, asked_ns)
                if answer is not None:
                    return answer
            self._take(self._deframer.feed(b"", final=True), self.clock.now_ns(), tight=False)
        raise LinkError("the microcontroller does not answer")

    def _answer_to(self, kind: int, asked_ns: int) -> _Answer | None:
        """Return the answer to the last command, which was sent at `asked_ns`. A frame that was sent before that
        answers an earlier command with the same number, and is refused.
        """
        since_us = self._latest_us(asked_ns)
        answers, self._answers = self._answers, []
        for index, answer in enumerate(answers):
            if answer.frame.kind != kind | link.ANSWER or answer.frame.sequence != self._sequence:
                self.refused[UNASKED] += 1
            elif since_us is not None and answer.sent_us < since_us - self._early_us(asked_ns):
                self.refused[ANOTHER_TIME] += 1
            else:
                self._answers = answers[index + 1 :]
                self.fit.add(answer.sent_us * 1000, answer.arrived_ns)
                return answer
        return None

    def drain(self) -> int:
        """Read the waiting bytes, whose arrival time is unknown; return their number."""
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
        """Wait for bytes for a short time; return how many frames they completed, at a known time."""
        with port_errors():
            data = self.port.read(max(1, self.port.in_waiting))
        frames = self._deframer.feed(data)
        self._take(frames, self.clock.now_ns(), tight=True)
        return len(frames)

    def collect(self) -> Data:
        """Return the data of the running stream that has come since the last call."""
        pieces, self._pieces = [piece for piece in self._pieces if piece.frames], []
        self.refused[UNASKED] += len(self._answers)
        self._answers.clear()
        if self._admission is None or not pieces:
            return Data([], _NONE, _NONE)
        if self.capacity.features & link.CAN_RESEND:
            pieces += self._recover(self._admission, pieces)
        frames = [frame for piece in pieces for frame in piece.frames]
        sent_us = np.concatenate([piece.sent_us for piece in pieces])
        numbers, places = self._admission.admit(frames, sent_us)
        self._learn(np.sort(places), sent_us, pieces)
        return Data([frames[place] for place in places.tolist()], numbers, sent_us[places])

    def _recover(self, admission: Admission, pieces: Sequence[_Piece]) -> list[_Piece]:
        """Request the frames that are missing before the newest of `pieces`; return the pieces that are sent again.
        Later frames that arrive in the meantime are kept for the next call.
        """
        if self._pause:
            self._pause -= 1
            return []
        newest_us = max(int(piece.sent_us.max()) for piece in pieces)
        recovered: list[_Piece] = []
        known: set[Frame] = set()
        count = attempts = 0
        while attempts < RESENDS:
            whole = [*pieces, *recovered]
            frames = [frame for piece in whole for frame in piece.frames]
            runs = admission.missing(frames, np.concatenate([piece.sent_us for piece in whole]))
            if not runs:
                break
            known.update(frames)
            attempts += 1
            try:
                sent = sum(self._ask_again(first, number) for first, number in runs[:RUNS])
            except OSError:  # no answer: received data are kept, and the silence is detected where data are required
                sent = 0
            arrived, self._pieces = self._pieces, []
            for piece in arrived:
                recovered.append(piece.between(admission.newest_us, newest_us, known))
                known.update(recovered[-1].frames)
                self._pieces.append(piece.since(newest_us + 1))
            count += sent
            if not sent:
                break
        if attempts:
            self._fruitless = 0 if count else self._fruitless + 1
            self._pause = min(1 << self._fruitless, MAX_PAUSE) - 1
        return [piece for piece in recovered if piece.frames]

    def _ask_again(self, first: int, number: int) -> int:
        """Request `number` frames from `first` on again; return how many the microcontroller sent. LinkError."""
        end, count = first + number, 0
        while first < end:
            answer = self.ask(link.RESEND, link.resend_payload(first, min(end - first, link.SEQUENCES - 1)))
            frames, following = link.sent_again(answer.payload)
            progress = (following - first) % link.SEQUENCES
            if not frames or not progress:
                break
            count += frames
            first += progress
        return count

    def _learn(self, admitted: Times, sent_us: Times, pieces: Sequence[_Piece]) -> None:
        """Pass to the fit when the newest admitted frame was sent, for each piece that was read as it arrived."""
        start = 0
        for piece in pieces:
            end = start + len(piece.frames)
            first, last = np.searchsorted(admitted, (start, end))
            start = end
            if first == last:
                continue
            newest_us = int(sent_us[admitted[first:last]].max())
            if self._newest is not None and newest_us <= self._newest[0]:
                continue
            self._newest = newest_us, piece.arrived_ns
            latest_ns = self.fit.latest_sent_ns(piece.arrived_ns)
            if piece.tight and latest_ns is not None:
                self.fit.add(min(newest_us * 1000, latest_ns + LEARNT_NS), piece.arrived_ns)

    def _latest_us(self, arrived_ns: int) -> int | None:
        """Return the count of the microcontroller at which a frame that arrives at `arrived_ns` is sent at the latest,
        if its delivery is as quick as the quickest of the last seconds; None while the counter is unknown.
        """
        latest_ns = self.fit.latest_sent_ns(arrived_ns)
        return None if latest_ns is None else latest_ns // 1000

    def _early_us(self, at_ns: int) -> int:
        """Return by how much, in us, a frame may have been sent before or after `_latest_us`: `EARLY_NS`, and the
        largest drift of the counter since the newest arrival.
        """
        return (EARLY_NS + round(MAX_DRIFT * max(at_ns - self.fit.newest_arrival_ns, 0))) // 1000

    def _bound_us(self, latest_us: int, arrived_ns: int) -> int:
        """Return the latest time at which a frame of this boot that has arrived by `arrived_ns` was sent. While the
        host is late, the quickest delivery is unknown: it is then taken to be that of the newest frame.
        """
        bound_us = latest_us + self._early_us(arrived_ns)
        if self._newest is None:
            return bound_us
        return max(bound_us, self._newest[0] + round((1 + MAX_DRIFT) * (arrived_ns - self._newest[1])) // 1000)

    def _take(self, frames: Sequence[Frame], arrived_ns: int, *, tight: bool) -> None:
        """Sort frames that have arrived by now; with `tight` not much earlier."""
        self.skipped = self._deframer.skipped
        if not frames:
            return
        latest_us = self._latest_us(arrived_ns)
        if latest_us is None:  # data from before the first answer is of an earlier program
            answers = [frame for frame in frames if _is_answer(frame)]
            self._answers += [_Answer(frame, frame.time_us, arrived_ns) for frame in answers]
            return
        times = np.fromiter((frame.time_us for frame in frames), np.int64, len(frames))
        sent_us = nearest(times, link.TIMES_US, latest_us)
        data = np.fromiter((frame.kind == link.DATA for frame in frames), np.bool_, len(frames))
        sent = sent_us <= self._bound_us(latest_us, arrived_ns)
        if not (data & sent).all():
            self.refused[ANOTHER_TIME] += int(np.count_nonzero(~sent))
            for place in np.flatnonzero(sent & ~data).tolist():
                if _is_answer(frames[place]):
                    self._answers.append(_Answer(frames[place], int(sent_us[place]), arrived_ns))
                else:
                    self.refused[MEANINGLESS] += 1
            places = np.flatnonzero(sent & data)
            frames, sent_us = [frames[place] for place in places.tolist()], sent_us[places]
        if frames:
            self._pieces.append(_Piece(frames, sent_us, arrived_ns, tight))


def _is_answer(frame: Frame) -> bool:
    return frame.kind & link.ANSWER != 0 and frame.kind != link.DATA
