"""Reports, each one self-contained HTML page: numbers with units, and figures with captions."""

from imuarray.report.page import Figure, Section, Table, Verdict, write_page

__all__ = ["Figure", "Section", "Table", "Verdict", "write_page"]
