"""Which cases there are: what is at work, how much of it, recorded how, by half, size and seed.

Severities are in units of the detection limit, the severity at which the full plan just shows something; those were
measured on development seeds (`imuarray.validation.detection`). No seed of one half is one of the other.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

from imuarray.validation.case import Case, Half, Kind, Put
from imuarray.validation.generator import CHIPS, PLANS, mechanisms
from imuarray.validation.limits import FURTHEST, limit

FULL = "full"
"""The plan of all cases but controls, and of those that show what a shorter one can't."""

SEVERITIES = (0.5, 1.0, 2.0, 5.0, 20.0)
"""In detection limits."""

STRONG = 5.0
"""Of what is not told by severity: unnamed and withheld mechanisms, pairs."""

_AT_ONE_TEMPERATURE = ("thermal_bias", "thermal_scale", "thermal_lag")
_IN_ONE_ATTITUDE = ("scale", "misalignment", "nonlinearity", "g_sensitivity", "saturation", "clock_error")
_AT_REST = ("skew", "size_effect")
_IN_ONE_BOOT = ("bias", "turn_on_bias", "bistable_bias")

HIDDEN: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "static": frozenset((*_AT_ONE_TEMPERATURE, *_IN_ONE_ATTITUDE, *_AT_REST, *_IN_ONE_BOOT)),
        "tumble": frozenset((*_AT_ONE_TEMPERATURE, *_AT_REST)),
        "heating": frozenset((*_IN_ONE_ATTITUDE, *_AT_REST)),
        "turn-on": frozenset((*_AT_ONE_TEMPERATURE, *_IN_ONE_ATTITUDE, *_AT_REST)),
    }
)
"""Effects that a plan can't show, by what they need: another temperature, face or boot, or motion.

What was measured to show is not among them (mechanisms at 5 limits, development seeds): a thermometer that is off shows
in every log beside the barometer's, a host that comes late in the repeats of gyroscopes that keep their own time, a
clock that is off by when the box is turned, and an output stage that gives out on the face on which it does.
"""

EXTRAS: tuple[Mapping[str, Any], ...] = (
    {"sensor": "Gyro1", "effect": "tone", "parameters": {"amplitude_dps": [0.0, 0.3, 0.0], "frequency_hz": 17.0}},
    {"sensor": "BMA1", "effect": "random_walk", "parameters": {"density_g_per_sqrt_s": [0.002, 0.002, 0.002]}},
    {"sensor": "Gyro3", "effect": "bandwidth", "parameters": {"cutoff_hz": 8.0}},
    {"sensor": "BMA3", "effect": "glitches", "parameters": {"probability": 0.01, "amplitude_g": 0.3}},
    {"sensor": "ADXL1", "effect": "stale_samples", "parameters": {"probability": 0.3}},
    {
        "sensor": "Gyro1",
        "effect": "bias_instability",
        "parameters": {"rms_dps": [0.3, 0.3, 0.3], "time_constant_s": 20.0},
    },
    {"sensor": "BMA1", "effect": "turn_on_bias", "parameters": {"rms_g": [0.05, 0.05, 0.05]}},
    {"sensor": "ADXL1", "effect": "quantisation", "parameters": {"step_lsb": 4.0}},
)
"""Effects that a model is given and the sensors have not."""

_SEEDS: Mapping[Half, int] = MappingProxyType({"development": 1_000_000, "sealed": 2_000_000})
"""The first seed of each half; a million cases keep them apart."""


@dataclass(frozen=True)
class Size:
    """How many cases: `controls` of each plan; `singles` of each named mechanism at each of `severities` on the full
    plan, `others` of it on each other plan at the highest, `hidden` on each that can't show it; `withheld` of each
    named and `unnamed` of each other one; `pairs` on different sensors and on one; `removals` of each extra effect.
    Only `mechanisms`, if any are named, and only `plans`.
    """

    controls: int = 0
    singles: int = 0
    others: int = 0
    hidden: int = 0
    withheld: int = 0
    unnamed: int = 0
    pairs: int = 0
    removals: int = 0
    severities: tuple[float, ...] = SEVERITIES
    mechanisms: tuple[str, ...] = ()
    plans: tuple[str, ...] = tuple(PLANS)


SIZES: Mapping[str, Size] = MappingProxyType(
    {
        "glance": Size(others=1, severities=(20.0,), mechanisms=("mains_ripple",), plans=("static",)),
        "reduced": Size(
            controls=1,
            singles=1,
            unnamed=1,
            severities=(20.0,),
            mechanisms=("mains_ripple", "power_on_stress", "stuck_bit", "interleaved_converters"),
        ),
        "short": Size(controls=20, singles=1, hidden=1, withheld=1, unnamed=1, pairs=6, removals=1, severities=(2, 5)),
        "medium": Size(controls=20, singles=1, others=1, withheld=1, unnamed=2, pairs=20, removals=2),
        "full": Size(controls=200, singles=20, others=4, withheld=4, unnamed=20, pairs=100, removals=12),
    }
)
"""By the names that the command takes."""


