"""What the box goes through: a path of orientations, the gravity, turning and temperature that follow from it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.foreign_world.parts import DPS, Array, Generator, rotation, small_rotation

GRID_HZ = 200.0
FACES = {"z_up": "+Z", "x_up": "+X", "y_up": "+Y", "x_down": "-X", "y_down": "-Y", "z_down": "-Z"}
EARTH_RATE = 7.292e-5


@dataclass(frozen=True)
class Phase:
    """A named stretch, in seconds of the log."""

    start_s: float
    end_s: float
    name: str
    up: str = ""


@dataclass(frozen=True)
class Stimulus:
    """What the box feels, box frame, on a grid of `GRID_HZ`: specific force (n, 3) m/s2, angular rate (n, 3) rad/s,
    angular acceleration (n, 3), magnetic field (n, 3) gauss, temperature of the box (n,) degC.
    """

    time_s: Array
    force: Array
    rate: Array
    acceleration: Array
    field: Array
    temperature: Array
    phases: tuple[Phase, ...]

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1])


@dataclass(frozen=True)
class Site:
    """Where the recording takes place: local gravity (9.780 to 9.832 m/s2 at sea level), latitude, magnetic field."""

    gravity: float
    latitude: float
    field_gauss: float
    dip: float


def draw_site(rng: Generator) -> Site:
    """Anywhere inhabited; the gravity is that of the latitude (international gravity formula, 1980)."""
    latitude = float(rng.uniform(0, 65) * DPS)
    gravity = 9.780327 * (1 + 0.0053024 * np.sin(latitude) ** 2 - 5.8e-6 * np.sin(2 * latitude) ** 2)
    return Site(float(gravity), latitude, float(rng.uniform(0.3, 0.6)), float(rng.uniform(-1.2, 1.2)))


@dataclass
class Path:
    """Orientations (box to world) put together from holds, turns by hand and turns of a table."""

    rng: Generator
    tilt_limit: float
    pieces: list[Array] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    shaking: list[Array] = field(default_factory=list)
    rows: int = 0

    @property
    def seconds(self) -> float:
        return self.rows / GRID_HZ

    def pose(self, up: str) -> Array:
        """Orientation with a box axis up, a random heading and a random tilt within the limit."""
        direction = np.zeros(3)
        direction["XYZ".index(up[1])] = 1 if up[0] == "+" else -1
        tilted = small_rotation(self.rng, self.tilt_limit) @ direction if self.tilt_limit else direction
        heading = np.cross(tilted, self.rng.normal(size=3))
        heading /= np.linalg.norm(heading)
        return np.array([heading, np.cross(tilted, heading), tilted])

    def hold(self, pose: Array, duration_s: float, name: str = "", up: str = "") -> None:
        """The box lies still."""
        rows = round(duration_s * GRID_HZ)
        self._label(rows, name, up)
        self._add(np.broadcast_to(pose, (rows, 3, 3)), np.zeros((rows, 3)))

    def turn(self, start: Array, end: Array, duration_s: float) -> None:
        """A hand turns the box; it shakes a little."""
        relative = start.T @ end
        values, vectors = np.linalg.eigh((relative + relative.T) / 2)
        axis = vectors[:, np.argmax(values)]
        skew = np.array(
            [relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]]
        )
        if skew @ axis < 0:
            axis = -axis
        angle = np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1))
        rows = round(duration_s * GRID_HZ)
        share = (np.arange(rows) + 1) / rows
        smooth = share**3 * (10 - 15 * share + 6 * share**2)
        window = np.sin(np.pi * share)[:, None] ** 2
        phase, speed = self.rng.uniform(0, 6, 3), self.rng.uniform(5, 25, 3)
        shake = window * self.rng.normal(0, 0.15, 3) * np.sin(share[:, None] * duration_s * speed + phase)
        self._add(start @ rotation(axis, angle * smooth), shake)

    def spin(self, pose: Array, rate: Array, lean: Array, name: str = "", up: str = "") -> None:
        """A table turns the box about its own axis, which leans a little from the vertical; rate (n,) in rad/s."""
        self._label(len(rate), name, up)
        angle = np.cumsum(rate) / GRID_HZ
        self._add(lean @ rotation(np.array([0.0, 0.0, 1.0]), angle) @ pose, np.zeros((len(rate), 3)))

    def _label(self, rows: int, name: str, up: str) -> None:
        if name:
            self.phases.append(Phase(self.seconds, (self.rows + rows) / GRID_HZ, name, up))

    def _add(self, poses: Array, shake: Array) -> None:
        self.pieces.append(np.asarray(poses))
        self.shaking.append(shake)
        self.rows += len(poses)

    def stimulus(self, site: Site, temperature: Array) -> Stimulus:
        """What the box feels on this path; the temperature is given on the same grid."""
        poses = np.concatenate(self.pieces)
        into_box = poses.transpose(0, 2, 1)
        step = into_box[:-1] @ poses[1:]
        vector = np.stack(
            [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], axis=1
        )
        sine = np.linalg.norm(vector, axis=1, keepdims=True) / 2
        vector = vector / 2 * np.where(sine > 1e-9, np.arcsin(np.clip(sine, 0, 1)) / np.maximum(sine, 1e-9), 1)
        rate = np.vstack([vector, vector[-1:]]) * GRID_HZ
        earth = EARTH_RATE * np.array([np.cos(site.latitude), 0, np.sin(site.latitude)])
        magnetic = site.field_gauss * np.array([np.cos(site.dip), 0, -np.sin(site.dip)])
        force = into_box @ np.array([0, 0, site.gravity]) + np.concatenate(self.shaking)
        return Stimulus(
            time_s=np.arange(len(poses)) / GRID_HZ,
            force=force,
            rate=rate + into_box @ earth,
            acceleration=np.gradient(rate, 1 / GRID_HZ, axis=0),
            field=into_box @ magnetic,
            temperature=temperature[: len(poses)],
            phases=tuple(self.phases),
        )


def table_profile(rng: Generator, duration_s: float, peak: float) -> Array:
    """Rate of a table (n,) in rad/s: plateaus of both signs with smooth ramps, then a swing."""
    rows = round(duration_s * GRID_HZ)
    time = np.arange(rows) / GRID_HZ
    swing_from = duration_s * rng.uniform(0.5, 0.7)
    rate = np.zeros(rows)
    start, sign = 1.0, float(rng.choice([-1.0, 1.0]))
    while start + 5 < swing_from:
        length = rng.uniform(3, 7)
        ramp = rng.uniform(0.6, 1.2)
        shape = smooth_step((time - start) / ramp) - smooth_step((time - start - length) / ramp)
        rate += sign * peak * rng.uniform(0.2, 1) * shape
        sign, start = -sign, start + length + ramp + rng.uniform(0.2, 1)
    window = smooth_step(time - swing_from - 1) - smooth_step(time - duration_s + 2)
    rate += peak * rng.uniform(0.3, 0.8) * window * np.sin(2 * np.pi * rng.uniform(0.3, 1.2) * (time - swing_from))
    return rate


def smooth_step(share: Array) -> Array:
    """0 before 0, 1 after 1, smooth between."""
    share = np.clip(share, 0, 1)
    smooth: Array = share * share * (3 - 2 * share)
    return smooth


def room_temperature(rng: Generator, start: float, rows: int, draughty: bool) -> Array:
    """Temperature of the box in a room (rows,): a slow swing, and draughts where a door is opened."""
    time = np.arange(rows) / GRID_HZ
    swing = rng.uniform(0.05, 0.5) * (
        np.sin(2 * np.pi * time / rng.uniform(900, 3600) + (at := rng.uniform(0, 6))) - np.sin(at)
    )
    if draughty:
        for moment in rng.uniform(0, time[-1], rng.poisson(time[-1] / 150)):
            age = np.maximum(time - moment, 0)
            swing -= rng.uniform(0.1, 0.4) * (np.exp(-age / 90) - np.exp(-age / 20))
    temperature: Array = start + swing
    return temperature


def heating(rng: Generator, rows: int, rise: float, phases: tuple[float, float]) -> Array:
    """Rise of temperature (rows,): none until the first moment, ramp or exponential until the second, then decay."""
    time = np.arange(rows) / GRID_HZ
    begin, end = phases
    if rng.random() < 0.5:
        up = np.clip((time - begin) / (end - begin), 0, 1)
    else:
        constant = (end - begin) * rng.uniform(0.3, 0.6)
        up = (1 - np.exp(-np.clip(time - begin, 0, end - begin) / constant)) / (1 - np.exp(-(end - begin) / constant))
    decay: Array = np.exp(-np.maximum(time - end, 0) / rng.uniform(100, 300))
    risen: Array = rise * up * decay
    return risen
