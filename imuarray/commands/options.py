"""Arguments, options and progress bars that several commands share."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import field, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar, cast

import click

from imuarray.errors import ImuArrayError, OutputExistsError
from imuarray.json_values import json_value
from imuarray.printable import duration, encodable


class PathName(click.Path):
    """The name of a file or folder, converted to a Path. An empty name, which a Path takes for the current folder, is a
    usage error.
    """

    def __init__(self, *, exists: bool = False, file_okay: bool = True) -> None:
        """Check names as `click.Path` with the same arguments does."""
        super().__init__(exists=exists, file_okay=file_okay, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the Path; a usage error states that a name is empty."""
        if value == "":
            self.fail("the name is empty", param, ctx)
        return super().convert(value, param, ctx)


config_argument = click.argument("config", type=PathName())
log_argument = click.argument("run", metavar="RUN.h5", type=PathName())
bus_option = click.option(
    "--bus",
    "bus_url",
    metavar="URL",
    help="i2c:/dev/i2c-1, spi:, iio:, serial:/dev/ttyACM0, replay:T.jsonl or emulated: (default: that of CONFIG)",
)
json_option = click.option("--json", "as_json", is_flag=True, help="print one JSON object instead of text")


class NumberRange(click.FloatRange):
    """A number in a range. "nan", which comparisons with the ends would accept, is refused."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; a usage error states what is allowed."""
        number = float(super().convert(value, param, ctx))
        if math.isnan(number):
            self.fail(f"{value!r} is not a valid float range.", param, ctx)
        return number


rate_option = click.option(
    "--rate-hz",
    type=NumberRange(0.01, 3200),
    default=50.0,
    show_default=True,
    help="frames per second; a frame reads every sensor once",
)
seed_option = click.option(
    "--seed", type=click.IntRange(0, 2**63), default=0, show_default=True, help="seed of all random draws"
)
force_option = click.option("--force", is_flag=True, help="overwrite the output if it exists")
workers_option = click.option(
    "--workers",
    type=click.IntRange(1, 256),
    default=lambda: os.cpu_count() or 1,
    show_default="the machine's processors",
    help="number of processes; it does not change the result",
)

_Decorated = TypeVar("_Decorated", bound=Callable[..., Any] | click.Command)
_Options = TypeVar("_Options")
_Result = TypeVar("_Result")


_PARAMETER = "parameter"
"""Key in the metadata of a field: the function of its name and type that returns the decorator of its parameter."""

_PATH = PathName()
_TYPES: Mapping[str, Mapping[str, Any]] = {
    "bool": {"is_flag": True},
    "Path": {"type": _PATH},
    "Path | None": {"type": _PATH},
    "tuple[Path, ...]": {"type": _PATH},
}
"""Settings of parameters that follow from the type of a field."""


def parameter(decorator: Callable[[Any], Any]) -> Any:
    """Return a field of a class of options whose parameter a decorator declares, such as `force_option`."""
    return field(metadata={_PARAMETER: lambda name, kind: decorator})


def argument(**settings: Any) -> Any:
    """Return a field of a class of options that is an argument of a command, with the settings of `click.argument`."""
    return field(metadata={_PARAMETER: lambda name, kind: click.argument(name, **{**_TYPES.get(kind, {}), **settings})})


def option(*declarations: str, **settings: Any) -> Any:
    """Return a field of a class of options that is an option of a command, with the settings of `click.option`.

    The parameter has the name of the field, and the option too unless `declarations` name it. A field of type bool is a
    flag, unless it has a second name for False.
    """

    def decorator(name: str, kind: str) -> Callable[[Any], Any]:
        names = declarations or (f"--{name.replace('_', '-')}",)
        return click.option(*names, name, **{**_TYPES.get(kind, {}), **settings})

    return field(metadata={_PARAMETER: decorator})


