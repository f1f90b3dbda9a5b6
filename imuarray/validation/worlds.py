"""Random worlds: for every case another array, plan, room, recorder and way of labelling.

::

    world = draw_world(1_000_042)     # a pure function of the seed
    world.table()                     # what the generator of cases records (`firmware_emulator.sessions`)

The main quantities (number of sensors, chips, rates, experiments, labels, timing, ...) are drawn by a Kronecker
sequence over consecutive seeds, with one irrational step per quantity, so that any short run of seeds covers their
ranges; each other quantity is drawn from a separate random stream. Everything is within the limits of data sheets,
rooms and programs: in a case without a mechanism there is no fault.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import tomli_w

from imuarray.chips import CHIPS

Table = dict[str, Any]

MOST_ROWS = 30_000
"""Maximum number of rows of all logs and sensors of a case: a comparison with forty replicates takes a few seconds on
one processor, the search for causes several times as long.
"""
MOST_SECONDS = 600.0
"""Maximum duration of all logs of a case, in s."""
MOST_READINGS_PER_S = 2500.0
"""Maximum number of readings of all sensors per second: the capacity of a bus at 400 kHz (0.25 ms for a triad) with a
reserve of a third.
"""
RATES_HZ = (20.0, 25.0, 32.0, 50.0, 64.0, 100.0, 128.0, 200.0, 250.0, 400.0, 500.0, 1000.0)
KINDS = ("static", "tumble", "heating", "turn-on", "motion")
"""The experiments, in the order in which they are recorded."""

QUANTITIES = (
    *("sensors", "chips", "twins", "rate", "rates", "plan", "poses", "heating", "labels", "recorder", "gaps"),
    *("thermometers", "barometer", "magnetometer", "reference", "draught", "vibration", "length"),
)
"""The quantities that are drawn evenly over consecutive seeds."""
_STEPS = tuple(math.sqrt(number) % 1 for number in range(2, 80) if all(number % factor for factor in range(2, number)))[
    : len(QUANTITIES)
]
"""Square roots of primes: no two quantities have commensurable periods."""

_ADDRESSES: Mapping[str, tuple[int, ...]] = {chip: CHIPS[chip].addresses for chip in ("adxl345", "bma180", "l3g4200d")}
_CHANNELS = 4
_FACES: Mapping[str, tuple[float, float, float]] = {
    "+Z": (0.0, 0.0, 1.0),
    "+X": (1.0, 0.0, 0.0),
    "+Y": (0.0, 1.0, 0.0),
    "-X": (-1.0, 0.0, 0.0),
    "-Y": (0.0, -1.0, 0.0),
    "-Z": (0.0, 0.0, -1.0),
}
_AXES = tuple(
    f"{a}{x}{b}{y}{c}{z}"
    for x, y, z in itertools.permutations("XYZ")
    for a, b, c in itertools.product("+-", repeat=3)
    if (x + y + z in "XYZXY") == ((a + b + c).count("-") % 2 == 0)
)
"""The 24 right-handed ways to mount a chip."""

TILT_DEG = 1.0
"""Tilt of a table together with the error of squareness of the box, in degrees (one sigma)."""
HAND_DEG = 20.0
"""Approximate angle in degrees between a box that is set down by hand and the nearest face."""
DRIFT_DEGC_PER_H = 2.0
"""Maximum temperature drift of a room, in degC per hour, in either direction."""
DRAUGHT_DEGC = (0.03, 0.4)
"""Temperature variation (rms) of the box in a draughty room, in degC: least and greatest."""
VIBRATION_G = (2e-5, 5e-4)
"""Peak vibration of a table by a fridge or a fan: from not perceptible to just perceptible by hand."""
VIBRATION_DPS_PER_G = 20.0
BUSY_SHARE, BUSY_MS = (0.005, 0.03), (0.05, 0.4)
"""Share of the transactions that wait on a busy board, and their mean wait in ms: least and greatest of each."""
STALLS_PER_MIN, STALL_S = (0.5, 2.0), (0.2, 2.0)
"""Stalls of a recorder per minute, and their duration in s: least and greatest of each."""

_LEAST_S: Mapping[str, float] = {"static": 20.0, "tumble": 42.0, "heating": 45.0, "turn-on": 20.0, "motion": 20.0}
"""The shortest useful duration of each experiment, in s."""
_USUAL_S: Mapping[str, tuple[float, float]] = {
    "static": (40.0, 300.0),
    "tumble": (60.0, 180.0),
    "heating": (120.0, 300.0),
    "turn-on": (30.0, 100.0),
    "motion": (25.0, 80.0),
}
"""The usual durations in s, if the limits of time and rows allow them."""


class WorldSensor(NamedTuple):
    """One sensor of a world: its chip, range (0: fixed), mounting ("" for a barometer), I2C address, and the number of
    readings per second.
    """

    chip: str
    range: float
    axes: str
    address: int
    rate_hz: float


@dataclass(frozen=True)
class World:
    """The draw of one seed. `array` is its TOML text and `sensors` are those in it, by name; `sessions` are the logs,
    `room` and `recorder` their conditions, all as tables of the generator; `strata` names the properties by which
    figures are broken down.
    """

    seed: int
    array: str
    sensors: Mapping[str, WorldSensor]
    kinds: tuple[str, ...]
    sessions: tuple[Table, ...]
    room: Table
    recorder: Table
    strata: Mapping[str, str]

    @property
    def plan(self) -> str:
        """The experiments in the form of `plan_of`: "heating+static"."""
        return plan_of(self.kinds)

    @property
    def inertial(self) -> dict[str, str]:
        """The chips of its accelerometers and gyroscopes, by sensor."""
        return {name: sensor.chip for name, sensor in self.sensors.items() if sensor.chip in _ADDRESSES}

    @property
    def seconds(self) -> float:
        """The duration of all logs."""
        return float(sum(session["seconds"] for session in self.sessions))

    @property
    def rows(self) -> float:
        """The approximate number of rows of all logs and sensors."""
        return self.seconds * sum(sensor.rate_hz for sensor in self.sensors.values())

    @property
    def faces(self) -> int:
        """The approximate number of different faces on which the box lies."""
        return _count_faces(self.sessions)

    @property
    def heated_faces(self) -> int:
        """The approximate number of different faces on which the box is heated."""
        return _count_faces([session for session in self.sessions if session["name"] == "heating"])

    def twins(self) -> list[tuple[str, str]]:
        """Return the pairs of sensors of one chip and range that are mounted differently: two that are mounted alike
        can be exchanged without any change of the readings.
        """
        pairs = itertools.combinations([(name, self.sensors[name]) for name in self.inertial], 2)
        return [
            (name, other)
            for (name, a), (other, b) in pairs
            if (a.chip, a.range) == (b.chip, b.range) and a.axes != b.axes
        ]

    @property
    def has_common_addresses(self) -> bool:
        """Return whether two inertial sensors of one chip share an address on different channels of the multiplexer."""
        places = [(chip, self.sensors[name].address) for name, chip in self.inertial.items()]
        return len(set(places)) < len(places)

    def table(self) -> Table:
        """Return the world as a JSON table for the generator."""
        return {"array": self.array, "sessions": list(self.sessions), "room": self.room, "recorder": self.recorder}


def _count_faces(sessions: Sequence[Table]) -> int:
    """Return the approximate number of different faces on which the box lies in these sessions."""
    ups = np.array([pose["up"] for session in sessions for pose in session["poses"]]).reshape(-1, 3)
    return len(set(np.argmax(ups @ np.array(list(_FACES.values())).T, axis=1).tolist()))


def plan_of(kinds: Sequence[str]) -> str:
    """Return the name of a plan with these experiments."""
    return "+".join(sorted(set(kinds)))


def draw_world(seed: int) -> World:
    """Return the world of a seed. Consecutive seeds cover the strata evenly."""
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
    sessions = [_label(session, labels, _stream(seed, "labels")) for session in sessions]
    recorder = _recorder(even, rate_hz, _stream(seed, "recorder"))
    if "motion" not in kinds:
        recorder["reference"] = bool(even["reference"] < 0.3)
    for session in sessions:
        session["reference_hz"] = 500.0 if recorder["reference"] and session["motions"] else 0.0
    room = _room(even, _stream(seed, "room"))
    strata = {
        "sensors": str(sum(sensor["chip"] in _ADDRESSES for sensor in sensors)),
        "rate_hz": f"{rate_hz:g}",
        "rates": "different" if any(sensor.get("fifo") for sensor in sensors) else "one",
        "poses": ("by hand" if by_hand else "by faces") if "tumble" in kinds else "none",
        "labels": labels,
        "recorder": "busy" if recorder["share"] else "quiet",
        "gaps": "some" if recorder["stalls_per_min"] else "none",
        "thermometers": "read" if recorder["thermometers"] else "not read",
        "barometer": "there" if any(sensor["chip"] == "bmp180" for sensor in sensors) else "none",
        "magnetometer": "there" if any(sensor["chip"].startswith("hmc") for sensor in sensors) else "none",
        "reference": "there" if recorder["reference"] else "none",
        "draught": "there" if room["draught_degc"] else "none",
        "vibration": _choice(even["vibration"], _VIBRATIONS),
    }
    array = {"name": "bench", "mux": {"chip": "pca9544a", "address": 0x70}}
    known = {
        name: WorldSensor(chip, sensor.get("range", 0.0), sensor.get("axes", ""), sensor["address"], rates[name])
        for sensor in sensors
        for name, chip in [(sensor["name"], sensor["chip"])]
    }
    text = tomli_w.dumps({"array": array, "sensor": sensors})
    return World(seed, text, known, kinds, tuple(sessions), room, recorder, strata)


def _stream(seed: int, key: str) -> np.random.Generator:
    """Return a separate random generator for each `key`."""
    return np.random.default_rng([seed, crc32(key.encode())])


def _choice(even: float, shares: Mapping[str, float]) -> str:
    """Choose a name according to its probability, by the number `even` in [0, 1)."""
    reached = 0.0
    for name, share in shares.items():
        reached += share
        if even < reached:
            return name
    return list(shares)[-1]


def _draw_between(random: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Draw log-uniformly, rounded to three digits."""
    low, high = np.log(bounds)
    return float(f"{math.exp(random.uniform(low, high)):.3g}")


