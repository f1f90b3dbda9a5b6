"""Drawings have a light and a dark version that differ in lightness and keep hue and contrast."""

from __future__ import annotations

import re

import pytest

from imuarray.report.page import INK, PAPER, follow_scheme, on_dark

SVG = '<svg width="1"><path style="fill: #ffffff; stroke: #0072b2; opacity: 0.5"/><a href="#000000"/></svg>'


def luminance(colour: str) -> float:
    """Relative luminance as WCAG 2.2 defines it."""
    parts = [int(colour[first : first + 2], 16) / 255 for first in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, other: str) -> float:
    low, high = sorted((luminance(first), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_white_becomes_the_page_and_black_the_ink() -> None:
    assert on_dark("#ffffff") == PAPER
    assert contrast(on_dark("#000000"), INK) < 1.05


def test_lightness_is_inverted() -> None:
    greys = [on_dark(f"#{level:02x}{level:02x}{level:02x}") for level in range(0, 256, 15)]
    assert [luminance(grey) for grey in greys] == sorted(map(luminance, greys), reverse=True)


@pytest.mark.parametrize("colour", ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#7f7f7f"])
def test_curves_are_as_distinct_on_dark_as_on_white(colour: str) -> None:
    """Okabe and Ito's colours: 3:1 is what WCAG 2.2 asks of graphics (1.4.11), where white allows as much."""
    assert contrast(on_dark(colour), PAPER) > min(3.0, contrast(colour, "#ffffff"))


def test_hue_is_kept() -> None:
    red, green, blue = (on_dark(colour) for colour in ("#cc0000", "#00aa00", "#0000cc"))
    for colour, strongest in ((red, 1), (green, 3), (blue, 5)):
        parts = {first: int(colour[first : first + 2], 16) for first in (1, 3, 5)}
        assert max(parts, key=lambda first: parts[first]) == strongest


def test_only_colours_of_styles_become_variables() -> None:
    drawing = follow_scheme(SVG)
    assert 'style="fill: var(--ffffff); stroke: var(--0072b2); opacity: 0.5"' in drawing
    assert 'href="#000000"' in drawing
    light, dark = re.findall(r"svg\{([^}]*)\}", drawing)
    assert "--ffffff:#ffffff" in light and f"--ffffff:{PAPER}" in dark
    assert "@media screen and (prefers-color-scheme:dark)" in drawing  # not on paper
    assert drawing.startswith('<svg width="1"><style>')
