# SPDX-License-Identifier: Apache-2.0
"""The sun against published values, against the formula of the Astronomical Almanac, and every bad argument."""

from __future__ import annotations

import importlib.util
import math
import sys
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from shadow_tracer.scene.sun import Sun, parse_time, sun_direction

if importlib.util.find_spec("ephem") is None:
    pytest.skip("needs ephem: pip install 'shadow_tracer[sun]'", allow_module_level=True)

SECOND = 1_000_000_000
PARALLAX = 8.794 / 3600.0  # of the sun [degrees]; it lowers it by this times the cosine of its elevation


def utc(*parts: int) -> datetime:
    return datetime(*parts, tzinfo=timezone.utc)  # type: ignore[misc,arg-type]


def angle(u: np.ndarray, v: np.ndarray) -> float:
    """Angle between two unit vectors [degrees]."""
    return math.degrees(2.0 * math.asin(min(1.0, float(np.linalg.norm(u - v)) / 2.0)))


def vector(elevation: float, azimuth: float) -> np.ndarray:
    """(3,) unit vector east, north, up to a place in the sky [degrees], azimuth from north over east."""
    h, a = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(h) * math.sin(a), math.cos(h) * math.cos(a), math.sin(h)])


def refraction(elevation: float) -> float:
    """How much the standard atmosphere lifts a true elevation [degrees]: Saemundsson's formula, as in Meeus,
    Astronomical Algorithms, chapter 16, for 1010 hPa and 15 degrees."""
    minutes = 1.02 / math.tan(math.radians(elevation + 10.3 / (elevation + 5.11)))
    return minutes * 283.0 / 288.0 / 60.0


def test_the_example_of_the_solar_position_algorithm() -> None:
    """Reda and Andreas, NREL/TP-560-34302, appendix A.5: 2003-10-17 12:30:30 at 7 hours west of Greenwich; topocentric
    elevation without refraction 39.872046, with 820 hPa and 11 degrees the zenith 50.11162, azimuth 194.34024."""
    direction, elevation = sun_direction(utc(2003, 10, 17, 19, 30, 30), 39.742476, -105.1786)
    assert math.degrees(elevation) == pytest.approx(39.872046 + refraction(39.872046), abs=0.001)
    # Nearly the sea level's atmosphere there: a fifth less of it is 0.003 degrees.
    assert angle(-direction, vector(90.0 - 50.11162, 194.34024)) < 0.004
    assert math.degrees(math.atan2(direction[0], direction[1])) % 360.0 == pytest.approx(14.34024, abs=0.001)


def test_declination_and_equation_of_time_of_meeus() -> None:
    """Meeus, Astronomical Algorithms, examples 25.b and 28.a: 1992-10-13 0 h dynamical time, apparent declination
    -7.783871 degrees, equation of time 13 min 42.6 s. Dynamical time was 59 s ahead of universal time."""
    direction, elevation = sun_direction(utc(1992, 10, 12, 23, 59, 1), 0.0, 180.0)
    declination, hour_angle = math.radians(-7.783871), math.radians((13 * 60 + 42.6 - 59.0) / 240.0)
    published = np.array(
        [
            -math.cos(declination) * math.sin(hour_angle),
            math.sin(declination),
            math.cos(declination) * math.cos(hour_angle),
        ]
    )
    height = math.degrees(math.asin(published[2]))
    apparent = height + refraction(height) - PARALLAX * math.cos(math.radians(height))
    assert math.degrees(elevation) == pytest.approx(apparent, abs=0.001)
    assert angle(-direction, vector(apparent, math.degrees(math.atan2(published[0], published[1])))) < 0.001


# Equinoxes as the U.S. Naval Observatory publishes them, universal time to the minute.
EQUINOXES = [
    utc(2000, 3, 20, 7, 35),
    utc(2000, 9, 22, 17, 28),
    utc(2010, 3, 20, 17, 32),
    utc(2010, 9, 23, 3, 9),
    utc(2020, 3, 20, 3, 50),
    utc(2020, 9, 22, 13, 31),
    utc(2024, 3, 20, 3, 6),
    utc(2024, 9, 22, 12, 44),
]


