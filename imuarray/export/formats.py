"""File formats, the request for an export and its summary. It imports nothing, because `--help` needs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from imuarray.calibrate import Calibration

WRITERS: Mapping[str, str] = {
    ".csv": "imuarray.export.csv_files",
    ".npz": "imuarray.export.npz_file",
    ".parquet": "imuarray.export.parquet_files",
    ".mcap": "imuarray.export.mcap_file",
    ".mat": "imuarray.export.mat_file",
    ".yaml": "imuarray.export.noise_files",
    ".sdf": "imuarray.export.noise_files",
}
"""The module that writes each suffix, imported when it is needed: `write(request, path, force, progress)`."""

TOOLS: Mapping[str, tuple[str, ...]] = {
    ".mcap": ("foxglove", "ros2"),
    ".yaml": ("kalibr", "openvins", "vins-fusion"),
    ".sdf": ("gazebo", "px4"),
}
"""The tools for which the files of a suffix differ; the first is the default."""

UNITS = ("counts", "si", "sensor")
"""Raw counts along the sensor's axes; m/s2, rad/s, T in the box frame; g, dps, gauss in the box frame."""

CSV_VERSION = "imuarray_csv"
"""First entry of the JSON file that accompanies CSV files."""
CSV_MAGIC = "# imuarray-csv 1: "
"""Beginning of the CSV files of earlier versions, which had two comment lines instead of the JSON file."""
CSV_INDEX = ("file", "table", "rows")
CSV_PHASES = ("start_s", "end_s", "name", "up")
CSV_EVENTS = ("time_s", "sensor", "kind", "message")
CSV_SUFFIX: Mapping[str, str] = {
    "m s-2": "_mps2",
    "rad s-1": "_radps",
    "m2 s-4": "_m2ps4",
    "rad2 s-2": "_rad2ps2",
    "T": "_t",
    "Pa": "_pa",
    "degC": "_degc",
    "ns": "_ns",
    "g": "_g",
    "dps": "_dps",
    "gauss": "_gauss",
}
"""The suffix of a column's name for each unit; counts and flags have none."""


def csv_names(column: str, cells: Sequence[str], unit: str) -> list[str]:
    """Return the names of a column's cells: time_s, counts_x, specific_force_x_mps2, temperature_degc."""
    if column == "time":
        return ["time_s"]
    suffix = CSV_SUFFIX.get(unit, "")
    return [f"{column}{cell}{suffix}" for cell in [f"_{cell}" for cell in cells] or [""]]


PARQUET_HEAD = "imuarray"
"""The entry of a Parquet file's metadata with everything except the columns, as JSON."""

NPZ_HEADER = "header"
"""The array of an npz file with everything except the columns: the bytes of a JSON object."""

Progress = Callable[[float], None]
"""Callback that receives the completed share of the work, 0 to 1."""


class ExportRequest(NamedTuple):
    """A request for an export: a log or fused file, its `sensors` (empty: everything), one of `UNITS` (None: the
    default of the format), a calibration for the conversion (None: values of the data sheets), and one of `TOOLS`
    (None: the first of the format).
    """

    source: Path
    sensors: tuple[str, ...] = ()
    calibration: Calibration | None = None
    units: str | None = None
    tool: str | None = None


class ExportSummary(NamedTuple):
    """The result of an export: files, rows by table, their units (one of `UNITS`), the sensors without a calibration,
    which were converted with values of the data sheets, and sentences on missing data.
    """

    files: tuple[Path, ...]
    rows: Mapping[str, int]
    units: str
    uncalibrated: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
