"""When the recorder reads which sensor, and on which clock."""

from __future__ import annotations

import numpy as np

from tests.field_world.streams import stream


class Logger:
    """A recorder: a microcontroller with a timer ("mcu"), or a Linux board that is late now and then ("linux").

    `ppm` is the error of its clock; `busy` counts seconds-long loads of the computer, `stall` scales its single delays;
    `gaps` and `restarts` (start and end, s) have no frames; with `catchup` a late recorder reads the frames that it
    owes.
    """

    kind = "linux"

    def __init__(
        self,
        rate,
        kind="linux",
        ppm=None,
        busy=0,
        gaps=(),
        stall=1.0,
        restarts=(),
        burst=0.00032,
        catchup=False,
    ):
        self.rate, self.kind, self.ppm, self.busy, self.gaps, self.stall = rate, kind, ppm, busy, gaps, stall
        self.restarts, self.burst, self.catchup = restarts, burst, catchup

    def frames(self, key, dur):
        """Return the true start times of the frames, and the gaps in them (start, end, reason)."""
        g = stream(*key, "logger")
        n = np.arange(int(dur * self.rate))
        t = n / self.rate
        self.clock_ppm = (
            self.ppm if self.ppm is not None else (g.normal(0, 8) if self.kind == "linux" else g.normal(0, 30))
        )
        holes = [(a, b, "lost") for a, b in self.gaps] + [(a, b, "restart") for a, b in self.restarts]
        if self.kind == "mcu":
            # a timer interrupt, on the recorder's own crystal
            t = (
                t / (1 + self.clock_ppm * 1e-6)
                + 4e-6 * g.integers(0, 2, len(t))
                + (g.random(len(t)) < 0.01) * g.uniform(0, 6e-5, len(t))
            )
        else:
            lat = 70e-6 + g.gamma(2.0, 22e-6, len(t))
            k = g.random(len(t)) < 0.002 * self.stall
            lat[k] += g.exponential(0.004, k.sum())
            for _ in range(self.busy):
                a, d = g.uniform(0, dur), g.uniform(2, 9)
                k = (t > a) & (t < a + d)
                lat[k] += g.exponential(0.35 / self.rate, k.sum())
                if g.random() < 0.7:
                    i = int(a * self.rate) + g.integers(0, 50)
                    if i < len(lat):
                        lat[i] += g.uniform(2, 25) / self.rate
            d = 0.75 / self.rate if not self.catchup else max(0.0006, 0.3 / self.rate)
            u = np.maximum.accumulate(t + lat - d * n) + d * n  # the frame before must be through
            if not self.catchup:  # deadlines that passed are skipped
                keep = np.ones(len(t), bool)
                late = u - t > 1.0 / self.rate
                keep[late] = False
                u = u[keep]
            t = u
        t = t + 0.004 + g.uniform(0, 0.002)
        for a, b, _ in holes:
            t = t[(t < a) | (t > b)]
        return t[t < dur], sorted(holes)

    def stamp(self, t):
        """Return the times (ns) of true instants on the recorder's clock."""
        x = t * (1 + self.clock_ppm * 1e-6)
        if self.kind == "mcu":
            return np.floor(x * 1e6 / 4).astype(np.int64) * 4000
        return np.rint(x * 1e9).astype(np.int64)


def burst_times(log, key, sensors, frames):
    """Return when each sensor is read, by its name: within a frame, the bursts follow one another."""
    g = stream(*key, "bursts")
    out, off = {}, 0.0
    last = None
    for s in sensors:
        if last is not None and s.channel != last:
            off += 0.00011
        last = s.channel
        f = frames[(np.arange(len(frames)) % s.divisor) == (_turn(s.name) % s.divisor)]
        j = g.gamma(2.0, 6e-6, len(f)) if log.kind == "linux" else 4e-6 * g.integers(0, 2, len(f))
        out[s.name] = f + off + j
        off += log.burst * (0.8 if s.kind == "mag" else 1.0)
    return out


def _turn(name):
    return sum(map(ord, name)) % 7
