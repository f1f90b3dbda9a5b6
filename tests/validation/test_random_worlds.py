"""Random worlds in which the diagnosis was once wrong: a gap without a mechanism, or an undetected mechanism."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from imuarray.gap.diagnose import Reference, compare
from imuarray.gap.model.workers import runner
from imuarray.gap.recording.recordings import recordings_of
from imuarray.log import Log, open_log
from imuarray.validation.case import Put
from imuarray.validation.generator import record_in
from imuarray.validation.trial import REPLICATES, leave_reference_out
from imuarray.validation.worlds import draw_world
from tests.selection import some


@contextmanager
def recorded(folder: Path, seed: int, *puts: Put) -> Iterator[list[Log]]:
    """The logs of the random world of a seed with these mechanisms, without a reference if the world has none."""
    world = draw_world(seed).table()
    recorder = {**world["recorder"], "reference": True}
    logs, _ = record_in({**world, "recorder": recorder}, folder, puts, seed)
    if not world["recorder"]["reference"]:
        for path in logs:
            leave_reference_out(path)
    with ExitStack() as stack:
        yield [stack.enter_context(open_log(path)) for path in logs]


@pytest.mark.parametrize(
    "seed",
    some(
        [
            9_000_010,  # two poses without notes, and accelerometers with a common bias of 0.17 g
            1_050_003,  # a single accelerometer, whose level is not separable from the attitude
            9_000_023,  # short phases with thermal drift, which is not a filter
            9_000_076,  # a queue that is slower than the frames
            9_000_102,  # samples that arrive while they are read, which the chip flags as an overrun
            9_000_147,  # polls that are early and late in turn, of a chip at its nominal rate
            9_000_093,  # a slow chip that is not polled in every frame
            9_000_128,  # a heating without a note and without a thermometer
            9_000_461,  # the same for a single accelerometer, in a quick heating
            9_000_460,  # flags that are very rare
            9_000_403,  # a recorder that is delayed within a frame
            9_000_123,  # a clock that differs from that of the track, in the only motion
            9_005_027,  # a draught without a recorded temperature
            9_005_045,  # readings that are equal by chance, which the recorder would flag if they were repeats
            9_005_046,  # readings that were requested before a stall of the recorder and received after it
            9_005_084,  # a heating without any temperature, and no other excitation
        ],
        0,
        1,
    ),
)
def test_a_world_without_a_mechanism_has_no_gap(tmp_path: Path, seed: int) -> None:
    with recorded(tmp_path, seed) as logs:
        compared = compare(recordings_of(logs), runner, Reference(None), replicates=REPLICATES)
        assert compared.comparison.localisation.p > 0.05


@pytest.mark.campaign
def test_a_dead_bit_is_detected_over_all_phases(tmp_path: Path) -> None:
    """Bit 4 of a gyroscope with a noise of 18 counts is always clear: half of the codes are missing, in
    seven phases. The quick half has `test_a_dead_bit_is_suggested` of tests/gap/effects.
    """
    with recorded(tmp_path, 1_060_059, Put("stuck_bit", 3.66, 5.0, ("Gyro3",))) as logs:
        compared = compare(recordings_of(logs), runner, Reference(None), replicates=REPLICATES)
        result = compared.comparison.localisation
        assert result.is_gap
        (sensor,) = result.root.significant("sensor")
        assert sensor.path[1] == "Gyro3"
        (first, *_) = result.p_by_place
        assert compared.comparison.pairs.keys[first].probe == "absent_codes"
