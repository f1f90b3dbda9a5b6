"""`imuarray demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imuarray.commands.options import Duration, PathName, force_option, json_option, print_json, workers_option
from imuarray.shipped import find_config

PAPERS_ARRAY = "martin2013"
"""Name of the array whose demonstration also checks the claims of the paper."""


@click.command("demo")
@click.option(
    "-o",
    "--output",
    default="demo",
    show_default=True,
    type=PathName(file_okay=False),
    help="folder for the logs and the page",
)
@click.option(
    "--seconds",
    default="1600s",
    show_default=True,
    type=Duration(minimum_s=300),
    metavar="30min",
    help="total duration of the recordings, in array time; at least 5min",
)
@click.option(
    "--array",
    default=PAPERS_ARRAY,
    show_default=True,
    help="array that comes with the package (icm42688x8, lsm6dso_pair, mpu9250x4, ...), or a configuration",
)
@click.option("--seed", default=1, show_default=True, help="seed of the emulated noise")
@workers_option
@force_option
@json_option
def command(**options: Any) -> None:
    """Record an emulated array, calibrate it, fuse it, diagnose it, and write report.html.

    No hardware is needed: the chips are emulated register by register.

    \b
    imuarray demo -o demo
    imuarray demo --array icm42688x8 -o demo8
    """
    from imuarray.array import load_array
    from imuarray.report.page import require_page_package
    from imuarray.studies.emulated_runs import DemoOptions

    require_page_package()
    demo_options = DemoOptions(options["seconds"], options["seed"], options["force"], options["workers"])
    config, output = find_config(Path(options["array"])), options["output"]
    name = load_array(config).name
    if name == PAPERS_ARRAY:
        from imuarray.studies.demo import run_demo as run
    else:
        from imuarray.studies.array_demo import run_array_demo as run
    result = run(config, output, demo_options, lambda step: click.echo(f"imuarray: {step}", err=True))
    if options["as_json"]:
        print_json(result)
        return
    subject = "The paper's array" if name == PAPERS_ARRAY else f"The array {name}"
    click.echo(f"{subject}, with its chips emulated register by register: recorded, calibrated, fused, diagnosed.")
    for line in result["summary"]:
        click.echo(f"  {line}")
    click.echo(f"  {result['gap']['sentence']}")
    pages = f"{result['report']} and {result['gap']['page']}"
    click.echo(f"Open {pages}; the logs, the calibration and the fused results are in the same folder.")
