"""Meaning of the names of columns: unit, quantity, time, temperature, pressure."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from imuarray.importers.text_layout import TextLayout, quote
from imuarray.units import UNITS_OF, standard_unit

_UNIT_IN_NAME = re.compile(
    r"[\[(]\s*([^\])]*?)\s*[\])]"
    r"|_(ms|us|ns|s|g|mg|m_?s2|m/s\^?[2²]|mps2|m?dps|(?:deg|°)/s|deg_?s|m?rad[_/]?s|radps|m?gauss|[mun]T|degC|C|K)$"
)
SPELLINGS: Mapping[str, str] = {
    "m/(s^2)": "m/s2", "ms2": "m/s2", "m_s2": "m/s2", "deg/s": "dps", "deg_s": "dps", "degs": "dps",
    "rad_s": "rad/s", "rads": "rad/s", "mrad_s": "mrad/s", "mrads": "mrad/s", "µt": "uT", "μt": "uT",
    "g": "g", "gs": "gauss", "°c": "degC", "c": "degC", "degc": "degC", "sec": "s", "seconds": "s", "msec": "ms",
    "µs": "us", "usec": "us",
}  # fmt: skip
"""Spellings of units in names of columns, in lower case, in addition to those allowed in maps (`imuarray.units`)."""
_BEGIN = r"(?<![a-z])"
"""Pattern before a letter that names a quantity: the beginning of the name, or of its last part (`imu0_gx`)."""
QUANTITIES: Sequence[tuple[str, re.Pattern[str]]] = (
    ("magnetic_field", re.compile(rf"mag|compass|field|{_BEGIN}[mihb]\*", re.IGNORECASE)),
    (
        "angular_rate",
        re.compile(rf"gyr|rot|omega|{_BEGIN}ang(?!le)|rate(?!d)|{_BEGIN}(?:[gwpr]|rg|gy_?)\*", re.IGNORECASE),
    ),
    ("specific_force", re.compile(rf"acc|beschl|force|{_BEGIN}(?:l?a|ac_?|g?_?f)\*|gravity|lin", re.IGNORECASE)),
)
TIME = re.compile(r"time|zeit|stamp|millis|micros|elapsed|^t$|^t[_ \[(]|^(ms|us|sec|seconds)$", re.IGNORECASE)
TEMPERATURE = re.compile(r"temp|^tmp|^t_?(die|chip|c)$|degc", re.IGNORECASE)
PRESSURE = re.compile(r"press|baro|^p$", re.IGNORECASE)
ATTITUDE = re.compile(r"rot(ation)?[._ ]?vec|quat|attitude|orientation|euler", re.IGNORECASE)
"""Names of attitudes that a program computed."""
COMPUTED = re.compile(r"lin|user|free|grav", re.IGNORECASE)
"""Names of accelerations that a program computed."""
TRUTH = re.compile(r"(^|[/_.])(ground[_-]?truth|truth|reference)($|[/_.])", re.IGNORECASE)
"""Names of the rows of a truth or a reference, such as the topics `/truth` and `/reference` of exported bags."""
INDEX = re.compile(
    r"(sample|row|index|count(er)?|cnt|no|nr|n|i|seq(uence)?|packet|frame)s?[ _]?(no|nr|number|index|count(er)?)?",
    re.IGNORECASE,
)
"""Names of columns that number the rows."""


def is_of_a_quantity(words: str) -> bool:
    """Return whether words name a quantity that a map can describe."""
    patterns = [*(pattern for _, pattern in QUANTITIES), TEMPERATURE, PRESSURE]
    return any(pattern.search(words) for pattern in patterns)


def column_label(names: Sequence[str], index: int) -> str:
    """Return a column as a map names it: by its name, or by its index if the name is missing or not unique."""
    if index >= len(names) or not names[index] or names.count(names[index]) > 1:
        return str(index)
    return quote(names[index])


def quantity_of(name: str) -> str:
    """Return the quantity that a name states, in its last part ("imu.gyro") or else in the whole name; "" if it states
    no quantity, or an attitude.
    """
    if ATTITUDE.search(name):
        return ""
    for part in dict.fromkeys((re.split(r"[./](?!\*)", name)[-1], name)):
        if by_name := next((what for what, words in QUANTITIES if words.search(part)), ""):
            return by_name
    return ""


def unit_in(name: str) -> str:
    """Return the unit in a column's name; "" without one."""
    texts = [match[1] or match[2] or "" for match in _UNIT_IN_NAME.finditer(name)]
    return next((unit for unit in map(_spell_as_usual, texts) if unit and not unit.isdigit()), "")


def _spell_as_usual(unit: str) -> str:
    if known := SPELLINGS.get(unit.lower()):
        return known
    usual_spellings = (standard_unit(spelling, quantity) for quantity in UNITS_OF for spelling in (unit, unit.lower()))
    return next((usual for usual in usual_spellings if usual not in (unit, unit.lower())), unit)


def units_below_header(layout: TextLayout, names: Sequence[str]) -> dict[str, str]:
    """Return the units of columns by name, from a row of units below the header."""
    units = {
        name: unit_in(f"[{cell.strip().strip('[]()')}]") for name, cell in zip(names, layout.unit_cells, strict=False)
    }
    return {name: unit for name, unit in units.items() if unit}
