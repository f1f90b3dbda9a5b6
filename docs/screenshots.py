"""Makes the screenshots of the documentation anew: `python docs/screenshots.py DEMO/report.html GAP/report.html`.

The pages are those of `imuarray demo` and of the example in docs/how_to/diagnose.md. Chromium draws them.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from PIL import Image, ImageChops

IMAGES = Path(__file__).parent / "images"
COLOURS = 64
"""So many are kept: the files stay small."""


def figure(page: Path, alternative: str, target: Path) -> None:
    """Save a picture of the figure of a page whose alternative text begins with `alternative`."""
    tags = re.findall(r"<img[^>]*>", page.read_text(encoding="utf-8"))
    tag = next((tag for tag in tags if f'alt="{alternative}' in tag), "")
    source = re.search(r'src="([^"]+)"', tag)
    if source is None:
        sys.exit(f"{page}: no figure {alternative!r}")
    alone = target.with_suffix(".html")
    style = "margin:0;background:#fff"
    alone.write_text(f'<body style="{style}"><img style="width:900px" src="{source[1]}"></body>', encoding="utf-8")
    top(alone, 700, target)
    alone.unlink()


def top(page: Path, height: int, target: Path) -> None:
    """Save a screenshot of the top of a page, without the white below it."""
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--window-size=900,{height}")
    subprocess.run(["chromium", *options, f"--screenshot={target}", page.resolve().as_uri()], check=True)
    image = Image.open(target).convert("RGB")
    used = ImageChops.difference(image, Image.new("RGB", image.size, image.getpixel((0, 0)))).getbbox()
    _save(image.crop((0, 0, image.width, min(used[3] + 8, image.height) if used else image.height)), target)


def _save(image: Image.Image, target: Path) -> None:
    image.thumbnail((900, 1200))
    image.convert("RGB").quantize(COLOURS).save(target, optimize=True)


if __name__ == "__main__":
    demo, gap = map(Path, sys.argv[1:])
    figure(demo, "Drift of single gyroscopes", IMAGES / "heating.png")
    top(gap, 940, IMAGES / "gap.png")
