"""Motions of the box, a file each; `imuarray.simulate.experiments` has the experiments by name.

::

    Motion.stimulus(time_ns) -> BoxStimulus   force, rate, field, temperature, pressure in the box frame
    Motion.phases, Motion.seconds
"""

from __future__ import annotations

from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.stimulus import BoxStimulus, Motion
from imuarray.simulate.motion.tumble import Tumble

__all__ = ["BoxStimulus", "HandShake", "Heating", "Motion", "Still", "Tumble", "turn_on_run"]
