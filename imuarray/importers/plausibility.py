"""The report after every import: facts about the new log, and doubts about its map.

Most mistakes of an import are wrong units, which contradict known values: gravity is 1 g, the earth's field is about
half a gauss, and a rotation measured by a gyroscope also rotates gravity in an accelerometer. Other mistakes are
detected in the times (a unit of time, rows in bursts, stalls) or in the codes (constant axes, only even codes, an
exceeded range). The report does not change the log; the user decides about doubts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import log as ln
from os import PathLike
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imuarray.arrays import Floats
from imuarray.calibrate.faces import axes_text
from imuarray.calibrate.motion import find_knocks, knock_sentence
from imuarray.calibrate.pointing import TURNS
from imuarray.calibrate.pose_readings import RestWindows
from imuarray.calibrate.segments import degc_of, has_zero
from imuarray.characterise.codes import NOTHING, Histogram, histogram, usual_step
from imuarray.characterise.findings import SURE, shares_times
from imuarray.characterise.processing import NO_GRAVITY, find_filters, find_interpolation
from imuarray.characterise.repeats import STALE_SHARE, Repeats, RepeatTally, RunTally
from imuarray.characterise.stretch import find_rate_changes, rate_change_sentence
from imuarray.importers.code_errors import find_jumps
from imuarray.importers.triad_behaviour import fit_sphere
from imuarray.log import Log, SensorLog, open_log
from imuarray.log.format import ASSUMED, RESOLUTION
from imuarray.log.import_report import ImportReport, store_import_report
from imuarray.log.row_timing import GAP, RowTiming, row_timing
from imuarray.printable import counted, listed, percent
from imuarray.units import INERTIAL, STANDARD_GRAVITY, Quantity

WINDOW_S = 0.5
"""Length of the windows in which rest and rotation are detected: gravity changes little in them, noise is averaged."""

TURN_WINDOW_S = 0.125
"""Length of the windows in which quick rotations are compared: a turn by hand takes a second. Slow rotations, in which
gravity hardly changes from window to window, are compared in windows of `WINDOW_S`.
"""

FEWEST_ROWS = 32
"""Fewest rows of a recording for doubts; a shorter one is an excerpt."""

GRAVITY_OFF = 0.12
"""Largest plausible relative difference of the force at rest from 1 g: an offset of 50 mg on each axis and a scale
error of 3 % are together a tenth.
"""

NEAR_FACTOR = 0.1
"""Largest log ratio between a measured force and 1 g times the ratio of two units at which a confusion of the units
explains the force.
"""

NEAR_TURNS = 0.3
"""The same limit for rotations, which quick motion disturbs."""

EARTH_GAUSS = (0.15, 1.0)
"""Field of the earth (0.22 to 0.67 gauss, IGRF) with the influence of iron near a sensor."""

LEAST_OFFSET = 64.0
"""Least code that is assumed to be the middle of an unsigned converter's range: with 8 bits it is 128."""

RATES_HZ = (0.5, 20_000.0)
"""Plausible rates of inertial and magnetic sensors: no chip is faster, and a program may read once a second. A lower
rate is due to a wrong unit of time.
"""

USUAL_RATES_HZ = (5.0, 5000.0)
"""Range in which the rate must be after a correction of the unit of time."""

OVER_RANGE = 1.05
"""Tolerance beyond the range: chips exceed their nominal range by a few per cent."""

STILL = 2.5
"""A window is at rest if its standard deviation is at most this multiple of that of the quiet windows (`QUIET`)."""

QUIET = 0.1
"""Share of the windows that are quiet: a recording is assumed to be at rest for at least this share of its time."""

RESTS = 0.5
"""Least share of windows at rest at which a disturbance is reported as a knock and not as motion."""

SHAKEN = 0.1
SHAKEN_LEVEL = 3.0
"""A recording is shaken throughout if the standard deviation of its quiet windows exceeds the share `SHAKEN` of the
force. The force then indicates a wrong unit only if it differs from 1 g by more than the factor `SHAKEN_LEVEL`.
"""

TURNS_DPS = 1.0
"""Scatter in dps of the means of a gyroscope's quiet windows, beyond their noise, above which they are not at rest."""

MOST_BIAS_DPS = 80.0
"""Largest plausible reading of a gyroscope at rest: the largest zero-rate level of a data sheet is 75 dps (L3G-70)."""

NOISY_DPS = 2.0
NOISY_BIAS_DPS = 20.0
"""A gyroscope at rest with a noise of more than `NOISY_DPS` and a reading of more than `NOISY_BIAS_DPS` is doubted."""

RESOLVED_LSB = 0.3
QUIET_DPS = 0.003
"""Least noise (rms) of a MEMS gyroscope. It is compared only if the noise exceeds `RESOLVED_LSB` counts: that of
rounding is 1 / sqrt(12).
"""

MOST = MappingProxyType({"specific_force": 450.0, "angular_rate": 4500.0, "magnetic_field": 60.0})
"""Readings (g, dps, gauss) that no usual chip exceeds."""

TURNED = 0.02
"""Least rotation of gravity between windows (rad) for a comparison with a gyroscope."""

MISALIGNED = 0.9
"""Cosine of the angle between the gravity vectors of two accelerometers below which one of them is not mounted as
stated in the map: chips are soldered within a few degrees, and no bias changes the direction by 26 degrees.
"""

FEWEST_RESTS = 8
"""Fewest windows at rest for a comparison of directions of gravity."""

ALWAYS = 0.9
"""Least share of the windows at rest in which the same axis points down, for a statement about all of them."""

LEAST_DIP_DEG = 20.0
"""Least inclination of the magnetic field in degrees at which it distinguishes up from down in spite of biases."""

LEAST_HELD = 32
"""Fewest consecutive equal rows that are reported as a stop: sensors that are read too often repeat fewer rows."""

BESIDE = 64
"""Number of rows before and after these rows in which the readings must change."""

AXIS_HELD = 64
OTHER_RUNS = 8.0
"""Fewest consecutive equal readings of a single axis that are reported as a stop (`AXIS_HELD`), and least ratio of
their number to that of its next longest run: an axis at rest with little noise often repeats a reading.
"""

