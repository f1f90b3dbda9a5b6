"""The score of a validation run: its outcomes are compared with the sealed truth, and every figure has an interval and
a bar.

::

    figures = score_folder("run", hidden={"static": {"scale", "misalignment"}})
    print(format_text(figures))

Random worlds are judged on all their plans, the fixed plans on the full one; the figures of the other plans are cells.
Only lost cases are omitted, and they are listed. The figures of detection and causes exclude effects that a plan cannot
show; these have a separate row.

Each world has its own figures. The loss of a figure from the emulated worlds, on which the diagnosis was developed, to
another world is its transfer gap. It estimates the loss on data from other sources; a comparison of the cases with one
chip or one experiment with all others does the same.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isclose, isfinite
from os import PathLike
from textwrap import wrap
from typing import Any, NamedTuple

from imuarray.json_values import json_value
from imuarray.validation.case import Case
from imuarray.validation.rates import Bin, rate
from imuarray.validation.score_answers import NEVER_BEGUN, Answer, LostCase, ValidationRun, read_run
from imuarray.validation.score_rows import (
    EVERY,
    FULL,
    LARGE,
    NO_BAR,
    Bar,
    Closure,
    Confusion,
    DetectionCurve,
    Hidden,
    Power,
    ScoreRow,
    cause_rows,
    closure_rows,
    closures_of,
    confusion_of,
    curves_of,
    detection_rows,
    group_answers,
    is_in_class,
    make_row,
    power_of,
    probability_rows,
    reliability_of,
    shown_singles,
    time_rows,
)

LEAST_CASES = 5
"""Minimum number of cases of a part for a figure."""


@dataclass(frozen=True)
class TransferRow:
    """A figure and its row in each world, first the world on which the diagnosis was developed."""

    name: str
    rows: Mapping[str, ScoreRow]

    @property
    def lost(self) -> float:
        """The loss in the worst of the other worlds: the decrease of the figure, its increase if the bar is an upper
        bound, or its absolute change if the bar has both bounds.
        """
        home, *others = self.rows.values()
        is_most = home.bar[0] is None and home.bar[1] is not None
        if None not in home.bar:  # a rate that is to be met from both sides
            return max(abs(row.value - home.value) for row in others)
        return max((row.value - home.value) * (1 if is_most else -1) for row in others)


class SplitFigure(NamedTuple):
    """A figure on the cases with a chip or an experiment and on all others; `cases` counts those with it."""

    part: str
    figure: str
    value: float
    others: float
    cases: int


def split_figures(answers: Sequence[Answer], hidden: Hidden) -> tuple[SplitFigure, ...]:
    """Return false alarms, detection and causes with and without each chip and each experiment. For probabilities that
    are fitted without a chip or an experiment see `imuarray.validation.calibration`.
    """
    shown = shown_singles(answers, hidden)
    detected = [answer for answer in shown if answer.is_detected()]
    figures: Mapping[str, tuple[Sequence[Answer], Callable[[Answer], bool]]] = {
        "detection at 5x the limit": (
            [answer for answer in shown if isclose(answer.limits, LARGE)],
            Answer.is_detected,
        ),
        "right cause first": (detected, Answer.is_first_right),
        "right within the reported class": (detected, is_in_class),
        "without a false alarm": (
            [answer for answer in answers if answer.case.kind == "none"],
            lambda answer: not answer.is_false_alarm(),
        ),
    }
    parts = []
    for group in ("chip", "experiment"):
        for part, with_part in group_answers(group, answers).items():
            names = {answer.case.name for answer in with_part}
            for name, (counted, is_hit) in figures.items():
                own = [answer for answer in counted if answer.case.name in names]
                others = [answer for answer in counted if answer.case.name not in names]
                if min(len(own), len(others)) >= LEAST_CASES:
                    share, others_share = (sum(map(is_hit, some)) / len(some) for some in (own, others))
                    parts.append(SplitFigure(f"{group} {part}", name, share, others_share, len(own)))
    return tuple(parts)


WIDTH = 120
NOTHING: Hidden = {}

BARS_ELSEWHERE: Mapping[str, Mapping[str, Bar]] = {
    "foreign": {
        "false alarms": (0.03, 0.08),
        "detection at 2x the limit": (0.75, None),
        "detection at 5x the limit": (0.95, None),
        "right cause first": (0.80, None),
        "right cause first, 5x and above": (0.90, None),
        "right within the reported class": (0.92, None),
        "right sensor and axis": (0.95, None),
        "unknown called unexplained or partly": (0.85, None),
        "unknown against known at 5x, AUROC": (0.85, None),
        "two on different units, both named": (0.60, None),
        "two on one sensor, both named": (0.40, None),
        "closure near the oracle's": (0.85, None),
        "closure's interval covers the oracle's": (0.88, 0.97),
        "closure claimed for a wrong cause": (None, 0.35),
        "calibration error (ECE)": (None, 0.10),
        "Brier score of causes": (None, 0.18),
    },
    "real": {"right cause first, 5x and above": (0.80, None)},
}
"""The bars of the figures in other worlds; figures that are not listed have no bar there."""

TRANSFERRED = tuple(BARS_ELSEWHERE["foreign"])
"""Figures that are compared between worlds."""
HEADLINE = "right cause first"
"""The figure whose transfer gap is printed first."""

MOST_CELLS = 8
"""Maximum number of failing cells that are printed for a row."""


@dataclass(frozen=True)
class Figures:
    """All figures of a run. `plan` is its plan.json, `cases` counts all cases including those `lost`; `full` names the
    plan on which bars are judged.
    """

    plan: Mapping[str, Any]
    full: str
    cases: int
    lost: tuple[LostCase, ...]
    notes: tuple[str, ...]
    rows: tuple[ScoreRow, ...]
    curves: tuple[DetectionCurve, ...]
    power: Power
    confusion: Confusion
    reliability: tuple[Bin, ...]
    closures: tuple[Closure, ...]
    world: str = ""
    elsewhere: Mapping[str, tuple[ScoreRow, ...]] = field(default_factory=dict)
    left_out: tuple[SplitFigure, ...] = ()

    @property
    def worlds(self) -> Mapping[str, tuple[ScoreRow, ...]]:
        """The rows of each world, its own first."""
        return {self.world or "fixed plans": self.rows, **self.elsewhere}

    @property
    def transfers(self) -> tuple[TransferRow, ...]:
        """The `TRANSFERRED` figures that at least two worlds have."""
        tables = {world: {row.name: row for row in rows} for world, rows in self.worlds.items()}
        transfers = [
            TransferRow(name, {world: own[name] for world, own in tables.items() if name in own and own[name].cases})
            for name in TRANSFERRED
        ]
        return tuple(transfer for transfer in transfers if len(transfer.rows) > 1)

    @property
    def half(self) -> str:
        """ "development" or "sealed"."""
        return str(self.plan.get("half", ""))

    @property
    def frozen(self) -> Mapping[str, Any]:
        """The thresholds and the version that were noted before the run."""
        return dict(self.plan.get("frozen") or {})

    @property
    def failed(self) -> tuple[ScoreRow, ...]:
        """The rows that miss their bar."""
        return tuple(row for row in self.rows if row.passes is False)

    def row(self, name: str) -> ScoreRow:
        """Return the row of a name; KeyError if there is none."""
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)


def score_folder(
    folder: str | PathLike[str],
    *,
    hidden: Hidden = NOTHING,
    planned: Iterable[Case] = (),
    full: str = FULL,
    sensors: Collection[str] = (),
    seed: int = 0,
) -> Figures:
    """Read a run's folder and score it. ConfigError if it isn't one."""
    return score(read_run(folder, planned), hidden=hidden, full=full, sensors=sensors, seed=seed)


def score(
    run: ValidationRun, *, hidden: Hidden = NOTHING, full: str = FULL, sensors: Collection[str] = (), seed: int = 0
) -> Figures:
    """Return the figures of a run. `hidden`: by plan, the effects that it cannot show; `sensors`: the sensors that
    mechanisms can affect (default: all that any truth names); other sensors of a cause are ignored; `seed` draws
    intervals and shuffles labels.
    """
    worlds: dict[str, list[Answer]] = {}
    for answer in sorted(run.answers, key=lambda answer: _order(answer.case.world)):
        worlds.setdefault(answer.case.world, []).append(answer)
    world = next(iter(worlds), "")
    answers = worlds.get(world, [])
    full = EVERY if world else full

    def rows_of(own: Sequence[Answer]) -> tuple[ScoreRow, ...]:
        return (
            *detection_rows(own, hidden, full),
            *cause_rows(own, hidden, full, sensors, seed),
            *closure_rows(own, full, seed),
            *probability_rows(own, full, seed),
            *time_rows(own, full, seed),
        )

    elsewhere = {name: _set_bars(rows_of(own), name) for name, own in worlds.items() if name != world}
    rows = _set_bars(rows_of(answers), world) if world in BARS_ELSEWHERE else rows_of(answers)
    return Figures(
        run.plan,
        full,
        len(run.answers) + len(run.lost),
        run.lost,
        run.notes,
        (*rows, _lost_row(run)),
        curves_of(answers, hidden),
        power_of(answers, full),
        confusion_of(answers, full),
        reliability_of(answers, full),
        closures_of(answers, full),
        world,
        elsewhere,
        split_figures(answers, hidden) if world else (),
    )


def _order(world: str) -> tuple[int, str]:
    """Return the sort key of a world: the emulator's worlds, the fixed plans, then the others by name."""
    return {"emulator": 0, "": 1}.get(world, 2), world


