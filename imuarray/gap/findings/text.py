"""A diagnosis in words: numbers with their units, parts of a diagnosis as text, and the text for the terminal."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from math import ceil, exp, floor, isfinite, log10, sin, sinh, tanh
from textwrap import wrap
from types import MappingProxyType
from typing import Any, NamedTuple

from imuarray.gap.findings.diagnosis import (
    DIFFERENCES,
    Cause,
    Diagnosis,
    Gap,
    Interval,
    Pull,
    Unobservable,
    Verdict,
    Where,
    needs_both_parts,
)
from imuarray.gap.model.use import Use
from imuarray.gap.statistics.synthetic_likelihood import LARGEST_SCORE
from imuarray.printable import counted, listed, series
from imuarray.simulate.effect import FOREVER_S
from imuarray.simulate.effects import EFFECTS, meaning
from imuarray.units import READABLE

NOTHING = "–"
NOT_ACCEPTED = "the nearest known effect; the evidence does not suffice to accept it"

LEAST_LISTED = 0.05
"""Least probability at which the terminal and the page list a cause; gap.json has all causes."""

_LEAST_P = 1e-6
"""Smallest p-value from the fitted tails that is printed: replicates do not determine the tails further out."""

_DIGITS, _MOST_DIGITS = 3, 7
"""Number of significant digits, and the largest number of them, used for two numbers that are nearly equal."""

_MOST = 9
"""Largest number of values of a list that are shown. A response matrix has nine."""

_WHEN = ("spans", "run", "runs", "moments_s", "lengths_s", "stuck_axes")
"""Parameters that state in which logs, when and on which axes an effect acts."""

_SMALL_G = 0.1
"""Acceleration in g below which values are written in mg."""

_SHARES = ("probability", "error")
"""Parameters that are shares of 1."""

_NAMES: Mapping[str, str] = MappingProxyType({"position": "displacement from the configured position (box X, Y, Z)"})
"""Names of parameters that would be misunderstood without an explanation."""

_UNITS: Mapping[str, str] = MappingProxyType(
    {name: name for name in ("g", "dps", "gauss", "s", "h", "ppm", "mm")}
    | {"degc": "°C", "degc2": "°C²", "hz": "Hz", "deg": "°", "lsb": "LSB", "sqrt_s": "√s"}
    | {"g2": "g²", "dps2": "dps²", "gauss2": "gauss²"}
)
_LONGEST_FIRST = "|".join(sorted(_UNITS, key=len, reverse=True))
_WITH_UNIT = re.compile(rf"(?P<name>.*?[^_])(?:_(?P<over>{_LONGEST_FIRST}))?(?:_per_(?P<under>{_LONGEST_FIRST}))?")

_DOMAINS: Mapping[str, str] = MappingProxyType(
    {
        "level": "mean reading",
        "spread": "noise",
        "distribution": "distribution of the noise",
        "codes": "codes",
        "spectrum": "spectrum",
        "autocorrelation": "correlation from row to row",
        "allan": "Allan deviation",
        "temperature": "response to temperature",
        "force": "response to gravity",
        "motion": "response to motion",
        "cross_sensor": "correlation between axes and sensors",
        "run_to_run": "change from run to run",
        "timing": "timing of rows",
        "status": "flags of rows",
    }
)


def number(value: float, digits: int = _DIGITS) -> str:
    """Format a number with `digits` significant digits, without exponent below a million; "–" if it isn't finite."""
    if not isfinite(value):
        return NOTHING
    text = f"{value + 0.0:.{digits}g}"  # -0 becomes 0
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text


def scored(score: float) -> str:
    """Format a score with one decimal below ten, otherwise as a whole number; "∞" for infinity, "–" for nan."""
    if not isfinite(score):
        return "∞" if score > 0 else NOTHING
    return f"{score:.1f}" if abs(score) < 9.95 else f"{score:.0f}"


