"""True responses of simulated sensors."""

from __future__ import annotations

import numpy as np

from tests.calibrate.conftest import Floats
from tests.calibrate.turn_effects import SCALE


def true_response(sensitivity: float, orientation: Floats) -> Floats:
    """The response (3, 3) in counts per dps after the effects are applied to an ideal sensor."""
    leaning = np.eye(3) + np.tan(np.radians([[0, 0.5, -1.0], [0.8, 0, 0.3], [-0.6, 1.2, 0]]))
    leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
    return np.asarray(sensitivity * np.diag(1 + np.array(SCALE)) @ leaning @ orientation.T)
