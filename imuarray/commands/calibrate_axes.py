"""What `imuarray calibrate axes` writes and says."""

from __future__ import annotations

from collections.abc import MutableMapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from imuarray.errors import ConfigError
from imuarray.printable import printable

if TYPE_CHECKING:
    from imuarray.calibrate.pointing import Pointing

_LONGEST = 1 << 20
"""Characters of a configuration; that of a hundred sensors has thirty thousand."""


def with_axes(text: str, found: Sequence[Pointing], where: str) -> str:
    """A configuration's text with the axes that were told, all else (comments too) as it was; ConfigError, with the log
    that it came from (`where`) at its head, for a text that is none.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    if len(text) > _LONGEST:
        raise ConfigError(f"{where}: its configuration has {len(text)} characters; at most {_LONGEST}")
    told = {each.sensor: each.axes for each in found if each.axes}
    try:
        file: Any = tomlkit.parse(text)
        for sensor in _sensors(file, where):
            if str(sensor.get("name")) in told:
                sensor["axes"] = told[str(sensor["name"])]
        return tomlkit.dumps(file)
    except (TOMLKitError, RecursionError) as error:
        raise ConfigError(f"{where}: its configuration is not TOML: {printable(str(error))[:200]}") from None


def _sensors(file: Any, where: str) -> list[Any]:
    """The [[sensor]] tables of a configuration; ConfigError."""
    sensors = file.get("sensor", [])
    if not isinstance(sensors, list) or not all(isinstance(sensor, MutableMapping) for sensor in sensors):
        raise ConfigError(f"{where}: its configuration has no list of [[sensor]] tables")
    return sensors


def report_of(found: Sequence[Pointing], before: dict[str, str]) -> dict[str, Any]:
    """Every sensor's axes before and now, JSON-ready; an empty text where they are not told."""
    return {"sensors": [{**asdict(each), "before": before[each.sensor]} for each in found]}


def print_report(report: dict[str, Any]) -> None:
    """The same as a table."""
    click.echo(f"{'sensor':12} {'axes':8} {'left':>6} {'next best':>9}")
    for row in report["sensors"]:
        note = row["reason"] and f"  not told: {row['reason']}; stays {row['before']}"
        told = f"{row['left'] or 0:6.2f} {row['next_best'] or 0:9.2f}" if row["axes"] else ""
        click.echo(f"{row['sensor']:12} {row['axes'] or '?':8} {told}{note}".rstrip())
