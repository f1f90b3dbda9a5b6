"""The page of the study: the gain of each technique by experiment, and its distance from the bound, with drawings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.calibrate.start_up import start_up_states
from imuarray.errors import LogError
from imuarray.figures import PALETTE, new_figure
from imuarray.fuse import errors_of, fuse, technique_names
from imuarray.fuse.evaluation import ten_second_means
from imuarray.fuse.fusion import AVERAGE
from imuarray.log import open_log
from imuarray.printable import counted
from imuarray.report import Figure, Section, Table, Verdict, write_page
from imuarray.simulate import write_log
from imuarray.simulate.experiments import EXPERIMENTS as MOTIONS
from imuarray.simulate.experiments import ExperimentOptions
from imuarray.studies.fusion_gain.gain_study import (
    ARRAY,
    ARRAYS,
    CAUSAL,
    EXPERIMENTS,
    FAULTS,
    NO_SLOPES,
    OPTIMAL_CAUSAL,
    RANGES,
    SMOOTHED,
    WORDS,
    GainRow,
    Study,
    calibrate_units,
    differs,
    interval_text,
    is_shown,
    simulate,
)
from imuarray.units import INERTIAL, READABLE_SI

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

    from imuarray.fuse import Ratio


_NEGLIGIBLE = 1e-6
"""Difference in rad/s below which two techniques are drawn as one curve."""


class HeatingErrors(NamedTuple):
    """Time (n,) in s; by technique, ten-second means of the error of the angular rate, minus the first one, (n, 3) in
    rad/s; time and temperature (k,) of the box in s and degC.
    """

    time_s: Floats
    errors: dict[str, Floats]
    temperature: tuple[Floats, Floats]


def simulate_heating(seed: int = 1, seconds: float | None = None) -> HeatingErrors:
    """Return one heating of the paper's array, fused with a calibration without slopes; techniques with the result of
    the average are omitted.
    """
    experiment = EXPERIMENTS["heating"]
    motion = MOTIONS[experiment.motion](ExperimentOptions(seconds=seconds or experiment.seconds))
    results: dict[str, Floats] = {}
    with TemporaryDirectory(prefix="imuarray_study_") as folder:
        path = Path(folder) / "heating.h5"
        write_log(simulate(ARRAYS[ARRAY](), motion, seed, 0, FAULTS), path)
        with open_log(path) as log:
            ranges = {sensor.name: RANGES[sensor.chip] for sensor in log.sensors.values()}
            calibration, _ = start_up_states(log, calibrate_units(ARRAY, seed)[NO_SLOPES], ranges)
            for technique in technique_names():
                time, errors = errors_of(log, fuse(log, calibration, technique))["angular_rate"]
                means = ten_second_means(time, errors)
                if not any(
                    np.allclose(means, means_drawn, rtol=0, atol=_NEGLIGIBLE) for means_drawn in results.values()
                ):
                    results[technique] = means
            truth = log.truth
            if truth is None or truth.temperature is None:
                raise LogError(f"{path}: a simulated log without a truth")
            warm = (truth.time[:] * 1e-9, np.asarray(truth.temperature[:], float))
    time_s: Floats = np.arange(5.0, 10.0 * len(next(iter(results.values()))), 10.0)
    return HeatingErrors(time_s, results, warm)


_MARKERS = "osD^vPX*"


def ratios_figure(panels: Mapping[str, Sequence[GainRow]], ratio_name: str) -> Drawing:
    """Draw a panel for each heading, with a row for each experiment and a mark for each technique: its `over_mean` or
    `over_bound` (`ratio_name`) with its interval.
    """
    figure = new_figure(9.0, 1.6 + 0.62 * max(len({row.experiment for row in rows}) for rows in panels.values()))
    axes_row = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    techniques = list(dict.fromkeys((*technique_names(), OPTIMAL_CAUSAL, CAUSAL, SMOOTHED)))
    for axes, (heading, rows) in zip(axes_row, panels.items(), strict=True):
        _panel(axes, heading, rows, techniques, ratio_name)
    axes_row[0].invert_yaxis()
    handles = [marks for axes in axes_row for marks in zip(*axes.get_legend_handles_labels(), strict=True)]
    result = {label: handle for handle, label in handles}
    named = {technique: result[technique] for technique in techniques if technique in result}
    figure.legend(named.values(), named, loc="outside upper center", ncols=7, frameon=False, fontsize=9)
    words = {"over_mean": "error over that of the simple average", "over_bound": "error over the causal bound"}
    figure.supxlabel(words[ratio_name], fontsize=10)
    return figure


def _panel(axes: Axes, heading: str, rows: Sequence[GainRow], techniques: Sequence[str], ratio_name: str) -> None:
    experiments = list(dict.fromkeys(row.experiment for row in rows))
    for number, technique in enumerate(techniques):
        own_rows = [row for row in rows if row.technique == technique]
        if not own_rows:
            continue
        places = [
            experiments.index(row.experiment) + 0.7 * ((number + 0.5) / len(techniques) - 0.5) for row in own_rows
        ]
        ratios = [ratio for row in own_rows if (ratio := getattr(row, ratio_name)) is not None]
        colour = PALETTE[number % len(PALETTE)]
        axes.errorbar(
            [ratio.ratio for ratio in ratios], places, xerr=_reach(ratios), fmt=_MARKERS[number % len(_MARKERS)],
            color=colour, markersize=5, elinewidth=1.2, capsize=2, label=technique,
        )  # fmt: skip
        _mark_beyond(axes, ratios, places, colour)
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_xlim(0, _furthest([ratio for row in rows if (ratio := getattr(row, ratio_name)) is not None]))
    axes.set_yticks(range(len(experiments)), experiments)
    axes.set_title(heading, fontsize=10)
    axes.grid(axis="x", linewidth=0.4, alpha=0.6)


_BEYOND = 3.0
"""Limit of an interval in multiples of the largest ratio. Longer intervals are cut off there, because an interval from
few seeds can be very long.
"""


_MOST_RATIO = 4.0
"""Largest ratio that is drawn to scale. A larger one is drawn as an arrow with its value at the edge, because it would
compress all others.
"""


def _mark_beyond(axes: Axes, ratios: Sequence[Ratio], places: Sequence[float], colour: str) -> None:
    """Draw an arrow at the right edge, and the number, for each ratio above `_MOST_RATIO`."""
    for ratio, place in zip(ratios, places, strict=True):
        if ratio.ratio > _MOST_RATIO:
            across = axes.get_yaxis_transform()
            axes.plot([0.985], [place], ">", color=colour, markersize=6, transform=across, clip_on=False)
            text = f"{ratio.ratio:.3g} ×"
            axes.text(0.95, place, text, fontsize=8, ha="right", va="bottom", transform=across)


def _furthest(ratios: Sequence[Ratio]) -> float:
    """Return the right end of an axis with all ratios up to `_MOST_RATIO`, and their intervals up to `_BEYOND`."""
    visible = [ratio for ratio in ratios if ratio.ratio <= _MOST_RATIO]
    largest = max((ratio.ratio for ratio in visible), default=1.0)
    ends = [min(ratio.high, _BEYOND * largest, _MOST_RATIO) for ratio in visible if np.isfinite(ratio.high)]
    return 1.05 * max(1.0, largest, *ends)


def _reach(ratios: Sequence[Ratio]) -> Floats:
    """Return the lengths (2, n) of intervals to both sides; nan without an interval."""
    low = [ratio.ratio - ratio.low for ratio in ratios]
    high = [ratio.high - ratio.ratio for ratio in ratios]
    return np.asarray(np.maximum(np.nan_to_num(np.array([low, high])), 0.0))


def heating_figure(
    time_s: Floats, curves: Mapping[str, Sequence[Floats]], temperature: tuple[Floats, Floats], unit: str
) -> Drawing:
    """Draw ten-second means of the errors along box X, Y and Z of some techniques (three (n,) each), and the
    temperature.
    """
    figure = new_figure(9.0, 7.0)
    axes_column = figure.subplots(4, 1, sharex=True, height_ratios=(3, 3, 3, 2))
    for axis, axes in enumerate(axes_column[:3]):
        for number, (technique, values) in enumerate(curves.items()):
            colour = PALETTE[number % len(PALETTE)]
            axes.plot(time_s, values[axis], color=colour, linewidth=1.6, label=technique)
        axes.axhline(0, color="black", linewidth=0.6)
        axes.set_ylabel(f"box {'XYZ'[axis]} ({unit})")
    axes_column[0].legend(frameon=False, fontsize=9, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    axes_column[3].plot(*temperature, color=PALETTE[2], linewidth=1.2)
    axes_column[3].set_ylabel("°C")
    axes_column[3].set_xlabel("time (s)")
    return figure


def drawings_of(study: Study, warm: HeatingErrors | None) -> dict[str, Drawing]:
    """Return the figures that have rows, by file name; MissingExtraError without matplotlib."""
    vectors = [row for row in study.of(measure="rms", box_axis="XYZ", calibration="measured") if differs(row)]
    bounded = study.of(measure="rms", box_axis="XYZ", calibration="true")
    bounded = [row for row in bounded if row.technique != SMOOTHED and is_shown(row)]
    ends = [row for row in study.of(calibration="measured", quantity="") if differs(row)]
    panels = {
        "ratios.png": (_group_by_sensors(vectors), "over_mean"),
        "bound.png": (_group_by_sensors(bounded), "over_bound"),
        "coasting.png": (
            {name: [r for r in ends if r.measure == name] for name in ("heading", "velocity")},
            "over_mean",
        ),
    }
    drawings = {
        name: ratios_figure({heading: rows for heading, rows in panel_rows.items() if rows}, ratio_name)
        for name, (panel_rows, ratio_name) in panels.items()
        if any(panel_rows.values())
    }
    if warm is not None:
        factor, unit = READABLE_SI["angular_rate"]
        curves = {name: list(factor * errors.T) for name, errors in warm.errors.items()}
        drawings["heating.png"] = heating_figure(warm.time_s, curves, warm.temperature, unit)
    return drawings


def _group_by_sensors(rows: Sequence[GainRow]) -> dict[str, list[GainRow]]:
    """Return a panel for each quantity of each set of sensors."""
    keys = dict.fromkeys((row.sensors, row.quantity) for row in rows)
    return {
        f"{sensors}: {quantity.replace('_', ' ')}": [
            row for row in rows if (row.sensors, row.quantity) == (sensors, quantity)
        ]
        for sensors, quantity in keys
    }


_SEE = {
    "ratios.png": (
        "Gain with calibrations from logs: left of the line, the technique is better than the simple average of the"
        " same sensors. Bars are 95 % intervals over the seeds; techniques that change nothing are not drawn.",
        "Ratios of the error of each technique to that of the average, by experiment",
    ),
    "bound.png": (
        "Errors divided by the causal bound, the smallest error that any estimator of past readings can have, if the"
        " model of the errors is right; 1 is the best possible. optimal uses the whole log, the others only the past."
        " bound, causal is the posterior mean, which reaches the bound.",
        "Ratios of the error of each technique to the bound, by experiment",
    ),
    "coasting.png": (
        "Heading and horizontal velocity after coasting for a minute; the mean error of ten seconds at rest is"
        " subtracted first. An arrow stands for more than four times the error of the average. A bar that reaches the"
        " edge continues beyond it, because few seeds give long intervals.",
        "Ratios of heading and velocity errors to those of the average, by experiment",
    ),
    "heating.png": (
        "Ten-second means of the angular rate's error less the first of them, one seed, while the box is heated by 28"
        " degrees and the calibration knows no slopes.",
        "Drift of the average and of the techniques that differ from it about three axes while the box is heated",
    ),
}


def write_study_page(
    path: str | PathLike[str], study: Study, drawings: Mapping[str, Drawing], *, force: bool = False
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
        *(_section(study, experiment) for experiment in dict.fromkeys(row.experiment for row in study.rows)),
    ]
    write_page(path, "What fusion gains", summary(study), sections, verdict=study_verdict(study), force=force)


def study_verdict(study: Study) -> Verdict:
    """Return the verdict: the technique with the largest gain, and the largest gain of each."""
    best = sorted(_best_rows(study).values(), key=lambda row: row.over_mean.ratio)
    if not best:
        return Verdict("No technique was compared with the simple average.")
    first = best[0]
    place = f"{first.experiment}, {first.sensors}, {first.quantity.replace('_', ' ')}"
    sure = bool(first.over_mean.high < 1)
    times = f"{first.over_mean.ratio:.2f} times that of the simple average"
    sentence = f"The technique {first.technique} gains most: at best, its error is {times} ({place})."
    if not sure:
        sentence = "No technique is better than the simple average beyond chance."
    figures = tuple((f"{row.over_mean.ratio:.2f} ×", f"{row.technique} at best: {row.experiment}") for row in best[:5])
    return Verdict(sentence, "good" if sure else "doubtful", figures)


def summary(study: Study) -> list[str]:
    """Return the summary: each technique in its best case, and the distance of the best one from the bound."""
    lines = []
    for technique, best in _best_rows(study).items():
        place = f"{best.experiment}, {best.sensors}, {best.quantity.replace('_', ' ')}"
        lines.append(f"{technique}: at best {interval_text(best.over_mean)} times the average's error ({place})")
    lines.append(f"seeds {study.seeds[0]} to {study.seeds[-1]}; intervals are 95 %, over the seeds")
    return lines


def _best_rows(study: Study) -> dict[str, GainRow]:
    """Return the row with the largest gain of each technique."""
    vectors = [
        row for row in study.of(measure="rms", box_axis="XYZ", calibration="measured") if row.technique != AVERAGE
    ]
    return {
        technique: min((row for row in vectors if row.technique == technique), key=lambda row: row.over_mean.ratio)
        for technique in dict.fromkeys(row.technique for row in vectors)
    }


def _section(study: Study, experiment: str) -> Section:
    rows = study.of(experiment=experiment)
    tables = []
    for calibration in dict.fromkeys(row.calibration for row in rows):
        lines = [
            _line(row) for row in rows if row.calibration == calibration and row.measure != "noise" and is_shown(row)
        ]
        heading = ["technique", "sensors", "what", "axis", "value", "unit", "over the average", "over the bound"]
        tables.append(Table(heading, lines, f"{experiment}: {WORDS[calibration]}.", (1, 2, 3, 5)))
    count = sum(len(table.rows) for table in tables)
    words = "Every technique that changes something, axis by axis."
    return Section(experiment, words, tables, fold=f"{count} rows in {counted(len(tables), 'table')}")


def _line(row: GainRow) -> list[str]:
    factor, unit = READABLE_SI[row.quantity] if row.quantity in INERTIAL else (1.0, _END_UNITS[row.measure])
    over_bound = "" if row.over_bound is None else interval_text(row.over_bound)
    subject = f"{row.quantity.replace('_', ' ')} {row.measure}".strip()
    is_lost = row.measure == "heading" and row.value > _LOST_DEG
    value = f"{factor * row.value:.4g}" + (" (lost)" if is_lost else "")
    return [row.technique, row.sensors, subject, row.box_axis, value, unit, interval_text(row.over_mean), over_bound]


_LOST_DEG = 60.0
"""Root mean square error in degrees from which on a heading counts as unknown; that of a random heading is 104 degrees.
"""

_END_UNITS = {"heading": "deg", "velocity": "m/s"}
