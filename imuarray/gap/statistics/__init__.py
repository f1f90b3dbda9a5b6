"""Summaries of a campaign, computed in one pass over its rows, the statistics that probes compute from them, and the
likelihood of the statistics.
"""
