"""What a log that was just imported says of itself, and what in it is doubtful: the report after every import.

Most mistakes of an import are of units, and they contradict something that is known: gravity is 1 g, the earth's field
some half a gauss, and what a gyroscope turns an accelerometer's gravity turns too. Others show in the times (a unit of
time, rows in bursts, stalls) or in the codes (axes that are always the same, only even codes, a range that is
exceeded). Nothing is changed here; a doubt is for a person.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import log as ln
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.calibrate.segments import degc_of, has_zero
from imuarray.characterise.codes import NOTHING, Histogram, histogram, usual_step
from imuarray.characterise.repeats import RepeatTally
from imuarray.gap.recording.row_timing import RowTiming, row_timing
from imuarray.log import Log, SensorLog
from imuarray.printable import counted
from imuarray.units import INERTIAL, STANDARD_GRAVITY

WINDOW_S = 0.5
"""Means of so long windows tell rest and turns: gravity changes little in it, noise averages out."""

FEWEST_ROWS = 32
"""A recording with fewer rows is an extract, of which nothing is doubted."""

GRAVITY_OFF = 0.12
"""Share by which the force felt at rest may differ from 1 g before it is doubted: an offset of 50 mg on each axis and a
scale that is off by 3 % make a tenth."""

NEAR_FACTOR = 0.1
"""A force is explained by a wrong unit if it is so near (log ratio) to 1 g times the units' ratio."""

EARTH_GAUSS = (0.15, 1.0)
"""Field of the earth (0.22 to 0.67 gauss, IGRF) with what iron near a sensor adds or takes."""

RATES_HZ = (1.0, 20_000.0)
"""Rows a second of inertial and magnetic sensors: no chip gives more, and slower ones are of a wrong unit of time."""

USUAL_RATES_HZ = (5.0, 5000.0)
"""In these a corrected unit of time has to bring them."""

OVER_RANGE = 1.05
"""Readings this much beyond the range: chips go a few per cent beyond what they promise."""

STILL = 2.5
"""A window is at rest if it scatters at most this many times as much as the quiet quarter does."""

TURNED = 0.02
"""Direction of gravity between windows has to change by so much (rad) for that to say something of a gyroscope."""

FEWEST_TURNS = 20
FOLLOWS = 0.8
"""Correlation of turns felt by the accelerometers and by a gyroscope from which on their ratio is believed."""

SAME_SCALE = 1.4
"""Ratio of turns up to which nothing is doubted: forces of motion disturb it."""

LISTED = 3
"""So many sensors of a quantity are reported one by one."""

STALE_SHARE = 0.015
"""Share of rows that repeat the one before, beyond chance, that is worth saying."""

DEGC = (-45.0, 130.0)
"""Temperatures of chips that work."""

_FORCE_UNITS: Mapping[float, str] = MappingProxyType(
    {
        STANDARD_GRAVITY: "m/s2 that were taken for g",
        1 / STANDARD_GRAVITY: "g that were taken for m/s2",
        1000.0: "mg that were taken for g",
        0.001: "g that were taken for mg",
    }
)
_FIELD_UNITS: Mapping[float, str] = MappingProxyType(
    {
        100.0: "uT that were taken for gauss",
        0.01: "gauss that were taken for uT",
        1000.0: "mgauss that were taken for gauss",
        1e-3: "gauss that were taken for mgauss",
        1e-4: "T that were taken for gauss",
        1e5: "nT that were taken for gauss",
    }
)
_TURN_UNITS: Mapping[float, str] = MappingProxyType(
    {
        180 / np.pi: "rad/s that were taken for dps",
        np.pi / 180: "dps that were taken for rad/s",
        1e-3: "mdps that were taken for dps",
        1e3: "dps that were taken for mdps",
    }
)


@dataclass(frozen=True)
class Report:
    """Sentences: `facts` of a recording, `quirks` that its analysis meets, `doubts`: what of its map may be wrong."""

    facts: tuple[str, ...] = ()
    quirks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass
