# SPDX-License-Identifier: Apache-2.0
"""Elevation models in files: where their cells are, what has no height, and what is refused, with field and cure."""

from __future__ import annotations

import math
import pickle

import data
import numpy as np
import pytest
from elevation_files import by_hand, geotiff

for _name in ("rasterio", "xarray", "h5netcdf", "h5py", "PIL"):
    pytest.importorskip(_name, reason="needs the extra: pip install 'shadow_tracer[terrain]'")

from shadow_tracer.apps.terrain import reading  # noqa: E402
from shadow_tracer.apps.terrain.georeference import TerrainError, locate  # noqa: E402
from shadow_tracer.apps.terrain.reading import open_model  # noqa: E402
from shadow_tracer.apps.terrain.writing import coordinates  # noqa: E402

WHOLE = slice(0, 6), slice(0, 5)
Z = np.arange(30, dtype=np.float32).reshape(6, 5)


def _opened(path, **options):
    return open_model(path, **{"band": None, "variable": "", "resolution": None, "nodata": None, **options})


def _located(path, given=None, curved=False, **options):
    model = _opened(path, **options)
    return locate(path.name, model.shape, model.transform, model.crs, given, curved)


def test_a_geotiff_gives_its_heights_and_steps(tmp_path) -> None:
    path = geotiff(tmp_path / "a.tif", Z)
    model = _opened(path)
    where = _located(path)
    assert np.array_equal(model.source.read(WHOLE), Z)
    assert np.array_equal(model.source.read((slice(2, 4), slice(1, 5))), Z[2:4, 1:5])
    assert (where.grid.row_step, where.grid.column_step) == ((0.0, -10.0), (10.0, 0.0))


def test_what_is_nodata_or_not_a_number_has_no_height(tmp_path) -> None:
    z = Z.copy()
    z[1, 2], z[3, 3] = -9999.0, np.nan
    read = _opened(geotiff(tmp_path / "a.tif", z, nodata=-9999.0)).source.read(WHOLE)
    assert np.argwhere(np.isnan(read)).tolist() == [[1, 2], [3, 3]]


def test_scale_and_offset_of_a_band_are_applied(tmp_path) -> None:
    path = geotiff(tmp_path / "a.tif", Z.astype(np.int16), nodata=7, scale=0.5, offset=100.0)
    read = _opened(path).source.read(WHOLE)
    assert read[0, 1] == 100.5 and np.isnan(read[1, 2])


@pytest.mark.parametrize("point", [False, True], ids=["area", "point"])
def test_heights_belong_to_centres_whichever_way_a_file_says_so(tmp_path, point) -> None:
    """The first height is at the tie point if pixels are points, and half a cell east and south of it if areas."""
    path = by_hand(tmp_path / "a.tif", Z, (440_000.0, 5_100_000.0), 10.0, point)
    model = _opened(path)
    assert model.point is point
    (variables, dims) = coordinates(_located(path))
    half = 0.0 if point else 5.0
    assert dims == ("y", "x")
    assert variables["x"][1].tolist() == [440_000.0 + half + 10.0 * k for k in range(5)]
    assert variables["y"][1].tolist() == [5_100_000.0 - half - 10.0 * k for k in range(6)]


def test_degrees_are_as_many_metres_as_the_ellipsoid_says(tmp_path) -> None:
    """WGS 84 at latitude 45: a degree is 111,132 m north and 78,847 m east."""
    step = 1.0 / 3600.0
    path = geotiff(tmp_path / "a.tif", Z, "EPSG:4326", (step, 0.0, 8.0, 0.0, -step, 45.0 + 3 * step))
    where = _located(path)
    assert where.grid.row_step == pytest.approx((0.0, -111_132.0 / 3600.0), abs=1e-4)
    assert where.grid.column_step == pytest.approx((78_847.0 / 3600.0, 0.0), abs=1e-4)
    assert (where.place.latitude, where.place.convergence) == (pytest.approx(45.0), 0.0)


@pytest.mark.parametrize("east", [200_000.0, 500_000.0, 760_000.0])
def test_grid_north_of_utm_is_off_by_its_convergence(tmp_path, east) -> None:
    """tan(convergence) = tan(longitude - 9) sin(latitude), for a transverse Mercator projection of the sphere."""
    place = _located(geotiff(tmp_path / "a.tif", Z, transform=(10.0, 0.0, east, 0.0, -10.0, 5_100_000.0))).place
    away = math.radians(place.longitude - 9.0)
    expected = math.degrees(math.atan(math.tan(away) * math.sin(math.radians(place.latitude))))
    assert place.convergence == pytest.approx(expected, abs=0.01)
    assert abs(place.convergence) < 0.001 if east == 500_000.0 else abs(place.convergence) > 2.0


