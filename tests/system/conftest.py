"""Linux guests under QEMU with Debian's kernel: each runs one script and powers off.

`guest` has its own root, of busybox and a few tools. `host_guest` has this machine's root, read-only over 9p
with a writable overlay in memory: all that is installed here, this project and its Python included, runs there on
another kernel. `.ci/system-packages` fetches what is needed; where something is missing, the tests that ask for a guest
are skipped.
"""

from __future__ import annotations

import gzip
import lzma
import os
import re
import shutil
import stat
import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

HOST = "10.0.2.2"
"""The machine that runs QEMU, seen from the guest (QEMU's user networking)."""
TOOLS = ("i2cdetect", "i2cget", "i2cset", "i2ctransfer", "usbip")
SYSTEM_PATH = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
SHARE = "/mnt"
"""Where a `host_guest` has the test's folder, the only one of the host that it can write to."""
START = """#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /run /var/run /tmp
/bin/busybox --install -s /bin
export PATH=/tools:/bin
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
for module in $(cat /modules/order); do insmod /modules/$module || echo "insmod $module failed"; done
ifconfig lo 127.0.0.1 up
ifconfig eth0 10.0.2.15 netmask 255.255.255.0 up
"""
INIT = f"""{START}
sh /script > /dev/ttyS1 2>&1
poweroff -f
"""
# The page cache of cache=loose is what makes a Python bearable there; the root is read-only, so that it is never wrong.
HOST_INIT = f"""{START}
mkdir -p /host /layer /root
mount -t 9p -o trans=virtio,version=9p2000.L,cache=loose,msize=512000,ro host /host
mount -t tmpfs tmpfs /layer
mkdir /layer/upper /layer/work
mount -t overlay -o lowerdir=/host,upperdir=/layer/upper,workdir=/layer/work overlay /root
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000 share /root{SHARE}
mount -t tmpfs tmpfs /root/run
cp /script /root/run/script
cp /bin/busybox /root/run/busybox
chmod +x /root/run/script
for place in proc sys dev; do mount --move /$place /root/$place; done
exec switch_root /root /run/script > /root/dev/ttyS1 2>&1
"""
HOST_MODULES = ("virtio_pci", "9p", "9pnet_virtio", "overlay")

Files = dict[str, tuple[int, bytes]]
"""By path in the guest: mode and content; of a symbolic link, its target."""


def cache_folder() -> Path:
    """Where `.ci/system-packages` keeps what it downloads."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("IMUARRAY_CACHE") or Path(base) / "imuarray")


def kernels() -> list[tuple[Path, Path]]:
    """Kernel images that can be read, each with the folder of its modules: the cached one, then the installed ones."""
    candidates = []
    for root in (cache_folder() / "kernel", Path("/")):
        for image in sorted(root.glob("boot/vmlinuz-*"), reverse=True):
            release = image.name.removeprefix("vmlinuz-")
            folders = [root / "lib/modules" / release, root / "usr/lib/modules" / release]
            candidates += [(image, folder) for folder in folders if folder.is_dir() and os.access(image, os.R_OK)]
    return candidates


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


def initramfs(script: str, modules: Mapping[str, bytes], init: str = INIT) -> bytes:
    """The guest's first file system, compressed."""
    busybox = Path(shutil.which("busybox", path=SYSTEM_PATH) or "").read_bytes()
    files: Files = {
        "init": (stat.S_IFREG | 0o755, init.encode()),
        "script": (stat.S_IFREG | 0o755, script.encode()),
        "bin/busybox": (stat.S_IFREG | 0o755, busybox),
        "modules/order": (stat.S_IFREG | 0o644, "\n".join(f"{name}.ko" for name in modules).encode()),
    }
    files.update({f"modules/{name}.ko": (stat.S_IFREG | 0o644, content) for name, content in modules.items()})
    for tool in TOOLS:
        files.update(program_files(tool))
    return gzip.compress(archive(files), 1)


@dataclass(frozen=True)
class Machine:
    """What QEMU emulates: MiB of memory, further words of its command line and of the kernel's."""

    memory_mib: int = 256
    devices: tuple[str, ...] = ()
    kernel: str = "tsc=unstable"


def host_machine(share: Path) -> Machine:
    """A machine that sees this one's root, read-only, and `share`, which it can write to."""
    root = ("-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap")
    shared = ("-virtfs", f"local,path={share},mount_tag=share,security_model=none,multidevs=remap")
    return Machine(1024, (*root, *shared), "tsc=reliable clocksource=tsc")