def output_option(*, folder: bool = False, **settings: Any) -> Any:
    """Return a field of a class of options that is the output of a command, a file or a `folder`."""
    return option("-o", "--output", type=PathName(file_okay=not folder), **settings)


def takes(options: type[_Options]) -> Callable[[Callable[[_Options], _Result]], Callable[..., _Result]]:
    """Return a decorator of a function whose one argument is an instance of the dataclass `options`: the fields of the
    class, in their order, are the parameters of the command.
    """

    def decorate(function: Callable[[_Options], _Result]) -> Callable[..., _Result]:
        @wraps(function)
        def call(**values: Any) -> _Result:
            return function(options(**values))

        for each in reversed(fields(cast(Any, options))):
            call = each.metadata[_PARAMETER](each.name, each.type)(call)
        return call

    return decorate


def names_option(
    *declarations: str,
    metavar: str,
    help: str,
    default: str = "",
    show_default: bool = False,
    may_be_empty: bool = True,
) -> Callable[[_Decorated], _Decorated]:
    """Return an option whose value is a tuple of names, written with commas between them. A text without a name is
    refused unless `may_be_empty`.
    """

    def split(context: click.Context, parameter: click.Parameter, text: str) -> tuple[str, ...]:
        names = tuple(name.strip() for name in text.split(",") if name.strip())
        is_default = context.get_parameter_source(str(parameter.name)) is click.core.ParameterSource.DEFAULT
        if not (names or is_default or may_be_empty):
            raise click.BadParameter("names are required, with commas between them", param=parameter)
        return names

    return click.option(
        *declarations, metavar=metavar, help=help, default=default, show_default=show_default, callback=split
    )


def only_option(help: str) -> Callable[[_Decorated], _Decorated]:
    """Return the option that restricts a command to sensors, by their names; empty by default, for all sensors."""
    return names_option("--only", "--sensor", "only", metavar="SENSOR,...", help=help, may_be_empty=False)


_ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))

_EVERY_S = 5.0
"""Time between two progress lines if no bar can be shown."""

if TYPE_CHECKING:
    from imuarray.log import Log

    _Seconds = click.ParamType[float]
else:  # has a type parameter only since click 8.4
    _Seconds = click.ParamType


_YEAR_S = 365 * 86_400.0


