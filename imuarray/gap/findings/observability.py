"""What a campaign can't tell: effects for which nothing was recorded that shows them, and statistics that scatter more
than the differences that matter.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.deviations import TWO_SIDED_95, needed, record_words
from imuarray.gap.findings.diagnosis import Cause, Unobservable
from imuarray.gap.inference.effects.candidate import Candidate, Kind
from imuarray.gap.model.downstream import attitude_of
from imuarray.gap.recording.recordings import Recording
from imuarray.gap.statistics.campaign import Campaign, PhaseSummary
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import THERMOMETERS

Need = Literal["faces", "warmth", "runs", "turns", "warm_faces", "warm_turns"]
Needs = tuple[tuple[Need, ...], ...]
"""One of several sets, all of it."""

LEAST_FACES, LEAST_DEGC, LEAST_RUNS, LEAST_REST_S = 2, 5.0, 4, 60.0
"""With fewer faces level and scale are one; within less warmth, drift and slope; fewer runs have no spread
(`imuarray.gap.statistics.probes.run_to_run`); a shorter rest is no static log."""

LONGEST_S = 48 * 3600.0
MOST_RUNS = 20.0
"""Nobody records for longer, or so many times as many runs."""

_RECORD: Mapping[Need, str] = MappingProxyType(
    {
        "faces": "all six faces, 1 minute each",
        "warmth": "warmer by 10 degC or more and cool again, twice",
        "runs": "a dozen short logs, switched off in between",
        "turns": "turns to and fro about every axis, 1 minute",
        "warm_faces": "warmer by 10 degC or more on two opposite faces",
        "warm_turns": "turns to and fro about every axis, 1 minute, and again when it is warmer by 10 degC or more",
    }
)
"""In words, where the candidate has none for the kind of experiment."""

_KIND: Mapping[Need, Kind] = MappingProxyType(
    {
        "faces": "tumble",
        "warmth": "heating",
        "runs": "turn-on",
        "turns": "motion",
        "warm_faces": "heating",
        "warm_turns": "motion",
    }
)
_DONE_BY: tuple[Need, ...] = ("faces", "warmth", "runs", "turns")
"""What makes an experiment of its kind."""

_NEEDS: Mapping[str, Needs] = MappingProxyType(
    {
        "scale": (("faces",), ("turns",)),
        "misalignment": (("faces",), ("turns",)),
        "axis_error": (("faces",), ("turns",)),
        "nonlinearity": (("faces",), ("turns",)),
        "saturation": (("faces",), ("turns",)),
        "g_sensitivity": (("faces",), ("turns",)),
        "size_effect": (("turns",),),
        "thermal_bias": (("warmth",),),
        "thermal_scale": (("warm_faces",),),
        "thermal_lag": (("warmth",),),
        "turn_on_bias": (("runs",),),
        "bistable_bias": (("runs",),),
    }
)
"""Any of these, the usual one first; without, an effect can't be told, whatever else was recorded: in one attitude it
looks like a bias (a clipped axis like one that is quiet besides), and so does what never changes with warmth or from
run to run."""

_GYROSCOPE_NEEDS: Mapping[str, Needs] = MappingProxyType(
    {
        "scale": (("turns",),),
        "misalignment": (("turns",),),
        "axis_error": (("turns",),),
        "nonlinearity": (("turns",),),
        "saturation": (("turns",),),
        "thermal_scale": (("warm_turns",),),
    }
)
"""The same where a gyroscope, which feels nothing on any face, needs something else."""

_ONLY: Mapping[str, str] = MappingProxyType({"g_sensitivity": "angular_rate", "size_effect": "specific_force"})
"""Effects that sensors of one quantity alone have."""

_SAME_AS: Mapping[str, str] = MappingProxyType({"thermal_scale": "thermal_bias"})
"""What an effect can't be told from as long as nothing was recorded that shows it."""

_INSTEAD: Mapping[str, str] = MappingProxyType(
    {
        "level": f"tumble: {_RECORD['faces']}, tell scale and misalignment from a level",
        "force": "tumble: all six faces, several times",
        "temperature": "heating: by more degC, several times",
        "motion": "motion: faster and longer turns",
        "cross_sensor": "heating: what sensors share grows with what causes it",
    }
)
"""By domain, what does more than a longer log."""

_ABSENT: Mapping[str, str] = MappingProxyType(
    {
        "temperature": "temperature: no log spans 1 degC",
        "force": "force: no log has faces",
        "motion": "motion: no log tells how the box moved",
        "run_to_run": "runs: there are no several logs of one kind",
        "cross_sensor": "what sensors share: there are no two of them",
    }
)
"""Domains that some campaigns tell nothing of, and why."""

