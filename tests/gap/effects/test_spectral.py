"""Effects on noise within a second: low-pass, lines; and the noise itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.inference.effects.noise import assign_signs, noise_of_logs, rarity_behind
from imuarray.gap.inference.evidence import Evidence, Span, When
from imuarray.gap.model.rest import FittedParameters
from imuarray.gap.model.signal_delay import SignalDelay
from imuarray.gap.statistics.lines import highest_lines
from imuarray.simulate.active_spans import spans_of
from imuarray.simulate.effects.bandwidth import Bandwidth
from imuarray.simulate.effects.noise import Tone, WhiteNoise
from imuarray.simulate.effects.timing import Skew
from tests.gap.effects.evidence_of import evidence_of
from tests.gap.small_campaign import RATE_HZ


def tones(kind: str, put_in: Tone, modelled: tuple[Tone, ...] = ()) -> list[Tone]:
    evidence = evidence_of(kind, "G1", {"G1": (put_in, *modelled)}, seed=7, modelled=modelled)
    trials = [trial for trial in CANDIDATES["tone"].guesses(evidence) if trial.action == "add"]
    return [effect for trial in trials for effect in trial.effects if isinstance(effect, Tone)]


@pytest.mark.parametrize("cutoff_hz", [5.0, 15.0, 30.0])
def test_a_cutoff_is_suggested(cutoff_hz: float) -> None:
    evidence = evidence_of("static", "G1", {"G1": (Bandwidth(cutoff_hz),)}, seed=7)
    first, *_ = (trial.effects[0] for trial in CANDIDATES["bandwidth"].guesses(evidence))
    assert isinstance(first, Bandwidth)
    assert first.cutoff_hz == pytest.approx(cutoff_hz, rel=0.1)


@pytest.mark.parametrize(("rows_per_s", "is_suggested"), [(100.0, True), (1.0, False)])
def test_correlations_of_a_minute_are_no_filter(
    monkeypatch: pytest.MonkeyPatch, rows_per_s: float, *, is_suggested: bool
) -> None:
    """The correlation of a filter of 0.5 Hz in 100 rows a second is that of one of 0.005 Hz in one row a second."""
    evidence = evidence_of("static", "G1", {"G1": (Bandwidth(0.5),)}, seed=7)
    monkeypatch.setattr(Evidence, "rows_per_s", rows_per_s)
    cutoffs_hz = [
        effect.cutoff_hz
        for trial in CANDIDATES["bandwidth"].guesses(evidence)
        for effect in trial.effects
        if isinstance(effect, Bandwidth)
    ]
    assert any(0.3 < cutoff_hz < 0.8 for cutoff_hz in cutoffs_hz) is is_suggested


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_filter_is_suggested_from_late_motion(share: float) -> None:
    evidence = evidence_of(("static", "motion"), "G1", {"G1": (Bandwidth(5.0, share),)}, seed=7)
    found = [
        one
        for trial in CANDIDATES["bandwidth"].guesses(evidence)
        for one in trial.effects
        if isinstance(one, Bandwidth)
    ]
    assert {one.share for one in found} == {0.0, share}
    assert [one for one in found if one.poles == 1][-1].cutoff_hz == pytest.approx(5.0, rel=0.1)


def test_a_filter_of_two_poles_is_suggested() -> None:
    """Lag 1 at 100 rows per second: exp(-a t) (cos a t + sin a t), a t = sqrt(2) pi 15 / 100."""
    evidence = evidence_of("static", "G1", {"G1": (Bandwidth(15.0, poles=2.0),)}, seed=7)
    found = [
        one
        for trial in CANDIDATES["bandwidth"].guesses(evidence)
        for one in trial.effects
        if isinstance(one, Bandwidth)
    ]
    (two,) = (one for one in found if one.poles == 2)
    assert two.cutoff_hz == pytest.approx(15.0, rel=0.1)


@pytest.mark.slow
def test_a_filter_too_fast_for_the_rows_is_suggested_from_its_delay() -> None:
    """60 Hz: 3.8 ms, and a correlation of -0.04 from row to row."""
    evidence = evidence_of(("static", "motion"), "G1", {"G1": (Bandwidth(60.0, 1.0, 2.0),)}, seed=7)
    trial = list(CANDIDATES["bandwidth"].guesses(evidence))[-1]
    (found,) = trial.effects
    assert isinstance(found, Bandwidth)
    assert (found.share, found.poles) == (1.0, 2.0)
    assert found.cutoff_hz == pytest.approx(60.0, rel=0.3)
    usual = replace(evidence.fitted, delay=SignalDelay(filter_s=0.002))
    delayed = replace(evidence, fitted=usual, effects=usual.effects())
    assert trial.effects[0] in [one.effects[0] for one in CANDIDATES["bandwidth"].guesses(delayed)]
    known = replace(delayed, effects=(*usual.effects(), found))
    assert trial.effects[0] not in [one.effects[0] for one in CANDIDATES["bandwidth"].guesses(known)]
    early = evidence_of(("static", "motion"), "G1", {"G1": (Skew(-0.004),)}, seed=7)
    assert not [
        one for one in CANDIDATES["bandwidth"].guesses(early) if one.effects[0] == replace(found, cutoff_hz=60.0)
    ]


@pytest.mark.slow
def test_a_filter_that_was_fitted_to_the_noise_is_suggested_for_the_signal() -> None:
    """The fit explains the correlation of the rows, 0.3 for 25 Hz, and leaves the delay, 9 ms = 1 / (sqrt(2) pi 25 Hz).
    A delay of another filter in the same motion is suggested by its own size.
    """
    late = evidence_of(("static", "motion"), "G1", {"G1": (Bandwidth(25.0, 1.0, 2.0, signal_only=1.0),)}, seed=7)
    evidence = replace(late, fitted=replace(late.fitted, low_pass=Bandwidth(20.0, poles=2.0)))
    own, by_delay = list(CANDIDATES["bandwidth"].guesses(evidence))[-2:]
    assert (own.effects, own.free) == ((Bandwidth(20.0, 1.0, 2.0, signal_only=1.0),), ())
    (effect,) = by_delay.effects
    assert isinstance(effect, Bandwidth)
    assert (effect.share, effect.poles, effect.signal_only) == (1.0, 2.0, 1.0)
    assert effect.cutoff_hz == pytest.approx(25.0, rel=0.2)
    header = replace(evidence.header, chip="l3g4200d", rate_hz=800.0, bandwidth_hz=110.0)  # 0.03 dps in 1 Hz
    usual, quiet = (
        replace(evidence, header=header, fitted=replace(evidence.fitted, rms=(0.03 * hz**0.5,) * 3)) for hz in (110, 28)
    )
    usual_rarity, quiet_rarity = (list(CANDIDATES["bandwidth"].guesses(item))[-1].rarity for item in (usual, quiet))
    assert usual_rarity > 1  # a filter at 25 Hz would leave half of the noise
    assert quiet_rarity == 0


def test_noise_below_the_data_sheet_suggests_a_filter() -> None:
    """30 mdps in 1 Hz are 0.18 dps rms in 35 Hz; two poles at 3.15 Hz pass 3.5 Hz, a third of the rms."""
    evidence = evidence_of("static", "G1", seed=5)
    header = replace(evidence.header, chip="l3g4200d", rate_hz=800.0, bandwidth_hz=35.0)
    usual, quiet = (
        replace(evidence, header=header, fitted=FittedParameters((rms,) * 3, *((0.0, 0.0, 0.0),) * 2))
        for rms in (0.03 * 35**0.5, 0.03 * 3.5**0.5)
    )
    assert rarity_behind(usual, 3.15) == pytest.approx(-rarity_behind(quiet, 3.15), abs=0.01)
    assert rarity_behind(quiet, 3.15) < -3  # 20 to 1
    assert rarity_behind(quiet, 500.0) == 0  # passes everything that the chip's own filter passes
    unknown = replace(quiet, header=replace(header, bandwidth_hz=0.0))
    assert rarity_behind(unknown, 3.15) == 0


def test_a_filter_from_a_moment_on_is_suggested_from_less_noise() -> None:
    """exp(-1/2) of the noise, on all axes: two poles pass that share of 35 Hz if they pass 35 / e = 12.9 Hz, which is
    pi / (2 sqrt 2) of the cutoff. Less noise on one axis suggests no filter.
    """
    evidence = evidence_of("static", "G1", seed=5)
    when = When((Span(0, 30.0, math.inf),))
    quiet = replace(
        evidence,
        header=replace(evidence.header, chip="l3g4200d", rate_hz=800.0, bandwidth_hz=35.0),
        values={**evidence.values, "noise": evidence.expected["noise"] - 0.5},
        scores={**evidence.scores, "noise": np.full_like(evidence.scores["noise"], -10.0)},
        when=when,
    )
    (trial,) = CANDIDATES["bandwidth"].guesses(quiet)
    (effect,) = trial.effects
    assert isinstance(effect, Bandwidth)
    assert effect.noise_share == pytest.approx(math.exp(-0.5))
    assert effect.cutoff_hz == pytest.approx(12.88 / 1.1107, rel=1e-3)
    one_axis = np.full_like(evidence.scores["noise"], -10.0)
    one_axis[:, 1] = 0.0
    assert not list(CANDIDATES["bandwidth"].guesses(replace(quiet, scores={**quiet.scores, "noise": one_axis})))


def test_a_line_is_suggested() -> None:
    """6000 rows: the amplitude's standard error is sqrt(2 / 6000) of the noise, 0.001 dps."""
    first, *_ = tones("static", Tone((0.0, 0.02, 0.0), 13.7))
    assert first.frequency_hz == pytest.approx(13.7, abs=0.02)
    assert first.amplitude == pytest.approx((0.0, 0.02, 0.0), abs=0.004)


