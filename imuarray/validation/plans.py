"""Which cases there are: what is at work, how much of it, recorded how, by half, size and seed.

Severities are in units of the detection limit: of a random world, the one of the very case
(`imuarray.validation.severity`); of the fixed plans, one that was measured once (`imuarray.validation.bench`). No seed
of one half is one of the other.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from types import MappingProxyType
from typing import Any, NamedTuple

from imuarray.validation.bench import (
    AT_ONE_TEMPERATURE,
    AT_REST,
    CHIPS,
    FULL,
    HIDDEN,
    IN_ONE_ATTITUDE,
    IN_ONE_BOOT,
    PLANS,
    limit,
)
from imuarray.validation.case import Case, Half, Kind, Put
from imuarray.validation.generator import mechanisms
from imuarray.validation.severity import FURTHEST
from imuarray.validation.worlds import World, draw_world

EMULATOR = "emulator"
"""The random worlds of the emulated array."""
RANDOM = ""
"""The plan of a world that is yet to be drawn."""

SEVERITIES = (0.5, 1.0, 2.0, 5.0, 20.0)
"""In detection limits."""

STRONG = 5.0
"""Of what is not told by severity: unnamed and withheld mechanisms, pairs."""

_SOMEWHERE_HIDDEN = frozenset((*AT_ONE_TEMPERATURE, *IN_ONE_ATTITUDE, *AT_REST, *IN_ONE_BOOT))

NEEDED_BY_UNNAMED: Mapping[str, str] = MappingProxyType(
    {"thermal_hysteresis": "heating", "vibration_rectification": "motion", "supply_droop": "motion"}
)
"""Experiments that mechanisms without a name need."""


MANY_FACES = 4
"""So many faces show what a tumble does; from two on nothing is hidden for sure."""


def hidden_in(world: World, chip: str, *, for_sure: bool = False) -> frozenset[str]:
    """Effects that a world hardly shows, or can't show `for_sure`, on a sensor of that chip, by what they need."""
    moves = "motion" in world.kinds and bool(world.recorder["reference"])
    turns = world.faces >= (2 if for_sure else MANY_FACES)
    needs: Mapping[tuple[str, ...], bool] = {
        AT_ONE_TEMPERATURE: "heating" in world.kinds,
        tuple(set(IN_ONE_ATTITUDE) - {"g_sensitivity"}): moves or (turns and chip != "l3g4200d"),
        ("g_sensitivity",): moves or turns,
        AT_REST: moves,
        IN_ONE_BOOT: len(world.sessions) > (1 if for_sure else 3),
    }
    return frozenset(name for names, is_there in needs.items() if not is_there for name in names)


EXTRAS: tuple[Mapping[str, Any], ...] = (
    {"chip": "l3g4200d", "effect": "tone", "parameters": {"amplitude_dps": [0.0, 0.3, 0.0], "frequency_hz": 17.0}},
    {"chip": "bma180", "effect": "random_walk", "parameters": {"density_g_per_sqrt_s": [0.002, 0.002, 0.002]}},
    {"chip": "l3g4200d", "effect": "bandwidth", "parameters": {"cutoff_hz": 8.0}},
    {"chip": "bma180", "effect": "glitches", "parameters": {"probability": 0.01, "amplitude_g": 0.3}},
    {"chip": "adxl345", "effect": "stale_samples", "parameters": {"probability": 0.3}},
    {
        "chip": "l3g4200d",
        "effect": "bias_instability",
        "parameters": {"rms_dps": [0.3, 0.3, 0.3], "time_constant_s": 20.0},
    },
    {"chip": "bma180", "effect": "turn_on_bias", "parameters": {"rms_g": [0.05, 0.05, 0.05]}},
    {"chip": "adxl345", "effect": "quantisation", "parameters": {"step_lsb": 4.0}},
)
"""Effects that a model is given for one sensor of a chip, and that the sensor has not."""

_SEEDS: Mapping[Half, int] = MappingProxyType({"development": 1_000_000, "sealed": 2_000_000})
"""The first seed of each half; a million cases keep them apart."""


