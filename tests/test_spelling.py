"""Suggestions for misspelt words, and durations with units."""

from __future__ import annotations

import shlex
from pathlib import Path

import click
import pytest

from imuarray.cli import main
from imuarray.commands.options import Duration
from imuarray.errors import FusionError
from imuarray.fuse.pipeline import QuantityPipeline
from imuarray.spelling import guess, guess_file


def test_the_nearest_word_is_suggested_or_none() -> None:
    assert guess("calibrat", ["detect", "calibrate"]) == "; did you mean calibrate?"
    assert guess("xyzzy", ["detect", "calibrate"]) == ""


def test_a_misspelt_technique_is_refused_with_a_suggestion() -> None:
    with pytest.raises(FusionError, match=r"^technique 'oposed': allowed are mean, .*; did you mean opposed\?$"):
        QuantityPipeline({}, "oposed")


def test_letter_case_does_not_matter() -> None:
    assert guess("GYRO1", ["Gyro1", "BMA2"]) == "; did you mean Gyro1?"


def test_a_similar_file_is_suggested(tmp_path: Path) -> None:
    (tmp_path / "tumble.h5").touch()
    (tmp_path / "notes.txt").touch()
    assert guess_file(tmp_path / "tumbel.h5") == f"; did you mean {tmp_path / 'tumble.h5'}?"
    assert guess_file(tmp_path / "heating.csv") == ""
    assert guess_file(tmp_path / "nowhere" / "tumble.h5") == ""


MISSPELT = {
    "calibrat x.h5": "did you mean calibrate?",
    "simulate martin201 -o {}/x.h5": "did you mean martin2013?",
    "simulate martin2013 --without white_nois -o {}/x.h5": "did you mean white_noise?",
    "simulate martin2013 --only gyro1 -o {}/x.h5": "did you mean Gyro1?",
    "simulate martin2013 --experiment motion --motion vehicel -o {}/x.h5": "did you mean vehicle?",
    "gap diagnose {}/rest.h5 --without ton": "did you mean tone?",
    "gap diagnose {}/rest.h5 --only Gyro11": "did you mean Gyro1?",
    "log martin2013 --bus emulate: -o {}/x.h5": "did you mean emulated:?",
    "log martin2013 --bus emulated: --only BMA22 -o {}/x.h5": "did you mean BMA2?",
    "fuse {}/rest.h5 --technique oposed -o {}/x.h5": "did you mean opposed?",
    "characterise {}/rest.h5 --sensor Giro1": "did you mean Gyro1?",
    "export {}/rest.h5 --sensor Giro1 -o {}/x.csv": "did you mean Gyro1?",
    "info {}/rets.h5": "rest.h5?",
    "verify {}/rets.h5": "rest.h5?",
    "monitor {}/rets.h5 --text --once": "rest.h5?",
    "report {}/rets.h5 -o {}/x.html": "rest.h5?",
    "fuse {}/rest.h5 --calibration {}/call.toml -o {}/x.h5": "cal.toml?",
    "export {}/rest.h5 -o {}/x.cvs": "did you mean .csv?",
    "export {}/rest.h5 --tool kalib -o {}/x.yaml": "did you mean kalibr?",
    "export {}/rest.h5 --units SI -o {}/x.csv": "did you mean si?",
    "simulate martin2013 --experiment heatng -o {}/x.h5": "did you mean heating?",
    "study --experiments statik": "did you mean static?",
    "import {}/dta.csv --format mimu4444 -o {}/x.h5": "data.csv?",
}
"""What a person might type, and the suggestion in the error."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("misspelt")
    options = ["--only", "Gyro1,BMA2", "--seconds", "2s"]
    assert main(["simulate", "martin2013", *options, "-o", str(here / "rest.h5")]) == 0
    for name in ("cal.toml", "data.csv"):
        (here / name).write_text("")
    return here


@pytest.mark.parametrize("line", MISSPELT)
def test_a_misspelt_word_on_the_command_line_gets_a_suggestion(
    line: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shlex.split(line.replace("{}", str(folder)))) == 2
    complaint = capsys.readouterr().err
    assert MISSPELT[line] in complaint.replace(f"{folder}/", "") and complaint.count("\n") <= 2


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90", 90.0), ("1.5", 1.5), ("500ms", 0.5), ("10s", 10.0), ("30min", 1800.0), ("2h", 7200.0), ("1d", 86400.0)],
)
def test_durations_are_converted_to_seconds(text: str, seconds: float) -> None:
    assert Duration().convert(text, None, None) == seconds


@pytest.mark.parametrize("text", ["", "0", "-5s", "5 m", "10m", "h", "1h30min", "inf", "nan", "s10"])
def test_invalid_durations_are_refused(text: str) -> None:
    with pytest.raises(click.UsageError, match="is not a duration; write 30s, 10min, 1h or 1d"):
        Duration().convert(text, None, None)


def test_durations_out_of_bounds_are_refused() -> None:
    bounded = Duration(minimum_s=0.2, maximum_s=3600)
    assert bounded.convert("1h", None, None) == 3600.0
    with pytest.raises(click.UsageError, match=r"allowed is at least 0\.2 s"):
        bounded.convert("100ms", None, None)
    with pytest.raises(click.UsageError, match="allowed is at most 3600 s"):
        bounded.convert("2h", None, None)
