"""Makes the pictures of the documentation anew: `python docs/screenshots.py DIR`, from the root of the repository.

Every page that the program writes is made in DIR by the commands of `PAGES` (a page that is there already is kept).
Chromium shows it in light, in dark, on a phone and on paper. docs/gallery.md shows these pictures. Needed are Chromium
(Debian's package chromium) and pdftoppm (poppler-utils), which draws the printed page.
"""

from __future__ import annotations

import asyncio
import base64
import io
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, ImageChops

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.monitor.chromium import Browser, browser  # noqa: E402  found beside docs/ only now

IMAGES = ROOT / "docs" / "images"
GALLERY = IMAGES / "gallery"

_LOGS = (
    'log martin2013 --bus "emulated:?world=tumble&face_s=10" --seconds 84s -o tumble.h5 --force',
    "calibrate tumble tumble.h5 -o cal.toml --force",
    "calibrate noise tumble.h5 -o cal.toml --update",
)
PAGES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "demo": ("demo/report.html", ("demo -o demo --force",)),
    "demo_array": ("demo8/report.html", ("demo --array icm42688x8 -o demo8 --force",)),
    "log": ("report.html", (*_LOGS, "report tumble.h5 -o report.html")),
    "calibration": ("cal.html", (*_LOGS, "report cal.toml -o cal.html")),
    "fused": (
        "fused.html",
        (
            *_LOGS,
            'log martin2013 --bus "emulated:?world=heating&scale=0.05" --seconds 330s -o heating.h5 --force',
            "fuse heating.h5 --calibration cal.toml --technique optimal -o optimal.h5 --force",
            "report optimal.h5 -o fused.html",
        ),
    ),
    "gap": (
        "gap/report.html",
        (
            'log martin2013 --bus "emulated:?mechanism=mains_ripple&severity=0.3&sensor=Gyro2" --only Gyro1,Gyro2'
            " --rate-hz 200 --seconds 60s --phase static -o bench.h5 --force",
            "gap diagnose bench.h5 --replicates 40 -o gap --force",
        ),
    ),
    "validation": ("val.html", ("gap validate --size glance -o validated", "report validated -o val.html")),
    "study": ("study/study.html", ("study --quick -o study --force",)),
    "paper": ("paper/paper.html", ("paper --replica -o paper --force",)),
}
"""The page and the commands that make it, by the name of its picture. The monitor's is made of a log by `_monitor`."""

_TALL = 900
_QUALITY = 62
_WIDE = 1280


def make(folder: Path, name: str) -> Path:
    """Return the page, which is made if it is not there."""
    page, commands = PAGES[name]
    for command in commands if not (folder / page).exists() else ():
        done = subprocess.run([sys.executable, "-m", "imuarray.cli", *shlex.split(command)], cwd=folder, check=False)
        if done.returncode not in (0, 1):  # a validation of few cases may miss a bar
            sys.exit(f"{command}: exit code {done.returncode}")
    return folder / page


async def four_modes(address: str, target: Path, wait_s: float = 2.0) -> None:
    """Save the top of a page in light and dark (above), on a phone and on paper (beside them) as one picture."""
    with tempfile.TemporaryDirectory() as profile:
        async with browser(Path(profile), address) as page:
            await page.call("Emulation.setScrollbarsHidden", hidden=True)
            light, dark = [await _shot(page, _WIDE, dark, wait_s) for dark in (False, True)]
            phone = await _shot(page, 390, False, wait_s)
            sheet = _first_sheet(base64.b64decode((await page.call("Page.printToPDF"))["data"]))
    half = light.resize((640, 450)), dark.resize((640, 450))
    phone = phone.resize((390, _TALL)).crop((0, 0, 390, _TALL))
    sheet.thumbnail((640, 908))
    width = 640 + 8 + 390 + 8 + sheet.width
    whole = Image.new("RGB", (width, 908), "#9aa5ad")
    whole.paste(half[0], (0, 0))
    whole.paste(half[1], (0, 458))
    whole.paste(phone, (648, 4))
    whole.paste(sheet, (1046, 0))
    target.parent.mkdir(parents=True, exist_ok=True)
    whole.save(target, quality=_QUALITY, method=6)


async def _shot(page: Browser, width: int, dark: bool, wait_s: float) -> Image.Image:
    await page.screen(width, _TALL, dark=dark)
    await asyncio.sleep(wait_s)
    return Image.open(io.BytesIO(await page.screenshot())).convert("RGB")


def _first_sheet(pdf: bytes) -> Image.Image:
    """The first page of a PDF; pdftoppm, of Poppler, draws it."""
    options = ("-r", "80", "-f", "1", "-l", "1", "-png", "-")
    drawn = subprocess.run(["pdftoppm", *options], input=pdf, capture_output=True, check=True)
    return Image.open(io.BytesIO(drawn.stdout)).convert("RGB")


async def _monitor(folder: Path) -> None:
    """The monitor's page of a log."""
    command = [sys.executable, "-m", "imuarray.cli", "monitor", str(folder / "tumble.h5"), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        address = process.stdout.readline().strip() if process.stdout else ""
        await four_modes(address, GALLERY / "monitor.webp", wait_s=25.0)
    finally:
        process.terminate()
        process.wait(60)


async def figure(page: Path, alternative: str, target: Path) -> None:
    """Save a picture of the figure of a page whose alternative text begins with `alternative`."""
    tags = re.findall(r"<img[^>]*>", page.read_text(encoding="utf-8"))
    tag = next((tag for tag in tags if f'alt="{alternative}' in tag), "")
    source = re.search(r'src="([^"]+)"', tag)
    if source is None:
        sys.exit(f"{page}: no figure {alternative!r}")
    alone = target.with_suffix(".html")
    style = "margin:0;background:#fff"
    alone.write_text(f'<body style="{style}"><img style="width:900px" src="{source[1]}"></body>', encoding="utf-8")
    await top(alone, 700, target)
    alone.unlink()


async def top(page: Path, height: int, target: Path) -> None:
    """Save a screenshot of the top of a page, without the white below it."""
    with tempfile.TemporaryDirectory() as profile:
        async with browser(Path(profile), page.resolve().as_uri()) as shown:
            await shown.call("Emulation.setScrollbarsHidden", hidden=True)
            await shown.screen(900, height)
            await asyncio.sleep(2.0)
            image = Image.open(io.BytesIO(await shown.screenshot())).convert("RGB")
    corner: Any = image.getpixel((0, 0))
    used = ImageChops.difference(image, Image.new("RGB", image.size, corner)).getbbox()
    image = image.crop((0, 0, image.width, min(used[3] + 8, image.height) if used else image.height))
    image.quantize(64).save(target, optimize=True)


async def main(folder: Path, names: Sequence[str]) -> None:
    """Make every picture, or those of the gallery that are named."""
    for name in names or PAGES:
        if name != "monitor":
            await four_modes(make(folder, name).resolve().as_uri(), GALLERY / f"{name}.webp")
    if not names or "monitor" in names:
        await _monitor(folder)
    if names:
        return
    await figure(folder / "demo/report.html", "Drift of single gyroscopes", IMAGES / "heating.png")
    await top(folder / "gap/report.html", 692, IMAGES / "gap.png")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python docs/screenshots.py DIR [NAME...]")
    if shutil.which("pdftoppm") is None:
        sys.exit("docs/screenshots.py: pdftoppm is missing; it is in poppler-utils (apt-get install poppler-utils)")
    asyncio.run(main(Path(sys.argv[1]), sys.argv[2:]))
