"""How noisy a sensor at rest is: Allan deviation, spread, correlation, codes, gaps; as numbers, text and a figure."""

from imuarray.characterise.allan import AllanCurve, allan_deviation
from imuarray.characterise.noise import NoiseStatistics, noise_statistics
from imuarray.characterise.result import characterise_log
from imuarray.characterise.text import render_text

__all__ = ["AllanCurve", "NoiseStatistics", "allan_deviation", "characterise_log", "noise_statistics", "render_text"]
