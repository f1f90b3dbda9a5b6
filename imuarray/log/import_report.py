"""The report on an import, kept in the log: what the importer left out or inferred, and what is doubtful.

The optional root attribute `import_report` of an imported log is a JSON object of lists of sentences. Readers that do
not know it are not affected.
"""

from __future__ import annotations

import json
from os import PathLike
from typing import Any, NamedTuple

import h5py

from imuarray.errors import LogError

IMPORT_REPORT = "import_report"
"""The root attribute with the report."""

_MOST_BYTES = 60_000
"""Most bytes of the attribute; HDF5 stores attributes of up to 64 KiB in the header of an object."""

_LISTS = ("facts", "remarks", "quirks", "doubts")


class ImportReport(NamedTuple):
    """Sentences about an imported recording: `facts` about its readings, `remarks` on what the importer left out,
    inferred or changed, `quirks` that concern its analysis, and `doubts` about its map or its readings.
    """

    facts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    quirks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def to_json(self) -> str:
        """Return the report as a JSON object; if it would be too long, its last sentences are omitted: facts first,
        then remarks, quirks and doubts.
        """
        lists = {name: list(sentences) for name, sentences in self._asdict().items()}
        while len(text := json.dumps(lists, ensure_ascii=False).encode("utf-8", "replace")) > _MOST_BYTES:
            longest = next((name for name in _LISTS if lists[name]), None)
            if longest is None:
                break
            lists[longest].pop()
        return text.decode()

    @classmethod
    def from_json(cls, text: Any) -> ImportReport | None:
        """Return the report that `to_json` wrote; None for anything else."""
        if not isinstance(text, str) or len(text) > _MOST_BYTES:
            return None
        try:
            lists = json.loads(text)
            sentences = [lists.get(name, []) for name in cls._fields]
        except (ValueError, AttributeError, RecursionError):
            return None
        if not all(isinstance(each, list) and all(isinstance(item, str) for item in each) for each in sentences):
            return None
        return cls(*map(tuple, sentences))


def store_import_report(path: str | PathLike[str], report: ImportReport) -> None:
    """Store the report in a finished log; LogError if the file cannot be written."""
    try:
        with h5py.File(path, "r+") as file:
            file.attrs[IMPORT_REPORT] = report.to_json()
    except OSError as error:
        raise LogError(f"{path}: the report on the import cannot be stored: {error}") from None
