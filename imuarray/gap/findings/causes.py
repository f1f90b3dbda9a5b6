"""The causes of a gap with their parameters, their origins, and the quantities of parts beyond tolerance that they
explain.

A cause is an effect that the search accepted. It has a probability and a list of the effects with which it can be
confused. A signal that many sensors measure along the same box axes is in the environment and is not a sensor fault. A
pull is a nuisance quantity of a part compared with its tolerance, and is listed with the causes that may explain it: it
is fitted without the causes. For example, if a sensor measures in another range than configured, the fit makes its
scale factor wrong, which is not a second finding.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats, triple
from imuarray.gap.findings.diagnosis import CandidateEvaluation, Cause, Origin, Pull
from imuarray.gap.findings.text import listed_causes
from imuarray.gap.findings.verdict import DeviatingStatistics, calibrated_probability, deviating, deviating_in_either
from imuarray.gap.inference.effects import Hypothesis
from imuarray.gap.inference.effects.candidate import Action
from imuarray.gap.inference.forward_selection import BRIEF, COST, Evaluation, Round
from imuarray.gap.inference.unit_state import Unit, UnitState
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.nuisance import NuisanceEstimate
from imuarray.gap.model.replication import SensorModel
from imuarray.gap.model.rest import REFERENCE_DEGC
from imuarray.gap.statistics.catalogue import AXES
from imuarray.gap.statistics.environment import AMPLITUDE_RATIO, LEAST_COMMON_SHARE, Pace, SharedSignal
from imuarray.log.format import SensorHeader
from imuarray.printable import series
from imuarray.simulate.effect import Effect, to_table
from imuarray.simulate.effects.temperature import ThermalBias

TEMPER = 0.3
"""Power to which the odds of a trial are raised for its probability."""

ALTERNATIVE = 0.1
"""Least probability at which an alternative effect is reported as a cause."""

LEAST = 0.03
"""Least share of the remaining gap that a cause closes. An effect that closes less may be present, but does not cause
the gap.
"""

CONFUSABLE = 0.05
"""Least odds of an effect against the accepted cause, 1 to 20, at which both are confusable."""

NEAREST_NATS = 3.0
"""Least gain, in nats, of an effect that is named although none was accepted: its gain on both parts together, less
that of the placebo and the cost of its parameters.
"""

NEAREST_RIGHT = 0.4
"""Rate at which an effect without a rival that is named in this way is right."""

_SAME, _SAME_FREQUENCY = 1.25, 1.01
"""Largest ratio of the parameters of two sensors, and of their frequencies, at which they are regarded as equal."""

_METADATA = frozenset({"axis_error", "channel_swap", "clock_error"})
"""Causes in the metadata of a log or array, not in a sensor."""


def probabilities(round_: Round, present: Collection[str] = ()) -> list[float]:
    """Return the probability of each confirmed trial of a round; the rest is the probability that none of them is
    right. Effects that are already `present` are not rivals and have probability 0.
    """
    odds = TEMPER * np.array([*round_.log_odds, 0.0])
    rivals = np.array([*(trial.trial.name not in present for trial in round_.confirmed), True])
    weights = np.where(rivals, np.exp(odds - odds.max(initial=0.0, where=rivals)), 0.0)
    return list((weights / weights.sum())[:-1].tolist())


def causes_of(bench: Bench, rounds: Mapping[Unit, Sequence[Round]], seed: int) -> tuple[Cause, ...]:
    """Return all causes, the most probable first; the same cause in several sensors of a chip is listed once."""
    single = [cause for unit, unit_rounds in rounds.items() for cause in _of_unit(bench, unit, unit_rounds, seed)]
    merged = [
        replace(joint, probability=calibrated_probability(joint.share, joint.all_closed))
        for joint in _merge(bench, single)
    ]
    return _rank(merged)


def nearest_of(bench: Bench, rounds: Mapping[Unit, Sequence[Round]], seed: int) -> tuple[Cause, ...]:
    """Return the effect that comes nearest to explaining a gap for which no effect was accepted: the one with the best
    odds of those that gain more than `NEAREST_NATS` on both parts together. The result is empty without one, or if too
    many rivals are as good.

    A deviation of five standard deviations in a single statistic is a gap, but it gains less than the cost of choosing
    among thousands of moments, lines and axes. Here this cost is only used to compare effects.
    """
    offers = [
        _Offer(unit, evaluation, _log_odds(unit_rounds[0], evaluation))
        for unit, unit_rounds in rounds.items()
        if unit_rounds and unit_rounds[0].selection is None
        for evaluation in unit_rounds[0].confirmed
        if evaluation.trial.effects
    ]
    if not (good := [offer for offer in offers if offer.gain > NEAREST_NATS]):
        return ()
    best = max(good, key=lambda offer: offer.log_odds)
    odds: dict[tuple[str, Unit], float] = {}
    for offer in good:
        rival = offer.evaluation.trial.name, offer.unit
        odds[rival] = max(odds.get(rival, 0.0), math.exp(offer.log_odds - best.log_odds))
    share = 1.0 / sum(odds.values())
    if NEAREST_RIGHT * share < ALTERNATIVE:
        return ()
    name = best.evaluation.trial.name
    rivals = tuple(sorted({effect for (effect, _), odd in odds.items() if odd > CONFUSABLE} - {name}))
    before = rounds[best.unit][0].before
    cause = _cause(bench, before, before, best.evaluation, Support(share, rivals), seed)
    return (replace(cause, probability=NEAREST_RIGHT * share, is_accepted=False),)


class _Offer(NamedTuple):
    """A confirmed trial for a unit, with its log odds, which are compared with those of the other offers."""

    unit: Unit
    evaluation: Evaluation
    log_odds: float

    @property
    def gain(self) -> float:
        """The log odds in nats without the cost of choosing a moment."""
        return self.log_odds + (2 * BRIEF if self.evaluation.trial.needs_both else 0.0)


def _log_odds(round_: Round, evaluation: Evaluation) -> float:
    """Return the gain of a trial on both parts, less that of the placebo, the cost of its parameters and its rarity, in
    nats.
    """
    cost = COST * evaluation.factors + evaluation.trial.rarity
    return evaluation.gain_of_both - max(round_.placebo_gain, 0.0) - cost


def _rank(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Return the causes, the most probable first.

    If a cause was detected with another cause of the same sensor in the model, it is at most as probable as that one
    and listed after it: without the other cause it would have to explain something else. This applies to all rivals of
    one round.
    """
    limited: list[Cause] = []
    for cause in sorted(causes, key=lambda cause: cause.preceding):
        earlier: dict[int, float] = {}  # the highest probability among the causes of each round
        for other in limited:
            if other.preceding < cause.preceding and set(other.sensors) & set(cause.sensors):
                earlier[other.preceding] = max(earlier.get(other.preceding, 0.0), other.probability)
        limited.append(replace(cause, probability=min(cause.probability, *earlier.values(), 1.0)))
    return tuple(sorted(limited, key=lambda cause: (-cause.probability, cause.preceding, -cause.gain)))


