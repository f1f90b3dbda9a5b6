"""Tables of the gap page, and the meaning of each effect in a few words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from imuarray.errors import MissingExtraError
from imuarray.gap.findings.diagnosis import (
    CandidateEvaluation,
    Cause,
    Diagnosis,
    Gap,
    Map,
    Overlay,
    Pull,
    Unobservable,
    Where,
)
from imuarray.gap.findings.text import (
    NOT_ACCEPTED,
    NOTHING,
    chance,
    closed_text,
    number,
    parameters_text,
    places_text,
    scored,
    share,
)
from imuarray.gap.model.use import IntervalEstimate, Use
from imuarray.printable import duration
from imuarray.report.gap_figures import outside
from imuarray.report.page import Table

MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "clock_error": "the clock of the log is off by a ratio that is constant or settles",
        "own_clock": "the chip samples by its own clock and answers a poll with its latest reading",
        "skew": "readings are older than their time stamps",
        "jitter": "time stamps of readings scatter",
        "dropped_samples": "readings are lost, alone or in bursts",
        "size_effect": "a sensor away from the origin of the box senses the rotation of the box as specific force",
        "thermal_lag": "the sensing element warms up later than the box",
        "axis_error": "the axes of the sensor differ from the configuration",
        "misalignment": "the axes of the sensor are misaligned",
        "nonlinearity": "the response is slightly nonlinear",
        "scale": "the scale factor differs from the data sheet",
        "thermal_scale": "the scale factor depends on the temperature of the sensing element",
        "g_sensitivity": "specific force changes the reading of a sensor of another quantity",
        "bias": "the reading differs from zero at zero input",
        "turn_on_bias": "the bias changes each time the sensor is switched on",
        "bistable_bias": "after some boots the bias is different",
        "thermal_bias": "the bias depends on the temperature of the sensing element",
        "bias_instability": "the bias wanders within bounds",
        "random_walk": "the bias wanders without bounds",
        "popcorn_noise": "the bias jumps between two levels",
        "common_mode": "all units of one design wander together",
        "tone": "a sine wave in the signal",
        "white_noise": "every reading has an independent, normally distributed error",
        "bandwidth": "each reading depends on the previous ones",
        "adaptive_range": "the reading is frozen for a moment when the rate passes a threshold",
        "odr_error": "the chip runs at another data rate, or with another filter, than configured",
        "range_reset": "the chip measures in another range than configured",
        "quantisation": "codes come in steps larger than one",
        "saturation": "the signal saturates before the codes do",
        "thermometer": "the thermometer of the chip has an error",
        "stale_samples": "a reading repeats the previous one",
        "glitches": "single readings are corrupted",
        "stuck": "the counts are frozen for a while",
        "channel_swap": "the sensor delivers the data of another sensor, or is mounted in its place",
    }
)
"""Keyed by the effects' names in models and in JSON."""


MOST_ROWS = 40
"""Most rows of a table."""

PLACEBO = "placebo"


def map_table(shown: Map) -> Table:
    """Return the scores before and after by sensor and domain; those above the limit after are marked."""
    rows = [
        [sensor, *(_pair(*cell, shown.limit) for cell in zip(before, after, strict=True))]
        for sensor, before, after in zip(shown.sensors, shown.before.tolist(), shown.after.tolist(), strict=True)
    ]
    heading = ["sensor", *(domain.replace("_", " ") for domain in shown.domains)]
    caption = f"Before → after; marked if above the limit of {number(shown.limit, 2)} after; –: no statistic."
    return Table(heading, rows, caption)


def causes_table(causes: Sequence[Cause]) -> Table:
    """Return a row for each cause, in their order, the most probable first."""
    heading = ["effect", "probability", "where", "parameters", "closes", "may also be", "origin"]
    rows = [
        [
            _explained(cause.effect, f"{cause.action}: {MEANINGS.get(cause.effect, 'not in the library')}"),
            share(cause.probability),
            places_text(cause),
            _parameters(cause),
            closed_text(cause.closed, cause.closed_ci95),
            ", ".join(cause.confusable_with) or NOTHING,
            _origin(cause),
        ]
        for cause in causes
    ]
    return Table(heading, rows, "Most probable first.", (2, 3, 5, 6))


def _origin(cause: Cause) -> str:
    if not cause.is_accepted:
        return NOT_ACCEPTED
    return f"{cause.origin}, detected on both parts together" if cause.needs_both else cause.origin


