"""Every page of the reference has its picture, and each picture shows a difference."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from imuarray.fuse.fusion import NAMES
from imuarray.gap.statistics.probes import Domain
from imuarray.simulate import EFFECTS

PICTURES = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "reference_pictures.py"))


def test_every_effect_domain_and_technique_has_a_picture() -> None:
    entries = {"EXAMPLES": set(EFFECTS), "PROBE_EXAMPLES": set(get_args(Domain)), "TECHNIQUE_EXAMPLES": set(NAMES)}
    for table, names in entries.items():
        assert names - set(PICTURES[table]) == set(), f"no line in docs/reference_pictures.py: {table}"
        assert names == set(PICTURES[table])


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_changes_its_picture(name: str) -> None:
    """A picture in which both curves are the same shows nothing."""
    example, pair = PICTURES["EXAMPLES"][name], PICTURES["_pair"](name)
    shown = [
        values[(time_s >= example.span_s[0]) & (time_s <= example.span_s[1])]
        for time_s, values in (pair.without, pair.within)
    ]
    assert len(shown[0]) > 20
    assert not np.array_equal(*shown)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("draw", "name"),
    [("picture", "skew"), ("probe_picture", "allan"), ("chip_picture", "bmp280"), ("technique_picture", "opposed")],
)
def test_pictures_are_small_svg(draw: str, name: str) -> None:
    drawn = PICTURES[draw](name)
    assert drawn.startswith(b"<?xml") and len(drawn) < 150_000
