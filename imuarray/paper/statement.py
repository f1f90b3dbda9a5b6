"""One thing that the paper says, the numbers that bear on it, and whether it holds.

`holds` is always computed from the tables; the evidence names the numbers and, where judgement enters, the criterion.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from typing import Any


@dataclass(frozen=True)
class Statement:
    """A claim of the paper (its place first), the evidence from its own tables, and the verdict."""

    claim: str
    evidence: str
    holds: bool

    def as_json(self) -> dict[str, Any]:
        """The three fields under their names."""
        return {"claim": self.claim, "evidence": self.evidence, "holds": self.holds}


def figure(value: float | Decimal, digits: int) -> str:
    """A number for an evidence sentence, with a fixed number of decimals and no negative zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"
