"""clock_error, jitter, dropped_samples, skew: suggested from motion of several sensors, and from gaps."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.gap.inference.effects import CANDIDATES, timing
from imuarray.gap.inference.effects.candidate import Hypothesis
from imuarray.gap.inference.effects.timing import guess_skew, late
from imuarray.gap.inference.evidence import Evidence, Span
from imuarray.gap.model.signal_delay import SignalDelay
from imuarray.gap.recording.events import Host
from imuarray.gap.recording.host_lag import HostLag
from imuarray.log.format import Phase
from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.timing import ClockError, DroppedSamples, Jitter, Skew
from tests.gap.effects.evidence_of import evidence_of
from tests.gap.small_campaign import RATE_HZ
from tests.selection import some

ALL = ("clock_error", "dropped_samples", "jitter", "skew")


def shown(kind: str, sensor: str, effect: Effect) -> Evidence:
    return evidence_of(kind, sensor, {sensor: (effect,)})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["static", "motion"])
@pytest.mark.parametrize("sensor", ["A1", "G1"])
def test_nothing_is_suggested_without_evidence(kind: str, sensor: str) -> None:
    assert not [trial for name in ALL for trial in CANDIDATES[name].guesses(evidence_of(kind, sensor))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "delay_s"), some([("G1", 0.002), ("G1", 0.005), ("A1", -0.02), ("A1", 0.1), ("G1", -0.08)], 2)
)
def test_a_skew_is_suggested(sensor: str, delay_s: float) -> None:
    """A tenth of a second is most of half a period of the fastest part of the motion, 6 Hz."""
    trial = next(iter(CANDIDATES["skew"].guesses(shown("motion", sensor, Skew(delay_s)))))
    (found,) = trial.effects
    assert isinstance(found, Skew)
    assert found.delay_s == pytest.approx(delay_s, rel=0.4)
    assert trial.free == ("delay_s",)
    assert (trial.rarity > 0) == (delay_s < 0)  # readings are made before their stamps


@pytest.mark.parametrize("hz", [0.5, 2.0, 3.0])
def test_a_skew_in_a_motion_that_windows_hardly_resolve(hz: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sine of angular frequency w in windows of T changes by sin(w T) / T from window to window, and so does one of
    pi / T - w: a lag of 45 ms is either of two lags. In a slow motion only one is plausible.
    """
    width_s, delay_s, pace = 0.1, 0.045, 2 * math.pi * hz
    rate = math.sin(pace * width_s) / width_s
    cross = SimpleNamespace(window_s=width_s)
    motion = Phase(0, 10_000_000_000, "motion", ""), cross
    monkeypatch.setattr(timing, "motions", lambda evidence: [motion])
    monkeypatch.setattr(timing, "_pace", lambda *_: (np.full(3, rate), np.ones(3)))
    monkeypatch.setattr(timing, "quadrature", lambda *_: np.full(3, math.sin(pace * delay_s) / rate))
    monkeypatch.setattr(timing, "along", lambda *_: np.full(3, math.cos(pace * delay_s)))
    monkeypatch.setattr(timing, "_usual_of", lambda evidence, probe, otherwise: np.full(3, otherwise))
    header = SimpleNamespace(name="G1")
    evidence = SimpleNamespace(header=header, is_odd=lambda *_, **__: True, score=lambda _: np.zeros(3))
    skews = [trial.effects[0] for trial in guess_skew(cast(Evidence, evidence))]
    delays_s = [effect.delay_s for effect in skews if isinstance(effect, Skew)]
    assert min(abs(found_s - delay_s) for found_s in delays_s) < 1e-9
    assert len(delays_s) == (1 if hz < 1 else 2)


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "error_ppm"), some([("A1", 2000.0), ("G1", -1000.0), ("G1", 300.0)], 1))
def test_a_clock_error_is_suggested(sensor: str, error_ppm: float) -> None:
    (trial,) = CANDIDATES["clock_error"].guesses(shown("motion", sensor, ClockError(error_ppm)))
    (found,) = trial.effects
    assert isinstance(found, ClockError)
    assert found.error_ppm == pytest.approx(error_ppm, rel=0.3)
    assert trial.free == ("error_ppm",)


