"""Properties in the paper's tables that the chips' data sheets do not predict, with the likely cause of each.

The findings are a fixed list, `findings.toml`. Nothing is fitted, simulated or ranked here, so no finding has a
probability or a closed share. `imuarray gap diagnose` reports these for logs; the paper does not publish its logs.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

from imuarray import __version__
from imuarray.json_values import json_value
from imuarray.studies.paper.results import hanging

NEXT_EXPERIMENT = (
    "switch the array on a dozen times a day for several days, a reference thermometer next to it "
    "(levels of other days); "
    "read BW_RATE of the ADXL345 back, and log it at 100 Hz: odd codes and 0.75 LSB rms are odr_error; "
    "one run of a day: random_walk keeps growing, bias_instability levels off; "
    "log Gyro1 alone at 350 Hz with its data-ready bits: repeated triads are stale_samples, none is bandwidth"
)
"""Measurements that distinguish similar causes."""


@dataclass(frozen=True)
class FindingFigure:
    """A number that shows a finding: `of` is its subject, `printed` its value by the tables, in `unit`.

    `data_sheet` is its value without the cause (or a limit, if the data sheet prints one), `with_cause` the prediction
    with the cause; None if it does not exist. `channel` is, for example, "Gyro3 x"; "" for several axes.
    """

    of: str
    printed: float
    unit: str
    data_sheet: float | None = None
    with_cause: float | None = None
    channel: str = ""


@dataclass(frozen=True)
class Finding:
    """An anomaly of the published tables, its place in the paper, its likely cause and open questions.

    `effect` is a name of `imuarray.simulate.effects`, "" if none is known; `action`, `sensors`, `axes`, `domain`,
    `confusable_with` and `parameters` are those of `gap diagnose`.
    """

    name: str
    place: str
    anomaly: str
    effect: str
    action: str
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    domain: str
    confusable_with: tuple[str, ...]
    open: str
    figures: tuple[FindingFigure, ...]
    parameters: Mapping[str, Any] = field(default_factory=dict)


@cache
def findings() -> tuple[Finding, ...]:
    """Return all findings, in the order of appendix A and the tables."""
    text = files("imuarray.studies.paper").joinpath("findings.toml").read_text(encoding="utf-8")
    result = []
    for entry in tomllib.loads(text)["finding"]:
        figures = tuple(FindingFigure(**figure) for figure in entry.pop("figure"))
        entry = {key: tuple(value) if isinstance(value, list) else value for key, value in entry.items()}
        result.append(Finding(**entry, figures=figures))
    return tuple(result)


def as_json() -> dict[str, Any]:
    """Return the keys of `gap diagnose` and `findings`. Keys that need a diagnosis of logs are None: the numbers of
    `gap`, `significance`, `probability`, `closed`, `unknown`, `seed`.
    """
    explained = [finding for finding in findings() if finding.effect]
    remaining = [finding for finding in findings() if not finding.effect]
    return {
        "verdict": "partly explained" if remaining else "explained",
        "gap": dict.fromkeys(("before", "after", "floor", "closed", "closed_ci95")),
        "where": [place for finding in findings() for place in _places(finding)],
        "causes": [
            {
                "effect": finding.effect,
                "action": finding.action,
                "sensors": list(finding.sensors),
                "axes": list(finding.axes),
                "probability": None,
                "parameters": dict(finding.parameters),
                "closed": None,
                "closed_ci95": None,
                "confusable_with": list(finding.confusable_with),
                "finding": finding.name,
            }
            for finding in explained
        ],
        "unknown": None,
        "unexplained": [place for finding in remaining for place in _places(finding)],
        "next_experiment": NEXT_EXPERIMENT,
        "seed": None,
        "model": {"name": "datasheet"},
        "software": f"imuarray {__version__}",
        "findings": [json_value(finding) for finding in findings()],
    }


def _places(finding: Finding) -> Iterator[dict[str, Any]]:
    """Yield an entry of `where` for each figure."""
    for figure in finding.figures:
        sensor, _, axis = figure.channel.partition(" ")
        yield {
            "log": finding.place,
            "sensor": sensor,
            "axis": axis,
            "domain": finding.domain,
            "phase": "",
            "statistic": figure.of,
            "real": figure.printed,
            "simulated": figure.data_sheet,
            "significance": None,
            "effect_size": None if figure.data_sheet is None else round(figure.printed - figure.data_sheet, 6),
        }


def render_text() -> str:
    """Return every finding for a terminal, in lines of at most 100 columns."""
    lines = ["The paper's tables compared with its chips' data sheets: anomalies and their likely causes", ""]
    for finding in findings():
        lines += [*_paragraph(finding), ""]
    return "\n".join([*lines, *hanging("Next: ", NEXT_EXPERIMENT)]) + "\n"


def _paragraph(finding: Finding) -> Iterator[str]:
    confusable = f", or {' or '.join(finding.confusable_with)}" if finding.confusable_with else ""
    place = f"{', '.join(finding.sensors)}{' ' if finding.axes else ''}{', '.join(finding.axes)}"
    yield f"{finding.name[0].upper()}{finding.name[1:]} ({finding.place})"
    yield from hanging("  ", finding.anomaly)
    yield from hanging("  cause    ", f"{finding.effect or 'unknown'}{confusable}; {place}")
    for figure in finding.figures:
        neighbours = {"data sheet": figure.data_sheet, "with the cause": figure.with_cause}
        neighbour_texts = [f"{name} {value:g}" for name, value in neighbours.items() if value is not None]
        channel_text = f"{figure.channel}, " if figure.channel else ""
        unit = f" {figure.unit}" if figure.unit else ""
        yield from hanging(
            "  figure   ",
            f"{channel_text}{figure.of}: {figure.printed:g}{unit}"
            + (f" ({', '.join(neighbour_texts)})" if neighbour_texts else ""),
        )
    yield from hanging("  open     ", finding.open)
