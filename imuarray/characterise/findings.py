"""Remarkable properties of a characterisation, in sentences: times, clipping, lines, codes, correlation, bad fits.

Everything is derived from the result of `characterise_log` alone. Sensors and axes with the same property share a
sentence with the ranges of its numbers; properties that make a recording unusable are first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from imuarray.characterise.repeats import STALE_SHARE
from imuarray.printable import listed
from imuarray.units import MAINS_HZ

SURE = 1e-6
"""The probability below which a finding is significant, for any number of axes."""

_SHARED_S = 1e-7
"""Longest interval, in s, between rows that had the same time in the source: the importer separates these by 1 ns."""

_CORRELATED = 0.05
_CLIPPED_SHARE = 1e-4

_SLOW_CHANGE = 0.3
"""Least share of an axis's variance outside its spectrum that is reported as a change of the mean."""

_LEAST_SEGMENTS = 8
"""Fewest segments of a spectrum for a comparison of its sum with the variance."""

_SLOW_SHARE = 0.95
_ALIASES = 2

_LISTED_LINES = 12
"""Number of listed lines: the strongest of all axes, by their share of the axis's variance."""

_SPANS = 4
"""Number of listed ranges of missing codes per axis."""

_MAINS_HZ_ERROR = 0.05
"""The mains frequency of large grids stays within this in normal operation (the Continental European grid: 50 mHz)."""

Place = tuple[str, str]
"""A sensor and an axis of it; "" for the sensor."""


@dataclass(frozen=True)
class _Remark:
    """A sentence about an axis of a sensor ("": about the sensor), with a field of `str.format` for each of the
    `numbers`, which are already formatted and are sorted by `values`.
    """

    place: Place
    sentence: str
    numbers: tuple[str, ...] = ()
    values: tuple[float, ...] = ()


def findings(result: Mapping[str, Any]) -> list[str]:
    """Return the remarks for the user, the most important first."""
    remark = result["stretch"]["remark"]
    about_box = [f"{remark}; the rows around these times are excluded"] if remark else []
    sensors = [sensor for sensor in result["sensors"] if sensor["timing"] is not None]
    return [
        *about_box,
        *_merge(sensors, _timing, _adaptive_range, _repeats, _rails, _ends),
        *_lines(sensors),
        *(_merge(sensors, _slow_change) if result["stretch"]["phase"] is not None else ()),
        *_merge(sensors, _codes, _correlation, _fit),
    ]


def _merge(sensors: Sequence[Mapping[str, Any]], *kinds: Callable[[Mapping[str, Any]], Iterator[_Remark]]) -> list[str]:
    """Return one text for each sentence of each kind in turn, with its places and numbers."""
    groups: dict[str, list[_Remark]] = {}
    for remark in (remark for kind in kinds for sensor in sensors for remark in kind(sensor)):
        groups.setdefault(remark.sentence, []).append(remark)
    texts = []
    for sentence, same in groups.items():
        numbers = [
            _span([(remark.values[index], remark.numbers[index]) for remark in same])
            for index in range(len(same[0].numbers))
        ]
        texts.append(f"{places_in_short([remark.place for remark in same])}: {sentence.format(*numbers)}")
    return texts


def _span(numbers: Sequence[tuple[float, str]]) -> str:
    """Return the number, or the least and the greatest of several."""
    low, high = min(numbers)[1], max(numbers)[1]
    return low if low == high else f"{low} to {high}"


def places_in_short(places: Sequence[Place]) -> str:
    """Spell axes of sensors: "Gyro1 to Gyro3 x, z; Acc1"."""
    axes: dict[str, list[str]] = {}
    for sensor, axis in places:
        axes_places = axes.setdefault(sensor, [])
        if axis and axis not in axes_places:
            axes_places.append(axis)
    sensors: dict[str, list[str]] = {}
    for sensor, names in axes.items():
        sensors.setdefault(", ".join(sorted(names)), []).append(sensor)
    return "; ".join(f"{listed(names)} {axes_text}".rstrip() for axes_text, names in sensors.items())


