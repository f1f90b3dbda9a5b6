"""The cases of a run, by half, size and seed: the active mechanisms, their size, and the recording.

Severities are in units of the detection limit: for a random world this is the limit of the case itself
(`imuarray.validation.severity`), for the fixed plans a limit that was measured once (`imuarray.validation.bench`). The
seeds of the two halves are disjoint.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from types import MappingProxyType
from typing import Any, NamedTuple

from imuarray.errors import ConfigError
from imuarray.printable import printable
from imuarray.spelling import guess
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
"""The plan of a world that is drawn later."""

SEVERITIES = (0.5, 1.0, 2.0, 5.0, 20.0)
"""Sizes of single mechanisms in detection limits."""

STRONG = 5.0
"""Size of unnamed mechanisms, withheld mechanisms and pairs, whose severity is not varied."""

_SOMEWHERE_HIDDEN = frozenset((*AT_ONE_TEMPERATURE, *IN_ONE_ATTITUDE, *AT_REST, *IN_ONE_BOOT))

NEEDED_BY_UNNAMED: Mapping[str, str] = {
    "thermal_hysteresis": "heating",
    "vibration_rectification": "motion",
    "supply_droop": "motion",
}
"""The experiments that unnamed mechanisms need."""


NUISANCES = frozenset({"white_noise", "jitter"})
"""Effects that are nuisance quantities in a random world, whatever their size: the noise of a part, which is fitted,
and the delay of a busy recorder. Mechanisms that have only these effects are not recorded there.
"""

NEED_COMMON_ADDRESSES = frozenset({"mux_hang"})
"""Mechanisms by which a sensor is read instead of another one that has the same address on another channel."""

MANY_FACES = 4
"""Number of faces from which on a recording shows the same effects as a tumble. With two or more, no effect is
certainly hidden.
"""


def hidden_in(world: World, chip: str, *, for_sure: bool = False) -> frozenset[str]:
    """Return the effects that are probably hidden in a world, or with `for_sure` only those that are certainly hidden,
    on a sensor of a chip, according to the conditions that they need. A gain that follows temperature changes a
    constant reading as a bias that follows temperature does, and no world has a motion of a warm box: only an
    accelerometer that is heated on several faces shows it.
    """
    moves = "motion" in world.kinds and bool(world.recorder["reference"])
    accelerometers = sum(other != "l3g4200d" for other in world.inertial.values())
    is_level_known = accelerometers > 1 or world.strata["labels"] != "missing"
    turns = world.faces >= (2 if for_sure else MANY_FACES)
    needs: Mapping[tuple[str, ...], bool] = {
        AT_ONE_TEMPERATURE: "heating" in world.kinds,
        ("thermal_scale",): chip != "l3g4200d" and world.heated_faces > 1,
        tuple(set(IN_ONE_ATTITUDE) - {"g_sensitivity"}): moves or (turns and chip != "l3g4200d"),
        ("misalignment",): chip == "l3g4200d" or is_level_known,
        ("axis_error", "channel_swap"): (moves or turns) if chip == "l3g4200d" else is_level_known,
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
"""Effects that the model has for one sensor of a chip and that the sensor itself does not have."""

_SEEDS: Mapping[Half, int] = {"development": 1_000_000, "sealed": 2_000_000}
"""The first seed of each half; a million cases keep them apart."""


@dataclass(frozen=True)
class Size:
    """The numbers of cases: `controls` for each plan, or in total for random worlds; `singles` of each named mechanism
    at each of `severities`, `others` of it on each other fixed plan at the highest severity, `hidden` in recordings
    that cannot show it; `withheld` of each named and `unnamed` of each unnamed mechanism; `pairs` on different sensors
    and on the same sensor; `removals` of each extra effect. `mechanisms` restricts the mechanisms to these; `effects`
    restricts them to those that resemble any of these effects, and restricts the extra effects to these.

    The cases are in random `worlds`, or on the fixed `plans` of the emulated bench.
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
    effects: tuple[str, ...] = ()
    worlds: bool = False
    plans: tuple[str, ...] = tuple(PLANS)


