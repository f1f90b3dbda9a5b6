"""Propose a map of a recording, with doubts as comments, for a person to edit.

The proposal (`imuarray.importers.source_proposal`) is tested by an import (`imuarray.importers.table`): the doubts in
its report become comments, and a unit or scale that the recording contradicts is corrected.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import log as ln
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imuarray.errors import ImuArrayError
from imuarray.importers.column_names import COMPUTED, TRUTH
from imuarray.importers.mapping import UNIT_UNKNOWN
from imuarray.importers.mimu4444 import is_recording
from imuarray.importers.plausibility import radii_of, report_of, turns_of
from imuarray.importers.proposal import (
    COUNTS_OF_GYROSCOPE,
    UNIT_MG,
    UNIT_MILLI,
    UNKNOWN_RATE,
    Item,
    Proposal,
    is_in_mg,
)
from imuarray.importers.resolution import MOST_BITS, SENSITIVITIES, WIDE_SENSITIVITIES
from imuarray.importers.source_proposal import propose_map
from imuarray.importers.table import import_table
from imuarray.log import Log, open_log
from imuarray.printable import percent
from imuarray.units import UNITS_OF

_MIMU4444 = 'file = { format = "mimu4444" }'

_SAME_SCALE = 0.25
"""Largest log ratio between the rotation of gravity and that by a gyroscope, due to quick motion, at which a guessed
sensitivity is kept.
"""
_NEAR_UNIT = 0.3
"""Greatest log ratio between the rotation of gravity and that by a gyroscope at which a unit explains it."""


def guess_map(source: str | Path) -> str:
    """Return a map of the recording `source` as TOML text; SourceError if no map can describe it."""
    path = Path(source)
    if path.is_file() and is_recording(path):
        return f"# Map of {path.name}: packets of a MIMU4444 board, which say the rest.\n{_MIMU4444}\n"
    proposal = propose_map(path)
    _leave_out_computed(proposal)
    if proposal.layout.parts and (why := _why_parts_are_apart(proposal, path)):
        proposal = propose_map(path, join_parts=False)
        proposal.doubts[-1] += f" ({why})"
        _leave_out_computed(proposal)
    head = [f"Proposed map of {path.name}: check and correct it, and enter chips, axes and ranges."]
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused and not any(line.startswith(("rate_hz", "wraps_at")) for line in proposal.time):
        trial = _try_sorted(proposal, path) or _try_restarts(proposal, path) or trial
    if _leave_out_weightless(proposal, trial.doubts):
        trial = _try_import(proposal.text([]), path)
    if _correct_milli(proposal, trial.radii):
        trial = _try_import(proposal.text([]), path)
    is_corrected = trial.factor is not None and _correct_scale(proposal, trial.factor)
    if is_corrected or _correct_quiet_unit(proposal, trial):
        trial = _try_import(proposal.text([]), path)
    if trial.factor is not None and _correct_rate(proposal, trial.factor):
        trial = _try_import(proposal.text([]), path)
    proposal.remarks += [text for text in trial.remarks if text not in proposal.remarks]
    proposal.doubts += [text for text in trial.doubts if text not in proposal.doubts]
    if trial.factor is None and not trial.is_refused:
        proposal.doubts += _assumed_scales(proposal)
    return proposal.text(head)


def _assumed_scales(proposal: Proposal) -> Iterator[str]:
    """Yield a doubt about each gyroscope of assumed unit or scale, if no rotations of the recording determine it."""
    for item in filter(_is_gyroscope, proposal.items):
        if item.is_guess("sensitivity"):
            per_dps = item.line("sensitivity").split()[2]
            yield (
                f"{item.name}: {per_dps} counts per dps are assumed, as no rotation shows the scale: enter sensitivity"
                " and range of its setting"
            )
        elif item.is_guess("unit") and UNIT_UNKNOWN in item.line("unit"):
            yield f"{item.name}: {item.text('unit')} is assumed, as no rotation shows the unit: dps or rad/s?"


class _Trial(NamedTuple):
    """An import with a proposed map: its remarks, its doubts, the error factor of the gyroscope's scale (None if
    unknown), the least interval of rows as a share of the usual one, and the longest as a share of the recording;
    the `radii` of gravity in all directions by accelerometer, in g.
    """

    remarks: list[str]
    doubts: list[str]
    factor: float | None = None
    least_interval: float = 0.0
    longest_gap: float = 0.0
    is_refused: bool = False
    radii: Mapping[str, float] = MappingProxyType({})


def _why_parts_are_apart(proposal: Proposal, path: Path) -> str:
    """Return the reason why files cannot be parts of one recording (their rows are not consecutive); "" if they can."""
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused:
        where = f"{str(path).lstrip('/')}/"
        return trial.doubts[0].removeprefix("cannot be imported as it is: ").removeprefix(where)
    if trial.longest_gap > _BETWEEN_PARTS:
        return f"joined, they would have a gap of {percent(trial.longest_gap)} of their time"
    return ""


_BETWEEN_PARTS = 0.01
"""Longest gap between joined parts, as a share of their time: a recorder that begins a new file loses a few rows."""

_FITTING = 0.5
"""Least interval of sorted rows, as a share of the usual one, at which late rows fit between the others. Rows are
closer together if the clock was set back or time stamps of arrival are too early.
"""


def _try_sorted(proposal: Proposal, path: Path) -> _Trial | None:
    """Add `sort = true` to the proposal if rows are late and fit between the others; None if sorting does not help."""
    line = "sort = true   # rows are out of order, and fit between the others"
    proposal.time.append(line)
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused or trial.least_interval < _FITTING or trial.longest_gap > _OPENED:
        proposal.time.remove(line)
        return None
    return trial


def _try_restarts(proposal: Proposal, path: Path) -> _Trial | None:
    """Add `restarts = true` to the proposal, if the recording can be imported then."""
    line = "restarts = true   # ? the clock was set back, or started again"
    proposal.time.append(line)
    trial = _try_import(proposal.text([]), path)
    if trial.is_refused:
        proposal.time.remove(line)
        return None
    proposal.doubts.append(
        "the times go back: the clock was set back, or the recorder restarted. If the file holds several"
        " recordings, import them one by one"
    )
    return trial


_OPENED = 0.25
"""Longest interval of sorted rows, as a share of the recording, up to which they are considered late. If the clock was
set back, sorting puts the rest of the recording before its beginning.
"""


def _extreme_intervals(log: Log) -> tuple[float, float]:
    """Return the shortest interval between rows of any sensor, as a share of its median interval, and the longest, as a
    share of the time of all its rows.
    """
    shortest, longest = [], []
    for sensor in log.sensors.values():
        intervals = [np.diff(np.asarray(sensor.time[block.start : block.stop + 1])) for block in sensor.blocks()]
        steps = np.concatenate([np.zeros(0), *intervals])
        if len(steps):
            shortest.append(float(steps.min() / max(np.median(steps), 1.0)))
            longest.append(float(steps.max() / max(steps.sum(), 1.0)))
    return min(shortest, default=1.0), max(longest, default=0.0)


def _try_import(text: str, path: Path) -> _Trial:
    with TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "map.toml").write_text(text, encoding="utf-8")
        try:
            summary = import_table(path, place / "map.toml", place / "run.h5")
            with open_log(place / "run.h5") as log:
                report = report_of(log)
                remarks = [*summary.remarks, *report.quirks]
                trial = _Trial(remarks, list(report.doubts), turns_of(log), *_extreme_intervals(log))
                return trial._replace(radii=radii_of(log))
        except ImuArrayError as error:
            return _Trial(
                [], [f"cannot be imported as it is: {str(error).replace(folder, '').lstrip('/')}"], is_refused=True
            )


def _label(item: Item) -> str:
    """Return the name of the rows of a sensor: their kind, or the sensor's name in the map."""
    return item.text("kind") or item.name


