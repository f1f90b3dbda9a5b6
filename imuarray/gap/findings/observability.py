"""Effects that a campaign cannot show: those that no recorded experiment shows, and statistics with more scatter than
the differences that matter.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.deviations import TWO_SIDED_95, length_words, needed
from imuarray.gap.findings.diagnosis import DIFFERENCES, Cause, Unobservable
from imuarray.gap.inference.effects.candidate import Candidate, Kind
from imuarray.gap.model.downstream import attitude_of
from imuarray.gap.recording.recordings import Recording
from imuarray.gap.statistics.campaign import Campaign, PhaseSummary
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.summary import Summary
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import THERMOMETERS

Need = Literal["faces", "warmth", "runs", "turns", "rest", "warm_faces", "warm_turns"]

LEAST_FACES, LEAST_DEGC, LEAST_RUNS, LEAST_REST_S = 2, 5.0, 4, 60.0
"""Least faces (with fewer, level and scale are not separated), span of temperature (drift and slope), runs (a spread:
`imuarray.gap.statistics.probes.run_to_run`) and rest of a static log.
"""

LONGEST_S = 48 * 3600.0
MOST_RUNS = 20.0
"""Longest log, and largest multiple of runs, that is suggested."""

_EXPERIMENTS: Mapping[Need, tuple[Kind, str]] = MappingProxyType(
    {
        "faces": ("tumble", "all six faces, 1 minute each"),
        "warmth": ("heating", "warmer by 10 degC or more and cool again, twice"),
        "runs": ("turn-on", "a dozen short logs, switched off in between"),
        "turns": ("motion", "turns to and fro about every axis, 1 minute"),
        "rest": ("static", "still for 1 minute"),
        "warm_faces": ("heating", "warmer by 10 degC or more on two opposite faces"),
        "warm_turns": (
            "motion",
            "turns to and fro about every axis, 1 minute, and again when it is warmer by 10 degC or more",
        ),
    }
)
"""The kind of experiment that meets a need, and what to record where the candidate has no text for that kind."""

_DONE_BY: tuple[Need, ...] = ("faces", "warmth", "runs", "turns")
"""The needs that make an experiment of its kind."""

_NEEDS: Mapping[str, tuple[Need, ...]] = MappingProxyType(
    {
        "scale": ("faces", "turns"),
        "misalignment": ("faces", "turns"),
        "axis_error": ("faces", "turns"),
        "nonlinearity": ("faces", "turns"),
        "saturation": ("faces", "turns"),
        "g_sensitivity": ("faces", "turns"),
        "size_effect": ("turns",),
        "thermal_bias": ("warmth",),
        "thermal_scale": ("warm_faces",),
        "thermal_lag": ("warmth",),
        "turn_on_bias": ("runs",),
        "bistable_bias": ("runs",),
        "white_noise": ("rest",),
        "bandwidth": ("rest",),
        "tone": ("rest",),
    }
)
"""Alternative needs of each effect, the usual one first. Without any of them the effect is not observable, whatever
else was recorded: in one attitude it looks like a bias (a clipped axis like a quiet one with a bias), and so does an
effect that does not change with temperature or from run to run.
"""

_GYROSCOPE_NEEDS: Mapping[str, tuple[Need, ...]] = MappingProxyType(
    {
        "scale": ("turns",),
        "misalignment": ("turns",),
        "axis_error": ("turns",),
        "nonlinearity": ("turns",),
        "saturation": ("turns",),
        "thermal_scale": ("warm_turns",),
    }
)
"""Needs of a gyroscope where they differ, since it feels nothing on any face."""

_SAME_AS: Mapping[str, str] = MappingProxyType({"thermal_scale": "thermal_bias"})
"""The effect from which an effect is not separable as long as no recorded experiment shows it."""

_INSTEAD: Mapping[str, str] = MappingProxyType(
    {
        "level": f"tumble: {_EXPERIMENTS['faces'][1]}, separate scale and misalignment from a level",
        "force": "tumble: all six faces, several times",
        "temperature": "heating: by more degC, several times",
        "motion": "motion: faster and longer turns",
        "cross_sensor": "heating: shared errors grow with their cause",
    }
)
"""What gives more than a longer log, by domain."""

_ABSENT: Mapping[str, str] = MappingProxyType(
    {
        "temperature": "temperature: no log spans 1 degC",
        "force": "force: no log has faces",
        "motion": "motion: no log has a motion that a track or several sensors show",
        "run_to_run": "runs: there is only one log of each kind",
        "cross_sensor": "shared errors: there is only one sensor",
    }
)
"""Domains that some campaigns have no statistics of, and why."""

_TRIAD = 3


@dataclass(frozen=True)
class Facts:
    """The facts about a campaign's recordings.

    Number of `faces` the box rested on, including poses by hand; largest `span_degc` of temperature in one log; `runs`
    of a turn-on series; whether the box `has_turned` while gyroscopes were read; total `rest_s` at rest; `warm_faces`:
    the number of faces, and `has_turned_warm`: whether there were turns, at temperatures that far apart.
    """

    faces: int
    span_degc: float
    runs: int
    has_turned: bool
    rest_s: float
    warm_faces: int = 0
    has_turned_warm: bool = False


def facts_of(campaign: Campaign) -> Facts:
    """Return the facts of a campaign, by its phases."""
    phases = [phase for log in campaign.logs for phase in log.phases]
    still = [phase for phase in phases if phase.is_still]
    moving = [sensor for phase in phases if not phase.is_still for sensor in phase.sensors.values()]
    turned = [summary for summary in moving if summary.rows and summary.header.quantity == "angular_rate"]
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
    """Return candidate effects that no recorded kind of experiment shows, each with the triads that need the same
    record.

    A kind counts if it has enough content: a tumble at least 2 faces, a heating 5 degC, 4 runs, a minute's rest. Faces,
    heating and turns in a log of another kind count as well. A candidate with an empty `shown_by` and without known
    needs is left out, since nothing can be suggested.
    """
    met_needs = _met_needs(kinds, facts)
    recorded_kinds = {_EXPERIMENTS[need][0] for need in _DONE_BY if need in met_needs}
    if "static" in kinds and facts.rest_s >= LEAST_REST_S:
        recorded_kinds.add("static")
    triads = {name: header for name, header in sensors.items() if len(header.columns) == _TRIAD}
    return tuple(
        hidden
        for candidate in candidates.values()
        for hidden in _of_candidate(candidate, recorded_kinds, met_needs, triads)
    )


def uncertain_domains(
    scales: Floats, margins: Floats, keys: Sequence[Key], seconds: Floats | float, sensors: Mapping[str, SensorHeader]
) -> tuple[Unobservable, ...]:
    """Return domains and chips in which differences that matter can't be excluded.

    These are statistics whose 95 % interval, 1.96 of their `scales` (n,) of chance to either side, is wider than their
    `margins` (n,); nan is left out. `seconds` (n,), or one number: length of each one's log.
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
            f"{DIFFERENCES}{domain.replace('_', ' ')}",
            tuple(dict.fromkeys(keys[number].sensor for number in members)),
            _more_of(domain, [(float(lasted[at]), float(scales[at]), float(margins[at])) for at in members]),
        )
        for (domain, _), members in places.items()
    )


