"""Waiting rows keep their flags when other rows are added, discarded, doubted or written."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.acquire.bus_segment import routes_of
from imuarray.acquire.sample_buffer import SampleBuffer
from imuarray.array import parse_array
from imuarray.bus import open_bus
from imuarray.log.format import LOST_BEFORE, RECONFIGURED, SUSPECT
from tests.selection import examples

ARRAY = parse_array('[array]\nname="a"\n[[sensor]]\nname="B"\nchip="bma180"\naddress=0x40\nrange=2\nbandwidth_hz=150\n')
KINDS = ("add", "add", "add", "add", "miss", "cut", "distrust", "trust", "set up", "take")
STEPS = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 7)), max_size=80)


def buffer() -> SampleBuffer:
    (route,) = routes_of(ARRAY, open_bus("emulated:", ARRAY))
    return SampleBuffer(route, 50.0)


def burst_of(code: int) -> bytes:
    """A BMA180 reading, new on all axes, of `code` in x (BMA-12, BMA-60, BMA-62)."""
    return ((code << 2 | 1) & 0xFFFF).to_bytes(2, "little") + b"\x01\x00\x01\x00" + b"\x00"


class Plain:
    """The same, kept as one list of rows with a set of flags each."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.doubt = self.missing = self.anew = False

    def add(self, at_ns: int) -> None:
        flags = LOST_BEFORE * self.missing | RECONFIGURED * self.anew | SUSPECT * self.doubt
        self.rows.append({"at": at_ns, "flags": flags})
        self.missing = self.anew = False

    def cut(self, row: int) -> None:
        gone = self.rows[row:]
        self.missing |= bool(gone)
        self.anew |= any(each["flags"] & RECONFIGURED for each in gone)
        del self.rows[row:]

    def distrust(self, row: int) -> None:
        self.doubt = True
        for each in self.rows[row:]:
            each["flags"] |= SUSPECT


