"""Thermometers and references of other rigs, from their recording to `calibrate thermal`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate.segments import thermometer_of
from imuarray.calibrate.thermal import calibrate_thermal
from imuarray.cli import main
from imuarray.importers.table import import_table
from imuarray.log import open_log
from imuarray.log.format import ThermometerScale
from imuarray.simulate.motion.like import LikeLog
from tests.selection import some

ROWS = 12_000
SLOPE_LSB_PER_DEGC = 3.0
ACC = """
[[sensor]]
name = "Acc"
chip = "any"
quantity = "specific_force"
columns = ["x", "y", "z"]
unit = "g"
range = 2
sensitivity = 16384
"""
TIME = '[time]\ncolumn = "t"\nunit = "s"\n'


def warming(folder: Path) -> np.ndarray:
    """20 minutes at 10 Hz of a sensor that warms up from 15 to 35 degC (time constant 300 s), z up; its temperature."""
    rng = np.random.default_rng(4)
    time_s = np.arange(ROWS) / 10
    degc = 35 - 20 * np.exp(-time_s / 300)
    counts = np.rint([0, 0, 16384] + rng.normal(0, 20, (ROWS, 3)) + SLOPE_LSB_PER_DEGC * degc[:, None]).astype(int)
    codes = np.rint((degc - 36.53) * 340).astype(int)
    lines = [
        f"{t:.1f},{x},{y},{z},{code},{d:.2f},{d + 273.15:.2f},{9.80665:.5f}"
        for t, (x, y, z), code, d in zip(time_s, counts.tolist(), codes.tolist(), degc.tolist(), strict=True)
    ]
    (folder / "data.csv").write_text("\n".join(["t,x,y,z,code,degc,kelvin,up", *lines]) + "\n")
    return np.asarray(degc)


def imported(folder: Path, more: str, sensor: str = "") -> Path:
    (folder / "map.toml").write_text(TIME + ACC + sensor + more)
    import_table(folder / "data.csv", folder / "map.toml", folder / "run.h5")
    return folder / "run.h5"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "more", "kind"),
    some(
        [
            ('temperature_column = "kelvin"\nthermometer = { unit = "K", lsb_per_degc = 50 }\n', "", "chip"),
            ('temperature_column = "code"\nthermometer = { zero_degc = 36.53, lsb_per_degc = 340 }\n', "", "chip"),
            ('temperature_column = "degc"\nthermometer = { unit = "degC" }\n', "", "chip"),
            ("", '[[thermometer]]\nname = "Baro"\ncolumn = "degc"\nunit = "degC"\n', "chip"),
            ("", '[[thermometer]]\nname = "Die"\ncolumn = "code"\nzero_degc = 36.53\nlsb_per_degc = 340\n', "chip"),
            ("", '[reference]\ntemperature = { column = "kelvin", unit = "K" }\n', "reference"),
        ],
        1,
    ),
)
def test_slopes_are_calibrated_with_an_imported_temperature(sensor: str, more: str, kind: str, tmp_path: Path) -> None:
    degc = warming(tmp_path)
    with open_log(imported(tmp_path, more, sensor)) as log:
        result = thermometer_of(log, log["Acc"], 5.0)
        assert result is not None and result.kind == kind
        np.testing.assert_allclose(result.at(np.array([300.0, 900.0])), degc[[3000, 9000]], atol=0.05)
        thermal = calibrate_thermal(log).calibration.sensors["Acc"].thermal
        assert thermal is not None
        error = np.asarray(thermal.slope_sem_lsb_per_degc)
        assert (np.abs(thermal.slope_lsb_per_degc - SLOPE_LSB_PER_DEGC) < np.maximum(4 * error, 0.1)).all()


@pytest.mark.slow
def test_a_simulation_uses_the_temperature_of_the_external_thermometer(tmp_path: Path) -> None:
    """The chip has counts of temperature of unknown scale in addition."""
    degc = warming(tmp_path)
    more = '[[thermometer]]\nname = "Baro"\ncolumn = "degc"\nunit = "degC"\n'
    with open_log(imported(tmp_path, more, 'temperature_column = "code"\n')) as log:
        like = LikeLog(log)
        assert like.temperature_source == "chip"
        times_ns = np.array([300, 900], np.int64) * 10**9
        np.testing.assert_allclose(like.stimulus(times_ns).temperature_degc, degc[[3000, 9000]], atol=0.3)


@pytest.mark.slow
def test_every_command_accepts_an_external_thermometer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warming(tmp_path)
    run = imported(tmp_path, '[[thermometer]]\nname = "Baro"\nchip = "bmp085"\ncolumn = "degc"\nunit = "degC"\n')
    with open_log(run) as log:
        assert log["Baro"].thermometer == ThermometerScale(0.0, 100.0)
        np.testing.assert_allclose(log["Baro"].compensated("temperature")[:3], [15, 15.01, 15.01], atol=0.02)
    for arguments in (
        ["info", str(run)],
        ["verify", str(run)],
        ["characterise", str(run)],
        ["export", str(run), "-o", str(tmp_path / "run.npz")],
        ["export", str(run), "-o", str(tmp_path / "si.csv"), "--units", "si"],
        ["import", str(tmp_path / "run.npz"), "-o", str(tmp_path / "again.h5")],
        ["calibrate", "thermal", str(run), "-o", str(tmp_path / "cal.toml")],
        ["simulate", "--like", str(run), "-o", str(tmp_path / "sim.h5")],
    ):
        assert main(arguments) == 0, capsys.readouterr().err


@pytest.mark.slow
def test_a_reference_has_only_the_named_columns(tmp_path: Path) -> None:
    warming(tmp_path)
    run = imported(tmp_path, '[reference]\ntemperature = { column = "degc" }\n')
    with open_log(run) as log:
        assert log.reference is not None
        assert log.reference.specific_force is None and log.reference.angular_rate is None
        assert log.reference.temperature is not None and len(log.reference.temperature) == ROWS
    assert main(["verify", str(run)]) == 0
    for suffix in (".npz", ".csv"):
        assert main(["export", str(run), "-o", str(tmp_path / f"run{suffix}")]) == 0
        assert main(["import", str(tmp_path / f"run{suffix}"), "-o", str(tmp_path / f"again{suffix}.h5")]) == 0
        with open_log(tmp_path / f"again{suffix}.h5") as log:
            assert log.reference is not None and log.reference.angular_rate is None
            assert log.reference.temperature is not None


def test_a_reference_in_any_unit_is_converted(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text(
        "t,x,y,z,fx,fy,fz,wx,wy,wz\n0,1,2,3,1,0,-0.5,180,0,90\n1,1,2,3,,,,,,\n2,1,2,3,0,0,1,0,0,0\n"
    )
    reference = """
