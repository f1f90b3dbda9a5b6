"""`imuarray demo`: the whole path on the emulated array, from the bus to a page.

It records four runs that need only a box, a table and a hair dryer: the six faces of the box, a long rest, a heating,
and a shaking that exceeds the low range. The first run calibrates the array; the others show the gain of each technique
over the simple average of the same sensors. The emulated world provides the truth, so every gain can be measured.
Finally, `gap` compares three sensors at rest with a simulator of the data sheets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imuarray import analysis
from imuarray.arrays import Reals
from imuarray.calibrate import Calibration, TumbleResult, calibrate_noise, calibrate_tumble
from imuarray.characterise import characterise_log
from imuarray.characterise.plots import allan_figure
from imuarray.errors import LogError, OutputExistsError
from imuarray.figures import PALETTE, new_figure
from imuarray.fuse import Gain, errors_of, fuse
from imuarray.fuse.evaluation import error_frames_together, gains_in
from imuarray.fuse.fusion import AVERAGE, fuse_together
from imuarray.gap.diagnose import diagnose
from imuarray.gap.findings.diagnosis import Diagnosis
from imuarray.gap.findings.text import effect_text, listed_causes, parameters_text, places_text, share
from imuarray.log import Log, open_log
from imuarray.log.format import Phase
from imuarray.printable import listed
from imuarray.report import Figure, Section, Table, Verdict, write_page
from imuarray.report.fused_page import ratio_figure
from imuarray.report.gap_page import write_gap_page
from imuarray.studies.emulated_runs import RUNS, DemoOptions, Report, record_all
from imuarray.units import INERTIAL, READABLE, READABLE_SI, STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure as DrawnFigure

BMA180S = ("BMA1", "BMA2", "BMA3", "BMA4")

Rows = Sequence[tuple["GainCase", Gain]]


@dataclass(frozen=True)
class GainCase:
    """One comparison of a technique with the average, on some sensors of one run, by the scatter or by the drift of the
    error.

    `claim` is the quantity for which the paper expects a gain in this case, "" if it expects none.
    """

    technique: str
    run: str
    claim: str = ""
    only: tuple[str, ...] = ()
    slow: bool = False
    phases: tuple[str, ...] = ()

    @property
    def sample(self) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
        """Return the data that are compared: a run, sensors (empty: all) and phases (empty: all)."""
        return self.run, self.only, self.phases

    @property
    def label(self) -> str:
        """Return the name in words, for a table."""
        sensors_text = f", {self.only[0]} to {self.only[-1]}" if self.only else ""
        return f"{self.technique}, {self.run}{sensors_text}{', drift' if self.slow else ''}"


CASES = (
    GainCase("opposed", "heating", "angular_rate", slow=True),
    GainCase("planes", "static", "specific_force"),
    GainCase("ranges", "static", "specific_force", BMA180S),
    GainCase("ranges", "shaking", only=BMA180S, phases=("motion",)),
    GainCase("opposed", "static"),
    GainCase("opposed", "shaking"),
    GainCase("planes", "heating", slow=True),
    GainCase("planes", "shaking"),
    GainCase("ranges", "static"),
    GainCase("ranges", "heating"),
)
"""The cases: first those in which the paper states that a technique helps, then others."""


def compare(logs: Mapping[str, Path], calibration: Calibration) -> list[tuple[GainCase, Gain]]:
    """Return the gains of every case, by quantity and axis; techniques on the same sample are evaluated in one pass."""
    gains: dict[GainCase, list[Gain]] = {}
    for run, only, names in dict.fromkeys(case.sample for case in CASES):
        cases = [case for case in CASES if case.sample == (run, only, names)]
        techniques = list(dict.fromkeys([AVERAGE, *(case.technique for case in cases)]))
        with open_log(logs[run]) as log:
            phases = [phase for phase in log.phases if phase.name in names]
            frames = error_frames_together(log, fuse_together(log, calibration, techniques, only=only), phases)
        gains |= {case: gains_in(frames, case.technique, slow=case.slow) for case in cases}
    return [(case, gain) for case in CASES for gain in gains[case]]


def _best(rows: Rows, case: GainCase) -> Gain:
    """Return the axis with the largest gain of a technique among those where the paper expects one."""
    of_case = [
        gain for result, gain in rows if result == case and gain.quantity == case.claim and gain.box_axis != "XYZ"
    ]
    return min(of_case, key=lambda gain: gain.ratio)


def summary(rows: Rows) -> list[str]:
    """Return the summary."""
    opposed, planes, ranges = (_best(rows, case) for case in CASES if case.claim)
    case, worst = max((row for row in rows if row[1].box_axis == "XYZ"), key=lambda row: row[1].ratio)
    return [
        f"opposed: gyroscope drift about box {opposed.box_axis} while heated, {_comparison(opposed)}",
        f"planes: specific force along box {planes.box_axis} at rest, {_comparison(planes)}",
        f"ranges: the four BMA180 along box {ranges.box_axis} at rest, {_comparison(ranges)}",
        f"worst of all comparisons: {case.label}, {worst.quantity.replace('_', ' ')}, {worst.ratio:.3f} ± "
        f"{worst.ratio_se:.3f} times the error of the average (all axes together)",
        "All figures are rms errors against the truth of the emulated world.",
    ]


_DIRECTION = {"specific_force": "along", "angular_rate": "about"}


def demo_verdict(rows: Rows, tumble: TumbleResult, diagnosis: Diagnosis) -> Verdict:
    """Return the verdict: gain of the techniques, calibration quality, and the gap of the simulator."""
    gained = [(case, _best(rows, case)) for case in CASES if case.claim]
    case, best = min(gained, key=lambda pair: pair[1].ratio)
    figures = [
        (f"{gain.ratio:.2f} ×", f"{gain_case.technique}: error over the average's, {gain.quantity.replace('_', ' ')}")
        for gain_case, gain in gained
    ]
    figures += common_figures(tumble, diagnosis)
    quantity = f"{best.quantity.replace('_', ' ')} {_DIRECTION[best.quantity]} box {best.box_axis}"
    sentence = (
        f"Fusion works: {case.technique} reduces the error of the {quantity} to {best.ratio:.2f} times that of the "
        "simple average."
    )
    return Verdict(sentence, "good" if best.ratio < 1 else "doubtful", tuple(figures))


def common_figures(tumble: TumbleResult, diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Return the figures of a verdict on the calibration and on the gap of the simulator."""
    residual_mg = 1e3 * max(tumble.residual_g.values(), default=0.0)
    return [
        (f"{residual_mg:.2g} mg", "largest residual of a calibrated accelerometer"),
        (diagnosis.verdict, "recordings against a simulator of the data sheets"),
    ]