def share(value: float | None) -> str:
    """Format a share in percent; "–" for None. "0 %" and "100 %" are written for exact values only."""
    if value is None or not isfinite(value):
        return NOTHING
    for limit, edge in ((0.005, 0.0), (0.995, 1.0)):
        if edge != value and min(limit, edge) <= value <= max(limit, edge):
            return "<1 %" if edge == 0 else ">99 %"
    return f"{100 * value:.0f} %"


def chance(p: float, replicates: int = 0) -> str:
    """Format a p-value: "p = 0.03", "p < 0.001". If it is the smallest that this number of `replicates` can give, it is
    a bound that is rounded up: "p < 0.016" with 64.
    """
    if not isfinite(p):
        return f"p {NOTHING}"
    if replicates and p * (replicates + 1) < 1 + 1e-9:
        return f"p < {_rounded_up(1 / (replicates + 1))}"
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def chance_text(diagnosis: Diagnosis) -> str:
    """Return how often chance alone gives such a difference, and what the smallest possible p-value means."""
    p = chance(diagnosis.p, diagnosis.replicates)
    if not diagnosis.is_p_limit:
        return p
    tail = ""
    if diagnosis.p_tail < diagnosis.p:
        by_tail = f"< {_LEAST_P:.0e}" if diagnosis.p_tail < _LEAST_P else f"= {diagnosis.p_tail:.1g}"
        tail = f"; p {by_tail} by the tails fitted to these".replace("e-0", "e-")
    return f"{p}: none of {diagnosis.replicates} simulations without a gap differs as much{tail}"


def closed_text(closed: float | None, interval: Interval | None) -> str:
    """Format a closed share and its 95 % interval: "86 % (75 to 94)". The interval is left out if both ends round to
    100 %. A change that makes the gap larger closes "below 0 %".
    """
    if closed is None or not isfinite(closed):
        return NOTHING
    text = share(closed) if closed >= 0 else "below 0 %"
    if interval is None or round(100 * interval[0]) == round(100 * interval[1]) == 100:
        return text
    low, high = ((NOTHING if not isfinite(end) else "below 0" if end < 0 else f"{100 * end:.0f}") for end in interval)
    return text if low == high == "below 0" else f"{text} ({low} to {high})"


def gap_text(gap: Gap) -> str:
    """Format the gap of a diagnosis: before, after, without a gap, and closed share; or the reason why no share is
    known.
    """
    before = _rms(gap.before)
    if gap.closed is None:
        return f"{before} standard deviations (rms); held-out data show too little of it to measure how much closes"
    return (
        f"{before} standard deviations (rms) before, {_rms(gap.after)} after, {scored(gap.floor)} without a gap: "
        f"{closed_text(gap.closed, gap.closed_ci95)} closed"
    )


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """Format the parameters of an effect with their units, small accelerations in mg: "offset 12, -3, 0.5 mg". When the
    effect acts follows: "in log 2 from 97.1 s on".
    """
    runs, spans, moments_s = (list(parameters.get(name, ())) for name in ("runs", "spans", "moments_s"))
    own = {name: value for name, value in parameters.items() if name not in _WHEN}
    parts = [_parameter(str(name), value) for name, value in own.items()]
    parts += [f"in log {run + 1:.0f}" for run in _numbers(parameters.get("run", ())) or () if isfinite(run)]
    parts += [_span_text(*span) for span in zip(spans[::3], spans[1::3], spans[2::3], strict=True)]
    parts += [
        _moments_text(run, [at for at, each in enumerate(runs) if each == run], moments_s, parameters)
        for run in dict.fromkeys(runs)
    ]
    return "; ".join(parts)


def places_text(cause: Cause) -> str:
    """Return the sensors of a cause, and its axes unless it acts on all: "Gyro1, Gyro2 (x, z)"."""
    axes = f" ({', '.join(cause.axes)})" if cause.axes else ""
    return f"{names_text(cause.sensors) or 'all sensors'}{axes}"


