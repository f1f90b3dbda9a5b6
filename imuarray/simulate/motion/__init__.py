"""Motions of the box, a file each; `imuarray.simulate.experiments` has the experiments by name.

::

    Motion.felt(time_ns) -> Felt          force, rate, field, temperature, pressure in the box frame; a pure function
    Motion.phases, Motion.seconds
"""

from __future__ import annotations

from imuarray.simulate.motion.faces import Still, turn_on_run
from imuarray.simulate.motion.felt import Felt, Motion
from imuarray.simulate.motion.hand_shake import HandShake
from imuarray.simulate.motion.heating import Heating
from imuarray.simulate.motion.tumble import Tumble

__all__ = ["Felt", "HandShake", "Heating", "Motion", "Still", "Tumble", "turn_on_run"]