def _comparison(gain: Gain) -> str:
    """Return the error of the simple average and that of the technique, and their ratio."""
    factor, unit = READABLE_SI[gain.quantity]
    errors = f"simple average {factor * gain.average:.3g} {unit}, fused {factor * gain.technique_error:.3g} {unit}"
    return f"{errors} ({gain.ratio:.3f} ± {gain.ratio_se:.3f} times)"


def gap_section(diagnosis: Diagnosis) -> Section:
    """Return the section on the effects that a simulator of the data sheets lacks."""
    rows = [
        [effect_text(cause), places_text(cause), parameters_text(cause.parameters), share(cause.probability)]
        for cause in listed_causes(diagnosis.causes)
    ]
    table = Table(
        ["effect", "where", "parameters", "probability"],
        rows or [["none", "", "", ""]],
        "Effects that the data sheets' model lacks. gap.html in the same folder has the details.",
        (0, 1, 2),
    )
    return Section("How far a simulator of the data sheets is from the run at rest", diagnosis.sentence, [table])


ABOUT_PAPERS_ARRAY = (
    "Twelve sensors of the paper's array behind one multiplexer, emulated register by register: nine inertial sensors"
    " with the biases, responses, temperature slopes and noise of the paper's Tables 3, 4, 8 and 10."
)