class _Drawn(NamedTuple):
    """A case as yet without a number."""

    kind: Kind
    plan: str
    names: tuple[str, ...] = ()
    limits: float = 0.0
    extra: Mapping[str, Any] = MappingProxyType({})
    together: bool = False


def cases(half: Half, size: Size, seed: int = 0) -> list[Case]:
    """All of them, numbered; `seed` makes another set of the same half (0 to 99)."""
    if not 0 <= seed < 100:
        raise ValueError(f"seed {seed}; allowed is 0 to 99")
    first = _SEEDS[half] + 10_000 * seed
    drawn = list(_all(size))
    random.Random(first).shuffle(drawn)  # a run that is stopped early has something of everything
    return [_case(one, half, number, first + number) for number, one in enumerate(drawn)]


def _all(size: Size) -> Iterator[_Drawn]:
    facts = {name: one for name, one in mechanisms().items() if (not size.mechanisms or name in size.mechanisms)}
    named = [name for name, one in facts.items() if one["resembles"]]
    for plan in size.plans:
        yield from [_Drawn("none", plan)] * size.controls
    for name in named:
        severities = size.severities if facts[name]["graded"] else size.severities[-1:]
        for limits in severities:
            yield from [_Drawn("single", FULL, (name,), limits)] * size.singles
        for plan in size.plans:
            if plan != FULL:
                count = size.others + size.hidden * (set(facts[name]["resembles"]) <= HIDDEN[plan])
                yield from [_Drawn("single", plan, (name,), size.severities[-1])] * count
        yield from [_Drawn("withheld", FULL, (name,), STRONG)] * size.withheld
    for name in facts:
        if name not in named:
            yield from [_Drawn("unnamed", FULL, (name,), STRONG)] * size.unnamed
    choose = random.Random(0)
    apart = [name for name in named if facts[name]["place"] == "sensor"]
    for together in (False, True):
        possible = [
            (first, second)
            for first in apart
            for second in apart
            if first != second and (not together or set(facts[first]["touches"]) & set(facts[second]["touches"]))
        ]
        for _ in range(size.pairs):
            yield _Drawn("pair", FULL, choose.choice(possible), STRONG, together=together)
    for extra in EXTRAS:
        yield from [_Drawn("removal", FULL, extra=extra)] * size.removals


def _case(one: _Drawn, half: Half, number: int, seed: int) -> Case:
    """With sensors, by its seed: those that both of a pair can be put on, or two, one for each."""
    choose = random.Random(seed)
    facts = [mechanisms()[name] for name in one.names]
    free = [[sensor for sensor, chip in CHIPS.items() if chip in fact["touches"]] for fact in facts]
    if one.together:
        free = [[choose.choice(sorted(set.intersection(*map(set, free))))]] * len(free)
    taken: set[str] = set()
    puts = []
    for name, fact, sensors in zip(one.names, facts, free, strict=True):
        chosen = _sensors(fact["place"], [sensor for sensor in sensors if sensor not in taken] or sensors, choose)
        taken |= set() if one.together else set(chosen)
        puts.append(_put(name, fact["graded"], one.limits, chosen))
    resembles = tuple(tuple(fact["resembles"]) for fact in facts)
    case = Case(number, half, one.kind, one.plan, tuple(puts), seed, extra=dict(one.extra), resembles=resembles)
    return replace(case, without=resembles[0]) if one.kind == "withheld" else case


def _put(mechanism: str, is_graded: bool, limits: float, sensors: tuple[str, ...]) -> Put:
    """So many limits of it; what a fit hides whatever its severity, or nearly, is there at its greatest."""
    if not is_graded:
        return Put(mechanism, 1.0, math.nan, sensors)
    severity = limit(mechanism, sensors) * limits
    is_possible = severity <= FURTHEST
    return Put(mechanism, severity if is_possible else FURTHEST, limits if is_possible else math.nan, sensors)


def _sensors(place: str, sensors: list[str], choose: random.Random) -> tuple[str, ...]:
    """One, two of a chip, or none where the mechanism itself says where it goes."""
    if place == "sensor":
        return (choose.choice(sensors),)
    if place == "pair":
        chip = choose.choice([chip for chip in set(CHIPS.values()) if list(CHIPS.values()).count(chip) > 1])
        return tuple(sensor for sensor in CHIPS if CHIPS[sensor] == chip)[:2]
    return ()