@pytest.mark.parametrize("when", EQUINOXES, ids=[f"{when:%Y-%m}" for when in EQUINOXES])
def test_at_an_equinox_the_sun_is_over_the_equator(when: datetime) -> None:
    """Seen from the equator it is then in the plane of east and up, at any hour. Half a minute of the almanac's
    rounding is 0.5 seconds of arc of declination; 2 are allowed."""
    noon = (12.0 - when.hour - when.minute / 60.0) * 15.0
    for longitude in (noon - 60.0, noon, noon + 45.0):
        direction, elevation = sun_direction(when, 0.0, (longitude + 180.0) % 360.0 - 180.0)
        assert elevation > 0.4
        assert abs(math.degrees(direction[1])) < 2.0 / 3600.0


@pytest.mark.parametrize(
    ("when", "sign"), [(utc(2020, 6, 20, 21, 44), 1.0), (utc(2020, 12, 21, 10, 2), -1.0)], ids=["june", "december"]
)
def test_at_a_solstice_the_pole_sees_the_obliquity(when: datetime, sign: float) -> None:
    """Of 2020.5: 23.4366 degrees (Astronomical Almanac). The other pole has night."""
    _, elevation = sun_direction(when, sign * 90.0, 0.0)
    assert math.degrees(elevation) == pytest.approx(23.4366 + refraction(23.4366) - PARALLAX * 0.917, abs=0.003)
    assert sun_direction(when, -sign * 90.0, 0.0)[1] < math.radians(-23.0)


def test_sunrise_and_sunset_of_a_calendar() -> None:
    """London, 2024-06-20: sunrise 04:43, sunset 21:21 British summer time. The upper edge is at the horizon then."""
    for when in (utc(2024, 6, 20, 3, 43), utc(2024, 6, 20, 20, 21)):
        _, elevation = sun_direction(when, 51.507, -0.128)
        assert math.degrees(elevation) == pytest.approx(-0.267, abs=0.15)  # a minute is 0.13 degrees there
    west = sun_direction(utc(2024, 6, 20, 20, 21), 51.507, -0.128)[0]
    assert west[0] > 0.6 and west[1] < -0.5  # light of the setting sun travels to the south-east


def almanac(when: datetime, latitude: float, longitude: float) -> tuple[float, np.ndarray]:
    """True elevation [degrees] and direction to the sun by the low-precision formulas of the Astronomical Almanac, good
    to 0.01 degrees from 1950 to 2050."""
    days = (when - utc(2000, 1, 1, 12)).total_seconds() / 86400.0
    mean = math.radians(357.528 + 0.9856003 * days)
    ecliptic = math.radians(280.460 + 0.9856474 * days + 1.915 * math.sin(mean) + 0.020 * math.sin(2.0 * mean))
    tilt = math.radians(23.439 - 0.0000004 * days)
    right_ascension = math.atan2(math.cos(tilt) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(tilt) * math.sin(ecliptic))
    hour = math.radians(280.46061837 + 360.98564736629 * days + longitude) - right_ascension
    phi = math.radians(latitude)
    to_sun = np.array(
        [
            -math.cos(declination) * math.sin(hour),
            math.cos(phi) * math.sin(declination) - math.sin(phi) * math.cos(declination) * math.cos(hour),
            math.sin(phi) * math.sin(declination) + math.cos(phi) * math.cos(declination) * math.cos(hour),
        ]
    )
    return math.degrees(math.asin(to_sun[2])), to_sun


def test_it_agrees_with_the_almanac_formula_from_1990_to_2050() -> None:
    """2000 times and places by day; another theory, written down here, so that a wrong sign or epoch cannot hide."""
    random = np.random.default_rng(5)
    errors = []
    while len(errors) < 2000:
        when = utc(1990, 1, 1) + timedelta(days=float(random.uniform(0.0, 61 * 365.25)))
        place = float(random.uniform(-90.0, 90.0)), float(random.uniform(-180.0, 180.0))
        height, to_sun = almanac(when, *place)
        if height < 1.0:
            continue
        direction, elevation = sun_direction(when, *place)
        azimuth = math.degrees(math.atan2(to_sun[0], to_sun[1]))
        errors.append(angle(-direction, vector(height + refraction(height), azimuth)))
        assert direction[2] == pytest.approx(-math.sin(elevation), abs=1e-15)
    assert max(errors) < 0.02 and np.median(errors) < 0.006