def _set_bars(rows: Iterable[ScoreRow], world: str) -> tuple[ScoreRow, ...]:
    """Return the rows, and their cells, with the bars of another world."""
    bars = BARS_ELSEWHERE.get(world, {})
    barred = []
    for row in rows:
        bar = bars.get(row.name, NO_BAR)
        cells = tuple(cell if cell.bar == NO_BAR else replace(cell, bar=bar) for cell in row.cells)
        barred.append(replace(row, bar=bar, cells=cells))
    return tuple(barred)


def as_json(figures: Figures) -> dict[str, Any]:
    """Return the figures as one JSON object; numbers that are not finite are null."""
    power, confusion = figures.power, figures.confusion
    table = {
        "half": figures.half,
        "plan": dict(figures.plan),
        "full": figures.full,
        "cases": figures.cases,
        "lost": [vars(item) for item in figures.lost],
        "notes": list(figures.notes),
        "figures": [row.as_json() for row in figures.rows],
        "curves": [
            {
                "plan": item.plan,
                "points": [{"limits": limits, **estimate._asdict()} for limits, estimate in item.points],
            }
            for item in figures.curves
        ],
        "power": {**power._asdict(), "about": "detected and all cases, by mechanism and severity"},
        "confusion": {**confusion._asdict(), "about": "first reported cause, by active mechanism"},
        "reliability": [item._asdict() for item in figures.reliability],
        "closures": [item._asdict() for item in figures.closures],
        "world": figures.world,
        "elsewhere": {world: [row.as_json() for row in rows] for world, rows in figures.elsewhere.items()},
        "transfer": [
            {"name": item.name, **{world: row.value for world, row in item.rows.items()}, "lost": item.lost}
            for item in figures.transfers
        ],
        "left_out": [item._asdict() for item in figures.left_out],
    }
    return {name: json_value(value) for name, value in table.items()}


