"""Random worlds: for every case another array, plan, room, recorder and way of noting what was done.

::

    world = draw_world(1_000_042)     # a pure function of the seed
    world.table()                     # what the generator of cases records (`firmware_emulator.sessions`)

What decides most (how many sensors, which chips, how fast, which experiments, labels, timing, ...) is drawn by a
Kronecker sequence over consecutive seeds, one irrational step a quantity, so that any short run of seeds has something
of everything; the rest is drawn from streams of its own. Nothing here is beyond what data sheets, rooms and programs
are allowed to do: a case without a mechanism is an array in which nothing is wrong.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any
from zlib import crc32

import numpy as np

from imuarray.chips import CHIPS

Table = dict[str, Any]

MOST_ROWS = 30_000
"""Of all logs and sensors of a case together: so many are compared with forty replicates in some seconds of one
processor; the search for causes takes several times that."""
MOST_SECONDS = 600.0
"""Of all logs of a case together."""
MOST_READINGS_PER_S = 2500.0
"""Of all sensors: what a bus of 400 kHz carries (0.25 ms a triad), and a third to spare."""
RATES_HZ = (20.0, 25.0, 32.0, 50.0, 64.0, 100.0, 128.0, 200.0, 250.0, 400.0, 500.0, 1000.0)
KINDS = ("static", "tumble", "heating", "turn-on", "motion")
"""Of experiments, in the order in which they are done."""

QUANTITIES = (
    *("sensors", "chips", "twins", "rate", "rates", "plan", "poses", "heating", "labels", "recorder", "gaps"),
    *("thermometers", "barometer", "magnetometer", "reference", "draught", "vibration", "length"),
)
"""What is drawn evenly over consecutive seeds."""
_STEPS = tuple(math.sqrt(number) % 1 for number in range(2, 80) if all(number % factor for factor in range(2, number)))[
    : len(QUANTITIES)
]
"""Square roots of primes: no two quantities go round together."""

_ADDRESSES: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {chip: CHIPS[chip].addresses for chip in ("adxl345", "bma180", "l3g4200d")}
)
_CHANNELS = 4
MOST_SENSORS = 16
_FACES: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {
        "+Z": (0.0, 0.0, 1.0),
        "+X": (1.0, 0.0, 0.0),
        "+Y": (0.0, 1.0, 0.0),
        "-X": (-1.0, 0.0, 0.0),
        "-Y": (0.0, -1.0, 0.0),
        "-Z": (0.0, 0.0, -1.0),
    }
)
_AXES = tuple(
    f"{a}{x}{b}{y}{c}{z}"
    for x, y, z in itertools.permutations("XYZ")
    for a, b, c in itertools.product("+-", repeat=3)
    if (x + y + z in "XYZXY") == ((a + b + c).count("-") % 2 == 0)
)
"""The 24 right-handed ways to mount a chip."""

TILT_DEG = 1.0
"""How far a table is off the horizontal (one sigma), together with a box that is not square."""
HAND_DEG = 20.0
"""How far from a face a box lies that is put down by hand."""
DRIFT_DEGC_PER_H = 2.0
"""Of a room, either way, at most."""
DRAUGHT_DEGC = (0.03, 0.4)
"""Swings (rms) of the box's temperature in a draughty room."""
VIBRATION_G = (2e-5, 5e-4)
"""Peak of what a fridge or a fan does to a table: from what nobody feels to what a hand on the table just feels."""
VIBRATION_DPS_PER_G = 20.0
BUSY_SHARE, BUSY_MS = (0.005, 0.03), (0.05, 0.4)
"""Of the transactions on a busy board, so many wait, so long on average."""
STALLS_PER_MIN, STALL_S = (0.5, 2.0), (0.2, 2.0)
"""Of a recorder that now and then reads nothing."""

_LEAST_S: Mapping[str, float] = MappingProxyType(
    {"static": 20.0, "tumble": 42.0, "heating": 45.0, "turn-on": 20.0, "motion": 20.0}
)
"""With less an experiment shows nothing."""
_USUAL_S: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "static": (40.0, 300.0),
        "tumble": (60.0, 180.0),
        "heating": (120.0, 300.0),
        "turn-on": (30.0, 100.0),
        "motion": (25.0, 80.0),
    }
)
"""Where the time and the rows allow it."""


