"""How fast error models run: triads with white noise, a Gauss-Markov bias and (ours alone) quantised counts.

Peers: pyins (python-ins), whose `Parameters.apply` adds white noise, an integrated bias and a 3x3 matrix; the error
model of gnss-ins-sim, which is on no package index: measured as it stands if it can be imported, else as a loop of the
same shape (a first-order recursion, axis by axis, row by row, beside vectorised white noise). And the bare cost of the
normal numbers: the same generator, the same number of draws as our effects ask for.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Callable

import numpy as np
import pandas as pd
from compare import Row, row
from pyins.inertial_sensor import Parameters

from imuarray.array import parse_array
from imuarray.simulate.effects.bias import BiasInstability
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.motion import Still
from imuarray.simulate.simulation import Simulation, plan_of
from imuarray.simulate.streams import CHUNK

RATE_HZ = 100.0
ROWS = 64 * CHUNK
SLOW_ROWS = CHUNK
ARRAY = parse_array(
    '[array]\nname = "one"\n[[sensor]]\nname = "A"\nchip = "bma180"\naddress = 0x40\nrange = 2\nbandwidth_hz = 150'
)
EFFECTS = (WhiteNoise((0.005, 0.005, 0.006)), BiasInstability((0.001, 0.001, 0.001), 100.0))


_DRAWS = 1 / 3
"""Share of the speed of the draws alone that is required."""


def rows() -> list[Row]:
    """Millions of triad samples a second; the sides take turns, the best of each counts."""
    name, loop = gnss_ins_sim()
    best = best_of(
        {
            "ours, float64": (lambda: simulate("float64"), ROWS),
            "ours, float32": (lambda: simulate("float32"), ROWS),
            "pyins Parameters.apply": (pyins, ROWS),
            name: (loop, SLOW_ROWS),
            "the normal draws alone, float64": (lambda: draws("float64"), ROWS),
            "the normal draws alone, float32": (lambda: draws("float32"), ROWS),
        }
    )
    return [
        against(peer, best[ours], best[peer], target)
        for ours, peer, target in (
            ("ours, float64", "pyins Parameters.apply", 3.0),
            ("ours, float64", name, 10.0),
            ("ours, float64", "the normal draws alone, float64", _DRAWS),
            ("ours, float32", "the normal draws alone, float32", _DRAWS),
        )
    ]


def against(peer: str, ours: float, theirs: float, target: float) -> Row:
    """One row."""
    name = f"white + Gauss-Markov + quantised triads against {peer}"
    return row(name, ours, theirs, "M triads/s", target, "higher")


def best_of(sides: dict[str, tuple[Callable[[], object], int]], rounds: int = 9) -> dict[str, float]:
    """The best of several rounds of each, in millions of rows a second of processor time."""
    seconds = dict.fromkeys(sides, math.inf)
    for _ in range(rounds):
        for name, (work, _) in sides.items():
            start = time.process_time()
            work()
            seconds[name] = min(seconds[name], time.process_time() - start)
    return {name: count / seconds[name] / 1e6 for name, (_, count) in sides.items()}


def simulate(dtype: str) -> None:
    """Our counts, chunk by chunk."""
    plan = plan_of(ARRAY, RATE_HZ, ROWS / RATE_HZ)
    sensor = Simulation(plan, Still(), {"A": EFFECTS}, seed=1, dtype=np.dtype(dtype)).sensors["A"]
    for start in range(0, ROWS, CHUNK):
        sensor.block(start, start + CHUNK)


def draws(dtype: str) -> None:
    """As many normal numbers as a triad of white noise takes: the Gauss-Markov bias's knots are a thousand times fewer
    than its time constant has rows.
    """
    generator = np.random.Generator(np.random.SFC64(1))
    kind = np.float32 if dtype == "float32" else np.float64
    for _ in range(ROWS // CHUNK):
        generator.standard_normal((CHUNK, 3), dtype=kind)


READINGS = pd.DataFrame(np.tile([0.0, 0.0, 9.8], (ROWS, 1)), index=np.arange(ROWS) / RATE_HZ, columns=["x", "y", "z"])


def pyins() -> None:
    """White noise, an integrated bias and the matrix, in one call."""
    Parameters(np.eye(3), np.zeros(3), 0.005, 0.001, rng=1).apply(READINGS, "rate")


def gnss_ins_sim() -> tuple[str, Callable[[], object]]:
    """The package's own error model, or a loop of its shape."""
    truth = np.tile([0.0, 0.0, 9.8], (SLOW_ROWS, 1))
    if importlib.util.find_spec("gnss_ins_sim"):
        from gnss_ins_sim.pathgen.pathgen import acc_gen

        errors = {"b": np.zeros(3), "b_drift": np.full(3, 1e-3), "b_corr": np.full(3, 100.0), "vrw": np.full(3, 5e-4)}
        return "gnss-ins-sim acc_gen", lambda: acc_gen(RATE_HZ, truth, errors)
    return "a loop of the shape of gnss-ins-sim's", lambda: looped(truth)


def looped(truth: np.ndarray) -> np.ndarray:
    """A Gauss-Markov recursion in a Python loop per axis, white noise at once."""
    drift = np.zeros_like(truth)
    generator = np.random.default_rng(1)
    keep, step = 1 - 1 / (RATE_HZ * 100.0), 1e-3 / RATE_HZ
    for axis in range(3):
        kicks = generator.standard_normal(len(truth))
        for at in range(1, len(truth)):
            drift[at, axis] = keep * drift[at - 1, axis] + step * kicks[at]
    return truth + drift + 0.005 * generator.standard_normal(truth.shape)
