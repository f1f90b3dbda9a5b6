"""`imuarray demo`: the whole path on the emulated array, from the bus to a page.

Four runs are recorded: the six faces of the box, a long rest, a heating, and a shaking that leaves the low range. The
first calibrates the array; the others show what each technique gains over the simple average of the same sensors. The
emulated world knows the truth, so every gain is measured. In the end three of the sensors at rest are compared with
what a simulator that knows nothing but data sheets makes of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from imuarray.calibrate import Calibration, calibrate_noise, calibrate_tumble
from imuarray.characterise import characterise_log
from imuarray.demo import sections
from imuarray.demo.comparison import compare, summary
from imuarray.demo.recording import RUNS, Say, record_all
from imuarray.errors import OutputExistsError
from imuarray.fuse import fuse, write_fused
from imuarray.gap.diagnose import diagnose
from imuarray.gap.findings.diagnosis import Diagnosis
from imuarray.log import open_log
from imuarray.report import write_page
from imuarray.report.gap_page import write_gap_page

FUSED = ("mean", "opposed")
"""Techniques whose result on the heating run is kept as a file."""

DIAGNOSED = ("ADXL1", "BMA2", "Gyro1")
"""One sensor of each inertial chip."""

_REPLICATES = 60


def run_demo(config: Path, folder: Path, *, seconds: float, seed: int, force: bool, say: Say) -> dict[str, Any]:
    """Record, calibrate, fuse and report into `folder`; the summary, JSON-ready.

    `seconds` of array time are recorded in all. OutputExistsError before anything is recorded, unless `force`.
    """
    _prepare(folder, force)
    logs = record_all(config, folder, seconds, seed, say)
    say("calibrating")
    with open_log(logs["tumble"]) as log:
        tumble = calibrate_tumble(log)
        calibration = tumble.calibration.merged(calibrate_noise(log))
    calibration.save(folder / "calibration.toml", force=True)
    say("fusing")
    _fuse_heating(logs["heating"], calibration, folder)
    rows = compare(logs, calibration)
    say("diagnosing")
    diagnosis = _diagnosed(logs["static"], seed)
    write_gap_page(folder / "gap.html", diagnosis, force=True)
    say("drawing")
    with open_log(logs["static"]) as log:
        noise = characterise_log(log)
    lines = summary(rows)
    title = "An emulated array, recorded, calibrated and fused"
    parts = [
        sections.gain_section(rows),
        sections.heating_section(logs["heating"], calibration),
        sections.motion_section(logs["shaking"], calibration),
        sections.recorded_section(logs),
        sections.calibration_section(tumble),
        sections.noise_section(noise),
        sections.gap_section(diagnosis),
    ]
    write_page(folder / "report.html", title, lines, parts, force=True)
    return {
        "folder": str(folder),
        "report": str(folder / "report.html"),
        "summary": lines,
        "gains": [{"case": case.label, **vars(gain)} for case, gain in rows],
        "residual_mg": {name: 1e3 * value for name, value in tumble.residual_g.items()},
        "gap": {"verdict": diagnosis.verdict, "sentence": diagnosis.sentence, "page": str(folder / "gap.html")},
    }


def _prepare(folder: Path, force: bool) -> None:
    """The folder exists and holds none of our files, or `force` was said."""
    folder.mkdir(parents=True, exist_ok=True)
    ours = [
        "report.html",
        "gap.html",
        "calibration.toml",
        *(f"{run}.h5" for run in RUNS),
        *(f"fused_{name}.h5" for name in FUSED),
    ]
    for name in ours:
        if (folder / name).exists() and not force:
            raise OutputExistsError(folder / name)


def _diagnosed(path: Path, seed: int) -> Diagnosis:
    """Some sensors at rest beside what their data sheets say."""
    with open_log(path) as log:
        return diagnose([log], only=DIAGNOSED, seed=seed, replicates=_REPLICATES)


def _fuse_heating(path: Path, calibration: Calibration, folder: Path) -> None:
    """Fused files of the heating run."""
    with open_log(path) as log:
        for name in FUSED:
            blocks = fuse(log, calibration, name)
            write_fused(folder / f"fused_{name}.h5", blocks, epoch=log.epoch, technique=name, log=str(path), force=True)
