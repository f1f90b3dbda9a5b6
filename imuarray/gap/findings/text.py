"""A diagnosis as text for the terminal, at most 120 columns, and the formatting of numbers and parameters, which the
HTML page shares.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from math import isfinite
from textwrap import wrap
from types import MappingProxyType
from typing import Any

from imuarray.gap.findings.diagnosis import Cause, Diagnosis, Gap, Interval, Pull, Unobservable, Where
from imuarray.printable import listed
from imuarray.simulate.effect import FOREVER_S

WIDTH = 120
NOTHING = "–"

_WORST = 10
_COLUMNS = (12, 15, 18, 7, 8, 8, 11, 6, 5, 10)
"""Greatest widths of the columns of the table of statistics, together `WIDTH` with two spaces before each."""
_MOST = 9
"""Most numbers of a list that are shown, as many as a response has."""

_MOST_NOTES = 12
"""Most notes that are shown: each of many logs has its own."""

_WHEN = ("spans", "runs", "moments_s", "lengths_s", "stuck_axes")
"""Parameters that say in which logs, when and on which axes an effect acts."""

_SMALL_G = 0.1
"""Accelerations below it are written in mg."""

_SHARES = ("probability", "error")
"""Parameters that are shares of 1."""

_UNITS: Mapping[str, str] = MappingProxyType(
    {name: name for name in ("g", "dps", "gauss", "s", "h", "ppm", "mm")}
    | {"degc": "°C", "degc2": "°C²", "hz": "Hz", "deg": "°", "lsb": "LSB", "sqrt_s": "√s"}
    | {"g2": "g²", "dps2": "dps²", "gauss2": "gauss²"}
)
_LONGEST_FIRST = "|".join(sorted(_UNITS, key=len, reverse=True))
_WITH_UNIT = re.compile(rf"(?P<name>.*?[^_])(?:_(?P<over>{_LONGEST_FIRST}))?(?:_per_(?P<under>{_LONGEST_FIRST}))?")


def text_of(diagnosis: Diagnosis) -> str:
    """Format a diagnosis for the terminal: sentence, gap, causes, parts out of specification, the worst statistics,
    notes, what is not observable, what is missing and what to record next.
    """
    parts = (
        wrap(_printable(diagnosis.sentence), WIDTH),
        list(_verdict(diagnosis)),
        list(_causes(diagnosis)),
        list(_pulls(diagnosis.pulls)),
        list(_where(diagnosis.where)),
        list(_notes(diagnosis.notes)),
        list(_unshown(diagnosis.unshown)),
        list(_missing(diagnosis.missing)),
        _hanging("Next experiment: ", diagnosis.next_experiment) if diagnosis.next_experiment else [],
    )
    return "\n\n".join("\n".join(lines) for lines in parts if lines) + "\n"


def number(value: float, digits: int = 3) -> str:
    """Format a number with so many significant digits, without exponent below a million; "–" for what isn't finite."""
    if not isfinite(value):
        return NOTHING
    text = f"{value + 0.0:.{digits}g}"  # -0 becomes 0
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e6 else text


def scored(score: float) -> str:
    """Format a score: one digit after the point below ten, otherwise whole; "∞" for infinity, "–" for nan."""
    if not isfinite(score):
        return "∞" if score > 0 else NOTHING
    return f"{score:.1f}" if abs(score) < 9.95 else f"{score:.0f}"


def share(value: float | None) -> str:
    """Format a share in percent; "–" for None. Only exact 0 and 1 are 0 and 100 %."""
    if value is None or not isfinite(value):
        return NOTHING
    for limit, edge in ((0.005, 0.0), (0.995, 1.0)):
        if edge != value and min(limit, edge) <= value <= max(limit, edge):
            return "<1 %" if edge == 0 else ">99 %"
    return f"{100 * value:.0f} %"


def chance(p: float) -> str:
    """Format a p-value: "p = 0.03", "p < 0.001"."""
    return f"p {NOTHING}" if not isfinite(p) else "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def closed_text(closed: float | None, interval: Interval | None) -> str:
    """Format a closed share and its 95 % interval: "86 % (75 to 94)"; without the interval if that rounds to 100 %."""
    if closed is None or interval is None or round(100 * interval[0]) == round(100 * interval[1]) == 100:
        return share(closed)
    low, high = (f"{100 * end:.0f}" if isfinite(end) else NOTHING for end in interval)
    return f"{share(closed)} ({low} to {high})"


