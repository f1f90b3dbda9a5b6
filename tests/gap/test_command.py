"""`imuarray gap diagnose` through the command line."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from imuarray.cli import main
from imuarray.commands.gap import diagnose
from imuarray.gap.diagnose import REPLICATES
from imuarray.gap.findings.verdict import RATES
from imuarray.gap.inference.effects import CANDIDATES
from imuarray.gap.statistics.probes import PROBES
from imuarray.log import open_log
from imuarray.simulate import load_model
from tests.gap.invariants import check_agreement

CONFIG = """
[array]
name = "two"

[[sensor]]
name = "G1"
chip = "l3g4200d"
address = 0x68
range = 250
rate_hz = 800
bandwidth_hz = 35
axes = "+X+Y+Z"

[[sensor]]
name = "A1"
chip = "bma180"
address = 0x40
range = 4
bandwidth_hz = 150
axes = "+X+Y+Z"
"""

MODEL = """
[model]
name = "humming"

[[sensor]]
name = "G1"
chip = "l3g4200d"
white_noise.rms_dps = 0.05
bias.offset_dps = 0.5
{line}

[[sensor]]
name = "A1"
chip = "bma180"
white_noise.rms_g = 0.004
bias.offset_g = 0.02
"""

LINE = "tone = { amplitude_dps = [0.0, 0.04, 0.0], frequency_hz = 17.0 }"
"""0.8 of the noise's standard deviation, on y."""

FILES = ["gap.json", "repaired.toml", "report.html"]

Said = tuple[int, str, list[str]]
Type = Callable[..., Said]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with logs of 20 s, with a line in a gyroscope and without."""
    folder = tmp_path_factory.mktemp("gap")
    (folder / "two.toml").write_text(CONFIG)
    for name, line, seed in (("humming", LINE, 0), ("quiet", "", 2)):
        (folder / f"{name}.toml").write_text(MODEL.format(line=line))
        asked = ["two.toml", "--model", f"{name}.toml", "--seconds", 20, "--rate-hz", 100, "-o", f"{name}.h5"]
        asked += ["--seed", seed]
        asked = [str(folder / one) if str(one).endswith((".toml", ".h5")) else str(one) for one in asked]
        assert main(["simulate", *asked]) == 0
    return folder


@pytest.fixture
def typed(here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Type:
    """``typed("humming.h5", ...)``: exit code, standard output, lines of standard error."""
    monkeypatch.chdir(here)
    capsys.readouterr()

    def call(*arguments: object, workers: int = 1, replicates: int = 40) -> Said:
        rest = [*map(str, arguments), "--workers", str(workers), "--replicates", str(replicates)]
        code = main(["gap", "diagnose", *rest])
        out, err = capsys.readouterr()
        return code, out, err.splitlines()

    return call


@pytest.fixture(scope="module")
def found(here: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The written diagnosis of the line; computed once."""
    asked = [here / "humming.h5", "--only", "G1", "--workers", 1, "--replicates", 40, "--seed", 3, "-o", here / "out"]
    assert main(["gap", "diagnose", *map(str, asked)]) == 0
    assert sorted(path.name for path in (here / "out").iterdir()) == FILES
    read: dict[str, Any] = json.loads((here / "out" / "gap.json").read_text())
    check_agreement(read)
    return read


WHERE = {"log", "sensor", "axis", "domain", "phase", "statistic", "real", "simulated", "significance", "effect_size"}
CAUSE = {
    "effect",
    "action",
    "sensors",
    "axes",
    "probability",
    "parameters",
    "closed",
    "closed_ci95",
    "confusable_with",
}
WHOLE = {
    "verdict",
    "gap",
    "where",
    "causes",
    "unknown",
    "unexplained",
    "next_experiment",
    "seed",
    "model",
    "software",
}


def test_json_has_the_published_fields(found: dict[str, Any]) -> None:
    """The published names with the published types; there may be more."""
    assert found.keys() >= WHOLE
    assert found["gap"].keys() >= {"before", "after", "floor", "closed", "closed_ci95"}
    assert all(one.keys() >= WHERE for one in [*found["where"], *found["unexplained"]])
    assert all(one.keys() >= CAUSE for one in found["causes"])
    assert all("alternative_to" in one for one in found["causes"])
    assert found["p"] == found["p_limit"] == 1 / 41
    assert 0 <= found["p_tail"] < found["p_limit"]
    assert found["verdict"] == "explained"
    assert found["reason"].startswith("the causes close the gap")
    assert found["gap"]["before"] > found["gap"]["after"]
    low, high = found["gap"]["closed_ci95"]
    assert low <= found["gap"]["closed"] <= high
    worst = found["where"][0]
    assert (worst["log"], worst["sensor"], worst["axis"]) == ("humming.h5", "G1", "y")
    assert worst["domain"] == PROBES[worst["statistic"]].domain
    assert 0 <= found["unknown"] <= 1
    assert isinstance(found["next_experiment"], str)
    assert (found["seed"], found["model"]) == (3, "data sheets")
    assert found["software"].startswith("imuarray ")


