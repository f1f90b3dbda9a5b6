"""The result of a diagnosis: the verdict, where the gap is, its causes, and how much of it they close. Also reads a
diagnosis from its JSON (`gap.json`).
"""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from math import nan
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from imuarray.arrays import Floats
from imuarray.errors import LogError
from imuarray.gap.findings import diagnosis as parts
from imuarray.gap.model.use import Use
from imuarray.json_values import json_value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from imuarray.simulate.model import Model

Verdict = Literal["no gap", "explained", "partly explained", "unexplained"]
Size = Literal["material", "harmless", "can't tell"]
Origin = Literal["sensor", "environment", "metadata"]

EVEN = 0.5
"""Probability of even odds. A cause that explains a gap is at least this probable, and an unknown effect is less
probable if the gap is explained.
"""

Interval = tuple[float, float]
"""95 % confidence interval."""


@dataclass(frozen=True)
class Where:
    """One statistic that differs: its value in the recording (`real`) and in the simulation (`simulated`), in `unit`
    ("" for pure numbers).

    `significance` is the difference in standard deviations of chance. `effect_size` is the difference in units of
    `margin`, the least one that matters (`imuarray.gap.findings.deviations`). `axis` and `phase` are "" for all axes or
    phases.
    """

    log: str
    sensor: str
    axis: str
    domain: str
    phase: str
    statistic: str
    about: str
    real: float
    simulated: float
    unit: str
    significance: float
    p: float
    effect_size: float
    margin: float
    size: Size


@dataclass(frozen=True)
class Cause:
    """One cause with the probability that it is present.

    The probability is its `share` among the effects that explain as much, multiplied by the rate at which causes are
    right if all causes together close the share `all_closed` of the gap of their sensors.

    `sensors` and `axes` are those concerned (no axes: all). `parameters` have their names and units; they are those of
    the first sensor if the sensors differ (`each` has all). `closed` is the share of these sensors' gap that the cause
    closes on data to which it was not fitted. `gain` is its log-likelihood ratio on that data, in nats. `needs_both`:
    the training part alone does not show the cause, so it was detected, and its closed share measured, on both parts
    together. `preceding` is the number of earlier causes (changes of the sensors' models) in the model when it was
    detected. `is_accepted` is false for the effect that comes nearest to explaining a gap for which none was accepted;
    it is in no model and does not count in the diagnosis's `gap`. `alternative_to` names the effect that was accepted
    instead of it ("" for accepted ones): an alternative is in no model either.
    """

    effect: str
    action: Literal["add", "remove", "replace"]
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    probability: float
    parameters: Mapping[str, Any]
    closed: float | None
    closed_ci95: Interval | None
    confusable_with: tuple[str, ...]
    origin: Origin = "sensor"
    gain: float = 0.0
    each: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    needs_both: bool = False
    share: float = nan
    all_closed: float | None = None
    preceding: int = 0
    is_accepted: bool = True
    alternative_to: str = ""

    @property
    def is_in_model(self) -> bool:
        """True if the repaired model has the cause."""
        return self.is_accepted and not self.alternative_to


def needs_both_parts(causes: Sequence[Cause]) -> bool:
    """Return whether every cause was detected on both parts together, so that no part can test a cause independently;
    False without causes.
    """
    return bool(causes) and all(cause.needs_both for cause in causes)


@dataclass(frozen=True)
class CandidateEvaluation:
    """A candidate effect that was evaluated for some sensors, whether or not it became a cause; placebos have `effect`
    "". `fits` and `gain` are log-likelihood ratios, in nats, on the training part and on the held-out part.
    """

    effect: str
    action: str
    sensors: tuple[str, ...]
    fits: float
    gain: float | None
    is_accepted: bool


@dataclass(frozen=True)
class Gap:
    """The root mean square score of the statistics that differ, on held-out data: `before` and `after` the causes were
    added, and the value without a gap (`floor`). `closed` is the share of the excess of squared scores that is closed
    (None without a gap).
    """

    before: float
    after: float
    floor: float
    closed: float | None
    closed_ci95: Interval | None
    domains: Mapping[str, tuple[float, float, float | None]] = field(default_factory=dict)
    """By domain: before, after, closed."""


@dataclass(frozen=True)
class Overlay:
    """A curve of one axis. `kind` is "spectrum", "allan", "temperature" or "codes"; `real` (n,) is the recording over
    `x` (n,); `before` and `after` (3, n) are the median and the 95 % band of simulations. `x_label` and `y_label`
    contain the units.
    """

    kind: Literal["spectrum", "allan", "temperature", "codes"]
    sensor: str
    axis: str
    phase: str
    x_label: str
    y_label: str
    x: Floats
    real: Floats
    before: Floats
    after: Floats


DIFFERENCES = "differences of "
"""Prefix of the `effect` of an `Unobservable` that is a domain of statistics with too much uncertainty."""


@dataclass(frozen=True)
class Unobservable:
    """An effect that the recordings cannot show for these sensors, or a domain of statistics that are too uncertain
    (`DIFFERENCES`), and what to `record` to show it.
    """

    effect: str
    sensors: tuple[str, ...]
    record: str


