"""Pictures of what an effect of the simulator does: the same simulated sensor with the effect and without it.

`docs/generate.py` adds them to the pages of the effects while the site is built.
"""

from __future__ import annotations

import io
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import imuarray as ia
from imuarray.atomic import draw_figure
from imuarray.figures import PALETTE, new_figure
from imuarray.log import Log
from imuarray.simulate import EFFECTS


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
    "white_noise": Example({"rms": (0.5, 0.5, 0.5)}, "White noise of 0.5 dps on top of the sensor's own."),
}  # fmt: skip


def picture(name: str) -> bytes:
    """The picture of an effect of `EXAMPLES` as SVG."""
    example = EXAMPLES[name]
    figure = new_figure(8.0, 2.6)
    panel = figure.subplots()
    level = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for label, colour in (("without", PALETTE[0]), (f"with {name}", PALETTE[1])):
            effects = [EFFECTS[name](**example.parameters)] if label != "without" else []
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # what the data sheets' model leaves out
                log = ia.simulate(
                    "martin2013", Path(folder) / f"{label}.h5", experiment=example.experiment, only=[example.sensor],
                    effects={example.sensor: effects}, seed=3, **example.conditions,
                )  # fmt: skip
            with log:
                time_s, values, unit = _curve(log, example)
            if label == "without" and example.sensor.startswith("Gyro"):
                level = float(np.median(values))  # the bias of this unit
            style: dict[str, Any] = {"marker": ".", "markersize": 3, "linestyle": "none"} if example.dots else {}
            panel.plot(time_s, values - level, color=colour, linewidth=0.8, label=label, **style)
    panel.set(xlabel="time (s)", ylabel=unit)
    panel.grid(linewidth=0.4, alpha=0.6)
    panel.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1, 1), borderpad=0, ncols=2)
    buffer = io.BytesIO()
    draw_figure(buffer, figure, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _curve(log: Log, example: Example) -> tuple[Any, Any, str]:
    """Times in s, readings in the sensor's unit by the data sheet, and the unit."""
    sensor = log[example.sensor]
    time_s = np.asarray(sensor.time[:]) * 1e-9
    return time_s, sensor.counts[:][:, example.axis] / sensor.sensitivity, sensor.unit
