# SPDX-License-Identifier: Apache-2.0
"""The times of some days in a zone."""

from __future__ import annotations

import re
from datetime import date, datetime, time, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

_EVERY = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h)")
_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}
_MOST = 100_000  # times


def seconds_of(text: str) -> float:
    """Seconds of a text like 15min, 30s or 1h.

    Raises:
        ValueError: it is something else, or not from 1 s to 24 h.
    """
    found = _EVERY.fullmatch(text.strip())
    seconds = float(found.group(1)) * _SECONDS[found.group(2)] if found else 0.0
    if not 1.0 <= seconds <= 86_400.0:
        raise ValueError(f"--every: expected 1s to 24h, such as 15min, got {text!r}")
    return seconds


def zone_of(text: str) -> tzinfo:
    """A zone by its name, like Europe/Zurich, or its distance from UTC, like +02:00.

    Raises:
        ValueError: there is none.
    """
    found = re.fullmatch(r"([+-])(\d{1,2}):?(\d{2})?", text)
    if found:
        sign, hours, minutes = found.group(1), int(found.group(2)), int(found.group(3) or 0)
        if hours <= 14 and minutes < 60:
            away = timedelta(hours=hours, minutes=minutes)
            return timezone(-away if sign == "-" else away)
    try:
        return ZoneInfo(text)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        raise ValueError(f"--tz: expected a zone such as Europe/Zurich, UTC or +02:00, got {text!r}") from error


def day_of(text: str, field: str) -> date:
    """A day like 2026-06-21.

    Raises:
        ValueError: it is something else.
    """
    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"{field}: expected a day such as 2026-06-21, got {text!r}") from error


def times_of(first: date, last: date, every: float, zone: tzinfo) -> list[int]:
    """Times from midnight of the first day to before midnight behind the last, nanoseconds since 1970 UTC.

    Raises:
        ValueError: the last day is before the first, or there are too many times.
    """
    begin, end = (datetime.combine(day, time(), zone).timestamp() for day in (first, last + timedelta(days=1)))
    if end <= begin:
        raise ValueError(f"--until: expected {first} or later, got {last}")
    count = int(-(-(end - begin) // every))
    if count > _MOST:
        raise ValueError(f"--every: expected at most {_MOST} times, got {count}")
    return [round((begin + k * every) * 1e9) for k in range(count)]
