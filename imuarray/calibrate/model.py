"""Parameters of each sensor, and the calibration file that stores them, which is validated when it is read.

Measurement model of a triad, counts of one reading::

    counts = response @ stimulus_box + bias + noise           accelerometer, gyroscope
    counts = ... + g_sensitivity @ (specific force in g)      gyroscope only

`stimulus_box` is the specific force in g or the angular rate in dps in the box frame. Row k of `response` (counts per
unit) is the response of the sensor's axis k to each box axis; it includes scale factor, misalignment and orientation.

Figures that result from one measurement form a group (`GROUPS`): they are replaced together, and each group states its
origin.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import numpy.typing as npt
import tomli_w

from imuarray import __version__
from imuarray.arrays import Floats
from imuarray.atomic import write_text
from imuarray.calibrate.entries import (
    EntryPlace,
    Matrix,
    Number,
    Sizes,
    Text,
    Triple,
    covariance,
    named_tables,
    number,
    numbers,
    read_table,
    several,
    table,
    tables,
    text,
    to_table,
    whole,
)
from imuarray.errors import CalibrationError
from imuarray.log import Log, SensorLog
from imuarray.log.format import SensorHeader
from imuarray.spelling import guess, guess_file
from imuarray.toml_files import key_lines, no_text
from imuarray.units import SI_PER_UNIT, TRIADS, UNIT_OF

if TYPE_CHECKING:
    from matplotlib.figure import Figure


BIAS = "bias"
BIAS_OR_SCALE = "bias or scale"
"""Meaning of a slope on an axis with gravity, heated in one orientation, which leaves it open (paper, 5.2.5)."""

THERMOMETERS = ("barometer", "reference", "chip", "relative")
"""Kinds of thermometers: barometer, `/reference`, chip's with a zero (BMA180: BMA-63) or without (L3G4200D: L3G-60)."""


NotNegative = Annotated[float, number(0.0)]
Share = Annotated[float, number(0.0, 1.0)]
Runs = Annotated[tuple[int, ...], several(whole)]
"""Numbers of runs."""


@dataclass(frozen=True)
class Thermal:
    """The change of one sensor's counts with temperature: ``slope (T - reference) + quadratic (T - reference)^2`` with
    T the temperature of the `thermometer` after a first-order lag of `lag_s`.

    Arrays are (3,), one figure per sensor axis, except `lag_interval_s` (2,), the 95 % likelihood interval. `meaning`
    states what the slope of an axis is: "bias", or "bias or scale" if one orientation does not distinguish them.
    `scale_slope_per_degc` is relative to the scale factor, nan without two orientations. The degrees of a "relative"
    thermometer have no zero and are comparable with readings of the same thermometer only. The standard error of the
    quadratic term is known if a curvature was fitted, the term itself if it was significant; the slope is the one at
    the reference in both cases.
    """

    slope_lsb_per_degc: Triple
    slope_sem_lsb_per_degc: Sizes
    reference_degc: Number
    meaning: Annotated[tuple[str, ...], several(text(BIAS, BIAS_OR_SCALE), 3)]
    thermometer: Annotated[str, text(*THERMOMETERS)]
    lag_s: NotNegative = 0.0
    lag_interval_s: Annotated[Floats | None, numbers(2, lowest=0.0)] = None
    quadratic_lsb_per_degc2: Triple | None = None
    scale_slope_per_degc: Annotated[Floats | None, numbers(3, unknown=True)] = None
    scale_slope_sem_per_degc: Annotated[Floats | None, numbers(3, lowest=0.0, unknown=True)] = None
    quadratic_sem_lsb_per_degc2: Sizes | None = None

    @property
    def significant_lag_s(self) -> float:
        """The lag, or 0 if its interval includes 0; a lag without an interval counts as significant."""
        return self.lag_s if self.lag_interval_s is None or self.lag_interval_s[0] > 0 else 0.0

    def bias_change_lsb(self, to_degc: npt.ArrayLike, from_degc: float) -> Floats:
        """Return the bias change (3,) or (n, 3) in counts between lagged temperatures; 0 if the slope may be scale."""
        is_bias = np.array([meaning == BIAS for meaning in self.meaning], float)
        return is_bias * (self._counts(np.asarray(to_degc, float)) - self._counts(np.asarray(from_degc, float)))

    def _counts(self, degc: Floats) -> Floats:
        rise = (degc - self.reference_degc)[..., None]
        curve = 0.0 if self.quadratic_lsb_per_degc2 is None else self.quadratic_lsb_per_degc2
        return np.asarray(rise * self.slope_lsb_per_degc + rise**2 * curve)


