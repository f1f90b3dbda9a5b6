"""A case: what is recorded with what at work in it, how it is diagnosed, and what came of that.

A case is made of its number's seed alone, so that it can be made anew anywhere. Its logs and the diagnosis lie in one
folder, under a name that tells nothing; what was at work in it lies in another, which the scorer alone opens.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from imuarray.atomic import write_text

Half = Literal["development", "sealed"]
Kind = Literal["none", "single", "withheld", "unnamed", "pair", "removal"]
"""Nothing is wrong; one mechanism that the library of causes names; one whose names are withheld from the library; one
that no effect names; two at once; the model has an effect that the sensors have not.
"""


@dataclass(frozen=True)
class Put:
    """A mechanism put on sensors (none named: wherever it can be), `severity` in units of its reference size and
    `limits` in detection limits (nan: it is there or not, however severe).
    """

    mechanism: str
    severity: float
    limits: float
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """One case: its `number` within a half; `plan` names what is recorded (`PLANS`, or the experiments of a world),
    `puts` what is at work, `seed` draws units, noise and chance. `without` are effects withheld from the library of
    causes, `extra` is a table of one effect that the model has besides, `resembles` what each of `puts` may rightly be
    called.

    `world` says who made it: "" the fixed plans of the emulated bench, "emulator" a random world, drawn of the seed
    `draw`, else what the folder `source` says from which it was read. `is_hidden`: the plan can't show it. `chips` says
    which chip a sensor is, `strata` what a judge may want apart; `control` names the same recording before something
    was put into it.
    """

    number: int
    half: Half
    kind: Kind
    plan: str
    puts: tuple[Put, ...]
    seed: int
    without: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    resembles: tuple[tuple[str, ...], ...] = ()
    world: str = ""
    draw: int = 0
    source: str = ""
    is_hidden: bool = False
    chips: Mapping[str, str] = field(default_factory=dict)
    strata: Mapping[str, str] = field(default_factory=dict)
    control: str = ""

    @property
    def name(self) -> str:
        """Of its files; tells nothing."""
        return f"{self.half}-{self.number:05d}"

    def table(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Case:
        """The case of such a table."""
        puts = tuple(Put(**{**put, "sensors": tuple(put["sensors"])}) for put in table["puts"])
        resembles = tuple(tuple(names) for names in table["resembles"])
        return cls(**{**table, "puts": puts, "resembles": resembles, "without": tuple(table["without"])})


@dataclass(frozen=True)
class Outcome:
    """What came of a case. `diagnosis` is the JSON of the blind diagnosis; `oracle` the share of the gap closed with
    its interval, of somebody who is told the effects ({} if there are none to tell); `error` is what went wrong, ""
    if nothing did; `seconds` it took.
    """

    name: str
    diagnosis: Mapping[str, Any]
    oracle: Mapping[str, Any]
    seconds: float
    error: str = ""


def write_json(path: Path, table: Any) -> None:
    """Whole or not at all: a file with this name is complete."""
    write_text(path, json.dumps(table, indent=1) + "\n", force=True)