def names_text(sensors: Sequence[str]) -> str:
    """Return names in short form; names that differ only by a number are next to each other: IMU1_acc to IMU8_acc."""
    return listed(sorted(sensors, key=lambda name: re.sub(r"\d+", "", name)))


def effect_text(cause: Cause) -> str:
    """Return the effect of a cause and its change to the simulator: "tone", "no white_noise (the simulator has it)",
    "tone other than the simulator's".
    """
    if cause.action == "remove":
        return f"no {cause.effect} (the simulator has it)"
    return f"{cause.effect} other than the simulator's" if cause.action == "replace" else cause.effect


def limits_text(verdict: Verdict, unshown: Sequence[Unobservable]) -> str:
    """State how many effects recordings without a gap cannot show, and for which differences they are too short; "" if
    none, and with a gap.
    """
    names = list(dict.fromkeys(item.effect for item in unshown))
    if verdict != "no gap" or not names:
        return ""
    domains = [domain_text(_domain_of(name)) for name in names if name.startswith(DIFFERENCES)]
    effects = len(names) - len(domains)
    texts = ["only what could be compared agrees"]
    texts += [f"{effects} of {len(EFFECTS)} known effects cannot be observed with every sensor"] if effects else []
    texts += [f"the recordings are too short to exclude differences of {series(domains)}"] if domains else []
    return "; ".join(texts)


def _domain_of(effect: str) -> str:
    """Return the domain in the `effect` of an `Unobservable` that begins with `DIFFERENCES`."""
    return effect.removeprefix(DIFFERENCES).replace(" ", "_")


def domain_text(domain: str) -> str:
    """Return a domain of statistics in words: "noise" for "spread"."""
    return _DOMAINS.get(domain, domain.replace("_", " "))


def place_text(where: Where) -> str:
    """Return the sensor and the axis of a statistic: "Gyro1 x"."""
    return f"{where.sensor} {where.axis}".rstrip()


class ReadableStatistic(NamedTuple):
    """A statistic in readable form: its meaning, and its recorded and simulated value with unit."""

    about: str
    real: str
    simulated: str


def readable_statistic(where: Where) -> ReadableStatistic:
    """Return a statistic without the transformation that makes it nearly normal: shares in percent, correlations from
    -1 to 1, ratios and noise without logarithm.
    """
    about, unit = where.about, where.unit
    values = [where.real, where.simulated]
    if about.startswith("arcsine of the share"):
        # the transformation is the arcsine of the square root of a share
        return _readable(about.removeprefix("arcsine of the "), [100 * sin(value) ** 2 for value in values], "%")
    for start, inverse in _INVERSES.items():
        if about.startswith(start):
            return _readable(about.removeprefix(start), list(map(inverse, values)), unit)
    if about.startswith("correlation"):  # correlations are stored as Fisher's z
        return _readable(about, list(map(tanh, values)), unit)
    if about.startswith("log ") or unit.startswith("log "):
        about = about.removeprefix("log of ").removeprefix("log ").removeprefix("the ")
        unit, root = unit.removeprefix("log "), 1
        if unit.endswith("^2") and about.startswith("variance"):
            unit, root, about = unit.removesuffix("^2"), 2, about.replace("variance", "standard deviation", 1)
        return _readable(about, [_exp(value / root) for value in values], unit)
    return _readable(about, values, "standard deviations" if about.startswith("normal score") else unit)


_INVERSES = MappingProxyType(
    {
        "Fisher's z of the ": tanh,
        "artanh of the ": tanh,
        "arsinh of the ": lambda value: sinh(min(max(value, -300.0), 300.0)),
    }
)


def difference_text(where: Where, logs: int = 1) -> str:
    """Return in one line the deviation of a statistic and its phase, and also its log if the diagnosis has several."""
    about, real, simulated = readable_statistic(where)
    at = " of ".join(filter(None, (where.phase, where.log if logs > 1 else "")))
    return (
        f"{place_text(where)}, {about}{f' in {at}' if at else ''}: recorded {real}, simulated {simulated} "
        f"({off_text(where.significance)}; {_size(where)})"
    )