def judged_of(rounds: Mapping[Unit, Sequence[Round]]) -> tuple[CandidateEvaluation, ...]:
    """Return all confirmed candidates, and the placebos with which they were compared."""
    evaluations = []
    for unit, unit_rounds in rounds.items():
        for round_ in unit_rounds:
            evaluations += [
                CandidateEvaluation(
                    trial.trial.name, trial.trial.action, unit, trial.train_gain, trial.gain, trial is round_.selection
                )
                for trial in round_.confirmed
            ]
        if unit_rounds[0].confirmed and unit_rounds[0].placebo_gain:
            evaluations.append(CandidateEvaluation("", "add", unit, math.nan, unit_rounds[0].placebo_gain, False))
    return tuple(evaluations)


def _of_unit(bench: Bench, unit: Unit, rounds: Sequence[Round], seed: int) -> Iterator[Cause]:
    """Return the causes that the rounds accepted and did not remove later, each with its probable alternatives."""
    first = rounds[0].before
    all_closed = _all_closed(bench, first, rounds, seed)
    selected_names = {round_.selection.trial.name for round_ in rounds if round_.selection is not None}
    for number, round_ in enumerate(rounds):
        if round_.selection is None or _is_undone(round_.selection, rounds[number + 1 :]):
            continue
        by_name: dict[str, tuple[float, Evaluation]] = {}
        present = selected_names - {round_.selection.trial.name}
        for chance, trial in zip(probabilities(round_, present), round_.confirmed, strict=True):
            before = by_name.get(trial.trial.name, (0.0, trial))
            by_name[trial.trial.name] = (before[0] + chance, trial if trial is round_.selection else before[1])
        selected_chance = by_name[round_.selection.trial.name][0]
        likely = {name for name, (chance, _) in by_name.items() if chance > CONFUSABLE * selected_chance}
        for name, (chance, trial) in by_name.items():
            if name in present:
                continue
            if (trial is round_.selection or chance > ALTERNATIVE) and not _undoes(trial, round_.before):
                cause = _cause(
                    bench, first, round_.before, trial, Support(chance, tuple(sorted(likely - {name}))), seed
                )
                if cause.closed is None or cause.closed > LEAST:
                    alternative_to = "" if trial is round_.selection else round_.selection.trial.name
                    yield replace(cause, all_closed=all_closed, alternative_to=alternative_to)


