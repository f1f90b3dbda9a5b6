"""`imuarray export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from imuarray.commands.options import (
    argument,
    force_option,
    json_option,
    only_option,
    option,
    output_option,
    parameter,
    print_json,
    refuse_existing,
    report_doubts_of,
    share_progress,
    takes,
)
from imuarray.export import TOOLS, UNITS, WRITERS
from imuarray.printable import counted, listed


@dataclass(frozen=True)
class ExportOptions:
    """The options of `imuarray export`."""

    source: Path = argument(metavar="RUN.h5")
    output: Path = output_option(
        required=True,
        metavar=f"RUN{'|'.join(WRITERS)}",
        help="the file to write; its suffix chooses the format",
    )
    only: tuple[str, ...] = parameter(only_option("only these sensors (default: everything)"))
    calibration_file: Path | None = option(
        "--calibration", metavar="CAL.toml", help="write calibrated values, in SI along the axes of the box"
    )
    units: str | None = option(
        type=click.Choice(UNITS),
        help=(
            "counts; si (m/s2, rad/s) or sensor (g, dps), converted by the calibration or else the data sheets"
            " (default: counts, or si with a calibration and in .mcap)"
        ),
    )
    tool: str | None = option(
        type=click.Choice([tool for tools in TOOLS.values() for tool in tools]),
        help=(
            "the tool that will read the file"
            f" ({'; '.join(f'{suffix}: ' + ', '.join(tools) for suffix, tools in TOOLS.items())}; default: the first)"
        ),
    )
    force: bool = parameter(force_option)
    as_json: bool = parameter(json_option)


@click.command("export")
@takes(ExportOptions)
def command(options: ExportOptions) -> None:
    """Write a log or a fused result as a file that other tools open.

    \b
    .csv   spreadsheets, pandas: a table for each sensor; run.csv lists them,
           run.json holds the rest
    .npz   NumPy: an array for each column
    .parquet  pandas, Polars, DuckDB: a typed table for each sensor
    .mcap  Foxglove; with --tool ros2 a ROS 2 bag of sensor_msgs
    .mat   MATLAB (which can also read RUN.h5 with h5read)
    .yaml  Kalibr, OpenVINS, VINS-Fusion: noise at rest, from a log or fused result
    .sdf   Gazebo, PX4: noise at rest

    `imuarray import` restores .csv, .npz and .parquet files of raw counts without loss.

    \b
    imuarray export run.h5 --calibration cal.toml -o run.mcap
    """
    from imuarray.calibrate import load_calibration
    from imuarray.export import export

    refuse_existing(options.output, options.force, source=options.source)
    calibration = load_calibration(options.calibration_file) if options.calibration_file else None
    with share_progress(str(options.output)) as progress:
        summary = export(
            options.source,
            options.output,
            sensors=options.only,
            calibration=calibration,
            units=options.units,
            tool=options.tool,
            force=options.force,
            progress=progress,
        )
    report_doubts_of(options.source)
    if options.as_json:
        files = [str(file) for file in summary.files]
        print_json({"source": str(options.source), **summary._asdict(), "files": files})
        return
    rows, tables = sum(summary.rows.values()), counted(len(summary.rows), "table")
    click.echo(f"{options.output}: {rows} rows of {tables}, units: {summary.units}")
    if summary.uncalibrated:
        click.echo(f"  not calibrated, nominal values used: {listed(summary.uncalibrated)}")
    for note in summary.notes:
        click.echo(f"  {note}")
    for file in summary.files:
        if file != options.output:
            click.echo(f"  {file}")
