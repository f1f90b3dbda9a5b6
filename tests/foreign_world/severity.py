"""How large an effect has to be to be seen: a matched detection limit from the noise of the case itself.

The effect's trace d (n, 3) is the difference, before rounding, of the rows recorded with the effect and without it,
from the same random streams. What the parts' tolerances can explain is taken out of it first: least squares over all
logs on a constant per log, the chip's temperature, and the three true inputs (scale factor, misalignment).

`matched`: a detector that knows the trace has a signal-to-noise ratio of sqrt(sum(d**2) * u / sigma**2), with sigma the
noise of a row in closed form (density, filter, rounding) and u the share of independent rows, which is
min(1, 2 * noise bandwidth / poll rate). `energy`: of a random trace only the power can be known; octave by octave of
the spectrum, with m bins and a ratio r of the trace's power to the noise's, the ratio is sqrt(sum(m * r**2)).
`spectrum`: the same with r the relative change of the noise's power. The limit is the size at which this ratio is
`THRESHOLD`. `tolerance`: the limit is the part's tolerance; `count`: a number of events; `fixed`: there is no size.
A case's size is so many limits, but never less than what the data sheets allow (`Effect.least`).
"""

from __future__ import annotations

import numpy as np

from tests.foreign_world.chain import Signal, output_rms, record
from tests.foreign_world.deeds import Placement
from tests.foreign_world.effects import Effect
from tests.foreign_world.parts import Array, noise_bandwidth
from tests.foreign_world.world import World

THRESHOLD = 4.0
"""Ratio at the limit: chance alone reaches it once in 30000 (normal distribution, one side)."""
STEPS = 6
"""Of the search for the limit."""


def limit(world: World, effect: Effect, place: Placement) -> float | None:
    """Size of the effect at its detection limit, in the effect's unit; None where it has no size."""
    sensor = next(s for s in world.sensors if s.name == place.sensors[0])
    if effect.limit == "fixed":
        return None
    if effect.limit == "tolerance":
        return effect.start
    if effect.limit == "count":
        return effect.start * (sensor.divider / world.recorder.frame_rate_hz if effect.unit == "s" else 1.0)
    scale = 1.0 if not effect.unit.startswith("SI") else float(world.parts[sensor.name].noise_density[0])
    scale *= np.sqrt(noise_bandwidth(sensor, 2)) if effect.unit.startswith("SI") else 1.0
    size = effect.start * scale
    logs = range(len(world.experiments))
    plain = [record(world, sensor, log) for log in logs]
    silent = [record(world, sensor, log, noise=False) for log in logs]
    power = 1 if effect.limit == "matched" else 2
    for _ in range(STEPS):
        acts = effect.acts(place, size)[sensor.name]
        ratio = ratio_of(effect.limit, plain, silent, [record(world, sensor, log, acts) for log in logs])
        if (
            effect.limit == "spectrum"
        ):  # not a sum: the size is a quotient, and at 0.1 and below nothing is left to find
            if abs(ratio / THRESHOLD - 1) < 0.1 or not 0.1 < size < 50:
                break
            size = float(np.clip(size * np.sqrt(THRESHOLD / max(ratio, 0.1)) ** 0.7, 0.05, 60))
            continue
        if ratio == 0:
            size *= 30
            continue
        if abs(ratio / THRESHOLD - 1) < 0.02:
            break
        size *= float(np.clip((THRESHOLD / ratio) ** (1 / power), 1e-3, 1e3))
    return size


def ratio_of(kind: str, plain: list[Signal], silent: list[Signal], changed: list[Signal]) -> float:
    """Signal-to-noise ratio of the effect in these logs of one sensor; see the module's text."""
    sensor, part = plain[0].sensor, plain[0].part
    poll_rate = plain[0].world.recorder.frame_rate_hz / sensor.divider
    sigma = output_rms(sensor, part)
    independent = min(1.0, 2 * noise_bandwidth(sensor, part.filter_order) / poll_rate)
    traces = [after.analogue - before.analogue for after, before in zip(changed, plain, strict=True)]
    if kind == "matched":
        left = unexplained(traces, plain)
        return float(np.sqrt(np.sum(left**2 / sigma**2) * independent))
    total = 0.0
    for trace, before, clean in zip(traces, plain, silent, strict=True):
        noise = before.analogue - clean.analogue
        for axis in range(3):
            floor = octaves(noise[:, axis], sigma[axis])
            if kind == "energy":
                change = octaves(trace[:, axis] - trace[:, axis].mean(), 0.0)[1]
            else:
                rounding = octaves(np.zeros(len(noise)), np.sqrt(1 / 12))[1]
                floor = (floor[0], floor[1] + rounding)
                change = octaves(noise[:, axis] + trace[:, axis], 0.0)[1] + rounding - floor[1]
            bins, level = floor
            total += float(np.sum(bins * (change / np.maximum(level, 1e-12)) ** 2))
    return float(np.sqrt(total))


def octaves(values: Array, least_rms: float) -> tuple[Array, Array]:
    """Bins and mean power of each octave of the periodogram; at least the power of white noise of this rms below the
    lowest three, where too few bins tell.
    """
    power = np.abs(np.fft.rfft(values)[1:]) ** 2 / max(len(values), 1)
    edges = [0]
    while edges[-1] < len(power):
        edges.append(min(len(power), max(1, 2 * edges[-1])))
    starts = np.array(edges[:-1])
    bins = np.diff(edges).astype(float)
    level = np.add.reduceat(power, starts) / bins
    if least_rms:
        level[:3] = np.maximum(level[:3], least_rms**2)
    return bins, level


def unexplained(traces: list[Array], plain: list[Signal]) -> Array:
    """Traces of all logs without what tolerances explain; rows of all logs, one after the other."""
    lengths = [len(trace) for trace in traces]
    rows = sum(lengths)
    columns = np.zeros((rows, len(traces) + 4))
    start = 0
    for log, signal in enumerate(plain):
        stop = start + lengths[log]
        columns[start:stop, log] = 1
        columns[start:stop, -4] = signal.temperature[signal.sample] - 25
        columns[start:stop, -3:] = signal.felt[signal.sample]
        start = stop
    joined = np.concatenate(traces)
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    columns /= norms
    solution = np.linalg.lstsq(columns, joined, rcond=1e-9)[0]
    left: Array = joined - columns @ solution
    return left