@dataclass(frozen=True)
class BiasState:
    """One of the biases (3,) with which a sensor starts, in counts; the share of the runs in it, and their numbers."""

    bias_lsb: Triple
    share: Share
    runs: Runs = ()


@dataclass(frozen=True)
class TurnOn:
    """The change of a bias from run to run, per sensor axis (3,), in counts.

    `rms_lsb` is the standard deviation from run to run about the run's state, corrected for the scatter within runs and
    for temperature, with its standard error; `spread_lsb` is the same including the scatter within runs, as in a run
    mean. `p_value` is that of no change about the states, nan if the scatter within runs is not known (`rms_lsb` then
    includes it). `runs` is the number of runs used, `apart` the numbers of those with a start-up fault. `states` has
    one entry for a sensor with a single state. `gravity_lsb` is the gravity assumed in the runs' pose (accelerometers).
    """

    rms_lsb: Sizes
    rms_sem_lsb: Sizes
    spread_lsb: Sizes
    p_value: Annotated[Floats, numbers(3, lowest=0.0, highest=1.0, unknown=True)]
    runs: Annotated[int, whole]
    states: Annotated[tuple[BiasState, ...], tables(BiasState)] = ()
    apart: Runs = ()
    gravity_lsb: Triple | None = None


@dataclass(frozen=True)
class Drift:
    """The drift of a bias during operation, per axis (3,), in counts: a first-order Gauss-Markov process with the
    autocorrelation ``rms^2 exp(-t / time_constant_s)``; changes with temperature are removed if slopes are known.

    `rms_lsb` is the most likely value (0 without drift), `rms_sem_lsb` its standard error and `rms_upper_lsb` its 95 %
    upper bound. The three axes share one time constant; `time_constant_interval_s` (2,) is its 95 % interval, nan at an
    end that the log does not determine. Drift slower than `span_s`, the longest stretch, is not included.
    """

    rms_lsb: Sizes
    rms_sem_lsb: Sizes
    time_constant_s: Annotated[float, number(1e-6)]
    rms_upper_lsb: Sizes | None = None
    time_constant_interval_s: Annotated[Floats | None, numbers(2, lowest=0.0, unknown=True)] = None
    span_s: NotNegative | None = None


@dataclass(frozen=True)
class NoiseLine:
    """A periodic part of one axis's noise (`axis` "x", "y" or "z"): frequency and amplitude of its sine, with standard
    errors if known, and its `share` of the variance of single readings. `range_hz` (2,) is the lowest and highest
    frequency of a line that wandered, else None.
    """

    axis: Annotated[str, text("x", "y", "z")]
    frequency_hz: NotNegative
    amplitude_lsb: NotNegative
    share: Share
    frequency_sem_hz: NotNegative | None = None
    amplitude_sem_lsb: NotNegative | None = None
    range_hz: Annotated[Floats | None, numbers(2, lowest=0.0)] = None


@dataclass(frozen=True)
class Provenance:
    """Origin of a group of figures: logs, software, epoch of the first log (ISO 8601 UTC), mean temperature (degC)."""

    logs: Annotated[tuple[str, ...], several(text(empty=True))] = ()
    software: Annotated[str, text(empty=True)] = ""
    epoch: Annotated[str, text(empty=True)] = ""
    temperature_degc: Number | None = None


SensorDescription = SensorLog | SensorHeader
"""A sensor as a log describes it: with its recorded rows, or its header alone."""

FORMAT_VERSION = 1

