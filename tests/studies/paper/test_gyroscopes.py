"""Tables 2, 4 and 9 against printed cells."""

from __future__ import annotations

import pytest

from imuarray.studies.paper.systematic import table2, table4, table9
from imuarray.studies.paper.tables import tally


def test_table_4_matches_in_every_cell() -> None:
    counts = tally(table4())
    assert set(counts) == {
        f"{what}_{unit}" for what in ("bias", "dbias_x", "dbias_y", "dbias_z", "drift") for unit in ("lsb", "dps")
    }
    assert all(count == [9, 9] for count in counts.values())


def test_table_4_bias_is_the_mean_of_seven_readings() -> None:
    gyro1_x = table4()[0].as_json()
    assert gyro1_x["channel"] == "Gyro1 x"
    assert gyro1_x["bias_lsb"] == 8.389  # six readings give 8.406
    assert sum([8.320732, 8.428642, 8.161185, 8.422897, 8.705721, 8.394012]) / 6 == pytest.approx(8.4055, abs=1e-4)


def test_dps_columns_of_tables_2_and_9() -> None:
    assert tally(table2()) == {"mean_dps": [6, 6], "std_dps": [6, 6]}
    assert tally(table9()) == {"mean_dps": [6, 6], "sem_dps": [6, 6], "std_dps": [6, 6]}
    assert table2()[0].as_json()["std_dps"] == 0.3221


def test_table_9_gives_the_length_of_the_fast_runs() -> None:
    """Appendix A.1: about 1400 s at about 350 Hz, 490 000 samples; the standard error gives 482 500 for Gyro1 x."""
    assert table9()[0].as_json()["samples"] == pytest.approx(482_500, rel=1e-3)
