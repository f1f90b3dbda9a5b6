"""Get numbers with uncertainties from a log, with the library alone.

`python configs/examples/night_to_numbers.py [FOLDER]` records the emulated array (use your own log instead),
calibrates it, fuses it and prints the accuracy of the result.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import imuarray as ia
from imuarray.acquire import record
from imuarray.calibrate import calibrate_noise, calibrate_tumble
from imuarray.characterise import characterise_log
from imuarray.fuse import evaluate, fuse


def main(folder: Path = Path()) -> dict[str, float]:
    """Return the results by name; in SI unless the name gives a unit."""
    array = ia.load_array(Path(__file__).parents[1] / "martin2013.toml")
    run = folder / "tumble.h5"
    with ia.open_bus("emulated:?world=tumble&face_s=5", array) as bus:  # or "i2c:/dev/i2c-1"
        faces = getattr(bus, "phases", ())  # only an emulated world says itself which face is up
        record(array, bus, run, rate_hz=50.0, seconds=50.0, phases=faces, force=True)

    with ia.open_log(run) as log:
        tumble = calibrate_tumble(log)
        calibration = tumble.calibration.merged(calibrate_noise(log))
        calibration.save(folder / "calibration.toml", force=True)

        noise = characterise_log(log, phase="z_up", sensors=["Gyro1"])["sensors"][0]["axes"][0]
        low, high = (noise["fit"]["terms"]["white"][end] * noise["unit_per_count"] for end in ("low", "high"))

        gyro = log["Gyro1"]
        bias, sem = calibration.of(gyro).bias_lsb[0], calibration.of(gyro).bias_sem_lsb
        errors = evaluate(log, fuse(log, calibration, "ranges"), [phase for phase in log.phases if phase.up])
    return {
        "Gyro1 x bias in counts": float(bias),
        "its standard error": float(sem[0]) if sem is not None else float("nan"),
        "Gyro1 x white noise, dps/sqrt(Hz), from": low,
        "to": high,
        "BMA3 residual in mg": 1e3 * tumble.residual_g["BMA3"],
        "fused specific force, rms error in m/s2": float(np.linalg.norm(errors["specific_force"].rms)),
    }


if __name__ == "__main__":
    for name, value in main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path()).items():
        print(f"{name:42} {value:10.4f}")