def test_rows_that_go_north_and_turned_grids_are_taken_as_they_are(tmp_path) -> None:
    up = _located(geotiff(tmp_path / "a.tif", Z, transform=(10.0, 0.0, 440_000.0, 0.0, 10.0, 5_100_000.0)))
    assert up.grid.row_step == (0.0, 10.0)
    turned = _located(geotiff(tmp_path / "b.tif", Z, transform=(8.0, -6.0, 440_000.0, -6.0, -8.0, 5_100_000.0)))
    assert (turned.grid.row_step, turned.grid.column_step) == ((-6.0, -8.0), (8.0, -6.0))
    assert coordinates(turned)[1] == ("row", "column")


def test_feet_of_a_projection_become_metres(tmp_path) -> None:
    """EPSG:2263, New York, counts in US survey feet."""
    where = _located(geotiff(tmp_path / "a.tif", Z, "EPSG:2263", (10.0, 0.0, 980_000.0, 0.0, -10.0, 200_000.0)))
    assert where.grid.column_step == pytest.approx((10.0 * 1200.0 / 3937.0, 0.0))


def _fault(tmp_path, **options):
    return geotiff(tmp_path / "a.tif", options.pop("z", Z), **options)


BAD = {
    "no_crs": ({"crs": None}, r"^a.tif: crs: there is none.*--latitude and --longitude.*gdal_edit.py -a_srs"),
    "no_transform": ({"transform": None}, r"^a.tif: transform: there is none.*gdal_edit.py -a_ullr"),
    "shear": ({"transform": (10.0, 3.0, 440_000.0, 0.0, -10.0, 5_100_000.0)},
              r"^a.tif: transform: .*right angle.*gdalwarp"),
    "bands": ({"z": np.stack([Z, Z])}, r"^a.tif: bands: expected one, got 2; choose with --band 1 to 2"),
    "complex": ({"z": Z.astype(np.complex64)}, r"^a.tif: band 1: expected real numbers, got complex64"),
    "feet": ({"units": "ft"}, r"^a.tif: band 1: its unit is 'ft', expected metres"),
    "mercator": ({"crs": "EPSG:3857", "transform": (10.0, 0.0, 9e5, 0.0, -10.0, 5.8e6)},
                 r"^a.tif: crs: a metre of it is 0.\d+ m on the ground.*gdalwarp -t_srs EPSG:32632"),
    "moon": ({"crs": "+proj=stere +lat_0=90 +R=1737400 +units=m"}, r"^a.tif: crs: its body has a radius of 1737.4 km"),
    "large": ({"transform": (9e3, 0.0, 440_000.0, 0.0, -9e3, 5_100_000.0)}, r"^a.tif: extent: .*give --curvature"),
    "turned_degrees": ({"crs": "EPSG:4326", "transform": (8e-4, -6e-4, 8.0, -6e-4, -8e-4, 45.0)},
                       r"^a.tif: transform: a grid of degrees is turned"),
    "geocentric": ({"crs": "EPSG:4978"}, r"^a.tif: crs: expected a projected or a geographic one, got EPSG:4978"),
    "nowhere": ({"transform": (10.0, 0.0, 4e8, 0.0, -10.0, 4e9)}, r"^a.tif: crs: (cannot be taken|.* is nowhere)"),
    "pole": ({"crs": "EPSG:4326", "transform": (1e-3, 0.0, 8.0, 0.0, -1e-3, 145.0)},
             r"^a.tif: transform: its centre is at longitude 8.0025, latitude 144.997"),
}  # fmt: skip


@pytest.mark.parametrize(("options", "message"), BAD.values(), ids=BAD)
def test_bad_geotiffs_are_refused_with_field_and_cure(tmp_path, options, message) -> None:
    with pytest.raises(TerrainError, match=message):
        _located(_fault(tmp_path, **options))


def test_large_grids_of_degrees_need_a_projection_even_with_curvature(tmp_path) -> None:
    path = geotiff(tmp_path / "a.tif", Z, "EPSG:4326", (0.1, 0.0, 8.0, 0.0, -0.1, 45.0))
    with pytest.raises(TerrainError, match=r"^a.tif: extent: .*grid of degrees.*gdalwarp -t_srs EPSG:32632"):
        _located(path, curved=True)


def test_heights_that_cannot_be_are_refused_with_their_place(tmp_path) -> None:
    z = Z.copy()
    z[2, 3] = -3.4e38
    source = _opened(geotiff(tmp_path / "a.tif", z)).source
    with pytest.raises(TerrainError, match=r"^a.tif: heights: .* at row 2, column 3; .*-a_nodata"):
        source.read((slice(1, 6), slice(2, 5)))


@pytest.mark.parametrize("keep", [0, 7, 300, 0.6])
def test_damaged_files_are_refused_by_name(tmp_path, keep) -> None:
    path = geotiff(tmp_path / "a.tif", np.random.default_rng(0).random((64, 64)).astype(np.float32), compress="deflate")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * keep) if isinstance(keep, float) else keep])
    with pytest.raises(TerrainError, match=r"^a.tif: .*damaged"):
        _opened(path).source.read((slice(0, 64), slice(0, 64)))