@pytest.mark.slow
def test_a_line_beyond_half_the_rate_is_suggested_at_its_alias() -> None:
    first, *_ = tones("turn-on", Tone((0.0, 0.03, 0.01), 63.7))
    rate_hz = RATE_HZ
    assert first.frequency_hz == pytest.approx(rate_hz - 63.7, abs=0.1)
    assert first.amplitude[1] == pytest.approx(0.03, rel=0.2)


def test_mains_lines_are_recognised_by_their_alias() -> None:
    """60 Hz appears at 40 Hz at 100 rows per second."""
    first, *_ = tones("static", Tone((0.03,) * 3, 60.0))
    assert first.frequency_hz == 60.0


def test_a_line_of_the_model_is_not_suggested_again() -> None:
    known = Tone((0.04,) * 3, 21.0)
    first, *_ = tones("static", Tone((0.02,) * 3, 13.7), (known,))
    assert first.frequency_hz == pytest.approx(13.7, abs=0.02)
    trials = list(CANDIDATES["tone"].guesses(evidence_of("static", "G1", {"G1": (known,)}, seed=7, modelled=(known,))))
    assert [trial.action for trial in trials if trial.action == "remove"] == ["remove"]


@pytest.mark.slow
def test_a_drifting_line_is_suggested() -> None:
    """From 13 Hz by 0.04 Hz/s while the box is on six faces; the initial frequencies of other logs are
    not observable.
    """
    put_in = Tone((0.0, 0.05, 0.0), 13.0, drift_hz_per_h=144.0)
    (drifting,) = (tone for tone in tones("tumble", put_in) if tone.drift_hz_per_h)
    assert drifting.frequency_hz == pytest.approx(13.0, abs=0.3)
    assert drifting.drift_hz_per_h == pytest.approx(144.0, rel=0.2)
    assert drifting.amplitude == pytest.approx((0.0, 0.05, 0.0), rel=0.2, abs=0.01)
    assert drifting.frequency_spread_hz > 0
    assert all(tone.drift_hz_per_h == 0 for tone in tones("tumble", replace(put_in, drift_hz_per_h=0.0)))


