"""The paper's experiments on the simulated array: does the model reproduce the tables to which it was fitted?

`observe` simulates every experiment of section 4, and `compare` compares each printed statistic with its simulated
value; columns with the same number in another unit (mg, dps) are compared once. No statistic is omitted because it does
not agree.
"""

from __future__ import annotations

from imuarray.studies.paper.replica.comparison import compare
from imuarray.studies.paper.replica.curves import Curves, curves_of
from imuarray.studies.paper.replica.simulation import ExperimentData, observe
from imuarray.studies.paper.replica.statistic import AgreementSummary, Replica, Statistic, render_text

__all__ = [
    "AgreementSummary",
    "Curves",
    "ExperimentData",
    "Replica",
    "Statistic",
    "compare",
    "curves_of",
    "observe",
    "render_text",
]
