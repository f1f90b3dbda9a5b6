"""Writes the axes of sensors into the text of a configuration."""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from typing import Any

from imuarray.calibrate.pointing import Pointing
from imuarray.errors import ConfigError
from imuarray.printable import printable

_LONGEST = 1 << 20
"""Characters of a configuration; one with a hundred sensors has thirty thousand."""


def with_axes(text: str, pointings: Sequence[Pointing], where: str) -> str:
    """The text of a configuration with the axes that were determined; all else, comments included, is unchanged.

    ConfigError, beginning with the log that it came from (`where`), for a text that is no configuration.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    if len(text) > _LONGEST:
        raise ConfigError(f"{where}: its configuration has {len(text)} characters; at most {_LONGEST}")
    axes = {pointing.sensor: pointing.axes for pointing in pointings if pointing.axes}
    try:
        file: Any = tomlkit.parse(text)
        for sensor in _sensors(file, where):
            if str(sensor.get("name")) in axes:
                sensor["axes"] = axes[str(sensor["name"])]
        return tomlkit.dumps(file)
    except (TOMLKitError, RecursionError) as error:
        raise ConfigError(f"{where}: its configuration is not TOML: {printable(str(error))[:200]}") from None


def _sensors(file: Any, where: str) -> list[Any]:
    """The [[sensor]] tables of a configuration; ConfigError."""
    sensors = file.get("sensor", [])
    if not isinstance(sensors, list) or not all(isinstance(sensor, MutableMapping) for sensor in sensors):
        raise ConfigError(f"{where}: its configuration has no list of [[sensor]] tables")
    return sensors