def run_guest(folder: Path, image: Path, system: bytes, timeout_s: float, machine: Machine) -> str:
    """Boot, run, power off; the output of the script. AssertionError with the console's end if it took too long."""
    console, written, packed = folder / "console", folder / "written", folder / "initramfs"
    packed.write_bytes(system)
    # Software emulation: it is the same everywhere, and a /dev/kvm that is there need not work.
    processor = ["qemu-system-x86_64", "-accel", "tcg", "-machine", "pc", "-cpu", "max", "-smp", "1", "-no-reboot"]
    screens = ["-display", "none", "-monitor", "none", "-serial", f"file:{console}", "-serial", f"file:{written}"]
    network = ["-netdev", "user,id=net", "-device", "e1000,netdev=net,romfile="]
    # A busy host emulates the timer too late for the kernel's test of it, which would panic.
    words = f"console=ttyS0 panic=-1 loglevel=4 no_timer_check {machine.kernel}"
    boot = ["-m", str(machine.memory_mib), "-kernel", str(image), "-initrd", str(packed), "-append", words]
    try:
        subprocess.run([*processor, *screens, *network, *machine.devices, *boot], timeout=timeout_s, check=True)
    except subprocess.TimeoutExpired:
        texts = [path.read_text(errors="replace")[-3000:] for path in (console, written) if path.exists()]
        raise AssertionError(f"the guest did not finish within {timeout_s} s:\n" + "\n---\n".join(texts)) from None
    return written.read_text(errors="replace").replace("\r\n", "\n")


Run = Callable[[str, Iterable[str], float], str]


def require(*programs: str) -> None:
    """Skip the test unless all `programs` are installed."""
    missing = [name for name in programs if shutil.which(name, path=SYSTEM_PATH) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (.ci/system-packages installs them)")


def kernel_with(modules: Sequence[str]) -> tuple[Path, dict[str, bytes]]:
    """The first kernel that has all `modules`, and those with their dependencies; without one the test is skipped."""
    result = kernels()
    if not result:
        pytest.skip(f"no Linux kernel with modules in {cache_folder() / 'kernel'} (.ci/system-packages fetches one)")
    for image, folder in result:
        loaded = with_dependencies(["e1000", *modules], folder)
        absent = [name for name in modules if name.replace("-", "_") not in loaded]
        if not absent:
            return image, loaded
    pytest.skip(f"the kernel {image.name} has no module {', '.join(absent)} (.ci/system-packages fetches one that has)")


@pytest.fixture
def guest(tmp_path: Path) -> Run:
    """``guest(script, modules, timeout_s)``: the output of the script in a guest that has loaded the modules."""
    require("qemu-system-x86_64", "busybox", "ldd", *TOOLS)

    def run(script: str, modules: Iterable[str], timeout_s: float) -> str:
        image, loaded = kernel_with(tuple(modules))
        return run_guest(tmp_path, image, initramfs(script, loaded), timeout_s, Machine())

    return run


@dataclass(frozen=True)
class HostGuest:
    """A guest with this machine's root, which is booted by `run`; it finds the folder `share` at `SHARE`."""

    share: Path

    def module(self, name: str) -> Path | None:
        """The file of a module of the guest's kernel."""
        image, _ = kernel_with(HOST_MODULES)
        folder = dict(kernels())[image]
        return module_files(folder).get(name.replace("-", "_"))

    def run(self, script: str, modules: Iterable[str], timeout_s: float) -> str:
        """What the script, an executable that becomes process 1, writes in a guest that has loaded the modules. It
        ends with ``/run/busybox poweroff -f``.
        """
        image, loaded = kernel_with((*HOST_MODULES, *modules))
        system = initramfs(script, loaded, HOST_INIT)
        return run_guest(self.share, image, system, timeout_s, host_machine(self.share))


@pytest.fixture(scope="module")
def host_guest(tmp_path_factory: pytest.TempPathFactory) -> HostGuest:
    """See `HostGuest`; only root can read all of this machine's root."""
    require("qemu-system-x86_64", "busybox", "usbip")
    if os.geteuid() != 0:
        pytest.skip("the guest shares this machine's root, which only root can read in full")
    kernel_with(HOST_MODULES)
    return HostGuest(tmp_path_factory.mktemp("guest"))
