"""The lines of a proposed map that describe a sensor: its unit or the scale of its codes, by the size of the values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import log as ln

import numpy as np

from imuarray.arrays import Floats
from imuarray.importers.column_names import COMPUTED, column_label, unit_in
from imuarray.importers.mapping import ZERO_OF_UNIT
from imuarray.importers.proposal import Item, Proposal
from imuarray.importers.resolution import WIDE_SENSITIVITIES, usual_bits
from imuarray.importers.sphere import fit_sphere
from imuarray.importers.text_layout import quoted
from imuarray.importers.triad_behaviour import NEAR_GRAVITY
from imuarray.units import STANDARD_GRAVITY, UNITS_OF

NAMES = {"specific_force": "Acc", "angular_rate": "Gyro", "magnetic_field": "Mag"}
_PRESSURES = {"Pa": 1e5, "hPa": 1e3, "kPa": 1e2, "bar": 1.0}
"""Air pressure at sea level in each unit."""
_COUNTS_OF_MAGNETOMETER = 1090.0
"""Counts per gauss of an HMC5883L after power-up (HMC-21), the most common magnetometer."""
COUNTS_OF_GYROSCOPE = 131.0
_CODES_16 = 1 << 16
_LEAST_MIDDLE = 128.0
_NEAR_MIDDLE = 0.15
_GRAVITY_FROM_MIDDLE = 0.55
"""Least middle of the range of an unsigned converter (8 bits), and the relative distances of the axes' medians from it:
of two axes, and of the one along gravity, which is half of the middle at +-2 g.
"""
_APPLE = re.compile(
    r"user_?acceleration|accelerometerAcceleration|motionGravity|DeviceMotion|CMAcceleration", re.IGNORECASE
)
"""Names of Apple's CoreMotion, in which a device that lies on its back reads -1 g along z."""