@dataclass(frozen=True)
class World:
    """What is drawn of one seed. `array` is its TOML text, `chips` says which chip each sensor is, `ranges` and `rates`
    how it is set and how often it is read; `sessions` are the logs, `room` and `recorder` what they are made with, all
    as tables of the generator; `strata` says in words what a judge may want apart.
    """

    seed: int
    array: str
    chips: Mapping[str, str]
    ranges: Mapping[str, float]
    rates: Mapping[str, float]
    kinds: tuple[str, ...]
    sessions: tuple[Table, ...]
    room: Table
    recorder: Table
    strata: Mapping[str, str]

    @property
    def plan(self) -> str:
        """Its experiments, "heating+static"; as `plan_of` names them."""
        return plan_of(self.kinds)

    @property
    def inertial(self) -> dict[str, str]:
        """The chips of its accelerometers and gyroscopes, by sensor."""
        return {name: chip for name, chip in self.chips.items() if chip in _ADDRESSES}

    @property
    def seconds(self) -> float:
        """Of all logs."""
        return float(sum(session["seconds"] for session in self.sessions))

    @property
    def rows(self) -> float:
        """Of all logs and sensors, about."""
        return self.seconds * sum(self.rates.values())

    @property
    def faces(self) -> int:
        """On how many different faces the box lies, about."""
        ups = np.array([pose["up"] for session in self.sessions for pose in session["poses"]])
        return len(set(np.argmax(ups @ np.array(list(_FACES.values())).T, axis=1).tolist()))

    def twins(self) -> list[tuple[str, str]]:
        """Pairs of sensors of one chip and range."""
        pairs = itertools.combinations(self.inertial, 2)
        return [(a, b) for a, b in pairs if (self.chips[a], self.ranges[a]) == (self.chips[b], self.ranges[b])]

    def table(self) -> Table:
        """For the generator, as JSON has it."""
        return {"array": self.array, "sessions": list(self.sessions), "room": self.room, "recorder": self.recorder}


def plan_of(kinds: Sequence[str]) -> str:
    """The name of a plan with these experiments."""
    return "+".join(sorted(set(kinds)))


def draw_world(seed: int) -> World:
    """The world of a seed. Consecutive seeds cover the strata evenly."""
    even = {name: (seed * step) % 1 for name, step in zip(QUANTITIES, _STEPS, strict=True)}
    kinds = _kinds(even["plan"])
    sensors = _sensors(even, _stream(seed, "array"), sum(_LEAST_S[kind] for kind in kinds))
    rate_hz, rates = _rates(even, sensors, kinds, _stream(seed, "rates"))
    lengths = _lengths(kinds, rates, even["length"], _stream(seed, "lengths"))
    labels = _choice(even["labels"], {"noted": 0.5, "missing": 0.2, "some wrong": 0.3})
    by_hand = even["poses"] < 0.5
    if labels == "some wrong" and ("tumble" not in kinds or by_hand):
        labels = "noted"
    limits = _motion_limits(sensors)
    sessions = [
        session for kind in kinds for session in _SESSIONS[kind](lengths[kind], _stream(seed, kind), even, limits)
    ]
    sessions = [_labelled(session, labels, _stream(seed, "labels")) for session in sessions]
    recorder = _recorder(even, rate_hz, _stream(seed, "recorder"))
    if "motion" not in kinds:
        recorder["reference"] = bool(even["reference"] < 0.3)
    for session in sessions:
        session["reference_hz"] = 500.0 if recorder["reference"] and session["motions"] else 0.0
    room = _room(even, _stream(seed, "room"))
    strata = {
        "sensors": str(sum(one["chip"] in _ADDRESSES for one in sensors)),
        "rate_hz": f"{rate_hz:g}",
        "rates": "different" if any(one.get("fifo") for one in sensors) else "one",
        "poses": ("by hand" if by_hand else "by faces") if "tumble" in kinds else "none",
        "labels": labels,
        "recorder": "busy" if recorder["share"] else "quiet",
        "gaps": "some" if recorder["stalls_per_min"] else "none",
        "thermometers": "read" if recorder["thermometers"] else "not read",
        "barometer": "there" if any(one["chip"] == "bmp180" for one in sensors) else "none",
        "magnetometer": "there" if any(one["chip"].startswith("hmc") for one in sensors) else "none",
        "reference": "there" if recorder["reference"] else "none",
        "draught": "there" if room["draught_degc"] else "none",
        "vibration": _choice(even["vibration"], _VIBRATIONS),
    }
    return World(
        seed,
        _toml(sensors),
        {one["name"]: one["chip"] for one in sensors},
        {one["name"]: one.get("range", 0.0) for one in sensors},
        rates,
        kinds,
        tuple(sessions),
        room,
        recorder,
        strata,
    )


