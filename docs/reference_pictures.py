"""Pictures of the reference: what effects, probes, chips and techniques do, drawn from simulated logs.

An effect is shown by one sensor with it and without it, a domain of probes by the statistic that an effect changes, a
chip by its readings at rest, a technique by its error beside that of single sensors. `docs/generate.py` adds them to
their pages while the site is built, and `python docs/generate.py DIR` writes them into DIR.
"""

from __future__ import annotations

import io
import math
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.signal import welch

import imuarray as ia
from imuarray.array import parse_array
from imuarray.arrays import Floats
from imuarray.atomic import draw_figure
from imuarray.characterise import allan_deviation
from imuarray.chips import CHIPS
from imuarray.figures import PALETTE, envelope, new_figure
from imuarray.log import Log
from imuarray.simulate import EFFECTS
from imuarray.simulate.effect import Effect
from imuarray.thermometers import thermometer_scale
from imuarray.units import STANDARD_GRAVITY


@dataclass(frozen=True)
class Example:
    """An effect with parameters that show what it does, and the simulated run that shows it."""

    parameters: Mapping[str, Any]
    """The parameters as the effect's class takes them, in the sensor's unit, g or dps."""
    caption: str
    sensor: str = "Gyro1"
    axis: int = 2
    experiment: str = "static"
    conditions: Mapping[str, Any] = field(default_factory=lambda: {"seconds": 30})
    dots: bool = False
    before: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """The effects of the run without it: none, or those that it is compared with."""
    span_s: tuple[float, float] = (0.0, math.inf)
    """The part of the run that is shown."""
    temperature: bool = False
    """Show the chip's thermometer, not an axis."""


_POINTS_OF_CURVE = 1500
"""A curve is drawn by its least and greatest values: a page does not load half a megabyte for a picture."""

_MOVED: Mapping[str, Any] = {"seconds": 30}
_SHORT = (12.0, 16.0)