def _kinds(even: float) -> tuple[str, ...]:
    """Choose one of the 31 sets of experiments."""
    bits = 1 + int(even * (2 ** len(KINDS) - 1))
    return tuple(kind for place, kind in enumerate(KINDS) if bits >> place & 1)


def _sensors(even: Mapping[str, float], random: np.random.Generator, least_s: float) -> list[Table]:
    """Return the entries of the array's TOML; their number is limited so that they can be read for `least_s`."""
    few = {"1": 0.15, "2": 0.15, "3": 0.2, "4": 0.15, "6": 0.2, "9": 0.1, "16": 0.05}
    most = int(_choice(even["sensors"], few))
    count = int(random.integers({"6": 5, "9": 7, "16": 10}.get(str(most), most), most + 1))
    count = min(count, int(MOST_ROWS / RATES_HZ[0] / least_s) - 2)  # plus barometer and magnetometer
    kinds = 1 + int(even["chips"] * 3)
    mix = random.permutation(list(_ADDRESSES))[:kinds].tolist()
    slots = {chip: [(channel, address) for channel in range(_CHANNELS) for address in _ADDRESSES[chip]] for chip in mix}
    twins = even["twins"] < 0.6
    common = {chip: _range(chip, random) for chip in mix}
    sensors: list[Table] = []
    chosen = [mix[place % len(mix)] for place in range(count)] if count >= len(mix) else mix[:count]
    for chip in random.permutation(chosen).tolist():
        if not slots[chip]:
            continue
        channel, address = slots[chip].pop(int(random.integers(len(slots[chip]))))
        range_ = common[chip] if twins else _range(chip, random)
        number = 1 + sum(sensor["chip"] == chip for sensor in sensors)
        name = f"{'Gyro' if chip == 'l3g4200d' else chip[:3].upper()}{number}"
        place = {"channel": channel, "address": address, "range": range_}
        settings = _filter(chip, random)
        sensors.append({"name": name, "chip": chip, **place, **settings, "axes": str(random.choice(_AXES))})
    if even["barometer"] < 0.4:
        sensors.append({"name": "Baro", "chip": "bmp180", "channel": 0, "address": CHIPS["bmp180"].addresses[0]})
    if even["magnetometer"] < 0.3:
        chip = str(random.choice(["hmc5883", "hmc5883l"]))
        range_ = float(random.choice([sensor for sensor in CHIPS[chip].sensitivity if sensor > 1]))
        place = {"channel": 1, "address": CHIPS[chip].addresses[0], "range": range_, "rate_hz": 75.0}
        sensors.append({"name": "Mag", "chip": chip, **place, "axes": str(random.choice(_AXES))})
    return sensors


