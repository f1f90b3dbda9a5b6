"""A model file: which effects the sensors of an array have, unit by unit or as a population.

::

    [model]      name  about
    [[design]]   chip  range  noise_bandwidth_hz             what units of this chip look like, at this range
    [[sensor]]   name  chip  range  noise_bandwidth_hz       one known unit; a chip without a driver states its unit
                 [design.bias], [[sensor.tone]], ...         its effects; several of a kind as an array of tables

For each effect, a sensor uses the first of these tables that has it: its [[sensor]] at its range, its [[sensor]] at any
range, the [[design]] of its chip at its range, the [[design]] of its chip. Values are numbers or populations
(`population`); their keys contain the sensor's unit ("offset_g").
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, PlainValidator, create_model, model_validator

from imuarray.chips import CHIPS
from imuarray.errors import ConfigError
from imuarray.log.format import SensorHeader
from imuarray.simulate.converters import adxl345_bandwidth_hz
from imuarray.simulate.effect import Effect, from_table, spelled
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.effects.conversion import RangeReset
from imuarray.simulate.effects.noise import WhiteNoise
from imuarray.simulate.population import Recipe, at_ends, drawn, figure_of, table_of
from imuarray.simulate.streams import Streams
from imuarray.toml_files import Mistake, Place, parse_toml, read_text, refusal

TRIADS = {name: spec for name, spec in CHIPS.items() if spec.sensitivity}
"""The chips whose readings pass through effects."""

_STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@dataclass(frozen=True)
class Part:
    """A chip and its effects: one known unit called `name`, or (without a name) all units of its design.

    `range` in the chip's unit (None: any). `noise_bandwidth_hz` is the bandwidth at which the value of its white noise
    holds; at another bandwidth the noise is proportional to the root of the bandwidth (None: the noise is the same at
    any bandwidth). `unit` is the unit of the values for a chip that `imuarray.chips` does not have ("g", "dps" or
    "gauss"), "" for the others.
    """

    chip: str
    range: float | None = None
    name: str = ""
    noise_bandwidth_hz: float | None = None
    effects: Mapping[str, tuple[Recipe, ...]] = field(default_factory=dict)
    unit: str = ""

    def fits(self, sensor: SensorHeader) -> bool:
        """Return whether this part describes the sensor, at its settings."""
        return (
            self.chip == sensor.chip
            and self.unit in ("", sensor.unit)
            and self.name in ("", sensor.name)
            and self.range in (None, sensor.range)
        )

    def to_table(self) -> dict[str, Any]:
        """Return the part as a TOML table."""
        head = {key: getattr(self, key) for key in ("name", "chip", "unit", "range", "noise_bandwidth_hz")}
        tables = {
            effect: [{key: table_of(figure) for key, figure in recipe.items()} for recipe in recipes]
            for effect, recipes in self.effects.items()
        }
        return {
            **{key: value for key, value in head.items() if value not in (None, "")},
            **{effect: several[0] if len(several) == 1 else several for effect, several in tables.items()},
        }


@dataclass(frozen=True)
class Model:
    """The contents of a model file: the designs, the known units, and its text."""

    name: str
    about: str
    designs: tuple[Part, ...]
    sensors: tuple[Part, ...]
    text: str = field(default="", compare=False, repr=False)

    def effects(
        self, sensor: SensorHeader, streams: Streams, *, population: bool = False, without: Set[str] = frozenset()
    ) -> tuple[Effect, ...]:
        """Return the effects of one sensor, drawn where the model has populations, in physical order; none for a chip
        that the model does not know.

        With `population`, known units are ignored: every sensor is drawn from its design. Effects named in `without`
        are omitted.
        """
        parts = self.parts(sensor, population=population)
        return tuple(
            effect
            for kind in EFFECTS
            if kind in parts and kind not in without
            for effect in self._make_effects(kind, parts[kind], sensor, streams)
        )

    def parts(self, sensor: SensorHeader, *, population: bool = False) -> dict[str, Part]:
        """Return, for each effect of the sensor, the part that defines it."""
        fitting = [part for part in (*(() if population else self.sensors), *self.designs) if part.fits(sensor)]
        fitting.sort(key=lambda part: (not part.name, part.range is None), reverse=True)
        return {kind: part for part in fitting for kind in part.effects}

    def to_toml(self) -> str:
        """Return the model as text that `parse_model` reads as the same model."""
        table: dict[str, Any] = {"model": {"name": self.name, "about": self.about}}
        for key, parts in (("design", self.designs), ("sensor", self.sensors)):
            if parts:
                table[key] = [part.to_table() for part in parts]
        return tomli_w.dumps(table)

    def _make_effects(self, kind: str, part: Part, sensor: SensorHeader, streams: Streams) -> Iterator[Effect]:
        keys, where = spelled(EFFECTS[kind], sensor.unit), f"model {self.name}: sensor {sensor.name}: {kind}"
        for number, recipe in enumerate(part.effects[kind], start=1):
            table = drawn(recipe, keys, kind if number == 1 else f"{kind} {number}", sensor, streams)
            effect = from_table(EFFECTS[kind], table, sensor.unit, where)
            yield _at_bandwidth(effect, part, sensor) if isinstance(effect, WhiteNoise) else effect


def load_model(path: str | PathLike[str]) -> Model:
    """Read a model's TOML file; ConfigError names file, line, table and key of every mistake, and what is allowed."""
    return parse_model(read_text(path), str(path))


