"""Effects that act for a part of the time: inside as without spans, outside as without the effect."""

from __future__ import annotations

import numpy as np
import pytest

from imuarray.errors import ConfigError
from imuarray.simulate import Simulation, plan_of
from imuarray.simulate.active_spans import effects_in, spans_of
from imuarray.simulate.effect import FOREVER_S, Effect, from_table, to_table
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.conversion import OdrError, Quantisation
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.readings import StaleSamples
from imuarray.simulate.effects.response import Scale
from imuarray.simulate.effects.temperature import ThermalLag
from imuarray.simulate.effects.timing import DroppedSamples, Jitter
from imuarray.simulate.motion.faces import Still
from tests.gap.small_bench import array_of

BASE = (WhiteNoise(0.2),)


def rows(*effects: Effect, run: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and counts of 20 s of a gyroscope at rest."""
    motion = Still(seconds=20)
    plan = plan_of(array_of("G1"), 100.0, motion.seconds)
    sensor = Simulation(plan, motion, {"G1": (*BASE, *effects)}, seed=3, boot=run).sensors["G1"]
    block = sensor.block(0, sensor.rows)
    return block.time * 1e-9, block.counts


@pytest.mark.parametrize(
    "effect",
    [Tone(0.5, 17.0), Bandwidth(5.0), Quantisation(2.0), Quantisation(8.0), Scale(0.5), StaleSamples(0.3)],
    ids=lambda effect: effect.name,
)
def test_an_effect_acts_only_within_its_spans(effect: Effect) -> None:
    time_s, never = rows()
    always = rows(effect)[1]
    spans = spans_of([(0, 4.0, 9.5), (0, 15.0, np.inf), (2, 0.0, np.inf)])
    some = type(effect)(**{**vars(effect), "spans": spans})
    inside = ((time_s >= 4.0) & (time_s < 9.5)) | (time_s >= 15.0)
    np.testing.assert_array_equal(rows(some)[1], np.where(inside[:, None], always, never))
    np.testing.assert_array_equal(rows(some, run=1)[1], rows(run=1)[1])
    np.testing.assert_array_equal(rows(some, run=2)[1], rows(effect, run=2)[1])


def test_rows_are_lost_only_within_a_span() -> None:
    time_s, _ = rows(DroppedSamples(0.3, spans=(0.0, 4.0, 9.0)))
    inside = np.count_nonzero((time_s >= 4.0) & (time_s < 9.0))
    assert 300 < inside < 400
    assert len(time_s) - inside == 1500


def test_effects_on_a_whole_run_refuse_partial_spans() -> None:
    """The rate of a chip can differ in some runs, not in a part of a run."""
    whole = OdrError(50.0, spans=spans_of([(0, 0.0, np.inf)]))
    assert (np.diff(rows(whole)[1], axis=0) == 0).all(axis=1).mean() > 0.4
    np.testing.assert_array_equal(rows(whole, run=1)[1], rows(run=1)[1])
    with pytest.raises(ValueError, match="part of a run"):
        rows(OdrError(50.0, spans=(0.0, 4.0, 9.0)))
    with pytest.raises(ValueError, match="part of a run"):
        rows(ThermalLag(10.0, spans=(0.0, 4.0, 9.0)))


def test_spans_are_stored_in_a_model_file() -> None:
    tone = Tone(0.5, 17.0, spans=spans_of([(0, 4.0, np.inf)]))
    table = to_table(tone, "dps")
    assert table == {"amplitude_dps": 0.5, "frequency_hz": 17.0, "spans": [0.0, 4.0, FOREVER_S]}
    assert from_table(Tone, table, "dps", "here") == tone
    for spans in ([0.0, 4.0], [0.0, 4.0, 4.0]):
        with pytest.raises(ConfigError, match="three numbers each are required"):
            from_table(Tone, {"spans": spans}, "dps", "here")


def test_inactive_effects_are_removed_unless_they_change_other_draws() -> None:
    """A tone before another one has another random phase than a single tone; a jitter defines how rows are read."""
    always, later = Tone((0.1, 0.0, 0.0), 3.0), Tone((0.1, 0.0, 0.0), 3.0, spans=(2.0, 0.0, 1e9))
    jitter = Jitter(1.0, spans=(2.0, 0.0, 1e9))
    assert effects_in(1, (always, later)) == (always,)
    assert effects_in(2, (always, later)) == (always, later)
    assert effects_in(1, (later, always)) == (later, always)
    assert effects_in(1, (jitter, always)) == (jitter, always)