@settings(max_examples=examples(300), deadline=None)
@given(STEPS)
def test_flags_stay_with_their_rows(steps: list[tuple[str, int]]) -> None:
    ours, plain, now_ns = buffer(), Plain(), 0
    for step, number in steps:
        row = max(len(plain.rows) - number, 0)
        if step == "add":
            now_ns += 1000
            ours.add(burst_of(now_ns // 1000 % 8000), now_ns)
            plain.add(now_ns)
        elif step == "miss":
            ours.mark_lost()
            plain.missing = True
        elif step == "cut":
            ours.cut(row)
            plain.cut(row)
        elif step == "distrust":
            ours.distrust(row)
            plain.distrust(row)
        elif step == "trust":
            ours.trust()
            plain.doubt = False
        elif step == "set up":
            ours.note_configured()
            plain.anew = True
        elif step == "take" and row:
            block = ours.take(row, 0)
            assert block.time.tolist() == [each["at"] for each in plain.rows[:row]]
            assert block.status.tolist() == [each["flags"] for each in plain.rows[:row]]
            assert block.counts[:, 0].tolist() == [each["at"] // 1000 % 8000 for each in plain.rows[:row]]
            del plain.rows[:row]
    assert ours.times_ns == [each["at"] for each in plain.rows]


def test_the_first_row_after_the_written_rows_keeps_its_flags() -> None:
    """The boundary: rows 0 and 1 are written, row 2 is the first that stays, and it is the flagged one."""
    ours = buffer()
    ours.add(burst_of(1), 0)
    ours.add(burst_of(2), 1000)
    ours.mark_lost()
    ours.note_configured()
    ours.add(burst_of(3), 2000, doubtful=True)
    assert ours.take(2, 0).status.tolist() == [0, 0]
    ours.add(burst_of(4), 3000)
    assert ours.take(2, 0).status.tolist() == [LOST_BEFORE | RECONFIGURED, 0]
    assert ours.doubtful_rows.tolist() == [True, False]


def test_the_row_after_discarded_ones_is_flagged() -> None:
    ours = buffer()
    for index in range(3):
        ours.add(burst_of(index), index * 1000)
    assert ours.cut(1) == 2
    ours.add(burst_of(8), 3000)
    ours.add(burst_of(9), 4000)
    block = ours.take(3, 0)
    assert block.counts[:, 0].tolist() == [0, 8, 9]
    assert block.status.tolist() == [0, LOST_BEFORE, 0]


def test_discarding_no_row_flags_no_row() -> None:
    ours = buffer()
    ours.add(burst_of(1), 0)
    assert ours.cut(1) == 0
    ours.add(burst_of(2), 1000)
    assert ours.take(2, 0).status.tolist() == [0, 0]


def test_rows_of_a_stream_are_flagged_where_readings_are_missing() -> None:
    """Lost rows before the stream and lost rows inside it are both flagged, once each."""
    ours = buffer()
    ours.mark_lost()
    ours.add_rows([0, 1000, 2000], b"".join(map(burst_of, (1, 2, 3))), [2])
    ours.add_rows([3000, 4000], b"".join(map(burst_of, (4, 5))), [0])
    assert ours.take(5, 0).status.tolist() == [LOST_BEFORE, 0, LOST_BEFORE, LOST_BEFORE, 0]


FRAME_NS = 20_000_000


def test_a_frozen_reading_is_distinguished_from_a_slowly_changing_one() -> None:
    """24 equal readings, a second's worth of a slow poll; at 50 Hz it takes the second."""
    ours = buffer()
    for index in range(200):
        ours.add(burst_of(index // 20), index * FRAME_NS)  # a step every twenty readings
    assert ours.frozen_since() is None
    for index in range(200, 249):
        ours.add(burst_of(77), index * FRAME_NS)
    assert ours.frozen_since() is None
    ours.add(burst_of(77), 249 * FRAME_NS)
    assert ours.frozen_since() == 200


def test_a_chip_still_frozen_after_a_set_up_is_flagged_from_its_first_equal_reading() -> None:
    ours = buffer()
    for index in range(60):
        ours.add(burst_of(5), index * FRAME_NS)
    assert ours.frozen_since() == 0
    ours.note_frozen()
    ours.distrust(0)
    ours.trust()
    ours.note_configured()
    for index in range(60, 70):
        ours.add(burst_of(5), index * FRAME_NS)
    for index in range(70, 80):
        ours.add(burst_of(6), index * FRAME_NS)
    ours.flag_frozen_rows()
    status = ours.take(80, 0).status
    np.testing.assert_array_equal((status & SUSPECT) != 0, np.arange(80) < 70)


STEP_NS = 5_000_000_000


def test_a_frozen_reading_is_detected_across_written_rows() -> None:
    """24 equal readings are too many to wait for at one in five seconds; the two newest rows wait."""
    (route,) = routes_of(ARRAY, open_bus("emulated:", ARRAY))
    ours = SampleBuffer(route, 0.2)
    assert ours.held_rows == 2  # ten seconds of them
    for index in range(30):
        ours.add(burst_of(index), index * STEP_NS)
        if len(ours.times_ns) > 2:
            ours.take(len(ours.times_ns) - 2, 0)
    for index in range(30, 53):
        assert ours.frozen_since() is None
        ours.add(burst_of(77), index * STEP_NS)
        ours.take(len(ours.times_ns) - 2, 0)
    assert ours.frozen_since() is None
    ours.add(burst_of(77), 53 * STEP_NS)
    assert ours.frozen_since() == 0
    assert ours.still_since_ns(0) == 30 * STEP_NS
    ours.note_configured()
    for index in range(54, 77):
        ours.add(burst_of(77), index * STEP_NS)
        ours.take(len(ours.times_ns) - 2, 0)
        assert ours.frozen_since() is None  # readings before the set-up do not count
    ours.add(burst_of(77), 77 * STEP_NS)
    assert ours.frozen_since() == 0
    assert ours.still_since_ns(0) == 54 * STEP_NS


def test_rows_at_50_hz_wait_for_a_second_and_a_quarter() -> None:
    assert buffer().held_rows == 62  # of 50 a second: 50 equal readings are no coincidence