EXAMPLES: Mapping[str, Example] = {
    "axis_error": Example(
        {"axes": "+X-Y-Z"}, "Mounted upside down, on the six faces.", "BMA1", 2, "tumble", {"seconds": 70}
    ),
    "bandwidth": Example(
        {"cutoff_hz": 1.0}, "A low pass of 1 Hz: neighbouring readings are alike.", conditions={"seconds": 8}
    ),
    "bistable_bias": Example(
        {"offset": (0.5, 0.5, 0.5), "probability": 1.0}, "A sensor that started in its second state, 0.5 dps away."
    ),
    "common_mode": Example(
        {"rms": (0.2, 0.2, 0.2), "time_constant_s": 20.0},
        "A bias of 0.2 dps that all sensors of a design share.",
        conditions={"seconds": 120},
    ),
    "g_sensitivity": Example(
        {"response": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0)},
        "A gyroscope that reads 20 dps for each g along its z axis, on the six faces.",
        experiment="tumble", conditions={"seconds": 70},
    ),
    "misalignment": Example(
        {"angles_deg": (20.0,) * 6}, "Axes that lean by 20 degrees, on the six faces.", "BMA1", 2, "tumble",
        {"seconds": 70},
    ),
    "thermal_scale": Example(
        {"slope": (0.005, 0.005, 0.005)}, "A scale factor that grows by 0.5 % per degree while the box is heated.",
        "BMA1", 2, "heating", {"seconds": 300},
    ),
    "turn_on_bias": Example({"rms": (1.0, 1.0, 1.0)}, "A bias that differs at each switch-on, by 1 dps rms."),
    "bias": Example({"offset": (0.5, 0.5, 0.5)}, "A bias of 0.5 dps."),
    "bias_instability": Example(
        {"rms": (0.2, 0.2, 0.2), "time_constant_s": 20.0},
        "A bias that wanders by 0.2 dps within 20 s.",
        conditions={"seconds": 120},
    ),
    "dropped_samples": Example({"probability": 0.02, "burst_rows": 40.0}, "Bursts of 40 lost readings.", dots=True),
    "glitches": Example({"probability": 0.01, "amplitude": 3.0}, "Single wrong readings, here spikes of 3 dps."),
    "nonlinearity": Example(
        {"cubic": (0.2, 0.2, 0.2)}, "A response that is not straight, on the six faces.", "BMA1", 2, "tumble",
        {"seconds": 70},
    ),
    "popcorn_noise": Example(
        {"amplitude": (0.5, 0.5, 0.5), "switches_per_s": 0.3}, "A level that jumps to and fro by 0.5 dps."
    ),
    "quantisation": Example({"step_lsb": (8.0, 8.0, 8.0)}, "Codes in steps of eight counts.", dots=True),
    "random_walk": Example(
        {"density": (0.05, 0.05, 0.05)}, "A random walk of 0.05 dps/√s.", conditions={"seconds": 120}
    ),
    "saturation": Example(
        {"limit": (0.8, 0.8, 0.8)}, "Readings stop at 0.8 g, on the six faces.", "BMA1", 2, "tumble", {"seconds": 70}
    ),
    "scale": Example(
        {"error": (0.2, 0.2, 0.2)}, "A scale factor that is 20 % too large, on the six faces.", "BMA1", 2, "tumble",
        {"seconds": 70},
    ),
    "stale_samples": Example(
        {"probability": 0.8}, "Most readings repeat the one before.", conditions={"seconds": 3}, dots=True
    ),
    "stuck": Example({"onset_s": 10.0, "duration_s": 8.0}, "The same reading from 10 s to 18 s."),
    "thermal_bias": Example(
        {"slope": (0.05, 0.05, 0.05)}, "A bias of 0.05 dps per degree while the box is heated.", experiment="heating",
        conditions={"seconds": 300},
    ),
    "tone": Example(
        {"amplitude": (0.6, 0.6, 0.6), "frequency_hz": 2.0}, "A vibration of 0.6 dps at 2 Hz.",
        conditions={"seconds": 6},
    ),
    "adaptive_range": Example(
        {"threshold": 200.0, "hold_s": 0.08}, "Each time a rate passes 200 dps, all readings are held for 80 ms.",
        experiment="motion", conditions=_MOVED, span_s=_SHORT,
    ),
    "channel_swap": Example(
        {"sensor": "Gyro2"}, "The data of Gyro2, which is mounted the other way round, in the place of Gyro1's.",
        experiment="motion", conditions=_MOVED, span_s=_SHORT,
    ),
    "clock_error": Example(
        {"error_ppm": 20_000.0}, "A clock that is 2 % wrong: the same motion comes later and later.",
        experiment="motion", conditions=_MOVED, span_s=_SHORT,
    ),
    "jitter": Example(
        {"rms_s": 0.05}, "Time stamps that scatter by 50 ms.", experiment="motion", conditions=_MOVED, span_s=(12, 14),
        dots=True,
    ),
    "odr_error": Example(
        {"rate_hz": 100.0, "bandwidth_hz": 2.0}, "A filter that was left at 2 Hz: neighbouring readings are alike.",
        conditions={"seconds": 8},
    ),
    "own_clock": Example(
        {"rate_error": -0.5, "polled": 1.0},
        "A chip that samples 400 times a second and is polled 1000 times: a poll gets its latest reading.",
        experiment="motion", conditions={"seconds": 30, "rate_hz": 1000.0}, dots=True, span_s=(12.0, 12.03),
    ),
    "range_reset": Example(
        {"range": 250.0, "onset_s": 14.0}, "After a reset at 14 s the chip measures in its narrowest range: counts are"
        " eight times as many, and stop at 250 dps.",
        experiment="motion", conditions=_MOVED, span_s=_SHORT,
    ),
    "size_effect": Example(
        {"position_mm": (300.0, 0.0, 0.0)}, "An accelerometer 30 cm from the origin senses the rotation of the box.",
        "BMA1", 0, "motion", _MOVED, span_s=_SHORT,
    ),
    "skew": Example(
        {"delay_s": 0.2}, "Readings that are 0.2 s older than their time stamps.", experiment="motion",
        conditions=_MOVED, span_s=_SHORT,
    ),
    "thermal_lag": Example(
        {"time_constant_s": 60.0, "slope": (0.05, 0.05, 0.05)},
        "A bias of 0.05 dps per degree that follows the temperature of the box a minute later, and without the delay.",
        experiment="heating", conditions={"seconds": 300}, before={"thermal_bias": {"slope": (0.05, 0.05, 0.05)}},
    ),
    "thermometer": Example(
        {"offset_degc": 3.0, "rms_degc": 0.5}, "A thermometer that is 3 degrees off and scatters by 0.5.", "BMA1",
        experiment="heating", conditions={"seconds": 300}, temperature=True,
    ),
    "white_noise": Example({"rms": (0.5, 0.5, 0.5)}, "White noise of 0.5 dps on top of the sensor's own."),
}  # fmt: skip


