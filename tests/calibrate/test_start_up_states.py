"""Start-up states of sensors: the bias of the state is used, and a sensor in the wrong range is named, while a log is
recorded and before it is fused.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imuarray.array import parse_array
from imuarray.calibrate import load_calibration
from imuarray.calibrate.start_up import StartStateDetector, _restlessness, start_up_states
from imuarray.calibrate.turn_on import calibrate_turn_on
from imuarray.chips import CHIPS
from imuarray.cli import main
from imuarray.log import open_log
from imuarray.log.format import Phase
from imuarray.simulate import EFFECTS, Simulation, plan_of, write_log
from imuarray.simulate.effect import Effect
from imuarray.simulate.motion import HandShake, turn_on_run
from tests.selection import some

TEXT = """
[array]
name = "two"
[[sensor]]
name = "B"
chip = "bma180"
address = 0x40
range = 16
[[sensor]]
name = "B2"
chip = "bma180"
address = 0x41
range = 16
[[sensor]]
name = "G"
chip = "l3g4200d"
address = 0x68
range = 250
"""
ARRAY = parse_array(TEXT)
RANGES = {name: spec.sensitivity for name, spec in CHIPS.items()}
BY_SENSOR = {sensor.name: sensor.spec.sensitivity for sensor in ARRAY.sensors}
OFFSET_DPS = (0.11, -0.05, 0.02)
"""Between the two states; 12.6 counts on x, as the paper's Gyro3 (Table 7)."""


def effect(name: str, **parameters: Any) -> Effect:
    return EFFECTS[name](**parameters)


def write(path: Path, boot: int, *, second: bool, faulty: bool = False) -> Path:
    chains = {
        "G": [effect("white_noise", rms=0.18), effect("bias", offset=0.3), effect("turn_on_bias", rms=0.002)],
        "B": [effect("white_noise", rms=0.016), effect("turn_on_bias", rms=0.0003)],
        "B2": [effect("white_noise", rms=0.016), effect("turn_on_bias", rms=0.0003)],
    }
    if second:
        chains["G"].append(effect("bistable_bias", offset=OFFSET_DPS, probability=1.0))
    if faulty:
        chains["B"].append(effect("range_reset", range=2.0, offset=(0.2, 0.23, 0.004)))
    plan = plan_of(ARRAY, 50.0, 60.0)
    write_log(Simulation(plan, turn_on_run(boot + 1, 60.0), chains, seed=1, boot=boot), path)
    return path


@pytest.fixture(scope="module")
def calibration_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    paths = [write(folder / f"{boot}.h5", boot, second=boot % 3 == 0) for boot in range(12)]
    logs = [open_log(path) for path in paths]
    calibration, _ = calibrate_turn_on(logs, RANGES, seed=1)
    for log in logs:
        log.close()
    calibration.save(folder / "cal.toml")
    return folder / "cal.toml"


@pytest.mark.slow
@pytest.mark.parametrize("second", some([False, True], 1))
def test_the_bias_of_the_state_is_used(calibration_file: Path, tmp_path: Path, second: bool) -> None:
    from imuarray.calibrate import load_calibration

    known = load_calibration(calibration_file)
    with open_log(write(tmp_path / "today.h5", 50, second=second)) as log:
        chosen, starts = start_up_states(log, known, BY_SENSOR)
    lsb_per_dps = 1 / 0.00875  # L3G-40
    expected = [(0.3 + second * offset) * lsb_per_dps for offset in OFFSET_DPS]
    # the bias of a state is known to 0.2 counts (turn-on 0.23, noise 20 / sqrt(3000), over four runs at least)
    assert chosen.sensors["G"].bias_lsb == pytest.approx(expected, abs=1.0)
    turn_on = chosen.sensors["G"].turn_on
    assert turn_on is not None and len(turn_on.states) == 1  # the other state is excluded now
    assert not any(start.fault for start in starts.values())
    assert "started in state" in starts["G"].sentence("G", known)
    assert starts["B"].sentence("B", known) == ""


