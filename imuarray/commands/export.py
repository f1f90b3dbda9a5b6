"""`imuarray export`."""

from __future__ import annotations

from pathlib import Path

import click

from imuarray.commands.options import force_option, json_option, print_json, progress, refuse_existing
from imuarray.export import TOOLS, UNITS, WRITERS
from imuarray.printable import counted

_STEPS = 1000


@click.command("export")
@click.argument("source", metavar="RUN.h5", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    metavar=f"RUN{'|'.join(WRITERS)}",
    help="the file to write; its suffix chooses the format",
)
@click.option("--sensor", "sensors", default="", metavar="NAME,...", help="only these sensors (default: everything)")
@click.option(
    "--calibration",
    "calibration_file",
    type=click.Path(path_type=Path),
    metavar="CAL.toml",
    help="calibrated values, in SI along the axes of the box",
)
@click.option(
    "--units",
    type=click.Choice(UNITS),
    help="counts; si (m/s2, rad/s) or sensor (g, dps), by the calibration or else the data sheets"
    " (default: counts, or si with a calibration and in .mcap)",
)
@click.option(
    "--tool",
    type=click.Choice([tool for tools in TOOLS.values() for tool in tools]),
    help=f"for which tool ({'; '.join(f'{suffix}: ' + ', '.join(tools) for suffix, tools in TOOLS.items())};"
    " default: the first)",
)
@force_option
@json_option
def command(
    source: Path,
    output: Path,
    sensors: str,
    calibration_file: Path | None,
    units: str | None,
    tool: str | None,
    force: bool,
    as_json: bool,
) -> None:
    """Write a log or a fused result as a file that other tools open.

    \b
    .csv   a table for each sensor: spreadsheets, pandas; run.csv says which,
           run.json the rest
    .npz   numpy, an array a column
    .parquet  a typed table for each sensor: pandas, Polars, DuckDB
    .mcap  Foxglove; with --tool ros2 a bag of sensor_msgs
    .mat   MATLAB (which also reads RUN.h5 itself: h5read)
    .yaml  noise for Kalibr, OpenVINS, VINS-Fusion, from rest (log, fused result)
    .sdf   noise for Gazebo, PX4

    .csv, .npz and .parquet of raw counts come back by `imuarray import`, equal.

    \b
    imuarray export run.h5 --calibration cal.toml -o run.mcap
    """
    from imuarray.calibrate import load_calibration
    from imuarray.export import export

    refuse_existing(output, force, source=source)
    calibration = load_calibration(calibration_file) if calibration_file else None
    names = tuple(sensors.split(",")) if sensors else ()
    with progress(_STEPS, str(output)) as done:
        written = export(
            source,
            output,
            sensors=names,
            calibration=calibration,
            units=units,
            tool=tool,
            force=force,
            progress=lambda share: done(int(share * _STEPS)),
        )
    if as_json:
        files = [str(file) for file in written.files]
        said = {"files": files, "units": written.units, "rows": dict(written.rows)}
        print_json(
            {"source": str(source), **said, "uncalibrated": list(written.uncalibrated), "notes": list(written.notes)}
        )
        return
    rows, tables = sum(written.rows.values()), counted(len(written.rows), "table")
    click.echo(f"{output}: {rows} rows of {tables}, units: {written.units}")
    if written.uncalibrated:
        click.echo(f"  not calibrated, data-sheet values used: {', '.join(written.uncalibrated)}")
    for note in written.notes:
        click.echo(f"  {note}")
    for file in written.files:
        if file != output:
            click.echo(f"  {file}")
