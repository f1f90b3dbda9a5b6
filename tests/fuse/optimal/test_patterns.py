"""Frames by the set of their valid readings."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imuarray.fuse.optimal.geometry import patterns
from tests.selection import examples


@settings(max_examples=examples(50), deadline=None)
@given(seed=st.integers(0, 10**6), frames=st.integers(0, 60), axes=st.integers(1, 20), share=st.floats(0, 1))
def test_every_frame_is_in_its_pattern_and_patterns_are_unique(seed: int, frames: int, axes: int, share: float) -> None:
    flags = np.random.default_rng(seed).random((frames, axes)) < share
    parts = patterns(flags)
    seen = np.zeros(frames, int)
    for pattern, which in parts:
        assert (flags[which] == pattern).all()
        seen[which] += 1
    assert (seen == 1).all()
    assert len({tuple(pattern.tolist()) for pattern, _ in parts}) == len(parts)


def test_patterns_are_in_the_order_of_their_bits() -> None:
    flags = np.array([[1, 0], [0, 1], [1, 0], [0, 0]], bool)
    assert [(pattern.tolist(), list(which)) for pattern, which in patterns(flags)] == [  # type: ignore[arg-type]
        ([False, False], [3]),
        ([False, True], [1]),
        ([True, False], [0, 2]),
    ]