OTHER_CODES = 5
MOST_COMPARED = 4096
"""Fewest different codes of another axis during such a stop, in at most `MOST_COMPARED` rows. At rest, an axis whose
noise is less than a count keeps its code, and the other axes have few codes.
"""

FITS = 0.95
"""Least correlation of the rotations of accelerometers and gyroscope at which axes other than the map's fit."""

BETTER = 0.1
"""Least difference between the best and the second-best correlation at which the best axes are stated."""

FEWEST_TURNS = 20
TURN_PASSES = 3
MOST_HALF_TURN = 1.0
"""Constants of the rotation fit: the fewest rotations, the number of iterations in which the angle between windows is
determined, and the largest half of this angle (rad) that is used.
"""

FOLLOWS = 0.8
"""Least correlation between the rotations of accelerometers and gyroscope at which their ratio is used."""

SAME_SCALE = 1.4
"""Largest ratio of rotations that is not doubted: accelerations of the motion disturb it."""

LISTED = 3
"""Maximum number of sensors of a quantity that are reported individually."""

MOST_OF_A_TIME = 4.0
"""Mean number of rows with the same time above which the times are doubted. With a clock of milliseconds, two rows of a
fast chip have the same time; a clock of seconds hides the rate.
"""

LOST_ROW = 1.5
"""Shortest gap after a single lost row, in usual intervals."""

OFF_GRID = 0.25
"""Largest difference of the sum of three consecutive intervals from a whole number, in usual intervals."""

MOST_GAPS = 0.1
"""Share of gaps in the intervals above which rows are reported as missing regularly."""

STEADY_SHARE = 0.9
"""Least share of rows on the grid at which the rows of a sensor count as steady."""

DEGC = (-45.0, 130.0)
"""Range of temperatures of a working chip in degC."""

_FORCE_UNITS: Mapping[float, str] = {
    STANDARD_GRAVITY: "m/s2, not g", 1 / STANDARD_GRAVITY: "g, not m/s2", 1000.0: "mg, not g", 0.001: "g, not mg",
}  # fmt: skip
_FIELD_UNITS: Mapping[float, str] = {
    100.0: "uT, not gauss", 0.01: "gauss, not uT", 1000.0: "mgauss, not gauss", 1e-3: "gauss, not mgauss",
    1e-4: "T, not gauss", 1e5: "nT, not gauss",
}  # fmt: skip
_TURN_UNITS: Mapping[float, str] = {
    180 / np.pi: "rad/s, not dps", np.pi / 180: "dps, not rad/s", 1e-3: "mdps, not dps", 1e3: "dps, not mdps",
}  # fmt: skip
"""Confusions of units in a map: forces and fields by the ratio of the reading to the known value, rotations by the
factor by which the rates must be multiplied.
"""


@dataclass
class _Sentences:
    """Sentences, each with the sensors that it applies to."""

    sentences: dict[str, list[str]] = field(default_factory=dict)

    def add(self, name: str, sentence: str) -> None:
        self.sentences.setdefault(sentence, []).append(name)

    def add_all(self, name: str, sentences: Iterable[str]) -> None:
        for sentence in sentences:
            self.add(name, sentence)

    def all(self) -> tuple[str, ...]:
        """Return the sentences; sensors with the same sentence share it."""
        return tuple(f"{listed(_group_names(names))}: {sentence}" for sentence, names in self.sentences.items())


def _group_names(names: Sequence[str]) -> list[str]:
    """Return names grouped by spelling without numbers, in order of occurrence: A1, A2, G1, G2 for A1, G1, A2, G2."""
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(re.sub(r"\d+", "", name), []).append(name)
    return [name for same in kinds.values() for name in same]


def report_of(log: Log) -> ImportReport:
    """Return the report on all triads and thermometers of a log, without remarks."""
    examination = _Examination()
    for sensor in log.sensors.values():
        if len(sensor) < FEWEST_ROWS:
            continue
        degrees, doubted = _degrees(sensor)
        examination.quirks.add_all(sensor.name, degrees)
        examination.doubts.add_all(sensor.name, doubted)
        if sensor.is_triad:
            examination.add_triad(sensor)
    windows = examination.windows
    for name, text in [*_turns(log, windows, examination.short_windows), *_directions(log, windows), *_twins(log)]:
        examination.doubts.add(name, text)
    for name, text in _upside_down(log, windows):
        examination.quirks.add(name, text)
    forces = _names_of(log, "specific_force", windows)
    if forces and (knocks := windows[forces[0]].knocks()):
        examination.quirks.add(forces[0], knocks)
    return ImportReport(
        facts=tuple(_facts(examination.levels)), quirks=examination.quirks.all(), doubts=examination.doubts.all()
    )


def store_report(output: str | PathLike[str], remarks: Sequence[str], doubts: Sequence[str] = ()) -> ImportReport:
    """Store the report on an imported log, and the importer's `remarks` and `doubts`, in the log, and return the
    report; LogError if the log cannot be read or written.
    """
    with open_log(output) as log:
        report = report_of(log)
    report = report._replace(remarks=tuple(remarks), doubts=(*doubts, *report.doubts))
    store_import_report(output, report)
    return report


@dataclass
class _Examination:
    """Observations of single sensors: sentences, their `levels` at rest by wording, and the windows of sensors with
    plausible times and codes.
    """

    quirks: _Sentences = field(default_factory=_Sentences)
    doubts: _Sentences = field(default_factory=_Sentences)
    levels: dict[str, dict[str, float]] = field(default_factory=dict)
    windows: dict[str, _Windows] = field(default_factory=dict)
    short_windows: dict[str, _Windows] = field(default_factory=dict)

    def add_triad(self, sensor: SensorLog) -> None:
        """Examine the times, the codes and the level of a triad."""
        timing, codes = row_timing(sensor), _Codes(sensor)
        interpolation = find_interpolation(sensor)
        if shares_times(timing.kind, timing.usual_s):
            is_doubtful = timing.rows > MOST_OF_A_TIME * (timing.gaps + 1)
            (self.doubts if is_doubtful else self.quirks).add(sensor.name, _shared_times(timing))
        else:
            self.quirks.add_all(sensor.name, _times(sensor, timing))
        self.quirks.add_all(sensor.name, [] if interpolation is None else [interpolation.sentence])
        self.quirks.add_all(sensor.name, [*find_filters(sensor), *codes.quirks()])
        of_rate = list(_rate(timing))
        self.doubts.add_all(sensor.name, [*of_rate, *codes.doubts(sensor)])
        if not sensor.sensitivity or codes.is_constant:
            return
        windows = _Windows(sensor, timing, codes.held)
        if not of_rate:  # rotations follow from rates and times
            self.windows[sensor.name] = windows
            if sensor.quantity in INERTIAL:
                self.short_windows[sensor.name] = _Windows(sensor, timing, codes.held, TURN_WINDOW_S)
        level, doubted = _level(sensor, windows)
        if level is not None:
            self.levels.setdefault(level[0], {})[sensor.name] = level[1]
        self.doubts.add_all(sensor.name, doubted)


