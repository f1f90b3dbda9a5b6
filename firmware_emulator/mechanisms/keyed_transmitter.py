"""A radio that is keyed nearby: noise while it sends, none while it doesn't."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from firmware_emulator.chip import Triple
from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site


@dataclass(frozen=True)
class KeyedTransmitter(SensorMechanism):
    """A transmitter nearby: for `sending_s` of every `period_s` the demodulated carrier adds Gaussian noise of `rms_g`
    or `rms_dps`.

    Reference: 15 mg or 0.5 dps, 1.5 s in every 9 s.
    """

    rms_g: float = 15e-3
    rms_dps: float = 0.5
    sending_s: float = 1.5
    period_s: float = 9.0

    @classmethod
    def at(cls, severity: float) -> Self:
        """A stronger transmitter."""
        return cls(rms_g=cls.rms_g * severity, rms_dps=cls.rms_dps * severity)

    def put_on(self, site: Site) -> None:
        """The sender keeps to its own time."""
        random, rms = site.run_random("radio"), site.by_unit(self.rms_g, self.rms_dps)
        offset_s = random.uniform(0.0, self.period_s)

        def noise(at_ns: int, value: Triple, own: Triple, bandwidth_hz: float) -> Triple:
            if (at_ns * 1e-9 + offset_s) % self.period_s >= self.sending_s:
                return value
            a, b, c = random.standard_normal(3).tolist()
            return value[0] + rms * a, value[1] + rms * b, value[2] + rms * c

        site.chain.noise.append(noise)
