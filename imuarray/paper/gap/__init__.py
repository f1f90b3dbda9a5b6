"""What the data sheets' array lacks of the paper's tables: discrepancies, the effects that explain them, what is left.

From the published tables alone. The base is `configs/models/datasheet.toml` for the paper's array, its biases fitted to
Table 10's faces. Every printed statistic of the inertial axes has an expectation and a scatter in closed form
(`expected`, `fast`); effects of the simulator act on these (`acting`); candidates are ranked by BIC (`candidate`).

Numbers that parameters were fitted to count among those that come closer; how far an explanation holds beyond them
is in each discrepancy's held-out checks.
"""

from __future__ import annotations

from imuarray.paper.gap.diagnose import STEPS, diagnose
from imuarray.paper.gap.render import render_text
from imuarray.paper.gap.result import Cause, PaperGap

__all__ = ["STEPS", "Cause", "PaperGap", "diagnose", "render_text"]