def missing_in(recordings: Sequence[Recording], domains: Collection[str]) -> tuple[str, ...]:
    """Return what recordings lack for statistics that are therefore not compared, in phrases: reference temperatures,
    chip thermometers, and statistics of other than these `domains`.
    """
    phrases = []
    for recording in recordings:
        if not recording.has_reference_temperature:
            phrases.append(f"no reference temperature in {recording.name}")
        if recording.temperature_source == "chip":
            phrases.append(f"no thermometer beside those of the chips in {recording.name}")
            continue
        headers = [header for header, _ in recording.experiment.plan.sensors.values() if header.chip in THERMOMETERS]
        without = [header.name for header in headers if not header.has_temperature]
        if without and len(without) == len(headers):
            phrases.append(f"no chip thermometer in {recording.name}")
        elif without:
            phrases.append(f"no chip thermometer of {', '.join(without)} in {recording.name}")
    phrases += [f"no statistic of {words}" for domain, words in _ABSENT.items() if domain not in domains]
    return tuple(phrases)


def with_unobservable_rivals(causes: Sequence[Cause], hidden: Sequence[Unobservable]) -> tuple[Cause, ...]:
    """Return the causes, with `hidden` effects that no recording shows of at least one of their sensors as further
    rivals.
    """
    twins = {_SAME_AS[effect.effect]: effect for effect in hidden if effect.effect in _SAME_AS}

    def with_rival(cause: Cause) -> Cause:
        twin = twins.get(cause.effect)
        if twin is None or not set(twin.sensors) & set(cause.sensors):
            return cause
        return replace(cause, confusable_with=tuple(sorted({*cause.confusable_with, twin.effect})))

    return tuple(map(with_rival, causes))