def test_arrays_of_numpy_need_a_resolution_and_a_place(tmp_path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.where(Z == 4.0, -1.0, Z))
    where = _located(path, given=(46.0, 8.0), resolution=2.0, nodata=-1.0)
    assert where.grid.row_step == (0.0, -2.0) and where.place.latitude == 46.0
    assert np.isnan(_opened(path, resolution=2.0, nodata=-1.0).source.read(WHOLE)[0, 4])
    with pytest.raises(TerrainError, match=r"^a.npy: --resolution: expected"):
        _opened(path)
    with pytest.raises(TerrainError, match=r"^a.npy: crs: there is none"):
        _located(path, resolution=2.0)
    np.save(path, Z[0])
    with pytest.raises(TerrainError, match=r"^a.npy: heights: expected real numbers of shape"):
        _opened(path, resolution=2.0)
    np.save(path, Z)
    path.write_bytes(path.read_bytes().replace(b"{", b"(", 1))
    with pytest.raises(TerrainError, match=r"^a.npy: not an array, or damaged"):
        _opened(path, resolution=2.0)
    path.write_bytes(b"\x93NUMPY")
    with pytest.raises(TerrainError, match=r"^a.npy: not an array, or damaged"):
        _opened(path, resolution=2.0)


def test_netcdf_has_coordinates_of_centres(tmp_path) -> None:
    import xarray
    from rasterio.crs import CRS

    path = tmp_path / "a.nc"
    x, y = 440_005.0 + 10.0 * np.arange(5), 5_099_995.0 - 10.0 * np.arange(6)
    found = xarray.Dataset(
        {"z": (("y", "x"), Z, {"units": "m", "grid_mapping": "utm"}),
         "utm": ((), 0, {"crs_wkt": CRS.from_epsg(32632).to_wkt()})},
        coords={"y": y, "x": x},
    )  # fmt: skip
    found.to_netcdf(path, engine="h5netcdf")
    model = _opened(path)
    assert model.transform == (10.0, 0.0, 440_000.0, 0.0, -10.0, 5_100_000.0) and model.crs.to_epsg() == 32632
    assert np.array_equal(model.source.read(WHOLE), Z)
    found["more"] = found.z
    found.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(TerrainError, match=r"^a.nc: --variable: expected one of z, more"):
        _opened(path)
    found.assign_coords(x=x + np.array([0, 0, 1, 0, 0])).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(TerrainError, match=r"^a.nc: x: expected equal steps"):
        _opened(path, variable="z")
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(TerrainError, match=r"^a.nc: not a NetCDF 4 file, or damaged"):
        _opened(path)


def test_zarr_stores_are_checked_as_netcdf_files(tmp_path) -> None:
    pytest.importorskip("zarr")
    import xarray

    path = tmp_path / "a.zarr"
    x, y = 440_005.0 + 10.0 * np.arange(5), 5_099_995.0 - 10.0 * np.arange(6)
    found = xarray.Dataset({"z": (("y", "x"), Z, {"units": "m"})}, coords={"y": y, "x": x})
    found.to_zarr(path, zarr_format=2)
    model = _opened(path)
    assert model.transform == (10.0, 0.0, 440_000.0, 0.0, -10.0, 5_100_000.0) and model.crs is None
    assert np.array_equal(model.source.read(WHOLE), Z)
    assert np.array_equal(pickle.loads(pickle.dumps(model.source)).read((slice(1, 3), slice(2, 5))), Z[1:3, 2:5])
    found["more"] = found.z > 3.0
    found.to_zarr(path, mode="w", zarr_format=2)
    with pytest.raises(TerrainError, match=r"^a.zarr: --variable: expected one of more, z, got"):
        _opened(path)
    with pytest.raises(TerrainError, match=r"^a.zarr: heights: expected real numbers"):
        _opened(path, variable="more")
    for name in (".zmetadata", "z/.zarray"):
        (path / name).write_text("{")
    with pytest.raises(TerrainError, match=r"^a.zarr: not a Zarr store, or damaged"):
        _opened(path, variable="z")


def test_without_zarr_the_cure_is_said(tmp_path, monkeypatch) -> None:
    (tmp_path / "a.zarr").mkdir()
    monkeypatch.setattr(reading.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(TerrainError, match=r"^a.zarr: a Zarr store needs zarr: pip install"):
        _opened(tmp_path / "a.zarr")


def test_what_is_not_there_is_said(tmp_path) -> None:
    with pytest.raises(TerrainError, match=r"a.tif: no such file"):
        _opened(tmp_path / "a.tif")


def test_real_model_of_the_earth() -> None:
    """129 x 129 heights of an arc second; the corner given is that of the pixel."""
    where = _located(data.file("dem/dem_squared.tif"))
    assert where.place.latitude == pytest.approx(38.0016667 - 64.5 / 3600.0, abs=1e-6)
    assert where.grid.column_step[0] == pytest.approx(24.4, abs=0.05)
    assert where.grid.row_step[1] == pytest.approx(-30.8, abs=0.05)


def test_real_model_of_the_moon_is_refused() -> None:
    with pytest.raises(TerrainError, match=r"^dem_moon.tif: crs: its body has a radius of 1737.4 km"):
        _located(data.file("dem/dem_moon.tif"))