@dataclass(frozen=True)
class Pair:
    """Times in s and readings in `unit` of one axis, without an effect and with it."""

    without: tuple[Floats, Floats]
    within: tuple[Floats, Floats]
    unit: str


def _pair(name: str, **conditions: Any) -> Pair:
    """The two runs of an example, with other conditions if these are given."""
    example = EXAMPLES[name]
    curves = []
    for effects in (example.before, {name: example.parameters}):
        made = [EFFECTS[each](**parameters) for each, parameters in effects.items()]
        with _simulated(example, made, {**example.conditions, **conditions}) as log:
            curves.append(_curve(log, example))
    return Pair(curves[0][:2], curves[1][:2], curves[0][2])


@contextmanager
def _simulated(example: Example, effects: Sequence[Effect], conditions: Mapping[str, Any]) -> Iterator[Log]:
    others = [example.parameters["sensor"]] if "sensor" in example.parameters else []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what the data sheets' model leaves out
        log = ia.simulate(
            "martin2013", Path(folder) / "run.h5", experiment=example.experiment, only=[example.sensor, *others],
            effects={example.sensor: effects}, seed=3, **conditions,
        )  # fmt: skip
        with log:
            yield log


def _curve(log: Log, example: Example) -> tuple[Floats, Floats, str]:
    """Times in s, readings in the sensor's unit by the data sheet, and the unit."""
    sensor = log[example.sensor]
    time_s = np.asarray(sensor.time[:]) * 1e-9
    if example.temperature and sensor.temperature_counts is not None:
        scale = thermometer_scale(sensor.chip)
        assert scale is not None  # noqa: S101  the example names a chip whose thermometer has a scale
        return time_s, scale.zero_degc + np.asarray(sensor.temperature_counts[:], float) / scale.lsb_per_degc, "degC"
    return time_s, np.asarray(sensor.counts[:])[:, example.axis] / sensor.sensitivity, sensor.unit


def picture(name: str) -> bytes:
    """The picture of an effect of `EXAMPLES` as SVG."""
    example, pair = EXAMPLES[name], _pair(name)
    figure, panel = _panel()
    level = float(np.median(pair.without[1])) if pair.unit == "dps" else 0.0  # the bias of this unit
    for label, colour, (time_s, values) in (
        ("without", PALETTE[0], pair.without), (f"with {name}", PALETTE[1], pair.within)
    ):  # fmt: skip
        shown = (time_s >= example.span_s[0]) & (time_s <= example.span_s[1])
        curve = (time_s[shown], values[shown] - level)
        has_dots = example.dots and not (example.experiment == "motion" and label == "without")
        style: dict[str, Any] = {"marker": ".", "markersize": 4, "linestyle": "none"} if has_dots else {}
        panel.plot(
            *(curve if example.dots else envelope(*curve, most=_POINTS_OF_CURVE)),
            color=colour,
            linewidth=0.8,
            label=label,
            **style,
        )
    panel.set(xlabel="time (s)", ylabel=pair.unit)
    return _svg(figure, panel)


def _panel() -> tuple[Any, Any]:
    figure = new_figure(8.0, 2.6)
    return figure, figure.subplots()


def _svg(figure: Any, panel: Any) -> bytes:
    """The figure with a grid and, if anything has a label, a legend above its right end."""
    panel.grid(linewidth=0.4, alpha=0.6)
    if panel.get_legend_handles_labels()[1]:
        panel.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1, 1), borderpad=0, ncols=4)
    buffer = io.BytesIO()
    draw_figure(buffer, figure, format="svg", metadata={"Date": None})
    return buffer.getvalue()


# Probes --------------------------------------------------------------------------------------------------------------

View = tuple[Floats, Floats]
"""What is drawn of one run: horizontal and vertical values."""


@dataclass(frozen=True)
class ProbeExample:
    """The statistic of a domain of probes, and an effect of `EXAMPLES` that changes it."""

    effect: str
    view: Callable[[Floats, Floats], View]
    labels: tuple[str, str]
    caption: str
    conditions: Mapping[str, Any] = field(default_factory=dict)
    style: Mapping[str, Any] = field(default_factory=dict)
    scale: Literal["linear", "log", "loglog"] = "linear"


