"""Which frames of the link belong to the stream that is running, from their numbers, times and lists.

A whole frame with a good checksum may still be old, repeated, out of order or of an earlier boot of the
microcontroller: a driver or a hub sends a buffer twice, a buffer survives a reset. The link says enough to tell:

* Time. A frame arrives after it was sent, and the host knows how the microcontroller's counter runs. A frame whose
  counter lies ahead of what the counter can show by now (`serial_session`) was not sent by this boot.
* Number. Frame k begins k periods after START and never earlier, so a number that is ahead of its own time belongs to
  another stream. It may be behind: a microcontroller that waits for its bus sends late and leaves frames out.
* List. In frame k the lists with ``k mod every == offset`` are sent, with a known length.
* Order. Number and list increase from frame to frame. Frames that arrive together are put in order first.

A frame of an earlier boot is admitted if all of this agrees: its stream's START was answered at the same count of the
microcontroller as this one's, from `EARLY_US` before to one period (at least 10 ms, `serial_session.EARLY_NS`) after
it, and the frame stands for one that is due now. So is a frame exactly one turn of the counter (71.6 minutes) old where
the frame numbers make whole turns in that time too (a period of 65536 us divided by a whole number). Nothing on the
link tells such a frame from the true one, which is refused if it arrives second.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from imuarray.bus import serial_link as link
from imuarray.bus.serial_link import Frame, PollList

EARLY_US = 5_000
"""A frame may be sent so much earlier than its number says: an interrupt that keeps the period is late now and then."""
PERIOD_ERROR = 0.01
"""A timer that can't count the period exactly (a coarse tick) gains or loses at most this share."""
MEMORY_US = 300_000_000
"""The earliest frame of this time and of as much before it says where the grid of frames lies: longer than a bus is
held, and short enough for `PERIOD_ERROR` to stay below the turn of the frame numbers at any rate."""

OUT_OF_ORDER = "old, repeated or out of order"
ANOTHER_TIME = "not sent since the microcontroller was last connected"
MEANINGLESS = "of no kind and no list that was asked for"
UNASKED = "an answer to no question"


class Arrival(NamedTuple):
    """A data frame that arrived, and when it was sent, in microseconds of the widened counter."""

    frame: Frame
    sent_us: int


class Admitted(NamedTuple):
    """A data frame of the running stream: its widened `number`, and its `place` among the arrivals."""

    number: int
    place: int


class Admission:
    """The order of one stream of `lists` every `period_us`, whose START was answered at `started_us`.

    `refused` counts frames by reason.
    """

    def __init__(self, lists: Sequence[PollList], period_us: int, started_us: int, refused: Counter[str]) -> None:
        self.refused = refused
        self._lists = dict(enumerate(lists))
        self._period_us = period_us
        self._newest = (-1, -1)
        """Number and list of the newest admitted frame."""
        self._newest_us = started_us
        self._grid_us = self._earlier_grid_us = started_us
        """When frame 0 would have been sent, from the earliest frame of the current and of the previous `MEMORY_US`."""
        self._grid_since_us = started_us

    def admit(self, arrivals: Sequence[Arrival]) -> list[Admitted]:
        """The arrivals that belong to the stream, in the order of their numbers; the others are counted in `refused`.

        Admitted numbers with their lists strictly increase, their times do not decrease, over all calls.
        """
        candidates: list[tuple[int, int, int, int]] = []
        for index, (frame, sent_us) in enumerate(arrivals):
            asked = self._lists.get(frame.payload[0]) if frame.payload else None
            if asked is None or asked.size != len(frame.payload):
                self.refused[MEANINGLESS] += 1
                continue
            number = self._number(frame.sequence, sent_us)
            if number < 0 or number % asked.every != asked.offset:
                self.refused[OUT_OF_ORDER] += 1
                continue
            candidates.append((number, frame.payload[0], sent_us, index))
        admitted = []
        for number, name, sent_us, index in sorted(candidates):
            if (number, name) <= self._newest or sent_us < self._newest_us:
                self.refused[OUT_OF_ORDER] += 1
                continue
            self._newest, self._newest_us = (number, name), sent_us
            self._remember(sent_us - number * self._period_us, sent_us)
            admitted.append(Admitted(number, index))
        return admitted

    def _number(self, sequence: int, sent_us: int) -> int:
        """The largest frame number that can have been begun by `sent_us` and is sent as `sequence`."""
        early_us = EARLY_US + round(PERIOD_ERROR * max(sent_us - self._newest_us, 0))
        begun = (sent_us - min(self._grid_us, self._earlier_grid_us) + early_us) // self._period_us
        return begun - (begun - sequence) % link.SEQUENCES

    def _remember(self, grid_us: int, sent_us: int) -> None:
        if sent_us - self._grid_since_us > MEMORY_US:
            self._earlier_grid_us, self._grid_us, self._grid_since_us = self._grid_us, grid_us, sent_us
        self._grid_us = min(self._grid_us, grid_us)
