"""`opposed`: anti-parallel axes of one design show the error that all its units share; it is taken out."""

from __future__ import annotations

from collections.abc import Sequence

from imuarray.fuse.axes import Axis, directions
from imuarray.fuse.frames import Estimate, Frames
from imuarray.fuse.solve import SlowErrors, solve_frames, weighted
from imuarray.fuse.techniques.common_mode import CommonMode, opposing_groups
from imuarray.fuse.techniques.technique import Technique, noise_of


def opposed(axes: Sequence[Axis]) -> Technique:
    """The error that all units of a design share is seen by anti-parallel axes and taken out (paper, section 2.1).

    It cancels what is alike in every unit, as far as they are seen to agree: the level at the start, drift with
    temperature, the mean of even-order terms. Where as many axes of a design point one way as the other the average
    does it already; where all point the same way nothing can be seen. `pairs.capabilities` says what it can cancel.
    """
    rows, noise, slow = directions(axes), noise_of(axes), SlowErrors(axes)
    modes = [CommonMode(group) for group in opposing_groups(axes)]

    def fused(frames: Frames) -> Estimate:
        weights = frames.valid.astype(float)
        residual = frames.values - solve_frames(frames.values, weights, rows) @ rows.T
        values = frames.values.copy()
        for mode in modes:
            values[:, mode.members] -= mode.estimate(frames.time, residual, frames.valid)[:, None]
        return weighted(values, weights, rows, noise, slow)

    return fused


def changes(axes: Sequence[Axis]) -> list[str]:
    """What it treats otherwise than the average does: design and box axis."""
    return [f"{axes[group.along[0]].chip} along {group.box_axis}" for group in opposing_groups(axes)]