def _all_closed(bench: Bench, first: UnitState, rounds: Sequence[Round], seed: int) -> float | None:
    """Return the share of a unit's gap that all its causes together close."""
    selections = [round_.selection for round_ in rounds if round_.selection is not None]
    last = selections[-1].standing if selections else first
    in_either = bool(selections) and all(evaluation.trial.needs_both for evaluation in selections)
    before, after = (_deviating(bench, first, state, in_either) for state in (first, last))
    return replace(before, after=after.after).closure(seed).closed


def _is_undone(evaluation: Evaluation, later: Sequence[Round]) -> bool:
    """Return whether a later round removed the effect, or replaced it by another of its kind."""
    return any(
        round_.selection is not None and round_.selection.trial.removed == evaluation.trial.name for round_ in later
    )


def _undoes(trial: Evaluation, before: UnitState) -> bool:
    """Return whether a trial only removes what an earlier round added."""
    added = {effect.name for model in before.models.values() for effect in model.added}
    return not trial.trial.effects and trial.trial.removed in added


class Support(NamedTuple):
    """The support of a cause by the data: its probability, and the effects with which it can be confused."""

    probability: float
    confusable: tuple[str, ...]


def _cause(
    bench: Bench, first: UnitState, before: UnitState, evaluation: Evaluation, support: Support, seed: int
) -> Cause:
    counted = _deviating(bench, first, before, evaluation.trial.needs_both)
    with_it = _deviating(bench, first, evaluation.standing, evaluation.trial.needs_both)
    closure = replace(counted, before=counted.after, after=with_it.after).closure(seed)
    effect = evaluation.trial.effects[0] if evaluation.trial.effects else None
    sensor, others = evaluation.trial.sensor, evaluation.trial.others if evaluation.trial.opposite else ()
    sensors = (sensor, *others) if sensor else evaluation.trial.members or first.unit
    effects = dict.fromkeys(sensors, effect) | dict.fromkeys(others, next(iter(evaluation.trial.opposite), None))
    models = evaluation.standing.models
    whole = {name: _with_fitted(acting, models.get(name)) if acting else None for name, acting in effects.items()}
    each = {name: to_table(acting, bench.base.headers[name].unit) if acting else {} for name, acting in whole.items()}
    return Cause(
        evaluation.trial.name,
        _action(bench, evaluation.trial, sensors),
        sensors,
        _axes(effect),
        support.probability,
        each[sensors[0]],
        closure.closed,
        closure.interval,
        support.confusable,
        _origin(evaluation.trial),
        evaluation.gain,
        each,
        evaluation.trial.needs_both,
        support.probability,
        preceding=_changes(before),
    )


