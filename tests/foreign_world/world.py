"""Draws a world from a key: an array of parts, a plan of experiments, the room, the recorder.

Everything is within the data sheets' tolerance: a world to which no effect is added is a control.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tests.foreign_world.parts import (
    CHIPS,
    DPS,
    L3G_BANDWIDTHS,
    Array,
    Generator,
    Part,
    Sensor,
    draw_part,
    small_rotation,
    stream,
)
from tests.foreign_world.stimulus import (
    FACES,
    GRID_HZ,
    Path,
    Phase,
    Site,
    Stimulus,
    draw_site,
    heating,
    room_temperature,
    table_profile,
)

INERTIAL = ("bma180", "adxl345", "l3g4200d")
TILT_LIMIT = 3 * DPS
"""Of the box on each face."""


@dataclass(frozen=True)
class Recorder:
    """How the host polls: jitter of a frame's start, and on a busy board delays of milliseconds now and then.

    `delay_chance` is per frame. `slot_s` is the time between two sensors of a frame. `has_status`, `labels_phases`,
    `has_thermometers` say what its files hold; `track` is the name of the group with what the box felt, or "".
    """

    frame_rate_hz: float
    jitter_s: float
    delay_chance: float
    delay_s: float
    slot_s: float
    clock_error: float
    has_status: bool
    labels_phases: bool
    has_thermometers: bool
    track: str
    track_rate_hz: float
    source: str


@dataclass(frozen=True)
class Experiment:
    """One log to be recorded; `warm_up_s` is how long the chips had power before it began."""

    kind: str
    name: str
    stimulus: Stimulus
    warm_up_s: float
    power_cycle: int


@dataclass(frozen=True)
class World:
    """An array somewhere, and what is done with it."""

    key: str
    sensors: tuple[Sensor, ...]
    parts: dict[str, Part]
    site: Site
    recorder: Recorder
    experiments: tuple[Experiment, ...]
    has_barometer: bool
    strata: dict[str, Any] = field(default_factory=dict)

    @property
    def kinds(self) -> frozenset[str]:
        return frozenset(experiment.kind for experiment in self.experiments)

    @property
    def inertial(self) -> tuple[Sensor, ...]:
        return tuple(sensor for sensor in self.sensors if sensor.chip in INERTIAL)

    @property
    def duration_s(self) -> float:
        return sum(experiment.stimulus.duration_s for experiment in self.experiments)


def axes_names() -> list[str]:
    """The 24 right-handed ways in which a chip can lie along the box's axes."""
    names = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[order, range(3)] = signs
            if np.linalg.det(matrix) > 0:
                names.append("".join(("+" if s > 0 else "-") + "XYZ"[o] for o, s in zip(order, signs, strict=True)))
    return names