def test_the_command_simulates_as_many_replicates_as_the_function() -> None:
    """Its default is a number of its own, since the function's module takes long to import."""
    (option,) = [parameter for parameter in diagnose.params if parameter.name == "replicates"]
    assert option.default == REPLICATES


def test_the_cause_is_reported_with_its_amplitude(found: dict[str, Any]) -> None:
    """1000 rows in noise of 0.05 dps determine an amplitude to 0.0022 dps."""
    cause = found["causes"][0]
    assert (cause["effect"], cause["action"], cause["sensors"], cause["axes"]) == ("tone", "add", ["G1"], ["y"])
    assert cause["share"] > 0.9
    assert 0.6 < cause["probability"] <= RATES.most
    assert cause["parameters"]["amplitude_dps"] == pytest.approx([0.0, 0.04, 0.0], abs=0.009)
    assert cause["parameters"]["frequency_hz"] == pytest.approx(17.0, abs=0.4)
    assert cause["closed"] > 0.8
    assert cause["confusable_with"] == []


@pytest.mark.slow
def test_an_existing_file_is_overwritten_only_with_force(found: dict[str, Any], typed: Type, here: Path) -> None:
    """The refusal precedes the computation, and one existing file is sufficient."""
    before = {name: (here / "out" / name).read_bytes() for name in FILES}
    code, out, err = typed("humming.h5", "-o", "out")
    assert (code, out, len(err)) == (2, "", 1)
    assert "out/gap.json" in err[0]
    assert "--force" in err[0]
    assert {name: (here / "out" / name).read_bytes() for name in FILES} == before
    (here / "other").mkdir(exist_ok=True)
    (here / "other" / "report.html").write_text("a page of somebody else")
    assert typed("humming.h5", "-o", "other")[0] == 2
    assert [path.name for path in (here / "other").iterdir()] == ["report.html"]


@pytest.mark.slow
def test_forced_files_and_standard_output_are_those_of_another_number_of_workers(
    found: dict[str, Any], typed: Type, here: Path
) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "report.html").write_text("a page of somebody else")
    code, out, err = typed("humming.h5", "--only", "G1", "--seed", 3, "--json", "-o", "mine", "--force", workers=2)
    assert code == 0
    assert err[-1] == "mine: report.html, gap.json, repaired.toml written"
    assert "a page of somebody else" not in (here / "mine" / "report.html").read_text()
    assert json.loads(out) == json.loads((here / "mine" / "gap.json").read_text()) == found


@pytest.mark.slow
def test_a_recording_without_a_gap(typed: Type) -> None:
    """The seed is one of the 20 of 21 without a gap by chance."""
    code, out, _ = typed("quiet.h5", "--json")
    said = json.loads(out)
    check_agreement(said)
    assert (code, said["verdict"], said["causes"], said["unknown"]) == (0, "no gap", [], 0.0)
    assert (said["gap"]["closed"], said["gap"]["closed_ci95"]) == (None, None)


