# SPDX-License-Identifier: Apache-2.0
"""Where the sun stands: from date, time and place, by the library ephem (extra ``sun``).

What is given is the apparent position, as a camera sees it: refraction of a standard atmosphere at sea level (1010 hPa,
15 degrees Celsius) is included, which lifts the sun by half a degree at the horizon and by a minute of arc at 45
degrees. The axes are those of REP 103: x east, y north, z up. Published values are met within 0.001 degrees; the disc
of the sun is 0.53 degrees wide.

ephem and not astral, because it is more exact (astral is up to 0.02 degrees away from it between 1990 and 2050), still
has releases, and takes 8 microseconds. It is compiled, works offline, and has wheels for every Python we support.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from datetime import datetime, timezone
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

FIRST_YEAR, LAST_YEAR = 1900, 2100  # beyond, the turn of the Earth is a guess

_SECOND = 1_000_000_000
_FIRST = int(datetime(FIRST_YEAR, 1, 1, tzinfo=timezone.utc).timestamp()) * _SECOND
_END = int(datetime(LAST_YEAR + 1, 1, 1, tzinfo=timezone.utc).timestamp()) * _SECOND
_EPOCH = 25_567.5  # 1970-01-01 00:00 in ephem's count of days


def parse_time(text: str) -> int:
    """A date and time as nanoseconds since 1970 UTC.

    Args:
        text: ISO 8601, such as ``2026-06-21T12:00:00Z``, ``2026-06-21 14:00+02:00`` or ``2026-06-21``; without a zone
            it is UTC, without a time it is midnight.

    Raises:
        ValueError: anything else, or a year out of range. The message does not name the field it came from.
    """
    plain = text.strip()
    if plain[-1:] in "Zz" and plain:
        plain = plain[:-1] + "+00:00"  # Python 3.10 does not know Z
    try:
        when = datetime.fromisoformat(plain)
    except ValueError as error:
        raise ValueError(
            f"expected a time in ISO 8601 such as 2026-06-21T12:00:00Z (no zone is UTC), got {text!r}"
        ) from error
    return _nanoseconds(when)


def sun_direction(when: datetime | int, latitude: float, longitude: float) -> tuple[FloatArray, float]:
    """The way sunlight travels, and how high the sun stands.

    Args:
        when: a datetime (without a zone it is UTC), or nanoseconds since 1970 UTC.
        latitude: degrees, north positive, -90 to 90.
        longitude: degrees, east positive, -180 to 360.

    Returns:
        (3,) float64 unit vector east, north, up, pointing away from the sun, not writable; and the apparent elevation
        of the sun's centre [rad], negative below the horizon.

    Raises:
        ValueError: an argument is out of range; the message starts with its name.
        ImportError: ephem is not installed; the message says how to.
    """
    stamp = _nanoseconds(when, "time: ") if isinstance(when, datetime) else _checked(int(when), "time: ")
    _in_range("latitude", latitude, -90.0, 90.0)
    _in_range("longitude", longitude, -180.0, 360.0)
    ephem = _library()
    observer = ephem.Observer()
    observer.lat, observer.lon = math.radians(latitude), math.radians(longitude)
    observer.elevation, observer.pressure, observer.temp = 0.0, 1010.0, 15.0
    observer.date = _EPOCH + stamp / (86_400 * _SECOND)
    seen = ephem.Sun(observer)
    elevation, azimuth = float(seen.alt), float(seen.az)
    level = math.cos(elevation)
    direction = np.array([-level * math.sin(azimuth), -level * math.cos(azimuth), -math.sin(elevation)])
    direction.setflags(write=False)
    return direction, elevation


class Sun:
    """:func:`sun_direction` at the beginning of each second, so that within it the answer is the same to the bit.

    The sun moves by 0.004 degrees in a second. Whoever keeps what belongs to a light that did not move can keep it.
    """

    def __init__(self) -> None:
        self._find: Callable[[int, float, float], tuple[FloatArray, float]] = lru_cache(maxsize=64)(sun_direction)

    def at(self, stamp: int, latitude: float, longitude: float) -> tuple[FloatArray, float]:
        """As :func:`sun_direction`, at the last whole second of a stamp [ns]. Raises the same."""
        return self._find(stamp // _SECOND * _SECOND, latitude, longitude)


def _nanoseconds(when: datetime, field: str = "") -> int:
    if when.tzinfo is None:
        when = when.replace(tzinfo=timezone.utc)
    past = when - datetime(1970, 1, 1, tzinfo=timezone.utc)
    return _checked((past.days * 86_400 + past.seconds) * _SECOND + past.microseconds * 1000, field)


def _checked(stamp: int, field: str) -> int:
    if not _FIRST <= stamp < _END:
        seconds = stamp / _SECOND
        raise ValueError(f"{field}expected the years {FIRST_YEAR} to {LAST_YEAR}, got {seconds:.0f} s since 1970")
    return stamp


def _in_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name}: expected {low:g} to {high:g} degrees, got {value!r}")


def _library() -> Any:
    try:
        return importlib.import_module("ephem")
    except ImportError as error:
        raise ImportError("the position of the sun needs ephem: pip install 'shadow_tracer[sun]'") from error
