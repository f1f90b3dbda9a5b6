"""What units of a chip are like before anything is blamed, where nobody has a model of them: the populations of what no
fit to logs tells.

The data sheets' figures where they say how readings of an array scatter, else what is usual. All that asks what a
sensor may have beside what is fitted to it asks here: the base model's replicates, the designs of a repaired model, and
models that have the usual and an effect more.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType

from imuarray.log.format import SensorHeader
from imuarray.shipped import configs
from imuarray.simulate.effects.white_noise import WhiteNoise
from imuarray.simulate.model import TRIADS, Model, Part, load_model, noise_bandwidth_hz
from imuarray.simulate.population import Recipe, Spread
from imuarray.simulate.signal import Triple
from imuarray.simulate.streams import Streams

SCALE_SIGMA, ANGLE_SIGMA_DEG, G_SENSITIVITY_SIGMA = 0.01, 0.7, 0.01
"""Population of sensors in an array. Of angles data sheets say how a die lies in its package (half a degree, BMA-119),
and not how that was soldered and its board screwed on. The paper's gyroscopes changed by up to 0.038 dps over 2 g (its
Table 4).
"""

USUAL: Mapping[str, Recipe] = MappingProxyType(
    {
        "own_clock": {"phase_deg": math.nan},
        "scale": {"error": Spread(sigma=SCALE_SIGMA)},
        "misalignment": {"angles_deg": Spread(sigma=ANGLE_SIGMA_DEG)},
    }
)
"""What sensors have beside the fitted, where there is no model."""

_USUAL_AT_DPS: Mapping[str, Recipe] = MappingProxyType(
    {"g_sensitivity": {"response_dps_per_g": Spread(sigma=G_SENSITIVITY_SIGMA)}}
)

PRINTED = frozenset({"scale"})
"""Those for which the data sheets' populations are taken where there are any. Not the clock's: with a rate that is off,
ages go round within a log, so that every replicate has the same mean age; at the set rate, in step with the polls, they
stay what they are. A recording may be like either, and is no odd one among replicates that keep step.
"""


def usual_model(headers: Iterable[SensorHeader]) -> Model:
    """The designs of these sensors' chips, with nothing but what no fit tells."""
    parts: dict[tuple[str, str, float | None], Part] = {}
    for header in headers:
        for part in (part for part in _data_sheets().designs if part.fits(header)):
            if kept := {kind: recipes for kind, recipes in part.effects.items() if kind in PRINTED}:
                parts[part.chip, "", part.range] = replace(part, noise_bandwidth_hz=None, effects=kept)
        known = Model("", "", tuple(parts.values()), ()).parts(header)
        if missing := {kind: (recipe,) for kind, recipe in _usual(header.unit).items() if kind not in known}:
            unit = own_unit(header)
            before = parts.get((header.chip, unit, None), Part(header.chip, unit=unit))
            parts[header.chip, unit, None] = replace(before, effects={**before.effects, **missing})
    return Model("data sheets", "", tuple(parts.values()), ())


def printed_noise(header: SensorHeader) -> Triple | None:
    """Standard deviation of readings along a sensor's axes as its data sheet has it, in its unit, at the bandwidth that
    is set; None where the sheet says nothing, or nothing is known of the bandwidth.
    """
    if noise_bandwidth_hz(header) <= 0:
        return None
    effects = _data_sheets().effects(header, Streams(0))
    return next((one.rms for one in effects if isinstance(one, WhiteNoise)), None)


def own_unit(header: SensorHeader) -> str:
    """What the part of a chip that we don't drive has to say of its unit."""
    return "" if header.chip in TRIADS else header.unit


def _usual(unit: str) -> dict[str, Recipe]:
    return {**USUAL, **(_USUAL_AT_DPS if unit == "dps" else {})}


@cache
def _data_sheets() -> Model:
    """The shipped model of units as the data sheets describe them."""
    return load_model(configs() / "models" / "datasheet.toml")