def _times(sensor: SensorLog, timing: RowTiming) -> Iterator[str]:
    """Yield sentences on unusual times of a sensor's rows, each of which has a time of its own."""
    if timing.sentence:
        hint = "; stamps = 'arrival' in the map reconstructs the reading times" if timing.kind == "bursts" else ""
        yield timing.sentence + hint
    elif text := rate_change_sentence(find_rate_changes(sensor)) or _missing_rows(sensor, timing):
        yield text


def _facts(levels: Mapping[str, Mapping[str, float]]) -> Iterator[str]:
    """Yield sentences on the readings of sensors at rest; for many sensors with the smallest and the largest value."""
    for wording, values in levels.items():
        if len(values) <= LISTED:
            yield from (f"{name}: {wording.format(f'{value:.4g}')}" for name, value in values.items())
        else:
            span = f"{min(values.values()):.4g} to {max(values.values()):.4g}"
            yield f"{listed(list(values))}: {wording.format(span)}"


class _Windows:
    """Means (w, 3) and largest standard deviation (w,) of a sensor's windows with rows, in its unit, box frame."""

    def __init__(
        self, sensor: SensorLog, timing: RowTiming, left_out: slice = slice(0, 0), window_s: float = WINDOW_S
    ) -> None:
        begin = int(sensor.time[0])
        self.width_ns = round(max(window_s, 8 * timing.seconds / max(timing.rows, 1)) * 1e9)
        count = (int(sensor.time[-1]) - begin) // self.width_ns + 1
        rows, sums, squares = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3))
        for block in sensor.blocks():
            row = np.arange(block.start, block.start + len(sensor.time[block]))
            used = (row < left_out.start) | (row >= left_out.stop)
            window = (np.asarray(sensor.time[block], np.int64)[used] - begin) // self.width_ns
            value = np.asarray(sensor.counts[block], float)[used] / sensor.sensitivity @ sensor.orientation.T
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

    @property
    def has_gravity(self) -> bool:
        """True if an accelerometer measures more than the remainder after a program has subtracted gravity."""
        return len(self.mean) > 0 and float(np.median(np.linalg.norm(self.mean, axis=1))) > NO_GRAVITY

    def still(self) -> npt.NDArray[np.bool_]:
        """Return which windows (w,) are at rest, relative to the quietest tenth."""
        if len(self.spread) == 0:
            return np.zeros(0, bool)
        return np.asarray(self.spread <= STILL * np.quantile(self.spread, QUIET, method="lower"))

    def knocks(self) -> str:
        """Describe the knocks of an accelerometer that is mostly at rest; "" without any."""
        still = self.still()
        if not len(still) or still.mean() < RESTS:
            return ""
        place, count = self.number - self.number[0], int(self.number[-1] - self.number[0]) + 1
        mean, spread, all_still = np.zeros((count, 3)), np.full(count, np.inf), np.zeros(count, bool)
        mean[place], spread[place], all_still[place] = self.mean, self.spread, still
        begin_ns = int(self.number[0]) * self.width_ns + self.offset_ns
        windows = RestWindows("specific_force", begin_ns, self.width_ns, mean, spread, all_still)
        return knock_sentence(find_knocks(windows), "mg", 1e3)


def _level(sensor: SensorLog, windows: _Windows) -> tuple[tuple[str, float] | None, list[str]]:
    """Return the reading of a sensor at rest (wording and value), and doubts about it."""
    still = windows.still()
    if not still.any():
        return None, []
    length = float(np.median(np.linalg.norm(windows.mean[still], axis=1)))
    if sensor.quantity == "specific_force":
        if weightless := _weightless(sensor):
            return None, [weightless]
        shaken = float(np.median(windows.spread[still])) > SHAKEN * length
        if abs(length - 1) <= GRAVITY_OFF:
            return ("measures {} g" if shaken else "measures {} g at rest", length), []
        if shaken and 1 / SHAKEN_LEVEL < length < SHAKEN_LEVEL:
            return None, []
        guess = _name_unit(length, _FORCE_UNITS) or _explain_doubling(length)
        if length < 0.3 and (not guess or float(np.median(windows.spread[still])) > length):
            unit = guess if "columns" in guess else "the unit may be wrong"
            guess = f"gravity may have been removed (linear acceleration), or {unit}"
        guess = guess or "unit, range, sensitivity or offset may be wrong"
        return None, [f"measures {length:.4g} g{'' if shaken else ' at rest'} instead of 1 g: {guess}"]
    if sensor.quantity == "magnetic_field":
        if EARTH_GAUSS[0] <= length <= EARTH_GAUSS[1]:
            return ("measures {} gauss", length), []
        middle = (EARTH_GAUSS[0] * EARTH_GAUSS[1]) ** 0.5
        guess = next((what for factor, what in _FIELD_UNITS.items() if 0.4 < length / factor / middle < 2.5), "")
        guess = f"the columns may be in {guess}" if guess else "unit or sensitivity may be wrong"
        return None, [f"measures {length:.4g} gauss instead of the earth's 0.2 to 0.7: {guess}"]
    middle = np.median(windows.mean[still], axis=0)
    wander = float(np.median(np.linalg.norm(windows.mean[still] - middle, axis=1)))
    if wander > TURNS_DPS + float(np.median(windows.spread[still])):
        return ("turns at {} dps at its quietest", length), []
    noise = float(np.median(windows.spread[still]))
    level = f"reads {length:.4g} dps at rest with a noise of {noise:.2g} dps"
    if length > MOST_BIAS_DPS or (length > NOISY_BIAS_DPS and noise > NOISY_DPS):
        return None, [f"{level}, more than gyroscopes do: the columns may be in dps, not rad/s"]
    if noise * sensor.sensitivity > RESOLVED_LSB and noise < QUIET_DPS:
        return None, [f"{level}, less than MEMS gyroscopes have: the columns may be in rad/s, not dps"]
    return ("reads {} dps at its quietest, which is its bias", length), []