def off_text(significance: float, unit: str = "sd") -> str:
    """Return a score in words: "12 sd too high". Scores are limited to `LARGEST_SCORE`; a score at the limit is "more
    than" it.
    """
    size = f"more than {LARGEST_SCORE:.0f}" if abs(significance) >= LARGEST_SCORE else scored(abs(significance))
    return f"{size} {unit} too {'low' if significance < 0 else 'high'}"


def _size(where: Where) -> str:
    times = number(abs(where.effect_size), 2)
    words = {
        "material": f"{times} times what matters",
        "harmless": f"harmless, {times} times what matters",
        "can't tell": "too uncertain to say whether it matters",
    }
    return words[where.size]


def specification_text(pull: Pull) -> str:
    """Return the text of a quantity of a part beyond its tolerance: "BMA2 z: scale factor error 4.2 %, 1.4 times its
    tolerance of 3 % (data sheet)".
    """
    place = f"{pull.sensor} {pull.axis}".rstrip()
    value, tolerance = pull_values(pull)
    return (
        f"{place}: {pull.quantity} {value}, {number(abs(pull.pull))} times its tolerance of {tolerance} ({pull.source})"
    )


def pull_values(pull: Pull) -> tuple[str, str]:
    """Return the value of a quantity and its tolerance with units; a quantity without a unit is a share, in percent."""
    factor, unit = (1.0, pull.unit) if pull.unit else (100.0, "%")
    return _in_unit(factor * pull.value, unit), _in_unit(factor * pull.tolerance, unit)


def unexplained_pulls(pulls: Sequence[Pull]) -> list[Pull]:
    """Return the pulls beyond tolerance that no cause explains, the worst first."""
    outside = [pull for pull in pulls if pull.is_out_of_specification and not pull.explained_by]
    return sorted(outside, key=lambda pull: -abs(pull.pull))


def explained_pulls_text(pulls: Sequence[Pull]) -> str:
    """Return one sentence on the pulls beyond tolerance that a cause may explain; "" without any."""
    explained = [pull for pull in pulls if pull.is_out_of_specification and pull.explained_by]
    if not explained:
        return ""
    quantities: dict[tuple[str, str], list[str]] = {}
    for pull in sorted(explained, key=lambda pull: -abs(pull.pull)):
        quantities.setdefault((pull.sensor, pull.quantity), []).append(pull.axis)
    places = [f"{' '.join([sensor, *axes]).rstrip()} ({quantity})" for (sensor, quantity), axes in quantities.items()]
    causes = series(list(dict.fromkeys(name for pull in explained for name in pull.explained_by)))
    return f"Beyond tolerance as fitted without {causes}, which may be the reason: {', '.join(places)}"


def own_closure(cause: Cause, diagnosis: Diagnosis) -> tuple[float | None, Interval | None]:
    """Return the share of the gap that a cause would close, with its interval. For the only cause in the model, this is
    the closure of the whole gap, which is estimated from more simulations.
    """
    is_only = cause.is_in_model and sum(other.is_in_model for other in diagnosis.causes) == 1
    if is_only and diagnosis.gap.closed is not None:
        return diagnosis.gap.closed, diagnosis.gap.closed_ci95
    return cause.closed, cause.closed_ci95


def use_text(uses: Sequence[Use], causes: Sequence[Cause]) -> str:
    """Return a figure of use of a sensor with a cause in the model: the one for which the simulation before the repair
    differs most from the recording; "" without any.
    """
    concerned = {name for cause in causes if cause.is_in_model for name in cause.sensors}
    known = [use for use in uses if use.sensor in concerned and use.before.value > 0 and use.real.value > 0]
    if not known:
        return ""
    use = max(known, key=lambda use: abs(use.real.value - use.before.value) / use.real.value)
    real, before, after = _several_in_unit([use.real.value, use.before.value, use.after.value], use.unit)
    return f"{use.sensor}, {use.name}: recorded {real}, simulated {before} before and {after} after"


