"""Recorded logs as the diagnosis reads them: rows, phases, attitudes, and events of single rows."""
