"""The firmware is compiled strictly, without heap or system, the RP2040's port against the declarations of the SDK."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.firmware.build import COMPILER, CORE, SOURCES, STRICT, compiled
from tests.selection import some


@pytest.mark.parametrize("sizes", some([((),), (("-DFIRMWARE_KEPT_BYTES=4096u", "-DFIRMWARE_LINE_BYTES=2560u"),)], 1))
def test_the_core_calls_only_the_memory_functions_of_c(folder: Path, sizes: tuple[str, ...]) -> None:
    if shutil.which("nm") is None:
        pytest.skip("no nm (Debian's package binutils)")
    for source in CORE:
        made = compiled(folder, "core.o", (source,), "-c", "-fno-stack-protector", *sizes)
        listed = subprocess.run(["nm", "-u", made], capture_output=True, text=True, check=True).stdout
        called = set(re.findall(r"U (\w+)", listed))
        assert {name for name in called if not name.startswith(("link_", "_GLOBAL"))} <= {
            "memcpy",
            "memmove",
            "memset",
            "memcmp",
            "memchr",
        }


@pytest.mark.parametrize("size", ["FIRMWARE_KEPT_BYTES=1000u", "FIRMWARE_LINE_BYTES=1500u", "FIRMWARE_LISTS=256u"])
def test_the_compiler_refuses_invalid_sizes(folder: Path, size: str) -> None:
    with pytest.raises(RuntimeError, match=r"negative|array"):
        compiled(folder, "core.o", (CORE[1],), "-c", f"-D{size}")


def test_the_port_for_the_rp2040_uses_the_sdk_as_it_is_declared(folder: Path) -> None:
    declared = Path(__file__).parent / "pico_sdk"
    flags = [flag for flag in STRICT if flag not in ("-std=c99", "-Wconversion")]
    words = [str(COMPILER), "-std=c11", *flags, "-fsyntax-only", f"-I{declared}", str(SOURCES / "rp2040/main.c")]
    ran = subprocess.run(words, capture_output=True, text=True)
    assert ran.stderr == ""
    assert ran.returncode == 0


@pytest.mark.slow
def test_the_makefile_builds_program_and_library(folder: Path) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make")
    subprocess.run(["make", "-s", "-C", SOURCES, f"BUILD={folder / 'made'}"], check=True, capture_output=True)
    assert {path.name for path in (folder / "made").iterdir()} == {"imuarray-firmware", "libimuarray-firmware.so"}