def _blocks(time_s: Floats, values: Floats, rows: int) -> tuple[Floats, Floats]:
    """Mean times (n,) and readings (n, rows) of blocks of rows."""
    count = len(values) // rows
    return time_s[: count * rows].reshape(count, rows).mean(axis=1), values[: count * rows].reshape(count, rows)


def _level(time_s: Floats, values: Floats) -> View:
    middle_s, blocks = _blocks(time_s, values, 50)
    return middle_s, blocks.mean(axis=1)


def _spread(time_s: Floats, values: Floats) -> View:
    middle_s, blocks = _blocks(time_s, values, 50)
    return middle_s, blocks.std(axis=1)


def _distribution(time_s: Floats, values: Floats) -> View:
    counts, edges = np.histogram(values - np.median(values), bins=np.arange(-4.0, 4.0, 0.1))
    return (edges[1:] + edges[:-1]) / 2, np.where(counts, counts, np.nan)


def _codes(time_s: Floats, values: Floats) -> View:
    codes = np.rint(values * CHIPS["l3g4200d"].sensitivity[2000.0])
    seen, counts = np.unique(codes, return_counts=True)
    return seen, counts


def _spectrum(time_s: Floats, values: Floats) -> View:
    frequency_hz, density = welch(values, 1 / float(np.median(np.diff(time_s))), nperseg=256)
    return frequency_hz[1:], density[1:]


def _correlation(time_s: Floats, values: Floats) -> View:
    rest = values - values.mean()
    lags = np.arange(1, 26)
    return lags, np.array([float(rest[lag:] @ rest[:-lag]) for lag in lags]) / float(rest @ rest)


def _allan(time_s: Floats, values: Floats) -> View:
    curve = allan_deviation(values, float(np.median(np.diff(time_s))))
    return curve.tau_s, curve.deviation.ravel()


def _change(time_s: Floats, values: Floats) -> View:
    """Change since the beginning over the temperature of a box that is heated at a constant rate, on average."""
    middle_s, blocks = _blocks(time_s, values, 100)
    return middle_s, blocks.mean(axis=1) - blocks[0].mean()


def _intervals(time_s: Floats, values: Floats) -> View:
    counts, edges = np.histogram(1e3 * np.diff(time_s), bins=np.arange(10.0, 2010.0, 20.0))
    return (edges[1:] + edges[:-1]) / 2, np.where(counts, counts, np.nan)


def _repeats(time_s: Floats, values: Floats) -> View:
    middle_s, blocks = _blocks(time_s[1:], (np.diff(values) == 0).astype(float), 10)
    return middle_s, 100 * blocks.mean(axis=1)


def _curves(time_s: Floats, values: Floats) -> View:
    shown = (time_s >= _SHORT[0]) & (time_s <= _SHORT[1])
    return time_s[shown], values[shown]


def _pieces(time_s: Floats, values: Floats) -> View:
    middle_s, blocks = _blocks(time_s, values, 25)
    return middle_s, blocks.mean(axis=1)


