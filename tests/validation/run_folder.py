"""Runs made by hand: cases, their truth, and their diagnoses, as the files of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import nan
from pathlib import Path
from typing import Any

from imuarray.validation.case import Case, Kind, Outcome, Put, write_json

FROZEN = {"level": 0.05, "version": "1.2.3"}
NAMES: Mapping[str, tuple[str, ...]] = {
    "mains_ripple": ("tone",),
    "single_trap": ("popcorn_noise",),
    "slow_oscillator": ("stale_samples", "odr_error"),
    "reference_voltage": ("scale",),
    "torn_reads": ("glitches",),
    "cable_bit_errors": ("glitches",),
    "crossed_wiring": ("channel_swap",),
}


def cause(effect: str, probability: float = 0.9, *sensors: str, **more: Any) -> dict[str, Any]:
    """A cause as in the JSON of a diagnosis; on Gyro1 by default."""
    return {
        "effect": effect,
        "action": "add",
        "sensors": list(sensors or ("Gyro1",)),
        "axes": [],
        "probability": probability,
        "closed": 0.9,
        "closed_ci95": [0.8, 1.0],
        "confusable_with": [],
        **more,
    }


def gap_diagnosis(
    *causes: Mapping[str, Any],
    verdict: str = "explained",
    closed: float | None = 0.9,
    ci95: tuple[float, float] | None = (0.8, 1.0),
    unknown: float = 0.1,
    unshown: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """A diagnosis that reports a gap."""
    gap = {"before": 9.0, "after": 2.0, "floor": 1.0, "closed": closed, "closed_ci95": ci95 and list(ci95)}
    return {
        "verdict": verdict,
        "p": 0.01,
        "gap": gap,
        "causes": list(causes),
        "unknown": unknown,
        "unshown": list(unshown),
    }


NO_GAP = gap_diagnosis(verdict="no gap", closed=None, ci95=None, unknown=0.0)


@dataclass
class RunFolder:
    """A run's folder that grows."""

    folder: Path
    count: int = 0
    plan: Mapping[str, Any] = field(default_factory=lambda: {"seed": 7, "half": "sealed", "frozen": FROZEN})

    def __post_init__(self) -> None:
        for name in ("sealed", "outcomes"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        write_json(self.folder / "plan.json", self.plan)

    def case(
        self,
        kind: Kind,
        *puts: Put,
        plan: str = "full",
        resembles: Sequence[Sequence[str]] | None = None,
        extra: Mapping[str, Any] | None = None,
        touched: Sequence[Mapping[str, Sequence[str]]] = (),
        **about: Any,
    ) -> Case:
        """The next case, with its truth sealed; in each log random faults `touched` these sensors. `about`: other
        fields of the case.
        """
        self.count += 1
        names = (
            tuple(tuple(item) for item in resembles)
            if resembles is not None
            else tuple(NAMES[put.mechanism] for put in puts)
        )
        case = Case(self.count, "sealed", kind, plan, puts, self.count, (), extra or {}, names, **about)
        mechanisms = [
            {
                "mechanism": put.mechanism,
                "severity": put.severity,
                "sensors": list(put.sensors or ("Gyro1",)),
                "parameters": {},
                "resembles": list(effects),
            }
            for put, effects in zip(puts, names, strict=kind != "removal")
        ]
        table = {"case": case.table(), "truth": {"array": "martin2013", "mechanisms": mechanisms}}
        table["truth"]["logs"] = [{"touched": item} for item in touched]
        write_json(self.folder / "sealed" / f"{case.name}.json", table)
        return case

    def answer(self, case: Case, diagnosis: Mapping[str, Any], **more: Any) -> None:
        """Write the outcome of a case."""
        outcome = Outcome(case.name, diagnosis, **{"oracle": {}, "seconds": 10.0, **more})
        write_json(self.folder / "outcomes" / f"{case.name}.json", asdict(outcome))

    def both(
        self, kind: Kind, diagnosis: Mapping[str, Any], *puts: Put, oracle: float | None = None, **more: Any
    ) -> Case:
        """A case and its answer."""
        case = self.case(kind, *puts, **more)
        self.answer(
            case, diagnosis, oracle={} if oracle is None else {"closed": oracle, "closed_ci95": [oracle, oracle]}
        )
        return case


def put(mechanism: str, limits: float = 5.0, *sensors: str) -> Put:
    """A mechanism, on Gyro1 by default; nan: it has no severity."""
    return Put(mechanism, 1.0 if limits != limits else limits / 2, limits, sensors)


THERE_OR_NOT = nan
