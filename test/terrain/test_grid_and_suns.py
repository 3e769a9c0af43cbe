# SPDX-License-Identifier: Apache-2.0
"""Grids, their curvature, where the sun stands over them, and every bad argument."""

from __future__ import annotations

import importlib.util
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from valleys import hills, sky

from shadow_tracer import HeightField, Place, sunlight
from shadow_tracer.terrain.grid import EARTH_RADIUS, Grid, slopes
from shadow_tracer.terrain.plan import make_plan
from shadow_tracer.terrain.suns import suns
from shadow_tracer.terrain.tile import solve

needs_ephem = pytest.mark.skipif(
    importlib.util.find_spec("ephem") is None, reason="needs ephem: pip install 'shadow_tracer[terrain]'"
)
needs_xarray = pytest.mark.skipif(
    importlib.util.find_spec("xarray") is None, reason="needs xarray: pip install 'shadow_tracer[terrain]'"
)


def test_slopes_of_a_plane_are_its_own_on_a_turned_grid() -> None:
    grid = Grid(7, 9, (1.2, -1.6), (2.4, 1.8))
    x, y = grid.plane(slice(0, 7), slice(0, 9))
    right, up = slopes(grid, 0.25 * x - 0.5 * y)
    assert np.allclose(right, 0.25, atol=1e-12) and np.allclose(up, -0.5, atol=1e-12)


def test_slopes_beside_holes_are_one_sided_or_unknown() -> None:
    grid = Grid(3, 5, (0.0, -1.0), (1.0, 0.0))
    z = np.array([[0, 1, 4, np.nan, 2.0]] * 3)
    right, up = slopes(grid, z)
    assert right[1].tolist()[:3] == [1.0, 2.0, 3.0] and np.isnan(right[1, 3:]).all() and np.isnan(up[1, 3])


def test_the_sphere_falls_below_its_plane() -> None:
    grid = Grid(101, 101, (0.0, -1000.0), (1000.0, 0.0), curved=True)
    drop = grid.drop(slice(0, 101), slice(0, 101))
    exact = EARTH_RADIUS - np.sqrt(EARTH_RADIUS**2 - 50_000.0**2)
    assert drop[50, 50] == 0.0 and drop[50, 0] == pytest.approx(exact, abs=0.01)
    assert np.array_equal(grid.drop(slice(3, 5), slice(7, 9)), drop[3:5, 7:9])


def test_on_a_sphere_the_sun_sets_earlier_in_the_east() -> None:
    """A sun 0.2 degrees high in the west: cells farther east than 0.2 degrees of arc, 22.2 km, are turned away."""
    z = np.zeros((5, 81))
    grid = Grid(5, 81, (0.0, -1000.0), (1000.0, 0.0), curved=True).checked()
    plan = make_plan(grid, sky([(270, 0.2)]), lambda window: z[window], 128, beyond="nothing")
    codes = solve(plan.tile(0, lambda window: z[window])).codes[0, 2]
    border = 40 + np.radians(0.2) * EARTH_RADIUS / 1000.0
    assert (codes[:62] == 0).all() and 62.2 < border < 62.3 and (codes[63:] == 1).all()


def test_large_grids_are_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match=r"^height_field: its corners are 14.1 km .* fallen by 16 m .* curvature"):
        Grid(201, 201, (0.0, -100.0), (100.0, 0.0)).checked()
    Grid(201, 201, (0.0, -100.0), (100.0, 0.0), curved=True).checked()
    with pytest.raises(ValueError, match=r"^height_field: its corners are 141.4 km .* at most 100 km"):
        Grid(201, 201, (0.0, -1000.0), (1000.0, 0.0), curved=True).checked()


@needs_ephem
def test_the_sun_of_the_solar_position_algorithm() -> None:
    """Reda and Andreas, NREL/TP-560-34302, appendix A.5; their pressure differs, which is 0.003 degrees."""
    found = suns(["2003-10-17T19:30:30Z"], Place(39.742476, -105.1786), interval=60.0)
    assert found.azimuth[0] == pytest.approx(194.34024, abs=0.001)
    assert found.elevation[0] == pytest.approx(90.0 - 50.11162, abs=0.005)
    a, h = np.radians(194.34024), np.radians(90.0 - 50.11162)
    published = [np.cos(h) * np.sin(a), np.cos(h) * np.cos(a), np.sin(h)]
    assert np.allclose(found.towards[0], published, atol=1e-4)


