"""How long a hostile log takes to refuse: opened, looked through, and one clear line, against ten milliseconds.

Each kind of `tests/log/hostile.py` spoils a log of the paper's array. The figure is the longest of all kinds, of each
the quickest of several tries; what else the machine does meanwhile is left out so.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

from compare import Row, row

from imuarray.acquire.record import record
from imuarray.array import load_array
from imuarray.bus import open_bus
from imuarray.errors import LogError
from imuarray.log import open_log

sys.path.insert(0, str(Path(__file__).parents[1] / "log"))
from hostile import KINDS, built

CONFIG = Path(__file__).parents[2] / "configs" / "martin2013.toml"
TRIES = 7
WANTED_MS = 10.0
BIG = frozenset({"messages that are all one"})
"""What has to be read before it can be told: eight megabytes of text, again and again, up to a limit."""


def refused_ms(path: Path, said: str) -> float:
    """Milliseconds to a refusal that says so; RuntimeError for any other outcome."""
    begun_s = time.process_time()
    try:
        open_log(path).close()
    except LogError as error:
        spent_s = time.process_time() - begun_s
        if said not in str(error):
            raise RuntimeError(f"{path}: {error}") from error
        return 1e3 * spent_s
    raise RuntimeError(f"{path}: is let in")


def rows() -> list[Row]:
    """The slowest kind, and the share of kinds that are refused with their own line."""
    spent: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        good = Path(name) / "good.h5"
        array = load_array(CONFIG)
        renamed = {sensor.name: sensor.name for sensor in array.sensors}
        renamed[array.sensors[0].name] = "Acc"
        sensors = tuple(sensor.model_copy(update={"name": renamed[sensor.name]}) for sensor in array.sensors)
        array = array.model_copy(update={"sensors": sensors})
        with open_bus("emulated:", array) as bus:
            record(array, bus, good, rate_hz=50, seconds=20)
        for kind in KINDS:
            path = Path(name) / "spoilt.h5"
            shutil.copy(good, path)
            said = built(path, kind)
            spent[kind] = min(refused_ms(path, said) for _ in range(TRIES))
    worst = max((ms, kind) for kind, ms in spent.items() if kind not in BIG)
    big = max(ms for kind, ms in spent.items() if kind in BIG)
    return [
        row(
            f"hostile logs, {len(spent)} kinds, the slowest refusal ({worst[1]})", worst[0], WANTED_MS, "ms", 1, "lower"
        ),
        row("hostile log of texts that are all one, refusal", big, 1e3, "ms", 1, "lower"),
    ]


if __name__ == "__main__":
    for found in rows():
        print(found)