class _Told:
    """Sentences with the sensors of which each is true."""

    sentences: dict[str, list[str]] = field(default_factory=dict)

    def add(self, name: str, sentence: str) -> None:
        """One more."""
        self.sentences.setdefault(sentence, []).append(name)

    def all(self) -> tuple[str, ...]:
        """Sensors of which the same is true share it."""
        return tuple(f"{', '.join(names)}: {sentence}" for sentence, names in self.sentences.items())


def report_of(log: Log) -> Report:
    """Of all triads and thermometers of a log."""
    quirks, doubts = _Told(), _Told()
    levels: dict[str, dict[str, float]] = {}
    windows: dict[str, _Windows] = {}
    for sensor in log.sensors.values():
        if len(sensor) < FEWEST_ROWS:
            continue
        known, doubted = _degrees(sensor)
        for text in doubted:
            doubts.add(sensor.name, text)
        for text in known:
            quirks.add(sensor.name, text)
        if not sensor.is_triad:
            continue
        timing = row_timing(sensor)
        if timing.sentence:
            hint = "; the map says stamps = 'arrival' for times that are counted out" if timing.kind == "bursts" else ""
            quirks.add(sensor.name, timing.sentence + hint)
        elif timing.gaps:
            quirks.add(sensor.name, _missing_rows(timing))
        for text in _rate(timing):
            doubts.add(sensor.name, text)
        codes = _Codes(sensor)
        for text in codes.quirks():
            quirks.add(sensor.name, text)
        for text in codes.doubts(sensor):
            doubts.add(sensor.name, text)
        if sensor.sensitivity and not codes.is_constant:
            windows[sensor.name] = _Windows(sensor, timing)
            told, doubted = _level(sensor, windows[sensor.name])
            if told is not None:
                levels.setdefault(told[0], {})[sensor.name] = told[1]
            for text in doubted:
                doubts.add(sensor.name, text)
    for name, text in [*_turns(log, windows), *_twins(log)]:
        doubts.add(name, text)
    return Report(tuple(_facts(levels)), quirks.all(), doubts.all())


def _facts(levels: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """What sensors read at rest; of many, from the least to the most."""
    for wording, values in levels.items():
        if len(values) <= LISTED:
            yield from (f"{name}: {wording.format(f'{value:.4g}')}" for name, value in values.items())
        else:
            span = f"{min(values.values()):.4g} to {max(values.values()):.4g}"
            yield f"{', '.join(values)}: {wording.format(span)}"


class _Windows:
    """Means (w, 3) and largest standard deviation (w,) of a sensor's windows that have rows, in its unit, box frame."""

    def __init__(self, sensor: SensorLog, timing: RowTiming) -> None:
        begin = int(sensor.time[0])
        self.width_ns = round(max(WINDOW_S, 8 * timing.seconds / max(timing.rows, 1)) * 1e9)
        count = (int(sensor.time[-1]) - begin) // self.width_ns + 1
        rows, sums, squares = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3))
        for block in sensor.blocks():
            window = (np.asarray(sensor.time[block], np.int64) - begin) // self.width_ns
            value = np.asarray(sensor.counts[block], float) / sensor.sensitivity @ sensor.orientation.T
            rows += np.bincount(window, minlength=count)
            for axis in range(3):
                sums[:, axis] += np.bincount(window, value[:, axis], minlength=count)
                squares[:, axis] += np.bincount(window, value[:, axis] ** 2, minlength=count)
        full = rows >= 4
        self.number = np.flatnonzero(full) + begin // self.width_ns
        share = rows[full][:, None]
        self.mean = sums[full] / share
        self.spread = np.sqrt(np.maximum(squares[full] / share - self.mean**2, 0)).max(axis=1)
        self.offset_ns = begin % self.width_ns

    def still(self) -> npt.NDArray[np.bool_]:
        """(w,) windows at rest, as far as the quiet quarter was."""
        if len(self.spread) == 0:
            return np.zeros(0, bool)
        return np.asarray(self.spread <= STILL * np.quantile(self.spread, 0.25))