def _weightless(sensor: SensorLog) -> str:
    """Return the doubt about an accelerometer in motion whose force averages to zero and often vanishes, as an
    acceleration without gravity does; "" about others.
    """
    forces = np.asarray(sensor.counts[:MOST_COMPARED], float) / sensor.sensitivity
    length = np.linalg.norm(forces, axis=1)
    usual = float(np.median(length))
    is_centred = float(np.linalg.norm(forces.mean(axis=0))) < _CENTRED * min(usual, 1.0)
    if len(forces) < _FEWEST_MOVED or not NO_GRAVITY <= usual < SHAKEN_LEVEL or not is_centred:
        return ""
    if float(np.quantile(length, 0.05)) > _VANISHING * usual:
        return ""
    return (
        f"its force averages to zero and often vanishes (half of its readings are below {usual:.3g} g): gravity may"
        " have been removed (linear acceleration), and the unit may be wrong"
    )


_FEWEST_MOVED = 200
_CENTRED, _VANISHING = 0.3, 0.5
"""Fewest rows for this doubt; largest length of the mean force as a share of the median length and in g, and of the
smallest twentieth of the forces as a share of the median length (0.39 for normal deviates). The length of gravity in a
sensor that turns hardly changes.
"""


def _name_unit(ratio: float, units: Mapping[float, str], most: float = NEAR_FACTOR) -> str:
    """Name the unit with the closest ratio, if any is close."""
    factor = min(units, key=lambda factor: abs(ln(ratio / factor))) if ratio > 0 else 1.0
    near = ratio > 0 and abs(ln(ratio / factor)) < most
    return f"the columns may be in {units[factor]}" if near else ""


def _explain_doubling(ratio: float) -> str:
    """Explain a power of two: ranges of chips differ by powers of two."""
    if ratio <= 0:
        return ""
    power = round(ln(ratio) / ln(2))
    if power == 0 or abs(power) > 5 or abs(ln(ratio / 2.0**power)) > NEAR_FACTOR:
        return ""
    factor = f"{2 ** abs(power)} times too {'small' if power > 0 else 'large'}"
    return f"range and sensitivity may be those of another setting, the counts per g {factor}"


def _shared_times(timing: RowTiming) -> str:
    # Rows of one tick have the same time; the first and the last tick are incomplete.
    rate_hz = timing.period_rows / timing.gap_s if timing.period_rows else timing.rate_hz
    return (
        f"several rows have the same time, and the next time is {timing.gap_s:.3g} s later: the clock is coarse,"
        " or the rows are of several sensors, which kind_column in the map tells apart. If they are of one sensor, its"
        f" rate is {rate_hz:.4g} Hz, and stamps = 'arrival' in the map reconstructs the reading times"
    )


def _missing_rows(sensor: SensorLog, timing: RowTiming) -> str:
    """Describe the rows that are missing between otherwise steady rows; "" if none is missing."""
    gaps = _find_gaps(sensor, timing)
    if not len(gaps):
        return ""
    if len(gaps) > MOST_GAPS * timing.rows:
        share, longer, usual = len(gaps) / timing.rows, float(np.median(gaps)) * timing.usual_s, timing.usual_s
        return (
            f"rows are {1e3 * usual:.3g} ms apart, but {1e3 * longer:.3g} ms in {percent(share)} of the intervals: rows"
            " are missing regularly"
        )
    missing = int(np.sum(np.maximum(np.rint(gaps) - 1, 1)))
    gap_s = float(np.median(gaps)) * timing.usual_s
    length = f"{gap_s:.3g} s" if gap_s >= 1 else f"{1e3 * gap_s:.3g} ms"
    gaps_text, rows_text = counted(len(gaps), "gap"), counted(missing, "row")
    return f"{gaps_text} between rows, {length} in the median: {rows_text} may be missing"


def _find_gaps(sensor: SensorLog, timing: RowTiming) -> npt.NDArray[np.float64]:
    """Return the gaps (k,) in usual intervals: all of at least `GAP`, and shorter ones that a lost row explains.

    A late row makes the next interval shorter, so that three intervals around it take the usual time; a lost row adds
    one interval to all three. If intervals scatter without a grid (a program that sleeps between readings), most sums
    of three are not a whole number of intervals, and no single row is reported as lost.
    """
    long_gaps: list[npt.NDArray[np.float64]] = []
    near_grid, rows = 0, 0
    for block in sensor.blocks():
        begin, end = max(block.start - 2, 0), min(block.stop + 1, len(sensor))
        times = np.asarray(sensor.time[begin:end], np.int64)
        intervals = (times[1:] - times[:-1]) * 1e-9 / timing.usual_s
        padded = np.concatenate([[1.0], intervals, [1.0]])
        three = padded[:-2] + padded[1:-1] + padded[2:]
        off_grid = np.abs(three - np.rint(three))
        near_grid, rows = near_grid + int(np.sum(off_grid < OFF_GRID)), rows + len(three)
        # Each interval belongs to the block of its later row.
        own_rows = slice(max(block.start - 1, 0) - begin, block.stop - 1 - begin)
        is_lost = (intervals > LOST_ROW) & (three > 3 + LOST_ROW - 1) & (off_grid < OFF_GRID)
        long_gaps.append(np.where((intervals > GAP) | is_lost, intervals, 0.0)[own_rows])
    gaps = np.concatenate(long_gaps)
    is_steady = near_grid > STEADY_SHARE * rows
    return gaps[gaps > (0 if is_steady else GAP)]