def _action(bench: Bench, trial: Hypothesis, sensors: Sequence[str]) -> Action:
    """Return the change that a trial makes to the base model. An effect that the base model lacks is added, even if it
    replaces another one of its kind that an earlier round added.
    """
    base = bench.base.effects(0)
    is_in_base = any(effect.name == trial.removed for name in sensors for effect in base[name])
    return "add" if trial.action == "replace" and not is_in_base else trial.action


def _changes(state: UnitState) -> int:
    """Return the largest number of changes of a sensor's model in a state of the search."""
    return max((len(model.added) + len(model.removed) for model in state.models.values()), default=0)


def _with_fitted(effect: Effect, model: SensorModel | None) -> Effect:
    """Return the effect; a `thermal_bias` with the sensor's fitted slope included, since the added slope alone has no
    meaning for a user.
    """
    if model is None or not isinstance(effect, ThermalBias) or effect.reference_degc != REFERENCE_DEGC:
        return effect
    return replace(effect, slope=triple(np.add(effect.slope, model.fitted.slope)))


def _deviating(bench: Bench, first: UnitState, then: UnitState, in_either: bool) -> DeviatingStatistics:
    """Return the statistics of a unit that deviated in the state `first`, with their scores in the state `then`; those
    of both parts for a cause that one part may not show.
    """
    pairs = bench.pairs(bench.own(first.unit))
    if in_either:
        return deviating_in_either(pairs, first.scores, then.scores)
    return deviating(pairs, first.scores, then.scores, first.likelihood.is_silent)


def _axes(effect: Effect | None) -> tuple[str, ...]:
    """Return the axes on which an effect acts; empty for all, and for an effect without axes."""
    if effect is None:
        return ()
    active = effect.active_axes()
    return () if all(active) or not any(active) else tuple(axis for axis, on in zip(AXES, active, strict=True) if on)


def _origin(trial: Hypothesis) -> Origin:
    effect = trial.effects[0] if trial.effects else None
    from_boot = (
        trial.name == "range_reset"
        and getattr(effect, "onset_s", 1.0) <= 0
        and getattr(effect, "probability", 0.0) >= 1
    )
    return "metadata" if trial.name in _METADATA or trial.everywhere or from_boot else "sensor"


def _merge(bench: Bench, causes: Sequence[Cause]) -> list[Cause]:
    """Merge causes that are the same in several sensors of a chip."""
    merged: list[Cause] = []
    for cause in causes:
        twin = next((at for at, other in enumerate(merged) if _is_same(bench.base.headers, other, cause)), None)
        if twin is None:
            merged.append(cause)
        else:
            merged[twin] = _joined(merged[twin], cause)
    return merged


def _is_same(headers: Mapping[str, SensorHeader], first: Cause, other: Cause) -> bool:
    chips = {headers[name].chip for name in (*first.sensors, *other.sensors)}
    same = ("effect", "action", "axes", "alternative_to")
    is_same_effect = all(getattr(first, name) == getattr(other, name) for name in same)
    return (
        is_same_effect
        and len(chips) == 1
        and not set(first.sensors) & set(other.sensors)
        and _agree(first.parameters, other.parameters)
    )