# Azimuth and apparent elevation by pvlib 0.16.1, get_solarposition(method="nrel_numpy", pressure=101000,
# temperature=15): dusk and noon, winter, the southern hemisphere, a midnight sun, the zenith, 2000 and 2040.
PVLIB = [
    ("2026-06-21T04:30Z", 46.5, 9.8, 64.5579, 8.4379),
    ("2026-06-21T11:20Z", 46.5, 9.8, 178.4712, 66.938),
    ("2026-06-21T18:50Z", 46.5, 9.8, 301.468, 3.2943),
    ("2026-12-21T08:00Z", 46.5, 9.8, 135.1867, 7.0139),
    ("2026-12-21T15:00Z", 46.5, 9.8, 229.1085, 4.27),
    ("2026-03-20T12:00Z", -33.4, -70.6, 80.1681, 14.6582),
    ("2026-09-22T20:30Z", -33.4, -70.6, 288.5224, 25.6608),
    ("2026-06-21T23:00Z", 78.2, 15.6, 0.1131, 11.7113),
    ("2026-03-18T11:00Z", 78.2, 15.6, 178.566, 11.0224),
    ("2026-03-20T05:27Z", 0.0, 100.0, 139.8964, 89.7995),
    ("2000-01-01T02:00Z", 0.0, 100.0, 118.7974, 35.6024),
    ("2040-07-14T09:00Z", 0.0, 100.0, 296.1642, 33.6077),
]


@needs_ephem
@pytest.mark.parametrize(("when", "latitude", "longitude", "azimuth", "elevation"), PVLIB)
def test_the_sun_of_pvlib(when: str, latitude: float, longitude: float, azimuth: float, elevation: float) -> None:
    """Within a hundredth of the sun's disc; they differ by what they say of refraction."""
    found, (a, h) = suns([when], Place(latitude, longitude), interval=60.0), np.radians([azimuth, elevation])
    theirs = np.array([np.cos(h) * np.sin(a), np.cos(h) * np.cos(a), np.sin(h)])
    assert np.degrees(np.linalg.norm(found.towards[0] - theirs)) < 0.005
    assert found.elevation[0] == pytest.approx(elevation, abs=0.005)


@needs_ephem
def test_grid_north_that_points_east_of_north_turns_the_sun_west() -> None:
    plain = suns(["2026-06-21T09:00Z"], Place(46.0, 8.0), interval=60.0)
    turned = suns(["2026-06-21T09:00Z"], Place(46.0, 8.0, convergence=3.0), interval=60.0)
    azimuth = np.degrees(np.arctan2(turned.towards[0, 0], turned.towards[0, 1]))
    assert azimuth == pytest.approx(plain.azimuth[0] - 3.0, abs=1e-9) and turned.azimuth[0] == plain.azimuth[0]


@needs_ephem
def test_times_of_all_kinds_are_the_same_times() -> None:
    begin = datetime(2026, 6, 21, 4, tzinfo=timezone.utc)
    whens = [begin + timedelta(minutes=30 * k) for k in range(3)]
    stamps = [int(when.timestamp()) * 10**9 for when in whens]
    local = [when.astimezone(timezone(timedelta(hours=2))).isoformat() for when in whens]
    numpys = np.array(stamps, "datetime64[ns]")
    for times in (whens, stamps, local, numpys):
        assert suns(times, Place(46, 8)).stamps == tuple(stamps)
    assert suns([stamps[0], stamps[1], stamps[1] + 10**11], Place(46, 8)).seconds.tolist() == [1800.0, 950.0, 100.0]


