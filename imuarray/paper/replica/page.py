"""A replica as a page of at most 100 columns."""

from __future__ import annotations

from collections.abc import Iterator

from imuarray.paper.replica.statistic import Replica, Statistic, Summary

_LISTED = 3.0
_WIDTH = 100


def render_text(replica: Replica) -> str:
    """What was compared, table by table, all together, and every statistic more than three uncertainties off."""
    return "\n".join((*_tables(replica), "", *_together(replica), "", *_beyond(replica))) + "\n"


def _tables(replica: Replica) -> Iterator[str]:
    yield f"The paper's experiments on the simulated array, seed {replica.seed}"
    yield f"  {'':<14}{'statistics':>10}{'within 1':>10}{'2':>7}{'3':>7}   uncertainties"
    for name in replica.tables:
        rows = replica.of(name)
        found = [sum(abs(row.z) <= limit for row in rows) for limit in (1, 2, 3)]
        yield f"  {name:<14}{len(rows):>10}{found[0]:>10}{found[1]:>7}{found[2]:>7}"


def _together(replica: Replica) -> Iterator[str]:
    whole = replica.summary
    one, two, three = (f"{count} ({100 * count / whole.count:.1f} %)" for count in whole.within)
    yield f"Together: {whole.count} statistics, within 1: {one}, within 2: {two}, within 3: {three}"
    yield "Chi-square per degree (statistics that don't follow from others; 95 % of true models)"
    yield _chi_square("all", whole)
    for name, found in replica.kinds.items():
        yield _chi_square(name, found)


def _chi_square(name: str, found: Summary) -> str:
    low, high = found.expected
    return (
        f"  {name:<13}{found.chi_square:>7.2f} over {found.independent:>4} of them; expected {low:.2f} to {high:.2f}"
        f" ({found.degrees:.0f} degrees)"
    )


def _beyond(replica: Replica) -> Iterator[str]:
    rows = replica.beyond(_LISTED)
    yield f"More than {_LISTED:g} uncertainties off: {len(rows)} (published -> simulated; most of the uncertainty)"
    yield from map(_line, rows)


def _line(row: Statistic) -> str:
    values = f"{row.published:>9.4g} -> {row.simulated:<9.4g}"
    cause = row.origin.partition(",")[0]
    return f"  {row.table:<9}{row.channel:<15}{row.statistic:<20}{values} z {row.z:+.1f}; {cause}"[:_WIDTH]
