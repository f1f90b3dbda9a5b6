"""Summaries of a campaign in one pass over its rows, the statistics that probes make of them, and their likelihood."""