_TRIAD = 3


@dataclass(frozen=True)
class Facts:
    """What was done in a campaign: how many `faces` the box rested on, poses by hand too; largest `span_degc` of
    temperature in one log; `runs` of a turn-on series; whether the box `has_turned` while gyroscopes were read;
    `rest_s` at rest in all; `warm_faces`: on how many of the faces, and `has_turned_warm`: whether its turns, were at
    temperatures that far apart.
    """

    faces: int
    span_degc: float
    runs: int
    has_turned: bool
    rest_s: float
    warm_faces: int = 0
    has_turned_warm: bool = False


def facts_of(campaign: Campaign) -> Facts:
    """From its phases."""
    phases = [phase for log in campaign.logs for phase in log.phases]
    still = [phase for phase in phases if phase.is_still]
    moving = [sensor for phase in phases if not phase.is_still for sensor in phase.sensors.values()]
    turned = [one for one in moving if one.rows and one.header.quantity == "angular_rate"]
    faces = {attitude_of(phase.phase) for phase in still} - {""}
    return Facts(
        faces=len(faces),
        span_degc=max((_span_degc(_sensors(log.phases)) for log in campaign.logs), default=0.0),
        runs=sum(log.kind == "turn-on" for log in campaign.logs),
        has_turned=bool(turned),
        rest_s=sum((phase.phase.end_ns - phase.phase.start_ns) * 1e-9 for phase in still),
        warm_faces=sum(
            _span_degc(_sensors([phase for phase in still if attitude_of(phase.phase) == face])) >= LEAST_DEGC
            for face in faces
        ),
        has_turned_warm=_span_degc(turned) >= LEAST_DEGC,
    )


def unobservable_effects(
    kinds: Collection[str], facts: Facts, candidates: Mapping[str, Candidate], sensors: Mapping[str, SensorHeader]
) -> tuple[Unobservable, ...]:
    """The candidate effects that no recorded kind of experiment shows, each with all the triads that it may concern.

    A kind counts if it was done in earnest: a tumble on at least 2 faces, heat over 5 degC, 4 runs, a minute's rest.
    Faces, warmth and turns in a log of another kind count as well. A candidate with an empty `shown_by` is left out,
    unless it is known what it needs: nothing can be asked for.
    """
    done, met = _kinds_done(kinds, facts), {need for need in _KIND if _is_met(need, kinds, facts)}
    triads = {name: header for name, header in sensors.items() if len(header.columns) == _TRIAD}
    found = (_of_candidate(candidate, done, met, triads) for candidate in candidates.values())
    return tuple(one for one in found if one is not None)


def uncertain_domains(
    scales: Floats, margins: Floats, keys: Sequence[Key], seconds: Floats | float, sensors: Mapping[str, SensorHeader]
) -> tuple[Unobservable, ...]:
    """Where differences that matter can't be excluded, by domain and chip: statistics whose 95 % interval, 1.96 of
    their `scales` (n,) of chance to either side, is wider than their `margins` (n,). `seconds` (n,), or one number:
    length of the log of each. What never says anything (nan) is left out.
    """
    lasted = np.broadcast_to(np.asarray(seconds, float), len(keys))
    places: dict[tuple[str, str], list[int]] = {}
    with np.errstate(invalid="ignore"):
        wide = np.flatnonzero(TWO_SIDED_95 * scales > margins)
    for number in wide.tolist():
        key = keys[number]
        places.setdefault((key.domain, sensors[key.sensor].chip), []).append(number)
    return tuple(
        Unobservable(
            f"differences of {domain.replace('_', ' ')}",
            tuple(dict.fromkeys(keys[number].sensor for number in members)),
            _longer(domain, [(float(lasted[at]), float(scales[at]), float(margins[at])) for at in members]),
        )
        for (domain, _), members in places.items()
    )


def missing_in(recordings: Sequence[Recording], domains: Collection[str]) -> tuple[str, ...]:
    """What recordings lack, so that statistics which need it are not compared, in phrases: reference temperatures, chip
    thermometers, and statistics of others than these `domains`.
    """
    found = []
    for recording in recordings:
        if not recording.has_reference_temperature:
            found.append(f"no reference temperature in {recording.name}")
        headers = [header for header, _ in recording.experiment.plan.sensors.values() if header.chip in THERMOMETERS]
        without = [header.name for header in headers if not header.has_temperature]
        if without and len(without) == len(headers):
            found.append(f"no chip thermometer in {recording.name}")
        elif without:
            found.append(f"no chip thermometer of {', '.join(without)} in {recording.name}")
    found += [f"no statistic of {words}" for domain, words in _ABSENT.items() if domain not in domains]
    return tuple(found)