def listed_causes(causes: Collection[Cause]) -> tuple[Cause, ...]:
    """Return the causes that are probable enough to be listed."""
    return tuple(cause for cause in causes if cause.probability >= LEAST_LISTED)


def _readable(about: str, values: Sequence[float], unit: str) -> ReadableStatistic:
    real, simulated = _several_in_unit(values, unit)
    return ReadableStatistic(about, real, simulated)


def _in_unit(value: float, unit: str) -> str:
    return _several_in_unit([value], unit)[0]


def _several_in_unit(values: Sequence[float], unit: str) -> list[str]:
    """Format values in one unit, small accelerations in mg, with the signs for degrees and powers."""
    if unit.split("/")[0].split(" ")[0] == "g" and unit != "g/g" and max(map(abs, values)) < _SMALL_G:
        factor, name = READABLE["g"]
        values, unit = [factor * value for value in values], name + unit[1:]
    unit = unit.replace("degC", "°C").replace("^2", "²")
    space = "" if unit in ("", "°") else " "
    digits = _digits(values)
    return [f"{number(value, digits)}{space}{unit}" if isfinite(value) else NOTHING for value in values]


def _digits(values: Sequence[float]) -> int:
    """Return three digits, or the number that shows the difference of two values to two digits."""
    if len(values) != 2 or not all(map(isfinite, values)) or values[0] == values[1]:
        return _DIGITS
    largest, difference = max(map(abs, values)), abs(values[0] - values[1])
    return min(max(_DIGITS, floor(log10(largest)) - floor(log10(difference)) + 2), _MOST_DIGITS)


def _exp(value: float) -> float:
    return exp(value) if value < 300 else float("inf")


def _rms(score: float) -> str:
    return f"{LARGEST_SCORE:.0f} or more" if score >= LARGEST_SCORE - 0.05 else scored(score)


def _rounded_up(p: float) -> str:
    """Format a p-value with two digits, rounded up."""
    step = 10.0 ** (floor(log10(p)) - 1)
    return f"{ceil(p / step - 1e-9) * step:.2g}"


def _span_text(run: float, begin_s: float, end_s: float) -> str:
    log = f"in log {run + 1:.0f}"
    if end_s >= FOREVER_S:
        return f"{log} from {_moment(begin_s)} s on" if begin_s > 0 else log
    return f"{log} from {_moment(begin_s)} to {_moment(end_s)} s" if begin_s > 0 else f"{log} until {_moment(end_s)} s"


def _moments_text(run: float, places: Sequence[int], moments_s: Sequence[float], parameters: Mapping[str, Any]) -> str:
    """Return in words the moments at `places` of the lists, which are those of one run, and how long the effect lasts
    at each.
    """
    log = f"in log {run + 1:.0f}"
    if not moments_s:
        return log
    at = _several([moments_s[place] for place in places], _moment)
    lengths_s = [parameters["lengths_s"][place] for place in places] if parameters.get("lengths_s") else []
    if any(length_s >= FOREVER_S for length_s in lengths_s):
        return f"{log} from {at} s on"
    ends = dict.fromkeys(map(number, (min(lengths_s), max(lengths_s)))) if lengths_s else {}
    return f"{log} at {at} s" + (f" for {' to '.join(ends)} s" if ends else "")


def _moment(seconds: float) -> str:
    """Format a moment of a log, however long it is, to a tenth of a second, so that it can be located there."""
    return f"{seconds:.1f}".removesuffix(".0") if abs(seconds) >= 100 else number(seconds)


def _several(values: Sequence[float], form: Callable[[float], str] = number) -> str:
    more = f" ... ({len(values)} in all)" if len(values) > _MOST else ""
    return ", ".join(map(form, values[:_MOST])) + more