def _timing(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    """Describe stalls and bursts of the whole log, else the gaps of the stretch."""
    place, timing = (sensor["name"], ""), sensor["timing"]
    pattern = timing["pattern"]
    if shares_times(pattern["kind"], pattern["usual_s"]):
        sentence = (
            "several rows have the same time, and the next time is {0} s later: the clock is coarse, and rows are"
            " assumed to have been read at the mean rate"
        )
        yield _Remark(place, sentence, (f"{pattern['gap_s']:.3g}",), (pattern["gap_s"],))
    elif pattern["sentence"]:
        yield _Remark(place, pattern["sentence"])
    elif timing["gaps"]:
        longest = timing["longest"][:3]
        places = ", ".join(f"{gap['length_s']:.3g} s after {gap['after_ns'] * 1e-9:.3f} s" for gap in longest)
        count = "a gap" if timing["gaps"] == 1 else f"{timing['gaps']} gaps, {timing['gaps_s']:.3g} s in all"
        yield _Remark(place, f"has {count}: {places}")


def shares_times(kind: str, usual_s: float) -> bool:
    """Return whether rows that arrive in bursts, usually `usual_s` apart, have the same times: the clock is coarse, and
    the host was not late.
    """
    return kind == "bursts" and usual_s < _SHARED_S


def _adaptive_range(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    stalls = sensor.get("stalls")
    if stalls and stalls["adaptive_range"]:
        sentence = (
            "its readings freeze at {0} of {1} passages of 100 dps in the log: its adaptive range is on, which"
            " imuarray log switches off (bits 7:6 of register 0x4D are 01)"
        )
        counts = stalls["stalled"], stalls["passages"]
        yield _Remark((sensor["name"], ""), sentence, tuple(map(str, counts)), counts)


def _repeats(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    """Describe a sensor that is read more often than it measures."""
    place, repeats, rate_hz = (sensor["name"], ""), sensor["timing"]["repeats"], sensor["rate_hz"]
    share = repeats["new_share"]
    if interpolation := sensor.get("interpolation"):
        yield _Remark(place, interpolation["sentence"])
    yield from (_Remark(place, text) for text in sensor.get("processing", ()))
    if share is None:
        return
    if rate_hz and share < _SLOW_SHARE:
        sentence = (
            "is read {1} times a second, but measures only {0} times; the same reading occurs up to {2} times in a row"
        )
        values = repeats["update_rate_hz"], rate_hz, repeats["longest"]
        yield _Remark(place, sentence, tuple(f"{value:.4g}" for value in values), values)
    elif share < 1 - STALE_SHARE:
        sentence = "{0} % of the rows repeat the previous row without new readings"
        yield _Remark(place, sentence, (f"{100 * (1 - share):.1f}",), (share,))


def _rails(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    """Describe the codes at which each axis clips anywhere in the log."""
    rails = sensor["rails"]
    if rails is None:
        return
    ends = [_ends_in_words(low, high) for low, high in zip(rails["low"], rails["high"], strict=True)]
    for axis, codes, readings in zip(sensor["axes"], ends, rails["rows"], strict=True):
        if not codes:
            continue
        flagged = rails["flagged"]
        count, unit = (
            (flagged, "readings of the sensor are flagged as saturated")
            if flagged
            else (readings, "readings of the axis")
        )
        advice = "" if flagged else "; none of them is flagged as saturated: import the log again"
        sentence = f"clips at {codes}; {{0}} {unit} in the log{advice}"
        yield _Remark((sensor["name"], axis["axis"]), sentence, (str(count),), (count,))


def _ends_in_words(low: float | None, high: float | None) -> str:
    return " and ".join(f"{code:.0f}" for code in (low, high) if code is not None)


def _ends(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    """Describe axes without readings, and readings that accumulate at the last code unless that is a known rail."""
    rails = sensor["rails"] or {"low": (), "high": ()}
    for number, axis in enumerate(sensor["axes"]):
        codes, place = axis["codes"], (sensor["name"], axis["axis"])
        end_codes = {codes_of_end[number] for codes_of_end in (rails["low"], rails["high"]) if codes_of_end}
        if codes is None:
            continue
        if codes["step"] == 0:
            yield _Remark(place, "always the same code")
        for end in (codes["low_end"], codes["high_end"]):
            if end["code"] in end_codes:
                continue
            if end["p_value"] is not None and end["p_value"] < SURE and end["share"] > _CLIPPED_SHARE:
                yield _Remark(place, "readings accumulate at code {0}: clipped", (str(end["code"]),), (end["code"],))


def _codes(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    """Describe the codes that occur and those that do not."""
    for axis in sensor["axes"]:
        codes, place = axis["codes"], (sensor["name"], axis["axis"])
        if codes is None:
            continue
        if codes["step"] and codes["usual_step"] > 1:
            is_even = codes["usual_step"] == 2 and codes["even_share"] == 1.0
            yield _Remark(place, "only even codes" if is_even else f"only every {ordinal(codes['usual_step'])} code")
        missing = [gap for gap in codes["missing"] if gap["p_value"] < SURE]
        if missing:
            spans = ", ".join(_code_span(gap) for gap in missing[:_SPANS])
            more = f" and {len(missing) - _SPANS} more" if len(missing) > _SPANS else ""
            yield _Remark(place, f"codes that never occur: {spans}{more}")


def ordinal(number: int) -> str:
    """Spell 2nd, 3rd, 4th, 11th, 22nd."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ending}"


def _code_span(gap: Mapping[str, Any]) -> str:
    return str(gap["first"]) if gap["first"] == gap["last"] else f"{gap['first']} to {gap['last']}"


def _slow_change(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    """Describe axes with a variance larger than that of their spectrum, from which each segment's mean is removed."""
    spectrum = sensor["spectrum"]
    if spectrum is None or spectrum["segments"] < _LEAST_SEGMENTS or len(spectrum["frequency_hz"]) < 2:
        return
    step_hz = spectrum["frequency_hz"][1] - spectrum["frequency_hz"][0]
    for axis in sensor["axes"]:
        variance = (axis["counts"]["std"] or 0.0) ** 2
        share = 1 - sum(axis["density"]) * step_hz / variance if variance else 0.0
        if share > _SLOW_CHANGE:
            sentence = (
                "{0} % of the variance is a slow change of the mean (by temperature, for example, which imuarray"
                " calibrate thermal determines)"
            )
            yield _Remark((sensor["name"], axis["axis"]), sentence, (f"{100 * share:.0f}",), (share,))


def _correlation(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    for axis in sensor["axes"]:
        values, errors = axis["autocorrelation"]["correlation"], axis["autocorrelation"]["error"]
        if values[1] is None or errors[1] is None or abs(values[1]) < max(_CORRELATED, 5 * errors[1]):
            continue
        if not axis["lines"]:  # a line causes correlation at all lags
            place = sensor["name"], axis["axis"]
            yield _Remark(place, "neighbouring readings correlate by {0}", (f"{values[1]:.2f}",), (values[1],))


def _fit(sensor: Mapping[str, Any]) -> Iterator[_Remark]:
    for axis in sensor["axes"]:
        fit = axis["fit"]
        if fit is None or not fit["verdict"]:
            continue
        way = "above" if fit["worst_ratio"] > 1 else "below"
        error, tau_s = abs(fit["worst_ratio"] - 1), fit["worst_tau_s"]
        reason = ", because of its lines" if axis["lines"] else ""
        sentence = f"the Allan curve is not a sum of the fitted noises{reason}: {{0}} {way} the fit at {{1}} s"
        yield _Remark(
            (sensor["name"], axis["axis"]), sentence, (f"{100 * error:.0f} %", f"{tau_s:.3g}"), (error, tau_s)
        )


@dataclass(frozen=True)
class _AxisLine:
    """A line of an axis, with its share of the axis's variance."""

    place: Place
    unit: str
    scale: float
    share: float
    resolution_hz: float
    line: Mapping[str, Any]

    def matches(self, other: _AxisLine) -> bool:
        """Return whether both can be one disturbance: equal in unit and, within resolution and width, in frequency."""
        if self.unit != other.unit or (self.line["fundamental_hz"] is None) != (other.line["fundamental_hz"] is None):
            return False
        widths = [line["width_hz"] for line in (self.line, other.line)]
        reach_hz = max(self.resolution_hz, other.resolution_hz, min(widths))
        return bool(abs(self.line["frequency_hz"] - other.line["frequency_hz"]) <= reach_hz)


def _lines(sensors: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Describe the strongest lines and count the others. A line that several axes have in common is described once."""
    groups: list[list[_AxisLine]] = []
    for line in sorted(_all_lines(sensors), key=lambda line: -line.share):
        same = next((group for group in groups if group[0].matches(line) and not _has_place(group, line)), None)
        if same is None:
            groups.append([line])
        else:
            same.append(line)
    order = [(sensor["name"], axis["axis"]) for sensor in sensors for axis in sensor["axes"]]
    for group in groups[:_LISTED_LINES]:
        yield _line_in_words(group, places_in_short(sorted((line.place for line in group), key=order.index)))
    unlisted = [line for group in groups[_LISTED_LINES:] for line in group]
    if unlisted:
        places = places_in_short(sorted((line.place for line in unlisted), key=order.index))
        yield f"weaker lines: {len(unlisted)}, in {places}"


def _has_place(group: Sequence[_AxisLine], line: _AxisLine) -> bool:
    return any(member.place == line.place for member in group)


def _all_lines(sensors: Sequence[Mapping[str, Any]]) -> Iterator[_AxisLine]:
    for sensor in sensors:
        unit = sensor["unit"] if sensor["unit_per_count"] is not None else "counts"
        for axis in sensor["axes"]:
            variance = (axis["counts"]["std"] or 0.0) ** 2
            for line in axis["lines"]:
                share = line["amplitude"] ** 2 / 2 / variance if variance else 0.0
                place = sensor["name"], axis["axis"]
                resolution_hz = sensor["spectrum"]["resolution_hz"]
                yield _AxisLine(place, unit, abs(axis["unit_per_count"] or 1.0), share, resolution_hz, line)


def _line_in_words(group: Sequence[_AxisLine], places: str) -> str:
    """Describe one line: frequency and width of the axis where it is strongest, and the amplitudes of all axes."""
    strongest = group[0]
    line, scale = strongest.line, strongest.scale
    other_aliases = [f"{hz:.4g}" for hz in line["aliases_hz"][1 : 1 + _ALIASES]]
    aliases = f" (or an alias of {', '.join(other_aliases)}, ... Hz)" if other_aliases else ""
    width = f"{line['width_hz']:.2g} Hz wide " if line.get("width_hz") else ""
    fundamental_hz = line.get("fundamental_hz")
    order = (
        f", harmonic {round(line['frequency_hz'] / fundamental_hz)} of {fundamental_hz:.4g} Hz"
        if fundamental_hz
        else ""
    )
    amplitude = f"{line['amplitude'] * scale:.3g} +- {line['amplitude_error'] * scale:.1g} {strongest.unit}"
    if len(group) > 1:
        values = [member.line["amplitude"] * member.scale for member in group]
        amplitude = f"{_span([(value, f'{value:.3g}') for value in values])} {strongest.unit}"
    shares = _span([(member.share, f"{100 * min(member.share, 1):.2g}") for member in group])
    return (
        f"{places}: a line {width}at {line['frequency_hz']:.4g} Hz{order}{aliases}, amplitude {amplitude},"
        f" {shares} % of the variance{_mains(line)}"
    )


def _mains(line: Mapping[str, Any]) -> str:
    """Return the mains frequency of a line, directly or aliased, within the errors of line and rate; "" if none."""
    if line.get("width_hz"):
        return ""
    near = 2 * line["frequency_error_hz"] + _MAINS_HZ_ERROR
    for mains_hz in MAINS_HZ:
        if any(abs(hz - mains_hz) < near for hz in line["aliases_hz"]):
            aliased = "" if abs(line["frequency_hz"] - mains_hz) < near else "aliased "
            return f", possibly {aliased}{mains_hz:g} Hz mains"
    return ""