def test_directions_are_unit_vectors_that_cannot_be_written() -> None:
    direction, _ = sun_direction(0, 48.1, 11.6)
    assert direction.dtype == np.float64 and np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-15)
    with pytest.raises(ValueError, match="read-only"):
        direction[0] = 0.0


def test_all_ways_to_say_a_time_and_a_place_agree() -> None:
    when = utc(2026, 6, 21, 12)
    stamp = int(when.timestamp()) * SECOND
    expected, height = sun_direction(when, 48.0, -77.0)
    zone = timezone(timedelta(hours=-7))
    for same in (stamp, np.int64(stamp), when.replace(tzinfo=None), when.astimezone(zone)):
        direction, elevation = sun_direction(same, 48.0, -77.0)
        assert (direction == expected).all() and elevation == height
    assert sun_direction(when, 48.0, 283.0)[0] == pytest.approx(expected, abs=1e-12)


def test_within_a_second_the_sun_stands_still() -> None:
    sun, stamp = Sun(), parse_time("2026-06-21T09:30:00Z")
    direction, elevation = sun.at(stamp, 48.1, 11.6)
    assert (direction == sun_direction(stamp, 48.1, 11.6)[0]).all()
    last, _ = sun.at(stamp + SECOND - 1, 48.1, 11.6)
    assert last is direction
    later, higher = sun.at(stamp + SECOND, 48.1, 11.6)
    assert 0.0 < angle(later, direction) < 0.005 and higher > elevation
    elsewhere, _ = sun.at(stamp, 48.2, 11.6)
    assert angle(elsewhere, direction) == pytest.approx(0.1, rel=0.3)
    assert sun.at(stamp, 48.1, 11.6)[0] is direction


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1970-01-01T00:00:00Z", 0),
        ("1970-01-02", 86_400 * SECOND),
        ("2026-06-21T12:00:00Z", 1_782_043_200 * SECOND),
        ("2026-06-21T12:00:00", 1_782_043_200 * SECOND),
        (" 2026-06-21 14:00+02:00 ", 1_782_043_200 * SECOND),
        ("2026-06-21T05:00:00-07:00", 1_782_043_200 * SECOND),
        ("2026-06-21T12:00:00.000250z", 1_782_043_200 * SECOND + 250_000),
        ("1969-12-31T23:59:59Z", -SECOND),
    ],
)
def test_times(text: str, expected: int) -> None:
    assert parse_time(text) == expected


@pytest.mark.parametrize("text", ["", " ", "Z", "now", "12:00", "21.6.2026", "2026-13-01", "2026-02-30T00:00Z"])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ValueError, match="^expected a time in ISO 8601 such as 2026-06-21T12:00:00Z") as error:
        parse_time(text)
    assert repr(text) in str(error.value)


@pytest.mark.parametrize("text", ["1899-12-31T23:59:59Z", "2101-01-01", "0001-01-01", "9999-12-31T23:00:00-23:00"])
def test_times_too_far_away(text: str) -> None:
    with pytest.raises(ValueError, match="^expected the years 1900 to 2100, got"):
        parse_time(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 90.1, 0.0), "latitude: expected -90 to 90 degrees, got 90.1"),
        ((0, math.nan, 0.0), "latitude: expected"),
        ((0, 0.0, -180.1), "longitude: expected -180 to 360 degrees"),
        ((0, 0.0, math.inf), "longitude: expected"),
        ((2**63 - 1, 0.0, 0.0), "time: expected the years 1900 to 2100, got 922337203. s since 1970"),
        ((utc(1899, 1, 1), 0.0, 0.0), "time: expected"),
    ],
)
def test_bad_arguments(arguments: tuple[int, float, float], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        sun_direction(*arguments)
    with pytest.raises(ValueError, match=f"^{message}"):
        stamp = arguments[0] if isinstance(arguments[0], int) else int(arguments[0].timestamp()) * SECOND
        Sun().at(stamp, *arguments[1:])


def test_without_ephem_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ephem", None)
    with pytest.raises(ImportError, match=r"pip install 'shadow_tracer\[sun\]'"):
        Sun().at(0, 0.0, 0.0)
    assert parse_time("1970-01-01") == 0
