"""Simulated logs: a motion, sensed by every sensor of an array through the effects of a model, written as counts.

::

    motion  ->  effects, in physical order  ->  counts  ->  log
    what        one small class each            codes,      the same shape as
    the box     (`EFFECTS`), parameters         flags       a recorded one,
    feels       from a model file                           `/truth` beside it

Any block of a log can be made alone; the same seed gives the same rows whatever the block size or number of workers.
`imuarray.simulate(array, "sim.h5")` does all of it (`imuarray.analysis.simulate`).
"""

from imuarray.callable_package import make_callable
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.model import Model, load_model, parse_model
from imuarray.simulate.motion.felt import Felt, Motion
from imuarray.simulate.record import Written, total_rows, write_log
from imuarray.simulate.simulation import Plan, Simulation, effects_of, plan_like, plan_of

__all__ = [
    "EFFECTS",
    "Felt",
    "Model",
    "Motion",
    "Plan",
    "Simulation",
    "Written",
    "effects_of",
    "load_model",
    "parse_model",
    "plan_like",
    "plan_of",
    "total_rows",
    "write_log",
]

make_callable(__name__)