def parse_model(text: str, where: str = "model") -> Model:
    """Return a model from TOML text; every error message begins with `where`."""
    return _model_of(parse_toml(text, _ModelFile, where), text, where)


def noise_bandwidth_hz(sensor: SensorHeader) -> float:
    """Return the -3 dB bandwidth of the sensor's noise as it is configured, in Hz; 0 if it is unknown."""
    if sensor.chip == "adxl345" and sensor.rate_hz:
        return adxl345_bandwidth_hz(sensor.rate_hz)
    return sensor.bandwidth_hz


def _range_choice(value: float, chip: str) -> str:
    return f"{value:g}: allowed for {chip} are {', '.join(f'{choice:g}' for choice in TRIADS[chip].sensitivity)}"


class _ModelTable(BaseModel):
    """The table `[model]`."""

    model_config = _STRICT
    name: Annotated[str, Field(min_length=1)]
    """Name of the model."""
    about: str = ""
    """A description."""


class _DesignTable(BaseModel):
    """A table `[[design]]` without its effects."""

    model_config = _STRICT
    chip: str
    """The chip, as configurations name it."""
    unit: Literal["g", "dps", "gauss"] | None = None
    """Unit of the chip; required only for a chip that `imuarray.chips` does not contain."""
    range: float | None = None
    """Measuring range in this unit; None: every range of the chip."""
    noise_bandwidth_hz: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """The -3 dB bandwidth in Hz to which the white noise refers; None: the configured bandwidth."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.chip not in TRIADS and (self.chip in CHIPS or self.unit is None):
            raise ValueError(
                f"chip {self.chip!r}: allowed are {', '.join(TRIADS)}; another chip needs a unit: g, dps or gauss"
            )
        if self.chip not in TRIADS:
            return self
        if self.unit not in (None, TRIADS[self.chip].unit):
            raise ValueError(f"unit {self.unit!r}: the {self.chip} measures in {TRIADS[self.chip].unit}")
        if self.range is not None and self.range not in TRIADS[self.chip].sensitivity:
            raise ValueError(f"range {_range_choice(self.range, self.chip)}")
        return self


class _SensorTable(_DesignTable):
    """A table `[[sensor]]` without its effects."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")]


def _tables(value: Any) -> list[dict[str, Any]]:
    """Return one table or several as a list; ValueError."""
    tables = value if isinstance(value, list) else [value]
    if not tables or not all(isinstance(table, dict) for table in tables):
        raise ValueError("a table such as [design.bias] is required, or several such as [[design.tone]]")
    return tables