def each_table(causes: Sequence[Cause]) -> Table | None:
    """Return the parameters by sensor of causes for which they differ; None without such a cause."""
    rows = [
        [sensor, cause.effect, parameters_text(parameters) or NOTHING]
        for cause in causes
        if _differs(cause)
        for sensor, parameters in cause.each.items()
    ]
    caption = "Parameters that differ from sensor to sensor."
    return Table(["sensor", "effect", "parameters"], rows, caption, (1, 2)) if rows else None


def shrink_table(gap: Gap) -> Table:
    """Return the scores before and after and the share that closed, of all statistics and by domain."""
    rows = [["all", scored(gap.before), scored(gap.after), closed_text(gap.closed, gap.closed_ci95)]]
    for domain, (before, after, closed) in gap.domains.items():
        rows.append([domain.replace("_", " "), scored(before), scored(after), share(closed)])
    caption = f"Rms score; {number(gap.floor)} without a gap."
    return Table(["domain", "before", "after", "closed"], rows, caption)


def uses_table(uses: Sequence[Use]) -> Table:
    """Return the figures in units of use with their intervals; a simulated one is marked if its interval does not
    overlap that of the recording.
    """
    rows = [
        [
            use.name,
            use.sensor or "array",
            use.unit,
            _interval(use.real),
            _against(use.before, use.real),
            _against(use.after, use.real),
        ]
        for use in uses
    ]
    heading = ["figure", "of", "unit", "recorded", "simulated before", "simulated after"]
    caption = "With 95 % intervals; marked where the interval does not overlap that of the recording."
    return Table(heading, rows, caption, (1, 2))


def where_table(where: Sequence[Where], caption: str) -> Table:
    """Return the first `MOST_ROWS` statistics, in their order, the worst first."""
    heading = ["sensor", "domain", "statistic", "recorded in", "real", "simulated", "score", "p", "size"]
    rows = [
        [
            f"{place.sensor} {place.axis}".rstrip(),
            place.domain.replace("_", " "),
            f"{place.about} ({place.unit.replace('degC', '°C')})" if place.unit else place.about,
            ", ".join(part for part in (place.log, place.phase) if part) or "all",
            number(place.real),
            number(place.simulated),
            f"{'-' if place.significance < 0 else '+'}{scored(abs(place.significance))}",
            chance(place.p).removeprefix("p ").removeprefix("= "),
            f"{number(place.effect_size, 2)}, {place.size}",
        ]
        for place in where[:MOST_ROWS]
    ]
    return Table(heading, rows, caption, (1, 2, 3))


def unshown_table(unshown: Sequence[Unobservable]) -> Table:
    """Return the effects that the recordings cannot show, for which sensors, and what to record."""
    rows = [[hidden.effect, ", ".join(hidden.sensors) or "all", hidden.record] for hidden in unshown]
    return Table(["effect", "sensors", "record"], rows, "Effects that these recordings cannot show.", (1, 2))


def pulls_table(pulls: Sequence[Pull]) -> Table:
    """Return the `MOST_ROWS` quantities with the largest pulls, those without a tolerance last; pulls out of tolerance
    are marked.
    """
    rows = [
        [
            f"{pull.sensor} {pull.axis}".rstrip(),
            pull.quantity,
            number(pull.value),
            number(pull.tolerance),
            pull.unit,
            _pull(pull),
            pull.source,
        ]
        for pull in sorted(pulls, key=lambda pull: -abs(np.nan_to_num(pull.pull)))[:MOST_ROWS]
    ]
    heading = ["sensor", "quantity", "value", "tolerance", "unit", "pull", "source"]
    caption = (
        "Worst first. The pull is the deviation from the nominal value in units of the tolerance; marked above one."
    )
    return Table(heading, rows, caption, (1, 4, 6))


def _pull(pull: Pull) -> str:
    if not np.isfinite(pull.pull):
        return number(pull.pull)
    return marked(f"{pull.pull:+.2f}") if pull.is_out_of_specification else f"{pull.pull:+.2f}"


def missing_table(missing: Sequence[str]) -> Table:
    """Return a row for each statistic that could not be compared, with what it lacks."""
    return Table(
        ["", "missing"],
        [[str(place), phrase] for place, phrase in enumerate(missing, 1)],
        "Statistics that could not be compared.",
        (1,),
    )


