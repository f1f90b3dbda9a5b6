"""What the guest printed, and the readings of our own drivers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from imuarray.acquire import connect
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.clock import sleep_for
from tests.system.bench import SEED


def sections(written: str) -> dict[str, str]:
    """The output of the script under each heading."""
    parts = (part.partition("\n") for part in written.split("## ")[1:])
    return {heading.strip(): text for heading, _, text in parts}


def addresses(table: str) -> set[int]:
    """The addresses listed by i2cdetect."""
    rows = [line.partition(":")[2].split() for line in table.splitlines()[1:]]
    return {int(cell, 16) for row in rows for cell in row if cell not in ("--", "UU")}


def own_readings(config: Path) -> dict[str, npt.NDArray[np.float64]]:
    """The readings of this project's drivers from an equal array: (n, axes) counts by chip, or (n, 2) kPa and degC."""
    array = load_array(config)
    readings: dict[str, list[npt.NDArray[np.float64]]] = {}
    with open_bus(f"emulated:?seed={SEED}", array) as bus:
        stations = connect(array, bus)
        for _ in range(200):
            sleep_for(bus.clock, 0.02)
            for station in stations:
                if not (burst := station.driver.fetch()):
                    continue
                decoded = station.driver.decode(np.frombuffer(burst, np.uint8).reshape(1, -1))
                values = decoded.counts[0].astype(float)
                if decoded.compensated:
                    values = np.array([decoded.compensated["pressure"][0] / 1e3, decoded.compensated["temperature"][0]])
                readings.setdefault(station.sensor.name, []).append(values)
    return {name: np.array(values) for name, values in readings.items()}


def numbers(text: str) -> npt.NDArray[np.float64]:
    return np.array([float(line) for line in text.split()])
