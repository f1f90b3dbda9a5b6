"""The thresholds of the diagnosis, recorded when a run begins so that none is changed during it."""

from __future__ import annotations

from typing import Any

import imuarray
from imuarray.gap.findings import causes, deviations, diagnosis, verdict
from imuarray.gap.inference import assessment, forward_selection, unit_state
from imuarray.gap.statistics import synthetic_likelihood
from imuarray.validation import trial


def frozen_thresholds() -> dict[str, Any]:
    """Return the thresholds by name, with the version of the software."""
    return {
        "significance level of a gap": assessment.LEVEL,
        "least gain (nats) of a candidate that is pursued": forward_selection.WORTH,
        "least gain (nats) of a candidate that is accepted": forward_selection.ACCEPTED,
        "cost (nats) of each parameter": forward_selection.COST,
        "allowed relative error of the form of an effect": synthetic_likelihood.FORM,
        "exponent of the odds of a candidate in its probability": causes.TEMPER,
        "probability of a cause that closes nothing": verdict.RATES.least,
        "probability of a cause that closes everything": verdict.RATES.most,
        "exponent of the share closed in the probability of a cause": verdict.RATES.steep,
        "exponent of the odds against rivals in the probability of a cause": verdict.RATES.rivals,
        "least probability of an alternative that is reported": causes.ALTERNATIVE,
        "least odds of an effect that is confusable": causes.CONFUSABLE,
        "least share of the gap that a cause closes": causes.LEAST,
        "least share closed for the verdict explained": verdict.EXPLAINED,
        "least share closed for the verdict partly explained": verdict.PARTLY,
        "least probability of the first cause for the verdict explained": diagnosis.EVEN,
        "remaining difference from which something unknown is likely": deviations.UNLIKELY,
        "factor over chance from which a remaining difference is significant": assessment.MORE,
        "replicates of the base model": trial.REPLICATES,
        "replicates of each candidate": unit_state.REPLICATES,
        "software": f"imuarray {imuarray.__version__}",
    }
