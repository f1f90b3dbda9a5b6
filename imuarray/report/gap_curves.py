"""The curves of a gap's page: the recording over simulations before and after, the most telling ones first."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

from imuarray.gap.findings.diagnosis import Overlay
from imuarray.gap.findings.text import number, share
from imuarray.report.gap_figures import farthest, outside, overlay_figure
from imuarray.report.gap_sheet import SmallFigure
from imuarray.report.gap_tables import overlays_table
from imuarray.report.page import Figure, Section

MOST_OVERLAYS = 12
"""Curves that are drawn; the rest are counted."""

_KINDS = MappingProxyType(
    {
        "spectrum": "Spectrum: a peak that only the recording has is a line; a bend is a filter.",
        "alla"
        "n": "Allan deviation: white noise falls with the square root; a floor is flicker noise; a rise is a drift.",
        "temperature": "Temperature: a slope is a thermal bias; a loop or a delayed curve is a lag.",
        "codes": "Codes: combs and gaps are coarse or missing codes; a pile at an end is saturation.",
    }
)
"""What to look for, by kind of overlay, in the order in which they are drawn."""


def curves_section(overlays: Sequence[Overlay], *, drawn: bool) -> Section:
    """The `MOST_OVERLAYS` that lay farthest outside before, by kind; a table where nothing can be `drawn`."""
    title = "Curves: real, before and after"
    if not overlays:
        return Section(title, "The diagnosis stored no curves. `gap diagnose -o DIR` draws them in DIR/report.html.")
    worst = sorted(overlays, key=lambda overlay: -farthest(overlay, overlay.before)[1])
    chosen = sorted(worst[:MOST_OVERLAYS], key=lambda overlay: list(_KINDS).index(overlay.kind))
    words = " ".join(text for kind, text in _KINDS.items() if any(overlay.kind == kind for overlay in chosen))
    words = (
        f"The black curve is the recording. The bands hold 95 % of the simulations, orange before, blue after. {words}"
    )
    if not drawn:
        return Section(title, words, [overlays_table(overlays)])
    if len(overlays) > len(chosen):
        words += f" The {len(chosen)} that lay farthest outside before, of {len(overlays)}."
    return Section(title, words, [_overlay(overlay) for overlay in chosen])


def _overlay(overlay: Overlay) -> Figure:
    place = f"{overlay.sensor} {overlay.axis}".rstrip() + (f", {overlay.phase}" if overlay.phase else "")
    before, after = (share(outside(overlay, bands)) for bands in (overlay.before, overlay.after))
    at, distance = farthest(overlay, overlay.before)
    name, _, unit = overlay.x_label.partition(" (")
    most = f", farthest at {name} {number(at)} {unit.removesuffix(')')}".rstrip() if distance else ""
    caption = f"{place}, {overlay.kind}: {before} of the curve outside the band before{most}; {after} after."
    alternative = f"{overlay.y_label} over {overlay.x_label}. {caption}"
    return SmallFigure(overlay_figure(overlay), caption, alternative)
