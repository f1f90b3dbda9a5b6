"""How long a diagnosis takes on two processes, beside the time that a user is asked to wait for it.

There is no other program to compare with: the peer is the bound, 60 s for ten minutes of the whole array at rest, 200 s
for a campaign of the paper's size (rest, six faces, heating, fifteen boots, shaking: 4.6 million readings of nine
triads) and 100 s for one of the same size without a gap, as the data sheets have it.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from click.testing import CliRunner
from compare import Row, row

from imuarray.cli import program
from imuarray.gap.diagnose import diagnose

_RATE_HZ = "28"
_BOUNDS_S = {
    "ten minutes at rest, nine triads": 60.0,
    "a campaign of the paper's size": 200.0,
    "a campaign of that size without a gap": 100.0,
}
_TRIADS = ("ADXL1", "ADXL2", "BMA1", "BMA2", "BMA3", "BMA4", "Gyro1", "Gyro2", "Gyro3")


def rows() -> list[Row]:
    """The static log alone, then all experiments, then these without what makes a gap."""
    with tempfile.TemporaryDirectory() as name:
        logs, control = (_recorded(Path(name) / model, model) for model in ("martin2013", "datasheet"))
        chosen = ([path for path in logs if path.stem == "static"], logs, control)
        return [
            row(f"gap diagnose: {what}", _seconds(paths), bound_s, "s", 1.0, "lower")
            for (what, bound_s), paths in zip(_BOUNDS_S.items(), chosen, strict=True)
        ]


def _recorded(folder: Path, model: str) -> list[Path]:
    """The array of the paper, simulated with all effects of a model."""
    folder.mkdir()
    for experiment in ("static", "tumble", "heating", "motion", "turn-on"):
        words = ["simulate", "martin2013", "--model", model, "--experiment", experiment]
        words += ["--rate-hz", _RATE_HZ, "--seed", "5", "-o", str(folder / f"{experiment}.h5")]
        CliRunner().invoke(program, words, catch_exceptions=False)
    return sorted(folder.glob("*.h5"))


def _seconds(paths: Sequence[Path]) -> float:
    begin = time.perf_counter()
    diagnose(paths, only=_TRIADS, workers=2)
    return time.perf_counter() - begin
