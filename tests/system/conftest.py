"""A Linux guest under QEMU, made of Debian's kernel, busybox and a few tools; it runs one script and powers off.

`.ci/system-packages` fetches what is needed; where something is missing, the tests that ask for `guest` are skipped.
"""

from __future__ import annotations

import gzip
import lzma
import os
import re
import shutil
import stat
import subprocess
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import pytest

HOST = "10.0.2.2"
"""The machine that runs QEMU, seen from the guest (QEMU's user networking)."""
TOOLS = ("i2cdetect", "i2cget", "i2cset", "i2ctransfer", "usbip")
SYSTEM_PATH = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
INIT = """#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /run /var/run /tmp
/bin/busybox --install -s /bin
export PATH=/tools:/bin
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
for module in $(cat /modules/order); do insmod /modules/$module || echo "insmod $module failed"; done
ifconfig lo 127.0.0.1 up
ifconfig eth0 10.0.2.15 netmask 255.255.255.0 up
sh /script > /dev/ttyS1 2>&1
poweroff -f
"""

Files = dict[str, tuple[int, bytes]]
"""By path in the guest: mode and content; of a symbolic link, its target."""


def cache_folder() -> Path:
    """Where `.ci/system-packages` keeps what it downloads."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("IMUARRAY_CACHE") or Path(base) / "imuarray")


def kernels() -> list[tuple[Path, Path]]:
    """Kernel images that can be read, each with the folder of its modules: the cached one, then the installed ones."""
    found = []
    for root in (cache_folder() / "kernel", Path("/")):
        for image in sorted(root.glob("boot/vmlinuz-*"), reverse=True):
            release = image.name.removeprefix("vmlinuz-")
            folders = [root / "lib/modules" / release, root / "usr/lib/modules" / release]
            found += [(image, folder) for folder in folders if folder.is_dir() and os.access(image, os.R_OK)]
    return found


def module_files(folder: Path) -> dict[str, Path]:
    """Every module under `folder` by its name, with underscores as the kernel has it."""
    return {path.name.split(".ko")[0].replace("-", "_"): path for path in folder.rglob("*.ko*")}


def module_bytes(path: Path) -> bytes:
    """The module itself; newer Debian kernels ship them compressed."""
    return lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()


def with_dependencies(wanted: Iterable[str], folder: Path) -> dict[str, bytes]:
    """The modules and all that they depend on, in an order in which they can be loaded; what is no file is built in."""
    files, loaded = module_files(folder), dict[str, bytes]()

    def add(name: str) -> None:
        if name in loaded or name not in files:
            return
        content = module_bytes(files[name])
        depends = re.search(rb"\0depends=([^\0]*)\0", content)
        for other in depends[1].decode().split(",") if depends else ():
            add(other.replace("-", "_"))
        loaded[name] = content

    for name in wanted:
        add(name.replace("-", "_"))
    return loaded


def program_files(name: str) -> Files:
    """A program as /tools/<name>, with the libraries that ldd names."""
    path = Path(shutil.which(name, path=SYSTEM_PATH) or "").resolve()
    files: Files = {f"tools/{name}": (stat.S_IFREG | 0o755, path.read_bytes())}
    listed = subprocess.run(["ldd", path], capture_output=True, text=True, check=False).stdout
    for library in re.findall(r"(/\S+) \(0x", listed):
        files[library.lstrip("/")] = (stat.S_IFREG | 0o755, Path(library).read_bytes())
    return files


def archive(files: Mapping[str, tuple[int, bytes]]) -> bytes:
    """A cpio archive in the format "newc" that the kernel unpacks as its first root (initramfs buffer format)."""
    folders = {str(parent) for name in files for parent in Path(name).parents} - {"."}
    entries: list[tuple[str, int, bytes]] = [(name, stat.S_IFDIR | 0o755, b"") for name in sorted(folders)]
    entries += [(name, mode, content) for name, (mode, content) in files.items()]
    out = bytearray()
    for inode, (name, mode, content) in enumerate([*entries, ("TRAILER!!!", 0, b"")], 1):
        encoded = name.encode() + b"\0"
        numbers = (inode, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(encoded), 0)
        for part in (b"070701" + b"".join(b"%08X" % number for number in numbers) + encoded, content):
            out += part + bytes(-len(part) % 4)
    return bytes(out)


def initramfs(script: str, modules: Mapping[str, bytes]) -> bytes:
    """The guest's whole file system, compressed."""
    busybox = Path(shutil.which("busybox", path=SYSTEM_PATH) or "").read_bytes()
    files: Files = {
        "init": (stat.S_IFREG | 0o755, INIT.encode()),
        "script": (stat.S_IFREG | 0o755, script.encode()),
        "bin/busybox": (stat.S_IFREG | 0o755, busybox),
        "modules/order": (stat.S_IFREG | 0o644, "\n".join(f"{name}.ko" for name in modules).encode()),
    }
    files.update({f"modules/{name}.ko": (stat.S_IFREG | 0o644, content) for name, content in modules.items()})
    for tool in TOOLS:
        files.update(program_files(tool))
    return gzip.compress(archive(files), 1)


def run_guest(folder: Path, image: Path, system: bytes, timeout_s: float) -> str:
    """Boot, run, power off; what the script wrote. AssertionError with the console's end if it took too long."""
    console, written, packed = folder / "console", folder / "written", folder / "initramfs"
    packed.write_bytes(system)
    machine = ["qemu-system-x86_64", "-accel", "tcg", "-machine", "pc", "-cpu", "max", "-m", "256", "-no-reboot"]
    screens = ["-display", "none", "-monitor", "none", "-serial", f"file:{console}", "-serial", f"file:{written}"]
    network = ["-netdev", "user,id=net", "-device", "e1000,netdev=net,romfile="]
    boot = ["-kernel", str(image), "-initrd", str(packed), "-append", "console=ttyS0 panic=-1 loglevel=4 tsc=unstable"]
    try:
        subprocess.run([*machine, *screens, *network, *boot], timeout=timeout_s, check=True)
    except subprocess.TimeoutExpired:
        texts = [path.read_text(errors="replace")[-3000:] for path in (console, written) if path.exists()]
        raise AssertionError(f"the guest did not finish within {timeout_s} s:\n" + "\n---\n".join(texts)) from None
    return written.read_text(errors="replace").replace("\r\n", "\n")


@pytest.fixture
def guest(tmp_path: Path) -> Callable[[str, Iterable[str], float], str]:
    """``guest(script, modules, timeout_s)``: what the script writes in a guest that has loaded the modules."""
    needed = ("qemu-system-x86_64", "busybox", "ldd", *TOOLS)
    missing = [name for name in needed if shutil.which(name, path=SYSTEM_PATH) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (.ci/system-packages installs them)")
    found = kernels()
    if not found:
        pytest.skip(f"no Linux kernel with modules in {cache_folder() / 'kernel'} (.ci/system-packages fetches one)")

    def run(script: str, modules: Iterable[str], timeout_s: float) -> str:
        for image, folder in found:
            loaded = with_dependencies(["e1000", *modules], folder)
            absent = [name for name in modules if name.replace("-", "_") not in loaded]
            if not absent:
                return run_guest(tmp_path, image, initramfs(script, loaded), timeout_s)
        pytest.skip(f"the kernel {image.name} has no module {', '.join(absent)}")

    return run
