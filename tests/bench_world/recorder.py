"""The program that records: when it polls each frame, and which frames it misses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tests.bench_world.chips import Array

START_S = 0.01
CLOSEST_SHARE = 0.35
"""Of a frame's period: frames do not follow each other faster."""
CATCH_UP_SHARE = 0.8
"""Of a frame's period: what a late frame makes up for."""


@dataclass(frozen=True)
class Recorder:
    """Frames a second, their mean delay in us, and how often in a log the computer stalls or misses frames."""

    rate_hz: int
    jitter_us: float = 60.0
    stalls: int = 0
    misses: int = 0


@dataclass(frozen=True)
class Frames:
    """The times (n,) s at which frames are polled, and (n,) whether frames before this are missing."""

    time_s: Array
    follows_loss: npt.NDArray[np.bool_]


def draw_frames(recorder: Recorder, duration_s: float, stream: np.random.Generator) -> Frames:
    """Return the frames of a log."""
    count = int((duration_s - 0.05) * recorder.rate_hz)
    due_s = START_S + np.arange(count) / recorder.rate_hz * (1 + stream.normal(0, 1e-5))
    late_s = stream.gamma(1.5, recorder.jitter_us * 1e-6 / 1.5, count)
    _add_stalls(late_s, recorder, stream)
    kept, follows_loss = _draw_misses(count, recorder, stream)
    time_s = np.maximum.accumulate(due_s + late_s)
    closest_s = CLOSEST_SHARE / recorder.rate_hz
    return Frames(_spread(time_s, closest_s)[kept], (follows_loss & kept)[kept])


def slots_s(sensors: int, rate_hz: float) -> list[float]:
    """Return how long after the frame's beginning each sensor is read, in s: 310 us and 260 us a sensor in turn,
    faster at more than 400 frames a second.
    """
    slots = [0.0]
    for index in range(sensors - 1):
        slots.append(slots[-1] + (260e-6 if index % 2 else 310e-6) * min(1, 400 / rate_hz))
    return slots


def _add_stalls(late_s: Array, recorder: Recorder, stream: np.random.Generator) -> None:
    if not recorder.stalls:
        return
    for start in stream.integers(len(late_s) // 10, len(late_s) - 30, recorder.stalls):
        delay_s, frame = stream.uniform(0.3, 3) / recorder.rate_hz, start
        while delay_s > 0 and frame < len(late_s):
            late_s[frame] += delay_s
            delay_s -= CATCH_UP_SHARE / recorder.rate_hz
            frame += 1


def _draw_misses(
    count: int, recorder: Recorder, stream: np.random.Generator
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    kept, follows_loss = np.ones(count, bool), np.zeros(count, bool)
    if recorder.misses:
        for start in np.sort(stream.integers(count // 10, count - 30, recorder.misses)):
            missing = int(stream.integers(1, 4))
            kept[start : start + missing] = False
            follows_loss[start + missing] = True
    return kept, follows_loss


def _spread(time_s: Array, closest_s: float) -> Array:
    times = time_s.tolist()
    for index in range(1, len(times)):
        times[index] = max(times[index], times[index - 1] + closest_s)
    return np.array(times)