def _level(sensor: SensorLog, windows: _Windows) -> tuple[tuple[str, float] | None, list[str]]:
    """What a sensor reads at rest (wording and value), and whether that can be."""
    still = windows.still()
    if not still.any():
        return None, []
    length = float(np.median(np.linalg.norm(windows.mean[still], axis=1)))
    if sensor.quantity == "specific_force":
        if abs(length - 1) <= GRAVITY_OFF:
            return ("feels {} g at rest", length), []
        guess = _explained(length, _FORCE_UNITS) or _doubled(length)
        if not guess and length < 0.3:
            guess = "gravity may have been taken out (linear acceleration), or the unit is another"
        guess = guess or "unit, range, sensitivity or offset may be wrong"
        return None, [f"feels {length:.4g} g at rest, where 1 g is there: {guess}"]
    if sensor.quantity == "magnetic_field":
        if EARTH_GAUSS[0] <= length <= EARTH_GAUSS[1]:
            return ("feels {} gauss", length), []
        middle = (EARTH_GAUSS[0] * EARTH_GAUSS[1]) ** 0.5
        guess = next((what for factor, what in _FIELD_UNITS.items() if 0.4 < length / factor / middle < 2.5), "")
        guess = f"the columns may be in {guess}" if guess else "unit or sensitivity may be wrong"
        return None, [f"feels {length:.4g} gauss, where the earth has 0.2 to 0.7: {guess}"]
    return ("reads {} dps where it is quietest, its bias", length), []


def _explained(ratio: float, units: Mapping[float, str]) -> str:
    """The unit whose ratio is the nearest, if any is near."""
    factor = min(units, key=lambda one: abs(ln(ratio / one))) if ratio > 0 else 1.0
    near = ratio > 0 and abs(ln(ratio / factor)) < NEAR_FACTOR
    return f"the columns may be in {units[factor]}" if near else ""


def _doubled(ratio: float) -> str:
    """Ranges of chips are powers of two apart."""
    if ratio <= 0:
        return ""
    power = round(ln(ratio) / ln(2))
    if power == 0 or abs(power) > 5 or abs(ln(ratio / 2.0**power)) > NEAR_FACTOR:
        return ""
    factor = f"{2 ** abs(power)} times too {'small' if power > 0 else 'large'}"
    return f"range and sensitivity may be those of another setting, the counts per g {factor}"


def _missing_rows(timing: RowTiming) -> str:
    """How many rows would fill the gaps of steady rows."""
    missing = max(round(timing.gaps_s / timing.usual_s) - timing.gaps, 1)
    gaps, rows = counted(timing.gaps, "gap"), counted(missing, "row")
    return f"{gaps} between rows, {1e3 * timing.gap_s:.3g} ms in the median: {rows} may be missing"


def _rate(timing: RowTiming) -> Iterator[str]:
    rate_hz = timing.rate_hz
    if timing.rows < FEWEST_ROWS or not rate_hz or RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        return
    factors = {1e3: "a thousand times smaller", 1e6: "a million times smaller", 1e-3: "a thousand times larger"}
    units = [name for factor, name in factors.items() if USUAL_RATES_HZ[0] <= rate_hz * factor <= USUAL_RATES_HZ[1]]
    guess = f": the unit of time may be {units[0]}" if units else ""
    yield f"{rate_hz:.3g} rows a second{guess}"


