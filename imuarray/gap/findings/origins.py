"""Causes in the environment: signals that all sensors measure along the box axes, and that are therefore no sensor
faults.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from imuarray.arrays import Floats
from imuarray.gap.findings.diagnosis import Cause
from imuarray.gap.statistics.environment import AMPLITUDE_RATIO, LEAST_COMMON_SHARE, Pace, SharedSignal
from imuarray.log.format import SensorHeader
from imuarray.printable import series

SAME_HZ = 0.01
"""Largest relative difference of the frequencies of one line."""

WANDER: Mapping[Pace, frozenset[str]] = MappingProxyType(
    {
        "slow": frozenset({"bias_instability", "random_walk", "common_mode", "popcorn_noise"}),
        "fast": frozenset({"bias_instability", "common_mode", "white_noise"}),
    }
)
"""Effects that a stimulus of that pace may be mistaken for."""

_LEAST_SENSORS = 3


def with_origins(
    causes: Sequence[Cause], headers: Mapping[str, SensorHeader], shared: Sequence[SharedSignal] = ()
) -> tuple[Cause, ...]:
    """Return the causes, with the origin "environment" for those in the environment of the box.

    A `tone` belongs to the environment if the same line (`lines_of`) is in each of its sensors. A wander does if its
    sensors share a stimulus of `environment_of` that explains at least half of it, along the axes in which most of it
    lies.
    """
    lines = lines_of(causes, headers)

    def is_felt(cause: Cause) -> bool:
        if cause.effect == "tone":
            return any(any(cause is known for known in line.causes) for line in lines)
        return bool(cause.sensors) and all(_wanders_with(cause, headers[name], shared) for name in cause.sensors)

    return tuple(
        replace(cause, origin="environment")
        if cause.origin == "sensor" and cause.action == "add" and is_felt(cause)
        else cause
        for cause in causes
    )


@dataclass(frozen=True)
class CommonLine:
    """A line that several sensors measure, along the box axis `axis` ("" if along different ones); `causes` are the
    tones that consist of it.
    """

    frequency_hz: float
    axis: str
    sensors: tuple[str, ...]
    causes: tuple[Cause, ...]


def lines_of(causes: Sequence[Cause], headers: Mapping[str, SensorHeader]) -> tuple[CommonLine, ...]:
    """Return the lines that are no sensor faults, from the added causes `tone`.

    Frequencies must agree within 1 %, and amplitudes in the box within a factor of 1.5 between two chips that measure
    the same quantity; between accelerometers and gyroscopes only the frequency counts. Half of the array's sensors of
    each quantity must show the line. If there is only one type of chip, all its units must show it, at least three, and
    not equally along their own axes, since its design may cause the line.
    """
    tones = [_Tone.of(cause, headers[name]) for cause in causes if _is_tone(cause) for name in cause.sensors]
    lines = []
    while tones:
        first = tones[0]
        together = [tone for tone in tones if _is_one_line(first, tone)]
        tones = [tone for tone in tones if not _is_one_line(first, tone)]
        if _reaches(together, headers):
            names = tuple(dict.fromkeys(tone.header.name for tone in together))
            axes = {_strongest(tone) for tone in together}
            line_causes = tuple(cause for cause in causes if _is_whole(cause, together))
            lines.append(CommonLine(first.frequency_hz, axes.pop() if len(axes) == 1 else "", names, line_causes))
    return tuple(lines)


def notes_of(lines: Sequence[CommonLine], shared: Sequence[SharedSignal] = ()) -> tuple[str, ...]:
    """Return sentences on what the box felt."""
    sentences = [
        f"{series(line.sensors)} have the same line at {line.frequency_hz:.1f} Hz"
        f"{f' along the box axis {line.axis}' if line.axis else ''}: a vibration of the box, not a fault of the "
        "sensors."
        for line in lines
    ]
    words = {"slow": "wander together", "fast": "shake together"}
    sentences += [
        f"{series(signal.sensors)} {words[signal.pace]} along the box axis {signal.axis} in phase {signal.phase!r} "
        f"(correlation {signal.correlation:.2g}), whatever their mounting: motion of the box, "
        "not a fault of the sensors."
        for signal in shared
    ]
    return tuple(sentences)


class _Tone(NamedTuple):
    """A line of one sensor: amplitudes (3,) along the box axes."""

    cause: Cause
    header: SensorHeader
    frequency_hz: float
    amplitude_box: Floats
    amplitude: Floats

    @classmethod
    def of(cls, cause: Cause, header: SensorHeader) -> _Tone:
        table = cause.each.get(header.name) or cause.parameters
        amplitude = np.abs(_sizes(table, f"amplitude_{header.unit}"))
        amplitude_box = np.abs(np.array(header.orientation)) @ amplitude
        return cls(cause, header, float(table["frequency_hz"]), amplitude_box, amplitude)


def _is_tone(cause: Cause) -> bool:
    return cause.effect == "tone" and cause.action == "add" and "frequency_hz" in cause.parameters


def _is_one_line(first: _Tone, other: _Tone) -> bool:
    if abs(first.frequency_hz - other.frequency_hz) > SAME_HZ * max(first.frequency_hz, other.frequency_hz):
        return False
    return first.header.quantity != other.header.quantity or _agree(first.amplitude_box, other.amplitude_box)


def _agree(first: Floats, other: Floats) -> bool:
    """Return whether large amplitudes agree on all axes; small ones may be lost in one chip's noise."""
    much = np.maximum(first, other) > max(first.max(), other.max()) / 3
    return bool((np.maximum(first, other)[much] <= AMPLITUDE_RATIO * np.minimum(first, other)[much]).all())


