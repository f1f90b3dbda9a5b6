"""The repaired model: the base model with all causes in it, as a file for simulations and for another diagnosis.

Every sensor has its fitted parameters and its causes. Its other effects remain with its design, as populations.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from imuarray.gap.model.bench import Bench
from imuarray.gap.model.populations import own_unit, usual_model
from imuarray.gap.model.replication import ORDINARY, Models, SensorModel
from imuarray.log.format import SensorHeader
from imuarray.simulate.effect import Effect, to_table
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.temperature import ThermalBias
from imuarray.simulate.model import TRIADS, Model, Part, noise_bandwidth_hz
from imuarray.simulate.population import Recipe, figure_of

_SLOPE = "slope_"
"""Prefix of the keys of the fitted part of `thermal_bias`."""

_QUADRATIC = "quadratic_"

_HARMLESS: Recipe = {}
"""Recipe of an effect without arguments, which does nothing."""


def repair_model(
    bench: Bench, models: Models, model: Model | None, name: str, *, about: str = "", logs: Sequence[str] = ()
) -> Model:
    """Return the repaired model with this `name` for the bench's sensors: `models` on top of the designs of `model`, on
    which the diagnosis was based (None: the data sheets' scale and misalignment). Units of `model` that were not
    recorded keep their parameters.

    If an effect of the design was detected as absent, the sensor gets it with harmless values instead. `about` is the
    description in the file; by default it states what was diagnosed, from `logs` or from how many logs of which kinds.
    """
    headers = bench.base.headers
    rest = model or usual_model(headers.values())
    sensors = tuple(_sensor(rest, header, models[sensor]) for sensor, header in headers.items())
    others = tuple(part for part in rest.sensors if part.name not in headers)
    return Model(name, about or _about(bench, models, model, logs), rest.designs, (*sensors, *others))


def _sensor(model: Model, header: SensorHeader, own_model: SensorModel) -> Part:
    """Return the model of one sensor, without the effects that it shares with its designs."""
    parts = model.parts(header)
    added: dict[str, list[Recipe]] = {}
    for effect in (*own_model.fitted.effects(), *own_model.added):
        added.setdefault(effect.name, []).append(_recipe(effect, header))
    effects: dict[str, tuple[Recipe, ...]] = {}
    for kind in EFFECTS:
        present = tuple(_kept(kind, parts[kind].effects[kind])) if kind in parts else ()
        remaining = () if kind in own_model.removed else present
        is_own = kind in parts and bool(parts[kind].name)
        if kind in added or (remaining and is_own):
            effects[kind] = (*remaining, *added.get(kind, ()))
        elif kind in own_model.removed and kind in model.parts(header, population=True):
            effects[kind] = (_HARMLESS,)
    known = TRIADS.get(header.chip)
    range_ = header.range if known is None or header.range in known.sensitivity else None
    return Part(header.chip, range_, header.name, noise_bandwidth_hz(header) or None, effects, own_unit(header))


def _kept(kind: str, recipes: Sequence[Recipe]) -> Iterator[Recipe]:
    """Yield the part of a model's effect that is not fitted: all, nothing, or the curve of a bias over temperature."""
    if kind not in ORDINARY:
        yield from recipes
    elif kind == ThermalBias.name:
        for recipe in recipes:
            if any(key.startswith(_QUADRATIC) for key in recipe):
                yield {key: figure for key, figure in recipe.items() if not key.startswith(_SLOPE)}


def _recipe(effect: Effect, header: SensorHeader) -> Recipe:
    return {key: figure_of(value, effect.name) for key, value in to_table(effect, header.unit).items()}


def _about(bench: Bench, models: Models, model: Model | None, logs: Sequence[str]) -> str:
    """Return a description of what was diagnosed from which logs."""
    kinds = " and ".join(f"{count} {kind}" for kind, count in Counter(bench.kinds).items())
    source = ", ".join(logs) or f"{kinds} {'log' if len(bench.kinds) == 1 else 'logs'}"
    changed_sensors = [
        f"{name} {words}" for name, sensor_model in models.items() if (words := ", ".join(_changes(sensor_model)))
    ]
    before = f"model {model.name}" if model else "the data sheets"
    changes = f"with {'; '.join(changed_sensors)}" if changed_sensors else "without a cause"
    return f"{len(bench.base.headers)} sensors as diagnosed from {source}: {before}, fitted, {changes}."


def _changes(sensor_model: SensorModel) -> Iterator[str]:
    kinds = [effect.name for effect in sensor_model.added]
    yield from dict.fromkeys(kinds)
    yield from (f"without {kind}" for kind in sorted(sensor_model.removed - set(kinds)))