_STEPS: Mapping[str, Any] = {"drawstyle": "steps-mid"}
_POINTS: Mapping[str, Any] = {"marker": "o", "markersize": 3, "linestyle": "none"}
PROBE_EXAMPLES: Mapping[str, ProbeExample] = {
    "allan": ProbeExample(
        "random_walk", _allan, ("averaging time (s)", "Allan deviation (dps)"),
        "The Allan deviation; a random walk raises it at long averaging times.", {"seconds": 300}, scale="loglog",
    ),
    "autocorrelation": ProbeExample(
        "bandwidth", _correlation, ("lag (rows)", "correlation"),
        "The correlation of a reading with those before; a filter raises it.", {"seconds": 60}, _POINTS,
    ),
    "codes": ProbeExample(
        "quantisation", _codes, ("code", "readings"),
        "How often each code occurs; here codes come in steps of eight.", {"seconds": 60}, _POINTS,
    ),
    "cross_sensor": ProbeExample(
        "common_mode", _level, ("time (s)", "means of 1 s (dps)"),
        "The level that a sensor shares with others of its design, here a common bias.",
    ),
    "distribution": ProbeExample(
        "glitches", _distribution, ("deviation from the median (dps)", "readings"),
        "The distribution of the noise; single wrong readings lengthen its tails.", {"seconds": 120}, _STEPS, "log",
    ),
    "force": ProbeExample(
        "g_sensitivity", _pieces, ("time (s)", "means (dps)"),
        "The level on each of the six faces; here a gyroscope senses gravity.", style=_STEPS,
    ),
    "level": ProbeExample(
        "bias_instability", _level, ("time (s)", "means of 1 s (dps)"),
        "The level and its stability, here of a bias that wanders.",
    ),
    "motion": ProbeExample(
        "skew", _curves, ("time (s)", "reading (dps)"),
        "The response to a motion that other sensors feel too; here readings come late.",
    ),
    "run_to_run": ProbeExample(
        "turn_on_bias", _level, ("time (s)", "means of 1 s (dps)"),
        "The level of a run against that of other runs, here by a bias that differs at each switch-on.",
    ),
    "spectrum": ProbeExample(
        "tone", _spectrum, ("frequency (Hz)", "density (dps²/Hz)"),
        "The spectrum; a vibration is a line in it.", {"seconds": 120}, scale="log",
    ),
    "spread": ProbeExample(
        "white_noise", _spread, ("time (s)", "standard deviation in 1 s (dps)"), "The noise level and its stability.",
    ),
    "status": ProbeExample(
        "stale_samples", _repeats, ("time (s)", "repeated rows (%)"), "Flags of rows, here those without a new one.",
        {"seconds": 30},
    ),
    "temperature": ProbeExample(
        "thermal_bias", _change, ("time of heating (s)", "change (dps)"),
        "The dependence on temperature, while the box is heated and cools.",
    ),
    "timing": ProbeExample(
        "dropped_samples", _intervals, ("interval (ms)", "rows"), "The intervals between rows; here rows are lost.",
        {"seconds": 300}, {"drawstyle": "steps-mid", "marker": "."}, "log",
    ),
}  # fmt: skip


def probe_picture(domain: str) -> bytes:
    """The picture of a domain of probes as SVG."""
    example = PROBE_EXAMPLES[domain]
    pair = _pair(example.effect, **example.conditions)
    level = float(np.median(pair.without[1]))  # the bias of this unit
    figure, panel = _panel()
    for label, colour, (time_s, values) in (
        ("without", PALETTE[0], pair.without), (f"with {example.effect}", PALETTE[1], pair.within)
    ):  # fmt: skip
        panel.plot(*example.view(time_s, values - level), color=colour, linewidth=1.0, label=label, **example.style)
    panel.set(xlabel=example.labels[0], ylabel=example.labels[1])
    if example.scale == "loglog":
        panel.set_xscale("log")
    if example.scale != "linear":
        panel.set_yscale("log")
    return _svg(figure, panel)


# Chips ---------------------------------------------------------------------------------------------------------------


def chip_picture(name: str) -> bytes:
    """Five seconds of a chip's readings at rest by its data sheet, less their mean, and their distribution."""
    spec = CHIPS[name]
    ranges = sorted(spec.sensitivity)
    scale = f"range = {ranges[len(ranges) // 2]:g}\n" if ranges else ""
    rate_hz = min(spec.rates_hz, key=lambda hz: abs(hz - 100.0), default=None)
    rate = f"rate_hz = {rate_hz:g}\n" if rate_hz else ""
    text = (
        f'[array]\nname = "one"\n[[sensor]]\nname = "S"\nchip = "{name}"\naddress = {spec.addresses[0]}\n{scale}{rate}'
    )
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        log = ia.simulate(parse_array(text), Path(folder) / "run.h5", rate_hz=50.0, seed=3, seconds=5)
        with log:
            sensor = log["S"]
            time_s, counts = np.asarray(sensor.time[:]) * 1e-9, np.asarray(sensor.counts[:], float)
            if not sensor.is_triad:
                counts = np.asarray(sensor.compensated("pressure")[:], float)[:, None]
            code = 1 / sensor.sensitivity if sensor.sensitivity else 1.0
            values = (counts - np.rint(counts.mean(axis=0))) * code
    most = max(float(np.abs(values).max()), 3 * code)
    bins = np.linspace(-most, most, 1 + min(31, int(2 * most / code) | 1))
    figure = new_figure(8.0, 2.6)
    curves, codes = figure.subplots(1, 2, width_ratios=(3, 1))
    names = "xyz" if values.shape[1] == 3 else ("pressure",)
    for label, colour, column in zip(names, PALETTE[1:], values.T, strict=False):
        curves.plot(time_s, column, color=colour, linewidth=0.8, label=label)
        codes.stairs(np.histogram(column, bins)[0], bins, orientation="horizontal", color=colour, linewidth=0.8)
    unit = spec.unit or "Pa"
    curves.set(xlabel="time (s)", ylabel=f"{unit}, less the mean", ylim=(-1.05 * most, 1.05 * most))
    codes.set(xlabel="readings", ylim=curves.get_ylim(), yticklabels=[])
    codes.grid(linewidth=0.4, alpha=0.6)
    return _svg(figure, curves)


