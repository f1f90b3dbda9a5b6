"""Localisation of the gap and the hypotheses that explain it; `effects` has one file for each effect."""