class _Codes:
    """The codes of a triad's axes, and how rows repeat."""

    def __init__(self, sensor: SensorLog) -> None:
        seen: list[Histogram] = [NOTHING] * 3
        tally = RepeatTally()
        for block in sensor.blocks():
            counts = np.asarray(sensor.counts[block], np.int64)
            seen = [known.merge(histogram(column)) for known, column in zip(seen, counts.T, strict=True)]
            tally.update(counts)
        self.seen, self.repeats = seen, tally.result()

    @property
    def is_constant(self) -> bool:
        """All axes always the same."""
        return all(len(codes.codes) == 1 for codes in self.seen)

    def quirks(self) -> Iterator[str]:
        """What of the codes is unusual and no mistake."""
        steps = Counter(usual_step(codes) for codes in self.seen if len(codes.codes) > 2)
        step = next(iter(steps)) if len(steps) == 1 else 1
        on_zero = (
            all(bool((codes.codes[np.argmax(codes.counts)] % step) == 0) for codes in self.seen) if step else False
        )
        if step > 1:
            yield "only even codes" if step == 2 and on_zero else f"only every {step}th code"
        if self.repeats.new_share < 1 - STALE_SHARE:
            yield f"{1 - self.repeats.new_share:.1%} of its rows repeat the one before, no new readings"

    def doubts(self, sensor: SensorLog) -> Iterator[str]:
        """What of the codes can't be."""
        constant = "".join(axis for axis, codes in zip("xyz", self.seen, strict=True) if len(codes.codes) == 1)
        if constant:
            codes = ", ".join(str(int(codes.codes[0])) for codes in self.seen if len(codes.codes) == 1)
            zero = " (rounded away, of a smaller unit than said, or not connected?)" if codes.strip("0, ") == "" else ""
            yield f"{constant} is always {codes}{zero}"
        limit = OVER_RANGE * sensor.range * sensor.sensitivity
        most = max(int(np.abs(codes.codes[[0, -1]]).max()) for codes in self.seen)
        if limit and most > limit:
            value = most / sensor.sensitivity
            yield f"reads up to {value:.4g} {sensor.unit}, beyond its range of {sensor.range:g}: is the unit another?"
        if all(_is_unsigned(codes) for codes in self.seen) and sensor.quantity in INERTIAL:
            yield "all codes are positive on every axis: are they unsigned, with an offset?"


def _is_unsigned(seen: Histogram) -> bool:
    return bool(seen.codes[0] >= 1000 and seen.codes[-1] - seen.codes[0] < seen.codes[0])


def _degrees(sensor: SensorLog) -> tuple[list[str], list[str]]:
    """What a thermometer read, and what of it is missing or can't be."""
    column = sensor.temperature_counts
    if column is None:
        return [], []
    seen = histogram(np.asarray(column[:], np.int64))
    scale = degc_of(sensor)
    if scale is None:
        return [], [
            "nobody knows what its thermometer's counts mean: the map says thermometer = { zero_degc, lsb_per_degc }"
        ]
    ends = sorted(scale[0] + scale[1] * float(code) for code in seen.codes[[0, -1]])
    whose = "" if sensor.quantity == "temperature" else "its thermometer "
    span = f"{whose}reads {ends[0]:.4g} to {ends[1]:.4g} degC"
    if has_zero(sensor) and not DEGC[0] <= ends[0] <= ends[1] <= DEGC[1]:
        return [], [f"{span}: is its scale another?"]
    step = usual_step(seen)
    return [f"{span}, in steps of {step} counts ({abs(step * scale[1]):.2g} degC)" if step > 1 else span], []


def _turns(log: Log, windows: Mapping[str, _Windows]) -> Iterator[tuple[str, str]]:
    """Gyroscopes that turn otherwise than gravity does in an accelerometer."""
    forces = [windows[one.name] for one in log.of("specific_force") if one.name in windows]
    for gyroscope in log.of("angular_rate"):
        if gyroscope.name not in windows or not forces:
            continue
        factor = _turn_ratio(forces[0], windows[gyroscope.name])
        if factor is None or 1 / SAME_SCALE < factor < SAME_SCALE:
            continue
        if factor < 0:
            yield gyroscope.name, "turns against the accelerometers: axes of one of them are mirrored or exchanged"
            continue
        guess = _explained(factor, _TURN_UNITS) or "range and sensitivity may be those of another setting"
        yield gyroscope.name, f"turns {1 / factor:.3g} times as fast as gravity does in the accelerometers: {guess}"