def propose_sensor(
    quantity: str,
    names: Sequence[str],
    columns: Sequence[Floats],
    indices: tuple[int, int, int],
    force_unit: str,
    proposal: Proposal,
) -> Item:
    """Return the lines of a sensor."""
    values = np.stack([columns[index][: min(map(len, columns))] for index in indices], axis=1)
    gravity = proposal.gravity.get(indices)
    if gravity is not None:
        values = values + np.stack([columns[index][: len(values)] for index in gravity], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    stated_unit = proposal.units.get(names[indices[0]]) or unit_in(names[indices[0]]) if names else ""
    whole = bool(len(values)) and float(np.mean(values == np.rint(values))) > _WHOLE and length > 5
    beyond = float(np.abs(values).max(initial=0.0))
    is_wide = (
        quantity == "specific_force"
        and whole
        and (beyond >= _CODES_16 or (beyond >= _CODES_16 / 2 and float(values.min()) < 0))
    )
    whole = whole and float(np.ptp(values)) < _CODES_16
    codes: list[str] = []
    largest = _CODES_16 / 2
    if whole:
        values, codes, largest = _signed(values)
        length = float(np.median(np.linalg.norm(values, axis=1)))
    listed = ", ".join(column_label(names, index) for index in indices)
    item = Item(
        [
            "[[sensor]]",
            proposal.name_line(NAMES[quantity]),
            'chip = "unknown"   # ?',
            f'quantity = "{quantity}"' if names else f'quantity = "{quantity}"   # ? the columns have no names',
            f"columns = [{listed}]",
        ]
    )
    if gravity is not None:
        item.append(f"gravity_columns = [{', '.join(column_label(names, index) for index in gravity)}]")
    if quantity == "specific_force" and names and _APPLE.search(names[indices[0]]):
        item.append('signs = "---"   # ? Apple\'s CoreMotion has the opposite sign: -1 g along the axis that points up')
    is_computed = bool(proposal.attitudes or (names and COMPUTED.search(names[indices[0]])))
    sphere = fit_sphere(values) if quantity == "specific_force" and (is_wide or whole) else None
    gravity_length = length if sphere is None else sphere.radius
    if stated_unit in UNITS_OF[quantity]:  # type: ignore[index]
        item.append(f'unit = "{stated_unit}"')
    elif is_wide:
        item += _wide_codes(gravity_length, beyond)
    elif quantity == "specific_force" and is_computed and not whole and length < _WEIGHTLESS:
        item.append('unit = "m/s2"   # ? gravity is subtracted, and programs that do so write m/s2')
    elif not whole:
        item += _measured(quantity, values, force_unit)
    elif sphere is not None and not codes and is_in_mg(sphere.radius):
        item.append(UNIT_MG.format(sphere.radius))
    else:
        item += [*codes, *_counted(quantity, gravity_length, largest)]
    return item


_WEIGHTLESS = 0.7
"""Median length of accelerations in which there is no gravity, in g or m/s2."""

_WHOLE = 0.999
"""Share of whole numbers of a column of codes: a torn row may hold others."""

UNIT_MG = 'unit = "mg"   # ? from gravity in all directions: {:.5g}'


def is_in_mg(length: float) -> bool:
    """Return whether gravity's length in all directions says that whole numbers are in mg, not 1024 counts per g."""
    return abs(ln(length / 1000)) < abs(ln(length / 1024)) and abs(ln(length / 1000)) < _EXACT


_EXACT = 0.012
"""Greatest log ratio of gravity's length in all directions to the counts per g."""


def _signed(values: Floats) -> tuple[Floats, list[str], float]:
    """Return codes (n, 3) as signed ones, the lines that say how, and the largest code that is then possible."""
    if values.min() < 0 or values.max() >= _CODES_16:
        return values, [], _CODES_16 / 2
    medians = np.median(values, axis=0)
    middle = 2.0 ** np.rint(np.log2(max(float(np.median(medians)), 1.0)))
    _, second, largest = np.sort(np.abs(medians / middle - 1)).tolist()
    if _LEAST_MIDDLE <= middle < _CODES_16 / 2 and second < _NEAR_MIDDLE and largest < _GRAVITY_FROM_MIDDLE:
        return values - middle, [f"offset = {middle:g}   # ? no code is negative, and all axes are near it"], middle
    if values.max() < _CODES_16 / 2:
        return values, [], _CODES_16 / 2
    outer = (values < _CODES_16 / 4) | (values >= _CODES_16 * 3 / 4)
    if float(np.mean(outer)) > 0.5:
        return (
            np.where(values >= _CODES_16 / 2, values - _CODES_16, values),
            ["bits = 16   # ? none is negative"],
            _CODES_16 / 2,
        )
    return values - _CODES_16 / 2, [f"offset = {_CODES_16 // 2}   # ? none is negative"], _CODES_16 / 2


def _wide_codes(length: float, beyond: float) -> list[str]:
    """Return the scale of an accelerometer's codes of more than 16 bits, up to `beyond`."""
    per_g = min(WIDE_SENSITIVITIES["specific_force"], key=lambda sensitivity: abs(ln(length / sensitivity)))
    if abs(ln(length / per_g)) > NEAR_GRAVITY:
        per_g = 2.0 ** round(ln(length) / ln(2))
    if abs(ln(length / per_g)) > NEAR_GRAVITY:
        per_g = float(f"{length:.3g}")
    bits = usual_bits(beyond)
    return [
        'unit = "g"',
        f"range = {(1 << bits - 1) / per_g:.6g}   # ? of {bits} bits",
        f"sensitivity = {per_g:.9g}   # ? from gravity: {length:.6g} counts",
    ]


def _counted(quantity: str, length: float, largest: float) -> list[str]:
    """Return unit and scale of columns of integers up to `largest`."""
    bits = f"of {round(ln(2 * largest) / ln(2))} bits"
    if quantity == "specific_force":
        per_g = 2.0 ** round(ln(length) / ln(2))
        if abs(ln(length / per_g)) > NEAR_GRAVITY:
            per_g = float(f"{length:.2g}")
        return [
            'unit = "g"',
            f"range = {largest / per_g:g}   # ? {bits}",
            f"sensitivity = {per_g:g}   # ? from gravity: {length:.5g} counts",
        ]
    if quantity == "angular_rate":
        usual_scales = ", ".join(f"{131 / (1 << power):.4g} ({250 << power} dps)" for power in range(4))
        return [
            'unit = "dps"',
            "range = 250   # ?",
            f"sensitivity = {COUNTS_OF_GYROSCOPE:g}   # ? not determined at rest; common are {usual_scales}",
        ]
    return [
        'unit = "gauss"',
        "range = 1.3   # ?",
        f"sensitivity = {_COUNTS_OF_MAGNETOMETER:g}   # ? {length:.4g} counts for the earth's 0.2 to 0.7 gauss",
    ]


def _measured(quantity: str, values: Floats, force_unit: str) -> list[str]:
    """Return the line of the unit of columns of physical values (n, 3)."""
    length = float(np.median(np.linalg.norm(values, axis=1))) if len(values) else 0.0
    if quantity == "angular_rate":
        largest = float(np.abs(values).max(initial=0.0))
        if largest > _MOST_DPS:
            return [f'unit = "mdps"   # ? from the size of the values: up to {largest:.4g}']
        unit = "rad/s" if force_unit == "m/s2" else "dps"
        return [f'unit = "{unit}"   # ? dps or rad/s: the import report compares rotations, if there are any']
    if quantity == "specific_force":
        sizes = {"g": 1.0, "m/s2": STANDARD_GRAVITY, "mg": 1000.0}
    else:
        sizes = {"gauss": 0.45, "uT": 45.0, "mgauss": 450.0, "T": 4.5e-5, "nT": 4.5e4}
    unit = min(sizes, key=lambda scale: abs(ln(max(length, 1e-12) / sizes[scale])))
    return [f'unit = "{unit}"   # ? from the size of the values: {length:.4g}']


_MOST_DPS = 6000.0
"""Readings beyond those of every gyroscope in dps: the values are in thousandths."""


def propose_thermometer(proposal: Proposal, name: str, values: Floats) -> None:
    """Propose a column of temperatures: in degrees, or as counts with unknown scale."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return
    unit = proposal.units.get(name) or unit_in(name)
    unit = unit if unit in ZERO_OF_UNIT else ""
    if not unit and finite.min() > 200 and finite.max() < 420 and (finite != np.rint(finite)).any():
        unit = "K"
    if unit or (finite.min() > -60 and finite.max() < 150 and (finite != np.rint(finite)).any()):
        unit_line = f'unit = "{unit}"' if unit else 'unit = "degC"   # ? from the size of the values'
        proposal.add("thermometer", "Thermometer", f"column = {quoted(name)}", unit_line)
        return
    span = f"{finite.min():g} to {finite.max():g}"
    proposal.doubts.append(
        f"column {name!r} may be a chip's thermometer ({span} counts): set temperature_column ="
        f" {quoted(name)} and thermometer = {{ zero_degc, lsb_per_degc }} of its sensor from its data sheet"
    )


def propose_barometer(proposal: Proposal, name: str, values: Floats) -> None:
    """Propose a column of air pressures, if they are such in some unit."""
    finite = values[np.isfinite(values)]
    middle = float(np.median(finite)) if len(finite) else 0.0
    near = next((unit for unit, sea_level in _PRESSURES.items() if 0.2 < middle / sea_level < 1.2), None)
    unit = proposal.units.get(name, near)
    if unit is None:
        proposal.doubts.append(
            f"column {name!r}: no air pressure in {', '.join(_PRESSURES)} has its size, {middle:.4g}"
        )
        return
    mark = "" if name in proposal.units else f"   # ? from the size of the values: {middle:.6g}"
    proposal.add("barometer", "Barometer", f"column = {quoted(name)}", f'unit = "{unit}"{mark}')
