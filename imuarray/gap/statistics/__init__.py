"""Summaries of a campaign from one pass over its rows, the statistics that probes compute from them, and their
likelihood.
"""
