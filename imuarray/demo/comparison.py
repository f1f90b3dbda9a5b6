"""Which technique is compared with the average on which run, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from imuarray.calibrate import Calibration
from imuarray.fuse import Gain, gains
from imuarray.log import open_log
from imuarray.units import READABLE_SI

BMA180S = ("BMA1", "BMA2", "BMA3", "BMA4")

Rows = Sequence[tuple["Case", Gain]]


@dataclass(frozen=True)
class Case:
    """One comparison: a technique, on some sensors of one run, by the scatter or by the drift of its error.

    `claim` is the quantity for which the paper expects a gain here, "" where it expects none.
    """

    technique: str
    run: str
    claim: str = ""
    only: tuple[str, ...] = ()
    slow: bool = False
    phases: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """In words, for a table."""
        which = f", {self.only[0]} to {self.only[-1]}" if self.only else ""
        return f"{self.technique}, {self.run}{which}{', drift' if self.slow else ''}"


CASES = (
    Case("opposed", "heating", "angular_rate", slow=True),
    Case("planes", "static", "specific_force"),
    Case("ranges", "static", "specific_force", BMA180S),
    Case("ranges", "shaking", only=BMA180S, phases=("motion",)),
    Case("opposed", "static"),
    Case("opposed", "shaking"),
    Case("planes", "heating", slow=True),
    Case("planes", "shaking"),
    Case("ranges", "static"),
    Case("ranges", "heating"),
)
"""First where the paper says that a technique helps, then elsewhere."""


def compare(logs: Mapping[str, Path], calibration: Calibration) -> list[tuple[Case, Gain]]:
    """Every case's gains, per quantity and axis."""
    rows = []
    for case in CASES:
        with open_log(logs[case.run]) as log:
            phases = [phase for phase in log.phases if phase.name in case.phases]
            found = gains(log, calibration, case.technique, only=case.only, phases=phases, slow=case.slow)
            rows += [(case, gain) for gain in found]
    return rows


def _best(rows: Rows, case: Case) -> Gain:
    """The axis on which a technique gains most where it should."""
    of_case = [gain for found, gain in rows if found == case and gain.quantity == case.claim and gain.box_axis != "XYZ"]
    return min(of_case, key=lambda gain: gain.ratio)


def summary(rows: Rows) -> list[str]:
    """What a person should know after half a minute."""
    opposed, planes, ranges = (_best(rows, case) for case in CASES if case.claim)
    case, worst = max((row for row in rows if row[1].box_axis == "XYZ"), key=lambda row: row[1].ratio)
    return [
        f"opposed: gyroscope drift about box {opposed.box_axis} while heated {_from_to(opposed)}",
        f"planes: specific force along box {planes.box_axis} at rest {_from_to(planes)}",
        f"ranges: the four BMA180 along box {ranges.box_axis} at rest {_from_to(ranges)}",
        f"the worst of all comparisons, {case.label}, {worst.quantity.replace('_', ' ')}: {worst.ratio:.3f} ± "
        f"{worst.ratio_se:.3f} times the average (length of the error)",
        "all figures: rms error against the emulated world's truth, simple average of the same sensors first",
    ]


def _from_to(gain: Gain) -> str:
    factor, unit = READABLE_SI[gain.quantity]
    errors = f"{factor * gain.average:.3g} to {factor * gain.technique_error:.3g} {unit}"
    return f"{errors} ({gain.ratio:.3f} ± {gain.ratio_se:.3f} times)"
