"""Pages open with a verdict: one sentence, a level, three to five figures."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import BIAS, Thermal
from imuarray.fuse import FusedHead
from imuarray.fuse.comparison import Score, TechniqueComparison
from imuarray.fuse.evaluation import Error, Ratio
from imuarray.log import Block, LogWriter, open_log
from imuarray.log.format import Event, SensorHeader
from imuarray.report import Verdict, write_page
from imuarray.report.files import KINDS, PageContext
from imuarray.report.gap_page import gap_verdict
from imuarray.report.log_page import log_sections
from imuarray.report.page import Table
from imuarray.report.verdicts import calibration_verdict, fused_verdict, joined, recording_verdict, techniques_verdict
from tests.report.example_diagnoses import diagnosis_without_gap, partial_diagnosis, unexplained_diagnosis
from tests.selection import some

ACC = SensorHeader("Acc", "bma180", "specific_force", "g", 4.0, 2048.0)
GYRO = SensorHeader("Gyro", "l3g4200d", "angular_rate", "dps", 250.0, 100.0)


def recorded(path: Path, rows: int = 1000, gyro_rows: int = 1000, status: int = 0, *events: Event) -> Verdict:
    with LogWriter(path, [ACC, GYRO], source="imported", epoch="2026-01-01T00:00:00Z") as log:
        for header, count in ((ACC, rows), (GYRO, gyro_rows)):
            flags = np.zeros(count, np.uint16)
            flags[5:8] = status
            log.append(header.name, Block(np.arange(count) * 10_000_000, np.ones((count, 3)), flags))
        for event in events:
            log.event(event)
    with open_log(path) as log:
        return recording_verdict(log)


@pytest.mark.parametrize(
    ("arguments", "level", "sentence"),
    some(
        [
            ((), "good", "run.h5 is healthy: all 2 sensors deliver, no frame was missed, no fault reported."),
            (
                (1000, 500),
                "bad",
                "run.h5 has serious losses: Gyro silent for 5 s; check cable, power and address.",
            ),
            (
                (1000, 1000, 8),
                "doubtful",
                "run.h5 is usable, with losses: 6 gaps in the readings of Acc, Gyro; read the events, which say why.",
            ),
            (
                (1000, 1000, 4),
                "doubtful",
                "run.h5 is usable, with losses: 6 readings of Acc, Gyro at the end of the range;"
                " choose a wider range if the motion was intended.",
            ),
            (
                (1000, 1000, 0, Event(0, "", "imported", "from x.csv"), Event(1, "", "bus", "works again, after 1 s")),
                "good",
                "run.h5 is healthy: all 2 sensors deliver, no frame was missed, no fault reported.",
            ),
        ],
        2,
    ),
)
def test_the_verdict_on_a_recording_states_its_health(
    tmp_path: Path, arguments: tuple[object, ...], level: str, sentence: str
) -> None:
    verdict = recorded(tmp_path / "run.h5", *arguments)  # type: ignore[arg-type]
    assert (verdict.level, verdict.sentence) == (level, sentence)
    assert verdict.figures[0][0] == "10.0 s"
    assert len(verdict.figures) == 5


def test_a_recording_with_stalls_is_doubtful(tmp_path: Path) -> None:
    """Fifty rows in half a second, then nothing for half a second, twenty times."""
    time_ns = (np.arange(1000) * 10_000_000 + np.arange(1000) // 50 * 500_000_000).astype(np.int64)
    with LogWriter(tmp_path / "run.h5", [ACC], source="imported", epoch="2026-01-01T00:00:00Z") as log:
        log.append("Acc", Block(time_ns, np.ones((1000, 3)), np.zeros(1000, np.uint16)))
    with open_log(tmp_path / "run.h5") as run:
        verdict = recording_verdict(run)
    assert verdict.level == "doubtful"
    # 19 stalls of 0.51 s in 19.49 s
    assert "no readings of Acc in 50 % of the time: the recorder stalled" in verdict.sentence
    assert ("19", "gaps in the readings") in verdict.figures


def test_a_result_without_most_of_its_sensors_is_doubtful() -> None:
    head = FusedHead("optimal", "run.h5", "", "", 500, {"specific_force": ("A", "B", "C")})
    noise, own = {"specific_force": np.full(3, 0.00980665)}, {"specific_force": np.full(3, 0.01)}
    verdict = fused_verdict(Path("f.h5"), head, noise, own, ["A", "B"])
    assert verdict.level == "doubtful"
    assert "; 2 of 3 sensors were excluded for part of the time" in verdict.sentence


def test_a_log_without_readings_is_bad(tmp_path: Path) -> None:
    verdict = recorded(tmp_path / "run.h5", 0, 0)
    assert (verdict.level, verdict.sentence) == ("bad", "run.h5 holds no reading.")


def test_a_sensor_that_never_gave_a_reading_is_silent(tmp_path: Path) -> None:
    assert "Gyro silent for 10 s" in recorded(tmp_path / "run.h5", 1000, 0).sentence


def test_gaps_are_also_stated_in_the_section(tmp_path: Path) -> None:
    recorded(tmp_path / "run.h5", 1000, 1000, 8)
    with open_log(tmp_path / "run.h5") as log:
        section = next(iter(log_sections(log, {}, with_figures=False)))
    assert "Readings are missing before 6 of the readings." in section.text


def sensor(name: str, *, measured: bool, scaled: bool = True) -> SensorCalibration:
    """A bias known to 2, 1 and 1 counts of 100 a dps or 1000 a g."""
    quantity, unit, scale = ("specific_force", "g", 1000.0) if name.startswith("A") else ("angular_rate", "dps", 100.0)
    return SensorCalibration(
        name, quantity, unit, np.zeros(3), np.eye(3) * scale,
        bias_sem_lsb=np.array([2.0, 1.0, 1.0]) if measured else None,
        response_sem_lsb_per_unit=np.ones(3) if scaled else None,
    )  # fmt: skip


def test_the_verdict_on_a_calibration_states_its_quality() -> None:
    good = {"A1": sensor("A1", measured=True), "G1": sensor("G1", measured=True, scaled=False)}
    verdict = calibration_verdict(Path("cal.toml"), Calibration(good))
    assert (verdict.level, verdict.sentence) == ("good", "cal.toml is good: biases are known to 2 mg and 0.02 dps.")
    assert verdict.figures[0] == ("2 mg", "largest standard error of a bias, specific force")
    unturned = np.diag([1e-4, 0.04, 1e-4] * 3) * 100  # row by row: the column of box Y is known to 2 %
    partly = replace(sensor("G2", measured=True), response_covariance_lsb2_per_unit2=unturned)
    assert partly.uncertain_axes() == "Y"
    verdict = calibration_verdict(Path("cal.toml"), Calibration({**good, "G2": partly}))
    assert verdict.sentence == (
        "cal.toml is good: biases are known to 2 mg and 0.02 dps; add turns of G2 about box Y, to which the response is"
        " not fully measured."
    )
    assert ("1", "of 3 sensors with measured scale and axes") in verdict.figures
    verdict = calibration_verdict(Path("cal.toml"), Calibration({**good, "G2": sensor("G2", measured=False)}))
    assert verdict.level == "doubtful"
    assert "is incomplete: G2 without a measured bias" in verdict.sentence
    verdict = calibration_verdict(Path("c.toml"), Calibration({"A1": sensor("A1", measured=True, scaled=False)}))
    assert "A1 without a measured scale, which a tumble gives" in verdict.sentence
    alone = sensor("A1", measured=False)
    assert calibration_verdict(Path("c.toml"), Calibration({"A1": alone})).level == "bad"
    heated = replace(alone, thermal=Thermal(np.ones(3), np.ones(3), 25.0, (BIAS,) * 3, "reference"))
    verdict = calibration_verdict(Path("c.toml"), Calibration({"A1": heated}))
    assert (verdict.level, "temperature slopes of biases, but no biases" in verdict.sentence) == ("doubtful", True)


@pytest.mark.parametrize(("claimed", "level"), [(0.01, "good"), (0.004, "doubtful")])
def test_the_verdict_on_a_fused_result_compares_scatter_and_claim(claimed: float, level: str) -> None:
    head = FusedHead("optimal", "run.h5", "", "", 500, {"specific_force": ("A", "B")})
    noise, own = {"specific_force": np.full(3, 0.00980665)}, {"specific_force": np.full(3, claimed)}
    verdict = fused_verdict(Path("f.h5"), head, noise, own)
    assert verdict.level == level
    assert verdict.sentence.startswith("f.h5, fused by optimal, scatters by 1 mg at rest")
    assert ("1 mg", "largest scatter at rest, specific force") in verdict.figures
    assert ("more than it claims" in verdict.sentence) == (level == "doubtful")


def test_the_verdict_of_several_files_is_that_of_the_worst() -> None:
    good, bad = (
        Verdict("a.h5 is healthy: yes.", "good", [("1", "a"), ("2", "b")]),
        Verdict("b.h5 is not.", "bad", [("3", "c")]),
    )
    assert joined([]) is None
    assert joined([good]) is good
    worst = joined([good, bad])
    both = joined([replace(good, figures=(("1", "a"), ("2", "b"))), replace(bad, figures=(("3", "a"),))])
    assert both is not None and both.figures == (("3", "a"), ("2", "b"))  # no figure of one kind twice
    assert worst == Verdict("b.h5 is not.", "bad", (("3", "c"), ("1", "a"), ("2", "b")))
    of_files = joined(
        [Verdict("", "good", (("1", "x"),)).of_file("a.h5"), Verdict("", "good", (("2", "x"),)).of_file("b.h5")]
    )
    assert of_files is not None
    assert of_files.figures == (("1", "x (a.h5)"), ("2", "x (b.h5)"))
    order = joined([good, replace(good, sentence="c.toml is good: yes.")])
    assert order is not None
    assert order.sentence == "Everything is in order: a.h5 is healthy; c.toml is good."
    gain = Verdict("Fusion of a.h5 reduces the error to 0.61 times (optimal).", "good", [])
    fused = Verdict("o.h5, fused by optimal, scatters by 5 mg at rest.", "good", [])
    two, three = joined([good, gain]), joined([good, gain, fused])
    assert two is not None and two.sentence.endswith(
        "a.h5 is healthy; fusion of a.h5 reduces the error to 0.61 times (optimal)."
    )
    assert three is not None and three.sentence.endswith("a.h5 is healthy; o.h5 scatters by 5 mg at rest.")


def test_the_verdict_on_a_gap_states_whether_the_simulator_is_good_enough() -> None:
    assert gap_verdict(diagnosis_without_gap()).sentence.startswith(
        "The simulator is good enough for what these recordings"
    )
    assert gap_verdict(diagnosis_without_gap()).level == "good"
    assert gap_verdict(unexplained_diagnosis()).level == "bad"
    for diagnosis in (partial_diagnosis(), diagnosis_without_gap(), unexplained_diagnosis()):
        verdict = gap_verdict(diagnosis)
        assert 3 <= len(verdict.figures) <= 5
        assert verdict.sentence.count(". ") == 0  # one sentence
    named = gap_verdict(replace(partial_diagnosis(), verdict="explained"))
    assert named.level == "doubtful"
    effects = list(dict.fromkeys(cause.effect.replace("_", " ") for cause in partial_diagnosis().causes))
    assert effects[0] in named.sentence
    assert named.sentence.endswith(
        "added most of the gap closes, but ADXL1 still differs by more than matters to a user."
    )
    harmless = tuple(place for place in partial_diagnosis().unexplained if place.size != "material")
    enough = gap_verdict(replace(partial_diagnosis(), verdict="explained", unexplained=harmless))
    assert harmless and enough.sentence.endswith("added it is good enough.")


def test_a_page_opens_with_its_verdict(tmp_path: Path) -> None:
    """Before the sections, escaped, with a symbol in addition to the colour."""
    verdict = Verdict("<b>a</b> is good.", "doubtful", [("1 <i>", "of & all"), ("2", "b"), ("3", "c")])
    write_page(tmp_path / "p.html", "Title", ["line"], [], verdict=verdict)
    text = (tmp_path / "p.html").read_text()
    opening = text.split("<main>")[0]
    assert '<section class="verdict doubtful" aria-label="Verdict">' in opening
    assert "▲</span> &lt;b&gt;a&lt;/b&gt; is good." in opening
    assert re.findall(r"<div><dt>(.*?)</dt><dd>(.*?)</dd></div>", opening)[0] == ("of &amp; all", "1 &lt;i&gt;")


@pytest.mark.parametrize(
    ("ratio", "words", "level"),
    some(
        [
            (0.61, "reduces the error of specific force to 0.61 times that of the simple average (optimal).", "good"),
            (0.97, "gains less than 5 % over the simple average.", "neutral"),
            (
                0.9985,
                "has no significant gain over the simple average.",
                "neutral",
            ),  # significant, but 1.00 when rounded
        ],
        1,
    ),
)
def test_a_gain_that_rounds_to_nothing_is_not_claimed(tmp_path: Path, ratio: float, words: str, level: str) -> None:
    """An interval wholly below 1 is not enough: a ratio of 1.00 is no reduction to a reader."""
    recorded(tmp_path / "log.h5")
    error = Error(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 1000)
    ratios = {"XYZ": Ratio(ratio, 0.0004, ratio - 0.001, ratio + 0.001)}
    score = Score("optimal", "specific_force", error, ratios, None)
    with open_log(tmp_path / "log.h5") as log:
        verdict = techniques_verdict(log, TechniqueComparison((score,), {}))
    assert verdict is not None
    assert (verdict.sentence, verdict.level) == (f"Fusion of log.h5 {words}", level)


def test_doubts_about_an_import_are_in_the_verdict_and_first_on_the_page(tmp_path: Path) -> None:
    """The accelerometer reads 1 count of 2048 per g on each axis: sqrt(3) / 2048 g, and no axis changes."""
    rows = np.ones((1000, 3))
    with LogWriter(tmp_path / "run.h5", [ACC], source="imported", epoch="2026-01-01T00:00:00Z") as log:
        log.append("Acc", Block(np.arange(1000) * 10_000_000, rows, np.zeros(1000, np.uint16)))
    part = KINDS["log"].part(tmp_path / "run.h5", PageContext(Calibration(), with_figures=False))
    (verdict,) = part.verdicts
    assert verdict.level == "doubtful"
    assert verdict.sentence == (
        "run.h5 is complete: the sensor delivers, no frame was missed, no fault reported. But there is 1 doubt about"
        " it: Acc: xyz is always 1, 1, 1"
    )
    assert part.sections[0].title == "run.h5: what is doubtful"
    table = part.sections[0].parts[0]
    assert isinstance(table, Table) and table.rows == [["Acc", "xyz is always 1, 1, 1"]]