def _rate(timing: RowTiming) -> Iterator[str]:
    rate_hz = timing.rate_hz
    if timing.rows < FEWEST_ROWS or not rate_hz or RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        return
    factors = {1e3: "a thousand times smaller", 1e6: "a million times smaller", 1e-3: "a thousand times larger"}
    units = [name for factor, name in factors.items() if USUAL_RATES_HZ[0] <= rate_hz * factor <= USUAL_RATES_HZ[1]]
    guess = f": the unit of time may be {units[0]}" if units else ""
    yield f"{rate_hz:.3g} rows a second{guess}"


class _Codes:
    """The codes of a triad's axes, and the repeated rows."""

    def __init__(self, sensor: SensorLog) -> None:
        histograms: list[Histogram] = [NOTHING] * 3
        tally, runs = RepeatTally(), [RunTally() for _ in "xyz"]
        for block in sensor.blocks():
            counts = np.asarray(sensor.counts[block], np.int64)
            histograms = [merged.merge(histogram(column)) for merged, column in zip(histograms, counts.T, strict=True)]
            tally.update(counts)
            for run, column in zip(runs, counts.T, strict=True):
                run.update(column)
        for run in runs:
            run.finish()
        self.runs = runs
        self.are_codes = sensor.attributes.get(RESOLUTION) != ASSUMED
        """False if the counts are values that the import rounded."""
        self.seen, self.repeats = histograms, tally.result()
        self.held = _find_held_rows(sensor, self.repeats)
        """Rows that repeat one reading for longer than chance or a slow chip can explain; an empty slice without
        any.
        """

    @property
    def is_constant(self) -> bool:
        return all(len(codes.codes) == 1 for codes in self.seen)

    def quirks(self) -> Iterator[str]:
        """Yield sentences on properties of the codes that are unusual but not an error."""
        steps = Counter(usual_step(codes) for codes in self.seen if len(codes.codes) > 2)
        step = next(iter(steps)) if len(steps) == 1 else 1
        on_zero = (
            all(bool((codes.codes[np.argmax(codes.counts)] % step) == 0) for codes in self.seen) if step else False
        )
        if step > 1 and self.are_codes:
            yield "only even codes" if step == 2 and on_zero else f"only every {step}th code"
        if self.held.stop == 0 and self.repeats.new_share < 1 - STALE_SHARE:
            yield f"{percent(1 - self.repeats.new_share, 1)} of the rows repeat the previous row without new readings"

    def _find_held_axes(self, sensor: SensorLog) -> Iterator[str]:
        """Yield the axes that stop while others of the triad change; codes at an end of the range are clipped."""
        for axis, run, codes in zip("xyz", self.runs, self.seen, strict=True):
            usual = max(run.next_longest, AXIS_HELD / OTHER_RUNS)
            if len(codes.codes) == 1 or run.longest < max(OTHER_RUNS * usual, AXIS_HELD):
                continue
            if run.longest >= self.repeats.longest * OTHER_RUNS:
                code = int(sensor.counts[run.first_row, "xyz".index(axis)])
                rows = slice(run.first_row, run.first_row + min(run.longest, MOST_COMPARED))
                others = np.delete(np.asarray(sensor.counts[rows]), "xyz".index(axis), axis=1)
                is_coarse = max(len(np.unique(column)) for column in others.T) < OTHER_CODES
                if code not in (int(codes.codes[0]), int(codes.codes[-1])) and not is_coarse:
                    yield _describe_held_axis(sensor, axis, run)

    def doubts(self, sensor: SensorLog) -> Iterator[str]:
        """Yield sentences on impossible properties of the codes."""
        constant = "".join(axis for axis, codes in zip("xyz", self.seen, strict=True) if len(codes.codes) == 1)
        if constant:
            codes = ", ".join(str(int(codes.codes[0])) for codes in self.seen if len(codes.codes) == 1)
            zero = (
                " (rounded to zero, in a smaller unit than stated, or not connected?)"
                if codes.strip("0, ") == ""
                else ""
            )
            yield f"{constant} is always {codes}{zero}"
        if self.held.stop and not self.is_constant:
            yield _describe_held(sensor, self.held)
        yield from self._find_held_axes(sensor)
        yield from find_jumps(sensor)
        limit = OVER_RANGE * sensor.range * sensor.sensitivity
        most = max(int(np.abs(codes.codes[[0, -1]]).max()) for codes in self.seen)
        if limit and most > limit:
            value = most / sensor.sensitivity
            yield f"reads up to {value:.4g} {sensor.unit}, beyond its range of {sensor.range:g}: is the unit wrong?"
        elif sensor.sensitivity and most > MOST[sensor.quantity] * sensor.sensitivity:
            value = most / sensor.sensitivity
            yield f"reads up to {value:.4g} {sensor.unit}, more than any usual chip measures: is the unit wrong?"
        if _are_unsigned(self.seen) and sensor.quantity in INERTIAL:
            yield "all codes are positive on every axis: are they unsigned, with an offset?"


def _find_held_rows(sensor: SensorLog, repeats: Repeats) -> slice:
    """Return the longest run of equal rows if it is not due to chance: other rows seldom repeat, and the rows on either
    side change by at least a count on average, unlike those of a coarse sensor that comes to rest.
    """
    no_rows, other_repeats = slice(0, 0), repeats.rows - repeats.longest
    if repeats.longest < LEAST_HELD or other_repeats < FEWEST_ROWS:
        return no_rows
    usual = max(repeats.repeat_share * (repeats.rows - 1) - (repeats.longest - 1), 1.0) / other_repeats
    if usual >= 1 or repeats.longest * ln(usual) > ln(SURE):
        return no_rows
    begin, end = repeats.longest_row, repeats.longest_row + repeats.longest
    sides = slice(max(begin - BESIDE, 0), begin), slice(end, min(end + BESIDE, repeats.rows))
    changes = [np.abs(np.diff(np.asarray(sensor.counts[side], np.int64), axis=0)).sum(axis=1) for side in sides]
    lively = [float(change.mean()) >= 1 for change in changes if len(change)]
    return slice(begin, end) if lively and all(lively) else no_rows


