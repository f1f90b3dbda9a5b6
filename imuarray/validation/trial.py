"""One case from its recording to its outcome: the generator records it, it is diagnosed blindly and then once more by
an oracle.

The diagnosis receives the paths of the logs, the effects that are withheld from its library and the model. Only the
oracle receives the active mechanisms; its library contains nothing else.
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

from imuarray import __version__
from imuarray.gap.diagnose import REPLICATES, GapCase, Reference, compare, explain, library
from imuarray.gap.findings import causes, deviations, diagnosis, verdict
from imuarray.gap.inference import assessment, forward_selection, refinement, unit_state
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.model.populations import usual_model
from imuarray.gap.model.workers import runner
from imuarray.gap.recording.recordings import recordings_of
from imuarray.gap.statistics import synthetic_likelihood
from imuarray.log import open_log
from imuarray.log.format import SensorHeader
from imuarray.simulate.model import Model, Part
from imuarray.simulate.population import figure_of
from imuarray.validation.bench import limit
from imuarray.validation.case import Case, Outcome, Put, write_json
from imuarray.validation.case_folder import read_case
from imuarray.validation.generator import mechanisms, record, record_in
from imuarray.validation.severity import FURTHEST, find_severity, matched_statistic
from imuarray.validation.worlds import draw_world

_KEPT = ("verdict", "sentence", "p", "gap", "causes", "unknown", "cannot_tell", "notes")
_WORST = 20


class CaseRecording(NamedTuple):
    """A case with the values that its recording determined, the paths of its logs, and the truth."""

    case: Case
    logs: list[Path]
    truth: Mapping[str, Any]


def diagnose_case(case: Case, folder: Path) -> None:
    """Write the truth into `folder`/sealed and then the outcome into `folder`/outcomes."""
    begin = time.perf_counter()
    with TemporaryDirectory() as name, ExitStack() as stack:
        case, logs, truth = record_case(case, Path(name))
        for part in ("sealed", "outcomes"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        write_json(folder / "sealed" / f"{case.name}.json", {"case": case.table(), "truth": truth})
        opened = [stack.enter_context(open_log(path)) for path in logs]
        recordings = recordings_of(opened)
        plans = [recording.experiment.plan.sensors for recording in recordings]
        headers = {name: header for plan in plans for name, (header, _) in plan.items()}
        model = model_with(case.extra, headers.values()) if case.extra else None
        compared = compare(recordings, runner, Reference(model))
        diagnosis = explain(compared, library(case.without), briefly=True).as_json()
        oracle = _oracle(compared, case, truth) if case.kind in ("single", "pair") else {}
    kept = {key: diagnosis[key] for key in _KEPT}
    lists = {key: diagnosis[key][:_WORST] for key in ("where", "unexplained")}
    outcome = Outcome(case.name, {**kept, **lists}, oracle, time.perf_counter() - begin)
    write_json(folder / "outcomes" / f"{case.name}.json", asdict(outcome))


def record_case(case: Case, folder: Path) -> CaseRecording:
    """Return the logs of a case: from a case folder, from a fixed plan, or from a random world, in which the severity
    of each mechanism is matched to the required number of detection limits.
    """
    if case.source:
        return CaseRecording(*read_case(case))
    if not case.world:
        return CaseRecording(case, *record(folder, case.plan, case.puts, case.seed))
    world = draw_world(case.draw).table()
    with_reference = {**world, "recorder": {**world["recorder"], "reference": True}}
    trials: dict[tuple[Put, ...], tuple[list[Path], dict[str, Any]]] = {}

    def written(*puts: Put) -> list[Path]:
        if puts not in trials:
            trials[puts] = record_in(with_reference, folder / f"{len(trials)}", puts, case.seed)
        return trials[puts][0]

    puts = []
    with ExitStack() as stack:
        for put in case.puts:
            if not mechanisms()[put.mechanism]["graded"]:
                puts.append(replace(put, severity=1.0, limits=math.nan))
                continue
            chip = case.chips[put.sensors[0]] if put.sensors else ""
            known = limit(put.mechanism, chip) * put.limits
            first = min(known, FURTHEST) if math.isfinite(known) else 1.0

            def statistic(severity: float, put: Put = put) -> float:
                paths = (written(), written(replace(put, severity=severity)))
                plain, changed = ([stack.enter_context(open_log(path)) for path in logs] for logs in paths)
                is_of_recorder = mechanisms()[put.mechanism]["place"] == "host"
                return matched_statistic(plain, changed, world["recorder"]["reference"], is_of_recorder)

            fit = find_severity(statistic, put.limits, first)  # nominal limits stay if they were reached
            puts.append(
                replace(put, severity=fit.severity, limits=put.limits if math.isfinite(fit.limits) else math.nan)
            )
    named = [replace(put, limits=wanted.limits) for put, wanted in zip(puts, case.puts, strict=True)]
    logs = written(*named)
    if not world["recorder"]["reference"]:
        for path in logs:
            leave_reference_out(path)
    truth = {**trials[tuple(named)][1], "world": world, "limits": [put.limits for put in puts]}
    return CaseRecording(replace(case, puts=tuple(puts)), logs, truth)


def leave_reference_out(path: Path) -> None:
    """Remove the reference and the truth from a log, as if the commanded motion had not been recorded."""
    with h5py.File(path, "r+") as file:
        for name in ("reference", "truth"):
            if name in file:
                del file[name]


def model_with(extra: Mapping[str, Any], headers: Iterable[SensorHeader]) -> Model:
    """Return the usual model of the diagnosis with one effect added to one sensor."""
    recipe = {key: figure_of(value, extra["effect"]) for key, value in extra["parameters"].items()}
    part = Part(extra["chip"], name=extra["sensor"], effects={extra["effect"]: (recipe,)})
    return replace(usual_model(headers), name="data sheets and more", sensors=(part,))


def _oracle(compared: GapCase, case: Case, truth: Mapping[str, Any]) -> dict[str, Any]:
    """Return the share closed by a diagnosis that knows the effects and their sensors, with its interval. It needs no
    evidence that they are present, and considers no others.
    """
    effects = {name for names in case.resembles for name in names}
    sensors = {name for mechanism in truth["mechanisms"] for name in mechanism["sensors"]} & compared.headers.keys()
    candidates = {name: mechanism for name, mechanism in CANDIDATES.items() if name in effects}
    gap = explain(compared, candidates, known=sorted(sensors), briefly=True).as_json()["gap"]
    return {"closed": gap["closed"], "closed_ci95": gap["closed_ci95"]}


def frozen_thresholds() -> dict[str, Any]:
    """Return the thresholds of the diagnosis by name, with the version of the software. They are recorded when a run
    begins, so that a change during the run is noticed.
    """
    return {
        "significance level of a gap": assessment.LEVEL,
        "least gain (nats) of a candidate that is pursued": refinement.WORTH,
        "least gain (nats) of a candidate that is accepted": forward_selection.ACCEPTED,
        "cost (nats) of each parameter": forward_selection.COST,
        "allowed relative error of the form of an effect": synthetic_likelihood.FORM,
        "exponent of the odds of a candidate in its probability": causes.TEMPER,
        "probability of a cause that closes nothing": verdict.RATES.least,
        "probability of a cause that closes everything": verdict.RATES.most,
        "exponent of the share closed in the probability of a cause": verdict.RATES.steep,
        "exponent of the odds against rivals in the probability of a cause": verdict.RATES.rivals,
        "least probability of an alternative that is reported": causes.ALTERNATIVE,
        "least odds of an effect that is confusable": causes.CONFUSABLE,
        "least share of the gap that a cause closes": causes.LEAST,
        "least share closed for the verdict explained": verdict.EXPLAINED,
        "least share closed for the verdict partly explained": verdict.PARTLY,
        "least probability of the first cause for the verdict explained": diagnosis.EVEN,
        "remaining difference from which something unknown is likely": deviations.UNLIKELY,
        "factor over chance from which a remaining difference is significant": assessment.MORE,
        "most replicates of the base model": REPLICATES,
        "replicates of each candidate": unit_state.REPLICATES,
        "software": f"imuarray {__version__}",
    }
