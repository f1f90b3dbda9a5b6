"""The row "Indep. Temp" of Tables 10 and 11: what the BMP180 beside the sensors read, degC.

The shipped CSV files hold the rows of the sensors only, in counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

FACES_DEGC = (26.23803, 26.45391, 26.47834, 26.42805, 26.49729, 26.49944, 26.68422)
"""Table 10: means over the faces in the order in which they were up, the repeated first one last."""

DEGC: Mapping[tuple[int, str], float] = MappingProxyType(
    {
        (10, "std_lsb"): 0.251412,
        (11, "runs_mean"): 24.505,
        (11, "runs_std"): 0.030,
        (11, "runs_std_of_means"): 0.131,
        (11, "runs_range_of_means"): 0.473,
        (11, "cont_mean"): 23.817,
        (11, "cont_std"): 0.019,
        (11, "cont_std_of_means"): 0.086,
        (11, "cont_range_of_means"): 0.193,
    }
)
"""Tables 10 and 11 by table and the column's name in the CSV files."""