def _describe_held(sensor: SensorLog, held: slice) -> str:
    first_s, last_s = ((int(sensor.time[row]) - int(sensor.time[0])) * 1e-9 for row in (held.start, held.stop - 1))
    if held.stop == len(sensor):
        return (
            f"repeats one reading from {first_s:.4g} s after the beginning to the end ({held.stop - held.start} of"
            f" {len(sensor)} rows): did it stop?"
        )
    return (
        f"repeats one reading for {last_s - first_s:.3g} s, from {first_s:.4g} s after the beginning"
        f" ({held.stop - held.start} rows): did it stop?"
    )


def _describe_held_axis(sensor: SensorLog, axis: str, run: RunTally) -> str:
    first_s = (int(sensor.time[run.first_row]) - int(sensor.time[0])) * 1e-9
    code = int(sensor.counts[run.first_row, "xyz".index(axis)])
    unit = f" ({code / sensor.sensitivity:.4g} {sensor.unit})" if sensor.sensitivity else ""
    until = " to the end" if run.first_row + run.longest == run.rows else ""
    return (
        f"{axis} stays at {code}{unit} from {first_s:.4g} s after the beginning{until}"
        f" ({run.longest} of {run.rows} rows), while the other axes change: did it stop?"
    )


def _are_unsigned(seen: Sequence[Histogram]) -> bool:
    """Return whether no axis has a negative code, and the usual codes of all axes are near each other. Signed forces
    and rates are on both sides of zero, at least on one axis of three.
    """
    usual = [float(codes.codes[np.searchsorted(np.cumsum(codes.counts), codes.counts.sum() / 2)]) for codes in seen]
    return min(codes.codes[0] for codes in seen) >= 0 and min(usual) > max(LEAST_OFFSET, max(usual) / 2)


def _degrees(sensor: SensorLog) -> tuple[list[str], list[str]]:
    """Return sentences on the readings of a thermometer, and doubts about it."""
    column = sensor.temperature_counts
    if column is None:
        return [], []
    codes = histogram(np.asarray(column[:], np.int64))
    scale = degc_of(sensor)
    if scale is None:
        return [], ["the scale of its thermometer is unknown: state thermometer = { zero_degc, lsb_per_degc }"]
    ends = sorted(scale[0] + scale[1] * float(code) for code in codes.codes[[0, -1]])
    subject = "" if sensor.quantity == "temperature" else "its thermometer "
    span = f"{subject}reads {ends[0]:.4g} to {ends[1]:.4g} degC"
    if has_zero(sensor) and not DEGC[0] <= ends[0] <= ends[1] <= DEGC[1]:
        return [], [f"{span}: is its scale wrong?"]
    step = usual_step(codes)
    return [f"{span}, in steps of {step} counts ({abs(step * scale[1]):.2g} degC)" if step > 1 else span], []


def _directions(log: Log, windows: Mapping[str, _Windows]) -> Iterator[tuple[str, str]]:
    """Yield accelerometers whose direction of gravity differs from that of the first one while both are at rest."""
    forces = _names_of(log, "specific_force", windows)
    for name in forces[1:]:
        first, other = windows[forces[0]], windows[name]
        if first.width_ns != other.width_ns:
            continue
        numbers = np.intersect1d(first.number[first.still()], other.number[other.still()])
        if len(numbers) < FEWEST_RESTS:
            continue
        a, b = (each.mean[np.searchsorted(each.number, numbers)] for each in (first, other))
        lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        cosine = float(np.median(np.sum(a * b, axis=1) / np.maximum(lengths, 1e-12)))
        if cosine < MISALIGNED:
            angle_deg = float(np.degrees(np.arccos(max(cosine, -1.0))))
            yield (
                name,
                f"its gravity is {angle_deg:.0f} degrees from that of {forces[0]}: it is mounted in another direction,"
                " which axes in the map states, or its columns are exchanged",
            )


def _upside_down(log: Log, windows: Mapping[str, _Windows]) -> Iterator[tuple[str, str]]:
    """Yield accelerometers that measure -1 g along an axis whenever they are at rest, unless a phase states this. A
    gyroscope does not determine whether their sign is wrong, because gravity with the opposite sign turns in the same
    way, df/dt = -omega x f; the earth's field does.
    """
    fields = [windows[name] for name in _names_of(log, "magnetic_field", windows)]
    for name in _names_of(log, "specific_force", windows):
        force = windows[name]
        if not force.has_gravity:
            continue
        still = force.still()
        up = force.mean[still] / np.maximum(np.linalg.norm(force.mean[still], axis=1), 1e-9)[:, None]
        middle = np.median(up, axis=0)
        axis = int(np.argmax(np.abs(middle)))
        is_noted = any(phase.up == f"-{'XYZ'[axis]}" for phase in log.phases)
        if is_noted or len(up) < FEWEST_RESTS or middle[axis] > 0 or np.mean(up[:, axis] < -MISALIGNED) < ALWAYS:
            continue
        yield (
            name,
            f"reads -1 g along box {'XYZ'[axis]} whenever it rests: the box is upside down, or this axis points down"
            f" (axes in the map), or the sign is the opposite, as in Apple's CoreMotion (signs = '---')"
            f"{_dip_in_words(force, fields)}",
        )


def _names_of(log: Log, quantity: Quantity, windows: Mapping[str, _Windows]) -> list[str]:
    return [sensor.name for sensor in log.of(quantity) if sensor.name in windows]


def _dip_in_words(force: _Windows, fields: Sequence[_Windows]) -> str:
    """Return what the field of the first magnetometer says about the sign of an accelerometer at rest; "" unless the
    field has the size of the earth's and is steep enough (`LEAST_DIP_DEG`).
    """
    field = next((each for each in fields if each.width_ns == force.width_ns), None)
    if field is None:
        return ""
    numbers = np.intersect1d(force.number[force.still()], field.number)
    f, m = (each.mean[np.searchsorted(each.number, numbers)] for each in (force, field))
    lengths = np.linalg.norm(m, axis=1)
    if not len(m) or not EARTH_GAUSS[0] <= float(np.median(lengths)) <= EARTH_GAUSS[1]:
        return ""
    upward = np.sum(f * m, axis=1) / np.maximum(np.linalg.norm(f, axis=1) * lengths, 1e-9)
    dip_deg = -float(np.degrees(np.arcsin(np.clip(np.median(upward), -1, 1))))
    if abs(dip_deg) < LEAST_DIP_DEG:
        return ""
    hemisphere = "southern" if dip_deg < 0 else "northern"
    return (
        f"; by this sign the magnetic field points {abs(dip_deg):.0f} degrees {'up' if dip_deg < 0 else 'down'}, as it"
        f" does in the {hemisphere} hemisphere"
    )