def test_a_phase_of_a_single_code_suggests_no_line() -> None:
    """As with a converter with missing codes: its whole spectrum is 0."""
    (seen,) = evidence_of("static", "A1", seed=5).still
    silent = replace(seen.raw.spectrum, density=np.zeros_like(seen.raw.spectrum.density))
    assert list(highest_lines(silent, 3)) == []


def test_nothing_spectral_is_suggested_for_white_noise() -> None:
    evidence = evidence_of("static", "A1", seed=5)
    for candidate in (CANDIDATES["bandwidth"], CANDIDATES["tone"], CANDIDATES["white_noise"]):
        assert list(candidate.guesses(evidence)) == []


@pytest.mark.slow
def test_noise_of_a_sensor_without_rest_is_suggested() -> None:
    """In 20 s of motion; the part not explained by equally noisy sensors: sqrt(2) of the noise at most."""
    seen = evidence_of("motion", "A1", seed=5)
    nothing = FittedParameters(*((0.0, 0.0, 0.0),) * 3)
    lost = np.log(seen.noise / nothing.noise(seen.header))
    values = {**seen.values, "motion_residual": seen.values["motion_residual"] + 2 * lost}
    scores = {**seen.scores, "motion_residual": np.full((1, 3), 50.0)}
    (trial,) = CANDIDATES["white_noise"].guesses(replace(seen, fitted=nothing, values=values, scores=scores))
    (effect,) = trial.effects
    assert isinstance(effect, WhiteNoise)
    assert np.all((np.array(effect.rms) > 0.002) & (np.array(effect.rms) < 0.2))