class Duration(_Seconds):
    """A duration as 30s, 500ms, 10min, 1h or 1d, converted to seconds; a plain number is in seconds."""

    name = "duration"

    def __init__(self, minimum_s: float = 0.0, maximum_s: float = 100 * _YEAR_S) -> None:
        """Allow durations above 0 from `minimum_s` to `maximum_s`."""
        self.minimum_s, self.maximum_s = minimum_s, maximum_s

    _SECONDS: ClassVar[Mapping[str, float]] = {"": 1, "ms": 1e-3, "s": 1, "min": 60, "h": 3600, "d": 86400}

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the seconds; a usage error states what is allowed."""
        number = str(value).rstrip("abcdefghijklmnopqrstuvwxyz")
        try:
            seconds = float(number) * self._SECONDS[str(value)[len(number) :]]
        except (ValueError, KeyError):
            seconds = 0.0
        if not 0 < seconds < math.inf:
            self.fail(f"{value!r} is not a duration; write 30s, 10min, 1h or 1d", param, ctx)
        if not self.minimum_s <= seconds <= self.maximum_s:
            limit = f"at least {self.minimum_s:g} s" if seconds < self.minimum_s else f"at most {self.maximum_s:g} s"
            self.fail(f"{value!r}: allowed is {limit}", param, ctx)
        return seconds


def refuse_other_suffix(path: Path, content: str) -> None:
    """Raise click.UsageError if the path of a log or fused result (`content`) is a folder or has the suffix of another
    format.
    """
    if path.is_dir():
        raise click.UsageError(f"{path}: is a folder; the output must be a file")
    if path.suffix not in (".h5", ".hdf5"):
        raise click.UsageError(f"{path}: {content} is an HDF5 file; name it {path.with_suffix('.h5').name}")


def refuse_existing(path: Path, force: bool, source: Path | None = None, *, in_new_folder: bool = False) -> None:
    """Raise an error if an output cannot or must not be written, before long work begins.

    OutputExistsError if `path` exists and not `force`; click.UsageError for a folder, for a file in a folder that does
    not exist (unless `in_new_folder`), and if `path` is the `source` of the output.
    """
    if path.is_dir():
        raise click.UsageError(f"{path}: is a folder; the output must be a file")
    if not path.parent.is_dir() and not in_new_folder:
        raise click.UsageError(f"{path}: the folder {path.parent} does not exist")
    if source is not None and path.exists() and source.exists() and path.samefile(source):
        raise click.UsageError(f"{path}: is the input; choose another name for the output")
    if path.exists() and not force:
        raise OutputExistsError(path)


def prepare_folder(folder: Path, names: Sequence[str], force: bool) -> None:
    """Make a folder for files of these names, after `refuse_existing` for each. ImuArrayError if it cannot be made."""
    for name in names:
        refuse_existing(folder / name, force, in_new_folder=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ImuArrayError(f"{error.filename or folder}: {error.strerror or error}") from error


@contextmanager
def output_folder(folder: Path, names: Sequence[str], force: bool) -> Iterator[None]:
    """Make a folder as `prepare_folder` does. If the work in the block fails or is interrupted, a folder that did not
    exist before is removed again, unless files are in it.
    """
    is_new = not folder.exists()
    prepare_folder(folder, names, force)
    try:
        yield
    except BaseException:
        with suppress(OSError):
            if is_new:
                folder.rmdir()
        raise


def print_json(value: Any) -> None:
    """Print one JSON object on standard output; null for numbers that are not finite, which JSON lacks."""
    text = json.dumps(json_value(value), indent=1, ensure_ascii=False, allow_nan=False)
    click.echo(encodable(text))


@contextmanager
def progress(length: int, label: str) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on standard error; yields a function that moves it to a position.

    The bar is hidden without a terminal and if the `length` is unknown (0).
    """
    hidden = not length or not sys.stderr.isatty()
    label, width = _fit_bar(label, terminal_columns())
    with (
        click.progressbar(length=max(length, 1), label=label, width=width, file=sys.stderr, hidden=hidden) as bar,
        _interrupts() as heed,
    ):

        def move(done: int) -> None:
            heed()
            bar.update(min(done, length) - bar.pos)

        yield move


def report_doubts(log: Log) -> None:
    """Print on standard error that the import of a log raised doubts, which concern everything derived from it."""
    if log.import_doubts:
        click.echo(f"imuarray: {encodable(str(log.path))}: {log.import_doubts}", err=True)


def report_doubts_of(*paths: Path) -> None:
    """Print the doubts about the import of these files, as `report_doubts`; a file that is no log has none."""
    from imuarray.errors import ImuArrayError
    from imuarray.log import Log

    for path in paths:
        with suppress(ImuArrayError, OSError), Log(path) as log:
            report_doubts(log)


def terminal_columns() -> int:
    """Return the number of usable columns of the terminal of standard error (79 without a terminal). The last column
    stays free, because some terminals begin a new line after it.
    """
    columns = shutil.get_terminal_size().columns
    if not os.environ.get("COLUMNS"):  # standard output may be a file
        with suppress(OSError, ValueError, AttributeError):
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or columns
    return columns - 1


_BAR_COLUMNS = (8, 36)
"""Least and largest length of a progress bar."""

_BAR_FRAME = 24
"""Columns of a progress line besides label and bar: spaces, brackets, the share, the remaining time (1d 02:03:04)."""