COLUMN_ERROR = 0.01
"""Largest standard error of a column of a response, as a share of the scale factor, that counts as determined: half of
the data sheet's tolerance as it is assumed (`turns.TOLERANCE`)."""


def uncertain_columns(response_lsb_per_unit: Floats, covariance: Floats) -> str:
    """Return the box axes ("XZ") for which the column of a response (3, 3) with this covariance (9, 9), row by row, is
    not known to `COLUMN_ERROR` of the scale factors, because the gyroscope was hardly turned about them.
    """
    scale = np.linalg.norm(response_lsb_per_unit, axis=1)
    shares = np.sqrt(np.diag(covariance)).reshape(3, 3) / scale[:, None]
    return "".join(axis for axis, share in zip("XYZ", shares.max(axis=0), strict=True) if share > COLUMN_ERROR)


_LIST = re.compile(r'\[\n\s+((?:(?:[-+.\w]+|"[^"\\\n]*"),\s+)*(?:[-+.\w]+|"[^"\\\n]*")),\n\s*\]')
"""A list of numbers or plain texts as tomli_w writes it, one entry per line. No text contains a newline: TOML escapes
it."""

_SHORT = 80

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "bias": ("bias_sem_lsb", "bias_lsb", "bias_covariance_lsb2", "temperature_degc"),
        "response": (
            "response_sem_lsb_per_unit",
            "response_lsb_per_unit",
            "response_covariance_lsb2_per_unit2",
        ),
        "response_change": ("response_change",),
        "g_sensitivity": ("g_sensitivity_lsb_per_g", "g_sensitivity_sem_lsb_per_g"),
        "noise": ("noise_lsb", "noise_sem_lsb", "noise_correlation", "noise_lines"),
        "drift": ("drift",),
        "thermal": ("thermal",),
        "turn_on": ("turn_on",),
    }
)
"""Fields that are measured together; the first of each group is None unless they were measured (a bias without a
standard error was not)."""