def recorded_section(logs: Mapping[str, Path], lead: str = ABOUT_PAPERS_ARRAY) -> Section:
    """Return the section on the contents of every log; `lead` is a sentence on the array."""
    rows = []
    for run, path in logs.items():
        with open_log(path) as log:
            seconds = max((int(s.time[-1]) for s in log.sensors.values()), default=0) * 1e-9
            readings = sum(len(sensor) for sensor in log.sensors.values())
            phases = ", ".join(phase.name for phase in log.phases)
            rows.append([run, f"{seconds:.0f}", f"{readings}", phases, str(len(log.events))])
    caption = "One log per run; all of them are in the folder of this page."
    table = Table(["run", "seconds", "readings", "phases", "events"], rows, caption, (3,))
    return Section("What was recorded", f"{lead} Every log holds raw counts.", [table])


def calibration_section(tumble: TumbleResult) -> Section:
    """Return the table of bias and scale factor of every axis, with standard errors."""
    rows = []
    for name, sensor in tumble.calibration.sensors.items():
        factor, unit = READABLE[sensor.unit]
        sem = sensor.bias_sem_lsb if sensor.bias_sem_lsb is not None else np.full(3, np.nan)
        for axis in range(3):
            bias = factor * sensor.bias_in_units()[axis]
            error = factor * sem[axis] / sensor.scale_lsb_per_unit[axis]
            measured = sensor.response_sem_lsb_per_unit is not None
            scale = f"{sensor.scale_lsb_per_unit[axis]:.2f}" if measured else "data sheet"
            rows.append([f"{name} {'xyz'[axis]}", f"{bias:.3f}", f"{error:.2g}", unit, scale])
    words = (
        "Bias and response of every axis from six faces of the box (the paper's Appendix B), gyroscope bias from all "
        "seven readings. The standard errors come from the scatter of batch means."
    )
    heading = ["axis", "bias", "standard error", "unit", "scale factor (LSB/g or LSB/dps)"]
    caption = "Compare with the paper's Tables 3 and 4." if {*BMA180S} <= {*tumble.calibration.sensors} else ""
    return Section("Calibration from six faces", words, [Table(heading, rows, caption)])


def noise_section(noise: dict[str, Any]) -> Section:
    """Return noise table and Allan curves of a `characterise_log` result."""
    rows = []
    for sensor in noise["sensors"]:
        if sensor["quantity"] not in INERTIAL:
            continue
        factor, unit = READABLE[sensor["unit"]]
        for axis in sensor["axes"]:
            name, own = f"{sensor['name']} {axis['axis']}", axis["unit"]
            density = "-" if own["noise_density"] is None else f"{factor * own['noise_density']:.4f}"
            scatter, even = f"{factor * own['std']:.3f}", f"{axis['even_share']:.2f}"
            rows.append([name, scatter, unit, density, f"{unit}/√Hz", even])
    caption = "Per axis, by the data sheets' sensitivities."
    return Section(
        "Noise",
        "Scatter of single readings and white-noise density from the long rest. A share of even "
        "codes of 1.00 betrays a chip that outputs even codes only, as the ADXL345 does at 1600 and 3200 Hz.",
        [
            Table(["axis", "std", "unit", "density", "unit", "even codes"], rows, caption),
            Figure(
                allan_figure(noise),
                "Allan deviation: straight lines of slope -1/2 are white noise; a curve that flattens shows drift.",
                "Allan deviation curves of every inertial sensor axis",
            ),
        ],
    )