def _agree(first_table: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    if first_table.keys() != other.keys():
        return False
    for key, value in first_table.items():
        first, second = np.atleast_1d(value), np.atleast_1d(other[key])
        if first.dtype.kind not in "if" or second.dtype.kind not in "if":
            if value != other[key]:
                return False
            continue
        if len(first) != len(second) and 1 not in (len(first), len(second)):
            return False  # lists of events of different lengths
        first, second = np.broadcast_arrays(first.astype(float), second.astype(float))
        finite = np.isfinite(first)  # an axis without a limit has an infinite one
        if (finite != np.isfinite(second)).any():
            return False
        first, second = first[finite], second[finite]
        largest = np.fmax(np.abs(first), np.abs(second))
        factor = _SAME_FREQUENCY if "frequency" in key else _SAME
        if (np.abs(first - second) > (factor - 1) * largest).any():
            return False
    return True


def _joined(first: Cause, other: Cause) -> Cause:
    """Merge two equal causes: odds are multiplied, closed shares averaged."""
    odds = [cause.share / max(1 - cause.share, 1e-9) for cause in (first, other)]
    both = odds[0] * odds[1]
    return replace(
        first,
        sensors=(*first.sensors, *other.sensors),
        share=max(first.share, other.share, both / (1 + both)),
        all_closed=_mean(first.all_closed, other.all_closed, len(first.sensors)),
        closed=_mean(first.closed, other.closed, len(first.sensors)),
        closed_ci95=_widest(first, other),
        confusable_with=tuple(sorted({*first.confusable_with} & {*other.confusable_with})),
        gain=first.gain + other.gain,
        each={**first.each, **other.each},
        needs_both=first.needs_both or other.needs_both,
    )


def _mean(first: float | None, other: float | None, weight: int) -> float | None:
    if first is None or other is None:
        return first if other is None else other
    return (weight * first + other) / (weight + 1)


def _widest(first: Cause, other: Cause) -> tuple[float, float] | None:
    known = [cause.closed_ci95 for cause in (first, other) if cause.closed_ci95 is not None]
    return (min(low for low, _ in known), max(high for _, high in known)) if known else None


SAME_HZ = 0.01
"""Largest relative difference of the frequencies of one line."""

WANDER: Mapping[Pace, frozenset[str]] = MappingProxyType(
    {
        "slow": frozenset({"bias_instability", "random_walk", "common_mode", "popcorn_noise"}),
        "fast": frozenset({"bias_instability", "common_mode", "white_noise"}),
    }
)
"""Effects for which a stimulus of this pace may be mistaken."""

_LEAST_SENSORS = 3


def with_origins(
    causes: Sequence[Cause], headers: Mapping[str, SensorHeader], shared: Sequence[SharedSignal] = ()
) -> tuple[Cause, ...]:
    """Return the causes, with the origin "environment" for those in the environment of the box.

    A `tone` is in the environment if the same line (`lines_of`) is in each of its sensors. A wander is in the
    environment if its sensors share a stimulus of `environment_of` that explains at least half of it, along the axes in
    which most of it lies.
    """
    lines = lines_of(causes, headers)

    def is_environmental(cause: Cause) -> bool:
        if cause.effect == "tone":
            return any(any(cause is known for known in line.causes) for line in lines)
        return bool(cause.sensors) and all(_wanders_with(cause, headers[name], shared) for name in cause.sensors)

    return tuple(
        replace(cause, origin="environment")
        if cause.origin == "sensor" and cause.action == "add" and is_environmental(cause)
        else cause
        for cause in causes
    )


@dataclass(frozen=True)
class CommonLine:
    """A line that several sensors measure, along the box axis `axis` ("" for different axes); `causes` are the tones
    that consist of it.
    """

    frequency_hz: float
    axis: str
    sensors: tuple[str, ...]
    causes: tuple[Cause, ...]


def lines_of(causes: Sequence[Cause], headers: Mapping[str, SensorHeader]) -> tuple[CommonLine, ...]:
    """Return the lines, among the added causes `tone`, that are not sensor faults.

    Frequencies must agree within 1 %. Amplitudes in the box must agree within a factor of 1.5 between two chips that
    measure the same quantity; between accelerometers and gyroscopes only the frequency counts. Half of the array's
    sensors of each quantity must show the line. If the array has only one type of chip, all its units must show it, at
    least three, and not equally along their own axes, since the line may be caused by the design of the chip.
    """
    tones = [_Tone.of(cause, headers[name]) for cause in causes if _is_tone(cause) for name in cause.sensors]
    lines = []
    while tones:
        first = tones[0]
        together = [tone for tone in tones if _is_one_line(first, tone)]
        tones = [tone for tone in tones if not _is_one_line(first, tone)]
        if _reaches(together, headers):
            names = tuple(dict.fromkeys(tone.header.name for tone in together))
            axes = {_strongest(tone) for tone in together}
            line_causes = tuple(cause for cause in causes if _is_whole(cause, together))
            lines.append(CommonLine(first.frequency_hz, axes.pop() if len(axes) == 1 else "", names, line_causes))
    return tuple(lines)


def notes_of(lines: Sequence[CommonLine], shared: Sequence[SharedSignal] = ()) -> tuple[str, ...]:
    """Return sentences on the lines and signals that several sensors share."""
    sentences = [
        f"{series(line.sensors)} have the same line at {line.frequency_hz:.1f} Hz"
        f"{f' along the box axis {line.axis}' if line.axis else ''}: a vibration of the box, not a fault of the "
        "sensors."
        for line in lines
    ]
    words = {"slow": "wander together", "fast": "shake together"}
    sentences += [
        f"{series(signal.sensors)} {words[signal.pace]} along the box axis {signal.axis} in phase {signal.phase!r} "
        f"(correlation {signal.correlation:.2g}), whatever their mounting: motion of the box, "
        "not a fault of the sensors."
        for signal in shared
    ]
    return tuple(sentences)


class _Tone(NamedTuple):
    """A line of one sensor: amplitudes (3,) along the box axes."""

    cause: Cause
    header: SensorHeader
    frequency_hz: float
    amplitude_box: Floats
    amplitude: Floats

    @classmethod
    def of(cls, cause: Cause, header: SensorHeader) -> _Tone:
        table = cause.each.get(header.name) or cause.parameters
        amplitude = np.abs(_sizes(table, f"amplitude_{header.unit}"))
        amplitude_box = np.abs(np.array(header.orientation)) @ amplitude
        return cls(cause, header, float(table["frequency_hz"]), amplitude_box, amplitude)


def _is_tone(cause: Cause) -> bool:
    return cause.effect == "tone" and cause.action == "add" and "frequency_hz" in cause.parameters


def _is_one_line(first: _Tone, other: _Tone) -> bool:
    if abs(first.frequency_hz - other.frequency_hz) > SAME_HZ * max(first.frequency_hz, other.frequency_hz):
        return False
    return first.header.quantity != other.header.quantity or _amplitudes_agree(first.amplitude_box, other.amplitude_box)


def _amplitudes_agree(first: Floats, other: Floats) -> bool:
    """Return whether the large amplitudes agree on all axes; small ones may be hidden by the noise of a chip."""
    much = np.maximum(first, other) > max(first.max(), other.max()) / 3
    return bool((np.maximum(first, other)[much] <= AMPLITUDE_RATIO * np.minimum(first, other)[much]).all())


def _reaches(tones: Sequence[_Tone], headers: Mapping[str, SensorHeader]) -> bool:
    names, quantities = {tone.header.name for tone in tones}, {tone.header.quantity for tone in tones}
    there = [{name for name, header in headers.items() if header.quantity == quantity} for quantity in quantities]
    if any(2 * len(names & those) < len(those) for those in there):
        return False
    if len({tone.header.chip for tone in tones}) > 1:
        return True
    if len(names) < _LEAST_SENSORS or names != there[0]:
        return False
    return any(not _amplitudes_agree(tones[0].amplitude, tone.amplitude) for tone in tones)


def _is_whole(cause: Cause, tones: Sequence[_Tone]) -> bool:
    """Return whether `tones` contains the cause's tone in each of its sensors."""
    return {tone.header.name for tone in tones if tone.cause is cause} == {*cause.sensors}


def _strongest(tone: _Tone) -> str:
    return "XYZ"[int(tone.amplitude_box.argmax())]


def _wanders_with(cause: Cause, header: SensorHeader, shared: Collection[SharedSignal]) -> bool:
    """Return whether at least half of the sensor's squared wander is along axes of the box that have a stimulus."""
    axes = {
        signal.axis
        for signal in shared
        if cause.effect in WANDER[signal.pace]
        and header.name in signal.sensors
        and signal.correlation >= LEAST_COMMON_SHARE
    }
    table = cause.each.get(header.name) or cause.parameters
    sizes = _sizes(table, f"rms_{header.unit}", f"amplitude_{header.unit}", f"density_{header.unit}_per_sqrt_s")
    squares = np.abs(np.array(header.orientation)) @ np.square(sizes)
    explained = sum(float(squares["XYZ".index(axis)]) for axis in axes)
    return explained > 0 and 2 * explained >= float(squares.sum())


def _sizes(table: Mapping[str, Any], *names: str) -> Floats:
    """Return the first of these parameters that exists (3,); zeros without any."""
    value = next((table[name] for name in names if name in table), 0.0)
    return np.asarray(np.broadcast_to(np.asarray(value, float), (3,)))


_OF_RATE = frozenset({"odr_error", "own_clock", "clock_error", "stale_samples", "dropped_samples", "skew", "jitter"})
_OF_FILTER = frozenset({"bandwidth", "odr_error", "white_noise", "stale_samples", "tone"})
_OF_LEVEL = frozenset({"bias", "turn_on_bias", "bistable_bias", "thermal_bias", "random_walk", "popcorn_noise"})
_OF_TEMPERATURE = frozenset({"thermal_bias", "thermal_scale", "thermal_lag", "random_walk", "common_mode"})
_OF_RESPONSE = frozenset(
    {
        "range_reset",
        "axis_error",
        "channel_swap",
        "face_error",
        "scale",
        "misalignment",
        "g_sensitivity",
        "nonlinearity",
        "saturation",
        "adaptive_range",
        "thermal_scale",
        "size_effect",
        "stuck",
        "skew",
        "bandwidth",
        "clock_error",
    }
)

_MOVED_BY: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "bias": _OF_LEVEL | _OF_RESPONSE | {"thermal_lag", "common_mode", "bias_instability", "glitches"},
        "thermal slope of the bias": _OF_TEMPERATURE | _OF_RESPONSE | _OF_LEVEL,
        "cutoff of the filter": _OF_FILTER,
        "rate of the data clock": _OF_RATE,
        "scale factor error": _OF_RESPONSE | _OF_LEVEL,
        "misalignment": _OF_RESPONSE | _OF_LEVEL,
        "g-sensitivity": _OF_RESPONSE | _OF_LEVEL,
        "zero of the chip's thermometer": frozenset({"range_reset", "channel_swap", "stuck"}),
    }
)
"""Effects that change the fitted value of a quantity if the model lacks them."""


def pulls_of(estimates: Iterable[NuisanceEstimate], causes: Sequence[Cause]) -> tuple[Pull, ...]:
    """Return the pulls of the estimates that have a tolerance, each with the listed causes of its sensor that may
    explain it.
    """
    return tuple(
        Pull(*estimate[:-1], estimate.pull, estimate.source, tuple(dict.fromkeys(_reasons(estimate, causes))))
        for estimate in estimates
        if isfinite(estimate.pull)
    )


def _reasons(estimate: NuisanceEstimate, causes: Sequence[Cause]) -> Iterator[str]:
    moved_by = _MOVED_BY.get(estimate.quantity, frozenset())
    for cause in listed_causes(causes):
        if cause.effect in moved_by and (estimate.sensor in cause.sensors or not cause.sensors):
            yield cause.effect
