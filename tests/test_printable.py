"""Names in a sentence, and names of files."""

from __future__ import annotations

import json
import os

from imuarray.log.format import Event
from imuarray.log.journal import note_columns
from imuarray.printable import encodable, series


def test_names_are_joined_into_a_series() -> None:
    assert [series(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]


def test_names_of_files_that_are_no_text_can_be_written() -> None:
    """A byte ff in a name is the surrogate dcff in Python (PEP 383), which UTF-8 refuses."""
    name = os.fsdecode(b"log\xff.h5")
    assert encodable(name).encode() == b"log\xef\xbf\xbd.h5"
    assert encodable("käfer.h5") == "käfer.h5"
    line = bytes(note_columns(Event(0, "", "imported", name))["text"])
    assert json.loads(line) == {"event": [0, "", "imported", "log\ufffd.h5"]}
