"""Gain of fusion: the error of every technique on simulated experiments of the paper's array, compared with the simple
average and with the Cramer-Rao bound of the true model (the future work of the paper's section 8).
"""

from imuarray.studies.fusion_gain.cramer_rao import (
    OUTSIDE,
    Bound,
    BoundStretch,
    ErrorLaw,
    Posterior,
    SlowError,
    StretchReadings,
    bound,
    law_of,
    true_calibration,
)
from imuarray.studies.fusion_gain.gain_study import (
    EXPERIMENTS,
    QUICK_S,
    QUICK_SEEDS,
    SEEDS,
    GainRow,
    RunErrors,
    Study,
    render_text,
    run,
    study,
)

__all__ = [
    "EXPERIMENTS",
    "OUTSIDE",
    "QUICK_S",
    "QUICK_SEEDS",
    "SEEDS",
    "Bound",
    "BoundStretch",
    "ErrorLaw",
    "GainRow",
    "Posterior",
    "RunErrors",
    "SlowError",
    "StretchReadings",
    "Study",
    "bound",
    "law_of",
    "render_text",
    "run",
    "study",
    "true_calibration",
]
