"""What fusion gains: every technique on simulated experiments of the paper's array, over the simple average and over
the Cramer-Rao bound of the true model (the future work of the paper's section 8).
"""

from imuarray.study.bound import Bound, ErrorLaw, Seen, SlowError, Stretch, bound
from imuarray.study.posterior import Posterior
from imuarray.study.runs import EXPERIMENTS, Measured, run
from imuarray.study.study import QUICK_S, QUICK_SEEDS, SEEDS, Row, Study, study
from imuarray.study.text import render_text
from imuarray.study.truth import OUTSIDE, law_of, true_calibration

__all__ = [
    "EXPERIMENTS",
    "OUTSIDE",
    "QUICK_S",
    "QUICK_SEEDS",
    "SEEDS",
    "Bound",
    "ErrorLaw",
    "Measured",
    "Posterior",
    "Row",
    "Seen",
    "SlowError",
    "Stretch",
    "Study",
    "bound",
    "law_of",
    "render_text",
    "run",
    "study",
    "true_calibration",
]
