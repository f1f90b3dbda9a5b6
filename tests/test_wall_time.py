"""Wall times as ISO 8601 texts."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest

from imuarray.wall_time import iso_text, unix_ns, wall_time


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-01T00:00:00Z", 0.0),
        ("2001-09-09T01:46:40", 1e9),  # no zone: UTC
        ("2001-09-09T03:46:40.5+02:00", 1e9 + 0.5),
    ],
)
def test_times_are_in_utc(text: str, seconds: float) -> None:
    moment = wall_time(text)
    assert moment is not None
    assert moment.utcoffset() == timedelta(0)
    assert moment.timestamp() == seconds
    assert unix_ns(text) == seconds * 1e9


@pytest.mark.parametrize("text", ["", "yesterday", "2001-13-01", "0001-01-01T00:00:00+14:00"])
def test_a_text_that_is_no_date_has_no_time(text: str) -> None:
    assert wall_time(text) is None
    assert unix_ns(text) is None


def test_a_moment_in_any_zone_is_written_in_utc() -> None:
    moment = datetime(2013, 9, 16, 10, 30, tzinfo=timezone(timedelta(hours=2)))
    assert iso_text(moment) == "2013-09-16T08:30:00.000000Z"
    assert iso_text(datetime(2013, 9, 16, tzinfo=UTC), "seconds") == "2013-09-16T00:00:00Z"
