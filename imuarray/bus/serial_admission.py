"""Decides which frames of the link belong to the running stream, by their numbers, times and lists.

A whole frame with a good checksum may still be old, repeated, out of order or of an earlier boot of the
microcontroller: a driver or a hub sends a buffer twice, a buffer survives a reset. Four properties identify the frames
of the stream:

* Time. A frame arrives after it was sent, and the host knows how the microcontroller's counter runs. A frame whose
  counter lies ahead of what the counter can show by now (`serial_session`) was not sent by this boot.
* Number. Frame k begins k periods after START and never earlier, so a number that is ahead of its own time belongs to
  another stream. It may be behind: a microcontroller that waits for its bus sends late and leaves frames out.
* List. In frame k the lists with ``k mod every == offset`` are sent, with a known length.
* Order. Number and list increase from frame to frame. Frames that arrive together are put in order first.

A frame of an earlier boot is admitted only if all of this agrees: its stream's START was answered at the same count of
the microcontroller as this one's, from `EARLY_US` before to one period (at least 10 ms, `serial_session.EARLY_NS`)
after it, and the frame stands for one that is due now. The same holds for a frame exactly one turn of the counter (71.6
minutes) old where the frame numbers make whole turns in that time too (a period of 65536 us divided by a whole number).
Nothing on the link distinguishes such a frame from the true one, which is refused if it arrives second.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Integers
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
        """When frame 0 would have been sent, from the earliest frame of the current and of the previous `MEMORY_US`."""
        self._grid_since_us = started_us
        self._usual_us = started_us
        """When frame 0 would have been sent, from the newest frame."""

    @property
    def newest_us(self) -> int:
        """Return when the newest admitted frame was sent; before the first frame, the time of START's answer."""
        return self._newest_us

    def admit(self, frames: Sequence[Frame], sent_us: Integers) -> FrameSelection:
        """Return the frames that belong to the stream, of those that were sent at `sent_us` (n,) of the widened
        counter; the others are counted in `refused`.

        FrameSelection numbers with their lists strictly increase, their times do not decrease, over all calls.
        """
        names, numbers, due = self._due(frames, sent_us)
        if not due.all():
            sizes = np.fromiter((len(frame.payload) for frame in frames), np.int64, len(frames))
            known = self._size[names] == sizes
            self.refused[MEANINGLESS] += int(np.count_nonzero(~known))
            self.refused[OUT_OF_ORDER] += int(np.count_nonzero(known & ~due))
        places = np.flatnonzero(due)
        order = numbers[places] << 8 | names[places]
        unusual_us = np.abs(sent_us[places] - numbers[places] * self._period_us - self._usual_us)
        ranks = np.lexsort((unusual_us, order))  # of two frames of one number the one that is as late as usual
        places = self._increasing(order[ranks], sent_us[places[ranks]], places[ranks])
        if len(places):
            self._usual_us = int(sent_us[places[-1]] - numbers[places[-1]] * self._period_us)
            self._remember(sent_us[places] - numbers[places] * self._period_us, int(sent_us[places[-1]]))
        return FrameSelection(numbers[places], places)

    def missing(self, frames: Sequence[Frame], sent_us: Integers) -> list[tuple[int, int]]:
        """Return the runs, (first, count), of frame numbers that lack a list between the newest admitted frame and the
        newest of these, which were sent at `sent_us` (n,). Nothing is admitted by asking.
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
        """Return (n,) each: list of a frame, widened number, and whether this list with this length is sent in it."""
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
        """Return the `places` (n,), sorted by `order` (n,), of frames that follow each other and the newest of
        before.
        """
        follows = (np.diff(order, prepend=self._newest) > 0) & (np.diff(sent_us, prepend=self._newest_us) >= 0)
        if not follows.all():  # one that does not may stand before others that do
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
        """Remember the position of the grid, from frames of which the newest was sent at `sent_us`."""
        earliest_us = int(grid_us.min())
        if sent_us - self._grid_since_us > MEMORY_US:
            self._earlier_grid_us, self._grid_us, self._grid_since_us = self._grid_us, earliest_us, sent_us
        self._grid_us = min(self._grid_us, earliest_us)


def _runs(numbers: Sequence[int]) -> list[tuple[int, int]]:
    """Increasing numbers as runs (first, count)."""
    runs: list[tuple[int, int]] = []
    for number in numbers:
        if runs and number == sum(runs[-1]):
            runs[-1] = runs[-1][0], runs[-1][1] + 1
        else:
            runs.append((number, 1))
    return runs