def format_text(figures: Figures) -> str:
    """Format the figures for the terminal, at most 120 columns: every row with its mark, the cells that miss a bar, and
    the lost cases.
    """
    heading = f"{figures.half or 'validation'} half: {figures.cases} cases, {len(figures.lost)} lost"
    lines = [heading, "", _format_line("", "figure", "value", "95 %", "cases", "bar")]
    shown = shown_rows(figures)
    lines += [_format_line(row.mark, row.name, *format_row(row)) for row in shown]
    if len(shown) < len(figures.rows):
        lines += ["", f"{len(figures.rows) - len(shown)} figures have no cases: a longer run is needed to judge any."]
    for world, rows in figures.elsewhere.items():
        filled = [row for row in rows if row.cases]
        lines += ["", f"world: {world}", *(_format_line(row.mark, row.name, *format_row(row)) for row in filled)]
    lines += ["", *(transfer_line(transfer) for transfer in figures.transfers)] if figures.transfers else []
    for row in figures.failed:
        lines += ["", *wrap(f"{row.name}: {row.about}", WIDTH), *_failing(row)]
    lines += (
        ["", *(f"lost: {count} of {name}" for name, count in lost_by(figures.lost).items())] if figures.lost else []
    )
    lines += ["", *(line for note in figures.notes for line in wrap(note, WIDTH))] if figures.notes else []
    return "\n".join(line.rstrip()[:WIDTH] for line in lines) + "\n"


