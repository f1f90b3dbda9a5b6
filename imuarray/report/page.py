"""A report as one HTML file without external scripts, fonts or images; all text is escaped. A page that shows a
recording has scripts to zoom it, and is complete without them.

Drawings follow the colour scheme of the page, light or dark. Matplotlib writes colours into the SVG; here each becomes
a CSS variable with one value for each scheme, between which the browser chooses. A print is always light.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from os import PathLike
from typing import TYPE_CHECKING, Literal

import numpy as np

from imuarray.atomic import draw_figure, write_text
from imuarray.errors import MissingExtraError
from imuarray.printable import printable
from imuarray.report.recording import RecordingFigure, scripts

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

NO_FIGURES = "No figures on this page: they need matplotlib (pip install 'imuarray[report]')."

PAPER, INK = "#14191d", "#e4e8eb"
"""Background and text of a dark page (page.html): white becomes the first, black the second."""

_SHAPE = 0.55
"""Exponent of the scale of lightness on a dark page, below 1: mid-tones need more lightness there to be distinct."""

_LMS = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
"""Matrices from linear sRGB to the response of the cones, and from its cube root to OKLab (B. Ottosson, A perceptual
color space for image processing, 2020).
"""

_COLOUR = re.compile(r"(?<=[:\s])#[0-9a-f]{6}\b")
_STYLED = re.compile(r'style="[^"]*"')


def follow_scheme(svg: str) -> str:
    """Return the SVG with each colour of its `style` attributes in a light and a dark version."""
    colours: dict[str, None] = {"#000000": None}

    def named(match: re.Match[str]) -> str:
        colours[match[0]] = None
        return f"var(--{match[0][1:]})"

    body = _STYLED.sub(lambda style: _COLOUR.sub(named, style[0]), svg)
    light = ";".join(f"--{colour[1:]}:{colour}" for colour in colours)
    dark = ";".join(f"--{colour[1:]}:{on_dark(colour)}" for colour in colours)
    sheet = (
        # Black glyphs and filled shapes have no colour of their own in Matplotlib's SVG: they inherit this one.
        f"<style>svg{{{light};fill:var(--000000)}}"
        f"@media screen and (prefers-color-scheme:dark){{svg{{{dark}}}}}</style>"
    )
    return re.sub(r"(<svg\b[^>]*>)", lambda tag: tag[1] + sheet, body, count=1)


@lru_cache(maxsize=4096)
def on_dark(colour: str) -> str:
    """Return the counterpart of a colour (#rrggbb) on a dark page: the same hue with the lightness inverted."""
    lightness, *chroma = _oklab(colour)
    (low, *tint), high = _oklab(PAPER), _oklab(INK)[0]
    target = low + (high - low) * max(0.0, 1 - lightness) ** _SHAPE
    for share in np.linspace(1, 0, 21):  # less chroma where sRGB lacks the colour at this lightness
        linear = _linear([target, *(share * part + own for part, own in zip(chroma, tint, strict=True))])
        if np.all(np.abs(linear - 0.5) <= 0.5):
            break
    linear = np.clip(linear, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(255 * float(part)):02x}" for part in encoded)


def _oklab(colour: str) -> list[float]:
    encoded = np.array([int(colour[first : first + 2], 16) for first in (1, 3, 5)]) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    return [float(part) for part in _LAB @ np.cbrt(_LMS @ linear)]


def _linear(lab: list[float]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the linear sRGB (3,) of an OKLab colour; outside 0 to 1 if sRGB lacks the colour."""
    return np.asarray(np.linalg.solve(_LMS, np.linalg.solve(_LAB, np.asarray(lab)) ** 3))


@dataclass(frozen=True)
class Table:
    """A heading row and rows of formatted text. `words` are the columns that hold no numbers."""

    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str
    words: Sequence[int] = ()


@dataclass(frozen=True)
class Figure:
    """A drawing, the caption that says what to look for, and the text alternative (WCAG 1.1.1)."""

    drawing: Drawing
    caption: str
    alternative: str

    @property
    def data_url(self) -> str:
        """Return the drawing as an SVG in a data URL, with colours that follow the page's scheme."""
        buffer = io.BytesIO()
        draw_figure(buffer, self.drawing, format="svg", metadata={"Date": None})
        drawing = follow_scheme(buffer.getvalue().decode("utf-8"))
        return "data:image/svg+xml;base64," + base64.b64encode(drawing.encode("utf-8")).decode("ascii")


@dataclass(frozen=True)
class Section:
    """A heading, a paragraph, and tables and figures. With a `fold`, a line of text, the parts are hidden until the
    reader opens that line.
    """

    title: str
    text: str
    parts: Sequence[Table | Figure | RecordingFigure] = ()
    fold: str = ""


Level = Literal["good", "doubtful", "bad", "neutral"]


@dataclass(frozen=True)
class Verdict:
    """The opening of a page: one sentence, a level, and three to five figures, each a value with unit and meaning."""

    sentence: str
    level: Level = "neutral"
    figures: Sequence[tuple[str, str]] = ()

    @property
    def sign(self) -> str:
        """Return a symbol of the level, for readers who do not see its colour."""
        return {"good": "✓", "doubtful": "▲", "bad": "✕", "neutral": "•"}[self.level]

    def of_file(self, name: str) -> Verdict:
        """Return the verdict with the name of its file at each figure, for a page of several files."""
        return replace(self, figures=tuple((value, f"{meaning} ({name})") for value, meaning in self.figures))


def highlight(text: str) -> str:
    """Return escaped text that the page highlights; MissingExtraError without jinja2's escaping."""
    return markup("<mark>{}</mark>", text)


def markup(pattern: str, *texts: str) -> str:
    """Return a pattern of HTML filled with escaped texts; MissingExtraError without jinja2's escaping."""
    require_page_package()
    from markupsafe import Markup

    return Markup(pattern).format(*texts)  # noqa: S704, patterns are constants of this package, and texts are escaped


def require_page_package() -> None:
    """Raise MissingExtraError if the package that pages need is not installed: to be called before long work."""
    try:
        import jinja2  # noqa: F401
    except ImportError:
        raise MissingExtraError("jinja2", "report") from None


def write_page(
    path: str | PathLike[str],
    title: str,
    summary: Sequence[str],
    sections: Sequence[Section],
    *,
    verdict: Verdict | None = None,
    force: bool = False,
) -> None:
    """Write the page. OutputExistsError if the file exists and `force` is false, OutputError if it cannot be written,
    MissingExtraError without jinja2.
    """
    require_page_package()
    from jinja2 import Environment

    template = files("imuarray.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, finalize=_escape_controls)
    environment.tests["table"] = lambda part: isinstance(part, Table)
    environment.tests["recording"] = lambda part: isinstance(part, RecordingFigure)
    has_recording = any(isinstance(part, RecordingFigure) for section in sections for part in section.parts)
    page = environment.from_string(template).render(
        title=title,
        summary=summary,
        sections=sections,
        verdict=verdict,
        scripts=scripts() if has_recording else (),
    )
    write_text(path, page, force=force)


def _escape_controls(value: object) -> object:
    """Escape control characters in text, which may come from a file of another author."""
    return "\n".join(map(printable, value.split("\n"))) if type(value) is str else value
