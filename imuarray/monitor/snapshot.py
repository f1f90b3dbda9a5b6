"""The state of a log at one moment, in the units of the sensors (g, dps), which people read, instead of SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from imuarray.arrays import Floats, Times
from imuarray.characterise.spectrum import Spectrum
from imuarray.log.format import Event
from imuarray.log.health import Health
from imuarray.monitor.event_counts import RepeatedEvent

WAITING, WRITTEN, FINISHED, INTERRUPTED = "waiting", "being written", "finished", "interrupted"
"""The states of a log that is watched."""


@dataclass(frozen=True)
class Disk:
    """Bytes that are free beside the log, bytes a second that it takes, and seconds until the logger will end it for
    want of room (None: it takes nothing).
    """

    free_bytes: int
    bytes_per_s: float
    left_s: float | None


@dataclass(frozen=True)
class SensorView:
    """A sensor in the last seconds of the log, which are those before the newest row of any sensor.

    From one that is silent nothing came for `silent_s` (None: something did in the last second), nor is its mean known.
    `rows` of the log so far, the first of them at `first_ns`; `delayed` and `missed` among those that were counted, and
    since it is silent; `framed`, whether there is one in every frame. `flags`, rows of the last seconds by flag.
    `time` (n,) ns and `values` (n, k) in `unit`, their `mean` (k,) over the last second and `sd` (k,) over all of
    them. `use` and `peak_use` (k,): share of the measuring range, in the last seconds and at most so far; None for a
    sensor without a range. `temperature_degc` of the last second, where `relative` says that its zero is not known.
    """

    name: str
    chip: str
    quantity: str
    unit: str
    columns: tuple[str, ...]
    rows: int
    first_ns: int | None
    rate_hz: float
    silent_s: float | None
    framed: bool
    delayed: int
    missed: int
    flags: Mapping[str, int]
    time: Times
    values: Floats
    mean: Floats
    sd: Floats
    use: Floats | None
    peak_use: Floats | None
    temperature_degc: float | None
    relative: bool
    spectrum: Spectrum | None


@dataclass(frozen=True)
class FusedView:
    """The fused result of the last seconds by quantity: `time` (n,) ns, `triads` (n, 3) in SI in the box frame, their
    `mean` (3,) over the last second, and `noise` (3,), the scatter from frame to frame. `technique` gave it.
    """

    technique: str
    calibrated: bool
    time: Times
    triads: Mapping[str, Floats]
    mean: Mapping[str, Floats]
    noise: Mapping[str, Floats]


@dataclass(frozen=True)
class Snapshot:
    """A log at one moment.

    `state` is one of the four above, `remark` what else is to be said of it ("" nothing). `begins_ns` and `ends_ns` are
    the first and the last time in it, since `epoch`; `quiet_s` how long nothing came. `rate_hz` is that of
    frames, `frame_rate_hz` what was asked for (0: not known). `missed` are frames whose time had passed, as the logger
    counts them; `delayed` those that were read more than a quarter of a period later than usual, which is fewer than
    the logger calls late: there it is every frame that began behind its time, however little. `counted` is the share of
    the log that was counted so far. `events` by kind, of which `problems` tell of trouble; `recent` are the last ones,
    the newest first, and `repeated` the last ones that differ in more than numbers. `health` is the sign of all of it.
    `took_s` is what it took to look.
    """

    path: Path
    state: str
    remark: str = ""
    source: str = ""
    epoch: str = ""
    phase: str = ""
    begins_ns: int | None = None
    ends_ns: int | None = None
    quiet_s: float = 0.0
    rate_hz: float = 0.0
    frame_rate_hz: float = 0.0
    delayed: int = 0
    missed: int = 0
    counted: float = 1.0
    events: Mapping[str, int] | None = None
    problems: int = 0
    recent: tuple[Event, ...] = ()
    repeated: tuple[RepeatedEvent, ...] = ()
    health: Health | None = None
    disk: Disk | None = None
    sensors: tuple[SensorView, ...] = ()
    fused: FusedView | None = None
    not_fused: str = ""
    took_s: float = 0.0
