"""Atomic output: a file is written under a temporary name next to its own, and renamed when it is complete.

Any failure, a full disk above all, leaves no partial file behind, and an older file of that name as it was.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imuarray.errors import OutputError, OutputExistsError, errno_of
from imuarray.printable import encodable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@contextmanager
def whole_file(path: str | PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """The path to write to: the file takes its name when the block ends well, else it is gone.

    OutputExistsError if it is there and `force` is false, OutputError where it can't be written. What is no file (a
    device, a pipe) is written to as it is.
    """
    target = Path(os.path.realpath(path))  # a link stays one
    draft = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        exists = target.exists()
        if exists and not force:
            raise OutputExistsError(path)
        if exists and not target.is_file():
            yield target
            return
        yield draft
        if exists:
            shutil.copymode(target, draft)
        _sync(draft)
        draft.replace(target)
    except (OSError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not errno_of(error):  # HDF5 may tell a failed write by one
            raise
        raise OutputError(path, error) from None
    finally:
        with suppress(OSError):
            draft.unlink()


def write_text(path: str | PathLike[str], text: str, *, force: bool = False) -> None:
    """Write a file of text, UTF-8, in which the names of files may stand that are no text (`encodable`); errors as
    `whole_file`.
    """
    with whole_file(path, force=force) as draft:
        draft.write_text(encodable(text), encoding="utf-8")


def save_figure(path: str | PathLike[str], figure: Figure, **options: Any) -> None:
    """Write a figure in the format of the suffix, replacing an existing file; OutputError."""
    kind = Path(path).suffix.removeprefix(".")
    if kind == "png":
        options.setdefault("pil_kwargs", {"compress_level": _PNG_LEVEL})
    with whole_file(path, force=True) as draft:
        draw_figure(draft, figure, format=kind, **options)


_PNG_LEVEL = 1
"""Compression of zlib: the usual level 6 takes a fifth of the time of a figure and saves a third of its file."""


_SVG_DPI = 72


def draw_figure(target: str | PathLike[str] | BytesIO, figure: Figure, **options: Any) -> None:
    """`figure.savefig`, with the parts of the figure laid out once: Matplotlib lays them out twice and goes through all
    that is drawn beforehand, which takes as long again as drawing.
    """
    engine, dpi = figure.get_layout_engine(), figure.dpi
    if engine is None or not figure.axes:
        figure.savefig(target, **options)
        return
    try:
        figure.set_dpi(_SVG_DPI if options.get("format") == "svg" else options.get("dpi", dpi))
        engine.execute(figure)
        figure.set_dpi(dpi)
        figure.set_layout_engine(None)
        figure.savefig(target, **options)
    finally:
        figure.set_dpi(dpi)
        figure.set_layout_engine(engine)


def _sync(path: Path) -> None:
    """Write the file to the disk before returning: a power cut leaves the old file or the new one. OSError."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