@pytest.mark.parametrize(
    ("between_axes", "expected"),
    [
        ((0.5, 0.5, 0.5), (1.0, 2.0, 3.0)),
        ((-0.5, 0.5, -0.5), (-1.0, 2.0, 3.0)),
        ((-0.5, -0.5, 0.5), (1.0, -2.0, 3.0)),
        ((0.5, -0.5, -0.5), (1.0, 2.0, -3.0)),
    ],
)
def test_a_line_in_antiphase_has_the_sign_of_the_correlations(
    between_axes: tuple[float, float, float], expected: tuple[float, float, float]
) -> None:
    """A sine of amplitudes a and b on two axes has the sign of a b in their covariance, a b / 2."""
    assert assign_signs((1.0, 2.0, 3.0), np.array(between_axes)) == expected


def test_an_axis_without_the_line_has_no_sign() -> None:
    x, y, z = assign_signs((1.0, 0.0, 3.0), np.array([-0.9, -0.9, 0.1]))
    assert (y, x * z) == (0.0, 3.0)


def test_a_temporary_filter_is_suggested_from_less_noise() -> None:
    """Half of the noise remains; the cutoff is that of the correlation; the filter of the model stays."""
    evidence = evidence_of("static", "G1", {"G1": (Bandwidth(15.0),)}, seed=7, modelled=(Bandwidth(30.0),))
    quiet = {"noise": np.full_like(evidence.values["noise"], math.log(0.5))}
    none = {"noise": np.zeros_like(quiet["noise"])}
    spell = replace(
        evidence,
        values={**evidence.values, **quiet},
        expected={**evidence.expected, **none},
        when=When((Span(0, 20.0, math.inf),)),
    )
    first, *_ = CANDIDATES["bandwidth"].guesses(spell)
    (effect,) = first.effects
    assert isinstance(effect, Bandwidth)
    assert effect.noise_share == pytest.approx(0.5)
    assert effect.cutoff_hz == pytest.approx(15.0, rel=0.1)
    assert (first.action, first.free) == ("add", ("cutoff_hz", "noise_share"))
    always, *_ = (trial for trial in CANDIDATES["bandwidth"].guesses(evidence) if trial.effects)
    assert (always.action, always.free) == ("replace", ("cutoff_hz",))


