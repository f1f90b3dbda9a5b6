"""Atomic output: a file is written under a temporary name next to its own, and renamed when it is complete.

After any failure, for example a full disk, there is no partial file, and an older file of that name is unchanged.
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
    """Yield the path to write to. The file is renamed to its final name if the block ends without an error, and
    otherwise deleted.

    OutputExistsError if the file exists and `force` is false, OutputError if it can't be written. A device or a pipe is
    written to directly.
    """
    target = Path(os.path.realpath(path))  # a link is kept, and its target replaced
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
        if isinstance(error, RuntimeError) and not errno_of(error):  # HDF5 reports some failed writes by one
            raise
        raise OutputError(path, error) from None
    finally:
        with suppress(OSError):
            draft.unlink()


def write_text(path: str | PathLike[str], text: str, *, force: bool = False) -> None:
    """Write a text file in UTF-8; the text may include file names with undecodable bytes (`encodable`). Errors as for
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
"""Compression level of zlib. The usual level 6 takes a fifth of the time of a figure; the file is then a third
smaller.
"""


_SVG_DPI = 72


def draw_figure(target: str | PathLike[str] | BytesIO, figure: Figure, **options: Any) -> None:
    """Save a figure like `figure.savefig`, but lay out its parts only once. Matplotlib lays them out twice and inspects
    all artists beforehand, which takes as long as drawing.
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
    """Write the file to the disk before returning, so that either the old or the new file exists after a power cut.
    OSError.
    """
    with path.open("rb") as file:
        os.fsync(file.fileno())