def gain_section(rows: Rows) -> Section:
    """Return the section that compares every technique with the average."""
    table, labels, ratios, errors = [], [], [], []
    unchanged: list[str] = []
    for case, gain in rows:
        if (gain.box_axis == "XYZ") == (gain.quantity == case.claim):
            continue  # each axis if a gain is claimed, otherwise the whole triad
        if isclose(gain.ratio, 1.0, rel_tol=1e-9):
            unchanged.append(f"{case.label} ({gain.quantity.replace('_', ' ')})")
            continue
        factor, unit = READABLE_SI[gain.quantity]
        axis = "" if gain.box_axis == "XYZ" else f" {_DIRECTION[gain.quantity]} {gain.box_axis}"
        name = f"{case.label}: {gain.quantity.replace('_', ' ')}{axis}"
        figures = [f"{factor * gain.average:.3f}", f"{factor * gain.technique_error:.3f}", unit]
        deviation = "< 0.0001" if gain.ratio_se < 1e-4 else f"{gain.ratio_se:.1g}"
        table.append([name, *figures, f"{gain.ratio:.3f}", deviation])
        labels.append(name)
        ratios.append(gain.ratio)
        errors.append(gain.ratio_se)
    same = f" The same as the simple average: {'; '.join(unchanged)}." if unchanged else ""
    return Section(
        "What each technique gains",
        "Rms error of each technique divided by that of the simple average of the same sensors, in runs whose truth "
        "is known. The first rows show, axis by axis, the cases in which the paper expects a gain; the other rows "
        "show all axes together in the remaining cases.",
        [
            Figure(
                ratio_figure(labels, ratios, errors),
                "Left of the line the technique is better than the average; bars are two standard errors.",
                "Ratios of the errors of each technique to those of the average",
            ),
            Table(
                ["case", "average", "technique", "unit", "ratio", "standard error"],
                table,
                f"Rms errors against the truth.{same}",
            ),
        ],
    )


def heating_section(path: Path, calibration: Calibration) -> Section:
    """Draw the gyroscopes about box Y, the axes of the paper's Figure 10."""
    with open_log(path) as log:
        barometer = log.of("pressure")[0]
        temperature = (np.asarray(barometer.time) * 1e-9, np.asarray(barometer.compensated("temperature")))
        figure = drift_of_gyroscopes(log, calibration, temperature)
    return Section(
        "Heated: opposed gyroscopes",
        "The hair dryer heats the box by 28 degrees. About box Y one gyroscope points along and two "
        "against the axis, and all three drift alike in their own frames.",
        [
            Figure(
                figure,
                "Five-second means of the error about box Y: every single gyroscope drifts, their "
                "average keeps part of it, opposing them removes what they share.",
                "Drift of single gyroscopes, their average and the opposed result while the box is heated",
            )
        ],
    )


def drift_of_gyroscopes(log: Log, calibration: Calibration, temperature: tuple[Any, Any]) -> DrawnFigure:
    """Draw the error about box Y of every gyroscope, of their average and of the technique "opposed" over time, and the
    `temperature`: times in s, and degC.
    """
    single = {
        sensor.name: _slow_error(*errors_of(log, fuse(log, calibration, "mean", only=[sensor.name]))["angular_rate"])
        for sensor in log.of("angular_rate")
    }
    labels = {AVERAGE: "simple average", "opposed": "opposed"}
    together = error_frames_together(log, fuse_together(log, calibration, list(labels)))
    fused = {label: together[technique]["angular_rate"] for technique, label in labels.items()}
    curves = {label: _slow_error(frames.time, frames.errors) for label, frames in fused.items()}
    length = min(len(time_s) for time_s, _ in (*single.values(), *curves.values()))
    time_s, _ = next(iter(single.values()))
    return drift_figure(
        time_s[:length],
        {name: values[:length] for name, (_, values) in single.items()},
        {name: values[:length] for name, (_, values) in curves.items()},
        "dps",
        temperature,
    )


def _slow_error(time: Any, error: Any) -> tuple[Any, Any]:
    """Return time (s) and five-second means of the error about box Y in dps, minus the first value."""
    groups = (time - time[0]) // 5_000_000_000
    _, first = np.unique(groups, return_index=True)
    means = np.add.reduceat(error[:, 1], first) / np.diff(np.append(first, len(error)))
    return time[first] * 1e-9, np.degrees(means - means[:2].mean())


