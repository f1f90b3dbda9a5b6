"""The experiments by name, each a motion and environment of the box with a configurable length.

They are the five of the paper's section 4 and after: a box at rest, tumbled, heated, switched on again and again,
moved. Without a length each lasts as long as its own description says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from imuarray.errors import SourceError
from imuarray.simulate.motion.felt import Motion
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.still import Still, turn_on_run
from imuarray.simulate.motion.trajectory import load_trajectory
from imuarray.simulate.motion.tumble import ORDER, Tumble
from imuarray.simulate.motion.vehicle import Vehicle
from imuarray.spelling import guess, guess_file

TURN_ON_S = 300.0
"""Length of a run of a turn-on series (section 4)."""

_STATIC_S = 600.0
_TURN_S = 5.0
_REST_SHARE = 1 / 6
"""Share of a motion at rest, at its beginning and again at its end."""


@dataclass(frozen=True)
class ExperimentOptions:
    """The options of an experiment: its length in s (None: its own), the box axis that points up, the temperature, what
    moves the box ("hand", "vehicle" or a trajectory file), and which run of a series it is (1, 2, ...).
    """

    seconds: float | None = None
    up: str = "+Z"
    temperature_degc: float = 25.0
    drive: str = "hand"
    run: int = 1


def static(wanted: ExperimentOptions) -> Motion:
    """Return a box at rest."""
    return Still(wanted.up, wanted.seconds or _STATIC_S, wanted.temperature_degc)


def tumble(wanted: ExperimentOptions) -> Motion:
    """Seven faces; the turns are shortened too where there is little time."""
    faces = len(ORDER)
    temperatures = (wanted.temperature_degc,) * faces
    if wanted.seconds is None:
        return Tumble(temperatures_degc=temperatures)
    turn_s = min(_TURN_S, wanted.seconds / (4 * faces))
    return Tumble((wanted.seconds - (faces - 1) * turn_s) / faces, turn_s, temperatures)


def heating(wanted: ExperimentOptions) -> Motion:
    """The paper's temperature profile, all times scaled."""
    whole = Heating(up=wanted.up)
    return Heating(scale=wanted.seconds / whole.seconds, up=wanted.up) if wanted.seconds else whole


def turn_on(wanted: ExperimentOptions) -> Motion:
    """One run of a series."""
    return turn_on_run(wanted.run, wanted.seconds or TURN_ON_S, wanted.temperature_degc)


def motion(wanted: ExperimentOptions) -> Motion:
    """Return a box at rest, moved, at rest; or what a file says. SourceError for a file that can't be read."""
    if wanted.drive not in DRIVES:
        if not Path(wanted.drive).exists():
            near = guess(wanted.drive, DRIVES) or guess_file(wanted.drive)
            raise SourceError(
                f"{wanted.drive}: no such file; allowed are {', '.join(DRIVES)} and a trajectory file{near}"
            )
        moved = load_trajectory(Path(wanted.drive))
        if wanted.seconds is not None and wanted.seconds > moved.seconds + 1e-9:
            raise SourceError(f"{wanted.drive}: lasts {moved.seconds:g} s; {wanted.seconds:g} s are required")
        return moved
    return DRIVES[wanted.drive](wanted)


def hand(wanted: ExperimentOptions) -> Motion:
    """Shaken by hand."""
    if wanted.seconds is None:
        return HandShake(temperature_degc=wanted.temperature_degc)
    still_s = wanted.seconds * _REST_SHARE
    return HandShake(still_s=still_s, motion_s=wanted.seconds - 2 * still_s, temperature_degc=wanted.temperature_degc)


def vehicle(wanted: ExperimentOptions) -> Motion:
    """A drive with curves."""
    if wanted.seconds is None:
        return Vehicle(temperature_degc=wanted.temperature_degc)
    still_s = wanted.seconds * _REST_SHARE
    return Vehicle(still_s=still_s, drive_s=wanted.seconds - 2 * still_s, temperature_degc=wanted.temperature_degc)


DRIVES: Mapping[str, Callable[[ExperimentOptions], Motion]] = MappingProxyType({"hand": hand, "vehicle": vehicle})
"""The motions of the box in the experiment "motion"."""

EXPERIMENTS: Mapping[str, Callable[[ExperimentOptions], Motion]] = MappingProxyType(
    {"static": static, "tumble": tumble, "heating": heating, "turn-on": turn_on, "motion": motion}
)
"""Every experiment by its name."""