def turns_of(log: Log) -> float | None:
    """By what a log's first gyroscope has to be multiplied to turn as gravity does in its first accelerometer; None if
    nothing tells.
    """
    pair = [next(iter(log.of(quantity)), None) for quantity in INERTIAL]
    if any(one is None or len(one) < FEWEST_ROWS or not one.sensitivity for one in pair):
        return None
    force, rate = (_Windows(one, row_timing(one)) for one in pair if one is not None)
    return _turn_ratio(force, rate)


def _turn_ratio(force: _Windows, rate: _Windows) -> float | None:
    """By what a gyroscope's turns have to be multiplied to be those of gravity; None if too little turned.

    A direction that is constant outside turns by -omega x f in a frame that turns with omega.
    """
    if force.width_ns != rate.width_ns:
        return None
    common, here, there = np.intersect1d(force.number, rate.number, return_indices=True)
    if len(common) < FEWEST_TURNS:
        return None
    f, omega = force.mean[here], rate.mean[there] * np.pi / 180
    length = np.linalg.norm(f, axis=1)
    usual = np.median(length)
    f = f / np.maximum(length, 1e-9)[:, None]
    follows = (np.diff(common) == 1) & (np.abs(length[1:] / usual - 1) < 0.2) & (np.abs(length[:-1] / usual - 1) < 0.2)
    turned = np.diff(f, axis=0)[follows]
    still = np.linalg.norm(turned, axis=1) < TURNED
    rates = (omega[1:] + omega[:-1])[follows] / 2
    if still.any():
        rates = rates - np.median(rates[still], axis=0)  # its bias
    middle = (f[1:] + f[:-1])[follows] / 2
    expected = -np.cross(rates, middle) * force.width_ns * 1e-9
    moving = ~still
    if np.count_nonzero(moving) < FEWEST_TURNS:
        return None
    a, b = turned[moving].ravel(), expected[moving].ravel()
    both = float(np.sqrt((a @ a) * (b @ b)))
    if not both or abs(float(a @ b)) / both < FOLLOWS:
        return None
    return float(a @ b) / float(b @ b)


def _twins(log: Log) -> Iterator[tuple[str, str]]:
    """Sensors and axes that have the same readings."""
    heads = {
        one.name: np.asarray(one.counts[:FEWEST_ROWS], np.int64)
        for one in log.sensors.values()
        if one.is_triad and len(one) >= FEWEST_ROWS
    }
    names = list(heads)
    for number, name in enumerate(names):
        sensor = log[name]
        for first, second in ((0, 1), (0, 2), (1, 2)):
            head = heads[name]
            if (
                np.ptp(head[:, first])
                and (head[:, first] == head[:, second]).all()
                and _same(sensor, sensor, first, second)
            ):
                yield name, f"{'xyz'[first]} and {'xyz'[second]} have the same readings: is a column named twice?"
        for other in names[:number]:
            same = np.ptp(heads[name]) and np.array_equal(heads[name], heads[other])
            if (
                same
                and len(log[other]) == len(sensor)
                and all(_same(sensor, log[other], axis, axis) for axis in range(3))
            ):
                yield name, f"has the readings of {other}: are its columns named twice?"


def _same(sensor: SensorLog, other: SensorLog, first: int, second: int) -> bool:
    """Whether two columns are equal in all rows."""
    return all(
        np.array_equal(np.asarray(sensor.counts[block])[:, first], np.asarray(other.counts[block])[:, second])
        for block in sensor.blocks()
    )
