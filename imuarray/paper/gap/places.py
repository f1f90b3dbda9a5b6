"""A statistic of the paper as an entry of `where`, in the words of `gap diagnose`."""

from __future__ import annotations

from typing import Any

from imuarray.paper.accelerometers import READINGS
from imuarray.paper.replica.statistic import Statistic


def place(row: Statistic) -> dict[str, Any]:
    """Where it stands, what is printed and foretold, how many deviations off, and by how much."""
    sensor, *axis = row.channel.split()
    return {
        "log": row.table,
        "sensor": sensor if axis else "",
        "axis": axis[0] if axis and axis[0] in ("x", "y", "z") else "",
        "domain": domain(row),
        "phase": row.statistic if row.statistic in READINGS else "",
        "statistic": row.statistic,
        "real": row.published,
        "simulated": row.simulated,
        "significance": row.z,
        "effect_size": row.published - row.simulated,
    }


def domain(row: Statistic) -> str:
    """One of those of `gap diagnose`."""
    if row.table == "Appendix A.2":
        return "codes"
    if row.table in ("Figure 13", "Figure 14"):
        return "autocorrelation" if "neighbours" in row.statistic else "spectrum"
    if row.statistic.startswith("slope"):
        return "temperature"
    if row.statistic.startswith(("dbias", "scale")):
        return "force"
    if "of_means" in row.statistic and row.statistic.startswith("cont"):
        return "allan"
    if "of_means" in row.statistic or row.statistic == "ratio" or row.statistic.startswith("run "):
        return "run_to_run"
    return "spread" if "std" in row.statistic or "sem" in row.statistic else "level"
