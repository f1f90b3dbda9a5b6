"""One case from its recording to its outcome: made by the generator, diagnosed blindly, then once more by an oracle.

The diagnosis is given the paths of the logs, the effects that are withheld from its library and the model; what is at
work in the logs is told to nobody but the oracle, whose library holds nothing else.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import h5py

from imuarray.gap.diagnose import GapCase, compare, explain, library
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.model.populations import usual_model
from imuarray.gap.model.workers import runner
from imuarray.gap.recording.recordings import Recording, recordings_of
from imuarray.log import open_log
from imuarray.log.format import SensorHeader
from imuarray.simulate.model import Model, Part
from imuarray.simulate.population import figure_of
from imuarray.validation.bench import limit
from imuarray.validation.case import Case, Outcome, Put, write_json
from imuarray.validation.case_folder import read_case
from imuarray.validation.generator import mechanisms, record, record_in
from imuarray.validation.severity import FURTHEST, Sized, sized
from imuarray.validation.worlds import draw_world

REPLICATES = 40
"""Of the base model in a case: the smallest number with which 5 % can be told; how often there's a false alarm is
measured.
"""

_KEPT = ("verdict", "sentence", "p", "gap", "causes", "unknown", "cannot_tell", "notes")
_WORST = 20


class Recorded(NamedTuple):
    """A case with all that was settled while it was recorded, the paths of its logs, and the truth."""

    case: Case
    logs: list[Path]
    truth: Mapping[str, Any]


def tried(case: Case, folder: Path) -> None:
    """Writes the truth into `folder`/sealed and the outcome into `folder`/outcomes, in this order."""
    begin = time.perf_counter()
    with TemporaryDirectory() as name, ExitStack() as stack:
        case, logs, truth = recorded(case, Path(name))
        for part in ("sealed", "outcomes"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        write_json(folder / "sealed" / f"{case.name}.json", {"case": case.table(), "truth": truth})
        opened = [stack.enter_context(open_log(path)) for path in logs]
        recordings = recordings_of(opened)
        model = model_with(case.extra, headers_of(recordings)) if case.extra else None
        compared = compare(recordings, runner, model=model, replicates=REPLICATES)
        found = explain(compared, library(case.without), briefly=True).as_json()
        oracle = _oracle(compared, case, truth) if case.kind in ("single", "pair") else {}
    kept = {key: found[key] for key in _KEPT}
    lists = {key: found[key][:_WORST] for key in ("where", "unexplained")}
    outcome = Outcome(case.name, {**kept, **lists}, oracle, time.perf_counter() - begin)
    write_json(folder / "outcomes" / f"{case.name}.json", asdict(outcome))


def recorded(case: Case, folder: Path) -> Recorded:
    """The logs of a case: those that somebody wrote, those of a fixed plan, or those of a random world, in which each
    mechanism has the severity that is so many detection limits of this case.
    """
    if case.source:
        return Recorded(*read_case(case))
    if not case.world:
        return Recorded(case, *record(folder, case.plan, case.puts, case.seed))
    world = draw_world(case.draw).table()
    told = {**world, "recorder": {**world["recorder"], "reference": True}}
    made: dict[tuple[Put, ...], tuple[list[Path], dict[str, Any]]] = {}

    def written(*puts: Put) -> list[Path]:
        if puts not in made:
            made[puts] = record_in(told, folder / f"{len(made)}", puts, case.seed)
        return made[puts][0]

    puts = []
    with ExitStack() as stack:
        for put in case.puts:
            if not mechanisms()[put.mechanism]["graded"]:
                puts.append(replace(put, severity=1.0, limits=math.nan))
                continue
            chip = case.chips[put.sensors[0]] if put.sensors else ""
            known = limit(put.mechanism, chip) * put.limits
            first = min(known, FURTHEST) if math.isfinite(known) else 1.0

            def logs_at(severity: float, put: Put = put) -> list[Any]:
                paths = written(replace(put, severity=severity))
                return [stack.enter_context(open_log(path)) for path in paths]

            plain = [stack.enter_context(open_log(path)) for path in written()]
            puts.append(_as_sized(put, sized(logs_at, plain, put.limits, first)))
    named = [replace(put, limits=wanted.limits) for put, wanted in zip(puts, case.puts, strict=True)]
    logs = written(*named)
    if not world["recorder"]["reference"]:
        for path in logs:
            leave_reference_out(path)
    truth = {**made[tuple(named)][1], "world": world, "limits": [put.limits for put in puts]}
    return Recorded(replace(case, puts=tuple(puts)), logs, truth)


def _as_sized(put: Put, found: Sized) -> Put:
    """What is asked for counts, if it was reached."""
    return replace(put, severity=found.severity, limits=put.limits if math.isfinite(found.limits) else math.nan)


def leave_reference_out(path: Path) -> None:
    """As if nobody had noted what the bench was told to do."""
    with h5py.File(path, "r+") as file:
        for name in ("reference", "truth"):
            if name in file:
                del file[name]


def model_with(extra: Mapping[str, Any], headers: Iterable[SensorHeader]) -> Model:
    """What sensors usually have, as the diagnosis' own model has it, and in one of them one effect more."""
    recipe = {key: figure_of(value, extra["effect"]) for key, value in extra["parameters"].items()}
    part = Part(extra["chip"], name=extra["sensor"], effects={extra["effect"]: (recipe,)})
    return replace(usual_model(headers), name="data sheets and more", sensors=(part,))


def headers_of(recordings: Iterable[Recording]) -> list[SensorHeader]:
    """Of all sensors that were recorded, each once."""
    found = {name: header for one in recordings for name, (header, _) in one.experiment.plan.sensors.items()}
    return list(found.values())


def _oracle(compared: GapCase, case: Case, truth: Mapping[str, Any]) -> dict[str, Any]:
    """The share closed by who knows the effects and the sensors that have them, with its interval: such a one need not
    be shown that they are there, and blames no others.
    """
    effects = {name for names in case.resembles for name in names}
    sensors = {name for one in truth["mechanisms"] for name in one["sensors"]} & compared.headers.keys()
    candidates = {name: one for name, one in CANDIDATES.items() if name in effects}
    gap = explain(compared, candidates, known=sorted(sensors), briefly=True).as_json()["gap"]
    return {"closed": gap["closed"], "closed_ci95": gap["closed_ci95"]}