SIZES: Mapping[str, Size] = {
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
"""Sizes by the names that the command accepts: "none" is for case folders alone, the next three are on the fixed plans.
"""

MOST_CASES = 10_000
"""Distance between the first seeds of two sets of cases, and therefore the maximum number of cases in a set."""
STRIDE = 10_000_000
"""Distance between the seeds of the worlds tried for one case; the halves stay disjoint."""
MOST_WORLDS = 2000
"""Maximum number of worlds tried for one case."""


class _DrawnCase(NamedTuple):
    """A case without number and seed."""

    kind: Kind
    plan: str
    names: tuple[str, ...] = ()
    limits: float = 0.0
    extra: Mapping[str, Any] = MappingProxyType({})
    together: bool = False
    is_hidden: bool = False


def restrict(
    size: Size, effects: Sequence[str] = (), severities: Sequence[float] = (), repeats: int | None = None
) -> Size:
    """Return a size with other mechanisms, severities or numbers; arguments that are not given change nothing.

    `effects` selects the mechanisms that resemble any of these effects, regardless of the size's own list, and excludes
    mechanisms without a name; controls stay. `severities` are some of `SEVERITIES`. `repeats` is the number of cases of
    each mechanism at each severity; the numbers of all other cases change in proportion and none becomes 0. ConfigError
    for an effect without a mechanism, and for another severity.
    """
    if effects:
        size = replace(size, mechanisms=(), effects=tuple(dict.fromkeys(effects)))
        known = {effect for fact in _mechanisms_of(replace(size, effects=())).values() for effect in fact["resembles"]}
        for effect in effects:
            if effect not in known:
                raise ConfigError(
                    f"effect {printable(effect)!r}: no case of this size has it; allowed are {', '.join(sorted(known))}"
                    + guess(effect, known)
                )
    for severity in severities:
        if severity not in SEVERITIES:
            allowed = ", ".join(f"{limits:g}" for limits in SEVERITIES)
            raise ConfigError(f"severity {severity:g} detection limits; allowed are {allowed}")
    if severities:
        size = replace(size, severities=tuple(sorted(set(severities))))
    if repeats is None:
        return size
    own = max(size.singles, size.others) or 1
    counts = {name: getattr(size, name) for name in _COUNTS}
    return replace(size, **{name: math.ceil(count * repeats / own) for name, count in counts.items() if count})


_COUNTS = ("controls", "singles", "others", "hidden", "withheld", "unnamed", "pairs", "removals")


def cases(half: Half, size: Size, seed: int = 0) -> list[Case]:
    """Return the numbered cases; each `seed` (0 to 99) gives a different set of the same half. ConfigError for more
    cases than `MOST_CASES`.
    """
    if not 0 <= seed < 100:
        raise ValueError(f"seed {seed}; allowed is 0 to 99")
    first = _SEEDS[half] + MOST_CASES * seed
    planned = list(_all(size))
    if len(planned) > MOST_CASES:
        raise ConfigError(f"{len(planned)} cases are planned; allowed are at most {MOST_CASES}")
    random.Random(first).shuffle(planned)  # a run that is stopped early covers every kind of case
    place = _world_case if size.worlds else _plan_case
    return [place(drawn, half, number, first + number) for number, drawn in enumerate(planned)]


def shuffle(planned: Sequence[Case], seed: int) -> list[Case]:
    """Return the cases in random order, so that a run that is stopped early covers every world."""
    if len({case.world for case in planned}) < 2:
        return list(planned)
    return random.Random(seed).sample(list(planned), len(planned))


def _mechanisms_of(size: Size) -> dict[str, dict[str, Any]]:
    """Return the generator's description of the mechanisms of a size."""
    return {
        name: fact
        for name, fact in mechanisms().items()
        if (not size.mechanisms or name in size.mechanisms)
        and (not size.effects or not set(size.effects).isdisjoint(fact["resembles"]))
        and not set(CHIPS.values()).isdisjoint(fact["touches"])
        and not (size.worlds and fact["resembles"] and NUISANCES.issuperset(fact["resembles"]))
    }


def _all(size: Size) -> Iterator[_DrawnCase]:
    facts = _mechanisms_of(size)
    named = [name for name, fact in facts.items() if fact["resembles"]]
    for plan in (RANDOM,) if size.worlds else size.plans:
        yield from [_DrawnCase("none", plan)] * size.controls
    for name in named:
        severities = size.severities if facts[name]["graded"] else size.severities[-1:]
        for limits in severities:
            yield from [_DrawnCase("single", FULL, (name,), limits)] * size.singles
        yield from _hidden(name, facts[name]["resembles"], size)
        yield from [_DrawnCase("withheld", FULL, (name,), STRONG)] * size.withheld
    for name in facts:
        if name not in named:
            yield from [_DrawnCase("unnamed", FULL, (name,), STRONG)] * size.unnamed
    choose = random.Random(0)
    apart = [name for name in named if facts[name]["place"] == "sensor"]
    for together in (False, True):
        possible = [
            (first, second)
            for first in apart
            for second in apart
            if first != second and (not together or set(facts[first]["touches"]) & set(facts[second]["touches"]))
        ]
        for _ in range(size.pairs if possible else 0):
            yield _DrawnCase("pair", FULL, choose.choice(possible), STRONG, together=together)
    for extra in EXTRAS:
        if size.effects and extra["effect"] not in size.effects:
            continue
        yield from [_DrawnCase("removal", FULL, extra=extra)] * size.removals


def _hidden(name: str, resembles: Collection[str], size: Size) -> Iterator[_DrawnCase]:
    """Yield cases of a mechanism in random worlds that do not show it, or on the fixed plans except the full one."""
    if size.worlds:
        if set(resembles) <= _SOMEWHERE_HIDDEN:
            yield from [_DrawnCase("single", RANDOM, (name,), size.severities[-1], is_hidden=True)] * size.hidden
        return
    for plan in size.plans:
        if plan != FULL:
            count = size.others + size.hidden * (set(resembles) <= HIDDEN[plan])
            yield from [_DrawnCase("single", plan, (name,), size.severities[-1])] * count


def _plan_case(drawn: _DrawnCase, half: Half, number: int, seed: int) -> Case:
    """Return the case on a fixed plan, with sensors drawn by its seed."""
    choose = random.Random(seed)
    sensors = _places(drawn, CHIPS, choose, lambda name, chip: True)
    if sensors is None:
        raise ValueError(f"{' and '.join(drawn.names)}: the bench has no sensors for it")
    facts = [mechanisms()[name] for name in drawn.names]
    puts = tuple(
        _put(name, fact["graded"], drawn.limits, chosen, CHIPS.get((*chosen, "")[0], ""))
        for name, fact, chosen in zip(drawn.names, facts, sensors, strict=True)
    )
    extra = {**drawn.extra, "sensor": _first_of(CHIPS, drawn.extra["chip"])} if drawn.extra else {}
    return replace(_case(drawn, half, number, seed), puts=puts, extra=extra, chips=dict(CHIPS))


def _world_case(drawn: _DrawnCase, half: Half, number: int, seed: int) -> Case:
    """Return the case in the first random world of its seed that can show it, with sensors drawn by its seed."""
    choose = random.Random(seed)
    for attempt in range(MOST_WORLDS):
        world = draw_world(seed + attempt * STRIDE)
        if NEED_COMMON_ADDRESSES.intersection(drawn.names) and not world.has_common_addresses:
            continue
        sensors = _places(drawn, world.inertial, choose, partial(_shows, drawn, world), world.twins())
        extra = {**drawn.extra, "sensor": _first_of(world.inertial, drawn.extra["chip"])} if drawn.extra else {}
        if sensors is None or (drawn.extra and not extra["sensor"]):
            continue
        puts = tuple(
            Put(name, math.nan, drawn.limits, chosen) for name, chosen in zip(drawn.names, sensors, strict=True)
        )
        return replace(
            _case(drawn, half, number, seed),
            plan=world.plan,
            puts=puts,
            extra=extra,
            chips=world.inertial,
            world=EMULATOR,
            draw=world.seed,
            is_hidden=drawn.is_hidden,
            strata=dict(world.strata),
        )
    raise ValueError(f"{' and '.join(drawn.names) or drawn.kind}: it does not show in any world")


def _shows(drawn: _DrawnCase, world: World, name: str, chip: str) -> bool:
    """Return whether a mechanism shows on a sensor of a chip in a world; for hidden cases, whether it does not show."""
    effects = mechanisms()[name]["resembles"]
    hidden = hidden_in(world, chip, for_sure=drawn.is_hidden)
    if not effects:
        return NEEDED_BY_UNNAMED.get(name, world.kinds[0]) in world.kinds
    return bool(set(effects) <= hidden) == drawn.is_hidden


def _places(
    drawn: _DrawnCase,
    chips: Mapping[str, str],
    choose: random.Random,
    can_show: Callable[[str, str], bool],
    twins: Sequence[tuple[str, str]] | None = None,
) -> list[tuple[str, ...]] | None:
    """Return the sensors of each mechanism: one sensor that both mechanisms of a pair can affect, or separate ones for
    each; None if there are not enough. A mechanism that itself determines where it acts has no sensors.
    """
    facts = [mechanisms()[name] for name in drawn.names]
    free = [
        [sensor for sensor, chip in chips.items() if chip in fact["touches"] and can_show(name, chip)]
        for name, fact in zip(drawn.names, facts, strict=True)
    ]
    if drawn.together:
        common = sorted(set.intersection(*map(set, free)))
        free = [[choose.choice(common)] if common else []] * len(free)
    taken: set[str] = set()
    placed = list[tuple[str, ...]]()
    for fact, sensors in zip(facts, free, strict=True):
        free_sensors = [sensor for sensor in sensors if sensor not in taken]
        chosen = _sensors(fact["place"], free_sensors, chips, choose, twins)
        if chosen is None:
            return None
        taken |= set() if drawn.together else set(chosen)
        placed.append(chosen)
    return placed


def _sensors(
    place: str,
    sensors: Sequence[str],
    chips: Mapping[str, str],
    choose: random.Random,
    twins: Sequence[tuple[str, str]] | None,
) -> tuple[str, ...] | None:
    """Return one sensor, two of a chip, or () if the mechanism determines where it acts; None if there are too few."""
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
    """Return the first sensor of a chip, "" if there is none."""
    return next((sensor for sensor, own in chips.items() if own == chip), "")


def _case(drawn: _DrawnCase, half: Half, number: int, seed: int) -> Case:
    """Return the case without its sensors."""
    resembles = tuple(tuple(mechanisms()[name]["resembles"]) for name in drawn.names)
    without = resembles[0] if drawn.kind == "withheld" else ()
    return Case(number, half, drawn.kind, drawn.plan, (), seed, without=without, resembles=resembles)


def _put(mechanism: str, is_graded: bool, limits: float, sensors: tuple[str, ...], chip: str) -> Put:
    """Place a mechanism at `limits` detection limits, or at the greatest severity if it cannot reach this size."""
    if not is_graded:
        return Put(mechanism, 1.0, math.nan, sensors)
    severity = limit(mechanism, chip) * limits
    is_possible = severity <= FURTHEST
    return Put(mechanism, severity if is_possible else FURTHEST, limits if is_possible else math.nan, sensors)
