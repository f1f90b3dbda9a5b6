"""The study as a page: what each technique gains, where, and how far it is from the bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING

from imuarray.fuse.fuse import AVERAGE
from imuarray.report import Figure, Section, Table, write_page
from imuarray.study.figures import heating_figure, ratios_figure
from imuarray.study.runs import SMOOTHED
from imuarray.study.study import Row, Study
from imuarray.study.text import WORDS, changed, interval_text
from imuarray.units import INERTIAL, READABLE_SI

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from imuarray.study.heated import Heated


def drawings_of(found: Study, warm: Heated | None) -> dict[str, Drawing]:
    """By file name, as many as there are rows for; MissingExtraError without matplotlib."""
    vectors = [row for row in found.of(measure="rms", box_axis="XYZ", calibration="measured") if changed(row)]
    bounded = found.of(measure="rms", box_axis="XYZ", calibration="true")
    bounded = [row for row in bounded if row.technique != SMOOTHED and (row.technique == AVERAGE or changed(row))]
    ends = [row for row in found.of(calibration="measured", quantity="") if changed(row)]
    panels = {
        "ratios.png": (_by_sensors(vectors), "over_mean"),
        "bound.png": (_by_sensors(bounded), "over_bound"),
        "coasting.png": (
            {name: [r for r in ends if r.measure == name] for name in ("heading", "velocity")},
            "over_mean",
        ),
    }
    drawn = {
        name: ratios_figure({heading: rows for heading, rows in chosen.items() if rows}, of)
        for name, (chosen, of) in panels.items()
        if any(chosen.values())
    }
    if warm is not None:
        factor, unit = READABLE_SI["angular_rate"]
        curves = {name: list(factor * errors.T) for name, errors in warm.errors.items()}
        drawn["heating.png"] = heating_figure(warm.time_s, curves, warm.temperature, unit)
    return drawn


def _by_sensors(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """A panel for each quantity of each set of sensors."""
    keys = dict.fromkeys((row.sensors, row.quantity) for row in rows)
    return {
        f"{sensors}: {quantity.replace('_', ' ')}": [
            row for row in rows if (row.sensors, row.quantity) == (sensors, quantity)
        ]
        for sensors, quantity in keys
    }


_SEE = {
    "ratios.png": (
        "What techniques gain with calibrations from logs: left of the line is better than the simple average of the"
        " same sensors. Bars are 95 % intervals over the seeds; what changes nothing is not drawn.",
        "Ratios of the error of each technique to that of the average, by experiment",
    ),
    "bound.png": (
        "Where the model is right, over the least error that any estimator can have: 1 is all that the readings hold."
        " optimal sees the whole log, the others what came before. The posterior mean (bound, causal) shows that it can"
        " be had.",
        "Ratios of the error of each technique to the bound, by experiment",
    ),
    "coasting.png": (
        "Heading and horizontal velocity after coasting for a minute; mean errors of ten seconds at rest are taken out."
        "",
        "Ratios of heading and velocity errors to those of the average, by experiment",
    ),
    "heating.png": (
        "Ten-second means of the angular rate's error less the first of them, one seed, while the box is heated by 28"
        " degrees and the calibration knows no slopes.",
        "Drift of the average and of the techniques that differ from it about three axes while the box is heated",
    ),
}


def write_study_page(
    path: str | PathLike[str], found: Study, drawings: Mapping[str, Drawing], *, force: bool = False
) -> None:
    """Write the page; OutputExistsError, OutputError, MissingExtraError without jinja2."""
    figures = [Figure(drawing, *_SEE[name]) for name, drawing in drawings.items()]
    sections = [
        Section(
            "At a glance",
            "Simulated experiments of the paper's array, each with several seeds. An error is the length of its vector,"
            " root mean square over all frames.",
            figures,
        ),
        *(_section(found, experiment) for experiment in dict.fromkeys(row.experiment for row in found.rows)),
    ]
    write_page(path, "What fusion gains", summary(found), sections, force=force)


def summary(found: Study) -> list[str]:
    """What a person should know after half a minute: each technique where it gains most, and how far the best is from
    the bound.
    """
    vectors = [
        row for row in found.of(measure="rms", box_axis="XYZ", calibration="measured") if row.technique != AVERAGE
    ]
    lines = []
    for technique in dict.fromkeys(row.technique for row in vectors):
        best = min((row for row in vectors if row.technique == technique), key=lambda row: row.over_mean.ratio)
        where = f"{best.experiment}, {best.sensors}, {best.quantity.replace('_', ' ')}"
        lines.append(f"{technique}: at best {interval_text(best.over_mean)} times the average's error ({where})")
    lines.append(f"seeds {found.seeds[0]} to {found.seeds[-1]}; intervals are 95 %, over the seeds")
    return lines


def _section(found: Study, experiment: str) -> Section:
    rows = found.of(experiment=experiment)
    tables = []
    for calibration in dict.fromkeys(row.calibration for row in rows):
        lines = [_line(row) for row in rows if row.calibration == calibration and _is_told(row)]
        heading = ["technique", "sensors", "what", "axis", "value", "unit", "over the average", "over the bound"]
        tables.append(Table(heading, lines, f"{experiment}: {WORDS[calibration]}.", (1, 2, 3, 5)))
    return Section(experiment, "Every technique that changes something, axis by axis.", tables)


def _is_told(row: Row) -> bool:
    return row.measure != "noise" and (row.technique == AVERAGE or changed(row))


def _line(row: Row) -> list[str]:
    factor, unit = READABLE_SI[row.quantity] if row.quantity in INERTIAL else (1.0, _END_UNITS[row.measure])
    over_bound = "" if row.over_bound is None else interval_text(row.over_bound)
    what = f"{row.quantity.replace('_', ' ')} {row.measure}".strip()
    value = f"{factor * row.value:.4g}"
    return [row.technique, row.sensors, what, row.box_axis, value, unit, interval_text(row.over_mean), over_bound]


_END_UNITS = {"heading": "deg", "velocity": "m/s"}