def test_a_clock_error_of_the_host_is_suggested() -> None:
    """All sensors lag by 4 ms at the epoch, and by 1 ms more each second (a fast clock: -1000 ppm); or at a rate that
    settles within 30 s, 0.001 (t - 30 s (1 - exp(-t / 30 s))). A sensor with a slow oscillator has a constant lag, and
    suggests no clock error.
    """
    at_s = np.linspace(5, 100, 12)
    bare = evidence_of("static", "A1")
    assert not _of_the_host(bare, at_s, 0.004 + 3e-4 * np.cos(at_s))
    (steady,) = _of_the_host(bare, at_s, 0.004 + 1e-3 * at_s)
    (constant,) = steady.effects
    assert steady.everywhere
    assert isinstance(constant, ClockError)
    assert (constant.error_ppm, constant.warm_up_ppm) == (pytest.approx(-1000.0), 0.0)
    _, settling = _of_the_host(bare, at_s, 0.004 + 1e-3 * (at_s + 30 * np.expm1(-at_s / 30)))
    (warm,) = settling.effects
    assert isinstance(warm, ClockError)
    assert (warm.error_ppm, warm.warm_up_ppm) == (pytest.approx(-1000.0, rel=0.05), pytest.approx(1000.0, rel=0.05))
    assert warm.warm_up_s == pytest.approx(30.0, rel=0.1)
    assert not _of_the_host(bare, at_s[:2], 0.01 * at_s[:2])


def test_a_clock_error_of_the_host_corrects_the_fitted_delay() -> None:
    """Lags of t / 1000 from 5 s to 100 s, half of which are before 52.5 s: the fit has their mean, 52.5 ms, which the
    clock error explains.
    """
    bare = evidence_of("static", "A1")
    delayed = replace(bare, fitted=replace(bare.fitted, delay=SignalDelay(stamp_s=0.0525)))
    at_s = np.linspace(5, 100, 12)
    bare_trial, beside = _of_the_host(delayed, at_s, 1e-3 * at_s)
    assert len(bare_trial.effects) == 1
    clock, skew = beside.effects
    assert isinstance(clock, ClockError)
    assert isinstance(skew, Skew)
    assert (clock.error_ppm, skew.delay_s) == (pytest.approx(-1000.0), pytest.approx(-0.0525))


def _of_the_host(evidence: Evidence, at_s: npt.NDArray[np.float64], lag_s: npt.NDArray[np.float64]) -> list[Hypothesis]:
    """The suggestions from lags that are known to 0.2 ms."""
    lags = tuple(HostLag(at, lag, 2e-4) for at, lag in zip(at_s.tolist(), lag_s.tolist(), strict=True))
    return list(CANDIDATES["clock_error"].guesses(replace(evidence, hosts=(Host(lags=lags),))))


def test_a_large_clock_error_is_suggested_with_both_signs() -> None:
    """At 10 000 ppm the time error is a seventh of a second in the middle of the motion, about a period."""
    trials = list(CANDIDATES["clock_error"].guesses(shown("motion", "G1", ClockError(-10000.0))))
    assert 2 <= len(trials) <= 4
    found = [effect.error_ppm for trial in trials for effect in trial.effects if isinstance(effect, ClockError)]
    assert any(0.5 < error / -10000 < 2 for error in found)


@pytest.mark.parametrize(("sensor", "rms_s"), some([("G1", 0.002), ("G1", 0.004), ("A1", 0.002)], 1))
def test_jitter_is_suggested(sensor: str, rms_s: float) -> None:
    trial = next(iter(CANDIDATES["jitter"].guesses(shown("motion", sensor, Jitter(rms_s)))))
    (found,) = trial.effects
    assert isinstance(found, Jitter)
    assert found.rms_s == pytest.approx(rms_s, rel=0.5)
    assert trial.free == ("rms_s",)


def test_delays_of_the_host_are_suggested() -> None:
    """From the times of all rows: 40 of 1000 waited, half of them 3 ms; in every sensor, before the transfer or, more
    rarely, after it. Without a deviating statistic nothing is suggested.
    """
    odd = shown("motion", "G1", Jitter(0.004))
    host = (Host(600, 30, 30 * 9e-6, 1), Host(400, 10, 10 * 9e-6))
    before, behind = (trial for trial in CANDIDATES["jitter"].guesses(replace(odd, hosts=host)) if trial.everywhere)
    for trial, told in ((before, 1.0), (behind, -1.0)):
        (effect,) = trial.effects
        assert isinstance(effect, Jitter)
        assert (effect.rms_s, effect.share, effect.wait_share) == (pytest.approx(0.003), 0.04, told)
    assert before.shared
    assert before.rarity < behind.rarity
    assert not any(trial.everywhere for trial in CANDIDATES["jitter"].guesses(replace(odd, hosts=(Host(1000),))))
    assert not list(CANDIDATES["jitter"].guesses(replace(odd, hosts=host, scores={})))


