"""`imuarray demo`."""

from __future__ import annotations

from pathlib import Path

import click

from imuarray.commands.options import Duration, force_option, json_option, print_json, workers_option
from imuarray.shipped import find_config


@click.command("demo")
@click.option(
    "-o",
    "--output",
    default="demo",
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="folder for logs and page",
)
@click.option(
    "--seconds",
    default=1600.0,
    show_default=True,
    type=Duration(minimum_s=300),
    metavar="30min",
    help="array time to record, all runs together; at least 5min",
)
@click.option("--seed", default=1, show_default=True, help="draws the emulated noise")
@workers_option
@force_option
@json_option
def command(output: Path, seconds: float, seed: int, workers: int, force: bool, as_json: bool) -> None:
    """Record the emulated paper array, calibrate it, fuse it, diagnose it, and write report.html.

    No hardware is needed: the chips are emulated register by register.

    \b
    imuarray demo -o demo
    """
    from imuarray.studies.demo import run_demo
    from imuarray.studies.emulated_runs import DemoOptions

    options = DemoOptions(seconds, seed, force, workers)
    say = lambda step: click.echo(f"imuarray: {step}", err=True)  # noqa: E731
    result = run_demo(find_config(Path("martin2013")), output, options, say)
    if as_json:
        print_json(result)
        return
    click.echo("The paper's array, emulated to the register: recorded, calibrated, fused, diagnosed.")
    for line in result["summary"]:
        click.echo(f"  {line}")
    click.echo(f"  {result['gap']['sentence']}")
    pages = f"{result['report']} and {result['gap']['page']}"
    click.echo(f"Open {pages}; the logs, the calibration and the fused results are in the same folder.")
