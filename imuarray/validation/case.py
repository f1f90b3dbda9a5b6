"""A case of the validation: its recording plan, the mechanisms that are active in it, and the outcome of its diagnosis.

A case depends only on its seed, so it can be reproduced anywhere. Its logs and its diagnosis are in one folder under a
neutral name; the truth is in another folder, which only the scorer opens.
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
"""In this order: no mechanism; one mechanism that the library of causes names; one mechanism whose names are withheld
from the library; one mechanism that no effect describes; two mechanisms; an effect that only the model has.
"""


@dataclass(frozen=True)
class Put:
    """A mechanism placed on sensors (none are named if the mechanism determines where it acts). `severity` is in units
    of its reference size, `limits` in detection limits (nan if the mechanism has no size).
    """

    mechanism: str
    severity: float
    limits: float
    sensors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """One case. `number` counts within a half; `plan` is the name of the recording plan (`PLANS`, or the experiments of
    a world); `puts` are the active mechanisms; `seed` draws units, noise and events. `without` are effects withheld
    from the library of causes, `extra` is the table of an effect that only the model has, and `resembles` lists the
    correct effect names of each of `puts`.

    `world` names the origin: "" for the fixed plans of the emulated bench, "emulator" for a random world drawn from the
    seed `draw`, otherwise the name given in the folder `source`. `is_hidden`: the plan cannot show the mechanism.
    `chips` maps sensors to chips, `strata` are properties by which figures are broken down, and `control` is the name
    of the case with the same recording before the injection.
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
        """The name of its files, which reveals nothing about its truth."""
        return f"{self.half}-{self.number:05d}"

    def table(self) -> dict[str, Any]:
        """Return the case as a JSON table."""
        return asdict(self)

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> Case:
        """Return the case of such a table."""
        puts = tuple(Put(**{**put, "sensors": tuple(put["sensors"])}) for put in table["puts"])
        resembles = tuple(tuple(names) for names in table["resembles"])
        return cls(**{**table, "puts": puts, "resembles": resembles, "without": tuple(table["without"])})


@dataclass(frozen=True)
class Outcome:
    """The outcome of a case. `diagnosis` is the JSON of the blind diagnosis; `oracle` holds the share of the gap that a
    diagnosis with known effects closes, and its interval ({} without effects); `error` is the error message, "" without
    one; `seconds` is the processing time.
    """

    name: str
    diagnosis: Mapping[str, Any]
    oracle: Mapping[str, Any]
    seconds: float
    error: str = ""


def write_json(path: Path, table: Any) -> None:
    """Write the file completely or not at all, so that an existing file is always complete."""
    write_text(path, json.dumps(table, indent=1) + "\n", force=True)