def _parameter(key: str, value: Any) -> str:
    values, match = _numbers(value), _WITH_UNIT.fullmatch(key)
    if values is None or match is None:
        return f"{key.replace('_', ' ')} {value}"
    if key in _SHARES:
        return f"{key} {', '.join(number(100 * value_of_axis) for value_of_axis in values)} %"
    over, under = match["over"] or "", match["under"]
    unit = _UNITS.get(over, "")
    if over == "g" and max(map(abs, values), default=0.0) < _SMALL_G:
        unit, values = "mg", [1000 * value_of_axis for value_of_axis in values]
    unit += f"/{_UNITS[under]}" if under else ""
    space = "" if unit == "°" else " "
    name = _NAMES.get(match["name"], match["name"].replace("_", " "))
    return f"{name} {_several(values, _moment if key == 'onset_s' else number)}{space}{unit}".rstrip()


def _numbers(value: Any) -> list[float] | None:
    """Return one number or several as a list; None for anything else."""
    several = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    try:
        return None if any(isinstance(item, str) for item in several) else [float(item) for item in several]
    except (TypeError, ValueError):
        return None


WIDTH = 120
"""Largest number of columns of the text."""

_LEAST_WIDTH = 40
_WORST, _WORST_AFTER = 6, 3
"""Numbers of statistics that are shown of those that differ before, and after, the causes are added."""

_MOST_SENSORS = 4
"""Largest number of sensors of a cause for which different parameters are shown."""

_MOST_NOTES = 12
"""Largest number of notes that are shown: each of many logs may have its own."""

IN_FILES = "gap.json and report.html (-o DIR)"


def text_of(diagnosis: Diagnosis, width: int = WIDTH) -> str:
    """Format a diagnosis for a terminal of `width` columns: the verdict; where the recordings differ; the causes; how
    much of the gap they close; parts out of specification; notes; what could not be shown or compared; what to record
    next.
    """
    width = min(max(width, _LEAST_WIDTH), WIDTH)
    parts = (_verdict, _where, _causes, _check, _pulls, _notes, _unshown, _too_short, _missing, _next)
    texts = ["\n".join(_wrapped(part(diagnosis), width)) for part in parts]
    return "\n\n".join(filter(None, texts)) + "\n"


Line = tuple[str, str]
"""The beginning of a line, and its text. If the text is wrapped, the next lines begin below it."""


def _verdict(diagnosis: Diagnosis) -> Iterator[Line]:
    reason = f": {diagnosis.reason}" if diagnosis.reason else ""
    yield "Verdict  ", f"{diagnosis.verdict}{reason}"
    if limits := limits_text(diagnosis.verdict, diagnosis.unshown):
        yield "Limits   ", limits
    yield "Chance   ", chance_text(diagnosis)
    if diagnosis.unknown > 0:
        yield "Unknown  ", f"{share(diagnosis.unknown)} that something outside the library of effects is present"


def _where(diagnosis: Diagnosis) -> Iterator[Line]:
    if not diagnosis.where:
        return
    worst = _distinct(diagnosis.where)
    more = ", the worst of a sensor and domain" if len(diagnosis.where) > len(worst[:_WORST]) else ""
    yield (
        "",
        f"Where it differs: {counted(len(diagnosis.where), 'statistic')}{more} (sd: standard deviations of chance)",
    )
    for entry in worst[:_WORST]:
        yield "  ", difference_text(entry, len(diagnosis.recorded))


def _distinct(where: Sequence[Where]) -> list[Where]:
    """Return the worst statistic of each sensor and domain, since axes, phases and logs repeat the same difference."""
    kinds: dict[tuple[str, str], Where] = {}
    for entry in where:
        kinds.setdefault((entry.sensor, entry.domain), entry)
    return list(kinds.values())


def _causes(diagnosis: Diagnosis) -> Iterator[Line]:
    causes = listed_causes(diagnosis.causes)
    if causes:
        yield "", "Causes, most probable first"
    elif diagnosis.causes:
        yield "", "Causes: none has a probability of 5 % or more"
    for cause in causes:
        yield f"  {share(cause.probability):>5}  ", f"{effect_text(cause)} in {places_text(cause)}{_about(cause)}"
        for text in _cause(cause, diagnosis):
            yield " " * 9, text
    if fewer := len(diagnosis.causes) - len(causes):
        yield "  ", f"{fewer} less probable: see gap.json (-o DIR)"


