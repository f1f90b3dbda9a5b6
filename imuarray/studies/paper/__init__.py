"""The paper's own numbers, recomputed from the tables that it prints, and its conclusions checked against them.

H. Martin, P. Groves, M. Newman, R. Faragher, A New Approach to Better Low-Cost MEMS IMU Performance Using Sensor
Arrays, 26th International Technical Meeting of the Satellite Division of The Institute of Navigation (ION GNSS+ 2013),
Nashville, Tennessee, September 2013: "the paper" everywhere in this project. Its raw logs are not public; its Tables 1
to 11 (`tables/`) are the only published measurements of that array.

Counts are "lsb", specific force mg and angular rate degrees per second here, as the paper prints them. Numbers are
decimal, so that no binary rounding precedes the comparison with a printed digit. Only the standard library is needed.
"""

from __future__ import annotations

from imuarray.studies.paper.results import SOURCE, recompute, render_text

__all__ = ["SOURCE", "recompute", "render_text"]