def _leave_out(proposal: Proposal, items: Sequence[Item], why: str) -> bool:
    """Remove sensors from a proposal and add a doubt that states this; return whether there were any."""
    if items:
        proposal.doubts.append(f"left out: {', '.join(map(_label, items))}: {why}")
        proposal.items = [item for item in proposal.items if not any(item is other for other in items)]
    return bool(items)


def _leave_out_computed(proposal: Proposal) -> None:
    """Remove triads that would be imported as additional sensors: a truth or reference recorded with the sensors, and
    triads that software computed from others of the recording. These are gravity, accelerations without gravity, and
    readings less an estimated bias if the recording also has the readings of the chip.
    """
    known = [item for item in proposal.items if TRUTH.search(_label(item))]
    if len(known) < len(proposal.items):
        _leave_out(proposal, known, "a truth or a reference, according to their names, not sensors of the array")
    triads = [item for item in proposal.items if item[0] == "[[sensor]]"]
    forces = [item for item in triads if item.text("quantity") == "specific_force"]
    computed = [item for item in forces if COMPUTED.search(_label(item))]
    if len(computed) < len(forces):
        _leave_out(proposal, computed, "computed by software, according to their names")
    labels = {_label(item).lower() for item in triads}
    corrected = [
        item for item in triads if any(f"{_label(item)}{mark}uncalibrated".lower() in labels for mark in ("", "_", " "))
    ]
    _leave_out(proposal, corrected, "the same chip's uncalibrated readings are kept, whose bias does not jump")


