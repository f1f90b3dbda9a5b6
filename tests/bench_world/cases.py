"""The thirty cases: nine controls, fifteen single faults, three without a name in the library of causes, three pairs.

The sizes of faults are in words as the experimenter noted them; "sd" is the standard deviation of the best estimate of
the fault from that recording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from tests.bench_world.arrays import adxl345, alone, bma180, l3g4200d, mpu6050, place
from tests.bench_world.chips import Sensor
from tests.bench_world.experiments import Experiment, Heat, faces, heating, spin, static, tumble, vehicle
from tests.bench_world.faults import (
    AxisError,
    BiasInstability,
    BistableBias,
    BurstNoise,
    DroppedSamples,
    Fault,
    ForceSensitivity,
    Glitches,
    Misalignment,
    Nonlinearity,
    PackageRelaxation,
    PopcornNoise,
    Quantisation,
    RandomWalk,
    RangeReset,
    RateError,
    Saturation,
    Scale,
    SizeEffect,
    Skew,
    Stuck,
    SweptTone,
    ThermalLag,
    ThermalScale,
    Tone,
)
from tests.bench_world.parts import Part
from tests.bench_world.recorder import Recorder

Kind = Literal["control", "single", "unknown", "pair"]
KINDS: tuple[Kind, ...] = ("control", "single", "unknown", "pair")
Parts = dict[str, Part]


def as_drawn(parts: Parts) -> Parts:
    """Return the specimens unchanged."""
    return parts


@dataclass(frozen=True)
class Case:
    """An array, an experiment for each log, a recorder, and what is wrong; `trim` changes the drawn specimens."""

    kind: Kind
    seed: int
    plan: str
    sensors: tuple[Sensor, ...]
    experiments: tuple[Experiment, ...]
    recorder: Recorder
    faults: tuple[Fault, ...] = ()
    supply_v: float = 2.5
    is_cold: bool = False
    trim: Callable[[Parts], Parts] = as_drawn


def _share_thermometer(parts: Parts) -> Parts:
    """Both halves of a six-axis chip have the same thermometer, place and clock."""
    half = parts["M_acc"]
    return parts | {
        "M_gyro": replace(
            parts["M_gyro"],
            thermometer_offset_k=half.thermometer_offset_k,
            heat_share=half.heat_share,
            time_constant_s=half.time_constant_s,
            clock_error=half.clock_error,
        )
    }


def _steep_slopes(parts: Parts) -> Parts:
    """Biases that change enough with temperature for a lag to be seen; within L3G-71."""
    slopes = {"G1": [0.018, -0.015, 0.022], "G2": [-0.012, 0.02, 0.009]}
    return parts | {name: replace(parts[name], bias_slope=np.array(slope)) for name, slope in slopes.items()}


_TURN_ONS = tuple(partial(static, duration_s=20, name=f"run {run}") for run in range(1, 7))
_RATE_TABLE = tuple(partial(spin, up=up) for up in ("+Z", "+X", "+Y"))
_RATE_TABLE_ARRAY = place(
    l3g4200d("G1", 250, "+X+Y+Z", 200, 25), l3g4200d("G2", 250, "-X+Y-Z", 200, 25), bma180("B1", 2, "+X+Y+Z", 20)
)

CONTROLS: dict[str, Case] = {
    "c1": Case(
        kind="control",
        seed=101,
        plan="still for 300 s at night",
        sensors=alone(adxl345("Acc", 4, "+X+Y+Z", 100)),
        experiments=(partial(static, duration_s=300),),
        recorder=Recorder(50, misses=3),
    ),
    "c2": Case(
        kind="control",
        seed=102,
        plan="six faces and check",
        sensors=place(
            adxl345("A1", 4, "+X+Y+Z", 200),
            adxl345("A2", 4, "-X-Y+Z", 200),
            bma180("B1", 4, "+Y-X+Z", 20),
            l3g4200d("G1", 500, "+X+Y+Z", 200, 25),
            l3g4200d("G2", 500, "+X-Y-Z", 200, 25),
        ),
        experiments=(partial(faces, check=True),),
        recorder=Recorder(60, stalls=2),
        supply_v=3.3,
    ),
    "c3": Case(
        kind="control",
        seed=103,
        plan="tumbled by hand, no track",
        sensors=place(
            l3g4200d("G1", 500, "+X+Y+Z", 400, 25),
            l3g4200d("G2", 500, "-X-Y+Z", 400, 25),
            l3g4200d("G3", 500, "+X-Y-Z", 400, 25),
            bma180("B1", 8, "+X+Y+Z", 40),
            bma180("B2", 4, "-Y+X+Z", 40),
            bma180("B3", 4, "+X-Y-Z", 40),
        ),
        experiments=(partial(tumble, moved_s=38, rate_dps=70, acceleration=1.0, rest_s=5),),
        recorder=Recorder(90, jitter_us=150, stalls=4),
    ),
    "c4": Case(
        kind="control",
        seed=104,
        plan="heated with a hair dryer",
        sensors=place(
            l3g4200d("G1", 250, "+X+Y+Z", 100, 12.5),
            l3g4200d("G2", 250, "-X+Y-Z", 100, 12.5),
            bma180("B1", 2, "+X+Y+Z", 10),
        ),
        experiments=(heating,),
        recorder=Recorder(40),
        is_cold=True,
    ),
    "c5": Case(
        kind="control",
        seed=105,
        plan="switched on six times, logs of 20 s",
        sensors=place(
            adxl345("A1", 2, "+X+Y+Z", 200), bma180("B1", 2, "+Y+X-Z", 40), l3g4200d("G1", 500, "+X+Y+Z", 200, 25)
        ),
        experiments=_TURN_ONS,
        recorder=Recorder(80),
        is_cold=True,
    ),
    "c6": Case(
        kind="control",
        seed=106,
        plan="rate table with reference, 3 logs",
        sensors=place(
            l3g4200d("G1", 250, "+X+Y+Z", 200, 25),
            l3g4200d("G2", 2000, "-X+Y-Z", 200, 25),
            bma180("B1", 2, "+X+Y+Z", 20),
        ),
        experiments=_RATE_TABLE,
        recorder=Recorder(80),
    ),
    "c7": Case(
        kind="control",
        seed=107,
        plan="vehicle, no track",
        sensors=place(
            *mpu6050(4, 500, "+X+Y+Z", 200), l3g4200d("G1", 250, "+X-Y-Z", 200, 25), adxl345("A1", 4, "-X-Y+Z", 200)
        ),
        experiments=(partial(vehicle, driven_s=55),),
        recorder=Recorder(100, jitter_us=200, stalls=3, misses=2),
        trim=_share_thermometer,
    ),
    "c8": Case(
        kind="control",
        seed=108,
        plan="still for 25 s and six faces, nine sensors",
        sensors=place(
            adxl345("A1", 16, "-X-Y+Z", 100),
            adxl345("A2", 16, "+X+Y+Z", 100),
            bma180("B1", 16, "-Y+X+Z", 10),
            bma180("B2", 16, "+Y+X-Z", 10),
            bma180("B3", 1.5, "-Y-X-Z", 10),
            bma180("B4", 1.5, "+Y-X+Z", 10),
            l3g4200d("G1", 2000, "+X+Y+Z", 100, 12.5),
            l3g4200d("G2", 2000, "+X-Y-Z", 100, 12.5),
            l3g4200d("G3", 250, "-X-Y+Z", 100, 12.5),
        ),
        experiments=(partial(static, duration_s=25), partial(faces, hold_s=5, turn_s=2)),
        recorder=Recorder(40),
    ),
    "c9": Case(
        kind="control",
        seed=109,
        plan="still for 32 s at 800 Hz, no thermometer",
        sensors=alone(replace(l3g4200d("Gyro", 500, "+X+Y+Z", 800, 110), has_thermometer=False)),
        experiments=(partial(static, duration_s=32),),
        recorder=Recorder(800, jitter_us=50),
    ),
}

SINGLES: dict[str, Case] = {
    "s01": Case(
        kind="single",
        seed=201,
        plan="still for 300 s at night",
        sensors=place(l3g4200d("G1", 250, "+X+Y+Z", 100, 12.5), l3g4200d("G2", 250, "+X-Y-Z", 100, 12.5)),
        experiments=(partial(static, duration_s=300),),
        recorder=Recorder(40),
        faults=(
            BiasInstability(
                sensor="G1", axes="y", corner_hz=0.15, size="1/f noise equals white noise at 0.15 Hz; about 16 sd"
            ),
        ),
    ),
    "s02": Case(
        kind="single",
        seed=202,
        plan="still for 200 s",
        sensors=place(bma180("B1", 2, "+X+Y+Z", 20), adxl345("A1", 4, "-X-Y+Z", 100)),
        experiments=(partial(static, duration_s=200),),
        recorder=Recorder(60, misses=2),
        faults=(
            PopcornNoise(
                sensor="B1",
                axes="x",
                step=0.00045,
                dwell_s=6,
                size="two states 0.45 mg apart, 6 s in each; 9 sd a stay, about 20 sd in all",
            ),
        ),
    ),
    "s03": Case(
        kind="single",
        seed=203,
        plan="still for 80 s",
        sensors=place(
            l3g4200d("G1", 500, "+X+Y+Z", 400, 50),
            l3g4200d("G2", 500, "-X+Y-Z", 400, 50),
            l3g4200d("G3", 500, "-X-Y+Z", 400, 50),
        ),
        experiments=(partial(static, duration_s=80),),
        recorder=Recorder(100, stalls=2),
        faults=(
            Tone(
                sensor="G2",
                axes="xy",
                frequency_hz=31.3,
                amplitude=(0.07, 0.045, 0),
                size="0.07 and 0.045 dps at 31.3 Hz; 20 and 13 sd",
            ),
        ),
    ),
    "s04": Case(
        kind="single",
        seed=204,
        plan="heated with a hair dryer",
        sensors=place(
            l3g4200d("G1", 250, "+X+Y+Z", 100, 12.5),
            l3g4200d("G2", 250, "-X-Y+Z", 100, 12.5),
            bma180("B1", 2, "+X+Y+Z", 10),
        ),
        experiments=(heating,),
        recorder=Recorder(40),
        faults=(
            ThermalLag(
                sensor="G1",
                lag_s=40,
                size="bias follows the chip's temperature 40 s late (slopes 0.018, -0.015, 0.022 dps/K); 15 to 25 sd",
            ),
        ),
        trim=_steep_slopes,
    ),
    "s05": Case(
        kind="single",
        seed=205,
        plan="heated with z up and with z down, 2 logs",
        sensors=place(bma180("B1", 2, "+X+Y+Z", 10), bma180("B2", 4, "-X+Y-Z", 10)),
        experiments=tuple(partial(heating, up=up, heat=Heat(25, 60, 60)) for up in ("+Z", "-Z")),
        recorder=Recorder(40),
        faults=(
            ThermalScale(
                sensor="B1",
                axes="z",
                per_k=(0, 0, 8e-4),
                size="0.08 %/K, 8 times the figure of the data sheet; 16 mg at +20 K",
            ),
        ),
    ),
    "s06": Case(
        kind="single",
        seed=206,
        plan="rate table with reference, 3 logs",
        sensors=_RATE_TABLE_ARRAY,
        experiments=_RATE_TABLE,
        recorder=Recorder(80),
        faults=(
            Misalignment(
                sensor="G2",
                axes="",
                rotation_deg=(5, -2, 0),
                size="turned by 5 deg about its x and -2 deg about its y; 10 tolerances",
            ),
        ),
    ),
    "s07": Case(
        kind="single",
        seed=207,
        plan="six faces",
        sensors=place(adxl345("A1", 4, "+X+Y+Z", 100), adxl345("A2", 4, "+Y-X+Z", 100), bma180("B1", 4, "-X-Y+Z", 20)),
        experiments=(faces,),
        recorder=Recorder(50),
        faults=(AxisError(sensor="A2", axes="y", order=(0, 1, 2), sign=(1, -1, 1), size="y has the wrong sign"),),
    ),
    "s08": Case(
        kind="single",
        seed=208,
        plan="six faces",
        sensors=place(
            l3g4200d("G1", 500, "+X+Y+Z", 200, 25),
            l3g4200d("G2", 500, "-X+Y-Z", 200, 25),
            adxl345("A1", 4, "+X+Y+Z", 100),
        ),
        experiments=(partial(faces, hold_s=9),),
        recorder=Recorder(60),
        faults=(
            ForceSensitivity(
                sensor="G1",
                axes="z",
                matrix=((0, 0, 0), (0, 0, 0), (0.12, 0, 0.06)),
                size="z: 0.12 dps/g along x, 0.06 dps/g along z; 20 sd",
            ),
        ),
    ),
    "s09": Case(
        kind="single",
        seed=209,
        plan="still for 60 s",
        sensors=place(adxl345("A1", 4, "+X+Y+Z", 100), adxl345("A2", 4, "-X-Y+Z", 100)),
        experiments=(partial(static, duration_s=60),),
        recorder=Recorder(100),
        faults=(Quantisation(sensor="A2", step=2, size="even codes only, with a noise of 0.75 codes"),),
    ),
    "s10": Case(
        kind="single",
        seed=210,
        plan="tumbled by hand, no track",
        sensors=place(
            l3g4200d("G1", 500, "+X+Y+Z", 400, 25),
            l3g4200d("G2", 500, "-X-Y+Z", 400, 25),
            bma180("B1", 4, "+X+Y+Z", 40),
            bma180("B2", 4, "-Y+X+Z", 40),
            bma180("B3", 4, "+X-Y-Z", 40),
        ),
        experiments=(partial(tumble, moved_s=45, rate_dps=60, acceleration=1.0),),
        recorder=Recorder(80, jitter_us=120),
        faults=(
            Glitches(
                sensor="B2", axes="y", share=0.004, jump_g=0.6, size="0.4 % of the rows jump by 0.4 to 0.8 g on y"
            ),
        ),
    ),
    "s11": Case(
        kind="single",
        seed=211,
        plan="tumbled by hand, no track",
        sensors=place(
            l3g4200d("G1", 500, "+X+Y+Z", 200, 25),
            l3g4200d("G2", 250, "-X-Y+Z", 200, 25),
            l3g4200d("G3", 500, "+X-Y-Z", 200, 25),
            adxl345("A1", 4, "+X+Y+Z", 200),
            adxl345("A2", 4, "-X+Y-Z", 200),
        ),
        experiments=(partial(tumble, moved_s=45, rate_dps=70, acceleration=0.8),),
        recorder=Recorder(80),
        faults=(Saturation(sensor="G3", axes="z", limit=110, size="z clips at 110 dps (range 500 dps; 70 dps rms)"),),
    ),
    "s12": Case(
        kind="single",
        seed=212,
        plan="switched on six times, logs of 20 s",
        sensors=place(
            l3g4200d("G1", 500, "+X+Y+Z", 200, 25),
            l3g4200d("G2", 500, "-X+Y-Z", 200, 25),
            bma180("B1", 2, "+Y+X-Z", 40),
        ),
        experiments=_TURN_ONS,
        recorder=Recorder(80),
        faults=(
            BistableBias(
                sensor="G2",
                jump=(0.9, -0.6, 0.15),
                states=(0, 1, 0, 0, 1, 1),
                since="runs 2, 5 and 6",
                size="0.9, -0.6, 0.15 dps between two states (0.06 dps from one switching on to the next)",
            ),
        ),
    ),
    "s13": Case(
        kind="single",
        seed=213,
        plan="six faces and check",
        sensors=place(bma180("B1", 8, "+X+Y+Z", 20), bma180("B2", 8, "-Y+X+Z", 20), adxl345("A1", 8, "+X+Y+Z", 200)),
        experiments=(partial(faces, check=True, hold_s=7),),
        recorder=Recorder(60),
        faults=(
            RangeReset(
                sensor="B2",
                codes_per_g=4096,
                onset_s=41.0,
                shift_g=(0.06, -0.05, 0.08),
                since="41 s",
                size="a range of 2 g instead of 8 g, and a zero shifted by 50 to 80 mg",
            ),
        ),
    ),
    "s14": Case(
        kind="single",
        seed=214,
        plan="vehicle, no track",
        sensors=place(
            l3g4200d("G1", 250, "+X+Y+Z", 400, 50),
            l3g4200d("G2", 250, "-X-Y+Z", 400, 50),
            bma180("B1", 4, "+X+Y+Z", 75),
            adxl345("A1", 4, "-X-Y+Z", 400),
        ),
        experiments=(partial(vehicle, driven_s=55),),
        recorder=Recorder(100, jitter_us=150),
        faults=(Skew(sensor="G2", delay_s=0.02, size="20 ms late, 5 times the delay of the filter; about 60 sd"),),
    ),
    "s15": Case(
        kind="single",
        seed=215,
        plan="still for 90 s",
        sensors=place(
            adxl345("A1", 4, "+X+Y+Z", 100), adxl345("A2", 4, "-X-Y+Z", 100), l3g4200d("G1", 250, "+X+Y+Z", 200, 25)
        ),
        experiments=(partial(static, duration_s=90),),
        recorder=Recorder(100),
        faults=(RateError(sensor="A2", rate_hz=25.0, size="25 Hz instead of 100 Hz; rows are flagged stale"),),
    ),
}

UNKNOWN: dict[str, Case] = {
    "u1": Case(
        kind="unknown",
        seed=301,
        plan="still for 100 s",
        sensors=place(
            l3g4200d("G1", 250, "+X+Y+Z", 200, 50),
            l3g4200d("G2", 250, "-X+Y-Z", 200, 50),
            bma180("B1", 2, "+X+Y+Z", 40),
        ),
        experiments=(partial(static, duration_s=100),),
        recorder=Recorder(80),
        faults=(
            BurstNoise(
                sensor="G1",
                axes="x",
                factor=1.9,
                length_s=2.0,
                every_s=12,
                size="1.9 times the noise for 2 s every 12 s, with the same mean",
            ),
        ),
    ),
    "u2": Case(
        kind="unknown",
        seed=302,
        plan="six faces and check",
        sensors=place(
            adxl345("A1", 4, "+X+Y+Z", 100),
            adxl345("A2", 4, "-X-Y+Z", 100),
            bma180("B1", 4, "+X+Y+Z", 20),
            l3g4200d("G1", 500, "+X+Y+Z", 200, 25),
        ),
        experiments=(partial(faces, order=("+Z", "-X", "-Z", "+Y", "+X", "-Y"), check=True),),
        recorder=Recorder(60),
        faults=(
            PackageRelaxation(
                sensor="A2",
                axes="z",
                g_per_g=0.02,
                time_constant_s=5,
                size="after each turn z creeps by 20 mg per g of the change, with a time constant of 5 s; 15 sd a face",
            ),
        ),
    ),
    "u3": Case(
        kind="unknown",
        seed=303,
        plan="still for 90 s",
        sensors=place(
            bma180("B1", 2, "+X+Y+Z", 75), bma180("B2", 2, "-X-Y+Z", 75), l3g4200d("G1", 250, "+X+Y+Z", 400, 50)
        ),
        experiments=(partial(static, duration_s=90),),
        recorder=Recorder(100),
        faults=(
            SweptTone(
                sensor="B1",
                axes="y",
                amplitude=0.0006,
                from_hz=8,
                to_hz=38,
                size="a sine of 0.6 mg that sweeps from 8 to 38 Hz in 90 s; 25 sd, 0.4 of the white noise",
            ),
        ),
    ),
}

PAIRS: dict[str, Case] = {
    "p1": Case(
        kind="pair",
        seed=401,
        plan="still for 130 s",
        sensors=place(
            l3g4200d("G1", 250, "+X+Y+Z", 100, 25),
            l3g4200d("G2", 250, "+X-Y-Z", 100, 25),
            bma180("B1", 2, "+X+Y+Z", 20),
        ),
        experiments=(partial(static, duration_s=130),),
        recorder=Recorder(60),
        faults=(
            RandomWalk(sensor="G1", axes="y", per_sqrt_s=0.012, size="0.012 dps per sqrt(s); 15 sd"),
            Stuck(sensor="B1", axes="x", onset_s=75.0, since="75 s", size="x repeats one code"),
        ),
    ),
    "p2": Case(
        kind="pair",
        seed=402,
        plan="rate table with reference, 3 logs",
        sensors=_RATE_TABLE_ARRAY,
        experiments=_RATE_TABLE,
        recorder=Recorder(80),
        faults=(
            Scale(sensor="G1", axes="x", share=(0.08, 0, 0), size="+8 %"),
            DroppedSamples(sensor="G2", share=0.05, size="5 % of the rows are missing, and the next is flagged"),
        ),
    ),
    "p3": Case(
        kind="pair",
        seed=403,
        plan="rate table with reference, 3 logs",
        sensors=_RATE_TABLE_ARRAY,
        experiments=_RATE_TABLE,
        recorder=Recorder(80),
        faults=(
            SizeEffect(
                sensor="B1",
                axes="",
                shift_mm=(40, 0, -15),
                size="40 mm along X and -15 mm along Z from where the configuration says; 28 mg at 150 dps",
            ),
            Nonlinearity(sensor="G2", axes="y", cubic=-0.025 / 150**2, size="2.5 % less at 150 dps, cubic (3.8 dps)"),
        ),
    ),
}

CASES: dict[str, Case] = CONTROLS | SINGLES | UNKNOWN | PAIRS