def _fit_bar(label: str, columns: int) -> tuple[str, int]:
    """Return the label, or its end, and the length of a progress bar that together fit into a line: each update of a
    longer line would begin a new one.

    >>> _fit_bar("run.h5", 80), _fit_bar("run.h5", 40), _fit_bar("folder/night_001.h5", 40)
    (('run.h5', 36), ('run.h5', 10), ('..001.h5', 8))
    """
    least, most = _BAR_COLUMNS
    room = max(columns - _BAR_FRAME, least)
    if len(label) + least > room:
        label = f"..{label[-(room - least - 2) :]}" if room - least > 2 else ""
    return label, max(least, min(most, room - len(label)))


@contextmanager
def share_progress(label: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error; yields a function that sets the share of the work that is done."""
    steps = 1000
    with progress(steps, label) as move:
        yield lambda share: move(int(share * steps))


@contextmanager
def bars() -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress bar for each step of the work; yields a function of the step, its progress and its length."""
    with ExitStack() as stack:
        current: tuple[str, Callable[[int], None]] | None = None

        def advance(what: str, done: int, of: int) -> None:
            nonlocal current
            if current is None or current[0] != what:
                stack.close()
                current = what, stack.enter_context(progress(of, what))
            current[1](done)

        yield advance


class Steps:
    """Progress of work in several steps: a bar for each, or, without a terminal, a line on standard error every few
    seconds, even without progress. A context manager.
    """

    def __init__(self) -> None:
        self._label, self._done, self._length, self._begin_s = "", 0, 0, time.monotonic()
        self._watched, self._end = sys.stderr.isatty(), threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)

    def begin(self, label: str) -> None:
        """Begin the next step, whose length is still unknown."""
        self._label, self._done, self._length, self._begin_s = label, 0, 0, time.monotonic()
        if self._watched:
            click.echo(label, err=True)

    @contextmanager
    def bar(self, length: int) -> Iterator[Callable[[int], None]]:
        """Show the progress of the step, whose length is now known; yields a function that sets it."""
        self._done, self._length, self._begin_s = 0, length, time.monotonic()
        with progress(length, "") as move:

            def tell(done: int) -> None:
                self._done = done
                move(done)

            yield tell
        self._done = self._length = 0

    def __enter__(self) -> Self:
        if not self._watched:
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()

    def _tell(self) -> None:
        while not self._end.wait(_EVERY_S):
            took_s = time.monotonic() - self._begin_s
            click.echo(progress_line(self._label, self._done, self._length, took_s), err=True)


def progress_line(label: str, done: int, length: int, took_s: float) -> str:
    """Return the progress of a step (`length` 0: unknown), with the remaining time at the same rate."""
    if not length:
        return f"{label}: {duration(took_s)}"
    remaining = f", {duration(took_s * (length - done) / done)} left" if done else ""
    return f"{label}: {done} of {length} in {duration(took_s)}{remaining}"


@contextmanager
def signal_handlers(handlers: Mapping[int, Any]) -> Iterator[None]:
    """Handle signals by these functions; the earlier handlers are restored at the end."""
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt as Ctrl-C does, so that everything is cleaned up. A SIGHUP that is
    ignored (nohup) stays ignored. Does nothing outside the main thread.
    """
    usual = [number for number in _ENDING[1:] if signal.getsignal(number) is signal.SIG_DFL]
    with signal_handlers(dict.fromkeys(usual, signal.default_int_handler) if _is_main_thread() else {}):
        yield


def _is_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


@contextmanager
def _interrupts() -> Iterator[Callable[[], None]]:
    """Yield a function that raises KeyboardInterrupt again if Python lost one, because it was raised inside a callback
    of the garbage collector.
    """
    asked = False

    def ask(number: int, frame: Any) -> None:
        nonlocal asked
        asked = True
        raise KeyboardInterrupt

    def heed() -> None:
        if asked:
            raise KeyboardInterrupt

    usual = [number for number in _ENDING if signal.getsignal(number) is signal.default_int_handler]
    with signal_handlers(dict.fromkeys(usual, ask) if _is_main_thread() else {}):
        yield heed
