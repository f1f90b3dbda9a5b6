"""A page in a real browser: nothing sticks out on a phone, no script fails, and figures follow dark mode."""

from __future__ import annotations

import asyncio
import base64
import io
from pathlib import Path

import numpy as np
import pytest

from imuarray.report import Figure, Section, Table, Verdict, write_page
from imuarray.report.fused_page import time_figure
from tests.monitor.chromium import CHROMIUM, Browser, browser

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")]

IMAGE = "document.querySelector('img')"


def written(path: Path) -> str:
    """The address of a page with a wide table, a figure and a fold."""
    time = np.linspace(0, 10, 50)
    drawing = time_figure(time, np.stack([np.sin(time)] * 3, axis=1), "rate (dps)")
    wide = Table([f"column {number}" for number in range(12)], [["123.456"] * 12], "A caption that is long. " * 8)
    sections = [Section("Figure", "Text.", [Figure(drawing, "caption", "a course")]), Section("S", "", [wide])]
    sections.append(Section("Folded", "Text.", [wide], fold="One row"))
    write_page(path, "Title", ["line"], sections, verdict=Verdict("Good.", "good", [("1", "of what")] * 5))
    return path.resolve().as_uri()


async def background(page: Browser) -> float:
    """The lightness, 0 to 255, that most of the figure has."""
    from PIL import Image

    box = await page.value(
        f"(() => {{const r = {IMAGE}.getBoundingClientRect(); return [r.x, r.y + scrollY, 300, 200]}})()"
    )
    clip = dict(zip(("x", "y", "width", "height"), box, strict=True), scale=1)
    shot = await page.call("Page.captureScreenshot", format="png", captureBeyondViewport=True, clip=clip)
    return float(np.median(np.asarray(Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("L"))))


def test_folded_parts_are_open_in_print(tmp_path: Path) -> None:
    async def visit(address: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            await page.until("document.querySelector('details table') !== null")
            shown = "document.querySelector('details table').checkVisibility()"
            assert not await page.value(shown)
            await page.call("Emulation.setEmulatedMedia", media="print")
            assert await page.value(shown)

    asyncio.run(visit(written(tmp_path / "page.html")))


async def press(page: Browser, key: str, code: int) -> None:
    """Press and release a key."""
    text = {"text": "\r"} if key == "Enter" else {}
    await page.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key, windowsVirtualKeyCode=code, **text)
    await page.call("Input.dispatchKeyEvent", type="keyUp", key=key, code=key, windowsVirtualKeyCode=code)


def test_a_page_can_be_used_by_keyboard(tmp_path: Path) -> None:
    """Tab goes from link to link to the fold, with an outline around the focus; Enter opens the fold."""

    async def visit(address: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            await page.until("document.querySelector('details table') !== null")
            reached: list[str] = []
            while "SUMMARY" not in reached and len(reached) < 20:
                await press(page, "Tab", 9)
                reached.append(await page.value("document.activeElement.tagName"))
                assert await page.value("getComputedStyle(document.activeElement).outlineStyle") != "none"
            assert reached[0] == "A" and reached[-1] == "SUMMARY"
            await press(page, "Enter", 13)
            assert await page.until("document.querySelector('details').open")

    asyncio.run(visit(written(tmp_path / "page.html")))


def test_a_page_fits_four_screens(tmp_path: Path) -> None:
    pytest.importorskip("PIL")

    async def visit(address: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            await page.until(f"{IMAGE} && {IMAGE}.complete && {IMAGE}.naturalWidth")
            for width in (1280, 390):
                for dark in (False, True):
                    await page.screen(width, 900, dark=dark)
                    assert await page.value("document.documentElement.scrollWidth") <= width
                    lightness = await background(page)
                    assert lightness < 60 if dark else lightness > 240, (width, dark)
            caption = "document.querySelector('caption').getBoundingClientRect().right"
            assert await page.value(caption) <= 390  # of a table that is wider than the phone
            assert not await page.value("document.querySelector('details').open")
            await page.value("document.querySelector('summary').click()")
            assert await page.value("document.querySelector('details table').offsetHeight > 0")
            assert page.said == []

    asyncio.run(visit(written(tmp_path / "page.html")))
