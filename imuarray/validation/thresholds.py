"""The thresholds of the diagnosis, recorded when a run begins so that none is changed during it."""

from __future__ import annotations

from typing import Any

import imuarray
from imuarray.gap.findings import causes, description, verdict
from imuarray.gap.inference import assessment, forward_selection, localisation, unit_state
from imuarray.gap.statistics import synthetic_likelihood
from imuarray.validation import trial


def frozen_thresholds() -> dict[str, Any]:
    """Return the thresholds by name, with the version of the software."""
    return {
        "level of false alarms": localisation.LEVEL,
        "nats to be looked at": forward_selection.WORTH,
        "nats to be accepted": forward_selection.ACCEPTED,
        "nats a parameter costs": forward_selection.COST,
        "wrong form allowed": synthetic_likelihood.FORM,
        "log odds tempered": causes.TEMPER,
        "right if nothing closes": verdict.RATES.least,
        "right if all closes": verdict.RATES.most,
        "power of what closes": verdict.RATES.steep,
        "power of odds against rivals": verdict.RATES.rivals,
        "probability to be told": causes.ALTERNATIVE,
        "odds to be confusable": causes.CONFUSABLE,
        "closed to be a cause": causes.LEAST,
        "closed to be explained": verdict.EXPLAINED,
        "closed to be partly explained": verdict.PARTLY,
        "probability to explain": verdict.EVEN,
        "left over to be unlikely": description.UNLIKELY,
        "beyond chance to be left": assessment.MORE,
        "replicates of the base model": trial.REPLICATES,
        "replicates of a trial": unit_state.REPLICATES,
        "software": f"imuarray {imuarray.__version__}",
    }
