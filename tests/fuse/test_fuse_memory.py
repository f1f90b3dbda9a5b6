"""Memory of fusion does not depend on the length of the log."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from imuarray.fuse import fuse
from imuarray.log import open_log
from tests.fuse.conftest import Part, WriteRun, calibration


@pytest.mark.slow
@pytest.mark.parametrize("technique", ["opposed"])
def test_memory_does_not_grow_with_the_log(write_run: WriteRun, technique: str) -> None:
    """Three times the frames; the second sensor has no rows for most of the log, and is not waited for."""
    parts = [Part(f"A{i}", late_s=0.001 * i, sigma=0.01) for i in range(2)]
    parts.append(Part("A2", lost=lambda seconds: seconds > 10.0))
    peaks = []
    for frames in (6000, 18_000):
        with open_log(write_run(parts, frames=frames, truth="", name=f"{frames}.h5")) as log:
            list(zip(fuse(log, calibration(parts), technique, block=500), range(3), strict=False))  # imports, caches
            tracemalloc.start()
            seen = sum(len(block.time) for block in fuse(log, calibration(parts), technique, block=500))
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        assert seen == frames
    assert np.ptp(peaks) < 0.1 * peaks[0]
