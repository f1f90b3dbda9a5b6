"""How readings follow the stimulus: place, axes, scale factors, nonlinearity, sensitivity to acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from imuarray.arrays import Floats, Reals
from imuarray.axes import AXES
from imuarray.simulate.effect import Effect, per_axis, several
from imuarray.simulate.signal import Analog, BoxStimulus, Place, Triple, per_row


@dataclass(frozen=True)
class SizeEffect(Effect):
    """force = force at the origin + angular_acceleration x r + rate x (rate x r), r the sensor's place in the box.

    `position_mm` in the box frame; rigid-body kinematics. In data: while the box turns, accelerometers differ by an
    amount that grows with their distance and with the square of the rate.
    """

    name: ClassVar[str] = "size_effect"
    meaning: ClassVar[str] = "a sensor away from the origin of the box senses the rotation of the box as specific force"
    position_mm: Triple = per_axis()

    def stimulus(self, stimulus: BoxStimulus, at: Place) -> BoxStimulus:
        """Add the rotational part of the specific force; a constant force remains constant if there is no rotation."""
        rate, acceleration = stimulus.rate_box, stimulus.angular_acceleration_box
        if rate.strides[0] == acceleration.strides[0] == 0:
            rate, acceleration = rate[:1], acceleration[:1]
        if not (rate.any() or acceleration.any()):
            return stimulus
        added = rotational_force(rate, acceleration, np.array(self.position_mm) * 1e-3)
        return replace(stimulus, force_box=stimulus.force_box + added) if added.any() else stimulus


def rotational_force(rate: Reals, acceleration: Reals, place_m: Floats) -> Floats:
    """Return the specific force (n, 3), in m/s2, that a rotation adds at a place (3,) of a rigid body, in m: the
    tangential and the centripetal one. `rate` (n, 3) is in rad/s, the angular `acceleration` (n, 3) in rad/s2, all in
    the frame of the body.
    """
    return np.asarray(np.cross(acceleration, place_m) + np.cross(rate, np.cross(rate, place_m)))


def with_position(effects: Sequence[Effect], position_mm: Triple) -> tuple[Effect, ...]:
    """Return the effects of a sensor at this position, unless one of them already states the position."""
    if not any(position_mm) or any(isinstance(effect, SizeEffect) for effect in effects):
        return tuple(effects)
    return (SizeEffect(position_mm), *effects)


_NOMINAL = "+X+Y+Z"


@dataclass(frozen=True)
class AxisError(Effect):
    """y_k = s_k x_a(k): the sensor's axis k is actually axis a(k), with the sign s_k, of the sensor as configured.

    `axes`, such as "+Y+X-Z", gives the true directions of x, y and z. Left-handed values are allowed, since a forgotten
    minus sign produces them. Everything that acts along the sensor's axes, including specific force on a gyroscope, is
    exchanged with them. The error is in the table that maps sensors to the box (the paper's Table 1). In data: two axes
    are exchanged, or one has the wrong sign, in all phases; nothing else changes.
    """

    name: ClassVar[str] = "axis_error"
    meaning: ClassVar[str] = "the axes of the sensor differ from the configuration"
    axes: str = field(default=_NOMINAL)

    def __post_init__(self) -> None:
        """Raise ValueError unless X, Y and Z occur once each, with a sign."""
        super().__post_init__()
        match = AXES.fullmatch(self.axes)
        if match is None or len(set(match.groups()[1::2])) < 3:
            raise ValueError(f"axes: {self.axes!r}; each of X, Y, Z once, signed, such as '+Y+X-Z'")

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes differ from the nominal ones."""
        return tuple(self.axes[at : at + 2] != _NOMINAL[at : at + 2] for at in (0, 2, 4))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Exchange axes and signs of the signal and of the specific force."""
        if self.axes == _NOMINAL:
            return analog
        return replace(analog, value=self._exchange(analog.value), force_g=self._exchange(analog.force_g))

    def _exchange(self, vectors: Reals) -> Reals:
        x, y, z = (1.0 if sign == "+" else -1.0 for sign in self.axes[::2])
        exchanged = np.take(vectors, ["XYZ".index(axis) for axis in self.axes[1::2]], axis=1)
        return exchanged * per_row((x, y, z), exchanged)


@dataclass(frozen=True)
class Misalignment(Effect):
    """y = D x, row i of D the unit vector along e_i + sum over j of tan(angle_ij) e_j.

    `angles_deg` in degrees, in the order xy, xz, yx, yz, zx, zy: the angle by which axis i is tilted towards axis j.
    Angles of opposite sign for ij and ji turn the triad as a whole (alignment to the package: BMA-119, ADX-66; of the
    boards: less than 5 degrees, the paper's section 5.2.1), equal ones make it oblique (cross-axis sensitivity:
    BMA-118, ADX-66). In data: on each face, a share sin(angle) of gravity in the axes that should read 0.
    """

    name: ClassVar[str] = "misalignment"
    meaning: ClassVar[str] = "the axes of the sensor are misaligned"
    angles_deg: tuple[float, ...] = several(6, low=-80.0, high=80.0)

    @property
    def directions(self) -> Reals:
        """Return (3, 3): row i is the unit vector along axis i in the sensor's nominal axes."""
        leaning = np.eye(3)
        leaning[~np.eye(3, dtype=bool)] = np.tan(np.radians(self.angles_deg))
        return np.asarray(leaning / np.linalg.norm(leaning, axis=1, keepdims=True))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Take the components along the misaligned axes."""
        if not any(self.angles_deg):
            return analog
        return replace(analog, value=np.asarray(analog.value @ self.directions.T.astype(analog.value.dtype)))


@dataclass(frozen=True)
class Nonlinearity(Effect):
    """y = x + quadratic x^2 + cubic x^3 for each axis separately, x in the sensor's unit.

    `quadratic` per unit, `cubic` per unit squared. Data sheets bound the deviation from the best straight line, as a
    share of full scale: BMA-117, ADX-65, L3G-73. In data: the mean of the two readings of an axis along and against
    gravity is not the bias (quadratic; opposed sensors of one design cancel this, the paper's section 2.1); the scale
    factor grows or falls with the range of motion (cubic); vibration shifts the mean (quadratic).
    """

    name: ClassVar[str] = "nonlinearity"
    meaning: ClassVar[str] = "the response is slightly nonlinear"
    quadratic: Triple = per_axis(suffix="_per_{u}")
    cubic: Triple = per_axis(suffix="_per_{u}2")

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Apply the polynomial to the signal."""
        if not any((*self.quadratic, *self.cubic)):
            return analog
        x = analog.value
        return replace(analog, value=x + x * x * (per_row(self.quadratic, x) + per_row(self.cubic, x) * x))


@dataclass(frozen=True)
class Scale(Effect):
    """y = x (1 + error) for each axis separately.

    `error` is relative: with 0.01 the readings are one per cent too large. Typical values are 1 % (ADX-63) and 2 to 3 %
    (the tolerances with BMA-70 to BMA-76); L3G-75 states none. The paper's Table 3 has -1.7 to +2.9 % for its eighteen
    accelerometer axes. In data: opposite faces differ by more or less than 2 g, and the integral over a known turn is
    not its angle.
    """

    name: ClassVar[str] = "scale"
    meaning: ClassVar[str] = "the scale factor differs from the data sheet"
    error: Triple = per_axis()

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Scale the signal."""
        if not any(self.error):
            return analog
        x, y, z = self.error
        return replace(analog, value=analog.value * per_row((1 + x, 1 + y, 1 + z), analog.value))


@dataclass(frozen=True)
class GSensitivity(Effect):
    """y = x + response f, f the specific force in g along the sensor's own axes.

    `response` (3x3, row after row) in the sensor's unit per g: entry ij is what force along axis j adds to axis i. A
    vibrating gyroscope is sensitive to force by its principle of operation: the paper's section 5.2.2 and Table 4
    (differences over 2 g of at most 0.038 dps; L3G-76). In data: a gyroscope at rest has a different bias on every face
    of the box.
    """

    name: ClassVar[str] = "g_sensitivity"
    meaning: ClassVar[str] = "specific force changes the reading of a sensor of another quantity"
    response: tuple[float, ...] = several(9, suffix="_{u}_per_g")

    def active_axes(self) -> tuple[bool, ...]:
        """Return (3,) which axes respond to force."""
        return tuple(any(self.response[at : at + 3]) for at in (0, 3, 6))

    def analog(self, analog: Analog, at: Place) -> Analog:
        """Add the response to specific force."""
        if not any(self.response):
            return analog
        columns = np.reshape(self.response, (3, 3)).T.astype(analog.value.dtype)
        return replace(analog, value=analog.value + analog.force_g @ columns)
