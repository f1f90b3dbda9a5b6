"""The notebooks of the documentation run from top to bottom, and end with the results that their text states."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    """The cells of one kind."""
    return [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == kind]


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names that a notebook defines, run in a folder as deep in a checkout as its own."""
    for part in ("tests", "configs"):
        (folder / part).symlink_to(ROOT / part)
    place = folder / "docs" / "notebooks"
    place.mkdir(parents=True)
    monkeypatch.chdir(place)
    names: dict[str, Any] = {}
    for number, cell in enumerate(cells(ROOT / "docs" / "notebooks" / f"{name}.ipynb", "code")):
        exec(compile("".join(cell["source"]), f"{name}, code cell {number}", "exec"), names)  # noqa: S102  ours
    return names


def test_there_are_three_notebooks_without_output() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["diagnosis", "first_night", "other_rig"]
    for path in NOTEBOOKS:
        assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells(path, "code"))
        assert "".join(cells(path, "markdown")[0]["source"]).startswith("# ")


@pytest.mark.slow
def test_the_notebook_first_night_gives_the_expected_scatter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mean of four BMA180 of 1.9 mg and two ADXL345 of 12 mg scatters by sqrt(4 1.9^2 + 2 12^2) / 6 = 2.9 mg; the
    best weights make it 1.9 / sqrt(4 + 2 (1.9 / 12)^2) = 0.94 mg.
    """
    names = run("first_night", tmp_path, monkeypatch)
    assert all(residual < 0.01 for residual in names["poses"].residual_g.values())
    assert names["scatter_mg"]["mean"][:2] == pytest.approx([2.9, 2.9], rel=0.1)
    assert names["scatter_mg"]["optimal"][:2] == pytest.approx([0.94, 0.94], rel=0.1)


@pytest.mark.slow
def test_the_notebook_other_rig_imports_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = run("other_rig", tmp_path, monkeypatch)
    assert names["summary"].rows == len(names["accelerometer"])


@pytest.mark.slow
def test_the_notebook_diagnosis_names_the_tone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The notebook adds a tone of 0.6 dps at 11 Hz. This gyroscope of the paper also wanders by 0.014 dps about x, more
    than usual parts do; a cause after the tone is this wander, or telegraph noise, which resembles it.
    """
    cause, *others = run("diagnosis", tmp_path, monkeypatch)["diagnosis"].causes
    assert (cause.effect, cause.sensors) == ("tone", ("Gyro2",))
    assert all(other.probability < cause.probability for other in others)
    assert {(other.effect, *other.sensors) for other in others} <= {
        ("bias_instability", "Gyro2"),
        ("popcorn_noise", "Gyro2"),
    }
    assert cause.parameters["frequency_hz"] == pytest.approx(11.0, abs=0.05)
