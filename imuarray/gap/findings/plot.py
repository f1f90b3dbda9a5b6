"""A figure of a diagnosis: the statistics that differ most, and the causes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imuarray.figures import PALETTE, new_figure
from imuarray.gap.findings.text import listed_causes, own_closure, share

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imuarray.gap.findings.diagnosis import Diagnosis

_MOST = 12


def diagnosis_figure(diagnosis: Diagnosis) -> Figure:
    """Return a figure of the worst statistics by their significance, and of each listed cause by the share of the gap
    that it would close, with its 95 % interval and its probability. Raises MissingExtraError without matplotlib.
    """
    rows = max(min(_MOST, len(diagnosis.where)), len(listed_causes(diagnosis.causes)), 3)
    figure = new_figure(10.0, 1.6 + 0.3 * rows)
    worst, causes = figure.subplots(1, 2)
    _draw_worst(worst, diagnosis)
    _draw_causes(causes, diagnosis)
    sentence = diagnosis.verdict if len(diagnosis.sentence) > 150 else diagnosis.sentence
    figure.suptitle(sentence.replace("$", r"\$"), fontsize=10, x=0.01, ha="left", wrap=True)
    return figure


def _draw_worst(panel: Axes, diagnosis: Diagnosis) -> None:
    """Draw the statistics that differ most."""
    worst = diagnosis.where[:_MOST]
    labels = [f"{entry.sensor} {entry.axis} {entry.statistic}".replace("  ", " ") for entry in worst]
    panel.barh(np.arange(len(worst)), [abs(entry.significance) for entry in worst], color=PALETTE[2], height=0.6)
    panel.set_yticks(range(len(worst)), labels, fontsize=8)
    panel.invert_yaxis()
    panel.set_xlabel("difference, standard deviations of chance")
    panel.set_title("where" if worst else "nothing differs by more than chance", loc="left", fontsize=9.5)


def _draw_causes(panel: Axes, diagnosis: Diagnosis) -> None:
    """Draw the listed causes, the most probable first."""
    causes = listed_causes(diagnosis.causes)
    for row, cause in enumerate(causes):
        closed, interval = own_closure(cause, diagnosis)
        if closed is None:
            continue
        panel.plot(interval or (closed, closed), [row, row], color=PALETTE[0], linewidth=1.2)
        panel.plot(closed, row, "o", color=PALETTE[1], markersize=5)
    labels = [f"{cause.effect} ({share(cause.probability)})" for cause in causes]
    panel.set_yticks(range(len(labels)), labels, fontsize=8)
    panel.set_ylim(max(len(labels), 1) - 0.5, -0.5)
    panel.set_xlim(-0.05, 1.05)
    panel.set_xlabel("share that would close if it were the cause (95 %)")
    panel.set_title("causes (probability)" if labels else "no cause", loc="left", fontsize=9.5)
