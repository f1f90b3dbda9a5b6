"""Logs of heated sensors, and calibrations with their slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imuarray.calibrate import Calibration, SensorCalibration
from imuarray.calibrate.model import Thermal
from imuarray.log import Block, LogWriter, Stimulus
from imuarray.log.format import SensorHeader
from tests.fuse.conftest import EPOCH, pointing

ROWS = 6000
SECONDS = np.arange(ROWS) / 5.0
RISE_DEGC, RISE_S, LAG_S = 20.0, 300.0, 60.0
WARM = 25 + RISE_DEGC * (1 - np.exp(-SECONDS / RISE_S))
# The solution of LAG dT/dt = WARM - T from balance at 25 degC.
ELEMENT = 25 + RISE_DEGC * (
    1 - (RISE_S * np.exp(-SECONDS / RISE_S) - LAG_S * np.exp(-SECONDS / LAG_S)) / (RISE_S - LAG_S)
)
SLOPES = {"A1": (3.0, -2.0, 1.5), "A2": (3.0, 4.0, 2.0), "G1": (2.0, -3.0, 5.0)}
BIAS = {"A1": (10.0, -20.0, 5.0), "A2": (0.0, 30.0, -5.0), "G1": (-12.0, 3.0, 7.0)}
HEADERS = {
    "A1": SensorHeader("A1", "bma180", "specific_force", "g", 16.0, 512.0, axes="+X+Y+Z", has_temperature=True),
    "A2": SensorHeader("A2", "adxl345", "specific_force", "g", 16.0, 256.0, axes="-Y+X+Z"),
    "G1": SensorHeader("G1", "l3g4200d", "angular_rate", "dps", 250.0, 114.0, axes="+X+Y+Z", has_temperature=True),
}
BAROMETER = SensorHeader(
    "P", "bmp180", "pressure", "Pa", 0.0, 0.0, columns=("ut", "up"), compensated=("temperature", "pressure")
)


def heating(path: Path, thermometer: str, names: Sequence[str] = ("A1", "A2", "G1")) -> Path:
    """A box at rest, Z up, heated by 20 degC: biases with a lag of 60 s, one count of noise."""
    rng, nothing = np.random.default_rng(5), np.zeros((ROWS, 3))
    time, status = np.round(SECONDS * 1e9).astype(np.int64), np.zeros(ROWS, np.uint16)
    headers = [replace(HEADERS[name], has_temperature=thermometer == HEADERS[name].chip) for name in names]
    barometer = [BAROMETER] if thermometer == "barometer" else []
    with LogWriter(path, [*headers, *barometer], source="simulated", epoch=EPOCH) as writer:
        for header in headers:
            felt = header.sensitivity * pointing(header.axes)[:, 2] * (header.quantity == "specific_force")
            above = (ELEMENT - 25)[:, None]
            counts = BIAS[header.name] + felt + above * SLOPES[header.name] + rng.normal(0, 1, (ROWS, 3))
            own = {"bma180": 2 * (WARM - 24), "l3g4200d": 45 - WARM}.get(header.chip, WARM)
            degrees = np.rint(own).astype(np.int16) if header.has_temperature else None
            writer.append(header.name, Block(time, np.rint(counts).astype(np.int16), status, degrees))
        if barometer:
            air = {"temperature": np.round(WARM, 1), "pressure": np.full(ROWS, 1e5)}
            writer.append("P", Block(time, np.zeros((ROWS, 2), np.int32), status, None, air))
        if thermometer == "reference":
            writer.stimulus("reference", Stimulus(time, nothing, nothing, WARM))
    return path


def known(
    thermometer: str = "barometer", reference_degc: float = 25.0, names: Sequence[str] = ("A1", "A2", "G1")
) -> Calibration:
    """All as simulated; z of accelerometers carried gravity, so that its slope may be of the scale factor."""
    return Calibration(
        {
            name: SensorCalibration(
                name=name,
                quantity=HEADERS[name].quantity,
                unit=HEADERS[name].unit,
                bias_lsb=np.array(BIAS[name]),
                response_lsb_per_unit=HEADERS[name].sensitivity * pointing(HEADERS[name].axes),
                bias_sem_lsb=np.ones(3),
                thermal=Thermal(
                    slope_lsb_per_degc=np.array(SLOPES[name]),
                    slope_sem_lsb_per_degc=np.full(3, 0.01),
                    reference_degc=reference_degc,
                    meaning=("bias", "bias", "bias" if name == "G1" else "bias or scale"),
                    thermometer=thermometer,
                    lag_s=LAG_S,
                    lag_interval_s=np.array([50.0, 70.0]),
                ),
            )
            for name in names
        }
    )
