"""Holds and losses that are listed individually: the suggestion from a recording reproduces them in its simulation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.inference.comparison import prepare
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.readings import _with_first_reading
from imuarray.gap.inference.evidence import Evidence, Repetition, ScoredStatistics, Span, evidence_of
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.recording.events import repeated_rows_in
from imuarray.gap.recording.recordings import Recording, recording_of
from imuarray.gap.statistics.campaign import Campaign
from imuarray.log import open_log
from imuarray.log.format import LOST_BEFORE, STALE
from imuarray.simulate import Simulation
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.readings import Glitches, Stuck
from imuarray.simulate.effects.timing import DroppedSamples
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.record import write_log
from tests.gap.small_campaign import BASE, simulation
from tests.selection import some

TORN_S = (8.004, 13.004, 21.004)
TORN_G = 128 / 2048

DONE: dict[str, tuple[Effect, ...]] = {
    "A1": (Glitches(runs=(0.0,) * 3, moments_s=TORN_S, jumps=(TORN_G, 0.0, 0.0) * 3),),
    "A2": (DroppedSamples(0.004, 2.0),),
    "G1": (Stuck(duration_s=0.2, every_s=4.0, kind="new"),),
    "G2": (Stuck(duration_s=0.2, every_s=4.0),),
}

Made = tuple[Simulation, Recording, Bench, Campaign]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    path = tmp_path_factory.mktemp("log") / "log.h5"
    origin = simulation(HandShake(peak_g=1.0, peak_dps=100.0, still_s=5, motion_s=20), DONE, seed=4)
    write_log(origin, path)
    with open_log(path) as log:
        recording = recording_of(log)
        bench, campaign = prepare([recording], None, 0)
        yield origin, recording, bench, campaign


def shown(made: Made, sensor: str) -> Evidence:
    """Evidence with large scores: every statistic differs from the model, which repeats no row."""
    *_, bench, campaign = made
    places = bench.columns((sensor,), cross=True)
    nothing = np.zeros(len(places))
    parts = bench.held_out[places].tolist()
    scored = ScoredStatistics([bench.keys[at] for at in places], parts, nothing, nothing, nothing + 50.0)
    return evidence_of(bench, bench.split.both(campaign), sensor, scored, SensorModel(bench.base.fitted[sensor]), ())


def again(made: Made, sensor: str, effect: Effect) -> Simulation:
    """The recording's plan, with that effect and other noise."""
    _, recording, *_ = made
    plan, motion, *_ = recording.experiment
    return Simulation(plan, motion, {**BASE, sensor: (*BASE[sensor], effect)}, seed=77)


def _flagged(status: npt.ArrayLike, flag: int) -> npt.NDArray[np.bool_]:
    return np.asarray(np.asarray(status) & flag != 0)


@pytest.mark.slow
@pytest.mark.parametrize("has_readings", some([False, True], 1))
@pytest.mark.parametrize(("sensor", "kind"), some([("G1", "new"), ("G2", "stale")], 1))
def test_held_rows_are_reproduced(made: Made, sensor: str, kind: str, has_readings: bool) -> None:
    """With a noise of some counts three rows are not equal by chance; the flag is unchanged. The readings are those of
    the recording, or those that the simulation repeats.
    """
    trials = [trial for trial in CANDIDATES["stuck"].guesses(shown(made, sensor)) if trial.whole]
    trial = trials[has_readings]
    assert len(trials) == 2
    (effect,) = trial.effects
    assert isinstance(effect, Stuck)
    assert effect.kind == kind
    assert trial.rarity == min(len(effect.moments_s), 4)  # a nat each; of more the moments do not matter
    assert trial.rarity > 0
    _, recording, _, campaign = made
    simulated = again(made, sensor, effect).sensors[sensor]
    block = simulated.block(0, simulated.rows)
    there, real = repeated_rows_in([block]), campaign.logs[0].events[sensor].repeated
    np.testing.assert_array_equal(there.begin_ns, real.begin_ns)
    np.testing.assert_array_equal(there.end_ns, real.end_ns)
    assert np.array_equal(there.counts, real.counts) == has_readings
    assert (_flagged(block.status, STALE) == _flagged(recording.log[sensor].status[:], STALE)).all()


def test_a_repetition_of_the_first_row_is_reproduced() -> None:
    """The first repetition is a row of 10 ms later; its interval begins half a row before it."""
    repetition = Repetition(Span(0, 0.005, 0.03), 3, (1, 2, 3))
    assert _with_first_reading(repetition) == pytest.approx(Span(0, 0.0, 0.035))


@pytest.mark.slow
def test_lost_rows_are_reproduced(made: Made) -> None:
    """All rows missing between the first and the last received row, and no others."""
    (trial,) = [trial for trial in CANDIDATES["dropped_samples"].guesses(shown(made, "A2")) if trial.whole]
    (effect,) = trial.effects
    _, recording, *_ = made
    simulated = again(made, "A2", effect).sensors["A2"]
    block = simulated.block(0, simulated.rows)
    np.testing.assert_array_equal(block.time, recording.log["A2"].time[:])
    assert (_flagged(block.status, LOST_BEFORE) == _flagged(recording.log["A2"].status[:], LOST_BEFORE)).all()
    assert len(block.time) < simulated.rows


@pytest.mark.slow
def test_torn_readings_in_motion_are_reproduced(made: Made) -> None:
    """By two units of the high byte of a BMA180 (BMA-60), which a comparison of neighbours cannot detect in the
    shaking.
    """
    (trial,) = [trial for trial in CANDIDATES["glitches"].guesses(shown(made, "A1")) if trial.whole]
    (effect,) = trial.effects
    assert isinstance(effect, Glitches)
    found = sorted(zip(effect.moments_s, effect.jumps[::3], strict=True))
    assert [moment_s for moment_s, _ in found] == pytest.approx(TORN_S, abs=0.015)
    assert [jump for _, jump in found] == [TORN_G] * 3