def judged_table(judged: Sequence[CandidateEvaluation]) -> Table:
    """Return the candidates, accepted ones first, then by gain; placebos are marked."""
    ranked = sorted(
        judged,
        key=lambda candidate: (not candidate.is_accepted, -(candidate.gain if candidate.gain is not None else -1e300)),
    )
    rows = [
        [
            candidate.effect or marked(PLACEBO),
            candidate.action,
            ", ".join(candidate.sensors) or "all",
            number(candidate.fits, 2),
            NOTHING if candidate.gain is None else f"{candidate.gain:+.1f}",
            "yes" if candidate.is_accepted else "no",
        ]
        for candidate in ranked[:MOST_ROWS]
    ]
    caption = "Fits: how well it explains what the training part shows. Gain: how much likelier it makes held-out data."
    return Table(["effect", "action", "sensors", "fits", "gain (nats)", "accepted"], rows, caption, (1, 2, 5))


def overlays_table(overlays: Sequence[Overlay]) -> Table:
    """Return the share of each curve that lies outside the bands of the simulations, before and after."""
    rows = [
        [
            f"{overlay.sensor} {overlay.axis}".rstrip(),
            overlay.kind,
            overlay.phase or "all",
            share(outside(overlay, overlay.before)),
            share(outside(overlay, overlay.after)),
        ]
        for overlay in overlays
    ]
    caption = "Share of each curve outside the 95 % band of the simulations; about 5 % by chance."
    return Table(["sensor", "curve", "phase", "before", "after"], rows, caption, (1, 2))


def recorded_table(diagnosis: Diagnosis) -> Table:
    """Return the logs that were diagnosed."""
    rows = [
        [
            recording.name,
            recording.kind,
            duration(recording.seconds),
            str(recording.sensors),
            str(recording.phases),
            f"{recording.rows:,}".replace(",", " "),
        ]
        for recording in diagnosis.recorded
    ]
    return Table(
        ["log", "experiment", "duration", "sensors", "phases", "rows"], rows, "The diagnosed recordings.", (1,)
    )


def origin_table(diagnosis: Diagnosis) -> Table:
    """Return the inputs from which this page can be reproduced."""
    rows = [
        ["model", diagnosis.model],
        ["seed", str(diagnosis.seed)],
        ["replicates", str(diagnosis.replicates)],
        ["software", diagnosis.software],
    ]
    return Table(["", "value"], rows, "With the same recordings, these reproduce this page.", (1,))


def notes_table(notes: Sequence[str]) -> Table:
    """Return the remarks of the diagnosis."""
    return Table(
        ["", "note"], [[str(place), note] for place, note in enumerate(notes, 1)], "Remarks of the diagnosis.", (1,)
    )


def marked(text: str) -> str:
    """Return escaped text that the page highlights; MissingExtraError without jinja2's escaping."""
    return _markup("<mark>{}</mark>", text)


def _markup(pattern: str, *texts: str) -> str:
    try:
        from markupsafe import Markup
    except ImportError:
        raise MissingExtraError("jinja2", "report") from None
    return Markup(pattern).format(*texts)  # noqa: S704, the patterns are those above, and texts are escaped


def _pair(before: float, after: float, limit: float) -> str:
    texts = [scored(before), scored(after)]
    if texts == [NOTHING, NOTHING]:
        return NOTHING
    joined = texts[0] if before == after else " → ".join(texts)
    return marked(joined) if after > limit else joined


def _explained(name: str, more: str) -> str:
    """Return an escaped name with its meaning in small type below it; MissingExtraError without jinja2's escaping."""
    return _markup('{}<br><small style="font-weight: normal">{}</small>', name, more)


def _parameters(cause: Cause) -> str:
    text = parameters_text(cause.parameters) or NOTHING
    return f"{text} ({next(iter(cause.each))}; others below)" if _differs(cause) else text


def _differs(cause: Cause) -> bool:
    several = list(cause.each.values())
    return any(item != several[0] for item in several)


def _interval(figure: IntervalEstimate) -> str:
    return f"{number(figure.value)} ({number(figure.low)} to {number(figure.high)})"


def _against(simulated: IntervalEstimate, real: IntervalEstimate) -> str:
    text = _interval(simulated)
    return marked(text) if simulated.low > real.high or simulated.high < real.low else text
