# SPDX-License-Identifier: Apache-2.0
"""Times of days in a zone."""

from __future__ import annotations

from datetime import date

import pytest

from shadow_tracer.apps.terrain.days import day_of, irradiance_of, seconds_of, times_of, zone_of

DAY = date(2026, 6, 21)


def test_a_day_goes_from_midnight_to_midnight() -> None:
    stamps = times_of(DAY, DAY, 900.0, zone_of("UTC"))
    assert len(stamps) == 96 and stamps[0] == 1_782_000_000 * 10**9 and stamps[1] - stamps[0] == 900 * 10**9


def test_zones_by_name_and_by_number() -> None:
    utc, two = (times_of(DAY, DAY, 3600.0, zone_of(zone))[0] for zone in ("UTC", "+02:00"))
    assert utc - two == 7200 * 10**9
    assert times_of(DAY, DAY, 3600.0, zone_of("Europe/Zurich"))[0] == two
    assert times_of(DAY, DAY, 3600.0, zone_of("-0330"))[0] == utc + 12_600 * 10**9


def test_the_day_on_which_clocks_change_has_23_hours() -> None:
    day = date(2026, 3, 29)
    assert len(times_of(day, day, 3600.0, zone_of("Europe/Zurich"))) == 23
    assert len(times_of(day, date(2026, 3, 30), 3600.0, zone_of("Europe/Zurich"))) == 47


def test_steps() -> None:
    assert [seconds_of(text) for text in ("30s", "15min", "1.5h")] == [30.0, 900.0, 5400.0]


def test_irradiance_is_a_number_or_a_file_with_one_for_each_time(tmp_path) -> None:
    stamps = times_of(DAY, DAY, 21_600.0, zone_of("UTC"))
    assert irradiance_of("900", stamps) == 900.0
    path = tmp_path / "dni.csv"
    path.write_text("time,dni\n2026-06-20T23:00Z,0\n2026-06-21T05:00Z,600\n\n2026-06-21 20:00+02:00,1000.0\n")
    assert irradiance_of(str(path), stamps).tolist() == pytest.approx([100.0, 600 + 400 / 13, 600 + 2800 / 13, 1000.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,dni\n2026-06-21T00:00Z,5\n2026-06-21T18:00Z\n", "dni.csv, line 3: expected TIME,W/m2"),
        ("2026-06-21T00:00Z,5\n2026-06-21T18:00Z,-3\n", "dni.csv, line 2: expected at least 0"),
        ("2026-06-21T00:00Z,5\n2026-06-21T18:00Z,nan\n", "dni.csv, line 2: expected at least 0"),
        ("2026-06-21T00:00Z,5\n2026-06-21T17:00Z,5\n", "dni.csv: expected rising times that cover all"),
        ("2026-06-21T18:00Z,5\n2026-06-21T00:00Z,5\n", "dni.csv: expected rising times that cover all"),
        ("", "dni.csv: expected rising times that cover all"),
    ],
)
def test_bad_files_of_irradiance_are_refused_with_the_line(tmp_path, text, message) -> None:
    path = tmp_path / "dni.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"^--irradiance: {message}"):
        irradiance_of(str(path), times_of(DAY, DAY, 21_600.0, zone_of("UTC")))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: seconds_of("15"), "^--every: expected 1s to 24h"),
        (lambda: seconds_of("25h"), "^--every: expected 1s to 24h"),
        (lambda: zone_of("Europe/Nowhere"), "^--tz: expected a zone"),
        (lambda: irradiance_of("bright", [0]), "^--irradiance: expected a number of W/m2 or a CSV file"),
        (lambda: zone_of("+15:00"), "^--tz: expected a zone"),
        (lambda: day_of("21.6.2026", "--date"), "^--date: expected a day such as"),
        (lambda: day_of("9999-12-31", "--until"), "^--until: expected the years 1900 to 2100"),
        (lambda: times_of(DAY, date(2026, 6, 20), 900.0, zone_of("UTC")), "^--until: expected 2026-06-21 or later"),
        (lambda: times_of(DAY, date(2126, 6, 20), 900.0, zone_of("UTC")), "^--every: expected at most 100000 times"),
    ],
)
def test_what_is_wrong_is_named(call, message) -> None:
    with pytest.raises(ValueError, match=message):
        call()
