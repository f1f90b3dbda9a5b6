"""Mechanisms of mounting: a sensor's position and direction on the box, and the socket into which it is plugged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import FittedBoard, Mechanism, SensorMechanism
from firmware_emulator.mechanisms.site import ACCELEROMETERS, Site, plus
from firmware_emulator.world import WorldStimulus, cross, seen_after_turn


@dataclass(frozen=True)
class PackageTilt(SensorMechanism):
    """The package was tilted when the solder solidified.

    The package is rotated by `tilt_deg` about an axis that depends on the part (Rodrigues). Reference: 2 degrees.
    """

    tilt_deg: float = 2.0

    resembles: ClassVar[tuple[str, ...]] = ("misalignment",)
    scaled: ClassVar[tuple[str, ...]] = ("tilt_deg",)

    def put_on(self, site: Site) -> None:
        """Rotate force, rate and field together."""
        x, y, z = site.direction("tilt")
        length = math.sqrt(x * x + y * y + z * z)
        axis = x / length, y / length, z / length
        cosine, sine = math.cos(math.radians(self.tilt_deg)), math.sin(math.radians(self.tilt_deg))
        site.chain.stimulus.append(Rotation(axis, cosine, sine))


class Rotation:
    """A function that returns the stimulus after a rotation about `axis`: the same object for the same stimulus."""

    def __init__(self, axis: tuple[float, float, float], cosine: float, sine: float) -> None:
        self._turn = axis, cosine, sine
        self._before: WorldStimulus | None = None
        self._after = WorldStimulus()

    def __call__(self, at_ns: int, stimulus: WorldStimulus) -> WorldStimulus:
        """Return the rotated stimulus; it is the same object as long as `stimulus` is the same."""
        if stimulus is not self._before:
            self._before = stimulus
            self._after = stimulus._replace(
                force_box=seen_after_turn(stimulus.force_box, *self._turn),
                rate_box=seen_after_turn(stimulus.rate_box, *self._turn),
                field_box=seen_after_turn(stimulus.field_box, *self._turn),
            )
        return self._after


@dataclass(frozen=True)
class RotatedPackage(SensorMechanism):
    """A square package that was soldered with a rotation of 90 degrees.

    The package is rotated by `quarters` quarter turns about the sensor's own z: after one, x measures the stimulus of
    y, and y the negative of that of x.

    It is present or absent: every severity is one quarter turn.
    """

    quarters: int = 1

    resembles: ClassVar[tuple[str, ...]] = ("axis_error",)

    def put_on(self, site: Site) -> None:
        """Rotate about the sensor's z axis, which in the box frame is the last column of its orientation."""
        x, y, z = (row[2] for row in site.orientation)
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[self.quarters % 4]
        site.chain.stimulus.append(Rotation((x, y, z), cosine, sine))


HALF_NS = 500_000


@dataclass(frozen=True)
class LeverArm(SensorMechanism):
    """A sensor at a distance from the point about which the box turns.

    f' = f + a x r + w x (w x r), r of length `arm_m` in a direction that depends on the part, a the derivative of the
    rate w.

    Rigid-body kinematics; a is a central difference over 1 ms. Reference: 50 mm.
    """

    arm_m: float = 0.05

    touches: ClassVar[tuple[str, ...]] = ACCELEROMETERS
    resembles: ClassVar[tuple[str, ...]] = ("size_effect",)
    scaled: ClassVar[tuple[str, ...]] = ("arm_m",)

    def put_on(self, site: Site) -> None:
        """Act in the box frame."""
        x, y, z = site.direction("arm")
        share = self.arm_m / math.sqrt(x * x + y * y + z * z)
        arm, world = (x * share, y * share, z * share), site.world

        def changed_stimulus(at_ns: int, stimulus: WorldStimulus) -> WorldStimulus:
            earlier, later = world(max(0, at_ns - HALF_NS)), world(at_ns + HALF_NS)
            if earlier is later is stimulus:
                return stimulus
            speeding = plus(later.rate_box, earlier.rate_box, -1.0)
            force = plus(stimulus.force_box, cross(speeding, arm), 0.5e9 / HALF_NS)
            turning: Triple = cross(stimulus.rate_box, cross(stimulus.rate_box, arm))
            return stimulus._replace(force_box=plus(force, turning, 1.0))

        site.chain.stimulus.append(changed_stimulus)


@dataclass(frozen=True)
class CrossedWiring(Mechanism):
    """Two sensors of one kind that are plugged into each other's socket.

    Each of two sensors of one chip answers instead of the other, with its own unit and orientation.

    It is present or absent: every severity is the same.
    """

    place: ClassVar[str] = "pair"
    resembles: ClassVar[tuple[str, ...]] = ("channel_swap",)

    def fit(self, board: FittedBoard, sites: Sequence[Site]) -> None:
        """Swap the two sensors including their ranges, because chips are set up through the same crossed wires."""
        first, second = sites
        board.crossed |= {first.name: second.name, second.name: first.name}


@dataclass(frozen=True)
class DroppedBox(SensorMechanism):
    """The box fell from the bench after the first recording.

    A box that was dropped: from power-up number 1 on, the bias of each axis is permanently shifted, by `shift_g` or
    `shift_dps` on average.

    Permanent deformation of the die's attachment; data sheets of that time state no figure. Reference: 15 mg or 0.5
    dps.
    """

    shift_g: float = 15e-3
    shift_dps: float = 0.5

    resembles: ClassVar[tuple[str, ...]] = ("bias", "turn_on_bias")
    scaled: ClassVar[tuple[str, ...]] = ("shift_g", "shift_dps")

    def put_on(self, site: Site) -> None:
        """Add the shift, except before the fall."""
        if site.run > 0:
            site.add("fall", self.shift_g, self.shift_dps, lambda at_ns, stimulus: 1.0)