def _range(chip: str, random: np.random.Generator) -> float:
    """Draw a range in which gravity is not clipped at any scale factor and bias of the part."""
    return float(random.choice([limit for limit in CHIPS[chip].sensitivity if limit >= 1.5]))


def _filter(chip: str, random: np.random.Generator) -> Table:
    """Draw the data rate and the filter, if the chip has these settings."""
    spec, settings = CHIPS[chip], dict[str, Any]()
    if spec.rates_hz:
        settings["rate_hz"] = float(random.choice([rate_hz for rate_hz in spec.rates_hz if 50 <= rate_hz <= 1600]))
    if bandwidths := spec.allowed_bandwidths_hz(settings.get("rate_hz", spec.fixed_rate_hz)):
        settings["bandwidth_hz"] = float(random.choice(bandwidths))
    return settings


def _rates(
    even: Mapping[str, float], sensors: list[Table], kinds: Sequence[str], random: np.random.Generator
) -> tuple[float, dict[str, float]]:
    """Return the frame rate, which is the highest that the draw, the bus and the budget of rows allow, and the reading
    rate of each sensor. In a third of the worlds, all samples of some accelerometers and gyroscopes are read from the
    chip's queue.
    """
    wanted = RATES_HZ[int(even["rate"] * len(RATES_HZ))]
    queued = [sensor for sensor in sensors if CHIPS[sensor["chip"]].has_fifo]
    if even["rates"] < 0.35 and wanted >= 50.0 and queued:
        for sensor in random.permutation(len(queued))[: max(1, len(queued) // 2)].tolist():
            slow = [rate for rate in CHIPS[queued[sensor]["chip"]].rates_hz if 50 <= rate <= min(400.0, 8 * wanted)]
            _queue(queued[sensor], float(random.choice(slow)), random)
    least_s = sum(_LEAST_S[kind] for kind in kinds)
    for rate_hz in reversed([allowed_hz for allowed_hz in RATES_HZ if allowed_hz <= wanted]):
        rates = {sensor["name"]: _rate(sensor, rate_hz) for sensor in sensors}
        total = sum(rates.values())
        if total <= MOST_READINGS_PER_S and total * least_s <= MOST_ROWS:
            return rate_hz, rates
    for sensor in queued:
        sensor.pop("fifo", None)
    return RATES_HZ[0], {sensor["name"]: _rate(sensor, RATES_HZ[0]) for sensor in sensors}


def _queue(sensor: Table, rate_hz: float, random: np.random.Generator) -> None:
    """Configure a sensor whose queue is read, at that data rate."""
    sensor |= {"fifo": True, "rate_hz": rate_hz}
    if bandwidths := CHIPS[sensor["chip"]].allowed_bandwidths_hz(rate_hz):
        sensor["bandwidth_hz"] = float(random.choice(bandwidths))


def _rate(sensor: Table, rate_hz: float) -> float:
    """Return the rows per second of a sensor."""
    if sensor.get("fifo"):
        return float(sensor["rate_hz"])
    return CHIPS[sensor["chip"]].default_rate_hz if CHIPS[sensor["chip"]].on_demand else rate_hz


def _lengths(
    kinds: Sequence[str], rates: Mapping[str, float], even: float, random: np.random.Generator
) -> dict[str, float]:
    """Return the duration of each experiment, s: the usual one, shortened as the limits of time and rows demand."""
    short = even < 0.3
    usual = {kind: _LEAST_S[kind] if short else _draw_between(random, _USUAL_S[kind]) for kind in kinds}
    most_s = min(MOST_SECONDS, MOST_ROWS / sum(rates.values()))
    least_s = sum(_LEAST_S[kind] for kind in kinds)
    over = sum(usual.values()) - least_s
    share = min(1.0, max(most_s - least_s, 0.0) / over) if over > 0 else 0.0
    return {kind: round(_LEAST_S[kind] + share * (usual[kind] - _LEAST_S[kind]), 1) for kind in kinds}


def _leaning(face: str, degrees: float, random: np.random.Generator) -> list[float]:
    """Return a unit vector at about this angle from a face's normal."""
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
    """Return a tumble over all or some faces in any order; or with poses set by hand and not labelled with a face."""
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
    """Return a heating: up, up and down, in steps or two pulses; on one face, or with a new face for each stretch."""
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
    """Return a series of power-ups, each a log."""
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
    """The greatest motion without clipping: rad/s, and g in addition to gravity."""

    rate: float
    force_g: float


def _motion_limits(sensors: Sequence[Table]) -> Limits:
    rates = [sensor["range"] for sensor in sensors if sensor["chip"] == "l3g4200d"]
    forces = [sensor["range"] for sensor in sensors if CHIPS[sensor["chip"]].unit == "g"]
    return Limits(0.5 * math.radians(min(rates, default=500.0)), 0.25 * (min(forces, default=4.0) - 1.1))


def _motion(seconds: float, random: np.random.Generator, even: Mapping[str, float], limits: Limits) -> list[Table]:
    """Return a session of rest, one to three motions of rocking and shaking about random axes, and rest."""
    still_s = max(4.0, round(0.12 * seconds, 2))
    count = int(random.integers(1, 4))
    edges = np.linspace(still_s, seconds - still_s, count + 1).tolist()
    face = "+Z" if random.random() < 0.6 else str(random.choice(list(_FACES)))
    motions = []
    for start_s, end_s in itertools.pairwise(edges):
        axis = random.standard_normal(3)
        rock_hz = _draw_between(random, (0.3, 2.0))
        motions.append(
            {
                "start_s": start_s,
                "end_s": end_s,
                "axis": (axis / np.linalg.norm(axis)).tolist(),
                "angle_rad": min(float(random.uniform(0.2, 0.9)), limits.rate / (2 * math.pi * rock_hz)),
                "rock_hz": rock_hz,
                "peak_g": min(float(random.uniform(0.0, 0.4)), limits.force_g),
                "shake_hz": _draw_between(random, (1.0, 7.0)),
            }
        )
    phases = [[0.0, still_s, "static", face], [edges[0], edges[-1], "motion", ""], [edges[-1], seconds, "static", face]]
    pose = {"up": _leaning(face, TILT_DEG, random), "hold_s": seconds}
    return [_session("motion", seconds, [pose], phases, motions=motions)]


_SESSIONS = {"static": _static, "tumble": _tumble, "heating": _heating, "turn-on": _turn_on, "motion": _motion}


def _label(session: Table, labels: str, random: np.random.Generator) -> Table:
    """Return the session with its labels: complete, missing, or with two faces of a tumble exchanged."""
    if labels == "missing":
        return {**session, "phases": []}
    if labels == "some wrong" and session["name"] == "tumble":
        phases = [list(phase) for phase in session["phases"]]
        first, second = random.choice(len(phases), 2, replace=False).tolist()
        for place in (2, 3):
            phases[first][place], phases[second][place] = phases[second][place], phases[first][place]
        return {**session, "phases": phases}
    return session


def _recorder(even: Mapping[str, float], rate_hz: float, random: np.random.Generator) -> Table:
    busy, gaps = even["recorder"] < 0.4, even["gaps"] < 0.25
    share, mean_ms = _draw_between(random, BUSY_SHARE), _draw_between(random, BUSY_MS)
    per_min, stall_s = _draw_between(random, STALLS_PER_MIN), _draw_between(random, STALL_S)
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
    drift, swings = float(random.uniform(-1, 1)) * DRIFT_DEGC_PER_H / 3600, _draw_between(random, DRAUGHT_DEGC)
    peak_g, direction = _draw_between(random, VIBRATION_G), random.standard_normal(3)
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
