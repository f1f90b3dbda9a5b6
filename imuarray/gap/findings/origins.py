"""Causes that come of the surroundings, told from faults of sensors: what all feel along the box's axes."""

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

SAME_HZ = 0.01
"""Lines whose frequencies differ by no larger share are one."""

WANDER: Mapping[Pace, frozenset[str]] = MappingProxyType(
    {
        "slow": frozenset({"bias_instability", "random_walk", "common_mode", "popcorn_noise"}),
        "fast": frozenset({"bias_instability", "common_mode", "white_noise"}),
    }
)
"""Effects that a stimulus of that pace is taken for."""

_LEAST_SENSORS = 3


def with_origins(
    causes: Sequence[Cause], headers: Mapping[str, SensorHeader], shared: Sequence[SharedSignal] = ()
) -> tuple[Cause, ...]:
    """The causes, those that come of the box's surroundings with the origin "environment".

    A `tone` does where the same line (`lines_of`) is in each of its sensors. A wander does where its sensors are among
    those of a stimulus of `environment_of` that explains at least half of it, along the axes on which it mostly is.
    """
    lines = lines_of(causes, headers)

    def is_felt(cause: Cause) -> bool:
        if cause.effect == "tone":
            return any(any(cause is one for one in line.causes) for line in lines)
        return bool(cause.sensors) and all(_wanders_with(cause, headers[name], shared) for name in cause.sensors)

    return tuple(
        replace(cause, origin="environment")
        if cause.origin == "sensor" and cause.action == "add" and is_felt(cause)
        else cause
        for cause in causes
    )


@dataclass(frozen=True)
class Line:
    """One line that reaches several sensors, along the box axis `axis` ("" if they show it along different ones);
    `causes` are the tones that are nothing else.
    """

    frequency_hz: float
    axis: str
    sensors: tuple[str, ...]
    causes: tuple[Cause, ...]


def lines_of(causes: Sequence[Cause], headers: Mapping[str, SensorHeader]) -> tuple[Line, ...]:
    """The lines that are no fault of a sensor, of the added causes `tone`.

    Frequencies agree within 1 %, and amplitudes in the box within a factor of 1.5, of two chips that measure the same;
    of accelerometers and gyroscopes, the frequency alone. Half of the array's sensors of each quantity show it. Of a
    single chip all must, three at least, and not as well along their own axes: its design may have the line.
    """
    tones = [_Tone.of(cause, headers[name]) for cause in causes if _is_tone(cause) for name in cause.sensors]
    found = []
    while tones:
        first = tones[0]
        together = [tone for tone in tones if _is_one_line(first, tone)]
        tones = [tone for tone in tones if not _is_one_line(first, tone)]
        if _reaches(together, headers):
            names = tuple(dict.fromkeys(tone.header.name for tone in together))
            axes = {_strongest(tone) for tone in together}
            own = tuple(cause for cause in causes if _is_whole(cause, together))
            found.append(Line(first.frequency_hz, axes.pop() if len(axes) == 1 else "", names, own))
    return tuple(found)


def notes_of(lines: Sequence[Line], shared: Sequence[SharedSignal] = ()) -> tuple[str, ...]:
    """What the box felt, in sentences."""
    told = [
        f"{_listed(line.sensors)} show the same line at {line.frequency_hz:.1f} Hz"
        f"{f' along the box axis {line.axis}' if line.axis else ''}: a vibration that reaches all of them, not a fault "
        "of the sensors."
        for line in lines
    ]
    words = {"slow": "wander together", "fast": "shake together"}
    told += [
        f"{_listed(one.sensors)} {words[one.pace]} along the box axis {one.axis} in phase {one.phase!r} (correlation "
        f"{one.correlation:.2g}), whichever way they are mounted: the box moved, not a fault of the sensors."
        for one in shared
    ]
    return tuple(told)


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
        own = np.abs(_sizes(table, f"amplitude_{header.unit}"))
        turned = np.abs(np.array(header.orientation)) @ own
        return cls(cause, header, float(table["frequency_hz"]), turned, own)


def _is_tone(cause: Cause) -> bool:
    return cause.effect == "tone" and cause.action == "add" and "frequency_hz" in cause.parameters


def _is_one_line(one: _Tone, other: _Tone) -> bool:
    if abs(one.frequency_hz - other.frequency_hz) > SAME_HZ * max(one.frequency_hz, other.frequency_hz):
        return False
    return one.header.quantity != other.header.quantity or _alike(one.amplitude_box, other.amplitude_box)


def _alike(one: Floats, other: Floats) -> bool:
    """Whether the axes on which there is much agree; small amplitudes may be lost in one chip's noise."""
    much = np.maximum(one, other) > max(one.max(), other.max()) / 3
    return bool((np.maximum(one, other)[much] <= AMPLITUDE_RATIO * np.minimum(one, other)[much]).all())


def _reaches(tones: Sequence[_Tone], headers: Mapping[str, SensorHeader]) -> bool:
    names, quantities = {tone.header.name for tone in tones}, {tone.header.quantity for tone in tones}
    there = [{name for name, header in headers.items() if header.quantity == quantity} for quantity in quantities]
    if any(2 * len(names & those) < len(those) for those in there):
        return False
    if len({tone.header.chip for tone in tones}) > 1:
        return True
    if len(names) < _LEAST_SENSORS or names != there[0]:
        return False
    return any(not _alike(tones[0].amplitude, tone.amplitude) for tone in tones)


def _is_whole(cause: Cause, tones: Sequence[_Tone]) -> bool:
    """Whether these are the cause's tones, in each of its sensors."""
    return {tone.header.name for tone in tones if tone.cause is cause} == {*cause.sensors}


def _strongest(tone: _Tone) -> str:
    return "XYZ"[int(tone.amplitude_box.argmax())]


def _wanders_with(cause: Cause, header: SensorHeader, shared: Collection[SharedSignal]) -> bool:
    """Whether half of the sensor's squared wander lies along axes of the box that show a stimulus."""
    axes = {
        one.axis
        for one in shared
        if cause.effect in WANDER[one.pace] and header.name in one.sensors and one.correlation >= LEAST_COMMON_SHARE
    }
    table = cause.each.get(header.name) or cause.parameters
    own = _sizes(table, f"rms_{header.unit}", f"amplitude_{header.unit}", f"density_{header.unit}_per_sqrt_s")
    squares = np.abs(np.array(header.orientation)) @ np.square(own)
    felt = sum(float(squares["XYZ".index(axis)]) for axis in axes)
    return felt > 0 and 2 * felt >= float(squares.sum())


def _sizes(table: Mapping[str, Any], *names: str) -> Floats:
    """(3,) the first of these parameters that there is; zeros without."""
    value = next((table[name] for name in names if name in table), 0.0)
    return np.asarray(np.broadcast_to(np.asarray(value, float), (3,)))


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