def gap_text(gap: Gap) -> str:
    """Format before, after, floor and closed share in one line; without a gap, the scores that differ most."""
    if gap.closed is None:
        return (
            f"nothing to close; the statistics that differ most are at {scored(gap.before)} standard deviations (rms)"
        )
    return (
        f"{scored(gap.before)} standard deviations (rms) before, {scored(gap.after)} after, "
        f"{scored(gap.floor)} without a gap: {closed_text(gap.closed, gap.closed_ci95)} closed"
    )


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """Format parameters of an effect with their units, small accelerations in mg: "offset 12, -3, 0.5 mg"; and when it
    acts: "in log 2 from 97.1 s on".
    """
    runs, spans, moments_s = (list(parameters.get(name, ())) for name in ("runs", "spans", "moments_s"))
    own = {name: value for name, value in parameters.items() if name not in _WHEN}
    parts = [_parameter(str(name), value) for name, value in own.items()]
    parts += [_span_text(*span) for span in zip(spans[::3], spans[1::3], spans[2::3], strict=True)]
    parts += [
        _moments_text(run, [at for at, each in enumerate(runs) if each == run], moments_s, parameters)
        for run in dict.fromkeys(runs)
    ]
    return "; ".join(parts)


def places_text(cause: Cause) -> str:
    """Return sensors, and the axes if not all: "Gyro1, Gyro2 (x, z)"."""
    axes = f" ({', '.join(cause.axes)})" if cause.axes else ""
    return f"{', '.join(cause.sensors) or 'all sensors'}{axes}"


def specification_text(pull: Pull) -> str:
    """Return a part that is out of specification in a sentence: "Gyro1 x: scale is 1.8 tolerances off: ..."."""
    place = f"{pull.sensor} {pull.axis}".rstrip()
    return f"{place}: {pull.quantity} is {number(abs(pull.pull), 2)} tolerances off: this part is out of specification"


def _span_text(run: float, begin_s: float, end_s: float) -> str:
    log = f"in log {run + 1:.0f}"
    if end_s >= FOREVER_S:
        return f"{log} from {number(begin_s)} s on" if begin_s > 0 else log
    return f"{log} from {number(begin_s)} to {number(end_s)} s" if begin_s > 0 else f"{log} until {number(end_s)} s"


def _moments_text(run: float, places: Sequence[int], moments_s: Sequence[float], parameters: Mapping[str, Any]) -> str:
    """Return the moments at `places` of the lists, which are those of one run, and how long it lasts at each."""
    log = f"in log {run + 1:.0f}"
    if not moments_s:
        return log
    at = _several([moments_s[place] for place in places])
    lengths_s = [parameters["lengths_s"][place] for place in places] if parameters.get("lengths_s") else []
    if any(length_s >= FOREVER_S for length_s in lengths_s):
        return f"{log} from {at} s on"
    ends = dict.fromkeys(map(number, (min(lengths_s), max(lengths_s)))) if lengths_s else {}
    return f"{log} at {at} s" + (f" for {' to '.join(ends)} s" if ends else "")


def _several(values: Sequence[float]) -> str:
    more = f" ... ({len(values)} in all)" if len(values) > _MOST else ""
    return ", ".join(map(number, values[:_MOST])) + more


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
    return f"{match['name'].replace('_', ' ')} {_several(values)}{space}{unit}".rstrip()


def _numbers(value: Any) -> list[float] | None:
    """One number or several; None for anything else."""
    several = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    try:
        return None if any(isinstance(item, str) for item in several) else [float(item) for item in several]
    except (TypeError, ValueError):
        return None


NOT_ACCEPTED = "the nearest known effect; the evidence does not suffice to accept it"


def _verdict(diagnosis: Diagnosis) -> Iterator[str]:
    yield from _hanging("Verdict  ", f"{diagnosis.verdict} (chance alone: {chance(diagnosis.p)})")
    yield from _hanging("Gap      ", gap_text(diagnosis.gap))
    if diagnosis.unknown > 0:
        yield from _hanging("Unknown  ", f"{share(diagnosis.unknown)} that something outside the library is present")


def _causes(diagnosis: Diagnosis) -> Iterator[str]:
    if not diagnosis.causes:
        return
    yield "Causes, most probable first"
    rows = [
        [share(cause.probability), cause.action, cause.effect, places_text(cause), _closes(cause)]
        for cause in diagnosis.causes
    ]
    for cause, line in zip(diagnosis.causes, _align(rows, (0,), (8, 8, 20, 44, 26)), strict=True):
        yield line
        more = [parameters_text(cause.parameters)] if cause.parameters else []
        more += [f"may also be {' or '.join(cause.confusable_with)}"] if cause.confusable_with else []
        more += [] if cause.is_accepted else [NOT_ACCEPTED]
        more += ["detected on both parts together, none was held out"] if cause.needs_both else []
        more += [f"in the {cause.origin}, not in the sensor"] if cause.origin != "sensor" else []
        yield from _hanging(" " * 8, ". ".join(more)) if more else []