def _leave_out_weightless(proposal: Proposal, doubts: Sequence[str]) -> bool:
    """Remove accelerometers that do not measure 1 g, because a program subtracted gravity. If no other sensor measures
    gravity, they stay in the map as comments, with the attitude by which gravity can be added again. An accelerometer
    that is the only sensor is kept.
    """
    forces = [item for item in proposal.items if item.text("quantity") == "specific_force"]
    names = [item.name for item in forces]
    doubted = [
        any(text.startswith(f"{name}: measures ") and "instead of 1 g" in text for text in doubts) for name in names
    ]
    weightless = [item for item, is_doubted in zip(forces, doubted, strict=True) if is_doubted]
    if not all(doubted):
        return _leave_out(proposal, weightless, "no gravity in it, while another accelerometer of the recording has it")
    doubt = {name: next(text for text in doubts if text.startswith(f"{name}: measures ")) for name in names}
    subtracted = [
        item
        for item, name in zip(forces, names, strict=True)
        if _SUBTRACTED in doubt[name]
        and (proposal.attitudes or _is_called_computed(item) or _NO_UNIT_EXPLAINS in doubt[name])
    ]
    for item in subtracted:
        item += proposal.attitude_lines(is_comment=len(subtracted) == len(proposal.items))
    if len(subtracted) == len(proposal.items):
        return False
    proposal.asides += subtracted
    return _leave_out(
        proposal,
        subtracted,
        "a linear acceleration: a program subtracted gravity, so it is not a measurement; the map contains it as a"
        f" comment{', with the attitude that adds gravity again' if proposal.attitudes else ''}",
    )


_SUBTRACTED, _NO_UNIT_EXPLAINS = "gravity may have been removed", "or the unit may be wrong"
"""Phrases of a report on a sensor without gravity: the first always, the second if the size of its readings does not
agree with another unit.
"""


def _is_called_computed(item: Item) -> bool:
    """Return whether the names of a sensor's rows or columns state that a program computed them."""
    return any(COMPUTED.search(item.line(key)) for key in ("kind", "columns"))


def _correct_milli(proposal: Proposal, radii: Mapping[str, float]) -> bool:
    """Replace 1024 counts per g, guessed from a single direction of gravity, by mg, if gravity in all directions agrees
    with mg, or if gravity in this direction does and the gyroscope is in mdps; otherwise add a doubt if mg are as near.
    """
    changed = False
    has_milli = any(_is_gyroscope(item) and item.text("unit") == "mdps" for item in proposal.items)
    for item in proposal.items:
        if not item.line("sensitivity").startswith("sensitivity = 1024 "):
            continue
        length = 1024 * radii.get(item.name, 0.0)
        along = float(item.line("sensitivity").rpartition(": ")[2].split()[0])
        if (length and is_in_mg(length)) or (not length and has_milli and is_in_mg(along)):
            item.leave_out("range", "sensitivity", "unit")
            item.append(UNIT_MG.format(length) if length else UNIT_MILLI.format(along))
            changed = True
        elif not length and is_in_mg(along):
            proposal.doubts.append(
                f"{item.name}: gravity is {along:.5g}: 1024 counts per g are assumed; if the columns are in mg, replace"
                ' unit, range and sensitivity by unit = "mg"'
            )
    return changed


def _correct_scale(proposal: Proposal, factor: float) -> bool:
    """Replace the guessed unit or sensitivity of a gyroscope by one that is known, if it fits."""
    if factor <= 0:
        return False
    for item in filter(_is_gyroscope, proposal.items):
        if _correct_unit(item, factor):
            return True
        if not item.is_guess("sensitivity") or abs(ln(factor)) < _SAME_SCALE:
            continue
        sensitivity = COUNTS_OF_GYROSCOPE / factor
        units = {1 / size: unit for unit, size in UNITS_OF["angular_rate"].items() if unit.startswith("m")}
        nearest = min([*SENSITIVITIES["angular_rate"], *units], key=lambda scale: abs(ln(scale / sensitivity)))
        if nearest == COUNTS_OF_GYROSCOPE:
            return False
        if nearest in units:  # the values are whole numbers in a small unit
            item.leave_out("range", "sensitivity")
            item.replace("unit", f'unit = "{units[nearest]}"   {_BY_GRAVITY}')
            return True
        item.replace("sensitivity", f"sensitivity = {nearest:.6g}   {_BY_GRAVITY}")
        item.replace("range", f"range = {round(32768 / nearest / 5) * 5}   # ? of 16 bits")
        return True
    return False