def _reaches(tones: Sequence[_Tone], headers: Mapping[str, SensorHeader]) -> bool:
    names, quantities = {tone.header.name for tone in tones}, {tone.header.quantity for tone in tones}
    there = [{name for name, header in headers.items() if header.quantity == quantity} for quantity in quantities]
    if any(2 * len(names & those) < len(those) for those in there):
        return False
    if len({tone.header.chip for tone in tones}) > 1:
        return True
    if len(names) < _LEAST_SENSORS or names != there[0]:
        return False
    return any(not _agree(tones[0].amplitude, tone.amplitude) for tone in tones)


def _is_whole(cause: Cause, tones: Sequence[_Tone]) -> bool:
    """Return whether these are the cause's tones in each of its sensors."""
    return {tone.header.name for tone in tones if tone.cause is cause} == {*cause.sensors}


def _strongest(tone: _Tone) -> str:
    return "XYZ"[int(tone.amplitude_box.argmax())]


def _wanders_with(cause: Cause, header: SensorHeader, shared: Collection[SharedSignal]) -> bool:
    """Return whether half of the sensor's squared wander is along axes of the box with a stimulus."""
    axes = {
        signal.axis
        for signal in shared
        if cause.effect in WANDER[signal.pace]
        and header.name in signal.sensors
        and signal.correlation >= LEAST_COMMON_SHARE
    }
    table = cause.each.get(header.name) or cause.parameters
    sizes = _sizes(table, f"rms_{header.unit}", f"amplitude_{header.unit}", f"density_{header.unit}_per_sqrt_s")
    squares = np.abs(np.array(header.orientation)) @ np.square(sizes)
    felt = sum(float(squares["XYZ".index(axis)]) for axis in axes)
    return felt > 0 and 2 * felt >= float(squares.sum())


def _sizes(table: Mapping[str, Any], *names: str) -> Floats:
    """Return the first of these parameters that exists (3,); zeros without any."""
    value = next((table[name] for name in names if name in table), 0.0)
    return np.asarray(np.broadcast_to(np.asarray(value, float), (3,)))