def _about(cause: Cause) -> str:
    about = meaning(cause.effect)
    return f": {about}" if about else ""


def _cause(cause: Cause, diagnosis: Diagnosis) -> Iterator[str]:
    yield from _sizes(cause)
    if cause.alternative_to:
        yield f"instead of {cause.alternative_to}, not besides it"
    elif cause.confusable_with:
        yield f"may also be {' or '.join(cause.confusable_with)}"
    if not cause.is_accepted:
        yield NOT_ACCEPTED
    if cause.origin != "sensor":
        yield f"in the {cause.origin}, not in the sensor"
    if closes := _closing(cause, diagnosis):
        yield closes


def _sizes(cause: Cause) -> Iterator[str]:
    """Yield the parameters of a cause, sensor by sensor if they differ."""
    each = {name: parameters_text(parameters) for name, parameters in cause.each.items()}
    if len(set(each.values())) < 2:
        yield from filter(None, [parameters_text(cause.parameters)])
        return
    for name, text in list(each.items())[:_MOST_SENSORS]:
        yield f"{name}: {text}"
    if len(each) > _MOST_SENSORS:
        yield f"{counted(len(each) - _MOST_SENSORS, 'more sensor')}: see gap.json (-o DIR)"


def _closing(cause: Cause, diagnosis: Diagnosis) -> str:
    """Return how much a cause would close if it were present; "" if unknown."""
    closed, interval = own_closure(cause, diagnosis)
    if closed is None:
        return ""
    data = "the data that showed it" if cause.needs_both else "held-out data"
    remaining = "what the previous causes leave of " if cause.preceding else ""
    of = f"{remaining}the gap of {names_text(cause.sensors) or 'all sensors'} on {data}"
    return f"if this were the cause, it would close {closed_text(closed, interval)} of {of}"


def _check(diagnosis: Diagnosis) -> Iterator[Line]:
    if diagnosis.verdict == "no gap":
        return
    in_model = [cause for cause in diagnosis.causes if cause.is_in_model]
    both = needs_both_parts(in_model)
    yield "", f"Check on {'the data that showed the gap: no part was held out' if both else 'held-out data'}"
    if in_model:
        effects = [f"{'no ' if cause.action == 'remove' else ''}{cause.effect}" for cause in in_model]
        names = series(list(dict.fromkeys(effects)))
        yield "  ", f"With {names} in the simulator: {gap_text(diagnosis.gap)}"
    else:
        yield "  ", "No cause was accepted, so the simulator is unchanged"
    if use := use_text(diagnosis.uses, diagnosis.causes):
        yield "  ", use
    remaining = _distinct(diagnosis.unexplained) if in_model else []
    if remaining:
        form = ", as far as the approximate models of the causes allow" if diagnosis.verdict == "explained" else ""
        yield "  ", f"Still different{form}: {counted(len(diagnosis.unexplained), 'statistic')}"
    for entry in remaining[:_WORST_AFTER]:
        yield "    ", difference_text(entry, len(diagnosis.recorded))


def _pulls(diagnosis: Diagnosis) -> Iterator[Line]:
    """Yield the parts that are out of specification, the worst first."""
    outside = unexplained_pulls(diagnosis.pulls)
    if outside:
        yield "", "Parts out of specification, worst first"
    for pull in outside:
        yield "  ", specification_text(pull)
    if explained := explained_pulls_text(diagnosis.pulls):
        yield "", explained


def _notes(diagnosis: Diagnosis) -> Iterator[Line]:
    notes = _by_log(diagnosis.notes, [recording.name for recording in diagnosis.recorded])
    if notes:
        yield "", "Notes"
    for note in notes[:_MOST_NOTES]:
        yield "  ", note
    if len(notes) > _MOST_NOTES:
        yield "  ", f"{len(notes) - _MOST_NOTES} more in {IN_FILES}"