@dataclass(frozen=True, repr=False)
class SensorCalibration:
    """Parameters of one sensor; a parameter that was not measured is None (the response: the data sheet's).

    Shapes: `bias_lsb`, `bias_sem_lsb`, `response_sem_lsb_per_unit` (one figure per sensor axis), `noise_lsb` (standard
    deviation of single readings), its standard error and `noise_correlation` (of one reading with the next) (3,);
    `response_lsb_per_unit`, `g_sensitivity_lsb_per_g` and its standard errors (3, 3), rows sensor axes, columns box
    axes; `bias_covariance_lsb2` (3, 3) over the sensor axes; `response_covariance_lsb2_per_unit2` (9, 9) over the
    entries of the response row by row. `noise_lines` are periodic parts of `noise_lsb`.
    `response_change` is the standard deviation by which each entry of the response, as a share of the scale factor,
    differs in use from the calibration. `temperature_degc` is that of the bias. `provenance` states the origin of each
    group of figures (`GROUPS`).
    """

    name: Text
    quantity: Text
    unit: Text
    bias_lsb: Triple
    response_lsb_per_unit: Matrix
    bias_sem_lsb: Sizes | None = None
    response_sem_lsb_per_unit: Sizes | None = None
    g_sensitivity_lsb_per_g: Matrix | None = None
    noise_lsb: Sizes | None = None
    temperature_degc: Number | None = None
    range: Number | None = None
    """The measuring range, in `unit`, for which this calibration is valid."""
    chip: Text | None = None
    """The chip of the sensor, as stated in its log."""
    bias_covariance_lsb2: Annotated[Floats | None, covariance(3)] = None
    response_covariance_lsb2_per_unit2: Annotated[Floats | None, covariance(9)] = None
    g_sensitivity_sem_lsb_per_g: Annotated[Floats | None, numbers(3, 3, lowest=0.0)] = None
    thermal: Annotated[Thermal | None, table(Thermal)] = None
    turn_on: Annotated[TurnOn | None, table(TurnOn)] = None
    noise_sem_lsb: Sizes | None = None
    noise_correlation: Annotated[Floats | None, numbers(3, lowest=-1.0, highest=1.0)] = None
    noise_lines: Annotated[tuple[NoiseLine, ...], tables(NoiseLine)] = ()
    drift: Annotated[Drift | None, table(Drift)] = None
    response_change: NotNegative | None = None
    provenance: Annotated[Mapping[str, Provenance], named_tables(Provenance, tuple(GROUPS))] = field(
        default_factory=lambda: MappingProxyType({})
    )

    def measured(self) -> tuple[str, ...]:
        """Return the groups of figures that were measured."""
        return tuple(group for group, names in GROUPS.items() if getattr(self, names[0]) is not None)

    def bias_at(self, temperature_degc: npt.ArrayLike) -> Floats:
        """Return the bias (3,), or (n, 3) for temperatures (n,), in counts at a (lagged) temperature in degC.

        The bias applies to the temperature at which it was measured, or to the slopes' reference if that temperature is
        not known or the thermometer of the slopes has no zero. It does not change without slopes, or on an axis whose
        slope may be one of scale.
        """
        degc = np.asarray(temperature_degc, float)
        if self.thermal is None:
            return np.broadcast_to(self.bias_lsb, (*degc.shape, 3)).astype(float)
        comparable = self.temperature_degc is not None and self.thermal.thermometer != "relative"
        holds_at = self.temperature_degc if comparable else self.thermal.reference_degc
        return np.asarray(self.bias_lsb + self.thermal.bias_change_lsb(degc, float(holds_at or 0.0)))

    @property
    def scale_lsb_per_unit(self) -> Floats:
        """Length (3,) of each row of the response: counts per unit along the true direction of the sensor axis."""
        return np.asarray(np.linalg.norm(self.response_lsb_per_unit, axis=1), float)

    @property
    def directions_box(self) -> Floats:
        """Directions (3, 3) of the sensor axes in the box frame: one unit vector per row."""
        return np.asarray(self.response_lsb_per_unit / self.scale_lsb_per_unit[:, None])

    @property
    def lsb_per_si(self) -> Floats:
        """Counts per m/s2 or rad/s (3,) along each sensor axis."""
        return np.asarray(self.scale_lsb_per_unit / SI_PER_UNIT[self.unit])

    def stimulus_box(self, counts: npt.ArrayLike) -> Floats:
        """Return specific force (m/s2) or angular rate (rad/s) in the box frame (n, 3) from counts (n, 3)."""
        inverse = np.linalg.inv(self.response_lsb_per_unit) * SI_PER_UNIT[self.unit]
        return np.asarray((np.asarray(counts, float) - self.bias_lsb) @ inverse.T)

    def response_covariance(self) -> Floats | None:
        """Return the covariance (9, 9) of the response's entries, row by row; None if the response was not measured. If
        a file has only one standard error per axis, its entries have that standard error and are independent.
        """
        if self.response_sem_lsb_per_unit is None:
            return None
        if self.response_covariance_lsb2_per_unit2 is not None:
            return self.response_covariance_lsb2_per_unit2
        return np.diag(np.repeat(self.response_sem_lsb_per_unit**2, 3))

    def uncertain_axes(self) -> str:
        """Return the `uncertain_columns` of a measured response; "" if it was not measured."""
        covariance = self.response_covariance()
        return "" if covariance is None else uncertain_columns(self.response_lsb_per_unit, covariance)

    def __repr__(self) -> str:
        bias = ", ".join(f"{part:.4g}" for part in self.bias_in_units())
        return f"<SensorCalibration {self.name}: {', '.join(self.measured()) or 'nothing'}; bias {bias} {self.unit}>"

    def bias_in_units(self) -> Floats:
        """Return the bias (3,) in the sensor's unit (g or dps), along its own axes."""
        return np.asarray(self.bias_lsb / self.scale_lsb_per_unit)

    def azimuth_elevation_deg(self) -> Floats:
        """Return azimuth (0 along box X, 90 along box Y) and elevation above the XY plane (3, 2) of each sensor axis,
        in degrees.

        These are the angles of the paper's Appendix B, by atan2: the printed quotient is inverted and loses the
        quadrant.
        """
        x, y, z = self.directions_box.T
        return np.asarray(np.degrees(np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=1)))


