"""Tests that run with the emulated firmware and with the firmware's core in its place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

KINDS = ("emulated", "core")


def both_kinds(*core_marks: pytest.MarkDecorator) -> Callable[[Any], Any]:
    """Return the decorator of a test that runs with both kinds of firmware, with the core under these marks."""
    cases = [KINDS[0], pytest.param(KINDS[1], marks=core_marks)]

    def decorate(test: Any) -> Any:
        return pytest.mark.usefixtures("firmware_kind")(
            pytest.mark.parametrize("firmware_kind", cases, indirect=True)(test)
        )

    return decorate