_BY_GRAVITY = "# ? from the rotation of gravity in the accelerometer"


_RATES_HZ = (
    10, 12.5, 20, 25, 26, 30, 32, 40, 50, 52, 60, 64, 75, 100, 104, 120, 125, 128, 200, 208, 250, 256, 400, 416, 500,
    512, 800, 1000,
)  # fmt: skip
"""Usual rates of recordings."""
_NEAR_RATE = 0.05
_KNOWN_RATE = 0.1
"""Largest log ratio to a usual rate that is replaced by it, and to the assumed rate that is not corrected."""


def _correct_rate(proposal: Proposal, factor: float) -> bool:
    """Replace an assumed rate of rows by the rate at which the gyroscope agrees with the rotation of gravity."""
    line = next((line for line in proposal.time if line == UNKNOWN_RATE), None)
    if line is None or factor <= 0 or abs(ln(factor)) < _KNOWN_RATE:
        return False
    rate_hz = turning_hz = 100 / factor
    nearest = min(_RATES_HZ, key=lambda usual: abs(ln(usual / rate_hz)))
    rate_hz = nearest if abs(ln(nearest / rate_hz)) < _NEAR_RATE else float(f"{rate_hz:.3g}")
    proposal.time[proposal.time.index(line)] = (
        f"rate_hz = {rate_hz:g}   # ? at {turning_hz:.4g} rows a second the gyroscope turns as gravity does"
    )
    proposal.doubts = [
        text.replace("100 rows a second are assumed", "the rate is that at which the gyroscope turns as gravity does")
        for text in proposal.doubts
    ]
    return True


def _is_gyroscope(item: Item) -> bool:
    return item.text("quantity") == "angular_rate"


def _has_guessed_unit(item: Item) -> bool:
    """Return whether the values of a sensor are in a guessed unit and are not counts."""
    return item.is_guess("unit") and not item.line("sensitivity")


def _correct_quiet_unit(proposal: Proposal, trial: _Trial) -> bool:
    """Replace dps by rad/s for gyroscopes with less noise in dps than any gyroscope has, and the reverse."""
    changed = False
    for item in proposal.items:
        guessed = item.text("unit")
        quiet = {"dps": "rad/s", "rad/s": "dps"}.get(guessed)
        if quiet is None or not _is_gyroscope(item) or not _has_guessed_unit(item):
            continue
        doubt = f"the columns may be in {quiet}, not {guessed}"
        if any(text.startswith(f"{item.name}: ") and text.endswith(doubt) for text in trial.doubts):
            item.replace("unit", f'unit = "{quiet}"   # ? from the noise at rest')
            changed = True
    return changed


def _correct_unit(item: Item, factor: float) -> bool:
    """Replace the guessed unit of a gyroscope's values by the unit that agrees with the factor, if any; or by the scale
    of codes of more than 16 bits, if one from a data sheet agrees.
    """
    if not _has_guessed_unit(item):
        return False
    units = UNITS_OF["angular_rate"]
    guessed = item.text("unit")
    true_size = factor * units[guessed]
    nearest = min(units, key=lambda unit: abs(ln(units[unit] / true_size)))
    if abs(ln(units[nearest] / true_size)) <= _NEAR_UNIT:
        if units[nearest] == units[guessed]:
            return False
        item.replace("unit", f'unit = "{nearest}"   {_BY_GRAVITY}')
        return True
    sensitivity = min(WIDE_SENSITIVITIES["angular_rate"], key=lambda sensitivity: abs(ln(sensitivity * true_size)))
    if abs(ln(sensitivity * true_size)) > _NEAR_UNIT:
        return False
    item.replace("unit", 'unit = "dps"')
    item.append(f"range = {(1 << MOST_BITS - 1) / sensitivity:.6g}   # ? of {MOST_BITS} bits")
    item.append(f"sensitivity = {sensitivity:.9g}   {_BY_GRAVITY}")
    return True
