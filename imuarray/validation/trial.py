"""One case from its recording to its outcome: made by the generator, diagnosed blindly, then once more by an oracle.

The diagnosis is given the paths of the logs, the effects that are withheld from its library and the model; what is at
work in the logs is told to nobody but the oracle, whose library holds nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from imuarray.gap.diagnose import GapCase, compare, explain, library
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.model.populations import usual_model
from imuarray.gap.model.workers import runner
from imuarray.gap.recording.recordings import Recording, recordings_of
from imuarray.log import open_log
from imuarray.log.format import SensorHeader
from imuarray.simulate.model import Model, Part
from imuarray.simulate.population import figure_of
from imuarray.validation.case import Case, Outcome, write_json
from imuarray.validation.generator import CHIPS, record

REPLICATES = 40
"""Of the base model in a case: the smallest number with which 5 % can be told; how often there's a false alarm is
measured.
"""

_KEPT = ("verdict", "sentence", "p", "gap", "causes", "unknown", "cannot_tell", "notes")
_WORST = 20


def tried(case: Case, folder: Path) -> None:
    """Writes the truth into `folder`/sealed and the outcome into `folder`/outcomes, in this order."""
    begin = time.perf_counter()
    with TemporaryDirectory() as name, ExitStack() as stack:
        logs, truth = record(Path(name), case.plan, case.puts, case.seed)
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


def model_with(extra: Mapping[str, Any], headers: Iterable[SensorHeader]) -> Model:
    """What sensors usually have, as the diagnosis' own model has it, and in one of them one effect more."""
    recipe = {key: figure_of(value, extra["effect"]) for key, value in extra["parameters"].items()}
    part = Part(CHIPS[extra["sensor"]], name=extra["sensor"], effects={extra["effect"]: (recipe,)})
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
