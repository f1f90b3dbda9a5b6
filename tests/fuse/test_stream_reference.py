"""The stream against a plain loop over frames and sensors: at rest both must agree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.fuse import FusedBlock, live
from imuarray.fuse.fusion import Patience
from imuarray.log import Block
from imuarray.log.format import SATURATED, STALE, SUSPECT
from tests.fuse.conftest import G, Part, calibration, pointing
from tests.fuse.row_pushes import AXES, push_rows
from tests.selection import examples

PERIOD_NS = 10_000_000
COUNTS = np.array([100, -200, 900])
"""What everybody reads along the box axes."""
SENSITIVITY = 1024.0


class Course(NamedTuple):
    """The course of one sensor: its divisor of the frame rate, the begin and end as a share of the run, the share of
    lost rows, whether rows have flags, and the delay within the frame.
    """

    every: int
    begins: float
    ends: float
    lost: float
    flagged: bool
    late_ns: int


LATE_NS = st.integers(0, 3_000_000)
USUAL = st.builds(
    Course, st.just(1), st.just(0.0), st.sampled_from([1.0, 0.7]), st.sampled_from([0.0, 0.05]), st.booleans(), LATE_NS
)
ODD = st.builds(
    Course,
    st.sampled_from([1, 2]),
    st.sampled_from([0.0, 0.4]),
    st.sampled_from([1.0, 0.7, 0.0]),
    st.sampled_from([0.0, 0.05, 0.5]),
    st.booleans(),
    LATE_NS,
)
COURSES = st.integers(1, 4).flatmap(
    lambda count: st.builds(
        lambda usual, odd, order: [[*usual, *odd][index] for index in order],
        st.lists(USUAL, min_size=count // 2 + 1, max_size=count // 2 + 1),
        st.lists(ODD, min_size=(count - 1) // 2, max_size=(count - 1) // 2),
        st.permutations(range(count)),
    )
)
"""More than half of the sensors are read in every frame: frames are as far apart as the rows of most."""


def rows_of(course: Course, part: Part, frames_ns: np.ndarray, rng: np.random.Generator) -> Block:
    """The remaining rows, all with the same counts."""
    number = np.arange(len(frames_ns))
    share = number / len(frames_ns)
    kept = (number % course.every == 0) & (share >= course.begins) & (share < course.ends)
    kept &= rng.uniform(size=len(kept)) >= course.lost
    time = (frames_ns + course.late_ns)[kept]
    flags = rng.choice([0, 0, 0, SATURATED, SUSPECT, STALE], len(time)) if course.flagged else np.zeros(len(time))
    counts = np.tile(pointing(part.axes) @ COUNTS, (len(time), 1)).astype(np.int16)
    return Block(time, counts, flags.astype(np.uint16))


def looped(rows: list[Block], time_ns: int) -> list[int]:
    """The sensors with a valid reading within half a frame, by the nearest reading."""
    result = []
    for number, block in enumerate(rows):
        if len(block.time):
            nearest = int(np.argmin(np.abs(block.time - time_ns)))
            is_near = 2 * abs(int(block.time[nearest]) - time_ns) <= PERIOD_NS
            if is_near and not block.status[nearest] & (SATURATED | SUSPECT):
                result.append(number)
    return result


@given(
    courses=COURSES,
    frames=st.integers(20, 200),
    pause_s=st.sampled_from([0.0, 0.0, 0.03, 7.0]),
    jitter_ns=st.sampled_from([1, 300_000, 1_500_000]),
    seed=st.integers(0, 1 << 32),
    most_s=st.sampled_from([0.02, 0.5, 3.0]),
)
@settings(max_examples=examples(60), deadline=None)
def test_every_frame_at_rest_is_the_mean_of_the_sensors_with_readings(
    courses: list[Course], frames: int, pause_s: float, jitter_ns: int, seed: int, most_s: float
) -> None:
    rng = np.random.default_rng(seed)
    times = np.arange(frames, dtype=np.int64) * PERIOD_NS + rng.integers(0, jitter_ns, frames)
    times[frames // 2 :] += round(pause_s * 1e9)
    parts = [Part(f"A{i}", AXES[i], range=2.0, sensitivity=SENSITIVITY, sigma=0.01) for i in range(len(courses))]
    rows = [rows_of(course, part, times, rng) for course, part in zip(courses, parts, strict=True)]
    stream = live([part.header for part in parts], calibration(parts), "mean", patience=Patience(1e9))
    blocks = list(push_rows(stream, {part.name: block for part, block in zip(parts, rows, strict=True)}, seed, most_s))
    fused = FusedBlock.joined(blocks)
    assert (np.diff(fused.time) > 0).all()
    truth = COUNTS / SENSITIVITY * G
    for time_ns, triad, bits in zip(
        fused.time.tolist(), fused.triads["specific_force"], fused.used["specific_force"], strict=True
    ):
        who = looped(rows, time_ns)
        assert np.flatnonzero(bits).tolist() == who
        assert np.abs(triad - truth).max() < 1e-9 if who else np.isnan(triad).all()