def shown_rows(figures: Figures) -> tuple[ScoreRow, ...]:
    """Return the rows of a table: all of them, or only those with cases if no figure with a bar has cases."""
    judged = any(row.passes is not None for row in figures.rows)
    return figures.rows if judged else tuple(row for row in figures.rows if row.cases)


def transfer_line(transfer: TransferRow) -> str:
    """Return a line with a figure in each world, and the loss from the first to the worst."""
    values = ", ".join(f"{world} {decimal(row.value)} ({row.cases})" for world, row in transfer.rows.items())
    return f"transfer gap of {transfer.name}: {decimal(transfer.lost)} ({values})"


def format_row(row: ScoreRow) -> tuple[str, str, str, str]:
    """Return value, interval, cases and bar as text."""
    low, high = row.bar
    if row.bar == NO_BAR:
        bar = ""
    elif low is None or high is None:
        bar = f"at most {high:.3g}" if low is None else f"at least {low:.3g}"
    else:
        bar = f"{low:.3g} to {high:.3g}"
    interval = f"{decimal(row.low)} to {decimal(row.high)}" if isfinite(row.low) else "–"
    return decimal(row.value), interval, str(row.cases), bar


def decimal(value: float) -> str:
    """Format with three decimals, one from 10 on; "–" if not finite."""
    return "–" if not isfinite(value) else f"{value:.3f}" if abs(value) < 10 else f"{value:.1f}"


def lost_by(lost: Iterable[LostCase]) -> Mapping[str, int]:
    """Count the lost cases by kind, plan and reason; those that were never begun together."""
    counts: dict[str, int] = {}
    for case in lost:
        name = case.why if case.why == NEVER_BEGUN else f"{case.kind}, plan {case.plan}, {case.why}"
        counts[name] = counts.get(name, 0) + 1
    return counts


def _failing(row: ScoreRow) -> Iterator[str]:
    failed = row.failing()
    for cell in failed[:MOST_CELLS]:
        value, interval, cases, _ = format_row(cell)
        yield f"      {cell.group} {cell.name}: {value} ({interval}) of {cases}"
    if len(failed) > MOST_CELLS:
        yield f"      and {len(failed) - MOST_CELLS} more"


def _format_line(mark: str, name: str, value: str, interval: str, cases: str, bar: str) -> str:
    return f"{mark:<5}{name:<48.48}{value:>8}  {interval:>16}{cases:>8}  {bar}"


def _lost_row(run: ValidationRun) -> ScoreRow:
    share = rate(len(run.lost), len(run.answers) + len(run.lost))
    return make_row("cases lost", share, NO_BAR, "no outcome, or one with an error; not included in other figures")
