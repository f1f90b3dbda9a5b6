"""`imuarray report`."""

from __future__ import annotations

from pathlib import Path

import click

from imuarray.commands.options import (
    PathName,
    force_option,
    json_option,
    print_json,
    refuse_existing,
    share_progress,
    workers_option,
)


@click.command("report")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=PathName())
@click.option("-o", "--output", required=True, type=PathName(), metavar="report.html", help="the page")
@click.option("--title", default="", metavar="TEXT", help="heading of the page (default: the names of the files)")
@workers_option
@force_option
@json_option
def command(files: tuple[Path, ...], output: Path, title: str, workers: int, force: bool, as_json: bool) -> None:
    """Write one HTML page about any logs, calibrations, fused results, gap diagnoses and validation runs.

    A folder means all the files in it. The page is self-contained and can be printed. If there is a calibration among
    the files, noise and residuals are in its units.

    \b
    imuarray report heating.h5 cal.toml fused.h5 gap/ -o report.html
    """
    from imuarray.report.files import file_kind, reportable_files, write_report
    from imuarray.report.page import require_page_package

    require_page_package()
    if not output.is_dir() and output.suffix.lower() not in (".html", ".htm"):
        name = output.with_suffix(".html").name if output.suffix else f"{output.name}.html"
        raise click.UsageError(f"{output}: a report is an HTML page; name it {name}")
    for path in (member for file in files for member in reportable_files(file)):
        refuse_existing(output, force, source=path if path.is_file() else None)
        file_kind(path)
    with share_progress("report") as progress:
        kinds = write_report(files, output, title=title, force=force, progress=progress, workers=workers)
    if as_json:
        print_json({"report": str(output), "files": kinds})
    else:
        parts = ", ".join(f"{Path(path).name} ({kind})" for path, kind in kinds.items())
        click.echo(f"wrote {output}: {parts}")
