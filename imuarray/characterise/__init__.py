"""Noise of sensors at rest: Allan deviation and fitted noise, spectrum and lines, correlation, codes, times; as
numbers, text and figures. The names below are imported on first use, because SciPy is slow to import.
`imuarray.characterise(log)` does all of it and returns a `Characterisation` (`imuarray.analysis.characterise`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from imuarray.callable_package import make_callable, public_name

if TYPE_CHECKING:
    from imuarray.characterise.allan import AllanStream, allan_deviation
    from imuarray.characterise.allan_curve import AllanCurve
    from imuarray.characterise.allan_fit import NoiseFit, fit_noise
    from imuarray.characterise.characterisation import Characterisation, Coefficient, render_text
    from imuarray.characterise.noise import NoiseStatistics, noise_statistics
    from imuarray.characterise.result import characterise_log

_PUBLIC = {
    "allan": "AllanStream allan_deviation",
    "allan_curve": "AllanCurve",
    "allan_fit": "NoiseFit fit_noise",
    "characterisation": "Characterisation Coefficient render_text",
    "noise": "NoiseStatistics noise_statistics",
    "result": "characterise_log",
}

__all__ = [
    "AllanCurve",
    "AllanStream",
    "Characterisation",
    "Coefficient",
    "NoiseFit",
    "NoiseStatistics",
    "allan_deviation",
    "characterise_log",
    "fit_noise",
    "noise_statistics",
    "render_text",
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    return public_name(__name__, _PUBLIC, name)


make_callable(__name__)
