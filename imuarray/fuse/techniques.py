"""How the axes of an array become one triad: the simple average and the paper's three techniques, each alone.

All of them solve ``values = directions @ truth_box`` by weighted least squares, frame by frame. `opposed` corrects
the values before, the others choose the weights. None of them, the average included, uses a reading whose flags say
that it is clipped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from imuarray.errors import FusionError
from imuarray.fuse.align import Axis, Frames, directions, solve_frames
from imuarray.fuse.common_mode import CommonMode, opposing_groups

Floats = npt.NDArray[np.float64]

Technique = Callable[[Frames], Floats]
"""Frames of one quantity, block after block in order, to the fused triad (n, 3) in SI in the box frame."""

TAPER = (0.75, 0.95)
"""Share of the measuring range at which a low-range sensor begins to be trusted less, and at which it is not used at
all.
"""

WORTH_WEIGHING = 1.25
"""Ratio of variances below which inverse-variance weights would gain less than 1 % over equal ones, and are left
alone.
"""


def mean(axes: Sequence[Axis]) -> Technique:
    """Every axis weighs the same: the simple average of the literature (paper, section 2)."""
    rows = directions(axes)
    return lambda frames: solve_frames(frames.values, frames.valid.astype(float), rows)


def opposed(axes: Sequence[Axis]) -> Technique:
    """The error that all units of a design share is seen by anti-parallel axes and taken out (paper, section 2.1).

    It cancels whatever drifts alike in every unit: even-order terms, drift with temperature. Where as many axes of a
    design point one way as the other the average does it already; where all point the same way nothing can be seen.
    """
    rows = directions(axes)
    modes = [CommonMode(group) for group in opposing_groups(axes)]

    def fused(frames: Frames) -> Floats:
        weights = frames.valid.astype(float)
        residual = frames.values - solve_frames(frames.values, weights, rows) @ rows.T
        values = frames.values.copy()
        for mode in modes:
            values[:, mode.members] -= mode.estimate(frames.time, residual, frames.valid)[:, None]
        return solve_frames(values, weights, rows)

    return fused


def planes(axes: Sequence[Axis]) -> Technique:
    """In-plane and out-of-plane axes by their measured noise (paper, section 2.2); see `plane_weights`."""
    rows, weights = directions(axes), plane_weights(axes)
    return lambda frames: solve_frames(frames.values, weights * frames.valid, rows)


def ranges(axes: Sequence[Axis]) -> Technique:
    """Low and high measuring ranges of one design blended by inverse variance (paper, section 2.3).

    The low range's weight falls smoothly to exactly zero before the end of its range, by the largest axis of its own
    triad; the high range then carries on alone. Weights otherwise as in `range_weights`.
    """
    rows, weights, span = directions(axes), range_weights(axes), np.array([axis.range_si for axis in axes])
    tapered = np.array([axis.range_si < _widest(axes, axis.chip) for axis in axes])

    def fused(frames: Frames) -> Floats:
        use = np.abs(frames.values / span).reshape(len(frames.values), -1, 3).max(axis=2).repeat(3, axis=1)
        share = np.clip((TAPER[1] - use) / (TAPER[1] - TAPER[0]), 0, 1)
        smooth = np.where(tapered, share * share * (3 - 2 * share), 1.0)
        return solve_frames(frames.values, weights * smooth * frames.valid, rows)

    return fused


def plane_weights(axes: Sequence[Axis]) -> Floats:
    """(m,) Within a design the better kind of axis weighs 1 and the other the ratio of the variances.

    Kinds that scatter too much alike for a gain weigh as in the average. The variances are means over the design's
    units and ranges, each unit's relative to its own three axes, so that only the plane matters here. FusionError
    where the noise of an axis is not known.
    """
    _need_noise(axes)
    weights = np.ones(len(axes))
    for chip in {axis.chip for axis in axes}:
        variance = {kind: np.mean(_relative_variances(axes, chip, kind)) for kind in (True, False)}
        best = min(variance.values())
        for index, axis in enumerate(axes):
            if axis.chip == chip and max(variance.values()) > WORTH_WEIGHING * best:
                weights[index] = best / variance[axis.in_plane]
    return weights


def range_weights(axes: Sequence[Axis]) -> Floats:
    """(m,) Within a design each measuring range weighs by its inverse variance, a mean over its units and axes.

    A design with one range, or whose ranges scatter too much alike for a gain, weighs as in the average, and no design
    gains on another. FusionError where the noise of an axis is not known.
    """
    _need_noise(axes)
    weights = np.ones(len(axes))
    for chip in {axis.chip for axis in axes}:
        members = [index for index, axis in enumerate(axes) if axis.chip == chip]
        spans = {axes[index].range_si for index in members}
        variance = {
            span: np.mean([_noise(axes[i]) ** 2 for i in members if axes[i].range_si == span]) for span in spans
        }
        if max(variance.values()) > WORTH_WEIGHING * min(variance.values()):
            weights[members] = [1 / variance[axes[index].range_si] for index in members]
            weights[members] *= len(members) / weights[members].sum()
    return weights


def changes(technique: str, axes: Sequence[Axis]) -> list[str]:
    """What a technique treats otherwise than the plain average does, in words; empty if nothing on this array."""
    if technique == "opposed":
        return [f"{axes[group.along[0]].chip} along {group.box_axis}" for group in opposing_groups(axes)]
    if technique == "planes":
        different = ~np.isclose(plane_weights(axes), 1.0)
    elif technique == "ranges":
        different = np.array([axis.range_si < _widest(axes, axis.chip) for axis in axes])
    else:
        return []
    return sorted({axis.chip for axis, other in zip(axes, different, strict=True) if other})


def _widest(axes: Sequence[Axis], chip: str) -> float:
    """The widest measuring range of a design."""
    return max(axis.range_si for axis in axes if axis.chip == chip)


TECHNIQUES: Mapping[str, Callable[[Sequence[Axis]], Technique]] = MappingProxyType(
    {"mean": mean, "opposed": opposed, "planes": planes, "ranges": ranges}
)

NEEDS_NOISE = frozenset({"planes", "ranges"})
"""Techniques that must know how much each axis scatters (`calibrate noise`)."""


def _need_noise(axes: Sequence[Axis]) -> None:
    for axis in axes:
        if axis.noise_si is not None and not axis.noise_si > 0:
            raise FusionError(f"sensor {axis.sensor} axis {'xyz'[axis.index]}: noise {axis.noise_si}: it is stuck")
        if axis.noise_si is None:
            raise FusionError(
                f"sensor {axis.sensor}: its noise is not known; run `imuarray calibrate noise` and give the file"
            )


def _noise(axis: Axis) -> float:
    return axis.noise_si or 0.0


def _relative_variances(axes: Sequence[Axis], chip: str, in_plane: bool) -> list[float]:
    """Variances of one kind of axis of a design, each relative to the mean of its own triad."""
    relative = []
    for axis in axes:
        if axis.chip == chip and axis.in_plane == in_plane:
            triad = [_noise(other) ** 2 for other in axes if other.sensor == axis.sensor]
            relative.append(float(_noise(axis) ** 2 / np.mean(triad)))
    return relative
