"""Populations of parameters: a number, or a distribution from which every unit of a design draws its own value.

In a model file a population is a table: ``offset_g = { mean = 0.0, sigma = 0.03, limit = 0.06, shared = 0.5 }``, drawn
anew for each axis, or a list with one such table or number for each axis. Draws are keyed by (seed, sensor, effect,
parameter): they do not depend on the draws of another parameter, effect or sensor, nor on the measuring range.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import Field
from functools import cache
from statistics import NormalDist
from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic import Field as Limits

from imuarray.arrays import Floats
from imuarray.errors import ConfigError
from imuarray.log.format import SensorHeader
from imuarray.simulate.streams import Streams
from imuarray.toml_files import complaints

HUGE = 1e12
"""Limit of the magnitude of any parameter, in any unit."""

_Number = Annotated[float, Limits(ge=-HUGE, le=HUGE)]
_Size = Annotated[float, Limits(ge=0, le=HUGE)]


class Spread(BaseModel):
    """A normal population: `mean`, standard deviation `sigma`, no value further than `limit` from the mean (default:
    three sigma), all in the parameter's unit.

    `shared` is the share of the variance that all units of the chip have in common, because it belongs to the design
    and not to the single part. The limit truncates the population as if draws beyond it were repeated.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    mean: _Number = 0.0
    sigma: _Size
    limit: _Size | None = None
    shared: Annotated[float, Limits(ge=0, le=1)] = 0.0

    @property
    def reach(self) -> float:
        """The largest possible deviation from the mean."""
        if self.sigma == 0:
            return 0.0
        return 3 * self.sigma if self.limit is None else self.limit

    def at(self, deviate: float) -> float:
        """Return the value of a unit at this standard normal `deviate`: the quantile at its probability."""
        if self.reach == 0:
            return self.mean
        beyond, below = _probability(-self.reach / self.sigma), _probability(deviate)
        if below in (0.0, 1.0):
            return self.mean + math.copysign(self.reach, deviate)
        deviation = self.sigma * _NORMAL.inv_cdf(beyond + below * (1 - 2 * beyond))
        return self.mean + min(max(deviation, -self.reach), self.reach)


_NORMAL = NormalDist()
"""The standard library's standard normal distribution, because importing `scipy.special` takes 0.1 s."""


def _probability(deviate: float) -> float:
    """Return the probability that a standard normal value is below `deviate`, precise even for small probabilities."""
    return 0.5 * math.erfc(-deviate / math.sqrt(2))


Figure: TypeAlias = "float | str | Spread | tuple[float | str | Spread, ...]"
"""A parameter as a model file states it."""

Recipe: TypeAlias = Mapping[str, Figure]
"""An effect as a model file states it: parameters by key, including the suffix of the unit."""


def figure_of(value: Any, where: str) -> Figure:
    """Return a parameter from its TOML value; ConfigError for a table that is not a population, a nested list, or a
    number beyond the limit.
    """
    if isinstance(value, list):
        return tuple(_item(part, f"{where}, number {number}") for number, part in enumerate(value, start=1))
    return _item(value, where)


def table_of(figure: Figure) -> Any:
    """Return the parameter as a TOML value."""
    if isinstance(figure, tuple):
        return [table_of(part) for part in figure]
    return figure.model_dump(exclude_defaults=True) if isinstance(figure, Spread) else figure


def at_ends(recipe: Recipe, spelled: Mapping[str, Field[Any]], side: int) -> dict[str, Any]:
    """Return the recipe with numbers in place of populations: their means (`side` 0), or their lower or upper ends (-1,
    +1). `spelled` are the effect's parameters by key.
    """

    def end(_: int, spread: Spread) -> float:
        return spread.mean + side * spread.reach

    return {key: _fill(figure, _count(spelled.get(key)), end) for key, figure in recipe.items()}


def drawn(
    recipe: Recipe, spelled: Mapping[str, Field[Any]], effect: str, sensor: SensorHeader, streams: Streams
) -> dict[str, Any]:
    """Return the recipe with this sensor's draws in place of populations; `effect` is the name of the effect in the
    keys of the draws. `spelled` are the effect's parameters by key.
    """
    return {
        key: _fill(figure, _count(spelled[key]), _draw(spelled[key], effect, sensor, streams))
        for key, figure in recipe.items()
    }


def _item(value: Any, where: str) -> float | str | Spread:
    if isinstance(value, dict):
        return _spread_of(value, where)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ConfigError(f"{where}: {str(value)[:40]}; a number, a text or a table with mean and sigma is required")
    if not isinstance(value, str) and HUGE < abs(value) < math.inf:
        raise ConfigError(f"{where}: a number beyond {HUGE:g}, which no sensor has")
    return math.nan if value != value else value  # one nan object, so that recipes with it compare equal


def _spread_of(table: dict[str, Any], where: str) -> Spread:
    try:
        return Spread.model_validate(table)
    except ValidationError as error:
        raise ConfigError(f"{where}: {complaints(error, table, Spread)}") from None


def _fill(figure: Figure, count: int, value: Callable[[int, Spread], float]) -> Any:
    """Return the parameter with `value` of (index, population) in place of populations; a single population is drawn
    `count` times.
    """
    if isinstance(figure, Spread):
        return [value(index, figure) for index in range(count)] if count else value(0, figure)
    if isinstance(figure, tuple):
        return [value(index, part) if isinstance(part, Spread) else part for index, part in enumerate(figure)]
    return figure


def _draw(parameter: Field[Any], effect: str, sensor: SensorHeader, streams: Streams) -> Callable[[int, Spread], float]:
    """Return a function that draws a sensor's value for (index, population) of a parameter."""

    @cache
    def normal(whose: str) -> Floats:
        return streams.of_unit(whose, effect, parameter.name).standard_normal(_count(parameter) or 1)

    def value(index: int, spread: Spread) -> float:
        own = normal(sensor.name)[index]
        if not spread.shared:
            return spread.at(own)
        common = normal(f"all {sensor.chip}")[index]  # a name with a blank, which no sensor has
        return spread.at(math.sqrt(1 - spread.shared) * own + math.sqrt(spread.shared) * common)

    return value


def _count(parameter: Field[Any] | None) -> int:
    """Return the length of the parameter's list; 0 for a single number or no parameter."""
    return 0 if parameter is None or not isinstance(parameter.default, tuple) else len(parameter.default)
