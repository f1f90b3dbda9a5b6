"""`imuarray characterise`: printed output, files, refusals, and the figure."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imuarray.characterise import Characterisation, characterise_log, plots
from imuarray.characterise.plots import COLOURS, allan_figure
from imuarray.cli import main
from imuarray.commands import characterise
from imuarray.commands.characterise import json_text
from imuarray.errors import MissingExtraError, OutputError
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import SensorHeader
from imuarray.report.files import write_report


def test_the_command_prints_the_table(log_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["characterise", str(log_path)]) == 0
    out, err = capsys.readouterr()
    assert "specific force in g" in out
    assert "angular rate in dps" in out
    assert err == ""


def test_the_command_prints_json_of_one_sensor(log_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["characterise", str(log_path), "--json", "--sensor", "G", "--phase", "motion"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [sensor["name"] for sensor in result["sensors"]] == ["G"]
    assert result["stretch"]["phase"] == "motion"


@pytest.mark.slow
def test_the_command_writes_files_and_overwrites_only_with_force(
    log_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new" / "folder"
    arguments = ["characterise", str(log_path), "-o", str(folder)]
    assert main(arguments) == 0
    files = {path.name for path in folder.iterdir()}
    assert {"allan.png", "characterise.json", "imu_A.yaml", "imu_E.yaml", "imu_G.yaml"} <= files
    assert (folder / "allan.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert json.loads((folder / "characterise.json").read_text())["confidence"] == 0.95
    (folder / "characterise.json").write_text("mine")
    capsys.readouterr()
    assert main(arguments) == 2
    assert "characterise.json: exists already" in capsys.readouterr().err
    assert (folder / "characterise.json").read_text() == "mine"
    assert main([*arguments, "--force"]) == 0
    assert (folder / "characterise.json").read_text() != "mine"


def test_the_error_of_a_figure_names_the_files_that_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def save(path: Path, *_: object, **__: object) -> None:
        if path.name == "b.png":
            raise OutputError(path, OSError(errno.ENOSPC, ""))

    monkeypatch.setattr(characterise, "save_figure", save)
    monkeypatch.setattr(plots, "FIGURES", dict.fromkeys(("a.png", "b.png", "c.png"), lambda result: None))
    with pytest.raises(OutputError) as error:
        characterise._write({}, tmp_path)
    assert str(error.value) == (
        f"{tmp_path / 'b.png'}: can't be written: No space left on device; "
        "characterise.json is written, but not b.png, c.png and the Kalibr files"
    )
    assert error.value.exit_code == 3


@pytest.mark.slow
def test_the_command_works_without_matplotlib(
    log_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with open_log(log_path) as log, pytest.raises(MissingExtraError, match=r"imuarray\[report\]"):
        allan_figure(characterise_log(log, sensors=["P"]))
    assert main(["characterise", str(log_path), "-o", str(tmp_path)]) == 0
    files = {path.name for path in tmp_path.iterdir()}
    assert "characterise.json" in files
    assert not {name for name in files if name.endswith(".png")}
    assert "no figures: this needs matplotlib" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--phase", "room"], "no phase 'room'; it has static, motion"),
        (["--sensor", "A,Q"], "no sensor 'Q'; it has A, E, G, P"),
        (["-o", "{log}"], "is a file"),
    ],
)
def test_invalid_input_gives_one_line(
    log_path: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["characterise", str(log_path), *(item.format(log=log_path) for item in arguments)]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert len(err.splitlines()) == 1
    assert out == ""


@pytest.mark.slow
def test_the_figure_has_a_panel_per_quantity(log_path: Path) -> None:
    with open_log(log_path) as log:
        figure = allan_figure(characterise_log(log, sensors=["A", "E", "G", "P"]))
    panels = figure.get_axes()
    assert [panel.get_ylabel() for panel in panels] == [f"Allan deviation ({u})" for u in ("g", "dps", "counts")]
    accelerometers = [line for line in panels[0].get_lines() if line.get_color() in COLOURS and not line.get_gid()]
    assert len(accelerometers) == 6
    shortest = accelerometers[0].get_xydata()[0]
    assert shortest == pytest.approx([0.01, 20 / 5460], rel=0.1)


@pytest.mark.slow
def test_a_figure_of_many_or_no_curves_is_drawn(log_path: Path) -> None:
    with open_log(log_path) as log:
        result = characterise_log(log, sensors=["A"])
    many = [result["sensors"][0] | {"name": f"$A{number}"} for number in range(32)]
    figure = allan_figure(result | {"sensors": many, "log": "cost_$5$_^.h5"})
    figure.canvas.draw()
    colours = [line.get_color() for line in figure.get_axes()[0].get_lines()]
    assert len({tuple(colour) for colour in colours if not isinstance(colour, str)}) == 32
    assert allan_figure(result | {"sensors": []}).get_axes() == []


@pytest.mark.slow
def test_heavy_packages_are_imported_only_when_needed() -> None:
    """The library needs NumPy and h5py until intervals or figures are asked for; a figure never loads pyplot."""
    code = (
        "import sys, imuarray.commands.characterise; assert 'numpy' not in sys.modules\n"
        "import imuarray.characterise, imuarray.characterise.plots as plots\n"
        "assert not {'scipy', 'matplotlib'} & set(sys.modules)\n"
        "plots.allan_figure({'sensors': [], 'source': 'i2c', 'log': 'x', "
        "'stretch': {'phase': None, 'start_s': 0.0, 'end_s': 1.0}})\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_log_without_phases_is_characterised_where_it_rests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Shaken for twenty seconds after a rest of ten; the next rest is after the end of the log: the first rest is the
    longest.
    """
    from dataclasses import replace as changed

    from imuarray.array import parse_array
    from imuarray.simulate import EFFECTS, Simulation, plan_of, write_log
    from imuarray.simulate.motion import HandShake

    class Unlabelled(HandShake):
        phases = ()

    array = parse_array('[array]\nname = "a"\n[[sensor]]\nname = "B"\nchip = "bma180"\naddress = 0x40\nrange = 16\n')
    noise = EFFECTS["white_noise"](rms=0.016)  # type: ignore[call-arg]
    plan = changed(plan_of(array, 50.0, 40.0), config="")
    write_log(Simulation(plan, Unlabelled(still_s=12.0, motion_s=20.0), {"B": [noise]}), tmp_path / "run.h5")
    assert main(["characterise", str(tmp_path / "run.h5"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["stretch"]["phase"].startswith("pose")
    assert result["stretch"]["end_s"] <= 12.0
    # 16 mg of noise are 8.2 counts; the shaking would give hundreds of counts
    assert result["sensors"][0]["axes"][0]["counts"]["std"] == pytest.approx(8.2, rel=0.2)


def test_json_lists_of_numbers_are_on_one_line() -> None:
    """The text has the same content as that of the standard library, with a line for each list of numbers."""
    result = {"log": "ü", "sensors": [{"tau_s": [0.1, 1e-7, None], "rows": [[1, 2], [3]], "none": {}, "nobody": []}]}
    text = json_text(result)
    assert json.loads(text) == result
    assert '"tau_s": [0.1, 1e-07, null]' in text
    assert len(text.splitlines()) == 14


@pytest.mark.slow
def test_noise_with_a_time_constant_is_not_bias_instability(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """White noise of 0.05 dps and a first-order process of 0.01 dps and 2 s (the Allan deviation of which falls again
    beyond 2 s): the figures B and K are in brackets, without limits, and p is marked, also in JSON, notebooks and
    pages.
    """
    from scipy.signal import lfilter

    rng, rows, decay = np.random.default_rng(4), 60_000, np.exp(-0.01 / 2.0)
    process = lfilter([np.sqrt(1 - decay**2) * 0.01], [1, -decay], rng.normal(size=(rows, 3)), axis=0)
    counts = np.rint((rng.normal(0, 0.05, (rows, 3)) + process) * 1000)
    header = SensorHeader("Gyro", "any", "angular_rate", "dps", 30.0, 1000.0)
    with LogWriter(tmp_path / "run.h5", [header], source="imported", epoch="2026-01-01T00:00:00Z") as log:
        log.append("Gyro", Block(np.arange(rows) * 10_000_000, counts, np.zeros(rows, np.uint16)))
    assert main(["characterise", str(tmp_path / "run.h5")]) == 0
    lines = capsys.readouterr().out.splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("noise of the Allan deviation"))
    for line in lines[start + 2 : start + 5]:
        name, _axis, white, percent, sign, flicker, *_ = line.split()
        assert (name, sign) == ("Gyro", "%") and percent.startswith("+-") and float(white) > 0
        assert flicker.startswith("(") and "!" in line
    assert main(["characterise", str(tmp_path / "run.h5"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    for axis in result["sensors"][0]["axes"]:
        doubtful = {name: term["doubtful"] for name, term in axis["fit"]["terms"].items()}
        assert doubtful == {"white": False, "flicker": True, "random walk": True}
    known = Characterisation(result)
    flicker_of_x = known.coefficient("Gyro", "x", "flicker")
    assert flicker_of_x is not None and flicker_of_x.doubtful
    assert f"<td>({flicker_of_x.value:.3g})</td>" in known._repr_html_()
    write_report([tmp_path / "run.h5"], tmp_path / "page.html")
    row = (tmp_path / "page.html").read_text().split(">Gyro x</th>")[1].split("</tr>")[0]
    assert f"<td>({flicker_of_x.value:.3g})</td>" in row
