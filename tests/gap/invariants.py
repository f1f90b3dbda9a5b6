"""Consistency of the parts of every diagnosis, checked on its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

LEAST_CLOSED, PARTLY_CLOSED, EVEN = 0.95, 0.3, 0.5
"""As README.md has them."""

ROUNDING = 1e-12


def check_agreement(found: Mapping[str, Any]) -> None:
    """Check that verdict, closure, probabilities, sentence and unexplained part are consistent."""
    verdict, gap, causes, unknown = (found[key] for key in ("verdict", "gap", "causes", "unknown"))
    chances = [cause["probability"] for cause in causes]
    assert verdict in ("no gap", "explained", "partly explained", "unexplained")
    assert 0 <= unknown <= 1
    assert all(0 <= chance <= 1 - unknown + ROUNDING for chance in chances)
    assert chances == sorted(chances, reverse=True)
    assert gap["closed"] is None or gap["closed"] <= 1
    assert gap["closed"] is not None or gap["closed_ci95"] is None
    assert ("something outside the library" in found["sentence"]) == (verdict == "unexplained")
    if verdict == "no gap":
        assert (gap["closed"], causes, unknown, found["unexplained"]) == (None, [], 0, [])
        assert gap["before"] == gap["after"]
    elif verdict == "explained":
        assert gap["closed"] >= LEAST_CLOSED
        assert chances[0] >= EVEN > unknown
    elif verdict == "partly explained":
        assert unknown <= EVEN
        assert gap["closed"] is None or gap["closed"] >= PARTLY_CLOSED
        assert chances if gap["closed"] is not None else chances[0] >= EVEN
    else:
        assert unknown >= EVEN
        assert max(chances, default=0.0) <= EVEN
