"""Simulation of the vibrations of the surroundings that a recording shows at rest (`imuarray.gap.recording.vibration`).

Each replicate of a log draws its own vibrations with the power densities of the recorded ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import next_fast_len

from imuarray.arrays import Floats, Integers, Reals
from imuarray.gap.recording.vibration import Vibration
from imuarray.simulate.motion.stimulus import BoxStimulus, MotionVariant, temperature_at
from imuarray.simulate.streams import DrawMemory, Streams

_SAMPLES_A_PERIOD = 6.0
"""Number of samples per period of the highest frequency; between samples the vibration is interpolated linearly."""

_COLUMNS = {"specific_force": "force_box", "angular_rate": "rate_box"}


@dataclass(frozen=True)
class VibratingBox(MotionVariant):
    """A motion with `vibrations`, drawn from the streams `streams` of a replicate for log number `log`; `sensor` is the
    one that measures its private part ("": none). Courses are kept in the `memory`.
    """

    vibrations: Sequence[Vibration]
    streams: Streams
    log: int
    sensor: str
    memory: DrawMemory

    def stimulus(self, time_ns: Integers) -> BoxStimulus:
        """Return the stimuli of the box at times (n,), with these vibrations."""
        stimulus = self.motion.stimulus(time_ns)
        time_ns = np.asarray(time_ns)
        columns: dict[str, Floats] = {}
        for vibration in self.vibrations:
            within = (time_ns >= vibration.start_ns) & (time_ns < vibration.end_ns)
            if within.any():
                name = _COLUMNS[vibration.quantity]
                if name not in columns:
                    columns[name] = np.array(getattr(stimulus, name), float)
                columns[name][within] += self._course(vibration, time_ns[within])
        return replace(
            stimulus,
            force_box=columns.get("force_box", stimulus.force_box),
            rate_box=columns.get("rate_box", stimulus.rate_box),
        )

    def temperature_at(self, time_ns: Integers) -> Reals:
        """Return the temperature (n,) of the motion at times (n,)."""
        return temperature_at(self.motion, time_ns)

    def _course(self, vibration: Vibration, time_ns: Integers) -> Floats:
        """Return the vibration (n, 3) at times (n,)."""
        course = np.zeros((len(time_ns), 3))
        time_s = (time_ns - vibration.start_ns) * 1e-9
        step_s = 1 / (_SAMPLES_A_PERIOD * vibration.edges_hz[-1])
        for density, sensor in ((vibration.common, ""), (vibration.private, self.sensor)):
            if density.any() and (sensor or density is vibration.common):
                samples = self._samples(vibration, density, sensor, step_s)
                place = np.minimum(time_s / step_s, len(samples) - 1.001)
                whole = place.astype(np.int64)
                part = (place - whole)[:, None]
                course += samples[whole] * (1 - part) + samples[whole + 1] * part
        return course

    def _samples(self, vibration: Vibration, density: Floats, sensor: str, step_s: float) -> Floats:
        """Return the vibration (n, 3) at equal steps of time."""
        key = ("vibration", self.streams.seed, self.log, vibration.quantity, vibration.start_ns, sensor)

        def draw() -> Floats:
            stream = self.streams.of_unit(
                sensor, "vibration", vibration.quantity, f"log {self.log}", f"{vibration.start_ns}"
            )
            count = next_fast_len(2 + math.ceil((vibration.end_ns - vibration.start_ns) * 1e-9 / step_s), real=True)
            return noise_of(density, vibration.coherence, vibration.edges_hz, count, step_s, stream)

        return self.memory.recall(key, draw, lambda samples: int(samples.nbytes))


def noise_of(
    density: Floats,
    coherence: Floats,
    edges_hz: Sequence[float],
    count: int,
    step_s: float,
    stream: np.random.Generator,
) -> Floats:
    """Return normal noise (count, 3) with power densities (b, 3), per Hz, and correlations of the axes (b, 3, 3) in the
    bands between the edges (b + 1,).
    """
    hertz = np.fft.rfftfreq(count, step_s)
    normal = stream.standard_normal((2, len(hertz), 3))
    waves = np.zeros((len(hertz), 3), complex)
    for at, (low_hz, high_hz) in enumerate(pairwise(edges_hz)):
        inside = (hertz >= low_hz) & (hertz < high_hz)
        levels, axes = np.linalg.eigh(coherence[at])
        mixing = (axes * np.sqrt(np.maximum(levels, 0.0))) * np.sqrt(density[at])[:, None]
        waves[inside] = (normal[0, inside] + 1j * normal[1, inside]) @ mixing.T
    return np.fft.irfft(waves * (math.sqrt(count / step_s) / 2), count, axis=0)
