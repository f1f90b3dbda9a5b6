"""A motion drives the emulated array."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from firmware_emulator.array import open_array
from firmware_emulator.world import WorldStimulus as EmulatedStimulus
from imuarray.acquire import record
from imuarray.array import parse_array
from imuarray.log import Log
from imuarray.simulate.motion import HandShake, Heating, Still, Tumble
from imuarray.simulate.motion.like import LikeLog
from tests.selection import some
from tests.simulate.motion_world import MotionWorld

G = 9.80665
S = 10**9
ARRAY = parse_array(
    """
[array]
name = "pair"
[[sensor]]
name = "ADXL"
chip = "adxl345"
address = 0x53
range = 16
rate_hz = 400
axes = "+X+Y+Z"
[[sensor]]
name = "Gyro"
chip = "l3g4200d"
address = 0x68
range = 2000
rate_hz = 400
axes = "+Y-X+Z"
"""
)


def test_its_stimulus_is_that_of_the_emulator() -> None:
    shown = MotionWorld(Still())(0)
    assert shown == EmulatedStimulus()
    assert all(type(value) is float for value in (*shown.force_box, *shown.rate_box, *shown.field_box, *shown[2:4]))


@pytest.mark.parametrize(
    "motion",
    some(
        [
            Still("-X", drift_degc_per_h=100.0),
            Tumble(0.3, 0.2, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)),
            Heating(scale=1e-3),
            HandShake(still_s=0.5, motion_s=1.0),
        ],
        3,
    ),
)
def test_the_world_equals_the_motion_at_any_instant(motion: Still | Tumble | Heating | HandShake) -> None:
    """Forwards, then in random order: results kept from an earlier call are never returned at another time."""
    world = MotionWorld(motion)
    end_ns = round(motion.seconds * S)
    times = [*range(-S // 10, min(end_ns, 7 * S) + S // 10, 13_456_789)]
    times += np.random.default_rng(5).permutation(times).tolist()
    stimulus = motion.stimulus(np.array(times))
    for row, at_ns in enumerate(times):
        shown = world(at_ns)
        assert shown.force_box == tuple(stimulus.force_box[row])
        assert shown.rate_box == tuple(stimulus.rate_box[row])
        assert shown.field_box == tuple(stimulus.field_box[row])
        assert (shown.temperature_degc, shown.pressure_pa) == (
            stimulus.temperature_degc[row],
            stimulus.pressure_pa[row],
        )
    assert world.phases == motion.phases


@pytest.mark.slow
def test_the_emulated_array_measures_the_motion_and_the_log_contains_it(tmp_path: Path) -> None:
    """Recorded through the emulated chips; the truth in the log is the motion, and a motion again. The errors of the
    units at rest are small compared with 0.3 g and with the shaking.
    """
    motion = HandShake(peak_g=4.0, peak_dps=400.0, still_s=1.0, motion_s=2.0)
    path = tmp_path / "log.h5"
    with open_array(ARRAY, world=MotionWorld(motion)) as bus:
        begin = datetime(2024, 1, 1, tzinfo=UTC)
        record(ARRAY, bus, path, rate_hz=200.0, seconds=3.5, phases=bus.phases, wall_time=begin)
    with Log(path) as log:
        assert log.truth is not None
        assert [phase.name for phase in log.phases] == ["static", "motion", "static"]
        offset_ns = log.phases[1].start_ns - motion.phases[1].start_ns
        assert -S // 2 < offset_ns < 0  # the log begins when the chips are set up, a moment after the world did
        times = np.asarray(log.truth.time)
        expected = motion.stimulus(times - offset_ns)
        assert np.asarray(log.truth.specific_force) == pytest.approx(expected.force_box, abs=1e-12)
        assert np.asarray(log.truth.angular_rate) == pytest.approx(expected.rate_box, abs=1e-12)
        force = log["ADXL"].counts[:] / log["ADXL"].sensitivity
        at = np.asarray(log["ADXL"].time) - offset_ns
        still = at < S
        assert np.median(force[still], axis=0) == pytest.approx([0, 0, 1], abs=0.3)
        felt_g = motion.stimulus(at).force_box / G
        assert np.corrcoef(force.ravel(), felt_g.ravel())[0, 1] > 0.95
        again = LikeLog(log)
        assert again.source == "truth"
        assert again.stimulus(times).force_box == pytest.approx(expected.force_box, abs=1e-12)