def motion_section(path: Path, calibration: Calibration) -> Section:
    """Draw the BMA180 along box X while the box is shaken: the low range, the high range, and both blended."""
    choices = {
        "±16 g alone": ("mean", BMA180S[:2]),
        "±1.5 g alone": ("mean", BMA180S[2:]),
        "ranges": ("ranges", BMA180S),
    }
    curves, times = {}, {}
    with open_log(path) as log:
        motion = next(phase for phase in log.phases if phase.name == "motion")
        window = Phase(motion.start_ns - 1_500_000_000, min(motion.start_ns + 4_500_000_000, motion.end_ns), "window")
        for label, (technique, only) in choices.items():
            time, error = errors_of(log, fuse(log, calibration, technique, only=only), [window])["specific_force"]
            error_mg = READABLE_SI["specific_force"][0] * error[:, 0]
            rest = float(np.sqrt(np.mean(error_mg[time < motion.start_ns] ** 2)))
            name = f"{label} (rms at rest {rest:.1f} mg)"
            curves[name], times[name] = error_mg, time * 1e-9
        track = log.truth
        if track is None or track.specific_force is None:
            raise LogError(f"{path}: an emulated log without a truth")
        times_ns = track.time[:]
        inside = (times_ns >= window.start_ns) & (times_ns < window.end_ns)
        truth = (times_ns[inside] * 1e-9, track.specific_force[:][inside, 0] / STANDARD_GRAVITY)
    return Section(
        "Shaken: low and high range blended",
        "Two of the four BMA180 measure up to 1.5 g, two up to 16 g. The low range is the quieter one, until it clips.",
        [
            Figure(
                motion_figure(truth, times, curves, 1.5),
                "Above: the specific force of the box; the dashed lines are the ends of the low range. Below: errors. "
                "The low range alone has gaps where it clips; the blend has neither gaps nor steps, and is quieter "
                "at rest than either range.",
                "True specific force of a shaken box and the errors of the low range, the high range and their blend",
            )
        ],
    )


FUSED = ("mean", "opposed")
"""Techniques whose result on the heating run is stored in a file."""

DIAGNOSED = ("ADXL1", "BMA2", "Gyro1")
"""One sensor of each inertial chip."""

REPLICATES = 60


def run_demo(config: Path, folder: Path, options: DemoOptions, report: Report) -> dict[str, Any]:
    """Record, calibrate, fuse and report into `folder`; return the summary, JSON-ready. OutputExistsError before
    anything is recorded, unless `options.force`.
    """
    prepare_folder(folder, options.force)
    logs, tumble, calibration = record_and_fuse(config, folder, options, report)
    rows = compare(logs, calibration)
    diagnosis, noise = diagnose_rest(logs["static"], folder, DIAGNOSED, options.seed, report)
    lines = summary(rows)
    title = "An emulated array, recorded, calibrated and fused"
    parts = [
        gain_section(rows),
        heating_section(logs["heating"], calibration),
        motion_section(logs["shaking"], calibration),
        recorded_section(logs),
        calibration_section(tumble),
        noise_section(noise),
        gap_section(diagnosis),
    ]
    write_page(folder / "report.html", title, lines, parts, verdict=demo_verdict(rows, tumble, diagnosis), force=True)
    measured = {"gains": [{"case": case.label, **vars(gain)} for case, gain in rows]}
    return demo_summary(folder, lines, measured, tumble, diagnosis)


def diagnose_rest(
    path: Path, folder: Path, only: Sequence[str], seed: int, report: Report
) -> tuple[Diagnosis, dict[str, Any]]:
    """Compare the sensors `only` of the run at rest with a simulator, write gap.html, and return the diagnosis and the
    noise of all sensors.
    """
    report("diagnosing")
    with open_log(path) as log:
        diagnosis = diagnose([log], only=only, seed=seed, replicates=REPLICATES)
        noise = characterise_log(log)
    write_gap_page(folder / "gap.html", diagnosis, force=True)
    report("drawing")
    return diagnosis, noise


