"""The thresholds that decide what a diagnosis says: noted when a run begins, so that none is moved in the middle."""

from __future__ import annotations

from typing import Any

import imuarray
from imuarray.gap import belief, causes, judgement, likeness, search, significance, standing
from imuarray.validation import trial


def frozen() -> dict[str, Any]:
    """By their names; the version of the software with them."""
    return {
        "level of false alarms": significance.LEVEL,
        "nats to be looked at": search.WORTH,
        "nats to be accepted": search.ACCEPTED,
        "nats a parameter costs": search.COST,
        "wrong form allowed": likeness.FORM,
        "log odds tempered": causes.TEMPER,
        "right if nothing closes": belief.RATES.least,
        "right if all closes": belief.RATES.most,
        "power of what closes": belief.RATES.steep,
        "power of odds against rivals": belief.RATES.rivals,
        "probability to be told": causes.ALTERNATIVE,
        "odds to be confusable": causes.CONFUSABLE,
        "closed to be a cause": causes.LEAST,
        "closed to be explained": judgement.EXPLAINED,
        "closed to be partly explained": judgement.PARTLY,
        "beyond chance to be left": judgement.MORE,
        "replicates of the base model": trial.REPLICATES,
        "replicates of a trial": standing.REPLICATES,
        "software": f"imuarray {imuarray.__version__}",
    }
