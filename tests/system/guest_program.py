"""The program in the guest of test_own_python.py: this project's commands on the kernel's /dev/i2c-N, in one process.

Python takes long to start there, so that each command is a fork of this process, which has everything loaded. What a
command prints is written to NAME.out and NAME.err in the folder of the configuration; `codes.json` has the exit codes.

    guest_program.py FOLDER PORT
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from itertools import zip_longest
from pathlib import Path

from imuarray.cli import main
from imuarray.errors import ImuArrayError
from imuarray.log import open_log
from imuarray.log.journal import journal_of

DEVICES = Path("/sys/bus/i2c/devices")
BUSYBOX = "/run/busybox"
HOST = "10.0.2.2"
WAIT_S = 90.0
"""For anything that should happen; two hundred times what most of it takes."""
RATE_HZ = "12.5"
"""Half of what the emulated processor stands."""
SILENCE_S = 3.0
"""A chip or an adapter is away for so long."""
LOGS = Path("/tmp/logs")


def wait_for(what: str, condition: Callable[[], bool]) -> None:
    """RuntimeError if it does not become true in time."""
    end = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError(f"not within {WAIT_S:.0f} s: {what}")
        time.sleep(0.2)


def adapters() -> dict[int, str]:
    """The names of the kernel's I2C adapters by number."""
    return {int(path.parent.name[4:]): path.read_text().strip() for path in DEVICES.glob("i2c-*/name")}


def emulated() -> int | None:
    """The number of the adapter that was plugged in, once its device file exists."""
    numbers = [number for number, name in adapters().items() if name.startswith("i2c-tiny-usb")]
    return numbers[0] if numbers and Path(f"/dev/i2c-{numbers[0]}").exists() else None


def occupy(module: Path, number: int) -> bool:
    """Give `number` to another adapter; False while the kernel has not freed it yet."""
    subprocess.run([BUSYBOX, "insmod", str(module), "chip_addr=0x50"], check=True)
    if number in adapters():
        return True
    subprocess.run([BUSYBOX, "rmmod", module.stem], check=True)
    return False


class Bench:
    """The guest's end of the emulated array, and the commands that were run."""

    def __init__(self, folder: Path, port: str) -> None:
        self.folder = folder
        self._port = port
        self.codes: dict[str, int] = {}

    def plug_in(self) -> int:
        """The number that the kernel gives the adapter."""
        subprocess.run(["usbip", "--tcp-port", self._port, "attach", "-r", HOST, "-b", "1-1"], check=True)
        wait_for("the adapter", lambda: emulated() is not None)
        number = emulated()
        assert number is not None
        return number

    def unplug(self) -> None:
        """As if the plug were pulled."""
        subprocess.run(["usbip", "detach", "-p", "0"], check=True)

    def start(self, name: str, *arguments: str) -> int:
        """Begin a command; its process."""
        if (process := os.fork()) != 0:
            return process
        code = 125
        try:
            for descriptor, ending in ((1, "out"), (2, "err")):
                file = os.open(self.folder / f"{name}.{ending}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
                os.dup2(file, descriptor)
            code = main(arguments)
            sys.stdout.flush()
            sys.stderr.flush()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)

    def end(self, name: str, process: int, how: int | None = None) -> None:
        """Wait for a command, with the signal `how` if it does not end by itself."""
        if how is not None:
            os.kill(process, how)
        self.codes[name] = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])

    def run(self, name: str, *arguments: str) -> None:
        """A command from beginning to end."""
        self.end(name, self.start(name, *arguments))

    def log(self, name: str, number: int, *more: str, config: str = "bench.toml") -> int:
        """Begin a log; its process, once rows are stored."""
        where = ("--bus", f"i2c:/dev/i2c-{number}", "-o", str(LOGS / f"{name}.h5"), "--rate-hz", RATE_HZ)
        process = self.start(name, "log", str(self.folder / config), *where, *more)
        self.more_rows(name)
        return process

    def rows(self, name: str) -> list[int]:
        """How many rows of each sensor the log has by now; none before it exists."""
        path = LOGS / f"{name}.h5"
        if not journal_of(path).exists():
            return []
        try:
            with open_log(path) as log:
                return [len(log[sensor].time) for sensor in log.sensors]
        except ImuArrayError:  # it is only just being made
            return []

    def more_rows(self, name: str, count: int = 4) -> None:
        """Wait until every sensor of a log that is being written has `count` rows more."""
        before = self.rows(name)

        def grown() -> bool:
            now = self.rows(name)
            return bool(now) and all(rows - start >= count for rows, start in zip_longest(now, before, fillvalue=0))

        wait_for(f"more rows of the log {name}", grown)

    def wait_for_message(self, name: str, word: str) -> None:
        """Wait until the log has written a message to standard error."""
        path = self.folder / f"{name}.err"
        wait_for(f"{word!r} from the log {name}", lambda: word in path.read_text(errors="replace"))