def demo_summary(
    folder: Path, lines: Sequence[str], measured: Mapping[str, Any], tumble: TumbleResult, diagnosis: Diagnosis
) -> dict[str, Any]:
    """Return the summary of a demonstration in `folder`, JSON-ready; `measured` has the gains of fusion."""
    return {
        "folder": str(folder),
        "report": str(folder / "report.html"),
        "summary": lines,
        **measured,
        "residual_mg": {name: 1e3 * value for name, value in tumble.residual_g.items()},
        "gap": {"verdict": diagnosis.verdict, "sentence": diagnosis.sentence, "page": str(folder / "gap.html")},
    }


def prepare_folder(folder: Path, force: bool, further_files: Sequence[str] = ()) -> Path:
    """Create the folder and return it; OutputExistsError if it contains a file of the demonstration or one of
    `further_files`, unless `force`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    existing = [
        "report.html",
        "gap.html",
        "calibration.toml",
        *(f"{run}.h5" for run in RUNS),
        *(f"fused_{name}.h5" for name in FUSED),
        *further_files,
    ]
    for name in existing:
        if (folder / name).exists() and not force:
            raise OutputExistsError(folder / name)
    return folder


def record_and_fuse(
    config: Path, folder: Path, options: DemoOptions, report: Report
) -> tuple[dict[str, Path], TumbleResult, Calibration]:
    """Record all runs, calibrate with the run on six faces (calibration.toml), and write the heating run fused by each
    technique of `FUSED` (fused_NAME.h5). Return the logs by run, the result of the tumble, and the calibration.
    """
    logs = record_all(config, folder, options, report)
    report("calibrating")
    with open_log(logs["tumble"]) as log:
        tumble = calibrate_tumble(log)
        calibration = tumble.calibration.merged(calibrate_noise(log))
    calibration.save(folder / "calibration.toml", force=True)
    report("fusing")
    with open_log(logs["heating"]) as log:
        for name in FUSED:
            fused = analysis.fuse(log, folder / "calibration.toml", name)
            fused.save(folder / f"fused_{name}.h5", force=True)
    return logs, tumble, calibration


def drift_figure(
    time_s: Reals,
    single: Mapping[str, Reals],
    fused: Mapping[str, Reals],
    unit: str,
    temperature: tuple[Reals, Reals] | None,
) -> DrawnFigure:
    """Draw the slow errors (n,) of sensors and of fused results over time, and the temperature (time, degC) below."""
    figure = new_figure(8.0, 5.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for number, values in enumerate(single.values()):
        upper.plot(
            time_s,
            values,
            color=PALETTE[0],
            linewidth=1.0,
            label=None if number else f"each alone: {listed(list(single))}",
        )
    for colour, (name, values) in zip(PALETTE[1:], fused.items(), strict=False):
        upper.plot(time_s, values, color=colour, linewidth=1.8, label=name)
    upper.axhline(0, color="black", linewidth=0.6)
    upper.set_ylabel(f"error ({unit})")
    upper.legend(frameon=False, fontsize=9, loc="best")
    if temperature is not None:
        lower.plot(*temperature, color=PALETTE[2], linewidth=1.2)
    lower.set_ylabel("temperature (°C)")
    lower.set_xlabel("time (s)")
    return figure


def motion_figure(
    force: tuple[Reals, Reals], times_s: Mapping[str, Reals], errors_mg: Mapping[str, Reals], end_of_range_g: float
) -> DrawnFigure:
    """Draw a specific force (time, g) that exceeds the low range, and below it the errors (n,) of several results."""
    figure = new_figure(8.0, 5.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
    upper.plot(*force, color="black", linewidth=1.0)
    for limit in (-end_of_range_g, end_of_range_g):
        upper.axhline(limit, color=PALETTE[2], linewidth=0.9, linestyle="--")
    upper.set_ylabel("truth (g)")
    for colour, (name, values) in zip((PALETTE[0], PALETTE[2], PALETTE[1]), errors_mg.items(), strict=False):
        lower.plot(times_s[name], values, color=colour, linestyle="none", marker=".", markersize=4, label=name)
    lower.set_ylabel("error (mg)")
    lower.set_xlabel("time (s)")
    lower.legend(frameon=False, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    return figure
