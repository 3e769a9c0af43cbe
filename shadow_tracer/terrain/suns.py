# SPDX-License-Identifier: Apache-2.0
"""Where the sun stands over an elevation model at each of some times, how long each of these counts, and how strong it
is."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.checks import finite
from shadow_tracer.scene.sun import parse_time, sun_direction

FloatArray = npt.NDArray[np.float64]

SOLAR_CONSTANT = 1361.0
"""What a plane at a right angle to the sun gets without an atmosphere [W/m2], at the mean distance of the Earth."""
_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Place:
    """Where an elevation model lies on the Earth.

    Attributes:
        latitude: of its centre [degrees], north positive.
        longitude: of its centre [degrees], east positive.
        convergence: azimuth of grid north, the y axis, clockwise from true north [degrees].
    """

    latitude: float
    longitude: float
    convergence: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in (("latitude", -90, 90), ("longitude", -180, 360), ("convergence", -180, 180)):
            value = finite(getattr(self, name), name)
            if not low <= value <= high:
                raise ValueError(f"{name}: expected {low} to {high} degrees, got {value!r}")
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Suns:
    """The sun at K times.

    Attributes:
        stamps: nanoseconds since 1970 UTC, rising.
        seconds: (K,) for how long each time stands [s], half of it before and half behind.
        azimuth: (K,) clockwise from true north [degrees].
        elevation: (K,) apparent, of the sun's centre [degrees].
        towards: (K, 3) unit vectors to the sun, x along grid east, y along grid north, z up.
        irradiance: (K,) direct, at a right angle to the rays [W/m2].
    """

    stamps: tuple[int, ...]
    seconds: FloatArray
    azimuth: FloatArray
    elevation: FloatArray
    towards: FloatArray
    irradiance: FloatArray

    def up(self) -> list[int]:
        """Which of them are above the horizon."""
        return [int(k) for k in np.flatnonzero(self.elevation > 0.0)]

    @property
    def daylight(self) -> float:
        """For how long the sun is above the horizon [s]."""
        return float(self.seconds[self.elevation > 0.0].sum())


def suns(times: Iterable[Any], place: Place, interval: float | None = None, irradiance: Any = SOLAR_CONSTANT) -> Suns:
    """The sun over a place.

    Args:
        times: rising; datetimes (without a zone they are UTC), texts in ISO 8601, numpy's datetime64, or integers,
            nanoseconds since 1970 UTC.
        place: where.
        interval: for how long each time stands [s], centred on it; None is to half way to the times beside it, at both
            ends as far outwards as inwards.
        irradiance: one number, or one for each time [W/m2].

    Raises:
        ValueError: an argument is malformed; the message names it.
        ImportError: ephem is not installed.
    """
    stamps = tuple(_stamp(when) for when in times)
    if not stamps or any(b <= a for a, b in zip(stamps, stamps[1:], strict=False)):
        raise ValueError("times: expected at least one, each later than the one before")
    found = [sun_direction(stamp, place.latitude, place.longitude) for stamp in stamps]
    seconds = _seconds(stamps, interval)
    light = np.array([direction for direction, _ in found])
    turn = math.radians(place.convergence)
    east, north = -light[:, 0], -light[:, 1]
    towards = np.stack(
        [east * math.cos(turn) - north * math.sin(turn), east * math.sin(turn) + north * math.cos(turn), -light[:, 2]],
        axis=-1,
    )
    azimuth = np.degrees(np.arctan2(east, north)) % 360.0
    elevation = np.degrees([height for _, height in found])
    return Suns(stamps, seconds, azimuth, elevation, towards, _irradiance(irradiance, len(stamps)))


def _stamp(when: Any) -> int:
    if isinstance(when, str):
        try:
            return parse_time(when)
        except ValueError as error:
            raise ValueError(f"times: {error}") from error
    if isinstance(when, np.datetime64):
        exact = when.astype("datetime64[ns]")
        if exact.astype(when.dtype) != when:  # NaT is not equal to itself
            raise ValueError(f"times: expected times that whole nanoseconds since 1970 can say, got {when!r}")
        return int(exact.astype(np.int64))
    if isinstance(when, datetime):
        past = (when if when.tzinfo else when.replace(tzinfo=timezone.utc)) - datetime(1970, 1, 1, tzinfo=timezone.utc)
        return (past.days * 86_400 + past.seconds) * _SECOND + past.microseconds * 1000
    if isinstance(when, (int, np.integer)) and not isinstance(when, bool):
        return int(when)
    raise ValueError(f"times: expected a datetime, a text in ISO 8601, datetime64 or nanoseconds, got {when!r}")


def _seconds(stamps: tuple[int, ...], interval: float | None) -> FloatArray:
    if interval is not None:
        each = finite(interval, "interval")
        if each <= 0.0:
            raise ValueError(f"interval: expected more than 0 s, got {interval!r}")
        return np.full(len(stamps), each)
    if len(stamps) < 2:
        raise ValueError("interval: expected seconds where there is only one time, got None")
    gaps = np.diff(np.array(stamps, np.int64)) / _SECOND
    return np.asarray(
        np.concatenate([gaps[:1], gaps[:-1] + gaps[1:], gaps[-1:]]) * np.array([1.0, *[0.5] * (len(gaps) - 1), 1.0])
    )


def _irradiance(value: Any, count: int) -> FloatArray:
    try:
        given = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"irradiance: expected a number or one for each time, got {value!r}") from error
    if given.shape not in ((), (count,)):
        raise ValueError(f"irradiance: expected a number, or {count} for as many times, got shape {given.shape}")
    if not (np.isfinite(given) & (given >= 0.0)).all():
        raise ValueError("irradiance: expected finite numbers of at least 0 W/m2")
    return np.array(np.broadcast_to(given, (count,)))
