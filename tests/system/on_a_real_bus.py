"""What runs in the guest of test_own_python.py: this project's commands on the kernel's /dev/i2c-N, in one process.

Python takes long to start there, so that each command is a fork of this process, which has everything loaded. What a
command prints goes to NAME.out and NAME.err beside the configuration; `codes.json` has the exit codes.

    on_a_real_bus.py FOLDER PORT
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
from pathlib import Path

from imuarray.cli import main
from imuarray.log.journal import journal_of

DEVICES = Path("/sys/bus/i2c/devices")
BUSYBOX = "/run/busybox"
HOST = "10.0.2.2"
WAIT_S = 90.0
"""For anything that should happen; two hundred times what most of it takes."""
LOGS = Path("/tmp/logs")


def wait_for(what: str, condition: Callable[[], bool]) -> None:
    """RuntimeError if it does not come true in time."""
    end = time.monotonic() + WAIT_S
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError(f"not within {WAIT_S:.0f} s: {what}")
        time.sleep(0.05)


def adapters() -> dict[int, str]:
    """The names of the kernel's I2C adapters by number."""
    return {int(path.parent.name[4:]): path.read_text().strip() for path in DEVICES.glob("i2c-*/name")}


def emulated() -> int | None:
    """The number of the adapter that was plugged in, once its device file is there."""
    numbers = [number for number, name in adapters().items() if name.startswith("i2c-tiny-usb")]
    return numbers[0] if numbers and Path(f"/dev/i2c-{numbers[0]}").exists() else None


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
        """Wait for a command, with the signal `how` if it goes on by itself."""
        if how is not None:
            os.kill(process, how)
        self.codes[name] = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])

    def run(self, name: str, *arguments: str) -> None:
        """A command from beginning to end."""
        self.end(name, self.start(name, *arguments))

    def log(self, name: str, number: int, *more: str, config: str = "bench.toml") -> int:
        """Begin a log; its process, once rows are stored."""
        where = ("--bus", f"i2c:/dev/i2c-{number}", "-o", str(LOGS / f"{name}.h5"), "--rate-hz", "5")
        process = self.start(name, "log", str(self.folder / config), *where, *more)
        wait_for(f"rows of the log {name}", lambda: self.stored(name) > 0)
        self.more_rows(name)
        return process

    def stored(self, name: str) -> int:
        """Bytes of the log's journal: it grows by every block of rows."""
        try:
            return journal_of(LOGS / f"{name}.h5").stat().st_size
        except OSError:
            return 0

    def more_rows(self, name: str, times: int = 5) -> None:
        """Wait until more rows were stored, several times."""
        for _ in range(times):
            before = self.stored(name)
            wait_for(f"more rows of the log {name}", lambda before=before: self.stored(name) > before)  # type: ignore[misc]

    def told(self, name: str, word: str) -> None:
        """Wait until the log has told of something on standard error."""
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
    bench.told("shared", "Gyro taken")
    bench.more_rows("shared")
    (DEVICES / f"i2c-{number}" / "delete_device").write_text("0x68\n")
    bench.told("shared", "Gyro reconfigured")
    bench.more_rows("shared")
    bench.end("shared", log, signal.SIGINT)


def unplug_during_a_log(bench: Bench, number: int) -> int:
    """Another adapter takes the number while the plug is out; the number under which it comes back."""
    log = bench.log("unplugged", number)
    bench.unplug()
    wait_for("the adapter's removal", lambda: number not in adapters())
    subprocess.run([BUSYBOX, "insmod", str(bench.folder / "i2c-stub.ko"), "chip_addr=0x50"], check=True)
    wait_for("the other adapter", lambda: number in adapters())
    again = bench.plug_in()
    bench.told("unplugged", f"/dev/i2c-{again}")
    bench.more_rows("unplugged")
    bench.end("unplugged", log, signal.SIGINT)
    (bench.folder / "numbers.json").write_text(json.dumps([number, again]))
    return again


def kill_and_recover(bench: Bench, number: int) -> None:
    """The journal holds what a killed log had stored."""
    log = bench.log("killed", number)
    bench.end("killed", log, signal.SIGKILL)
    path = LOGS / "killed.h5"
    shutil.copy(path, bench.folder / "unfinished.h5")
    shutil.copy(journal_of(path), journal_of(bench.folder / "unfinished.h5"))
    bench.run("recover", "recover", str(path))
    bench.run("verify", "verify", str(path))


def let_the_kernel_drive_the_multiplexer(bench: Bench, number: int) -> None:
    """Each channel is a bus of its own."""
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
    """The plug is pulled, and nobody puts it in again."""
    log = bench.log("lost", number)
    bench.unplug()
    wait_for("the adapter's removal", lambda: number not in adapters())
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