def draw_world(key: str) -> World:
    """The world of this key, without its stimuli's pairing to any effect."""
    rng = stream(key, "world")
    track = str(rng.choice(["", "reference", "truth"], p=[0.45, 0.45, 0.10]))
    kinds = draw_plan(rng, bool(track))
    sensors = draw_array(rng)
    if "heating" in kinds and not track and not any(sensor.facts.thermometer for sensor in sensors):
        kinds = tuple(kind for kind in kinds if kind != "heating") or ("static",)  # nobody heats what nothing measures
    frame_rate = draw_frame_rate(rng, len(sensors), kinds)
    sensors = tuple(
        replace(
            sensor,
            divider=int(rng.choice([1, 1, 1, 1, 2])) if sensor.chip in INERTIAL else max(1, int(frame_rate // 15)),
        )
        for sensor in sensors
    )
    busy = bool(rng.random() < 0.3)
    foreign = bool(rng.random() < 0.25)
    recorder = Recorder(
        frame_rate_hz=frame_rate,
        jitter_s=float(rng.uniform(10e-6, 60e-6)),
        delay_chance=float(rng.uniform(0.0005, 0.005)) if busy else 0.0,
        delay_s=float(rng.uniform(0.001, 0.005)),
        slot_s=float(rng.uniform(0.00025, 0.0004)),
        clock_error=float(rng.uniform(-20e-6, 20e-6)),
        has_status=not foreign,
        labels_phases=bool(rng.random() < 0.85),
        has_thermometers=bool(rng.random() < 0.75) or "heating" in kinds,
        track=track,
        track_rate_hz=float(rng.choice([50, 100])),
        source="simulated" if track == "truth" else "imported" if foreign else str(rng.choice(["i2c", "serial"])),
    )
    strata: dict[str, Any] = {
        "second_order": bool(rng.random() < 0.35),
        "supply_3v3": bool(rng.random() < 0.15),
        "busy_board": busy,
        "draughty_room": bool(rng.random() < 0.3),
        "cold_start": bool(rng.random() < 0.3),
    }
    l3g_order = strata["l3g4200d_filter_order"] = int(rng.choice([1, 2]))
    parts = {
        sensor.name: draw_part(
            stream(key, "part", sensor.name),
            sensor,
            second_order=strata["second_order"],
            supply_3v3=strata["supply_3v3"],
            l3g_order=l3g_order,
        )
        for sensor in sensors
    }
    site = draw_site(rng)
    experiments = draw_experiments(stream(key, "experiments"), kinds, sensors, site, strata)
    return World(
        key, sensors, parts, site, recorder, experiments, has_barometer=bool(rng.random() < 0.15), strata=strata
    )


def draw_plan(rng: Generator, has_track: bool) -> tuple[str, ...]:
    """Which experiments are recorded, in which order; motion only where a track says what the motion was."""
    chances = {"static": 0.8, "tumble": 0.6, "heating": 0.4, "turn_on": 0.25, "motion": 0.7 if has_track else 0.0}
    kinds = [kind for kind, chance in chances.items() if rng.random() < chance]
    return tuple(str(kind) for kind in rng.permutation(kinds)) or ("static",)


def draw_frame_rate(rng: Generator, sensors: int, kinds: tuple[str, ...]) -> float:
    """Frames per second; what the bus can carry (BUS-08 measured generously) and what keeps a case small."""
    rates, chances = (
        (20.0, 50.0, 80.0, 100.0, 125.0, 200.0, 400.0, 1000.0),
        (0.08, 0.2, 0.1, 0.3, 0.1, 0.16, 0.04, 0.02),
    )
    while True:
        rate = float(rng.choice(rates, p=chances))
        if rate * sensors * 0.0004 < 0.8 and (rate <= 200 or (sensors <= 2 and kinds in (("static",), ("tumble",)))):
            return rate


def draw_array(rng: Generator) -> tuple[Sensor, ...]:
    """1 to 16 inertial sensors, mostly few; singles and twins in mixed ranges; sometimes a magnetometer."""
    count = (
        int(rng.integers(7, 17))
        if rng.random() < 0.08
        else int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.12, 0.24, 0.22, 0.2, 0.12, 0.1]))
    )
    names, placed, sensors = axes_names(), {}, []  # type: ignore[var-annotated]
    spread = float(rng.choice([0.0, 3.0, 20.0], p=[0.4, 0.4, 0.2]))
    width = int(rng.choice([1, 2, 4]))
    while len(sensors) < count:
        chip = str(rng.choice(INERTIAL))
        model = draw_model(rng, chip)
        copies = min(int(rng.choice([1, 2, 3], p=[0.45, 0.45, 0.1])), count - len(sensors))
        for _ in range(copies):
            places = [(c, a) for c in range(4) for a in CHIPS[chip].addresses if (c, a) not in placed]
            if not places:
                break
            channel, address = places[0] if width == 1 else places[int(rng.integers(min(width, len(places))))]
            placed[channel, address] = chip
            number = 1 + sum(sensor.chip == chip for sensor in sensors)
            x, y, z = (round(float(v), 1) for v in rng.uniform(-spread, spread, 3))
            letters = {"bma180": "BMA", "adxl345": "ADXL", "l3g4200d": "Gyro"}[chip]
            axes = str(rng.choice(names))
            sensors.append(Sensor(f"{letters}{number}", chip, channel, address, *model, axes, (x, y, z)))
    if rng.random() < 0.15:
        rate, gauss = float(rng.choice([15, 30, 75])), float(rng.choice([0.88, 1.3, 1.9]))
        sensors.append(
            Sensor("Mag1", "hmc5883l", 0, 0x1E, gauss, rate, rate / 2, str(rng.choice(names)), (0.0, 0.0, 0.0))
        )
    return tuple(sensors)


def draw_model(rng: Generator, chip: str) -> tuple[float, float, float]:
    """Range, chip rate and bandwidth as a configuration may ask for them."""
    if chip == "bma180":
        return float(rng.choice([1.5, 2, 4, 8, 16])), 2400.0, float(rng.choice([20, 40, 75, 150, 300, 1200]))
    if chip == "adxl345":
        rate = float(rng.choice([50, 100, 200, 400, 800], p=[0.1, 0.25, 0.25, 0.25, 0.15]))
        return float(rng.choice([2, 4, 8, 16])), rate, rate / 2
    rate = int(rng.choice([100, 200, 400, 800]))
    return float(rng.choice([250, 500, 2000])), float(rate), float(rng.choice(L3G_BANDWIDTHS[rate]))


