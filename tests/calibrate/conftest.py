"""Logs with known truth in closed form, computed with numpy alone from response matrices, biases and noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from imuarray.log import Block, LogWriter
from imuarray.log.format import Phase, SensorHeader

Floats = npt.NDArray[np.float64]

EPOCH = "2024-01-01T00:00:00Z"

FACES = (
    ("z_up", "+Z", (0, 0, 1)),
    ("x_up", "+X", (1, 0, 0)),
    ("y_up", "+Y", (0, 1, 0)),
    ("x_down", "-X", (-1, 0, 0)),
    ("y_down", "-Y", (0, -1, 0)),
    ("z_down", "-Z", (0, 0, -1)),
    ("z_up_check", "+Z", (0, 0, 1)),
)
"""The order of the paper's Table 10."""


class Part(NamedTuple):
    """A sensor and the true model of its counts, ``response @ up + bias + noise``, limited to the span of codes."""

    header: SensorHeader
    response: Floats
    bias: Floats
    sigma: float | Sequence[float] = 0.0
    code_end: int = 32767

    def read(self, up: Floats, rng: np.random.Generator) -> npt.NDArray[np.int16]:
        """Counts (n, 3) under gravity reactions `up` (n, 3)."""
        exact = up @ self.response.T + self.bias + rng.normal(0.0, 1.0, up.shape) * np.asarray(self.sigma)
        return np.clip(np.rint(exact), -self.code_end - 1, self.code_end).astype(np.int16)


def ideal(axes: str, sensitivity: float) -> Floats:
    """The response (3, 3) of a sensor whose axes point in the given directions."""
    rows = np.zeros((3, 3))
    for index in range(3):
        rows[index, "XYZ".index(axes[2 * index + 1])] = sensitivity * (1 if axes[2 * index] == "+" else -1)
    return rows


def skewed(axes: str, sensitivity: float, rng: np.random.Generator, spread: float = 0.02) -> Floats:
    """`ideal`, with errors of scale factors and angles of some per cent."""
    return ideal(axes, sensitivity) @ (np.eye(3) + rng.uniform(-spread, spread, (3, 3)))


def accelerometer(name: str, axes: str = "+X+Y+Z", chip: str = "bma180", sensitivity: float = 2048.0) -> SensorHeader:
    return SensorHeader(name, chip, "specific_force", "g", 16.0, sensitivity, axes=axes)


def gyroscope(name: str, axes: str = "+X+Y+Z") -> SensorHeader:
    return SensorHeader(name, "l3g4200d", "angular_rate", "dps", 250.0, 1 / 0.00875, axes=axes)


def directions(count: int, rng: np.random.Generator) -> Floats:
    """`count` unit vectors, uniform on the sphere."""
    drawn = rng.normal(size=(count, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


class WriteLog:
    """Writes logs into a folder; `rows` of every pose, named or not, with or without moves between them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(
        self,
        parts: Sequence[Part],
        ups: Floats,
        *,
        names: Sequence[tuple[str, str]] = (),
        rows: int = 128,
        rate_hz: float = 100.0,
        moving_rows: int = 0,
        drift_lsb_per_s: float = 0.0,
        seed: int = 1,
        name: str = "run.h5",
        keep: Callable[[str, npt.NDArray[np.int64]], npt.NDArray[np.bool_]] | None = None,
        status: Callable[[str, npt.NDArray[np.int16]], npt.NDArray[np.uint16]] | None = None,
    ) -> Path:
        """Write the poses in order; `keep` selects the received rows (by sensor and time), `status` flags counts."""
        rng = np.random.default_rng(seed)
        felt = _felt(ups, rows, moving_rows, rng)
        time = np.round(np.arange(len(felt)) * 1e9 / rate_hz).astype(np.int64)
        path = self.folder / name
        with LogWriter(path, [part.header for part in parts], source="simulated", epoch=EPOCH) as writer:
            for part in parts:
                moved = part._replace(bias=part.bias + drift_lsb_per_s * time[:, None] * 1e-9)
                counts = moved.read(felt, rng)
                flags = np.zeros(len(time), np.uint16) if status is None else status(part.header.name, counts)
                arrived = np.ones(len(time), bool) if keep is None else keep(part.header.name, time)
                writer.append(part.header.name, Block(time[arrived], counts[arrived], flags[arrived]))
            for index, (label, up) in enumerate(names):
                first = index * (rows + moving_rows)
                end_ns = int(time[first + rows - 1]) + 1
                writer.phase(Phase(int(time[first]), end_ns, label, up))
        return path

    def faces(self, parts: Sequence[Part], *, labels: Sequence[tuple[str, str]] = (), **options: object) -> Path:
        """Table 10's seven readings; `labels` replace the right ones, to mislabel faces."""
        ups = np.array([up for _, _, up in FACES], float)
        named = labels or [(label, up) for label, up, _ in FACES]
        return self(parts, ups, names=named, **options)  # type: ignore[arg-type]


def _felt(ups: Floats, rows: int, moving_rows: int, rng: np.random.Generator) -> Floats:
    """(n, 3): each pose for `rows`, then to the next along an arc, shaken by 0.3 g."""
    parts = []
    for index, up in enumerate(ups):
        parts.append(np.repeat(up[None], rows, axis=0))
        if moving_rows and index + 1 < len(ups):
            share = np.linspace(0, 1, moving_rows)[:, None]
            arc = (1 - share) * up + share * ups[index + 1]
            parts.append(arc + rng.normal(0, 0.3, arc.shape))
    return np.concatenate(parts)


@pytest.fixture
def write_log(tmp_path: Path) -> WriteLog:
    """Writes logs into this test's folder."""
    return WriteLog(tmp_path)