def test_late_rows_are_repeated() -> None:
    """Rows every 10 ms of a chip with the same period: a row late by w is repeated with the probability w / 10 ms, and
    for exponential w of mean m with m / 10 ms (1 - e^(-10 ms / m)). 5 ms for a tenth of rows give 4.3 %, and sqrt(2
    0.1) 5 ms for all; without such information they are late by a row.
    """
    (trial,) = late(0.1 * 0.5 * (1 - math.exp(-2)), math.sqrt(0.2) * 5e-3, 0.01, 100.0)
    (found,) = trial.effects
    assert isinstance(found, Jitter)
    assert found.rms_s == pytest.approx(math.sqrt(2) * 5e-3, rel=0.1)
    assert found.share == pytest.approx(0.1, rel=0.1)
    assert trial.free == ("rms_s", "share")
    ((untold,),) = (one.effects for one in late(0.02, 0.0, 0.01, 100.0))
    assert isinstance(untold, Jitter)
    assert untold.rms_s == pytest.approx(math.sqrt(2) * 0.01, rel=0.1)
    assert untold.share == pytest.approx(0.02 / (1 - math.exp(-1)), rel=0.1)
    assert not list(late(0.02, 0.0, 0.01, 0.0))  # a chip without a rate returns the current value


@pytest.mark.parametrize(("probability", "burst_rows"), [(0.03, 3.0), (0.1, 1.0), (0.2, 10.0), (0.3, 30.0)])
def test_dropped_samples_are_suggested(probability: float, burst_rows: float) -> None:
    """6000 rows: 60 to 600 bursts, whose share scatters by up to a third."""
    evidence = shown("static", "A1", DroppedSamples(probability, burst_rows))
    (trial,) = CANDIDATES["dropped_samples"].guesses(evidence)
    (found,) = trial.effects
    assert isinstance(found, DroppedSamples)
    assert 1 / 2 < found.burst_rows / burst_rows < 2
    lost = 1 - evidence.phases[0].raw.rows / 6000
    assert found.probability == pytest.approx(lost, abs=0.01)
    assert trial.free == (("probability", "burst_rows") if burst_rows > 1 else ("probability",))


def test_stalls_of_the_recorder_are_not_lost_rows() -> None:
    """100 rows were lost, one at a time; 500 other intervals are long, and a third of the time has no rows."""
    evidence = shown("static", "A1", DroppedSamples(0.02))
    (phase,) = evidence.phases
    intervals = replace(phase.raw.intervals, gaps=600, longest_s=3.0)
    stalled = replace(phase.raw, intervals=intervals, rows=2 * phase.raw.rows // 3)
    start_s, end_s = phase.raw.phase.start_ns * 1e-9, phase.raw.phase.end_ns * 1e-9
    inside = [Span(phase.log, moment_s, 1 / RATE_HZ) for moment_s in np.linspace(start_s, end_s, 100, endpoint=False)]
    outside = [Span(phase.log, end_s + number, 1 / RATE_HZ) for number in range(50)]
    changed = replace(evidence, phases=(replace(phase, raw=stalled),), holes=(*inside, *outside))
    (trial,) = CANDIDATES["dropped_samples"].guesses(changed)
    (effect,) = trial.effects
    assert isinstance(effect, DroppedSamples)
    assert effect.probability == pytest.approx(100 / (stalled.rows + 100))
    assert effect.burst_rows == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "effect", "kind"),
    some(
        [
            ("skew", Skew(0.01), "motion"),
            ("clock_error", ClockError(500.0), "motion"),
            ("jitter", Jitter(0.001), "motion"),
            ("dropped_samples", DroppedSamples(0.1), "static"),
        ],
        2,
    ),
)
def test_an_effect_of_the_model_alone_is_removed(name: str, effect: Effect, kind: str) -> None:
    evidence = evidence_of(kind, "A1", modelled=(effect,))
    assert list(CANDIDATES[name].guesses(evidence)) == [Hypothesis((), removed=effect.name)]
