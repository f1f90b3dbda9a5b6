"""The page in a real browser: it shows the log, follows its changes, and reconnects to a restarted monitor."""

from __future__ import annotations

import asyncio
import dataclasses
from pathlib import Path

import pytest

from imuarray.log import LogWriter
from imuarray.log.format import Event
from imuarray.monitor.log_monitor import THEMES
from tests.monitor.chromium import CHROMIUM, browser
from tests.monitor.conftest import ACC, EPOCH, HEADERS, Logger, rows
from tests.monitor.page_server import serve_page

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")]

DRAWN = """(() => {
  const canvases = (node) => [...node.querySelectorAll('*')].reduce(
    (sum, one) => sum + (one.tagName === 'CANVAS') + (one.shadowRoot ? canvases(one.shadowRoot) : 0), 0);
  const data = (one) => one.get_model_by_name('source').data;
  const fed = Bokeh.documents.filter((one) => (data(one).t ?? data(one).f).length > 10);
  return Math.min(fed.length, [...document.querySelectorAll('.figure')].filter((one) => canvases(one) > 0).length);
})()"""
"""Figures that have data, and canvases on which to draw them."""
LIGHT = f"""Bokeh.documents.every((one) => JSON.stringify(
  one.roots()[0].below[0].major_label_text_color).includes('{THEMES["light"].text}'))"""
ROWS = "document.querySelectorAll('#sensors tbody tr').length"
NEWEST = "document.querySelector('#tiles .more').textContent"


def test_the_page_shows_the_log_and_follows_its_changes(logger: Logger, log_path: Path, tmp_path: Path) -> None:
    logger.go_on(12.0)

    async def visit(address: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            await page.screen(1366, 900)
            assert await page.until(ROWS) == 4
            names = await page.value(
                "[...document.querySelectorAll('#sensors tbody th')].map((one) => one.textContent)"
            )
            assert names == ["Acc", "Turned", "Gyro", "Baro"]
            assert await page.value("document.getElementById('state-text').textContent") == "being written"
            assert await page.value(
                "[...document.querySelectorAll('h1,h2,h3')].map((one) => one.tagName).join('')"
            ) == (
                "H1H2H2H3H3H2H2H3H3H3H3"  # headings of sections, and of cards in them
            )
            await page.until(f"{DRAWN} >= 2")
            first = await page.screenshot()
            assert first[:8] == b"\x89PNG\r\n\x1a\n" and len(first) > 20_000
            before = await page.value(NEWEST)
            logger.go_on(3.0)
            after = await page.until(f"{NEWEST} !== {before!r} && {NEWEST}")
            assert (before, after) == ("12 s recorded", "15 s recorded")
            assert await page.value("document.getElementById('events-new').textContent") == ""
            logger.writer.event(Event(15_000_000_000, "Acc", "lost", "no reading"))
            logger.go_on(1.0)
            await page.until("document.getElementById('events-new').textContent === 'Acc lost: no reading'")
            assert await page.value("document.querySelector('#events tbody .warn').textContent") == "▲ lost"
            for width in (1366, 390):  # nothing sticks out of a laptop's or a phone's screen
                await page.screen(width, 800, dark=True)
                assert await page.value("document.documentElement.scrollWidth") <= width
            for dark in (False, True, False, True, False):  # in quick succession: no figure keeps the other's colours
                await page.screen(1366, 2500, dark=dark)
            await page.until(f"Bokeh.documents.length === 9 && {LIGHT}")
            await page.until(f"{DRAWN} === 9")
            assert page.said == []

    with serve_page(log_path) as (address, _):
        asyncio.run(visit(address))


def test_a_dead_sensor_is_shown_silent_in_the_fault_colour(logger: Logger, log_path: Path, tmp_path: Path) -> None:
    logger.go_on(4.0)
    logger.go_on(49.0, without=("Turned",))
    warned = "[...document.querySelectorAll('#sensors .warn, #cards .warn')]"

    async def visit(address: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            assert await page.until(ROWS) == 4
            assert await page.value(f"{warned}.map((one) => one.textContent)") == [
                "silent 49 s",
                "4,900",
                "adxl345, silent 49 s",
            ]
            colours = await page.value(f"{warned}.map((one) => getComputedStyle(one).color)")
            assert set(colours) == {"rgb(154, 67, 0)"}
            assert page.said == []

    with serve_page(log_path) as (address, _):
        asyncio.run(visit(address))


def test_the_page_reports_a_stopped_monitor_and_reconnects(log_path: Path, tmp_path: Path) -> None:
    writer = LogWriter(log_path, HEADERS, source="emulated", epoch=EPOCH)
    writer.keep()
    Logger(writer).go_on(2.0)
    state = "document.getElementById('state-text')?.textContent"

    async def visit(address: str, port: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            await page.until(f"{state} === 'being written'")
            first.kill()
            first.wait(60)
            await page.until(f"{state} === 'no connection'")
            assert "tries again in" in await page.value("document.getElementById('connection').textContent")
            with serve_page(log_path, "--port", port):
                await page.until(f"{state} === 'being written'")
                assert await page.value("document.getElementById('connection').hidden")
                writer.__exit__(None, None, None)
                await page.until(f"{state} === 'the log has ended'")

    with serve_page(log_path) as (address, first):
        asyncio.run(visit(address, address.rsplit(":", 1)[1].strip("/")))


def test_names_are_shown_as_text(log_path: Path, tmp_path: Path) -> None:
    name = "<img src=x onerror=document.title=1>"
    header = dataclasses.replace(ACC, name=name)
    with LogWriter(log_path, [header], source="emulated", epoch=EPOCH) as writer:
        writer.append(name, rows("Acc", 0.0, 3.0))
        writer.event(Event(0, name, "<b>lost</b>", "<script>document.title=1</script>"))

    async def visit(address: str) -> None:
        async with browser(tmp_path / "profile", address) as page:
            await page.until("document.querySelectorAll('#events tbody tr').length === 1")
            assert await page.value("document.querySelector('#sensors tbody th').textContent") == name
            assert await page.value("document.querySelectorAll('img, b:not(.axes b), td script').length") == 0
            assert await page.value("document.title") == "run.h5: finished"

    with serve_page(log_path) as (address, _):
        asyncio.run(visit(address))