def _by_log(notes: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the notes; a note that several logs share is returned once."""
    logs: dict[str, list[str]] = {}
    for note in notes:
        name, _, text = note.partition(": ")
        logs.setdefault(text if name in names else note, []).extend([name] if name in names else [])
    return [f"{_logs(of, names)}: {text}" if of else text for text, of in logs.items()]


def _logs(some: Sequence[str], names: Sequence[str]) -> str:
    return "all logs" if len(names) > 1 and set(some) == set(names) else names_text(some)


def _unshown(diagnosis: Diagnosis) -> Iterator[Line]:
    """Yield the effects that the recordings cannot show, grouped by the experiment that would show them."""
    shown_by: dict[tuple[str, str], list[str]] = {}
    for item in diagnosis.unshown:
        if not item.effect.startswith(DIFFERENCES):
            kind, colon, record = item.record.partition(": ")
            kind, record = (kind, record) if colon else ("record", item.record)
            place = kind, names_text(item.sensors) or "all sensors"
            shown_by.setdefault(place, []).append(f"{item.effect} ({record})")
    if shown_by:
        yield "", "Not observable in these recordings, and what to record"
    kinds = [kind for kind, _ in shown_by]
    for (kind, sensors), effects in sorted(shown_by.items(), key=lambda item: kinds.index(item[0][0])):
        yield "  ", f"{kind}, {sensors}: {'; '.join(effects)}"


def _too_short(diagnosis: Diagnosis) -> Iterator[Line]:
    """Yield the lengths to record that exclude differences that matter, by sensors."""
    lengths: dict[str, list[str]] = {}
    for item in diagnosis.unshown:
        if item.effect.startswith(DIFFERENCES):
            domain = domain_text(_domain_of(item.effect))
            lengths.setdefault(names_text(item.sensors), []).append(f"{domain} ({item.record})")
    if lengths:
        yield "", "Too short to exclude differences that matter, and what to record"
    for sensors, texts in lengths.items():
        yield "  ", f"{sensors}: {'; '.join(texts)}"


def _missing(diagnosis: Diagnosis) -> Iterator[Line]:
    if diagnosis.missing:
        yield "", "Missing, and therefore not compared"
    names = [recording.name for recording in diagnosis.recorded]
    phrases: dict[str, list[str]] = {}
    for phrase in diagnosis.missing:
        start, _, name = phrase.rpartition(" in ")
        phrases.setdefault(start if name in names else phrase, []).extend([name] if name in names else [])
    for phrase, of in phrases.items():
        yield "  ", f"{phrase} in {_logs(of, names)}" if of else phrase


def _next(diagnosis: Diagnosis) -> Iterator[Line]:
    if diagnosis.next_experiment:
        yield "Next experiment: ", diagnosis.next_experiment


def _wrapped(lines: Iterator[Line], width: int) -> Iterator[str]:
    for start, text in lines:
        indent = len(start) if start.endswith("  ") and start.strip() else len(start) - len(start.lstrip()) + 2
        bound = _BOUND.sub(_TIE, start + _printable(text).replace(" degC", " °C"))
        for line in wrap(bound, width, subsequent_indent=" " * indent, break_on_hyphens=False):
            yield line.replace(_TIE, " ")


_TIE = "\x00"
"""Stands for a space at which a line is not broken."""

_BOUND = re.compile(
    r"(?<=\d) (?=(?:%|sd|m?g|dps|s|Hz|°C|deg|mm|h|times|minutes?|seconds?|hours?)(?!\w))"
    r"|(?<=\bp) (?=[<=])|(?<=[<=]) (?=\d)"
)


def _printable(text: str) -> str:
    """Return the text without characters that control a terminal."""
    return "".join(sign if sign.isprintable() else " " if sign.isspace() else "?" for sign in text)
