"""The core of the firmware and its host build, compiled once a session."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.firmware import build


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if build.COMPILER is None:
        pytest.skip(build.NO_COMPILER)
    return tmp_path_factory.mktemp("firmware")


@pytest.fixture(scope="session")
def core(core_firmware: type[build.CoreFirmware]) -> build.Core:
    return core_firmware.core


@pytest.fixture(scope="session")
def host_program(folder: Path) -> Path:
    return build.program(folder)
