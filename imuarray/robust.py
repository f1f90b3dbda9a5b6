"""Medians as estimates of the scatter of Gaussian numbers, which outliers hardly change."""

from __future__ import annotations

MEDIAN_ABSOLUTE = 0.6744897501960817
"""Median of the absolute value of a standard normal number: its quantile of three quarters."""

MEDIAN_SQUARE = MEDIAN_ABSOLUTE**2
"""Median of a chi-squared number with one degree of freedom."""
