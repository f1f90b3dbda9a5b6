"""The two ways to replay a conversation; `replay.py` is loaded by its path, as tests/facts/mutation.py does."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def replay() -> ModuleType:
    spec = spec_from_file_location("golden_replay", Path(__file__).with_name("replay.py"))
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