def _stream(seed: int, key: str) -> np.random.Generator:
    """Random numbers of their own for everything that has a name."""
    return np.random.default_rng([seed, crc32(key.encode())])


def _choice(even: float, shares: Mapping[str, float]) -> str:
    """One of these by their shares of 1."""
    reached = 0.0
    for name, share in shares.items():
        reached += share
        if even < reached:
            return name
    return list(shares)[-1]


def _between(random: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Evenly by its logarithm, three digits."""
    low, high = np.log(bounds)
    return float(f"{math.exp(random.uniform(low, high)):.3g}")


def _kinds(even: float) -> tuple[str, ...]:
    """One of the 31 sets of experiments."""
    bits = 1 + int(even * (2 ** len(KINDS) - 1))
    return tuple(kind for place, kind in enumerate(KINDS) if bits >> place & 1)


def _sensors(even: Mapping[str, float], random: np.random.Generator, least_s: float) -> list[Table]:
    """Entries of the array's TOML; no more than can be read for `least_s`."""
    few = {"1": 0.15, "2": 0.15, "3": 0.2, "4": 0.15, "6": 0.2, "9": 0.1, "16": 0.05}
    most = int(_choice(even["sensors"], few))
    count = int(random.integers({"6": 5, "9": 7, "16": 10}.get(str(most), most), most + 1))
    count = min(count, int(MOST_ROWS / RATES_HZ[0] / least_s) - 2)  # beside them a barometer and a magnetometer
    kinds = 1 + int(even["chips"] * 3)
    mix = random.permutation(list(_ADDRESSES))[:kinds].tolist()
    slots = {chip: [(channel, address) for channel in range(_CHANNELS) for address in _ADDRESSES[chip]] for chip in mix}
    twins = even["twins"] < 0.6
    common = {chip: _range(chip, random) for chip in mix}
    found: list[Table] = []
    chosen = [mix[place % len(mix)] for place in range(count)] if count >= len(mix) else mix[:count]
    for chip in random.permutation(chosen).tolist():
        if not slots[chip]:
            continue
        channel, address = slots[chip].pop(int(random.integers(len(slots[chip]))))
        range_ = common[chip] if twins else _range(chip, random)
        name = f"{'Gyro' if chip == 'l3g4200d' else chip[:3].upper()}{1 + sum(one['chip'] == chip for one in found)}"
        found.append(
            {
                "name": name,
                "chip": chip,
                "channel": channel,
                "address": address,
                "range": range_,
                **_filter(chip, random),
                "axes": str(random.choice(_AXES)),
            }
        )
    if even["barometer"] < 0.4:
        found.append({"name": "Baro", "chip": "bmp180", "channel": 0, "address": CHIPS["bmp180"].addresses[0]})
    if even["magnetometer"] < 0.3:
        chip = str(random.choice(["hmc5883", "hmc5883l"]))
        range_ = float(random.choice([one for one in CHIPS[chip].sensitivity if one > 1]))
        place = {"channel": 1, "address": CHIPS[chip].addresses[0], "range": range_, "rate_hz": 75.0}
        found.append({"name": "Mag", "chip": chip, **place, "axes": str(random.choice(_AXES))})
    return found


def _range(chip: str, random: np.random.Generator) -> float:
    """One in which gravity does not clip, whatever the part's scale and bias."""
    return float(random.choice([one for one in CHIPS[chip].sensitivity if one >= 1.5]))


def _filter(chip: str, random: np.random.Generator) -> Table:
    """Data rate and filter, as far as they can be set."""
    spec, found = CHIPS[chip], dict[str, Any]()
    if spec.rates_hz:
        found["rate_hz"] = float(random.choice([one for one in spec.rates_hz if 50 <= one <= 1600]))
    if bandwidths := spec.allowed_bandwidths_hz(found.get("rate_hz", spec.fixed_rate_hz)):
        found["bandwidth_hz"] = float(random.choice(bandwidths))
    return found


def _rates(
    even: Mapping[str, float], sensors: list[Table], kinds: Sequence[str], random: np.random.Generator
) -> tuple[float, dict[str, float]]:
    """Frames a second, the highest of those that the draw, the bus and the budget of rows allow, and readings a second
    of each sensor: some accelerometers and gyroscopes of a third of the worlds have all their samples fetched from the
    chip's queue.
    """
    wanted = RATES_HZ[int(even["rate"] * len(RATES_HZ))]
    queued = [one for one in sensors if CHIPS[one["chip"]].has_fifo]
    if even["rates"] < 0.35 and wanted >= 50.0 and queued:
        for one in random.permutation(len(queued))[: max(1, len(queued) // 2)].tolist():
            slow = [rate for rate in CHIPS[queued[one]["chip"]].rates_hz if 50 <= rate <= min(400.0, 8 * wanted)]
            _queue(queued[one], float(random.choice(slow)), random)
    least_s = sum(_LEAST_S[kind] for kind in kinds)
    for rate_hz in reversed([one for one in RATES_HZ if one <= wanted]):
        rates = {one["name"]: _rate(one, rate_hz) for one in sensors}
        total = sum(rates.values())
        if total <= MOST_READINGS_PER_S and total * least_s <= MOST_ROWS:
            return rate_hz, rates
    for one in queued:
        one.pop("fifo", None)
    return RATES_HZ[0], {one["name"]: _rate(one, RATES_HZ[0]) for one in sensors}


def _queue(sensor: Table, rate_hz: float, random: np.random.Generator) -> None:
    """Its chip's queue is drained, at that data rate."""
    sensor |= {"fifo": True, "rate_hz": rate_hz}
    if bandwidths := CHIPS[sensor["chip"]].allowed_bandwidths_hz(rate_hz):
        sensor["bandwidth_hz"] = float(random.choice(bandwidths))


def _rate(sensor: Table, rate_hz: float) -> float:
    """Rows a second."""
    if sensor.get("fifo"):
        return float(sensor["rate_hz"])
    return CHIPS[sensor["chip"]].default_rate_hz if CHIPS[sensor["chip"]].on_demand else rate_hz


def _lengths(
    kinds: Sequence[str], rates: Mapping[str, float], even: float, random: np.random.Generator
) -> dict[str, float]:
    """Seconds of each experiment: as usual, or as much less as the time and the rows demand."""
    short = even < 0.3
    usual = {kind: _LEAST_S[kind] if short else _between(random, _USUAL_S[kind]) for kind in kinds}
    most_s = min(MOST_SECONDS, MOST_ROWS / sum(rates.values()))
    least_s = sum(_LEAST_S[kind] for kind in kinds)
    over = sum(usual.values()) - least_s
    share = min(1.0, max(most_s - least_s, 0.0) / over) if over > 0 else 0.0
    return {kind: round(_LEAST_S[kind] + share * (usual[kind] - _LEAST_S[kind]), 1) for kind in kinds}


def _leaning(face: str, degrees: float, random: np.random.Generator) -> list[float]:
    """A unit vector about so far from a face's."""
    up = np.array(_FACES[face]) + math.radians(degrees) * random.standard_normal(3) / math.sqrt(2)
    return [float(part) for part in up / np.linalg.norm(up)]


def _session(name: str, seconds: float, poses: list[Table], phases: list[list[Any]], **more: Any) -> Table:
    return {
        "name": name,
        "seconds": seconds,
        "poses": poses,
        "turn_s": 2.0,
        "stretches": [],
        "motions": [],
        "phases": phases,
        **more,
    }


def _static(seconds: float, random: np.random.Generator, even: Mapping[str, float], limits: Limits) -> list[Table]:
    face = "+Z" if random.random() < 0.6 else str(random.choice(list(_FACES)))
    pose = {"up": _leaning(face, TILT_DEG, random), "hold_s": seconds}
    return [_session("static", seconds, [pose], [[0.0, seconds, "static", face]])]


def _tumble(seconds: float, random: np.random.Generator, even: Mapping[str, float], limits: Limits) -> list[Table]:
    """By faces, in any order, all or some of them; or put down by hand, of which nobody says how it lay."""
    turn_s = float(random.choice([1.5, 2.0, 3.0]))
    most = int(seconds / (turn_s + 4.0))
    by_hand = even["poses"] < 0.5
    count = int(random.integers(6, max(min(most, 12), 6) + 1)) if by_hand else int(random.integers(4, min(most, 7) + 1))
    faces = random.permutation(list(_FACES)).tolist()
    faces = (faces + faces)[:count]
    hold_s = seconds / count - turn_s
    poses = [{"up": _leaning(face, HAND_DEG if by_hand else TILT_DEG, random), "hold_s": hold_s} for face in faces]
    phases = list[list[Any]]()
    for place, face in enumerate(faces):
        start_s, seen = place * (hold_s + turn_s), face in faces[:place]
        name = f"{face[1].lower()}_{'up' if face[0] == '+' else 'down'}{'_check' if seen else ''}"
        phases.append([start_s, start_s + hold_s, f"pose {place + 1}" if by_hand else name, "" if by_hand else face])
    return [_session("tumble", seconds, poses, phases, turn_s=turn_s)]


def _heating(seconds: float, random: np.random.Generator, even: Mapping[str, float], limits: Limits) -> list[Table]:
    """Up, down, by steps or in two pulses; on one face, or on another one from stretch to stretch."""
    course = _choice(even["heating"], {"up": 0.25, "up and down": 0.25, "steps": 0.25, "pulses": 0.25})
    peak, faces = float(random.uniform(35, 55)), random.permutation(list(_FACES)).tolist()
    rises = {
        "up": [("room", 24.0), ("heat", peak)],
        "up and down": [("room", 24.0), ("heat", peak), ("cool", 25.0)],
        "steps": [("room", 24.0), *(("heat", 24.0 + (peak - 24.0) * step / 3) for step in (1, 2, 3))],
        "pulses": [("room", 24.0), ("heat", peak - 8.0), ("cool", 25.0), ("heat", peak), ("cool", 26.0)],
    }[course]
    shares = np.array([0.5 if name == "room" else 1.0 for name, _ in rises])
    lengths = (seconds * shares / shares.sum()).tolist()
    several = random.random() < 0.4
    ups = [faces[place % 3] if several else faces[0] for place in range(len(rises))]
    lean = {face: _leaning(face, TILT_DEG, random) for face in faces}
    poses, phases, start_s, turn_s = list[Table](), list[list[Any]](), 0.0, 2.0
    for (name, _), length, up in zip(rises, lengths, ups, strict=True):
        poses.append({"up": lean[up], "hold_s": length - (turn_s if several else 0.0)})
        phases.append([start_s, start_s + poses[-1]["hold_s"], name, up])
        start_s += length
    if not several:
        poses = [{"up": lean[faces[0]], "hold_s": seconds}]
    stretches = [
        {"seconds": length, "towards_degc": towards, "constant_s": length * float(random.uniform(0.25, 0.6))}
        for (_, towards), length in zip(rises, lengths, strict=True)
    ]
    return [_session("heating", seconds, poses, phases, turn_s=turn_s, stretches=stretches)]


def _turn_on(seconds: float, random: np.random.Generator, even: Mapping[str, float], limits: Limits) -> list[Table]:
    """A series of power-ups, each a log."""
    each_s = float(random.choice([4.0, 6.0, 10.0]))
    logs = int(np.clip(seconds / each_s, 4, 12))
    each_s = round(seconds / logs, 2)
    face = str(random.choice(list(_FACES)))
    pose = {"up": _leaning(face, TILT_DEG, random), "hold_s": each_s}
    return [
        _session(f"boot_{run + 1:02d}", each_s, [pose], [[0.0, each_s, f"run {run + 1}", face]]) for run in range(logs)
    ]


@dataclass(frozen=True)
class Limits:
    """How far a motion may go without clipping: rad/s, and g beside gravity."""

    rate: float
    force_g: float


def _motion_limits(sensors: Sequence[Table]) -> Limits:
    rates = [one["range"] for one in sensors if one["chip"] == "l3g4200d"]
    forces = [one["range"] for one in sensors if CHIPS[one["chip"]].unit == "g"]
    return Limits(0.5 * math.radians(min(rates, default=500.0)), 0.25 * (min(forces, default=4.0) - 1.1))


def _motion(seconds: float, random: np.random.Generator, even: Mapping[str, float], limits: Limits) -> list[Table]:
    """At rest, rocked and shaken once to three times about any axis, at rest."""
    still_s = max(4.0, round(0.12 * seconds, 2))
    count = int(random.integers(1, 4))
    edges = np.linspace(still_s, seconds - still_s, count + 1).tolist()
    face = "+Z" if random.random() < 0.6 else str(random.choice(list(_FACES)))
    motions = []
    for start_s, end_s in itertools.pairwise(edges):
        axis = random.standard_normal(3)
        rock_hz = _between(random, (0.3, 2.0))
        motions.append(
            {
                "start_s": start_s,
                "end_s": end_s,
                "axis": (axis / np.linalg.norm(axis)).tolist(),
                "angle_rad": min(float(random.uniform(0.2, 0.9)), limits.rate / (2 * math.pi * rock_hz)),
                "rock_hz": rock_hz,
                "peak_g": min(float(random.uniform(0.0, 0.4)), limits.force_g),
                "shake_hz": _between(random, (1.0, 7.0)),
            }
        )
    phases = [[0.0, still_s, "static", face], [edges[0], edges[-1], "motion", ""], [edges[-1], seconds, "static", face]]
    pose = {"up": _leaning(face, TILT_DEG, random), "hold_s": seconds}
    return [_session("motion", seconds, [pose], phases, motions=motions)]


_SESSIONS = MappingProxyType(
    {"static": _static, "tumble": _tumble, "heating": _heating, "turn-on": _turn_on, "motion": _motion}
)


def _labelled(session: Table, labels: str, random: np.random.Generator) -> Table:
    """As somebody noted it: all; nothing; or two faces of a tumble confused."""
    if labels == "missing":
        return {**session, "phases": []}
    if labels == "some wrong" and session["name"] == "tumble":
        phases = [list(phase) for phase in session["phases"]]
        one, other = random.choice(len(phases), 2, replace=False).tolist()
        for place in (2, 3):
            phases[one][place], phases[other][place] = phases[other][place], phases[one][place]
        return {**session, "phases": phases}
    return session


def _recorder(even: Mapping[str, float], rate_hz: float, random: np.random.Generator) -> Table:
    busy, gaps = even["recorder"] < 0.4, even["gaps"] < 0.25
    share, mean_ms = _between(random, BUSY_SHARE), _between(random, BUSY_MS)
    per_min, stall_s = _between(random, STALLS_PER_MIN), _between(random, STALL_S)
    return {
        "rate_hz": rate_hz,
        "share": share if busy else 0.0,
        "mean_ms": mean_ms if busy else 0.0,
        "stalls_per_min": per_min if gaps else 0.0,
        "stall_s": stall_s if gaps else 0.0,
        "thermometers": even["thermometers"] < 0.7,
        "reference": even["reference"] < 0.7,
    }


_VIBRATIONS = {"none": 0.5, "fridge": 0.25, "fan": 0.25}


def _room(even: Mapping[str, float], random: np.random.Generator) -> Table:
    kind = _choice(even["vibration"], _VIBRATIONS)
    drift, swings = float(random.uniform(-1, 1)) * DRIFT_DEGC_PER_H / 3600, _between(random, DRAUGHT_DEGC)
    peak_g, direction = _between(random, VIBRATION_G), random.standard_normal(3)
    hz = float(random.uniform(24.0, 25.0) if kind == "fridge" else random.uniform(15.0, 60.0))
    vibrations = []
    if kind != "none":
        way = {"direction": (direction / np.linalg.norm(direction)).tolist(), "peak_dps": VIBRATION_DPS_PER_G * peak_g}
        cycle = {"cycle_s": 400.0, "share": 0.5} if kind == "fridge" else {}
        vibrations = [
            {"hz": hz, "peak_g": peak_g, **way, **cycle},
            {"hz": 2 * hz, "peak_g": 0.3 * peak_g, **way, **cycle},
        ]
    return {
        "degc": float(random.uniform(18, 28)),
        "drift_degc_per_s": drift,
        "vibrations": vibrations,
        "draught_degc": swings if even["draught"] < 0.4 else 0.0,
    }


def _toml(sensors: Sequence[Table]) -> str:
    """Of an array with a multiplexer."""
    lines = ["[array]", 'name = "bench"', 'mux = { chip = "pca9544a", address = 0x70 }']
    for one in sensors:
        lines += ["[[sensor]]", *(f"{key} = {_value(value)}" for key, value in one.items())]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else f"{value!r}"