# Techniques ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TechniqueExample:
    """The run in which a technique gains, and the quantity and box axis that show it."""

    quantity: Literal["specific_force", "angular_rate"]
    axis: int
    caption: str
    experiment: str = "static"
    seconds: float = 60.0
    only: tuple[str, ...] = ()


TECHNIQUE_EXAMPLES: Mapping[str, TechniqueExample] = {
    "mean": TechniqueExample("angular_rate", 1, "Means of 1 s of three gyroscopes at rest, and of their mean."),
    "opposed": TechniqueExample(
        "angular_rate", 1, "While the box is heated, gyroscopes of one design drift alike along their own axes.",
        "heating", 300.0,
    ),
    "optimal": TechniqueExample(
        "angular_rate", 1, "While the box is heated; single gyroscopes drift.", "heating", 300.0
    ),
    "planes": TechniqueExample(
        "specific_force", 2, "Means of 1 s along Z, where some accelerometers have their noisier axis."
    ),
    "ranges": TechniqueExample(
        "specific_force", 2, "Means of 1 s of accelerometers of 2 and 16 g, which scatter by different amounts."
    ),
}  # fmt: skip


def technique_picture(name: str) -> bytes:
    """Changes of the fused result, of the plain mean and of single sensors, in means of one second, as SVG."""
    example = TECHNIQUE_EXAMPLES[name]
    figure, panel = _panel()
    unit, factor = ("mg", 1e3 / STANDARD_GRAVITY) if example.quantity == "specific_force" else ("dps", np.degrees(1.0))
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        log = ia.simulate(
            "martin2013", Path(folder) / "run.h5", experiment=example.experiment, model="martin2013", seed=5,
            seconds=example.seconds,
        )  # fmt: skip
        with log:
            for sensor in log.of(example.quantity):
                time_s = np.asarray(sensor.time[:]) * 1e-9
                box = np.asarray(sensor.counts[:], float) / sensor.sensitivity @ sensor.orientation.T
                scale = 1e3 if unit == "mg" else 1.0
                panel.plot(*_changes(time_s, scale * box[:, example.axis]), color=PALETTE[0], linewidth=0.5, alpha=0.7)
            for technique in dict.fromkeys(("mean", name)):
                fused = ia.fuse(log, technique=technique)
                values = factor * np.asarray(getattr(fused, example.quantity))[:, example.axis]
                colour = PALETTE[1] if technique == name else PALETTE[2]
                panel.plot(
                    *_changes(np.asarray(fused.time) * 1e-9, values), color=colour, linewidth=1.4, label=technique
                )
    panel.plot([], [], color=PALETTE[0], linewidth=0.5, label="single sensors")
    panel.set(xlabel="time (s)", ylabel=f"{unit}, less the first 10 s")
    return _svg(figure, panel)


def _changes(time_s: Floats, values: Floats) -> View:
    """Means of a second of readings at 50 Hz, less the mean of the first ten."""
    middle_s, blocks = _blocks(np.asarray(time_s), values, 50)
    means = blocks.mean(axis=1)
    return middle_s, means - means[:10].mean()


def pictures() -> Iterator[tuple[str, bytes]]:
    """Every picture, with its path below docs/images/."""
    for folder, names, draw in (
        ("effects", EXAMPLES, picture), ("probes", PROBE_EXAMPLES, probe_picture), ("chips", CHIPS, chip_picture),
        ("techniques", TECHNIQUE_EXAMPLES, technique_picture),
    ):  # fmt: skip
        for name in names:
            yield f"{folder}/{name}.svg", draw(name)