def with_unobservable_rivals(causes: Sequence[Cause], hidden: Sequence[Unobservable]) -> tuple[Cause, ...]:
    """The causes, confusable also with what they can't be told from because nothing that was recorded shows it, of one
    of the sensors concerned at least: `hidden` effects.
    """
    twins = {_SAME_AS[one.effect]: one for one in hidden if one.effect in _SAME_AS}

    def told(cause: Cause) -> Cause:
        twin = twins.get(cause.effect)
        if twin is None or not set(twin.sensors) & set(cause.sensors):
            return cause
        return replace(cause, confusable_with=tuple(sorted({*cause.confusable_with, twin.effect})))

    return tuple(map(told, causes))


def _sensors(phases: Sequence[PhaseSummary]) -> list[Summary]:
    return [sensor for phase in phases for sensor in phase.sensors.values()]


def _span_degc(sensors: Sequence[Summary]) -> float:
    parts = [sensor.segments.temperature_degc for sensor in sensors]
    degc = np.concatenate(parts) if parts else np.zeros(0)
    known = degc[np.isfinite(degc)]
    return float(np.ptp(known)) if len(known) else 0.0


def _kinds_done(kinds: Collection[str], facts: Facts) -> frozenset[Kind]:
    met: list[Kind] = [_KIND[need] for need in _DONE_BY if _is_met(need, kinds, facts)]
    rests: list[Kind] = ["static"] if "static" in kinds and facts.rest_s >= LEAST_REST_S else []
    return frozenset(met + rests)


def _is_met(need: Need, kinds: Collection[str], facts: Facts) -> bool:
    if need == "faces":
        return facts.faces >= LEAST_FACES
    if need == "warmth":
        return facts.span_degc >= LEAST_DEGC
    if need == "runs":
        return facts.runs >= LEAST_RUNS
    if need == "warm_faces":
        return facts.warm_faces >= LEAST_FACES
    if need == "warm_turns":
        return facts.has_turned_warm
    return facts.has_turned or "motion" in kinds


def _of_candidate(
    candidate: Candidate, done: Collection[str], met: Collection[Need], triads: Mapping[str, SensorHeader]
) -> Unobservable | None:
    effect = candidate.effect
    concerned = {name: one.quantity for name, one in triads.items() if _ONLY.get(effect, one.quantity) == one.quantity}
    texts = {name: _lacking(candidate, quantity, done, met) for name, quantity in concerned.items()}
    lacking = {name: text for name, text in texts.items() if text}
    return Unobservable(effect, tuple(lacking), "; ".join(dict.fromkeys(lacking.values()))) if lacking else None


def _lacking(candidate: Candidate, quantity: str, done: Collection[str], met: Collection[Need]) -> str:
    """What to record so that a sensor of this quantity shows the effect; "" if that was done."""
    special = _GYROSCOPE_NEEDS if quantity == "angular_rate" else _NEEDS
    needs = special.get(candidate.effect, _NEEDS.get(candidate.effect, ()))
    if not needs:
        is_shown = any(kind in done for kind in candidate.shown_by)
        return "" if is_shown else next((f"{kind}: {text}" for kind, text in candidate.shown_by.items()), "")
    missing = [[need for need in group if need not in met] for group in needs]
    return " and ".join(_words(candidate, need) for need in missing[0]) if all(missing) else ""


def _words(candidate: Candidate, need: Need) -> str:
    kind = _KIND[need]
    return f"{kind}: {candidate.shown_by.get(kind, _RECORD[need])}"


def _longer(domain: str, known: Sequence[tuple[float, float, float]]) -> str:
    """Of seconds, scales and margins: the median length that would tell, or what does more."""
    wanted_s = float(np.median([needed(*one) for one in known]))
    if domain == "run_to_run":
        times = wanted_s / float(np.median([seconds for seconds, _, _ in known]))
        return f"turn-on: {times:.1f} times as many runs" if times < MOST_RUNS else "no series is long enough"
    if wanted_s <= LONGEST_S:
        return record_words(wanted_s)
    return "; ".join(["a longer log won't do", *filter(None, [_INSTEAD.get(domain)])])
