"""All probes by name: small pure functions of summaries, one file per domain."""

from __future__ import annotations

from types import MappingProxyType

from imuarray.gap.statistics.probes import (
    allan,
    autocorrelation,
    codes,
    cross_sensor,
    distribution,
    force,
    level,
    motion,
    run_to_run,
    spectrum,
    spread,
    status,
    temperature,
    timing,
    turns,
)
from imuarray.gap.statistics.probes.probe import (
    ArrayProbe,
    CampaignProbe,
    CrossProbe,
    Domain,
    LogProbe,
    PhaseProbe,
    Probe,
    Probes,
    RunsProbe,
)

__all__ = [
    "PROBES",
    "ArrayProbe",
    "CampaignProbe",
    "CrossProbe",
    "Domain",
    "LogProbe",
    "PhaseProbe",
    "Probe",
    "RunsProbe",
]

_DOMAINS = (
    *(level, spread, distribution, codes, spectrum, autocorrelation, allan),
    *(temperature, force, motion, turns, cross_sensor, run_to_run, timing, status),
)

PROBES: Probes = MappingProxyType({name: probe for domain in _DOMAINS for name, probe in domain.PROBES.items()})
"""All probes by name, domain by domain; each describes its value and lists the effects that change it."""
