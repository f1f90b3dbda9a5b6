"""One short study for several tests."""

from __future__ import annotations

import pytest

from imuarray.studies.fusion_gain import gain_study
from imuarray.studies.fusion_gain.gain_study import Study, study
from imuarray.studies.fusion_gain.page import HeatingErrors, simulate_heating


@pytest.fixture(scope="session")
def short_and_warm() -> tuple[Study, HeatingErrors]:
    """A study with short calibration logs: sufficient for rows and curves, too short for conclusions."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("TUMBLE_S", 56.0), ("HEATING_S", 120.0), ("BOOTS", 3), ("BOOT_S", 12.0)):
            patch.setattr(gain_study, name, value)
        gain_study.calibrate_units.cache_clear()
        result = study(("static",), 1, seconds=12.0), simulate_heating(1, 100.0)
    gain_study.calibrate_units.cache_clear()
    return result


@pytest.fixture(scope="session")
def short(short_and_warm: tuple[Study, HeatingErrors]) -> Study:
    """Twelve seconds at rest, one seed."""
    return short_and_warm[0]


@pytest.fixture(scope="session")
def warm(short_and_warm: tuple[Study, HeatingErrors]) -> HeatingErrors:
    """A hundred seconds of heating."""
    return short_and_warm[1]
