# SPDX-License-Identifier: Apache-2.0
"""The times of some days in a zone, and how strong the sun is at them."""

from __future__ import annotations

import math
import re
from datetime import date, datetime, time, timedelta, timezone, tzinfo
from pathlib import Path
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.sun import FIRST_YEAR, LAST_YEAR, parse_time

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
        ValueError: it is something else, or of a year for which it is not known where the sun stands.
    """
    try:
        day = date.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"{field}: expected a day such as 2026-06-21, got {text!r}") from error
    if not FIRST_YEAR <= day.year <= LAST_YEAR:
        raise ValueError(f"{field}: expected the years {FIRST_YEAR} to {LAST_YEAR}, got {text!r}")
    return day


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


def irradiance_of(text: str, stamps: list[int]) -> float | npt.NDArray[np.float64]:
    """A number [W/m2], or one for each time from a CSV file: lines of a time in ISO 8601 and a number, the first line
    may be a head. Between its times it is interpolated.

    Raises:
        ValueError: it is neither, a line is malformed, or the times of the file do not cover those that are asked for.
    """
    try:
        return float(text)
    except ValueError:
        path = Path(text)
    if not path.is_file():
        raise ValueError(f"--irradiance: expected a number of W/m2 or a CSV file, got {text!r}")
    known: list[tuple[int, float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        cells = [cell.strip() for cell in line.split(",")]
        try:
            value = float(cells[1])
            known.append((parse_time(cells[0]), value))
        except (ValueError, IndexError) as error:
            if number == 1 or not line.strip():
                continue
            raise ValueError(f"--irradiance: {path.name}, line {number}: expected TIME,W/m2, got {line!r}") from error
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"--irradiance: {path.name}, line {number}: expected at least 0 W/m2, got {line!r}")
    at, values = np.array([stamp for stamp, _ in known], np.int64), np.array([value for _, value in known])
    if len(at) < 2 or (np.diff(at) <= 0).any() or at[0] > stamps[0] or at[-1] < stamps[-1]:
        raise ValueError(
            f"--irradiance: {path.name}: expected rising times that cover all that are asked for, from "
            f"{datetime.fromtimestamp(stamps[0] / 1e9, timezone.utc).isoformat()} to "
            f"{datetime.fromtimestamp(stamps[-1] / 1e9, timezone.utc).isoformat()}"
        )
    return np.interp(np.array(stamps, np.int64) - at[0], at - at[0], values)