def _turns(log: Log, windows: Mapping[str, _Windows], short: Mapping[str, _Windows]) -> Iterator[tuple[str, str]]:
    """Yield gyroscopes that disagree with the rotation of gravity in an accelerometer."""
    forces = [name for name in _names_of(log, "specific_force", windows) if windows[name].has_gravity]
    for name in _names_of(log, "angular_rate", windows) if forces else ():
        first = forces[0]
        if (delay := _delay(short[first], short[name])) is not None:
            yield name, delay.sentence(first)
            continue
        pairs = (short[first], short[name]), (windows[first], windows[name])
        candidates = [(_factor(each), each) for pair in pairs if (each := _rotations(*pair)) is not None]
        if not candidates:
            continue
        # Short windows resolve quick turns; in long ones slow turns exceed the noise.
        (factor, correlation), rotations = next((each for each in candidates if each[0][1] >= FOLLOWS), candidates[-1])
        if correlation < FOLLOWS:
            if axes := _fitting_axes(rotations, log[name]):
                yield name, axes
            continue
        if 1 / SAME_SCALE < factor < SAME_SCALE:
            continue
        if factor < 0:
            yield name, "rotates opposite to the accelerometers: axes of one of them are mirrored or exchanged"
            continue
        guess = _name_unit(factor, _TURN_UNITS, NEAR_TURNS) or "range and sensitivity may be those of another setting"
        yield name, f"measures {1 / factor:.3g} times the rotation of gravity in the accelerometers: {guess}"


def radii_of(log: Log) -> dict[str, float]:
    """Return the length of gravity in all directions, in g, of each accelerometer that was turned enough."""
    spheres = {
        sensor.name: fit_sphere(_Windows(sensor, row_timing(sensor)).mean)
        for sensor in log.of("specific_force")
        if len(sensor) >= FEWEST_ROWS and sensor.sensitivity
    }
    return {name: sphere.radius for name, sphere in spheres.items() if sphere is not None}


def turns_of(log: Log) -> float | None:
    """Return the factor by which a log's first gyroscope must be multiplied to agree with the rotation of gravity in
    its first accelerometer; None if it cannot be determined.
    """
    pair = [next(iter(log.of(quantity)), None) for quantity in INERTIAL]
    if any(sensor is None or len(sensor) < FEWEST_ROWS or not sensor.sensitivity for sensor in pair):
        return None
    for window_s in (TURN_WINDOW_S, WINDOW_S):
        force, rate = (_Windows(sensor, row_timing(sensor), window_s=window_s) for sensor in pair if sensor is not None)
        rotations = _rotations(force, rate)
        ratio, correlation = (0.0, 0.0) if rotations is None else _factor(rotations)
        if correlation >= FOLLOWS:
            return ratio
    return None


class _Rotations(NamedTuple):
    """Changes of the direction of gravity (n, 3) between windows of `width_s`, its direction in their middle (n, 3),
    and the gyroscope's rates (n, 3) in rad/s meanwhile.
    """

    turned: Floats
    middle: Floats
    rates: Floats
    width_s: float


def _rotations(force: _Windows, rate: _Windows, late: int = 0, most: int | None = None) -> _Rotations | None:
    """Return the rotations that an accelerometer and a gyroscope measured in the same windows (the first `most` of
    them), if the gyroscope is `late` by that many windows; None if they are too few.
    """
    if force.width_ns != rate.width_ns:
        return None
    both = np.intersect1d(force.number[:most], rate.number[:most] - late, return_indices=True)
    common, force_rows, rate_rows = both
    if len(common) < FEWEST_TURNS:
        return None
    f, omega = force.mean[force_rows], rate.mean[rate_rows] * np.pi / 180
    sphere = fit_sphere(f)
    f = f if sphere is None else f - sphere.centre  # biases of 50 mg would change the rotations by a twentieth
    length = np.linalg.norm(f, axis=1)
    usual = np.median(length)
    f = f / np.maximum(length, 1e-9)[:, None]
    follows = (np.diff(common) == 1) & (np.abs(length[1:] / usual - 1) < 0.2) & (np.abs(length[:-1] / usual - 1) < 0.2)
    turned = np.diff(f, axis=0)[follows]
    rates = _weighted_means(omega, np.diff(common) == 1)[follows]
    middle = (f[1:] + f[:-1])[follows] / 2
    if np.count_nonzero(np.linalg.norm(turned, axis=1) >= TURNED) < FEWEST_TURNS:
        return None
    return _Rotations(turned, middle, rates, force.width_ns * 1e-9)


class _Delay(NamedTuple):
    """The delay in s of a gyroscope against an accelerometer, and their rotations' correlation with and without it."""

    delay_s: float
    with_delay: float
    without: float

    def sentence(self, first: str) -> str:
        """Return the delay against the accelerometer `first` as a sentence."""
        direction = "later" if self.delay_s > 0 else "earlier"
        return (
            f"its rotations come {abs(self.delay_s):.2g} s {direction} than those of {first} (correlation"
            f" {self.with_delay:.2f} with this delay, {self.without:.2f} without): a buffer or another clock shifts the"
            " times of one of them"
        )