def draw_experiments(
    rng: Generator, kinds: tuple[str, ...], sensors: tuple[Sensor, ...], site: Site, strata: dict[str, Any]
) -> tuple[Experiment, ...]:
    """The stimuli of all logs. Together they last ten minutes at most; each log has a temperature of its own."""
    room = float(rng.uniform(18, 27))
    day = str(rng.choice(list(FACES)))
    logs: list[Experiment] = []
    cycle = 0
    for kind in kinds:
        runs = int(rng.integers(5, 9)) if kind == "turn_on" else 1
        offset = float(rng.uniform(-5, 5)) if kind in ("turn_on", "motion") else float(rng.uniform(-2, 2))
        cycle += bool(rng.random() < 0.4) or kind == "turn_on"
        for run in range(runs):
            path = Path(rng, TILT_LIMIT)
            if kind == "tumble":
                tumble(rng, path)
            elif kind == "motion":
                table(rng, path, sensors, day)
            else:
                lie(rng, path, kind, day, run)
            shift = float(rng.uniform(-1, 1)) if kind == "turn_on" else 0.0
            temperature = room_temperature(rng, room + offset + shift, path.rows, strata["draughty_room"])
            if kind == "heating":
                temperature = temperature + warm(rng, path, day)
            name = f"{kind}_{run + 1:02d}" if kind == "turn_on" else kind
            cold = kind == "turn_on" or strata["cold_start"]
            warm_up = float(rng.uniform(1, 10)) if cold else 1800.0
            logs.append(Experiment(kind, name, path.stimulus(site, temperature), warm_up, cycle))
            cycle += kind == "turn_on"
    return tuple(logs)


def lie(rng: Generator, path: Path, kind: str, face: str, run: int) -> None:
    """The box lies on one face all the time."""
    lengths = {"static": (90, 200), "heating": (180, 300), "turn_on": (15, 25)}
    name = {"static": "static", "heating": "", "turn_on": f"run {run + 1}"}[kind]
    path.hold(path.pose(FACES[face]), float(rng.uniform(*lengths[kind])), name, FACES[face])


def warm(rng: Generator, path: Path, face: str) -> Array:
    """Labels the phases of a heating and gives its rise of temperature, 5 to 20 K."""
    total = path.seconds
    begin = float(rng.uniform(0.1, 0.2)) * total
    end = float(rng.uniform(0.7, 1.0)) * total
    end = total if end > 0.9 * total else end
    up = FACES[face]
    path.phases += [Phase(0, begin, "room", up), Phase(begin, end, "heat", up)]
    path.phases += [Phase(end, total, "cool", up)] if end < total else []
    return heating(rng, path.rows, float(rng.uniform(5, 20)), (begin, end))


def tumble(rng: Generator, path: Path) -> None:
    """The box is put on its faces one after another, by hand; at times one face is read again at the end."""
    order = list(rng.permutation(list(FACES))) if rng.random() < 0.5 else list(FACES)
    order += [order[0]] if rng.random() < 0.5 else []
    length = float(rng.uniform(8, 22))
    pose = None
    for index, face in enumerate(order):
        following = path.pose(FACES[face])
        if pose is not None:
            path.turn(pose, following, float(rng.uniform(2, 4)))
        name = f"{face}_check" if index >= len(FACES) else face
        path.hold(following, length * float(rng.uniform(0.8, 1.2)), name, FACES[face])
        pose = following


def table(rng: Generator, path: Path, sensors: tuple[Sensor, ...], face: str) -> None:
    """The box lies still on a rate table, is turned by it, and lies still again; no gyroscope is driven to its end."""
    pose = path.pose(FACES[face])
    lean = small_rotation(rng, 0.2 * DPS)
    widest = min([sensor.range for sensor in sensors if sensor.chip == "l3g4200d"], default=500)
    peak = float(rng.uniform(0.25, 0.6)) * min(widest, 600) * DPS
    path.hold(lean @ pose, float(rng.uniform(5, 12)), "static", FACES[face])
    rate = table_profile(rng, float(rng.uniform(40, 80)), peak)
    path.spin(pose, rate, lean, "motion", FACES[face])
    last = path.pieces[-1][-1]
    path.hold(last, float(rng.uniform(5, 12)), "static", FACES[face])


def track_times(world: World, stimulus: Stimulus) -> Array:
    """Moments of the track, in seconds of the log."""
    return np.arange(0, stimulus.duration_s, 1 / world.recorder.track_rate_hz)


__all__ = ["GRID_HZ", "Experiment", "Recorder", "World", "draw_world", "track_times"]
