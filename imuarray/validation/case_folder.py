"""Folders of cases from any source: the logs, and separate from them the truth of each case.

::

    FOLDER/000/*.h5           the logs of case 000, in the order of their epochs
    FOLDER/sealed/000.json    its truth

A truth is one object of JSON; keys in brackets are optional:

    kind         "control": no effect; "effect"; "unknown": an effect that no library names; "pair": two effects
    effects      a list (empty for a control) of
        effect       its name in the source of the case
        design_name  its name in the library, null if it has none there; [also_called]: a list of other names
        sensors      the names of the affected sensors, [] for all
        [axes]       the affected axes, "x", "y", "z"; all if missing
        [severity]   its size in detection limits, null for an effect without a size
    [world]      the source: "foreign" (the default), "real", ...
    [experiments]  a list of names, which makes the plan; [sensors]: chips by the names of sensors; [strata]: words
    [control]    the number of the case that is the same recording without the effects

Other keys are kept and ignored. An effect that has only names of nuisance quantities is ignored, because it is within
the tolerances of parts.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

from imuarray.errors import ConfigError
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.validation.case import Case, Half, Kind, Put, write_json

FOREIGN = "foreign"
SEALED = "sealed"
NUISANCES = frozenset({"thermometer", "own_clock"})
"""Effect names that a diagnosis never reports as causes."""

_KINDS = ("control", "effect", "unknown", "pair")


def cases_in(folders: Sequence[Path], half: Half, first: int) -> list[Case]:
    """Return the cases of these folders, numbered from `first` on, without reading their truth. ConfigError for a
    folder without cases.
    """
    cases: list[Case] = []
    for folder in folders:
        places = _places(folder)
        if not places:
            raise ConfigError(f"{folder}: no cases: NAME/*.h5 and {SEALED}/NAME.json are required")
        for number, place in enumerate(places, first + len(cases)):
            cases.append(Case(number, half, "none", "", (), number, world=FOREIGN, source=str(place.resolve())))
    return cases


def read_case(case: Case) -> tuple[Case, list[Path], dict[str, Any]]:
    """Return the case completed from its truth, its logs, and the truth with its effects under "mechanisms".
    ConfigError for an invalid truth.
    """
    place = Path(case.source)
    path = place.parent / SEALED / f"{place.name}.json"
    truth = _truth(path)
    logs = sorted(place.glob("*.h5"))
    if not logs:
        raise ConfigError(f"{place}: no logs")
    effects = [effect for effect in truth["effects"] if not set(_names(effect)) <= NUISANCES or not _names(effect)]
    resembles = tuple(tuple(name for name in _names(effect) if name in CANDIDATES) for effect in effects)
    mechanisms = [
        {
            "mechanism": effect["effect"],
            "sensors": list(effect["sensors"]),
            "parameters": {"axes": list(effect.get("axes") or ())} if len(effect.get("axes") or ()) < 3 else {},
            "resembles": list(names),
        }
        for effect, names in zip(effects, resembles, strict=True)
    ]
    puts = tuple(
        Put(
            effect["effect"],
            nan,
            nan if effect.get("severity") is None else float(effect["severity"]),
            tuple(effect["sensors"]),
        )
        for effect in effects
    )
    control = truth.get("control")
    completed = replace(
        case,
        kind=_kind(resembles),
        plan="+".join(sorted(truth.get("experiments", ()))),
        puts=puts,
        resembles=resembles,
        world=str(truth.get("world", FOREIGN)),
        chips=dict(truth.get("sensors") or {}),
        strata={key: str(value) for key, value in (truth.get("strata") or {}).items()},
        control="" if control is None else _control(case, place, str(control)),
    )
    return completed, logs, {"mechanisms": mechanisms, "told": truth}


def write_truth(folder: Path, name: str, truth: Mapping[str, Any]) -> None:
    """Write the truth of the case of that name; ConfigError if it is invalid."""
    _check(truth, str(folder / SEALED / name))
    (folder / SEALED).mkdir(parents=True, exist_ok=True)
    write_json(folder / SEALED / f"{name}.json", truth)


def _truth(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: not the truth of a case: {error}") from None
    _check(table, str(path))
    return dict(table)


def _check(table: Any, where: str) -> None:
    for problem in _problems(table):
        raise ConfigError(f"{where}: {problem}")


def _problems(table: Any) -> Iterator[str]:
    if not isinstance(table, Mapping) or table.get("kind") not in _KINDS:
        yield f"kind is missing or none of {', '.join(_KINDS)}"
        return
    effects = table.get("effects")
    if not isinstance(effects, list):
        yield "effects is not a list"
        return
    for effect in effects:
        if not isinstance(effect, Mapping) or not isinstance(effect.get("effect"), str) or "sensors" not in effect:
            yield "an effect has an effect, a design_name and sensors"
        elif unknown := sorted(set(_names(effect)) - set(CANDIDATES) - NUISANCES):
            yield f"effect {unknown[0]!r}: allowed are {', '.join(CANDIDATES)}, or null"


def _names(effect: Mapping[str, Any]) -> list[str]:
    own = effect.get("design_name")
    return [*([] if own is None else [str(own)]), *effect.get("also_called", ())]


def _kind(resembles: Sequence[Sequence[str]]) -> Kind:
    """Return the kind of a case from the library names of its effects."""
    if not resembles:
        return "none"
    if len(resembles) > 1:
        return "pair"
    return "single" if resembles[0] else "unnamed"


def _control(case: Case, place: Path, name: str) -> str:
    """Return the name of the control case, which is in the same folder."""
    names = [path.name for path in _places(place.parent)]
    if name not in names:
        raise ConfigError(f"{place}: no case {name!r} in the same folder, but it is named as the control")
    return replace(case, number=case.number + names.index(name) - names.index(place.name)).name


def _places(folder: Path) -> list[Path]:
    """Return the folders of the cases that have a truth."""
    return sorted(
        path for path in folder.glob("*") if path.is_dir() and (folder / SEALED / f"{path.name}.json").exists()
    )