@dataclass(frozen=True)
class Size:
    """How many cases: `controls` of each plan, or in all of random worlds; `singles` of each named mechanism at each of
    `severities`, `others` of it on each other fixed plan at the highest, `hidden` where it can't show; `withheld` of
    each named and `unnamed` of each other one; `pairs` on different sensors and on one; `removals` of each extra
    effect. Only `mechanisms`, if any are named.

    In random `worlds`, or on the fixed `plans` of the emulated bench.
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
    worlds: bool = False
    plans: tuple[str, ...] = tuple(PLANS)


SIZES: Mapping[str, Size] = MappingProxyType(
    {
        "none": Size(),
        "glance": Size(others=1, severities=(20.0,), mechanisms=("mains_ripple",), plans=("static",)),
        "reduced": Size(
            controls=1,
            singles=1,
            unnamed=1,
            severities=(20.0,),
            mechanisms=("mains_ripple", "power_on_stress", "stuck_bit", "interleaved_converters"),
        ),
        "bench": Size(controls=20, singles=1, hidden=1, withheld=1, unnamed=1, pairs=6, removals=1, severities=(2, 5)),
        "short": Size(
            controls=150,
            singles=2,
            hidden=2,
            withheld=1,
            unnamed=3,
            pairs=20,
            removals=1,
            severities=(2, 5),
            worlds=True,
        ),
        "medium": Size(controls=400, singles=3, hidden=1, withheld=2, unnamed=6, pairs=60, removals=3, worlds=True),
        "full": Size(controls=1000, singles=12, hidden=4, withheld=6, unnamed=20, pairs=200, removals=10, worlds=True),
    }
)
"""By the names that the command takes: "none" for folders of cases alone, the first three others on the fixed plans."""

STRIDE = 10_000_000
"""Between the seeds of the worlds that are looked at for one case; the halves stay apart."""
MOST_WORLDS = 2000
"""That are looked at for one case."""


class _Drawn(NamedTuple):
    """A case as yet without a number."""

    kind: Kind
    plan: str
    names: tuple[str, ...] = ()
    limits: float = 0.0
    extra: Mapping[str, Any] = MappingProxyType({})
    together: bool = False
    is_hidden: bool = False


def cases(half: Half, size: Size, seed: int = 0) -> list[Case]:
    """All of them, numbered; `seed` makes another set of the same half (0 to 99)."""
    if not 0 <= seed < 100:
        raise ValueError(f"seed {seed}; allowed is 0 to 99")
    first = _SEEDS[half] + 10_000 * seed
    drawn = list(_all(size))
    random.Random(first).shuffle(drawn)  # a run that is stopped early has something of everything
    place = _in_a_world if size.worlds else _on_the_bench
    return [place(one, half, number, first + number) for number, one in enumerate(drawn)]


def shuffled(planned: Sequence[Case], seed: int) -> list[Case]:
    """So that a run that is stopped early has something of every world."""
    if len({one.world for one in planned}) < 2:
        return list(planned)
    return random.Random(seed).sample(list(planned), len(planned))


def _all(size: Size) -> Iterator[_Drawn]:
    facts = {name: one for name, one in mechanisms().items() if (not size.mechanisms or name in size.mechanisms)}
    named = [name for name, one in facts.items() if one["resembles"]]
    for plan in (RANDOM,) if size.worlds else size.plans:
        yield from [_Drawn("none", plan)] * size.controls
    for name in named:
        severities = size.severities if facts[name]["graded"] else size.severities[-1:]
        for limits in severities:
            yield from [_Drawn("single", FULL, (name,), limits)] * size.singles
        yield from _hidden(name, facts[name]["resembles"], size)
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


def _hidden(name: str, resembles: Collection[str], size: Size) -> Iterator[_Drawn]:
    """Cases of a mechanism where it doesn't show, and on the fixed plans that aren't full."""
    if size.worlds:
        if set(resembles) <= _SOMEWHERE_HIDDEN:
            yield from [_Drawn("single", RANDOM, (name,), size.severities[-1], is_hidden=True)] * size.hidden
        return
    for plan in size.plans:
        if plan != FULL:
            count = size.others + size.hidden * (set(resembles) <= HIDDEN[plan])
            yield from [_Drawn("single", plan, (name,), size.severities[-1])] * count


def _on_the_bench(one: _Drawn, half: Half, number: int, seed: int) -> Case:
    """On a fixed plan, with sensors by its seed."""
    choose = random.Random(seed)
    sensors = _places(one, CHIPS, choose, lambda name, chip: True)
    if sensors is None:
        raise ValueError(f"{' and '.join(one.names)}: the bench has no sensors for it")
    facts = [mechanisms()[name] for name in one.names]
    puts = tuple(
        _put(name, fact["graded"], one.limits, chosen, CHIPS.get((*chosen, "")[0], ""))
        for name, fact, chosen in zip(one.names, facts, sensors, strict=True)
    )
    extra = {**one.extra, "sensor": _first_of(CHIPS, one.extra["chip"])} if one.extra else {}
    return _case(one, half, number, seed, puts, extra, one.plan, CHIPS)


def _in_a_world(one: _Drawn, half: Half, number: int, seed: int) -> Case:
    """In the first random world of its seed that has what the case needs, with sensors by its seed."""
    choose = random.Random(seed)
    for attempt in range(MOST_WORLDS):
        world = draw_world(seed + attempt * STRIDE)
        sensors = _places(one, world.inertial, choose, partial(_shows, one, world), world.twins())
        extra = {**one.extra, "sensor": _first_of(world.inertial, one.extra["chip"])} if one.extra else {}
        if sensors is None or (one.extra and not extra["sensor"]):
            continue
        puts = tuple(Put(name, math.nan, one.limits, chosen) for name, chosen in zip(one.names, sensors, strict=True))
        about = {"world": EMULATOR, "draw": world.seed, "is_hidden": one.is_hidden, "strata": dict(world.strata)}
        return _case(one, half, number, seed, puts, extra, world.plan, world.inertial, **about)
    raise ValueError(f"{' and '.join(one.names) or one.kind}: no world shows it")


def _shows(one: _Drawn, world: World, name: str, chip: str) -> bool:
    """Whether a mechanism shows on a sensor of that chip in that world; or hides, if that is asked for."""
    effects = mechanisms()[name]["resembles"]
    hidden = hidden_in(world, chip, for_sure=one.is_hidden)
    if not effects:
        return NEEDED_BY_UNNAMED.get(name, world.kinds[0]) in world.kinds
    return bool(set(effects) <= hidden) == one.is_hidden


def _places(
    one: _Drawn,
    chips: Mapping[str, str],
    choose: random.Random,
    can_show: Callable[[str, str], bool],
    twins: Sequence[tuple[str, str]] | None = None,
) -> list[tuple[str, ...]] | None:
    """Sensors of each mechanism: those that both of a pair can be put on, or two, one for each; None if there are not
    enough. None of its own has a mechanism that goes wherever it can.
    """
    facts = [mechanisms()[name] for name in one.names]
    free = [
        [sensor for sensor, chip in chips.items() if chip in fact["touches"] and can_show(name, chip)]
        for name, fact in zip(one.names, facts, strict=True)
    ]
    if one.together:
        common = sorted(set.intersection(*map(set, free)))
        free = [[choose.choice(common)] if common else []] * len(free)
    taken: set[str] = set()
    found = list[tuple[str, ...]]()
    for fact, sensors in zip(facts, free, strict=True):
        left = [sensor for sensor in sensors if sensor not in taken]
        chosen = _sensors(fact["place"], left, chips, choose, twins)
        if chosen is None:
            return None
        taken |= set() if one.together else set(chosen)
        found.append(chosen)
    return found


def _sensors(
    place: str,
    sensors: Sequence[str],
    chips: Mapping[str, str],
    choose: random.Random,
    twins: Sequence[tuple[str, str]] | None,
) -> tuple[str, ...] | None:
    """One, two of a chip, or none where the mechanism itself says where it goes; None if there are not enough."""
    if place == "sensor":
        return (choose.choice(sensors),) if sensors else None
    if place == "pair":
        pairs = [
            (first, second)
            for first, second in (combinations(chips, 2) if twins is None else twins)
            if chips[first] == chips[second] and first in sensors and second in sensors
        ]
        return choose.choice(pairs) if pairs else None
    common = Counter(chips[sensor] for sensor in sensors)
    return () if common and (place != "design" or max(common.values()) > 1) else None


def _first_of(chips: Mapping[str, str], chip: str) -> str:
    """The first sensor of that chip, "" if there is none."""
    return next((sensor for sensor, own in chips.items() if own == chip), "")


def _case(
    one: _Drawn,
    half: Half,
    number: int,
    seed: int,
    puts: tuple[Put, ...],
    extra: Mapping[str, Any],
    plan: str,
    chips: Mapping[str, str],
    **about: Any,
) -> Case:
    resembles = tuple(tuple(mechanisms()[name]["resembles"]) for name in one.names)
    without = resembles[0] if one.kind == "withheld" else ()
    more = {"without": without, "extra": extra, "resembles": resembles, "chips": dict(chips), **about}
    return Case(number, half, one.kind, plan, puts, seed, **more)


def _put(mechanism: str, is_graded: bool, limits: float, sensors: tuple[str, ...], chip: str) -> Put:
    """So many limits of it; what a fit hides whatever its severity, or nearly, is there at its greatest."""
    if not is_graded:
        return Put(mechanism, 1.0, math.nan, sensors)
    severity = limit(mechanism, chip) * limits
    is_possible = severity <= FURTHEST
    return Put(mechanism, severity if is_possible else FURTHEST, limits if is_possible else math.nan, sensors)
