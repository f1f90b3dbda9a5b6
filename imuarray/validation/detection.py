"""The detection limit of a mechanism: the severity at which the full plan just shows that something is wrong.

    python -m imuarray.validation.detection --seed 1 -o limits.json

A case without a mechanism says what chance makes of the same units; what is scored is the distance from the model that
was fitted to the case itself, so that what a fit absorbs doesn't show. From the largest score at one severity, at first
the limit as it was known before, the next is told, until it is about what chance reaches. Seeds are of the development
half.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
import numpy.typing as npt

from imuarray.gap.inference.comparison import Comparison, compared_with_base, prepared
from imuarray.gap.model.bench import Bench
from imuarray.gap.model.workers import processes, runner
from imuarray.gap.recording.recordings import recordings_of
from imuarray.gap.statistics.campaign import Campaign
from imuarray.gap.statistics.catalogue import Key
from imuarray.gap.statistics.pairs import scorer_of
from imuarray.gap.statistics.synthetic_likelihood import likeness_of
from imuarray.log import open_log
from imuarray.validation.case import Put, write_json
from imuarray.validation.generator import mechanisms, record
from imuarray.validation.limits import FURTHEST, limit

Floats = npt.NDArray[np.float64]

REPLICATES = 60
PLAN = "full"
_TRIES, _NEAR = 4, 1.4
_MORE, _CLEAR = 5.0, 1.5
_NEXT_TO_NOTHING, _APART, _LEAST = 1e-6, 1.0, 0.03
_POWERS = (0.5, 3.0)

_FITTED = 4
"""Replicates that say what a case's own model makes."""

_PROBES: Mapping[str, str] = {"adxl345": "ADXL1", "bma180": "BMA1", "l3g4200d": "Gyro1"}
"""The sensors on which limits are measured: one of each chip."""


@dataclass(frozen=True)
class Asked:
    """One mechanism on one sensor (or, "", wherever it goes)."""

    mechanism: str
    sensor: str
    seed: int


def limit_of(asked: Asked) -> float:
    """The severity, to within some tenths of itself; nan if the greatest doesn't show, the least that was tried if that
    shows. Chance alone comes near what chance reaches: several times the limit has to be well beyond it.
    """
    known = limit(asked.mechanism, (asked.sensor,) if asked.sensor else ())
    severity = _just(asked, 1.0 if np.isnan(known) else known)
    while not np.isnan(severity) and not is_clear(asked, severity):
        further = _MORE * severity
        severity = max(_just(asked, further), further) if further < FURTHEST else float("nan")
    return severity


def is_clear(asked: Asked, severity: float) -> bool:
    """Whether several times that severity, or the greatest, is well beyond what chance reaches."""
    return beyond(asked, min(_MORE * severity, FURTHEST)) > _CLEAR


def _just(asked: Asked, severity: float) -> float:
    """About the severity that reaches what chance does, from the first one that is tried; nan if none does."""
    tried = list[tuple[float, float]]()
    for _ in range(_TRIES):
        reached = beyond(asked, severity)
        tried.append((severity, reached))
        if 1 / _NEAR < reached < _NEAR:
            break
        power = _power(tried)
        severity = float(np.clip(severity * reached ** (-1 / power), 1 / FURTHEST, FURTHEST))
        if severity == tried[-1][0]:
            break
    severity, reached = tried[-1]
    if severity == FURTHEST and reached < 1:
        return float("nan")
    return float(np.clip(severity * reached ** (-1 / _power(tried)), 1 / FURTHEST, FURTHEST))


def _power(tried: Sequence[tuple[float, float]]) -> float:
    """How scores go with severity, by the last two: 1 as bias does, 2 as noise added to noise, 1 if nobody knows."""
    if len(tried) < 2 or tried[-1][1] == tried[-2][1]:
        return 1.0
    (first, low), (second, high) = tried[-2:]
    return float(np.clip(np.log(high / low) / np.log(second / first), *_POWERS))


def beyond(asked: Asked, severity: float) -> float:
    """The largest score of a case of that severity over what chance reaches, of those that are another with next to
    nothing of it, whose noise is the same; at least 0.03.
    """
    scores, nothing = _scores(asked, severity), _scores(asked, _NEXT_TO_NOTHING)
    moved = np.where(np.abs(scores - nothing) > _APART, np.abs(scores), np.abs(scores - nothing))
    return float(max(moved.max() / _null(asked.seed).located.limit, _LEAST))