@needs_ephem
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"times": []}, "^times: expected at least one"),
        ({"times": ["2026-06-21", "2026-06-20"]}, "^times: expected at least one, each later"),
        ({"times": ["tomorrow"]}, "^times: expected a time in ISO 8601"),
        ({"times": [3.5]}, "^times: expected a datetime"),
        ({"times": [np.datetime64("NaT")]}, "^times: expected times that whole nanoseconds"),
        ({"times": [np.datetime64("2584-01-01", "s")]}, "^times: expected times that whole nanoseconds"),
        ({"times": [0, 10**20]}, "^time: expected the years 1900 to 2100"),
        ({"times": ["2026-06-21"]}, "^interval: expected seconds where there is only one time"),
        ({"interval": 0.0}, "^interval: expected more than 0"),
        ({"irradiance": [1.0, 2.0]}, "^irradiance: expected a number, or 3 for as many times"),
        ({"irradiance": -1.0}, "^irradiance: expected finite numbers of at least 0"),
        ({"above": -1.0}, "^above: expected at least 0"),
        ({"beyond": "hills"}, "^beyond: expected one of unknown, nothing"),
        ({"tile": 3}, "^tile: expected an integer from 16"),
        ({"memory": 10.0}, "^memory: expected at least"),
        ({"memory": float("nan")}, "^memory: expected a finite number"),
        ({"memory": float("inf")}, "^memory: expected a finite number"),
        ({"place": (46, 8)}, "^place: expected a Place"),
        ({"height_field": np.zeros((3, 3))}, "^height_field: expected a HeightField"),
    ],
)
@needs_xarray
def test_bad_arguments_are_refused_by_name(options, message) -> None:
    given = {
        "height_field": HeightField(np.zeros((3, 3)), 2.0),
        "times": ["2026-06-21T10:00Z", "2026-06-21T11:00Z", "2026-06-21T12:00Z"],
        "place": Place(46.0, 8.0),
        **options,
    }
    with pytest.raises(ValueError, match=message):
        sunlight(**given)


def test_bad_places_are_refused_by_name() -> None:
    for bad in ({"latitude": 91}, {"longitude": 400}, {"convergence": 181}, {"latitude": float("nan")}):
        with pytest.raises(ValueError, match=f"^{next(iter(bad))}: expected"):
            Place(**{"latitude": 46, "longitude": 8, **bad})


@needs_ephem
@needs_xarray
def test_the_dataset_has_names_and_units_of_cf() -> None:
    field = HeightField(hills(20, 24), (2.0, 3.0), origin=(500.0, 900.0, 0.0))
    times = [f"2026-03-20T{hour:02d}:00Z" for hour in range(4, 21)]
    found = sunlight(field, times, Place(46.0, 8.0), device="cpu")
    assert found.sizes == {"time": 17, "y": 20, "x": 24, "bnds": 2} and found.attrs["Conventions"] == "CF-1.11"
    assert found.x.values[[0, -1]].tolist() == [500.0, 569.0] and found.y.values[[0, -1]].tolist() == [900.0, 862.0]
    assert found.sun_code.flag_meanings == "lit turned_away cast_shadow unknown"
    assert found.sunshine_duration.standard_name == "duration_of_sunshine" and found.sunshine_duration.units == "s"
    assert found.direct_exposure.units == "J m-2" and found.sunlit.standard_name == "sunlit_binary_mask"
    assert np.array_equal(found.sunlit.values == 1, found.sun_code.values == 0)
    width = np.diff(found.time_bnds.values, axis=1).astype("timedelta64[s]").astype(int)
    assert (width == 3600).all() and found.time_bnds.values[0, 0] == np.datetime64("2026-03-20T03:30")
    noon = int(found.solar_elevation.values.argmax())
    assert found.solar_elevation.values[noon] == pytest.approx(44.0, abs=0.6)  # 90 - latitude at the equinox
    assert found.solar_azimuth.values[noon] == pytest.approx(180.0, abs=15.0)


@needs_ephem
@needs_xarray
def test_a_turned_field_has_positions_for_each_cell() -> None:
    field = HeightField(hills(6, 7), 2.0, axes=((0.6, -0.8), (0.8, 0.6)))
    found = sunlight(field, ["2026-06-21T12:00Z"], Place(46.0, 8.0), interval=60.0, device="cpu")
    positions = field.positions()
    assert found.sunlit.dims == ("time", "row", "column")
    assert np.allclose(found.x, positions[..., 0]) and np.allclose(found.y, positions[..., 1])