@pytest.mark.slow
def test_a_permanent_increase_of_noise_is_suggested() -> None:
    """0.05 dps and, from 30 s of the first log on, 0.1 dps more on one axis, as in the log after it."""
    grown = WhiteNoise((0.0, 0.1, 0.0), spans=spans_of(((0, 30.0, math.inf), (1, 0.0, math.inf))))
    evidence = evidence_of(("static", "tumble"), "G1", {"G1": (grown,)}, seed=7)
    trial = next(trial for trial in CANDIDATES["white_noise"].guesses(evidence) if trial.when.triples[0][1] > 0)
    (effect,) = trial.effects
    assert isinstance(effect, WhiteNoise)
    assert effect.rms == pytest.approx((0.0, 0.1, 0.0), abs=0.01)
    assert [log for log, _, _ in trial.when.triples] == [0, 1]
    assert trial.when.triples[0][1] == pytest.approx(30.0, abs=2.0)
    assert trial.fitted is not None
    assert trial.fitted.rms == pytest.approx((0.05, 0.05, 0.05), rel=0.15)


@pytest.mark.slow
def test_logs_with_less_noise_on_all_axes_suggest_a_filter() -> None:
    """The log at rest has three times the noise of the tumble, whose noise was filtered: 35 Hz of the chip's noise, one
    ninth of whose power remains, and two poles, which pass pi / (2 sqrt(2)) of their cutoff.
    """
    noisy = WhiteNoise((0.05 * math.sqrt(8),) * 3, spans=spans_of(((0, 0.0, math.inf),)))
    evidence = evidence_of(("static", "tumble"), "G1", {"G1": (noisy,)}, seed=7)
    trial = next(trial for trial in CANDIDATES["bandwidth"].guesses(evidence) if trial.when.spans)
    (effect,) = trial.effects
    assert isinstance(effect, Bandwidth)
    assert effect.noise_share == pytest.approx(1 / 3, rel=0.1)
    assert effect.cutoff_hz == pytest.approx(35 / 9 * 2 * math.sqrt(2) / math.pi, rel=0.2)
    assert [log for log, _, _ in trial.when.triples] == [1]
    assert trial.fitted is not None
    assert trial.fitted.rms == pytest.approx((0.15,) * 3, rel=0.1)


@pytest.mark.campaign
def test_noise_of_most_logs_above_that_of_a_quiet_log_is_suggested() -> None:
    """0.05 dps in one log at rest and 0.15 dps in two others: the fit is that of these two."""
    noisy = WhiteNoise((0.05 * math.sqrt(8),) * 3, spans=spans_of(((1, 0.0, math.inf), (2, 0.0, math.inf))))
    evidence = evidence_of(("static", "tumble", "tumble"), "G1", {"G1": (noisy,)}, seed=7)
    logs = noise_of_logs(evidence)
    assert logs is not None
    assert (logs.quiet, logs.noisy) == ((0,), (1, 2))
    assert np.exp(logs.more - logs.less) == pytest.approx((3.0,) * 3, rel=0.1)


@pytest.mark.slow
def test_an_increase_of_noise_is_suggested_for_any_order_of_logs() -> None:
    """From 30 s of the second log on, and in the first: the logs of equal noise, in any order of their dates."""
    grown = WhiteNoise((0.0, 0.1, 0.0), spans=spans_of(((0, 0.0, math.inf), (1, 30.0, math.inf))))
    evidence = evidence_of(("tumble", "static"), "G1", {"G1": (grown,)}, seed=7)
    trials = [trial for trial in CANDIDATES["white_noise"].guesses(evidence) if trial.when.spans]
    assert any(
        [log for log, _, _ in trial.when.triples] == [0, 1] and trial.when.triples[1][1] > 25 for trial in trials
    )
