"""A machine whose I2C adapters are plugged in and unplugged: a tree like sysfs, and device files that emulated adapters
serve.

It does as Linux does (drivers/i2c/i2c-core-base.c, i2c-mux.c): an adapter that is unplugged leaves sysfs at once, but
while a program has it open its removal is not finished, and until then nothing at its port is seen. Of a multiplexer
that the kernel drives the channels go one after the other, each when the one before it is closed, and the adapter last.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from firmware_emulator.device_file import Adapter, Message, device_files
from firmware_emulator.wire import Wire


class Plugged(Adapter):
    """An adapter that fails as i2c-tiny-usb does when its cable is pulled: EIO."""

    def __init__(self, wire: Wire, there: Callable[[], bool]) -> None:
        super().__init__(wire)
        self.there = there

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        if not self.there():
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return super().transfer(messages)


class Machine:
    """`devices` is its /sys/bus/i2c/devices; numbers that are served are those of `wires`."""

    def __init__(self, folder: Path, wires: Mapping[int, Wire]) -> None:
        self.folder = folder
        self.devices = folder / "bus/i2c/devices"
        self.devices.mkdir(parents=True)
        self.wires = dict(wires)
        self.there: set[int] = set()
        self._going: list[int] = []
        self._pulled: Path | None = None

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Its device files can be opened inside the block."""
        adapters = {
            f"/dev/i2c-{number}": Plugged(wire, lambda number=number: number in self.there)  # type: ignore[misc]
            for number, wire in self.wires.items()
        }
        with device_files(adapters):
            yield

    def plug(
        self,
        number: int,
        port: str,
        serial: str = "",
        *,
        vendor: str = "0403",
        channels: Mapping[int, int] | None = None,
    ) -> None:
        """An i2c-tiny-usb adapter appears at a port; `channels` of a kernel-driven multiplexer at 0x70 by number."""
        assert not self._going, "the port is blocked: a program holds an adapter that was unplugged"
        usb = self.folder / "devices/pci0000:00/0000:00:14.0/usb1" / port
        (usb / f"{port}:1.0").mkdir(parents=True)
        for name, text in (("idVendor", vendor), ("idProduct", "c631"), ("serial", serial)):
            if text:
                (usb / name).write_text(text + "\n")
        root = usb / f"{port}:1.0" / f"i2c-{number}"
        self._add(number, root, f"i2c-tiny-usb at bus 001 device {number + 10:03d}")
        for channel, own in (channels or {}).items():
            mux = root / f"{number}-0070"
            mux.mkdir(exist_ok=True)
            self._add(own, root / f"i2c-{own}", f"i2c-{number}-mux (chan_id {channel})")
            (root / f"i2c-{own}" / "mux_device").symlink_to(mux)
            (mux / f"channel-{channel}").symlink_to(root / f"i2c-{own}")

    def _add(self, number: int, folder: Path, name: str) -> None:
        folder.mkdir()
        (folder / "name").write_text(name + "\n")
        (self.devices / f"i2c-{number}").symlink_to(folder)
        self.there.add(number)

    def unplug(self, *numbers: int) -> None:
        """The cable is pulled: transfers fail at once, entries go in this order, each when the one before is closed."""
        self.there -= set(numbers)
        self._going = list(numbers)
        root = (self.devices / f"i2c-{numbers[-1]}").resolve()
        self._pulled = root.parent.parent
        self._remove_first()

    def _remove_first(self) -> None:
        if self._going:
            link = self.devices / f"i2c-{self._going[0]}"
            shutil.rmtree(link.resolve())
            link.unlink()

    def work(self) -> None:
        """Let the kernel go on with a removal."""
        while self._going and not self.opened(self._going[0]):
            self._going.pop(0)
            self._remove_first()
        if not self._going and self._pulled is not None:
            shutil.rmtree(self._pulled)
            self._pulled = None

    def opened(self, number: int) -> int:
        """How many descriptors of this process lead to a device file."""
        links = [path.readlink() for path in Path("/proc/self/fd").iterdir() if path.is_symlink()]
        return sum(link.name.endswith(f"_dev_i2c-{number}") for link in links)
