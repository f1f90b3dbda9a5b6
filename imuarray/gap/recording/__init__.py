"""Recorded logs as the diagnosis takes them: rows, phases, attitudes, and what happened to single rows."""
