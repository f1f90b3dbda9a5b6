"""The rule by which the noted phases of a log are rests of the box. Every analysis uses it: characterisation,
calibration of noise, start-up states, and the gap tool.

A phase is a rest if

* its name is that of a rest: `static`, `room`, a face (`z_up`, `x_down`, ..., `z_up_check` if it is read again),
  `pose 3`, `run 3` (a run of a turn-on series), or that of a box at rest that is heated or cools (`heat`, `heating`,
  `warm-up`, `soak`, `cool`, `cooling`); or
* an axis of the box is noted as up, and the name is not `motion`.

In a log with several phases `run 1`, `run 2`, ... these names do not mean a rest: a turn-on series has a file for each
run, and runs of a motor or of a turntable have the same names.
"""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.axes import CHECK, face_up
from imuarray.log.format import Phase

STILL_NAMES = frozenset({"static", "room"})
"""Names of phases at rest."""

MOVING_NAMES = frozenset({"motion"})
"""Names of phases in which the box moves, whether or not an axis is noted as up."""

OVEN_NAMES = frozenset({"heat", "heating", "warm-up", "soak", "cool", "cooling"})
"""Names of phases in which the box is at rest while its temperature changes."""

RUN = "run "
"""Beginning of the names of the runs of a turn-on series."""

_POSE = "pose "
"""Beginning of the names of rests in other poses than faces."""


def is_at_rest(phase: Phase) -> bool:
    """Return whether the box is at rest in a phase: the phase has the name of a rest, or an axis is noted as up and the
    name is not that of a motion.
    """
    name = phase.name
    is_named = name in STILL_NAMES or bool(face_up(name)) or name in OVEN_NAMES
    return is_named or name.startswith((RUN, _POSE)) or (bool(phase.up) and name not in MOVING_NAMES)


def is_face_check(phase: Phase) -> bool:
    """Return whether a phase is a face that is read again."""
    return phase.name.endswith(CHECK) and bool(face_up(phase.name))


def has_several_runs(phases: Sequence[Phase]) -> bool:
    """Return whether several phases of one log are named as runs, so that these names do not mean a rest."""
    return sum(phase.name.startswith(RUN) for phase in phases) > 1


def rests_of(phases: Sequence[Phase]) -> list[Phase]:
    """Return the phases of one log that are rests, in order."""
    is_ambiguous = has_several_runs(phases)
    return [
        phase
        for phase in phases
        if is_at_rest(phase) and not (is_ambiguous and phase.name.startswith(RUN) and not phase.up)
    ]


def steady_rests(phases: Sequence[Phase]) -> list[Phase]:
    """Return the rests of one log in which the box is neither heated nor cooled; all rests if there are no others."""
    rests = rests_of(phases)
    return [phase for phase in rests if phase.name not in OVEN_NAMES] or rests