def _quotient(values: Floats | None, scale: Floats) -> Floats:
    """Return values (3,) in counts divided by the scale factors (3,); nan without values."""
    return np.full(3, np.nan) if values is None else values / scale


@dataclass(frozen=True, repr=False)
class Calibration:
    """The parameters of many sensors and their sources."""

    sensors: Mapping[str, SensorCalibration] = field(default_factory=lambda: MappingProxyType({}))
    sources: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> SensorCalibration:
        """Return the parameters of the sensor of this name; the CalibrationError for an unknown name lists the names
        that exist.
        """
        if name not in self.sensors:
            names = ", ".join(self.sensors) or "no sensor"
            raise CalibrationError(f"no calibration of {name!r}; there is {names}{guess(name, self.sensors)}")
        return self.sensors[name]

    def merged(self, other: Calibration) -> Calibration:
        """Return this calibration with every figure that `other` measured replaced by the newer one."""
        sensors = dict(self.sensors)
        for name, newer in other.sensors.items():
            older = sensors.get(name)
            sensors[name] = newer if older is None else _merge(older, newer)
        return Calibration(sensors, (*self.sources, *other.sources))

    def stamped(self, logs: Sequence[Log]) -> Calibration:
        """Return this calibration with logs, software, epoch and bias temperature as the provenance of every measured
        group that has none.
        """
        return replace(self, sensors={name: _add_provenance(sensor, logs) for name, sensor in self.sensors.items()})

    def of(self, sensor: SensorDescription) -> SensorCalibration:
        """Return the calibration of `sensor`; an empty calibration returns the data sheet's values. CalibrationError if
        the calibration does not fit the sensor, or contains other sensors only.
        """
        if self.sensors and sensor.name not in self.sensors:
            raise CalibrationError(
                f"{sensor.where}: not calibrated; the calibration contains {', '.join(self.sensors)}"
                f"{guess(sensor.name, self.sensors)}"
            )
        return self.or_nominal(sensor)

    def or_nominal(self, sensor: SensorDescription) -> SensorCalibration:
        """Return the calibration of `sensor`, or the data sheet's values (no bias, the configured axes) if there is
        none. CalibrationError if the calibration does not fit the sensor.
        """
        stored = self.sensors.get(sensor.name)
        if stored is None:
            return nominal(sensor)
        if (stored.quantity, stored.unit) != (sensor.quantity, sensor.unit):
            raise CalibrationError(
                f"{sensor.where}: calibrated as {stored.quantity} in {stored.unit}, logged as {sensor.quantity}"
            )
        if stored.range not in (None, sensor.range):
            raise CalibrationError(
                f"{sensor.where}: calibrated at a range of {stored.range:g} {stored.unit}, logged at {sensor.range:g}"
            )
        if stored.chip not in (None, sensor.chip):
            raise CalibrationError(f"{sensor.where}: calibrated as chip {stored.chip}, logged as {sensor.chip}")
        ratio = stored.scale_lsb_per_unit / (sensor.sensitivity or np.nan)
        if (np.abs(np.log2(ratio)) > 1).any():  # no chip deviates by a factor of two; a different range does
            raise CalibrationError(
                f"{sensor.where}: calibrated at {stored.scale_lsb_per_unit[0]:.4g} counts per {stored.unit}, logged at"
                f" {sensor.sensitivity:.4g}: another range"
            )
        return stored

    def scales(self, sensors: Iterable[SensorDescription]) -> dict[str, list[float]]:
        """Return the counts per unit of each axis (3,), by name, of those `sensors` that the calibration contains.
        CalibrationError if it does not fit one of them.
        """
        known = (sensor for sensor in sensors if sensor.name in self.sensors)
        return {sensor.name: self.or_nominal(sensor).scale_lsb_per_unit.tolist() for sensor in known}

    def plot(self, group: str | None = None) -> Figure:
        """Plot the figures of one `group` ("bias", "noise", "thermal" or "turn_on"; None: the first of these that was
        measured) with two standard errors, one line per axis. MissingExtraError without matplotlib.
        """
        from imuarray.calibrate.plots import calibration_figure

        return calibration_figure(self, group)

    def __repr__(self) -> str:
        sensors = (f"{sensor.name} ({', '.join(sensor.measured()) or 'nothing'})" for sensor in self.sensors.values())
        return f"<Calibration of {len(self.sensors)} sensors: {'; '.join(sensors)}>"

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` with a row for each axis: bias, scatter of single readings and their unit (g, dps
        or gauss), counts per unit, and standard errors; nan where a figure was not measured. MissingExtraError without
        pandas.

        >>> from imuarray import load_calibration
        >>> table = load_calibration("cal.toml").to_pandas()
        >>> table.loc[("BMA1", "x"), "unit"], bool(table.loc[("BMA1", "x"), "bias_sem"] > 0)
        ('g', True)
        """
        from imuarray.log.datasets import optional_package

        pandas = optional_package("pandas")
        rows = []
        for sensor in self.sensors.values():
            scale = sensor.scale_lsb_per_unit
            columns = {
                "bias": sensor.bias_in_units(),
                "bias_sem": _quotient(sensor.bias_sem_lsb, scale),
                "scale_lsb_per_unit": scale,
                "scale_sem_lsb_per_unit": _quotient(sensor.response_sem_lsb_per_unit, np.ones(3)),
                "noise": _quotient(sensor.noise_lsb, scale),
            }
            for index, axis in enumerate("xyz"):
                row = {name: float(values[index]) for name, values in columns.items()}
                rows.append({"sensor": sensor.name, "axis": axis, "unit": sensor.unit, **row})
        return pandas.DataFrame(rows).set_index(["sensor", "axis"])

    def _repr_html_(self) -> str:
        """Return a table of biases and scale factors with their standard errors, for notebooks."""
        from imuarray.calibrate.plots import bias_rows
        from imuarray.html_table import html_table

        groups = sorted({group for sensor in self.sensors.values() for group in sensor.measured()})
        sentence = f"Calibration of {len(self.sensors)} sensors: {', '.join(groups) or 'nothing'} measured"
        heading = ("axis", "unit", "bias", "standard error", "counts per unit", "noise")
        return html_table(sentence, heading, bias_rows(self))

    def to_toml(self) -> str:
        """Return the text of the calibration file."""
        head = {"format_version": FORMAT_VERSION, "software": f"imuarray {__version__}", "sources": list(self.sources)}
        text = tomli_w.dumps(
            {"calibration": head, "sensor": [to_table(sensor) for sensor in self.sensors.values()]}, indent=2
        )
        return _LIST.sub(
            lambda match: match[0] if len(match[1]) > _SHORT else ("[" + re.sub(r",\n *", ", ", match[1]) + "]"), text
        )

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write the file; OutputExistsError if it exists and not `force`, OutputError if it can't be written."""
        write_text(path, self.to_toml(), force=force)


def nominal(sensor: SensorDescription) -> SensorCalibration:
    """Return the calibration of a triad according to its data sheet and its configured axes; CalibrationError for a
    sensor without a sensitivity.
    """
    if not sensor.is_triad:
        raise CalibrationError(f"{sensor.where}: measures {sensor.quantity}; only triads are calibrated")
    if sensor.sensitivity <= 0:
        raise CalibrationError(
            f"{sensor.where}: its sensitivity (counts per {sensor.unit}) is not known: state it in the log"
        )
    return SensorCalibration(
        name=sensor.name,
        quantity=sensor.quantity,
        unit=sensor.unit,
        bias_lsb=np.zeros(3),
        response_lsb_per_unit=np.array(sensor.axis_sensitivity)[:, None] * np.asarray(sensor.orientation, float).T,
        range=sensor.range,
        chip=sensor.chip or None,
    )


def _merge(older: SensorCalibration, newer: SensorCalibration) -> SensorCalibration:
    """Return `newer` with the groups of figures that only `older` measured."""
    if (older.quantity, older.unit) != (newer.quantity, newer.unit):
        raise CalibrationError(
            f"sensor {newer.name}: calibrated as {older.quantity} before, as {newer.quantity} now: two sensors"
            " with the same name"
        )
    if None not in (older.range, newer.range) and older.range != newer.range:
        raise CalibrationError(
            f"sensor {newer.name}: calibrated at a range of {older.range:g} {older.unit} before, at {newer.range:g} now"
        )
    kept_fields = {
        name: getattr(older, name) for group in GROUPS if group not in newer.measured() for name in GROUPS[group]
    }
    if kept_fields.get("temperature_degc") is None:
        kept_fields.pop("temperature_degc", None)
    origins = {**older.provenance, **{group: newer.provenance.get(group) for group in newer.measured()}}
    return replace(
        newer,
        **kept_fields,
        range=older.range if newer.range is None else newer.range,
        chip=older.chip if newer.chip is None else newer.chip,
        provenance={group: origin for group, origin in origins.items() if origin is not None},
    )


def _add_provenance(sensor: SensorCalibration, logs: Sequence[Log]) -> SensorCalibration:
    """Return a sensor's calibration with its provenance."""
    origin = Provenance(tuple(str(log.path) for log in logs), f"imuarray {__version__}", logs[0].epoch if logs else "")
    warm = replace(origin, temperature_degc=sensor.temperature_degc)
    fresh = {group: warm if group == "bias" else origin for group in sensor.measured()}
    return replace(sensor, provenance={**fresh, **sensor.provenance})


_UNITS: Mapping[str, str] = {quantity: UNIT_OF[quantity] for quantity in TRIADS}


def load_calibration(path: str | PathLike[str]) -> Calibration:
    """Read a calibration file; CalibrationError names the file, the line, the sensor and the key.

    >>> calibration = load_calibration("cal.toml")
    >>> calibration.sensors["Gyro1"].bias_lsb.shape
    (3,)
    """
    try:
        content = Path(path).read_text(encoding="utf-8-sig")
        file = tomllib.loads(content)
    except (OSError, ValueError, RecursionError) as error:
        near = guess_file(path) if isinstance(error, FileNotFoundError) else ""
        message = no_text(path) if isinstance(error, UnicodeDecodeError) else f"no calibration file: {error}"
        raise CalibrationError(f"{path}: {getattr(error, 'strerror', None) or message}{near}") from None
    head = file.get("calibration")
    if not isinstance(head, dict):
        raise CalibrationError(f"{path}: is not a calibration: it has no table [calibration]")
    version = head.get("format_version")
    if version != FORMAT_VERSION:
        raise CalibrationError(f"{path}: calibration format_version is {version}; this software reads {FORMAT_VERSION}")
    sources, entries = head.get("sources", []), file.get("sensor", [])
    if not isinstance(entries, list) or not isinstance(sources, list) or not all(isinstance(s, str) for s in sources):
        raise CalibrationError(f"{path}: a list of [[sensor]] and a list of texts as calibration.sources are required")
    sensors: dict[str, SensorCalibration] = {}
    array = EntryPlace(str(path), key_lines(content), ("sensor",), "sensor")
    for index, entry in enumerate(entries, start=1):
        sensor = _read_sensor(entry, array.entry(index))
        if sensor.name in sensors:
            raise CalibrationError(f"{array.entry(index).key('name')}: {sensor.name!r} appears twice")
        sensors[sensor.name] = sensor
    return Calibration(sensors, tuple(sources))


def _read_sensor(entry: object, where: EntryPlace) -> SensorCalibration:
    sensor = read_table(entry, where, SensorCalibration)
    if _UNITS.get(sensor.quantity) != sensor.unit:
        choices = ", ".join(f"{quantity} in {unit}" for quantity, unit in _UNITS.items())
        raise CalibrationError(f"{where.key('unit')}: {sensor.quantity!r} in {sensor.unit!r}; allowed are {choices}")
    if not np.linalg.cond(sensor.response_lsb_per_unit) < 1e3:
        raise CalibrationError(f"{where.key('response_lsb_per_unit')}: can't be inverted")
    return sensor
