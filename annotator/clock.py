"""Times as people read them."""

from __future__ import annotations

from datetime import datetime


def local_minute(time: str) -> str:
    """Day and minute of an ISO 8601 time in UTC, in the time of this place."""
    try:
        return datetime.fromisoformat(time).astimezone().strftime("%Y-%m-%d %H:%M")
    except ValueError:
        return "an unknown time"