def look(bench: Bench, number: int) -> None:
    """`detect`, with and without self-test."""
    words = ("detect", str(bench.folder / "bench.toml"), "--bus", f"i2c:/dev/i2c-{number}", "--json")
    bench.run("detect", *words)
    bench.run("self_test", *words, "--self-test")


def share_with_a_driver(bench: Bench, number: int) -> None:
    """A driver of the kernel takes a chip during a log, and gives it back. Only channel 0 is read: the driver's
    transactions go to the channel that the log has connected.
    """
    log = bench.log("shared", number, "--only", "Accel,Gyro")
    (DEVICES / f"i2c-{number}" / "new_device").write_text("l3g4200d 0x68\n")
    driver = DEVICES / f"{number}-0068" / "driver"
    wait_for("the kernel's driver", driver.exists)
    bench.wait_for_message("shared", "Gyro taken")
    time.sleep(SILENCE_S)
    (DEVICES / f"i2c-{number}" / "delete_device").write_text("0x68\n")
    bench.wait_for_message("shared", "Gyro reconfigured")
    bench.more_rows("shared")
    bench.end("shared", log, signal.SIGINT)


def unplug_during_a_log(bench: Bench, number: int) -> int:
    """Another adapter takes the number while the plug is out; the number under which it returns."""
    log = bench.log("unplugged", number)
    bench.unplug()
    wait_for("the adapter's removal", lambda: number not in adapters())
    wait_for("the other adapter", lambda: occupy(bench.folder / "i2c-stub.ko", number))
    again = bench.plug_in()
    bench.wait_for_message("unplugged", f"/dev/i2c-{again}")
    bench.more_rows("unplugged")
    bench.end("unplugged", log, signal.SIGINT)
    (bench.folder / "numbers.json").write_text(json.dumps([number, again]))
    return again


def kill_and_recover(bench: Bench, number: int) -> None:
    """The journal contains the rows that a killed log had stored."""
    log = bench.log("killed", number)
    bench.end("killed", log, signal.SIGKILL)
    path = LOGS / "killed.h5"
    shutil.copy(path, bench.folder / "unfinished.h5")
    shutil.copy(journal_of(path), journal_of(bench.folder / "unfinished.h5"))
    bench.run("recover", "recover", str(path))
    bench.run("verify", "verify", str(path))


def let_the_kernel_drive_the_multiplexer(bench: Bench, number: int) -> None:
    """Each channel is a separate bus."""
    subprocess.run([BUSYBOX, "insmod", str(bench.folder / "i2c-mux-pca954x.ko")], check=True)
    (DEVICES / f"i2c-{number}" / "new_device").write_text("pca9544 0x70\n")
    channels = [DEVICES / f"{number}-0070" / f"channel-{channel}" for channel in range(4)]
    wait_for("the multiplexer's channels", lambda: all(channel.exists() for channel in channels))
    text = (bench.folder / "bench.toml").read_text()
    text = "\n".join(line for line in text.splitlines() if not line.startswith("mux"))
    for index, channel in enumerate(channels):
        text = text.replace(f"channel = {index}", f'bus = "/dev/{channel.resolve().name}"')
    (bench.folder / "channels.toml").write_text(text)
    bench.run("detect_trunk", "detect", str(bench.folder / "bench.toml"), "--bus", f"i2c:/dev/i2c-{number}", "--json")
    words = (str(bench.folder / "channels.toml"), "--bus", f"i2c:/dev/i2c-{number}")
    bench.run("detect_channels", "detect", *words, "--json")
    log = bench.log("channels", number, config="channels.toml")
    bench.end("channels", log, signal.SIGINT)
    (DEVICES / f"i2c-{number}" / "delete_device").write_text("0x70\n")


def lose_everything(bench: Bench, number: int) -> None:
    """The adapter is unplugged and stays unplugged."""
    log = bench.log("lost", number)
    bench.unplug()
    bench.wait_for_message("lost", "was removed")
    time.sleep(SILENCE_S)
    bench.end("lost", log, signal.SIGINT)


def check(folder: Path, port: str) -> None:
    """Everything, one after the other."""
    LOGS.mkdir()
    bench = Bench(folder, port)
    try:
        number = bench.plug_in()
        look(bench, number)
        share_with_a_driver(bench, number)
        number = unplug_during_a_log(bench, number)
        kill_and_recover(bench, number)
        if (folder / "i2c-mux-pca954x.ko").exists():
            let_the_kernel_drive_the_multiplexer(bench, number)
        lose_everything(bench, number)
    finally:
        (folder / "codes.json").write_text(json.dumps(bench.codes))
        for path in LOGS.iterdir():
            shutil.copy(path, folder)


if __name__ == "__main__":
    check(Path(sys.argv[1]), sys.argv[2])
