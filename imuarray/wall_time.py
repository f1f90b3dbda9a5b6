"""Wall times as ISO 8601 texts, such as the epoch of a log; a time without a zone is in UTC."""

from __future__ import annotations

from datetime import UTC, datetime

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def wall_time(text: str) -> datetime | None:
    """Return the time, in UTC, of an ISO 8601 text; None if the text is not one."""
    try:
        moment = datetime.fromisoformat(text)
        return moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None


def unix_ns(text: str) -> int | None:
    """Return the nanoseconds from 1970 to the time of an ISO 8601 text; None if the text is not one."""
    moment = wall_time(text)
    if moment is None:
        return None
    since = moment - _UNIX_EPOCH
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def iso_text(moment: datetime, timespec: str = "microseconds") -> str:
    """Return a time of any zone as ISO 8601 text in UTC, with a Z at its end."""
    return moment.astimezone(UTC).isoformat(timespec=timespec).replace("+00:00", "Z")