@lru_cache(maxsize=8)
def _scores(asked: Asked, severity: float) -> Floats:
    """(m,) by how much a case is off what its own model makes, by the scatter of the replicates of one without."""
    null = _null(asked.seed)
    sensors = (asked.sensor,) if asked.sensor else ()
    with _recorded(asked.seed, Put(asked.mechanism, severity, 1.0, sensors)) as (bench, campaign):
        models = bench.models()
        own = np.array([one.values for one in bench.replicates([(models, number) for number in range(_FITTED)])])
        found = np.vstack([bench.observed(campaign, models).values, own]) - _mean(own)
        places = {key: place for place, key in enumerate(_parts(bench))}
    known = [places.get(key, -1) for key in _parts(null.bench)]
    off, *chance = np.where(np.array(known) < 0, np.nan, found[:, known])
    return np.nan_to_num(_scorer(asked.seed)(off / _wider(null, np.array(chance)) + _mean(null.chance)))


def _wider(null: Comparison, chance: Floats) -> Floats:
    """(n,) how much more than without the mechanism the statistics of a probe scatter about their mean in replicates
    (r, n) of the case's own model, 1 where they scatter less: more noise moves everything further by chance.
    """
    usual = np.nanstd(null.chance, axis=0, ddof=1)
    square = np.square(chance / np.where(usual > 0, usual, np.nan)) * len(chance) / (len(chance) - 1)
    kinds = np.unique([f"{key.sensor} {key.probe}" for key in null.bench.keys], return_inverse=True)[1]
    counted = np.isfinite(square)
    total = np.bincount(kinds, np.where(counted, square, 0.0).sum(axis=0))
    mean = total / np.maximum(np.bincount(kinds, counted.sum(axis=0)), 1)
    return np.asarray(np.sqrt(np.maximum(mean, 1.0))[kinds])


def _mean(replicates: Floats) -> Floats:
    """(n,) of what is known of (b, n)."""
    return np.asarray(np.nansum(replicates, axis=0) / np.maximum(np.isfinite(replicates).sum(axis=0), 1))


def _parts(bench: Bench) -> Iterator[tuple[Key, bool]]:
    return zip(bench.keys, bench.held_out.tolist(), strict=True)


@lru_cache(maxsize=2)
def _null(seed: int) -> Comparison:
    with _recorded(seed) as (bench, campaign):
        return compared_with_base(bench, campaign, runner(bench), REPLICATES)


@lru_cache(maxsize=2)
def _scorer(seed: int) -> Callable[[Floats], Floats]:
    """By one half of the replicates, as a diagnosis with fewer of them would have it."""
    null = _null(seed)
    first = null.chance[1::2]
    return scorer_of(null.pairs, likeness_of(first, null.bench.resolutions), first)


@contextmanager
def _recorded(seed: int, *puts: Put) -> Iterator[tuple[Bench, Campaign]]:
    """A case of the full plan with these at work, as a diagnosis begins with it; its logs are gone at the end."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        logs, _ = record(Path(name), PLAN, puts, seed)
        yield prepared(recordings_of([stack.enter_context(open_log(path)) for path in logs]), None, 0)


@click.command()
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--workers", type=int, default=2, show_default=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True)
def program(seed: int, workers: int, output: Path) -> None:
    """Measure the limits of all mechanisms."""
    found: dict[str, dict[str, float]] = json.loads(output.read_text()) if output.exists() else {}
    asked = [
        one
        for one in sorted(_all(seed), key=lambda one: (not one.sensor, one.sensor))
        if one.sensor not in found.get(one.mechanism, {})
    ]
    with processes(workers) as executor:
        futures = {executor.submit(limit_of, one): one for one in asked}
        for number, future in enumerate(as_completed(futures), start=1):
            one = futures[future]
            found.setdefault(one.mechanism, {})[one.sensor] = future.result()
            click.echo(f"{number}/{len(asked)} {one.mechanism} {one.sensor or 'anywhere'}: {future.result():.3g}")
            write_json(output, found)


def _all(seed: int) -> Iterator[Asked]:
    for name, facts in mechanisms().items():
        if not facts["graded"] or facts["place"] == "pair":
            continue
        if facts["place"] in ("host", "design"):
            yield Asked(name, "", seed)
        else:
            yield from (Asked(name, sensor, seed) for chip, sensor in _PROBES.items() if chip in facts["touches"])


if __name__ == "__main__":
    program()