def _sensors(phases: Sequence[PhaseSummary]) -> list[Summary]:
    return [sensor for phase in phases for sensor in phase.sensors.values()]


def _span_degc(sensors: Sequence[Summary]) -> float:
    parts = [sensor.segments.temperature_degc for sensor in sensors]
    degc = np.concatenate(parts) if parts else np.zeros(0)
    known = degc[np.isfinite(degc)]
    return float(np.ptp(known)) if len(known) else 0.0


def _met_needs(kinds: Collection[str], facts: Facts) -> frozenset[Need]:
    is_met: Mapping[Need, bool] = {
        "faces": facts.faces >= LEAST_FACES,
        "warmth": facts.span_degc >= LEAST_DEGC,
        "runs": facts.runs >= LEAST_RUNS,
        "turns": facts.has_turned or "motion" in kinds,
        "rest": facts.rest_s >= LEAST_REST_S,
        "warm_faces": facts.warm_faces >= LEAST_FACES,
        "warm_turns": facts.has_turned_warm,
    }
    return frozenset(need for need, met in is_met.items() if met)


def _of_candidate(
    candidate: Candidate,
    recorded_kinds: Collection[str],
    met_needs: frozenset[Need],
    triads: Mapping[str, SensorHeader],
) -> Iterator[Unobservable]:
    """Yield what is to be recorded for the candidate, each with the sensors that need it."""
    sensors: dict[str, list[str]] = {}
    for name, header in triads.items():
        if candidate.can_concern(header):
            text = _needed_record(candidate, header.quantity, recorded_kinds, met_needs)
            sensors.setdefault(text, []).append(name)
    for text, names in sensors.items():
        if text:
            yield Unobservable(candidate.effect, tuple(names), text)


def _needed_record(
    candidate: Candidate, quantity: str, recorded_kinds: Collection[str], met_needs: frozenset[Need]
) -> str:
    """Return what to record so that a sensor of this quantity shows the effect; "" if that was recorded."""
    special = _GYROSCOPE_NEEDS if quantity == "angular_rate" else _NEEDS
    needs = special.get(candidate.effect, _NEEDS.get(candidate.effect, ()))
    if not needs:
        is_shown = any(kind in recorded_kinds for kind in candidate.shown_by)
        return "" if is_shown else next((f"{kind}: {text}" for kind, text in candidate.shown_by.items()), "")
    if met_needs.intersection(needs):
        return ""
    kind, record = _EXPERIMENTS[needs[0]]
    return f"{kind}: {candidate.shown_by.get(kind, record)}"


def _more_of(domain: str, known: Sequence[tuple[float, float, float]]) -> str:
    """Return the median length that would resolve the differences, from seconds, scales and margins, or what is more
    useful than a longer log.
    """
    wanted_s = float(np.median([needed(*item) for item in known]))
    if domain == "run_to_run":
        times = wanted_s / float(np.median([seconds for seconds, _, _ in known]))
        return f"turn-on: {times:.1f} times as many runs" if times < MOST_RUNS else "no series is long enough"
    if wanted_s <= LONGEST_S:
        return length_words(wanted_s)
    return "; ".join(["a longer log is not enough", *filter(None, [_INSTEAD.get(domain)])])