@dataclass(frozen=True)
class Pull:
    """A quantity that varies from part to part within a tolerance of the data sheet.

    `value` is the fitted value in `unit`, `tolerance` the limit to either side in the same unit, and `pull` the
    deviation from the nominal value in tolerances. `axis` is "" for all axes. `source` names where the tolerance is
    printed, such as "BMA-64". `explained_by` are causes of the same sensor that may explain the value, since it was
    fitted without them.
    """

    quantity: str
    sensor: str
    axis: str
    value: float
    unit: str
    tolerance: float
    pull: float
    source: str
    explained_by: tuple[str, ...] = ()

    @property
    def is_out_of_specification(self) -> bool:
        """True if the part deviates by more than its tolerance."""
        return abs(self.pull) > 1


@dataclass(frozen=True)
class Map:
    """The largest absolute score of each sensor (rows) and domain (columns), before and after the causes were added;
    nan without a statistic. Chance alone exceeds `limit` in one of twenty campaigns.
    """

    sensors: tuple[str, ...]
    domains: tuple[str, ...]
    before: Floats
    after: Floats
    limit: float


@dataclass(frozen=True)
class RecordingSummary:
    """One recording that was diagnosed."""

    name: str
    kind: str
    seconds: float
    sensors: int
    phases: int
    rows: int


@dataclass(frozen=True, repr=False, kw_only=True)
class Diagnosis:
    """The complete result of a diagnosis.

    `missing` are statistics that could not be compared because a recording or the simulator lacks what they need, in
    phrases such as "no chip thermometer in bench.h5". `pulls` are the quantities that vary from part to part, compared
    with their tolerances; none is a cause. `repaired` is the base model with the causes in it.

    `reason` says why the verdict is this one. `p` is the share of simulations without a gap that differ as much, never
    less than `p_limit`. `p_tail` is the p-value of the largest difference according to the tails fitted to these
    simulations, multiplied by the number of statistics (nan if unknown).
    """

    verdict: Verdict
    sentence: str
    p: float
    gap: Gap
    where: tuple[Where, ...]
    causes: tuple[Cause, ...]
    unknown: float
    unexplained: tuple[Where, ...]
    next_experiment: str
    unshown: tuple[Unobservable, ...]
    missing: tuple[str, ...] = ()
    pulls: tuple[Pull, ...] = ()
    uses: tuple[Use, ...]
    judged: tuple[CandidateEvaluation, ...]
    map: Map
    overlays: tuple[Overlay, ...]
    recorded: tuple[RecordingSummary, ...]
    notes: tuple[str, ...]
    held_out: str
    seed: int
    replicates: int
    model: str
    software: str
    repaired: Model | None = None
    reason: str = ""
    p_tail: float = nan

    @property
    def p_limit(self) -> float:
        """The smallest p that this number of replicates can give."""
        return 1 / (self.replicates + 1)

    @property
    def is_p_limit(self) -> bool:
        """True if no simulation without a gap differs as much: p is then only an upper bound."""
        return self.p <= self.p_limit * (1 + 1e-9)

    def plot(self) -> Figure:
        """Return a figure of the statistics that differ most and of the causes with the share of the gap that they
        close. Raises MissingExtraError without matplotlib (extra "report").
        """
        from imuarray.gap.findings.plot import diagnosis_figure

        return diagnosis_figure(self)

    def __str__(self) -> str:
        from imuarray.gap.findings.text import text_of

        return text_of(self)

    def __repr__(self) -> str:
        from imuarray.gap.findings.text import listed_causes, share

        causes = ", ".join(f"{cause.effect} ({share(cause.probability)})" for cause in listed_causes(self.causes))
        return f"<Diagnosis: {self.verdict}; {f'causes {causes}' if causes else 'no cause'}>"

    def _repr_html_(self) -> str:
        """Return the sentence and the causes as HTML, for notebooks."""
        from imuarray.gap.findings.text import closed_text, effect_text, listed_causes, places_text, share
        from imuarray.html_table import html_table

        rows = [
            (effect_text(each), places_text(each), share(each.probability), closed_text(each.closed, each.closed_ci95))
            for each in listed_causes(self.causes)
        ]
        return html_table(self.sentence, ("cause", "where", "probability", "would close of the gap there"), rows)

    def as_json(self) -> dict[str, Any]:
        """Return the diagnosis as one JSON object; numbers that aren't finite are null."""
        plain = {
            JSON_NAMES.get(item.name, item.name): json_value(getattr(self, item.name))
            for item in fields(self)
            if item.name not in NOT_IN_JSON
        }
        plain["p_limit"] = self.p_limit
        for pull, table in zip(self.pulls, plain["pulls"], strict=True):
            table["is_out_of_specification"] = pull.is_out_of_specification
        return plain


JSON_NAMES: Mapping[str, str] = MappingProxyType({"unshown": "cannot_tell"})
"""Names of fields in JSON that differ from those of the class."""

NOT_IN_JSON: Mapping[str, Any] = MappingProxyType({"overlays": (), "repaired": None})
"""Fields that are not in JSON, with their values in a diagnosis that is read from it."""