[reference]
specific_force = { columns = ["fx", "fy", "fz"], unit = "g" }
angular_rate = { columns = ["wx", "wy", "wz"], unit = "dps" }
"""
    with open_log(imported(tmp_path, reference)) as log:
        assert log.reference is not None
        assert log.reference.time[:].tolist() == [0, 2_000_000_000]
        force, rate = log.reference.specific_force, log.reference.angular_rate
        assert force is not None and rate is not None
        np.testing.assert_allclose(force[0], [9.80665, 0, -4.903325])
        np.testing.assert_allclose(rate[0], [np.pi, 0, np.pi / 2])


@pytest.mark.slow
def test_the_option_up_names_the_face(tmp_path: Path) -> None:
    """`--up` of the command, and of a phase."""
    warming(tmp_path)
    imported(tmp_path, "")
    arguments = ["import", str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o"]
    assert main([*arguments, str(tmp_path / "up.h5"), "--up", "-X"]) == 0
    with open_log(tmp_path / "up.h5") as log:
        assert [(phase.name, phase.up) for phase in log.phases] == [("x_down", "-X")]
        assert log.phases[0].end_ns == log["Acc"].time[-1] + 1
    imported_phases = '[[phase]]\nname = "upright"\nup = "+Z"\nseconds = [1.5, 700.0]\n'
    (tmp_path / "map.toml").write_text(TIME + ACC + imported_phases)
    assert main([*arguments, str(tmp_path / "phases.h5")]) == 0
    with open_log(tmp_path / "phases.h5") as log:
        (phase,) = log.phases
        assert (phase.start_ns, phase.end_ns, phase.up) == (1_500_000_000, 700_000_000_000, "+Z")
    assert main([*arguments, str(tmp_path / "both.h5"), "--up", "-X"]) == 2


def test_a_temperature_with_blank_cells_is_a_separate_thermometer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Many recorders read the temperature in every tenth row only."""
    rows = [f"{row / 100:.2f},1,2,4096,{25 if row % 10 == 0 else ''}" for row in range(100)]
    (tmp_path / "data.csv").write_text("t,x,y,z,temp\n" + "\n".join(rows) + "\n", encoding="utf-8")
    sensor = (
        'time = { column = "t", unit = "s" }\n[[sensor]]\nname = "A"\nchip = "any"\nquantity = "specific_force"\n'
        'columns = ["x", "y", "z"]\nunit = "g"\nrange = 8\nsensitivity = 4096\n'
    )
    within = sensor + 'temperature_column = "temp"\nthermometer = { unit = "degC" }\n'
    apart = sensor + '[[thermometer]]\nname = "T"\ncolumn = "temp"\nunit = "degC"\n'
    for text, code in ((within, 2), (apart, 0)):
        (tmp_path / "map.toml").write_text(text, encoding="utf-8")
        arguments = [str(tmp_path / "data.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(tmp_path / "run.h5")]
        assert main(["import", *arguments]) == code
    assert "line 3, column 'temp': no temperature; a column with blank cells is a [[thermometer]]" in (
        capsys.readouterr().err
    )
