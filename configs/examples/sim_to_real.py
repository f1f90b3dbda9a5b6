"""From logs to a diagnosis in thirty lines: `python configs/examples/sim_to_real.py [FOLDER]`.

The logs are simulated, so the example runs anywhere; replace them by your own. FOLDER (default: sim_to_real) holds
all files that it writes. Figures need the extra "report", tables the extra "analysis".
"""

import sys
from pathlib import Path

import imuarray as ia
from imuarray.simulate import EFFECTS


def main(folder: Path) -> dict[str, object]:
    """The results, by name."""
    folder.mkdir(exist_ok=True)
    hum = EFFECTS["tone"](amplitude=0.6, frequency_hz=11.0)  # dps: unknown to the simulator below
    tumble = ia.simulate("martin2013", folder / "tumble.h5", experiment="tumble", seconds=70, seed=1, force=True)
    night = ia.simulate("martin2013", folder / "night.h5", seconds=120, effects={"Gyro2": [hum]}, seed=1, force=True)
    print(night["Gyro1"].to_pandas().filter(like="angular_rate").std())  # rad/s, in the box frame

    poses = ia.calibrate_tumble(tumble)
    calibration = poses.calibration.merged(ia.calibrate_noise(tumble))
    calibration.save(folder / "cal.toml", force=True)
    fused = ia.fuse(night, calibration, "optimal")
    print(fused.specific_force.mean(axis=0), fused.standard_error("specific_force").mean(axis=0))  # m/s2

    noise = ia.characterise(night, calibration=calibration)
    noise.plot("allan").savefig(folder / "allan.svg")
    print(noise.coefficient("Gyro1", "x", "white"))  # dps/sqrt(Hz), with its 95 % interval

    diagnosis = ia.diagnose([tumble, night], only=["Gyro1", "Gyro2"], replicates=40)
    diagnosis.plot().savefig(folder / "diagnosis.svg")
    print(diagnosis.sentence)
    return {"fused": fused, "noise": noise, "poses": poses, "diagnosis": diagnosis}


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("sim_to_real"))
