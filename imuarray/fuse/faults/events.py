"""Events of a fault monitor: which axes it left out, since when, why, and when it took them back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from imuarray.units import READABLE_SI

UNIT: Mapping[str, str] = MappingProxyType({"specific_force": "g", "angular_rate": "dps"})
"""Unit of measuring ranges."""

_PLURAL: Mapping[str, str] = MappingProxyType(
    {
        "agrees": "agree",
        "gives": "give",
        "gave": "gave",
        "is": "are",
        "has": "have",
        "reads": "read",
        "scatters": "scatter",
    }
)
"""The verbs of the sentences, of one axis and of two."""

State = Literal["isolated", "not isolated", "readmitted", "silent", "back", "no redundancy"]


@dataclass(frozen=True)
class FaultEvent:
    """One thing that a person should know of a sensor.

    `time_ns` of the first frame of the window in which it was found, in the log's time; `sensor` and its `axes` ("x",
    "y", "z"); `kind` is the name of an effect (`bias`, `scale`, `stuck`, `range_reset`, `glitches`, `white_noise`,
    `random_walk`: the baseline walked off; `dropped_samples`: nothing valid comes). `state` says what was done:
    "isolated" leaves the axes out, "not isolated" leaves all in, because others explain it as well. `size_si` in m/s2
    or rad/s, of `scale` and `range_reset` a factor, of `white_noise` the ratio to the usual noise, of `dropped_samples`
    seconds. `significance` in standard deviations.
    """

    time_ns: int
    quantity: str
    sensor: str
    axes: tuple[str, ...]
    kind: str
    state: State
    size_si: float
    significance: float
    others: tuple[str, ...] = ()
    range: float | None = None
    """The measuring range, in the sensor's unit, that explains a `range_reset`."""

    @property
    def sentence(self) -> str:
        """The same for a person."""
        axes = "" if len(self.axes) == 3 else " " + " and ".join(self.axes)
        words = self._words()
        if len(self.axes) == 2:  # two axes are a plural; a whole sensor is not
            verb, rest = words.split(" ", 1)
            words = f"{_PLURAL[verb]} {rest}"
        return f"{self.time_ns * 1e-9:.2f} s: {self.sensor}{axes} {words}"

    def _words(self) -> str:
        """Return the sentence that names the fault and what is done about it, of one axis."""
        if self.state == "readmitted":
            return "agrees with the others again: back in use"
        if self.state == "back":
            return "gives valid readings again"
        if self.state == "silent":
            return f"gave no valid reading for {self.size_si:.1f} s; fused from the others"
        if self.state == "no redundancy":
            return "is left out; the remaining axes can't check each other: no further fault can be detected"
        significance = f"{self.significance:.0f} sigma"
        if self.state == "not isolated":
            others = " or ".join(self.others)
            return f"{self._fault()} ({significance}), or the fault is in {others}: not isolated, all stay in use"
        return f"{self._fault()} ({significance}): left out"

    def _fault(self) -> str:
        """Return the words that name the fault, of one axis."""
        factor, unit = READABLE_SI[self.quantity]
        size = f"{factor * self.size_si:.3g} {unit}"
        span = f"{self.range or 0:g} {UNIT[self.quantity]}"
        reset = f"has {self.size_si:.3g} times its scale, as if set to a range of {span}"
        words = {
            "bias": f"is off by {size}",
            "random_walk": f"has drifted by {size}",
            "scale": f"reads {self.size_si:.3g} times what the others read",
            "range_reset": reset,
            "stuck": "is stuck",
            "glitches": f"has readings that are off by up to {size}",
            "white_noise": f"scatters {self.size_si:.3g} times as much as before",
        }
        return words[self.kind]

    def as_json(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "time_s": self.time_ns * 1e-9,
            "quantity": self.quantity,
            "sensor": self.sensor,
            "axes": list(self.axes),
            "effect": self.kind,
            "state": self.state,
            "size_si": self.size_si,
            "significance": self.significance,
            "others": list(self.others),
            "sentence": self.sentence,
        }
