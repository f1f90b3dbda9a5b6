"""The emulated array that a guest's kernel sees as a USB device."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SEED = 11
# Settings are those which the kernel's drivers choose, so that counts mean the same.
CONFIG = """
[array]
name = "bench"
mux = { chip = "pca9544a", address = 0x70 }

[[sensor]]
name = "Accel"
chip = "adxl345"
channel = 0
address = 0x53
range = 16

[[sensor]]
name = "Bosch"
chip = "bma180"
channel = 0
address = 0x40
range = 2

[[sensor]]
name = "Gyro"
chip = "l3g4200d"
channel = 0
address = 0x68
range = 250
rate_hz = 100
bandwidth_hz = 12.5

[[sensor]]
name = "Baro"
chip = "bmp180"
channel = 0
address = 0x77

[[sensor]]
name = "Compass"
chip = "hmc5883l"
channel = 0
address = 0x1E
range = 1.3

[[sensor]]
name = "Other"
chip = "l3g4200d"
channel = 1
address = 0x69
range = 250
"""


@contextmanager
def serve_array(config: Path) -> Iterator[int]:
    """The emulated array of `config` in a separate process, as a user starts it; its port."""
    command = [sys.executable, "-m", "firmware_emulator", str(config), "--usbip", "--port", "0"]
    with subprocess.Popen([*command, "--query", f"seed={SEED}"], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield int(process.stdout.readline().split()[3])
        finally:
            process.terminate()
