"""Reports, each one self-contained HTML page: numbers with units, figures with a sentence that says what to see."""

from imuarray.report.page import Figure, Section, Table, Verdict, write_page

__all__ = ["Figure", "Section", "Table", "Verdict", "write_page"]