def _closes(cause: Cause) -> str:
    if cause.closed is None:
        return ""
    return f"{'closes' if cause.is_accepted else 'would close'} {closed_text(cause.closed, cause.closed_ci95)}"


def _where(where: Sequence[Where]) -> Iterator[str]:
    if not where:
        return
    kinds: dict[tuple[str, str, str], Where] = {}
    for entry in where:
        kinds.setdefault(
            (entry.sensor, entry.axis, entry.statistic), entry
        )  # where it is worst: logs repeat each other
    worst = list(kinds.values())[:_WORST]
    more = f", the worst {len(worst)}" if len(where) > len(worst) else ""
    yield f"Where it differs: {len(where)} statistics{more} (sd of chance; size in margins, matters from 1 on)"
    heading = ["sensor", "domain", "statistic", "phase", "real", "sim.", "unit", "sd", "size", ""]
    yield from _align([heading, *map(_row, worst)], (4, 5, 7, 8), _COLUMNS)


def _row(entry: Where) -> list[str]:
    values = [number(entry.real), number(entry.simulated), entry.unit]
    sizes = [
        f"{entry.significance:+.{1 if abs(entry.significance) < 1000 else 0}f}",
        number(entry.effect_size, 2),
        entry.size,
    ]
    return [
        f"{_cut(entry.sensor, _COLUMNS[0] - 2)} {entry.axis}".rstrip(),
        entry.domain,
        entry.statistic,
        entry.phase or "all",
        *values,
        *sizes,
    ]


def _notes(notes: Sequence[str]) -> Iterator[str]:
    if notes:
        yield "Notes"
    for note in notes[:_MOST_NOTES]:
        yield from _hanging("  ", note, "    ")
    if len(notes) > _MOST_NOTES:
        yield f"  {len(notes) - _MOST_NOTES} more in gap.json and report.html (-o DIR)"


def _unshown(unshown: Sequence[Unobservable]) -> Iterator[str]:
    if unshown:
        yield "Not observable in these recordings"
    for item in unshown:
        sensors = f" of {_by_kind(item.sensors)}" if item.sensors else ""
        yield from _hanging(f"  {_printable(item.effect)}", f"{sensors}: record {item.record}", "    ")


def _by_kind(sensors: Sequence[str]) -> str:
    """Return names that differ by a number beside each other, so that they are listed in short:
    IMU1_acc to IMU8_acc.
    """
    return listed(sorted(sensors, key=lambda name: re.sub(r"\d+", "", name)))


def _pulls(pulls: Sequence[Pull]) -> Iterator[str]:
    """Yield the parts that are out of specification, worst first."""
    outside = sorted((pull for pull in pulls if pull.is_out_of_specification), key=lambda pull: -abs(pull.pull))
    if not outside:
        return
    yield "Parts out of specification, worst first"
    heading = ["sensor", "quantity", "value", "tolerance", "unit", "pull", "source"]
    rows = [
        [
            f"{pull.sensor} {pull.axis}".rstrip(),
            pull.quantity,
            number(pull.value),
            number(pull.tolerance),
            pull.unit,
            f"{pull.pull:+.1f}",
            pull.source,
        ]
        for pull in outside
    ]
    yield from _align([heading, *rows], (2, 3, 5), (16, 28, 10, 10, 14, 8, 20))


def _missing(missing: Sequence[str]) -> Iterator[str]:
    if missing:
        yield "Missing, and therefore not compared"
    for phrase in missing:
        yield from _hanging("  ", phrase)


def _align(rows: Sequence[Sequence[str]], right: Collection[int], most: Sequence[int]) -> Iterator[str]:
    """Columns two spaces apart, `right` ones to the right, none wider than its `most`."""
    clean = [[_cut(cell, wide) for cell, wide in zip(row, most, strict=True)] for row in rows]
    widths = [max(len(row[place]) for row in clean) for place in range(len(most))]
    for row in clean:
        cells = [
            cell.rjust(wide) if place in right else cell.ljust(wide)
            for place, (cell, wide) in enumerate(zip(row, widths, strict=True))
        ]
        yield ("  " + "  ".join(cells)).rstrip()


def _cut(text: str, wide: int) -> str:
    text = _printable(text)
    return text if len(text) <= wide else text[: wide - 1] + "…"


def _hanging(head: str, text: str, indent: str | None = None) -> list[str]:
    rest = " " * len(head) if indent is None else indent
    return wrap(head + _printable(text), WIDTH, subsequent_indent=rest, break_on_hyphens=False, drop_whitespace=True)


def _printable(text: str) -> str:
    """Return the text without characters that control a terminal."""
    return "".join(sign if sign.isprintable() else " " if sign.isspace() else "?" for sign in text)