def _delay(force: _Windows, rate: _Windows) -> _Delay | None:
    """Return the delay of a gyroscope against an accelerometer, if it is at least `LATE_S` and explains their rotations
    better than none; None otherwise.
    """
    at_once = _rotations(force, rate, most=_MOST_WINDOWS)
    if at_once is None:
        return None
    without = _factor(at_once)[1]
    if without > _IN_TIME:
        return None
    windows = np.arange(-LATE_WINDOWS, LATE_WINDOWS + 1)
    by_delay = [_rotations(force, rate, int(late), _MOST_WINDOWS) for late in windows]
    fits = [(0.0, 0.0) if each is None else _factor(each) for each in by_delay]
    correlations = np.array([correlation if factor > 0 else 0.0 for factor, correlation in fits])
    best = int(np.argmax(correlations))
    if correlations[best] < max(FOLLOWS, without + _LATER_FIT) or not 0 < best < len(windows) - 1:
        return None
    before, at, after = correlations[best - 1 : best + 2]
    bend = before - 2 * at + after
    delay_s = (windows[best] + (0.5 * (before - after) / bend if bend else 0.0)) * force.width_ns * 1e-9
    return _Delay(float(delay_s), float(at), without) if abs(delay_s) >= LATE_S else None


LATE_S = 0.1
"""Least delay in s of a gyroscope against an accelerometer that is reported: filters of chips delay by less."""

LATE_WINDOWS = 16
"""Largest delay that is searched for, in windows of `TURN_WINDOW_S`."""

_MOST_WINDOWS = 1 << 14
"""Number of windows from the beginning, half an hour, in which a delay is searched for."""

_IN_TIME = 0.97
"""Correlation of the rotations above which the delay is small."""

_LATER_FIT = 0.05
"""Least increase of the correlation by a delay."""


def _factor(rotations: _Rotations) -> tuple[float, float]:
    """Return the factor by which the rates must be multiplied to agree with the rotation of gravity, and the
    correlation (0 to 1) of the two.

    A direction f that is constant in an inertial frame changes by -omega x f in a frame that rotates with omega.
    """
    turned, middle, rates, width_s = rotations
    # turned = -factor (rates - bias) x middle, times tan(angle / 2) / (angle / 2) of the angle (Cayley), which is 1.1
    # for 1 rad: linear in the factor and in factor x bias, if the angle is that of the factor before.
    factor, angle = 0.0, np.linalg.norm(rates, axis=1) * width_s
    for _ in range(TURN_PASSES):
        half = np.clip(angle * abs(factor) / 2, 1e-9, MOST_HALF_TURN)
        width = (width_s * np.tan(half) / half)[:, None]
        design = np.empty((len(turned), 3, 4))
        design[:, :, 0] = -np.cross(rates, middle) * width
        for axis in range(3):
            design[:, :, 1 + axis] = np.cross(np.eye(3)[axis], middle) * width
        flat, observed = design.reshape(-1, 4), turned.ravel()
        solution = np.linalg.lstsq(flat, observed, rcond=None)[0]
        factor = float(solution[0])
    a, b = observed - flat[:, 1:] @ solution[1:], flat[:, 0]
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return factor, abs(float(a @ b)) / norm if norm else 0.0


def _fitting_axes(rotations: _Rotations, gyroscope: SensorLog) -> str:
    """Describe a gyroscope that agrees with the rotation of gravity only with other axes; "" if no axes agree."""
    fits = [_factor(rotations._replace(rates=rotations.rates @ turn.T)) for turn in TURNS]
    proper = np.array([correlation if factor > 0 else 0.0 for factor, correlation in fits])
    best, second = np.argsort(-proper)[:2]
    if proper[best] < FITS:
        is_mirrored = max(correlation for _, correlation in fits) >= FITS
        fits_mirrored = "its rotations fit those of the accelerometers only with a mirrored axis"
        return f"{fits_mirrored}: a column or a sign is wrong" if is_mirrored else ""
    axes = axes_text((TURNS[best] @ gyroscope.orientation).T)
    fitting = f", but would with axes = {axes!r}" if proper[best] - proper[second] > BETTER else ""
    return (
        f"its rotations do not fit those of the accelerometers{fitting}: it is mounted in another direction, or columns"
        " are exchanged or a sign is wrong, its own or the accelerometers'"
    )


def _weighted_means(means: Floats, follows: npt.NDArray[np.bool_]) -> Floats:
    """Return the means (n - 1, 3) over pairs of consecutive windows, with a triangular weight on time like the change
    of the window means of an integral, from the means (n, 3) of the windows and from which of them `follows` the one
    before (n - 1,).

    The plain mean of both has a rectangular weight with a variance that is larger by a sixth of a squared window; half
    of that times the second derivative is subtracted if both neighbours are known.
    """
    pairs = (means[1:] + means[:-1]) / 2
    if len(means) < 4:
        return pairs
    inner = (follows[:-2] & follows[1:-1] & follows[2:])[:, None]
    bend = means[:-3] - means[1:-2] - means[2:-1] + means[3:]
    pairs[1:-1] -= np.where(inner, bend / 24, 0.0)
    return pairs


def _twins(log: Log) -> Iterator[tuple[str, str]]:
    """Yield sensors and axes with the same readings."""
    heads = {
        sensor.name: np.asarray(sensor.counts[:FEWEST_ROWS], np.int64)
        for sensor in log.sensors.values()
        if sensor.is_triad and len(sensor) >= FEWEST_ROWS
    }
    names = list(heads)
    for number, name in enumerate(names):
        sensor = log[name]
        for first, second in ((0, 1), (0, 2), (1, 2)):
            head = heads[name]
            if (
                np.ptp(head[:, first])
                and (head[:, first] == head[:, second]).all()
                and _are_same(sensor, sensor, first, second)
            ):
                yield name, f"{'xyz'[first]} and {'xyz'[second]} have the same readings: is a column named twice?"
        for other in names[:number]:
            same = np.ptp(heads[name]) and np.array_equal(heads[name], heads[other])
            if (
                same
                and len(log[other]) == len(sensor)
                and all(_are_same(sensor, log[other], axis, axis) for axis in range(3))
            ):
                yield name, f"has the same readings as {other}: are its columns named twice?"
                break


def _are_same(sensor: SensorLog, other: SensorLog, first: int, second: int) -> bool:
    """Return whether two columns are equal in all rows."""
    return all(
        np.array_equal(np.asarray(sensor.counts[block])[:, first], np.asarray(other.counts[block])[:, second])
        for block in sensor.blocks()
    )
