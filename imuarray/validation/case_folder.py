"""Folders of cases that anybody wrote: logs, and apart from them what is true of each.

::

    FOLDER/000/*.h5           the logs of case 000, in the order of their epochs
    FOLDER/sealed/000.json    its truth

A truth is one object of JSON; what is in brackets may be missing:

    kind         "control": nothing is wrong; "effect"; "unknown": an effect that no library names; "pair": two effects
    effects      a list (empty of a control) of
        effect       what its maker calls it
        design_name  the effect of the library that it is, null if it has no name there; [also_called]: a list of others
        sensors      the names of those that have it, [] all
        [axes]       of these, "x", "y", "z"; all if missing
        [severity]   its size in detection limits, null if it is there or not
    [world]      who made it: "foreign" (the default), "real", ...
    [experiments]  a list of names, which makes the plan; [sensors]: chips by the names of sensors; [strata]: words
    [control]    the number of the case that is the same recording before anything was put into it

Others are kept and not looked at. Effects whose only names are those of nuisance quantities are what parts may have.
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
"""Names of the vocabulary that no diagnosis gives to a cause."""

_KINDS = ("control", "effect", "unknown", "pair")


def cases_in(folders: Sequence[Path], half: Half, first: int) -> list[Case]:
    """The cases of these folders, numbered from `first` on; of their truth nothing is read. ConfigError for a folder
    without cases.
    """
    found: list[Case] = []
    for folder in folders:
        places = _places(folder)
        if not places:
            raise ConfigError(f"{folder}: no cases: NAME/*.h5 beside {SEALED}/NAME.json are wanted")
        for number, place in enumerate(places, first + len(found)):
            found.append(Case(number, half, "none", "", (), number, world=FOREIGN, source=str(place.resolve())))
    return found


def read_case(case: Case) -> tuple[Case, list[Path], dict[str, Any]]:
    """With all that its truth says, its logs, and the truth, whose "mechanisms" are its effects. ConfigError for a
    truth that isn't one.
    """
    place = Path(case.source)
    path = place.parent / SEALED / f"{place.name}.json"
    truth = _truth(path)
    logs = sorted(place.glob("*.h5"))
    if not logs:
        raise ConfigError(f"{place}: no logs")
    effects = [one for one in truth["effects"] if not set(_names(one)) <= NUISANCES or not _names(one)]
    resembles = tuple(tuple(name for name in _names(one) if name in CANDIDATES) for one in effects)
    mechanisms = [
        {
            "mechanism": one["effect"],
            "sensors": list(one["sensors"]),
            "parameters": {"axes": list(one.get("axes") or ())} if len(one.get("axes") or ()) < 3 else {},
            "resembles": list(names),
        }
        for one, names in zip(effects, resembles, strict=True)
    ]
    puts = tuple(
        Put(one["effect"], nan, nan if one.get("severity") is None else float(one["severity"]), tuple(one["sensors"]))
        for one in effects
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
    """Beside the logs of the case of that name; ConfigError if it isn't a truth."""
    _checked(truth, str(folder / SEALED / name))
    (folder / SEALED).mkdir(parents=True, exist_ok=True)
    write_json(folder / SEALED / f"{name}.json", truth)


def _truth(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: no truth of a case: {error}") from None
    _checked(table, str(path))
    return dict(table)


def _checked(table: Any, where: str) -> None:
    for problem in _problems(table):
        raise ConfigError(f"{where}: {problem}")


def _problems(table: Any) -> Iterator[str]:
    if not isinstance(table, Mapping) or table.get("kind") not in _KINDS:
        yield f"kind is missing or none of {', '.join(_KINDS)}"
        return
    effects = table.get("effects")
    if not isinstance(effects, list):
        yield "effects is no list"
        return
    for one in effects:
        if not isinstance(one, Mapping) or not isinstance(one.get("effect"), str) or "sensors" not in one:
            yield "an effect has an effect, a design_name and sensors"
        elif unknown := sorted(set(_names(one)) - set(CANDIDATES) - NUISANCES):
            yield f"effect {unknown[0]!r}: allowed are {', '.join(CANDIDATES)}, or null"


def _names(effect: Mapping[str, Any]) -> list[str]:
    own = effect.get("design_name")
    return [*([] if own is None else [str(own)]), *effect.get("also_called", ())]


def _kind(resembles: Sequence[Sequence[str]]) -> Kind:
    """By whether effects have names."""
    if not resembles:
        return "none"
    if len(resembles) > 1:
        return "pair"
    return "single" if resembles[0] else "unnamed"


def _control(case: Case, place: Path, name: str) -> str:
    """The name of the control's case, which stands in the same folder."""
    names = [one.name for one in _places(place.parent)]
    if name not in names:
        raise ConfigError(f"{place}: no case {name!r} beside it, which is said to be its control")
    return replace(case, number=case.number + names.index(name) - names.index(place.name)).name


def _places(folder: Path) -> list[Path]:
    """Of the cases that have a truth."""
    return sorted(one for one in folder.glob("*") if one.is_dir() and (folder / SEALED / f"{one.name}.json").exists())
