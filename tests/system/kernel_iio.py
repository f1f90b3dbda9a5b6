"""The program in the guest of test_kernel_iio.py: the kernel's drivers bind to emulated chips, which are logged.

python -m tests.system.kernel_iio FOLDER PORT
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

from tests.system.guest_program import BUSYBOX, DEVICES, LOGS, Bench, wait_for

IIO = Path("/sys/bus/iio/devices")
QUEUED = {"mpu6050": 0x68, "lsm6dso": 0x6A}
CHIPS = {**QUEUED, "l3g4200d": 0x69, "lis3mdl": 0x1C}
"""Names by which the kernel's drivers know them, and their addresses; the first have queues, for which the drivers want
an interrupt.
"""
NAMES = {"mpu6050", "l3g4200d", "lsm6dso_accel", "lsm6dso_gyro", "lis3mdl"}
"""Names that the drivers give their devices."""
TRIGGER = "sysfstrig7"
PULLS_S = 0.2
"""Between two pulls of the trigger."""


def names() -> set[str]:
    return {path.read_text().strip() for path in IIO.glob("iio:device*/name")}


def load(module: Path) -> bool:
    """Load a module, if it exists."""
    if module.exists():
        subprocess.run([BUSYBOX, "insmod", str(module)], check=True)
    return module.exists()


def log(bench: Bench, name: str, seconds: float, rate_hz: float) -> None:
    """Log the configuration `name` for a while."""
    words = ("log", str(bench.folder / f"{name}.toml"), "-o", str(LOGS / f"{name}.h5"), "--rate-hz", f"{rate_hz}")
    bench.run(name, *words, "--seconds", f"{seconds}")


def pull(trigger: Path, stopped: threading.Event) -> None:
    """Pull the trigger repeatedly."""
    while not stopped.wait(PULLS_S):
        trigger.write_text("1")


def log_what_is_triggered(bench: Bench) -> None:
    """Log two devices that a trigger captures, which a thread pulls."""
    (IIO / "iio_sysfs_trigger/add_trigger").write_text("7")
    (trigger,) = [path.parent for path in IIO.glob("trigger*/name") if path.read_text().strip() == TRIGGER]
    stopped = threading.Event()
    thread = threading.Thread(target=pull, args=(trigger / "trigger_now", stopped))
    thread.start()
    try:
        log(bench, "captured", 8.0, 2.0)
    finally:
        stopped.set()
        thread.join()


def check(folder: Path, port: str) -> None:
    """Devices that are polled, that a trigger captures, and whose queues the drivers drain, as far as there are modules
    for it.
    """
    LOGS.mkdir()
    bench = Bench(folder, port)
    try:
        number = bench.plug_in()
        has_interrupts = load(folder / "i2c_interrupt.ko")
        for chip, address in CHIPS.items():
            if has_interrupts and chip in QUEUED:
                Path("/sys/module/i2c_interrupt/parameters/device").write_text(f"{number} {chip} {address:#x}\n")
            else:
                (DEVICES / f"i2c-{number}" / "new_device").write_text(f"{chip} {address:#x}\n")
        wait_for("the kernel's drivers", lambda: names() >= NAMES)
        (folder / "names.json").write_text(json.dumps(sorted(names())))
        bench.run("detect", "detect", str(folder / "polled.toml"), "--json")
        log(bench, "polled", 12.0, 1.0)
        if load(folder / "iio-trig-sysfs.ko"):
            log_what_is_triggered(bench)
        if has_interrupts:
            log(bench, "queued", 8.0, 2.0)
    finally:
        (folder / "codes.json").write_text(json.dumps(bench.codes))
        for path in LOGS.iterdir():
            (folder / path.name).write_bytes(path.read_bytes())


if __name__ == "__main__":
    check(Path(sys.argv[1]), sys.argv[2])