@pytest.mark.slow
def test_the_repaired_model_can_be_simulated_and_compared(
    found: dict[str, Any], typed: Type, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is simulated, and a recording is compared with it: the line is not a gap any more. p is 0.05 to 0.07; the seed
    is one of those without a gap.
    """
    with (here / "out" / "repaired.toml").open("rb") as file:
        assert tomllib.load(file)["model"]["name"] == "repaired data sheets"
    assert "tone" in load_model(here / "out" / "repaired.toml").sensors[0].effects
    asked = ["two.toml", "--model", "out/repaired.toml", "--only", "G1", "--seconds", "5", "-o", "again.h5", "--force"]
    assert main(["simulate", *asked]) == 0
    with open_log(here / "again.h5") as log:
        assert list(log.sensors) == ["G1"]
    capsys.readouterr()
    code, out, _ = typed("humming.h5", "--only", "G1", "--model", "out/repaired.toml", "--seed", "1", "--json")
    said = json.loads(out)
    assert (code, said["model"]) == (0, "repaired data sheets")
    assert said["verdict"] == "no gap"


@pytest.mark.slow
def test_changes_since_an_earlier_log_are_reported(typed: Type) -> None:
    """The line is not a difference from the log that has it, and is missing in the other log."""
    code, out, _ = typed("humming.h5", "--only", "G1", "--against", "humming.h5", "--json")
    same = json.loads(out)
    check_agreement(same)
    assert (code, same["verdict"]) == (0, "no gap")
    assert same["model"] == "data sheets, fitted to humming.h5"
    code, out, _ = typed("humming.h5", "--only", "G1", "--against", "quiet.h5", "--against", "quiet.h5", "--json")
    since = json.loads(out)
    check_agreement(since)
    assert (code, since["causes"][0]["effect"], since["causes"][0]["axes"]) == (0, "tone", ["y"])
    assert since["sentence"].startswith("The recordings differ from quiet.h5, most in ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["humming.h5", "--against", "nothing.h5"], ["nothing.h5"]),
        (["humming.h5", "--without", "tone,ghosts"], ["ghosts", *CANDIDATES]),
        (["humming.h5", "--only", "Nose"], ["humming.h5", "Nose"]),
        (["two.toml"], ["two.toml"]),
        (["nothing.h5"], ["nothing.h5"]),
        (["humming.h5", "--model", "nothing.toml"], ["nothing.toml"]),
        (["humming.h5", "--model", "humming.h5"], ["humming.h5"]),
        (["humming.h5", "-o", "two.toml"], ["two.toml"]),
        (["nothing.h5", "-o", "new"], ["nothing.h5"]),
    ],
)
def test_invalid_input_gives_one_line_and_no_file(
    typed: Type, here: Path, arguments: list[str], words: list[str]
) -> None:
    before = sorted(here.iterdir())
    code, out, err = typed(*arguments)
    assert (code, out, len(err)) == (2, "", 1)
    assert all(word in err[0] for word in words)
    assert sorted(here.iterdir()) == before


@pytest.mark.parametrize(
    "arguments", [[], ["humming.h5", "--replicates", "10"], ["humming.h5", "--workers", "0"], ["humming.h5", "--what"]]
)
def test_invalid_options_are_refused(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    monkeypatch.chdir(here)
    assert main(["gap", "diagnose", *arguments]) == 2
    assert capsys.readouterr().out == ""


def test_help_of_the_group_lists_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gap", "--help"]) == 0
    assert re.search(r"^  diagnose  +\w", capsys.readouterr().out, flags=re.MULTILINE)


@pytest.mark.parametrize(
    "option", ["--without", "--only", "--against", "-o", "--json", "--model", "--replicates", "--workers"]
)
def test_help_explains_the_options(capsys: pytest.CaptureFixture[str], option: str) -> None:
    """The name of the option begins a line of the list, and words about it follow there or on the next line."""
    assert main(["gap", "diagnose", "--help"]) == 0
    story, options = capsys.readouterr().out.split("\nOptions:\n")
    assert "REAL.h5" in story
    assert re.search(rf"^  (?:-\w, )?{option}\b[^\n]*?(?:  |\n {{6,}})[a-zA-Z]\w", options, flags=re.MULTILINE)


@pytest.mark.slow
def test_effects_can_be_excluded(found: dict[str, Any], typed: Type) -> None:
    """Without its cause the line may be attributed to another effect, but not to a tone, and is closed less."""
    code, out, _ = typed("humming.h5", "--only", "G1", "--without", "tone", "--json")
    said = json.loads(out)
    assert code == 0
    assert "tone" not in {one["effect"] for one in said["causes"]}
    assert (said["gap"]["closed"] or 0.0) < found["gap"]["closed"]
    assert said["unknown"] > found["unknown"]


@pytest.mark.slow
def test_all_sensors_of_a_log_are_diagnosed(typed: Type) -> None:
    """The accelerometer has no part in the cause."""
    code, out, _ = typed("humming.h5", "--json")
    said = json.loads(out)
    assert code == 0
    assert said["causes"][0]["effect"] == "tone"
    assert {name for cause in said["causes"] for name in cause["sensors"]} == {"G1"}


@pytest.mark.slow
def test_two_logs_of_a_kind_are_training_and_held_out(typed: Type) -> None:
    """The second log is held out and has no line. A name given twice is one log."""
    code, out, _ = typed("humming.h5", "quiet.h5", "humming.h5", "--only", "G1", "--json")
    said = json.loads(out)
    assert code == 0
    assert {one["log"] for one in said["where"]} <= {"humming.h5", "quiet.h5"}
    assert said["verdict"] != "explained"
