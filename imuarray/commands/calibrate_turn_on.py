"""The report of `imuarray calibrate turn-on`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from imuarray.printable import percent
from imuarray.units import READABLE

if TYPE_CHECKING:
    from imuarray.calibrate import TurnOnResult


def report_of(results: Sequence[TurnOnResult]) -> dict[str, Any]:
    """Return the runs of every sensor, JSON-ready; `p_value` is corrected for the number of axes (Holm)."""
    from imuarray.calibrate import holm

    p_values = holm(np.concatenate([result.p_value for result in results])).reshape(-1, 3)
    return {"sensors": [_sensor(*row) for row in zip(results, p_values.tolist(), strict=True)]}


def _sensor(result: TurnOnResult, p_values: Sequence[float]) -> dict[str, Any]:
    turn_on, slope = result.turn_on(), result.slope_lsb_per_degc
    return {
        "name": result.runs.sensor,
        "unit": result.runs.unit,
        "sensitivity": result.runs.sensitivity,
        "runs": turn_on.runs,
        "rms_lsb": turn_on.rms_lsb.tolist(),
        "rms_sem_lsb": turn_on.rms_sem_lsb.tolist(),
        "run_sd_lsb": result.run_sd_lsb.tolist(),
        "run_freedom": result.run_freedom,
        "in_run_sd_lsb": result.in_run_sd_lsb.tolist(),
        "p_value": list(p_values),
        "slope_lsb_per_degc": None if slope is None else slope.tolist(),
        "p_states": result.p_states,
        "states": [
            {"bias_lsb": state.bias_lsb.tolist(), "share": state.share, "runs": list(state.runs)}
            for state in result.states
        ],
        "apart": [
            {"run": fault.run, "ratio": fault.ratio, "range": fault.range, "explanation": str(fault)}
            for fault in result.apart
        ],
    }


def print_report(report: dict[str, Any]) -> None:
    """Print the change from run to run by axis, then the states, and the runs that started wrong."""
    click.echo(f"{'axis':14} {'runs':>4} {'run to run':>10} {'+-':>8} {'within':>8}  {'run to run':>10}       {'p':>8}")
    click.echo(f"{'':14} {'':>4} {'LSB rms':>10} {'LSB':>8} {'LSB':>8}  {'mg or dps':>10}")
    for row in report["sensors"]:
        factor, unit = READABLE[row["unit"]]
        for index, axis in enumerate("xyz"):
            rms, in_run, p = row["rms_lsb"][index], row["in_run_sd_lsb"][index], row["p_value"][index]
            click.echo(
                f"{row['name'] + ' ' + axis:14} {row['runs']:4} {rms:10.3f} {row['rms_sem_lsb'][index]:8.3f}"
                f" {'-' if in_run is None else f'{in_run:.3f}':>8}  {factor * rms / row['sensitivity']:10.3f} {unit:3}"
                f"  {'-' if p is None else f'{p:.2g}':>8}"
            )
    click.echo(
        "p: probability of such a change if switching on had no effect, corrected for all axes of the array (Holm)"
    )
    for row in report["sensors"]:
        _print_states(row)
        for fault in row["apart"]:
            click.echo(f"{row['name']}: {fault['explanation']}")


def _print_states(row: dict[str, Any]) -> None:
    if len(row["states"]) > 1:
        click.echo(f"{row['name']}: starts in one of {len(row['states'])} states (p {row['p_states']:.2g} by chance)")
        for state in row["states"]:
            bias = ", ".join(f"{value:.2f}" for value in state["bias_lsb"])
            runs = ", ".join(map(str, state["runs"]))
            click.echo(f"  {percent(state['share']):>5} of the runs: bias {bias} LSB; runs {runs}")
