"""Arrays that are turned from pose to pose, simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from imuarray.simulate.effect import Effect
from imuarray.simulate.effects.bias import Bias
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.effects.response import GSensitivity, Misalignment, Scale

ACCELEROMETERS = ("BMA1", "BMA2")
GYROSCOPES = ("Gyro1", "Gyro3")
SCALE = (0.02, -0.03, 0.015)
LEAN = Misalignment((0.5, -1.0, 0.8, 0.3, -0.6, 1.2))
G_SENSITIVITY = (0.10, -0.05, 0.02, 0.03, 0.08, -0.06, -0.04, 0.01, 0.07)
"""dps per g."""


def effects(noise_g: float, noise_dps: float) -> dict[str, tuple[Effect, ...]]:
    """Accelerometers with noise and bias only; gyroscopes with errors of all kinds that a tumble determines."""
    still = {name: (WhiteNoise((noise_g,) * 3), Bias((0.1, -0.05, 0.02))) for name in ACCELEROMETERS}
    turning = (
        WhiteNoise((noise_dps,) * 3),
        Bias((0.5, -0.7, 0.3)),
        Scale(SCALE),
        LEAN,
        GSensitivity(G_SENSITIVITY),
    )
    return {**still, **dict.fromkeys(GYROSCOPES, turning)}


def drawn_effects(rng: np.random.Generator, noise_g: float, noise_dps: float) -> dict[str, tuple[Effect, ...]]:
    """The same, with errors of the response that are drawn for each gyroscope from the tolerance of its data sheet."""
    turning = {
        name: (
            WhiteNoise((noise_dps,) * 3),
            Bias((0.5, -0.7, 0.3)),
            Scale(tuple(TOLERANCE * rng.normal(size=3))),
            Misalignment(tuple(np.degrees(TOLERANCE) * rng.normal(size=6))),
            GSensitivity(G_SENSITIVITY),
        )
        for name in GYROSCOPES
    }
    return {**effects(noise_g, noise_dps), **turning}


def changed_effects(
    effects: Mapping[str, Sequence[Effect]], rng: np.random.Generator, share: float
) -> dict[str, tuple[Effect, ...]]:
    """The same, after each entry of a gyroscope's response has changed by a draw of `share` of the scale."""

    def changed(effect: Effect) -> Effect:
        if isinstance(effect, Scale):
            return Scale(tuple(np.add(effect.error, share * rng.normal(size=3)).tolist()))
        if isinstance(effect, Misalignment):
            return Misalignment(tuple(np.add(effect.angles_deg, np.degrees(share) * rng.normal(size=6)).tolist()))
        return effect

    return {
        name: tuple(changed(effect) for effect in each) if name in GYROSCOPES else tuple(each)
        for name, each in effects.items()
    }


TOLERANCE = 0.02
"""L3G-72: 2 % of scale; as much of misalignment is 1.1 degrees."""


def about(axes: str, count: int, rng: np.random.Generator) -> Rotation:
    """Attitudes, each turned from the previous one by 50 to 150 degrees about the next of these box axes, in either
    sense.
    """
    made = [Rotation.random(random_state=rng)]
    for step in range(count - 1):
        axis = np.eye(3)["XYZ".index(axes[step % len(axes)])]
        made.append(made[-1] * Rotation.from_rotvec(rng.choice([-1, 1]) * np.radians(rng.uniform(50, 150)) * axis))
    return Rotation.concatenate(made)
