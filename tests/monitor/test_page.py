"""The page's colours have the required contrast to their background (WCAG 2.2, 1.4.3 and 1.4.11, AA)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import imuarray.monitor
from imuarray.monitor.log_monitor import COLOURS, THEMES

CSS = (Path(imuarray.monitor.__file__).parent / "page.css").read_text()
TEXT = ("text", "soft", "x", "y", "z", "good", "warn", "bad")


def variables(theme: str) -> dict[str, str]:
    light, dark = re.findall(r":root \{(.*?)\}", CSS, re.DOTALL)
    return dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", dark if theme == "dark" else light))


def luminance(colour: str) -> float:
    """Relative luminance of sRGB (WCAG 2.2, definitions)."""
    shares = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, other: str) -> float:
    dark, light = sorted((luminance(first), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_the_contrast_formula_gives_known_values() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)  # the grey that just misses


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_and_curves_have_the_required_contrast(theme: str) -> None:
    colours = variables(theme)
    for name in TEXT:
        for behind in ("back", "card"):
            assert contrast(colours[name], colours[behind]) >= 4.5, (name, behind)
    assert contrast(THEMES[theme].text, colours["card"]) >= 4.5
    assert contrast(colours["focus"], colours["back"]) >= 3
    for name, curve in zip("xyz", COLOURS[theme], strict=True):
        assert contrast(curve, colours["card"]) >= 3
        assert curve.lower() == colours[name]  # its letter has the same colour