_DEPTH = 12
_HUGE = 1e30
"""Limit of the numbers in a diagnosis that is read from JSON; larger ones are rejected."""


def diagnosis_of(table: object, where: str = "gap.json") -> Diagnosis:
    """Return the diagnosis from a table that `Diagnosis.as_json` made; null becomes nan. Raises LogError for anything
    else.
    """
    hints = get_type_hints(Diagnosis, {**vars(parts), "Model": object})
    if not isinstance(table, Mapping):
        raise LogError(f"{where}: not a diagnosis: it must be an object")
    values: dict[str, Any] = dict(NOT_IN_JSON)
    for item in fields(Diagnosis):
        if item.name in NOT_IN_JSON:
            continue
        key = JSON_NAMES.get(item.name, item.name)
        if key not in table and item.default is not MISSING:
            continue  # files of earlier versions lack it
        if key not in table:
            raise LogError(f"{where}: not a diagnosis: {key} is missing")
        values[item.name] = _read(table[key], hints[item.name], f"{where}: {key}", _DEPTH)
    diagnosis = Diagnosis(**values)
    shape = (len(diagnosis.map.sensors), len(diagnosis.map.domains))
    if diagnosis.map.before.shape != shape or diagnosis.map.after.shape != shape:
        raise LogError(f"{where}: map: its size must be {shape[0]} sensors by {shape[1]} domains")
    return diagnosis


def _read(value: Any, kind: Any, where: str, depth: int) -> Any:
    """Return a value of the type of a field; raises LogError if it can't be converted."""
    origin, inside = get_origin(kind), get_args(kind)
    if depth == 0:
        raise LogError(f"{where}: nested without end")
    if origin in (Union, types.UnionType):
        option = next(each for each in inside if each is not type(None))
        return None if value is None else _read(value, option, where, depth)
    if is_dataclass(kind):
        return _dataclass(value, kind, where, depth)
    if origin is tuple:
        if not isinstance(value, list) or (inside[-1] is not Ellipsis and len(value) != len(inside)):
            raise LogError(f"{where}: must be a list")
        kinds = [inside[0]] * len(value) if inside[-1] is Ellipsis else inside
        return tuple(_read(item, each, where, depth - 1) for item, each in zip(value, kinds, strict=True))
    if origin is np.ndarray or kind is np.ndarray:
        return _array(value, where)
    if origin is not None and isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise LogError(f"{where}: must be an object")
        return {_text(key, where): _read(item, inside[1], where, depth - 1) for key, item in value.items()}
    if kind is Any or kind is object:
        return _anything(value, where, depth)
    return _plain(value, kind, where)


def _dataclass(value: Any, kind: Any, where: str, depth: int) -> Any:
    if not isinstance(value, Mapping):
        raise LogError(f"{where}: must be an object")
    hints = get_type_hints(kind)
    known = [item.name for item in fields(kind) if item.name in value]
    try:
        return kind(**{name: _read(value[name], hints[name], f"{where}.{name}", depth - 1) for name in known})
    except TypeError as error:
        raise LogError(f"{where}: {error}") from None


def _array(value: Any, where: str) -> Any:
    try:
        rows = [[nan if item is None else float(item) for item in row] for row in value]
        table = np.array(rows, float).reshape(len(value), -1)
        if (np.abs(table) >= _HUGE).any():
            raise ValueError("beyond any figure of a diagnosis")
        return table
    except (TypeError, ValueError, OverflowError):
        raise LogError(f"{where}: must be rows of numbers") from None


def _plain(value: Any, kind: Any, where: str) -> Any:
    """Return a text, a number or a flag."""
    if kind is float:
        return nan if value is None else _number(value, where)
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise LogError(f"{where}: {value!r:.40}; allowed are {', '.join(get_args(kind))}")
        return value
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise LogError(f"{where}: {value!r:.40} has the wrong type")
    if kind is int:
        _number(value, where)
    return _text(value, where) if kind is str else value


def _anything(value: Any, where: str, depth: int) -> Any:
    """Return a value of any type; raises LogError if it contains what a float or a file cannot hold."""
    if depth == 0:
        raise LogError(f"{where}: nested without end")
    if isinstance(value, Mapping):
        return {_text(key, where): _anything(item, where, depth - 1) for key, item in value.items()}
    if isinstance(value, list):
        return [_anything(item, where, depth - 1) for item in value]
    if isinstance(value, str):
        return _text(value, where)
    return value if value is None or isinstance(value, bool) else _number(value, where)


def _number(value: Any, where: str) -> float:
    """Return a number; raises LogError beyond the allowed range, since JSON's integers are unbounded."""
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) >= _HUGE:
        raise LogError(f"{where}: {str(value)[:40]!r} is not a number in the allowed range")
    return value


def _text(value: str, where: str) -> str:
    """Return a text; raises LogError if a file cannot hold it, since JSON can encode half a character."""
    try:
        value.encode()
    except UnicodeEncodeError:
        raise LogError(f"{where}: {value!r:.40} contains half a character") from None
    return value