@pytest.mark.slow
def test_live_fusion_uses_the_same_biases(calibration_file: Path, tmp_path: Path) -> None:
    """The monitor of a recording reads the same first seconds."""
    judge = StartStateDetector(load_calibration(calibration_file), ARRAY.sensitivities)
    before = judge.in_states().sensors["G"].bias_lsb
    with open_log(write(tmp_path / "today.h5", 51, second=True)) as log:
        judge({name: np.asarray(log[name].counts[:500]) for name in ("B", "B2", "G")})
    lsb_per_dps = 1 / 0.00875  # L3G-40
    expected = [(0.3 + offset) * lsb_per_dps for offset in OFFSET_DPS]
    assert judge.in_states().sensors["G"].bias_lsb == pytest.approx(
        expected, abs=3.0
    )  # of 500 readings: 20 / sqrt(500)
    assert before != pytest.approx(expected, abs=3.0)


@pytest.mark.slow
def test_a_sensor_in_the_wrong_range_is_named_and_excluded(
    calibration_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write(tmp_path / "today.h5", 60, second=False, faulty=True)
    arguments = ["fuse", str(run), "--calibration", str(calibration_file), "-o", str(tmp_path / "f.h5"), "--json"]
    assert main(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    (message,) = [text for text in report["start_up"] if text.startswith("B ")]
    assert "started at 2 g" in message
    # B alone would pull the mean of two by half its 0.2 g
    assert abs(report["results"]["mean"]["specific_force"]["mean"][0]) < 0.02 * 9.80665


class Shaken(HandShake):
    """A shaken box whose log has no phase at rest."""

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phase in motion alone."""
        return super().phases[1:2]


class ShakenUpright(Shaken):
    """A shaken box whose log notes the axis that points up."""

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phase in motion with a noted axis."""
        return tuple(phase._replace(up="+Z") for phase in super().phases)


@pytest.mark.slow
def test_a_log_without_rest_reports_no_start_up_fault(calibration_file: Path, tmp_path: Path) -> None:
    """The sensor in the wrong range has a fault after half a second of rest, and none if the log has no rest."""
    from imuarray.calibrate import load_calibration

    known = load_calibration(calibration_file)
    chains = {
        "G": [effect("white_noise", rms=0.18), effect("bias", offset=0.3)],
        "B": [effect("range_reset", range=2.0, offset=(0.2, 0.23, 0.004))],  # starts at 2 g
    }
    faults = list[set[str]]()
    for motion in (HandShake, Shaken, ShakenUpright):
        path = tmp_path / f"{motion.__name__}.h5"
        write_log(Simulation(plan_of(ARRAY, 50.0, 60.0), motion(still_s=0.5, motion_s=59.0), chains), path)
        with open_log(path) as log:
            calibration, starts = start_up_states(log, known, BY_SENSOR)
        faults.append({name for name, start in starts.items() if start.fault})
    assert faults == [{"B"}, set(), set()]
    assert starts == {}
    turn_on = calibration.sensors["G"].turn_on
    assert turn_on is not None and len(turn_on.states) == 2  # neither is excluded


@pytest.mark.slow
def test_log_reports_wrong_states_while_it_records(
    calibration_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The emulated units have their own biases, far from those of the file: all of them start in a wrong state."""
    config = tmp_path / "two.toml"
    config.write_text(TEXT, encoding="utf-8")
    arguments = ["log", str(config), "--bus", "emulated:", "--seconds", "25", "-o", str(tmp_path / "run.h5")]
    assert main([*arguments, "--calibration", str(calibration_file), "--json"]) == 0
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert any(text.startswith("G started in a wrong state") for text in report["start_up"])
    for text in report["start_up"]:
        assert f"imuarray: {text}" in captured.err


def test_restlessness_is_the_ratio_of_variances_by_hand() -> None:
    """Ten parts of four readings, one count to either side of 0 and 10 in turn: 4/3 and a rounding of 1/12 within them,
    a quarter of that in their means; 250 / 9 between them.
    """
    parts = [level + side for level in [0, 10] * 5 for side in (-1, 1, -1, 1)]
    counts = np.array(parts)[:, None] * [0, 1, 0]
    assert _restlessness(counts) == pytest.approx(250 / 9 / ((4 / 3 + 1 / 12) / 4))
