"""What the recorder reads of each sensor in the logs of a case."""

from __future__ import annotations

import numpy as np

from tests.field_world.chain import convert
from tests.field_world.parts import Part
from tests.field_world.recorder import burst_times


class Readings:
    """The specimens of a case and the rows that they give; `offset` is added to the seed."""

    def __init__(self, case, offset):
        self.case, self.key = case, ("field", offset, case.name)
        self.parts = {s.name: Part(self.key, s) for s in case.sensors if s.kind != "baro"}
        for s in case.sensors:  # a six-axis chip has one clock
            if s.die:
                first = next(x for x in case.sensors if x.die == s.die)
                self.parts[s.name].clock = self.parts[first.name].clock
        self.cache = {}

    def worlds(self):
        """Return the worlds of the logs."""
        worlds = self.case.worlds(self.key)
        return worlds if isinstance(worlds, list) else [worlds]

    def poll(self, k, w):
        """Return the times at which each sensor is read in log `k`, the gaps, and the error of the clock in ppm."""
        if ("poll", k) not in self.cache:
            case, key = self.case, (*self.key, k)
            frames, gaps = case.logger.frames(key, w.dur)
            self.cache["poll", k] = (burst_times(case.logger, key, case.sensors, frames), gaps, case.logger.clock_ppm)
        return self.cache["poll", k]

    def read(self, w, s, k, faults, alt=0):
        """Return the rows of sensor `s` in log `k`: times, index of the output read, codes, values before rounding."""
        t = self.poll(k, w)[0][s.name]
        active = [x for x in faults if x.sensor == s.name and x.on]
        c = convert(w, s, self.parts[s.name], self.key, k, active, alt)
        read_at = t
        for x in active:
            read_at = x.read_delay(c, read_at)
        index = np.clip(np.searchsorted(c.ty, read_at - 3e-5, "right") - 1, 0, len(c.ty) - 1)
        d = {"t": t, "idx": index, "c": c}
        for x in active:
            if x.name != "glitches":
                d = x.rows(c, d)
        d["counts"] = c.codes[d["idx"]].copy()
        d["real"] = c.real[d["idx"]]
        for x in active:
            if x.name == "glitches":
                d = x.rows(c, d)
        return d