_EFFECT_TABLES: dict[str, Any] = {
    name: (Annotated[list[dict[str, Any]], PlainValidator(_tables)], []) for name in EFFECTS
}
_Design = create_model("_Design", __base__=_DesignTable, **_EFFECT_TABLES)
_Sensor = create_model("_Sensor", __base__=_SensorTable, **_EFFECT_TABLES)


class _ModelFile(BaseModel):
    """The whole TOML file."""

    model_config = _STRICT
    model: _ModelTable
    design: list[_Design] = []  # type: ignore[valid-type]
    sensor: list[_Sensor] = []  # type: ignore[valid-type]


def _model_of(file: _ModelFile, text: str, where: str) -> Model:
    mistakes: list[Mistake] = []
    designs, sensors = (
        tuple(_part(entry, (key, index), mistakes) for index, entry in enumerate(getattr(file, key)))
        for key in ("design", "sensor")
    )
    for key, parts in (("design", designs), ("sensor", sensors)):
        kinds = [(part.name, part.chip, part.unit, part.range) for part in parts]
        for kind, count in Counter(kinds).items():
            if count > 1:
                name, chip, _, range_ = kind
                subject = f"sensor {name!r}" if name else f"design {chip}"
                span = "no range" if range_ is None else f"range {range_:g}"
                last = len(kinds) - 1 - kinds[::-1].index(kind)
                mistakes.append(Mistake((key, last), "", f"{count} tables of {subject} with {span}; one is allowed"))
    if mistakes:
        raise refusal(text, where, mistakes)
    return Model(file.model.name, file.model.about, designs, sensors, text)


def _part(entry: Any, place: Place, mistakes: list[Mistake]) -> Part:
    """Return a part from its validated table; invalid tables of effects are added to `mistakes`."""
    name = getattr(entry, "name", "")
    subject = f"{place[0]} {int(place[1]) + 1}" + (f" {name!r}" if name else "")
    unit = TRIADS[entry.chip].unit if entry.chip in TRIADS else entry.unit
    effects: dict[str, tuple[Recipe, ...]] = {}
    for kind in EFFECTS:
        recipes = []
        for number, table in enumerate(getattr(entry, kind)):
            try:
                recipes.append(_recipe(kind, table, entry.chip, unit))
            except ConfigError as error:
                draw, _, complaint = str(error).partition(": ")
                mistakes.append(Mistake((*place, kind, number), f"{subject}: {draw}", complaint))
        if recipes:
            effects[kind] = tuple(recipes)
    foreign = "" if entry.chip in TRIADS else unit
    return Part(entry.chip, entry.range, name, entry.noise_bandwidth_hz, effects, foreign)


def _recipe(kind: str, table: Mapping[str, Any], chip: str, unit: str) -> Recipe:
    """Return the parameters of an effect's table; ConfigError, which begins with the kind, for an unsuitable unit."""
    if strange := [key for key in table if not key.isprintable()]:
        raise ConfigError(f"{kind}: {strange[0]!r}: unknown key")
    recipe = {key: figure_of(value, f"{kind}: {key}") for key, value in table.items()}
    ranges = TRIADS[chip].sensitivity if chip in TRIADS else {}
    keys = spelled(EFFECTS[kind], unit)
    for end, note in ((0, ""), (-1, ", lowest draw"), (1, ", highest draw")):
        effect = from_table(EFFECTS[kind], at_ends(recipe, keys, end), unit, kind + note)
        if isinstance(effect, RangeReset) and not math.isnan(effect.range) and effect.range not in ranges:
            choice = _range_choice(effect.range, chip) if ranges else f"the ranges of a {chip} are not known"
            raise ConfigError(f"{kind}: range_{unit}: {choice}")
    return recipe


def _at_bandwidth(noise: WhiteNoise, part: Part, sensor: SensorHeader) -> WhiteNoise:
    """Return the noise at the sensor's bandwidth, scaled from the bandwidth that the part states."""
    bandwidth_hz = noise_bandwidth_hz(sensor)
    if part.noise_bandwidth_hz is None or bandwidth_hz <= 0:
        return noise
    x, y, z = (rms * math.sqrt(bandwidth_hz / part.noise_bandwidth_hz) for rms in noise.rms)
    return replace(noise, rms=(x, y, z))
