"""Runs a command as a program: its exit code, and one line for each error."""

from __future__ import annotations

import errno
import io
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from imuarray.errors import NO_ROOM, ImuArrayError, LogWarning
from imuarray.printable import printable
from imuarray.spelling import guess

EXIT_CODES = (
    "0 success; 1 a check failed (detect --doctor, a self-test that could not be determined, gap validate,"
    " a recording at whose end no sensor answered); 2 bad input, or a chip other than expected: one line names"
    " the place and what is allowed; 3 the disk is full, and the log that was being written is complete up to that"
    " moment; 130 interrupted"
)


def run(command: click.Command, name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command as the program `name` with `arguments` (None: those of the process), and return the exit code:
    `EXIT_CODES`. An error is printed in one line on standard error. To print on a closed standard output is an error.
    """
    if sys.stdout is None:  # its descriptor was closed when the process started
        sys.stdout = io.TextIOWrapper(_ClosedOutput(), "utf-8", write_through=True)
    try:
        words = None if arguments is None else list(arguments)
        with _warnings_as_lines(name):
            result = command.main(args=words, prog_name=name, standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo(f"{name}: interrupted", err=True)
        return 130
    except click.ClickException as error:
        return _end(name, _explain(error), 2)
    except ImuArrayError as error:
        return _end(name, str(error), error.exit_code)
    except UnicodeEncodeError as error:  # of the name of a file, the only text that comes from outside as it is
        return _end(name, f"{error.object!a}: a name with bytes that are no text on this machine; rename the file", 2)
    except MemoryError as error:
        return _end(name, f"the memory of this machine is too small: {error or 'no more memory'}", 2)
    except OSError as error:  # of a file or a bus, without an error of its own
        place = f"{error.filename}: " if error.filename else ""
        return _end(name, f"{place}{error.strerror or error}", 3 if error.errno in NO_ROOM else 2)
    return result if isinstance(result, int) else 0


class _ClosedOutput(io.RawIOBase):
    """Standard output without a descriptor. Without it, Python drops what is printed, and the program would succeed."""

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        raise OSError(errno.EBADF, "standard output is closed; nothing can be printed")


def _explain(error: click.ClickException) -> str:
    """Return the message of an error, with what is allowed where click does not say it."""
    text = error.format_message()
    context = error.ctx if isinstance(error, click.UsageError) else None
    if context is not None and (extra := re.fullmatch(r"Got unexpected extra arguments? \((.*)\)", text)):
        usage = " ".join(context.command.collect_usage_pieces(context))
        return f"unexpected argument {extra[1]}; allowed is {context.command_path} {usage}"
    kind = error.param.type if isinstance(error, click.BadParameter) and error.param is not None else None
    if isinstance(kind, click.FloatRange | click.IntRange):
        number = "a number" if isinstance(kind, click.FloatRange) else "a whole number"
        ends = f"{'' if kind.min is None else f' from {kind.min:g}'}{'' if kind.max is None else f' to {kind.max:g}'}"
        return re.sub(r"is not a valid (float|integer) range\.", f"is not {number}{ends}", text)
    if isinstance(kind, click.Path) and (file := re.search(r"Directory '(.*)' is a file", text)):
        return f"{file[1]}: is a file; the output must be a folder"
    if isinstance(kind, click.Choice) and (wrong := re.search(r"'([^']*)' is not one of ", text)):
        return text.removesuffix(".") + guess(wrong[1], map(str, kind.choices))
    return text


@contextmanager
def _warnings_as_lines(name: str) -> Iterator[None]:
    """Print each LogWarning as one line on standard error, once."""
    printed: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", LogWarning)
        show = warnings.showwarning

        def print_line(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if not issubclass(category, LogWarning):
                show(message, category, *place, **more)
            elif str(message) not in printed:
                printed.add(str(message))
                click.echo(printable(f"{name}: warning: {message}"), err=True)

        warnings.showwarning = print_line
        yield


def _end(name: str, text: str, exit_code: int) -> int:
    click.echo(printable(f"{name}: {' '.join(text.split())}"), err=True)
    return exit_code
