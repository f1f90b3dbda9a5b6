"""Every fact id that code or tests cite belongs to a series that SOURCES.md explains."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = (ROOT / "imuarray" / "facts" / "SOURCES.md").read_text(encoding="utf-8")
SERIES = "BMA|ADX|L3G|BMP|HMC|INV|TDK|LSM|LIS|MMC|AKM|PCA|LNX|BUS|PAP|DEC"


def explained() -> set[str]:
    """Every id in the ranges of the second table; BUS and PAP are explained as a whole."""
    ids: set[str] = set()
    for series, first, last in re.findall(rf"^\| ({SERIES})-(\d+) to -(\d+) \|", SOURCES, flags=re.MULTILINE):
        ids |= {f"{series}-{number:02d}" for number in range(int(first), int(last) + 1)}
    for series, first, second in re.findall(rf"^\| ({SERIES})-(\d+), -(\d+) \|", SOURCES, flags=re.MULTILINE):
        ids |= {f"{series}-{int(first):02d}", f"{series}-{int(second):02d}"}
    return ids


def test_every_cited_fact_is_explained() -> None:
    known, cited = explained(), {}
    for folder in ("imuarray", "firmware_emulator", "tests", "configs"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".toml", ".jsonl"):
                for match in re.finditer(rf"\b({SERIES})-(\d+)\b", path.read_text(encoding="utf-8")):
                    cited[f"{match[1]}-{int(match[2]):02d}"] = path.name
    assert len(cited) > 200
    unknown = {fact: name for fact, name in cited.items() if fact not in known and fact[:3] not in ("BUS", "PAP")}
    assert unknown == {}
