"""One HTML file that needs nothing else: no script, no font, no image from elsewhere; every name escaped. Only a page
that shows a recording has scripts, which zoom it, and it is whole without them.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from os import PathLike
from typing import TYPE_CHECKING, Literal

from imuarray.atomic import draw_figure, write_text
from imuarray.errors import MissingExtraError
from imuarray.printable import printable
from imuarray.report.colour_scheme import follow_scheme
from imuarray.report.recording import RecordingFigure, scripts

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing


@dataclass(frozen=True)
class Table:
    """A heading row and rows of text; numbers come formatted, with their unit. `words` are columns that hold no
    numbers.
    """

    heading: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str
    words: Sequence[int] = ()


@dataclass(frozen=True)
class Figure:
    """A drawing, what to see in it, and what it shows for those who can't see it."""

    drawing: Drawing
    caption: str
    alternative: str

    @property
    def data_url(self) -> str:
        """The drawing as SVG inside a URL, with colours that follow the page's."""
        buffer = io.BytesIO()
        draw_figure(buffer, self.drawing, format="svg", metadata={"Date": None})
        drawing = follow_scheme(buffer.getvalue().decode("utf-8"))
        return "data:image/svg+xml;base64," + base64.b64encode(drawing.encode("utf-8")).decode("ascii")


@dataclass(frozen=True)
class Section:
    """A heading, a paragraph and what belongs to it. With a `fold`, which is one line, the parts are hidden behind that
    line until the reader opens it.
    """

    title: str
    text: str
    parts: Sequence[Table | Figure | RecordingFigure] = ()
    fold: str = ""


Level = Literal["good", "doubtful", "bad", "neutral"]


@dataclass(frozen=True)
class Verdict:
    """The opening of a page: one plain sentence, how good what it tells of is, and three to five figures, each a value
    with its unit and what it is.
    """

    sentence: str
    level: Level = "neutral"
    figures: Sequence[tuple[str, str]] = ()

    @property
    def sign(self) -> str:
        """The level as a sign, for those who do not see colours."""
        return {"good": "✓", "doubtful": "▲", "bad": "✕", "neutral": "•"}[self.level]


def write_page(
    path: str | PathLike[str],
    title: str,
    summary: Sequence[str],
    sections: Sequence[Section],
    *,
    verdict: Verdict | None = None,
    force: bool = False,
) -> None:
    """Write the page; OutputExistsError if it is there, OutputError, MissingExtraError without jinja2."""
    try:
        from jinja2 import Environment
    except ImportError:
        raise MissingExtraError("jinja2", "report") from None
    template = files("imuarray.report").joinpath("page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, finalize=_shown)
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


def _shown(value: object) -> object:
    """Texts without control characters, spelled out: they may come from a file that somebody else wrote."""
    return "\n".join(map(printable, value.split("\n"))) if type(value) is str else value
