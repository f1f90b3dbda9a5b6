"""Logs and fused results as files that other tools open; the suffix of the output chooses the writer.

::

    .csv   a text table for each sensor; `imuarray import` restores it
    .npz   numpy's archive, an array for each column, a header in JSON; `imuarray import` restores it
    .parquet  a table for each sensor with types, times and units; `imuarray import` restores it
    .mcap  Foxglove: messages of JSON with their schemas, IMU data in SI in the box frame, events;
           or ROS 2: sensor_msgs in CDR
    .mat   MATLAB, version 5: a struct for each sensor
    .yaml  noise figures of an IMU for Kalibr, OpenVINS or VINS-Fusion, from a log at rest, a fused result at rest
           or characterise.json
    .sdf   the same for Gazebo or PX4
"""

from __future__ import annotations

from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imuarray.errors import ExportError
from imuarray.export.formats import TOOLS, UNITS, WRITERS, ExportRequest, ExportSummary, Progress
from imuarray.spelling import guess

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imuarray.calibrate import Calibration
    from imuarray.log import Log

__all__ = ["TOOLS", "UNITS", "WRITERS", "ExportSummary", "export"]


# This is the interface of the package: keyword-only options with the names of the command's options.
def export(  # noqa: PLR0913
    source: Log | str | PathLike[str],
    path: str | PathLike[str],
    *,
    sensors: Sequence[str] = (),
    calibration: Calibration | None = None,
    units: str | None = None,
    tool: str | None = None,
    force: bool = False,
    progress: Progress = lambda share: None,
) -> ExportSummary:
    """Write a log or a fused file to `path`, in the format of its suffix (`WRITERS`). No partial file remains after an
    error.

    `sensors` are the sensors to export (empty: all). `units` is one of `UNITS`; the default is raw counts with the data
    required to convert them, or SI in the box frame for MCAP and with a `calibration`. `tool` is one of the `TOOLS` of
    the suffix. ExportError for an unknown suffix, unit or tool, LogError, CalibrationError, OutputExistsError,
    OutputError, MissingExtraError.
    """
    target = Path(path)
    write = _writer(target)
    tools = TOOLS.get(target.suffix.lower(), ())
    if tool is not None and tool not in tools:
        tools_text = ", ".join(tools) or "none, because all tools read the same file"
        raise ExportError(f"{path}: tool {tool!r}: allowed for {target.suffix} are {tools_text}{guess(tool, tools)}")
    log_path = source if isinstance(source, str | PathLike) else source.path
    exported: ExportSummary = write(
        ExportRequest(Path(log_path), tuple(sensors), calibration, units, tool), target, force, progress
    )
    return exported


def _writer(path: Path) -> Any:
    module = WRITERS.get(path.suffix.lower())
    if module is None:
        raise ExportError(
            f"{path}: no format has the suffix {path.suffix!r}; allowed are {', '.join(WRITERS)}"
            f"{guess(path.suffix, WRITERS)}"
        )
    return import_module(module).write
