"""Simulated logs: every sensor of an array measures a motion, the effects of a model act on its signal, and counts are
written.

::

    motion  ->  effects, in physical order  ->  counts  ->  log
    force,      one small class each            codes,      the same shape as
    rate,       (`EFFECTS`), parameters         flags       a recorded one,
    field ...   from a model file                           with `/truth`

Any block of a log can be made alone; the same seed gives the same rows whatever the block size or number of workers.
`imuarray.simulate(array, "sim.h5")` does all of it (`imuarray.analysis.simulate`).
"""

from imuarray.callable_package import make_callable
from imuarray.simulate.effects import EFFECTS
from imuarray.simulate.model import Model, load_model, parse_model
from imuarray.simulate.motion.stimulus import BoxStimulus, Motion
from imuarray.simulate.record import Written, total_rows, write_log
from imuarray.simulate.simulation import Plan, Simulation, effects_of, plan_like, plan_of

__all__ = [
    "EFFECTS",
    "BoxStimulus",
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
