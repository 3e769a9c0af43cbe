# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer terrain`: files in, files out; runs that are interrupted, several processes, wrong options."""

from __future__ import annotations

import pickle
from pathlib import Path

import data
import numpy as np
import pytest
import terrain_runs
from elevation_files import by_hand, geotiff, tags_of
from valleys import hills

for _name in ("ephem", "h5netcdf", "h5py", "matplotlib", "PIL", "rasterio", "rich", "xarray"):
    pytest.importorskip(_name, reason="needs the extra: pip install 'shadow_tracer[terrain]'")

from shadow_tracer import HeightField, Place, sunlight  # noqa: E402
from shadow_tracer.apps.fleet.files import only_one  # noqa: E402
from shadow_tracer.apps.terrain import pictures, run, terrain  # noqa: E402
from shadow_tracer.apps.terrain.georeference import TerrainError  # noqa: E402
from shadow_tracer.apps.terrain.reading import open_model  # noqa: E402
from shadow_tracer.terrain.tile import TileResult  # noqa: E402

DAY = ["--date", "2026-03-20", "--every", "2h", "--device", "cpu"]


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    z = hills(40, 46, seed=9, height=90.0).astype(np.float32)
    z[12:15, 20:22] = -9999.0
    return z


@pytest.fixture
def model(tmp_path, ground) -> Path:
    return geotiff(tmp_path / "dem.tif", ground, nodata=-9999.0)


def _bands(path: Path) -> np.ndarray:
    import rasterio

    with rasterio.open(path) as file:
        return file.read()


def _run(model: Path, name: str, *more: str) -> Path:
    out = model.with_name(name)
    assert terrain.main([str(model), "-o", str(out), *DAY, *more]) == 0
    return out


def test_a_geotiff_becomes_sums_and_codes_where_it_was(model, ground) -> None:
    import rasterio

    codes = model.with_name("codes.tif")
    out = _run(model, "sun.tif", "--codes", str(codes))
    with rasterio.open(model) as before, rasterio.open(out) as file, rasterio.open(codes) as each:
        assert file.transform == each.transform == before.transform and file.crs == each.crs == before.crs
        assert file.descriptions[0] == "sunshine_duration [s]" and file.units[0] == "s" and np.isnan(file.nodata)
        assert each.descriptions[:2] == ("2026-03-20T00:00:00Z", "2026-03-20T02:00:00Z") and each.count == 12
        assert float(each.tags(7)["sun_elevation"]) == pytest.approx(43.5, abs=1.0)
        sums, states = file.read(), each.read()
    hole = ground == -9999.0
    assert np.isnan(sums[:, hole]).all() and not np.isnan(sums[:, ~hole]).any() and (states[:, hole] == 3).all()
    assert np.array_equal(sums[0][~hole], ((states == 0).sum(axis=0) * 7200.0)[~hole])
    assert not list(model.parent.glob("*.part*"))


def test_the_program_and_the_library_say_the_same(model) -> None:
    import xarray

    out = _run(model, "sun.nc")
    where = terrain.locate("dem.tif", *_placed(model), None, False)
    z = open_model(model, None, "", None, None).source.read((slice(0, 40), slice(0, 46)))
    times = [f"2026-03-20T{hour:02d}:00Z" for hour in range(0, 24, 2)]
    found = sunlight(HeightField(z, 10.0), times, where.place, interval=7200.0, device="cpu")
    with xarray.open_dataset(out, engine="h5netcdf", decode_timedelta=False) as file:
        assert np.array_equal(file.sun_code, found.sun_code)
        assert np.array_equal(file.direct_exposure, found.direct_exposure, equal_nan=True)
        assert np.array_equal(file.time, found.time) and np.array_equal(file.time_bnds, found.time_bnds)
        assert file.x.values[0] == 440_005.0 and file.y.values[0] == 5_099_995.0
        assert "UTM zone 32N" in file.spatial_ref.crs_wkt and file.sun_code.grid_mapping == "spatial_ref"
    assert isinstance(where.place, Place)


@pytest.mark.slow
def test_a_zarr_store_has_what_the_netcdf_file_has(model, capsys) -> None:
    """Tile by tile, in whatever order chunks and tiles meet; and again in its place."""
    pytest.importorskip("zarr")
    import xarray

    plain = _run(model, "sun.nc")
    for more in ([], ["--tile", "16", "--overwrite"]):
        out = _run(model, "sun.zarr", *more)
        with (
            xarray.open_dataset(plain, engine="h5netcdf", decode_timedelta=False) as one,
            xarray.open_dataset(out, engine="zarr", decode_timedelta=False) as other,
        ):
            assert set(one.variables) == set(other.variables)
            for name in one.variables:
                np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=str(name))
                assert one[name].dims == other[name].dims and one[name].dtype == other[name].dtype, name
                kept = {key: value for key, value in one[name].attrs.items() if key != "flag_values"}
                assert kept == {key: value for key, value in other[name].attrs.items() if key != "flag_values"}, name
            assert one.attrs == other.attrs and list(other.sun_code.attrs["flag_values"]) == [0, 1, 2, 3]
    assert terrain.main([str(model), "-o", str(out), *DAY]) == 1 and "exists" in capsys.readouterr().err
    assert not list(model.parent.glob("*.part*"))


def test_a_model_in_a_zarr_store_is_that_of_the_geotiff(model, ground) -> None:
    pytest.importorskip("zarr")
    import xarray
    from rasterio.crs import CRS

    x, y = 440_005.0 + 10.0 * np.arange(46), 5_099_995.0 - 10.0 * np.arange(40)
    wkt = CRS.from_epsg(32632).to_wkt()
    store = model.with_name("dem.zarr")
    z = ("y", "x"), np.where(ground == -9999.0, np.nan, ground), {"units": "m", "grid_mapping": "utm"}
    found = xarray.Dataset({"z": z, "utm": ((), 0, {"crs_wkt": wkt})}, coords={"y": y, "x": x})
    found.to_zarr(store, encoding={"z": {"chunks": (16, 16)}}, zarr_format=2)
    assert _run(store, "b.tif", "--tile", "16").read_bytes() == _run(model, "a.tif", "--tile", "16").read_bytes()


def test_cloud_optimised_files_have_the_same_cells_and_overviews(tmp_path) -> None:
    import rasterio

    z = hills(300, 560, seed=3, height=200.0).astype(np.float32)
    z[:4, :4] = -9999.0
    model = geotiff(tmp_path / "dem.tif", z, nodata=-9999.0)
    day = ["--every", "8h"]
    plain = _run(model, "sun.tif", "--codes", str(tmp_path / "codes.tif"), *day)
    out = _run(model, "cog.tif", "--codes", str(tmp_path / "cogs.tif"), "--cog", *day)
    for one, other in ((plain, out), (tmp_path / "codes.tif", tmp_path / "cogs.tif")):
        with rasterio.open(one) as before, rasterio.open(other) as file:
            assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and file.overviews(1) == [2]
            assert file.block_shapes[0] == (512, 512) and file.compression.value == "DEFLATE"
            assert np.array_equal(before.read(), file.read(), equal_nan=True)
            assert (file.transform, file.crs, file.descriptions) == (before.transform, before.crs, before.descriptions)
            assert file.tags()["AREA_OR_POINT"] == before.tags()["AREA_OR_POINT"] and file.units == before.units
            assert np.isnan(file.nodata) if before.nodata is not None else file.nodata is None
    with rasterio.open(tmp_path / "cogs.tif", overview_level=0) as file:
        assert set(np.unique(file.read())) <= {0, 1, 2, 3}
    with rasterio.open(out, overview_level=0) as file, rasterio.open(plain) as before:
        assert file.read(1)[100, 100] == pytest.approx(before.read(1)[200:202, 200:202].mean())  # of four cells
    assert not list(tmp_path.glob("*.pl*")) and not list(tmp_path.glob("*.part*"))


def _placed(path: Path):
    model = open_model(path, None, "", None, None)
    return model.shape, model.transform, model.crs


@pytest.mark.parametrize("point", [False, True], ids=["area", "point"])
def test_results_lie_where_the_model_lies_to_the_half_cell(tmp_path, ground, point) -> None:
    path = by_hand(tmp_path / "dem.tif", np.maximum(ground, 0.0), (440_000.0, 5_100_000.0), 10.0, point)
    tags = tags_of(_run(path, "sun.tif", "--every", "6h"))
    assert tags[33922][3:5] == (440_000.0, 5_100_000.0) and tags[33550][:2] == (10.0, 10.0)
    assert dict(zip(tags[34735][4::4], tags[34735][7::4], strict=True))[1025] == (2 if point else 1)


def test_tiles_give_the_file_of_the_whole(model) -> None:
    assert _run(model, "a.tif").read_bytes() == _run(model, "b.tif", "--tile", "256").read_bytes()
    assert np.array_equal(
        _bands(model.with_name("a.tif")), _bands(_run(model, "c.tif", "--tile", "16")), equal_nan=True
    )


def test_an_interrupted_run_goes_on_and_gives_the_same_bytes(model, monkeypatch, capsys) -> None:
    whole = _run(model, "whole.tif", "--tile", "16").read_bytes()
    saved, save = [], run.save

    def stop_after_three(path, result):
        if len(saved) == 3:
            raise KeyboardInterrupt
        saved.append(path)
        save(path, result)

    monkeypatch.setattr(run, "save", stop_after_three)
    out = model.with_name("sun.tif")
    command = [str(model), "-o", str(out), *DAY, "--tile", "16"]
    assert terrain.main(command) == 130 and not out.exists() and len(saved) == 3
    monkeypatch.setattr(run, "save", save)
    saved[1].write_bytes(saved[1].read_bytes()[:100])  # a file that was damaged is made again
    capsys.readouterr()
    assert terrain.main([*command, "--every", "3h"]) == 1
    assert "holds tiles of a run with other options" in capsys.readouterr().err
    assert terrain.main(command) == 0
    assert "9 tiles, 2 of them from the run before" in capsys.readouterr().out
    assert out.read_bytes() == whole


def test_the_second_run_on_one_output_refuses(model, capsys) -> None:
    with only_one(model.with_name("sun.tif.parts") / run.LOCK):
        assert terrain.main([str(model), "-o", str(model.with_name("sun.tif")), *DAY]) == 2
    assert "another run is at work there" in capsys.readouterr().err
    _run(model, "sun.tif")


def test_engines_and_what_goes_with_them(model, monkeypatch, capsys) -> None:
    """Jobs name files alone, by their full paths: whoever does them stands somewhere else."""
    seen = []

    def here(work, jobs, workers, retries, good, done):
        seen.append((len(jobs), workers, retries))
        monkeypatch.chdir("/")
        for job in jobs:
            done(job, work(pickle.loads(pickle.dumps(job))))
        monkeypatch.chdir(model.parent)

    monkeypatch.setattr("shadow_tracer.apps.fleet.engines.run_local", here)
    monkeypatch.chdir(model.parent)
    command = ["dem.tif", *DAY, "--tile", "16", "-o"]
    assert terrain.main([*command, "a.tif", "--jobs", "3", "--retries", "5"]) == 0 and seen == [(9, 3, 5)]
    assert terrain.main([*command, "b.tif"]) == 0 and len(seen) == 1
    assert model.with_name("a.tif").read_bytes() == model.with_name("b.tif").read_bytes()
    for more in (["--scheduler", "tcp://h:1"], ["--retries", "-1"], ["--threads", "0"],
                 ["--engine", "dask", "--scheduler", "tcp://h:1", "--scheduler-file", "f"]):  # fmt: skip
        assert terrain.main([*command, "c.tif", *more]) == 1 and f"{more[-2]}: expected" in (
            capsys.readouterr().err.replace(
                "--scheduler: expected without --scheduler-file", "--scheduler-file: expected"
            )
        )


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced(model, monkeypatch) -> None:
    """A tile that its worker does not survive at first."""
    mark = model.with_name("mark")
    monkeypatch.setenv("SHADOW_TRACER_TEST_MARK", str(mark))
    monkeypatch.setattr(run, "answer", terrain_runs.perilous)
    out = model.with_name("sun.tif")
    assert terrain.main([str(model), "-o", str(out), *DAY, "--tile", "16", "--jobs", "2"]) == 0
    assert mark.exists() and out.read_bytes() == _run(model, "whole.tif", "--tile", "16").read_bytes()


def test_a_tile_that_has_changed_on_the_disk_is_not_believed(tmp_path, model) -> None:
    """Each byte of the compressed numbers, in the middle of the file: all that a reader may say of it."""
    folder, result = tmp_path / "parts", TileResult(*(np.arange(400.0).reshape(20, 20) for _ in range(5)))
    parts = run.Parts(folder, "key", False)
    run.save(parts.path(0), result)
    good = parts.path(0).read_bytes()
    assert parts.load(0) is not None
    for place in range(40, len(good) // 4, 7):
        parts.path(0).write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        found = parts.load(0)
        assert found is None or np.array_equal(found.codes, result.codes), place


@pytest.mark.parametrize("left", ["nothing", "a part", "no mark", "half a mark", "another's"])
def test_what_a_run_leaves_that_was_interrupted_at_its_begin(tmp_path, left) -> None:
    folder = tmp_path / "parts"
    whole = run.Parts(folder, "key", False)
    run.save(whole.path(0), TileResult(*(np.zeros((1, 1)) for _ in range(5))))
    mark = folder / "run.json"
    if left in ("nothing", "a part"):
        whole.remove()
        folder.mkdir()
        if left == "a part":
            (folder / "run.json.part").write_text("{")
        assert run.Parts(folder, "key", False).load(0) is None
        assert [path.name for path in folder.iterdir()] == ["run.json"]
        return
    text = {"no mark": None, "half a mark": mark.read_text()[:9], "another's": "[]"}[left]
    mark.unlink()
    if text is not None:
        mark.write_text(text)
    with pytest.raises(TerrainError, match="holds tiles of a run with other options, or of another file; --restart"):
        run.Parts(folder, "key", False)
    assert whole.load(0) is not None, "nothing is thrown away"
    assert run.Parts(folder, "key", True).load(0) is None


@pytest.mark.slow
def test_the_same_command_goes_on_after_an_interrupt_while_files_are_written(model, monkeypatch, capsys) -> None:
    """None of them is there yet, which would be refused."""
    gif, names = pictures.Pictures.gif, [model.with_name(name) for name in ("sun.tif", "codes.tif", "a.png", "a.gif")]

    def interrupted(self, path):
        path.write_bytes(b"GIF89a")
        raise KeyboardInterrupt

    monkeypatch.setattr(pictures.Pictures, "gif", interrupted)
    options = [text for pair in zip(["-o", "--codes", "--png", "--gif"], map(str, names), strict=True) for text in pair]
    assert terrain.main([str(model), *DAY, *options]) == 130
    assert sorted(path.name for path in model.parent.iterdir()) == ["dem.tif", "sun.tif.parts"]
    monkeypatch.setattr(pictures.Pictures, "gif", gif)
    assert terrain.main([str(model), *DAY, *options]) == 0
    assert "1 tiles, 1 of them from the run before" in capsys.readouterr().out
    assert all(path.exists() for path in names)


@pytest.mark.parametrize(
    ("name", "options"), [("sun.tif", []), ("sun.tif", ["--cog"]), ("sun.nc", []), ("sun.zarr", [])]
)
def test_an_output_is_whole_or_not_there(model, monkeypatch, capsys, name, options) -> None:
    if name == "sun.zarr":
        pytest.importorskip("zarr")
    results = run.results

    def ends_early(plan, parts):
        yield next(results(plan, parts))
        raise TerrainError("parts/000001.npz: has gone")

    monkeypatch.setattr(run, "results", ends_early)
    more = ["--tile", "16", "--png", str(model.with_name("sun.png")), *options]
    command = [str(model), "-o", str(model.with_name(name)), *DAY, *more]
    assert terrain.main(command) == 1 and "has gone" in capsys.readouterr().err
    assert sorted(path.name for path in model.parent.iterdir()) == ["dem.tif", f"{name}.parts"]


@pytest.mark.slow
def test_two_processes_give_the_bytes_of_one(model) -> None:
    one, two = (_run(model, f"{jobs}.tif", "--tile", "16", "--jobs", jobs) for jobs in ("1", "2"))
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.slow
def test_pictures_have_a_frame_for_each_time_with_the_sun_up(model) -> None:
    from PIL import Image

    png, gif = model.with_name("sun.png"), model.with_name("day.gif")
    _run(model, "sun.tif", "--png", str(png), "--gif", str(gif), "--tile", "16", "--every", "1h")
    with Image.open(gif) as moving:
        assert moving.n_frames == 12
    with Image.open(png) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 50 and (pixels == (140, 140, 140)).all(axis=1).any()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--every", "soon"], "--every: expected 1s to 24h"),
        (["--tz", "Nowhere"], "--tz: expected a zone"),
        (["--height-above", "-1"], "above: expected at least 0"),
        (["--irradiance", "-5"], "irradiance: expected finite numbers"),
        (["--jobs", "0"], "--jobs: expected at least 1"),
        (["--latitude", "3"], "--latitude: expected together with --longitude"),
        (["--latitude", "3", "--longitude", "4"], "crs: there is one; leave out --latitude"),
        (["--memory", "0.00001"], "memory: expected at least"),
        (["-o", "sun.png"], "-o: expected *.tif, *.nc or *.zarr"),
        (["-o", "sun.nc", "--cog"], "--cog: expected an output of *.tif"),
        (["-o", "nowhere/sun.tif"], "there is no folder"),
        (["--gif", "day.gif", "--until", "2026-03-22", "--every", "1min"], "--gif: expected at most 2000 times"),
        (["--codes", "codes.nc"], "--codes: expected *.tif"),
        (["--codes", "sun.tif"], "--codes: expected another file than those of the other options"),
        (["--codes", "codes.tif", "--until", "2026-04-15", "--every", "30s"], "--codes: expected at most 65535 times"),
        (["--memory", "nan"], "memory: expected a finite number"),
        (["--memory", "inf"], "memory: expected a finite number"),
        (["--until", "9999-12-31"], "--until: expected the years 1900 to 2100"),
        (["--gif", "day.gif", "--every", "24h"], "--gif: expected times with the sun above the horizon"),
        (["--resolution", "3"], "--resolution and --nodata are for .npy"),
    ],
)
def test_wrong_options_are_named(model, monkeypatch, capsys, more, message) -> None:
    monkeypatch.chdir(model.parent)
    assert terrain.main([str(model), "-o", "sun.tif", *DAY, *more]) == 1
    assert message in capsys.readouterr().err
    assert [path.name for path in model.parent.iterdir()] == ["dem.tif"]


def test_no_file_is_overwritten_unless_asked(model, capsys) -> None:
    out = _run(model, "sun.tif")
    assert terrain.main([str(model), "-o", str(out), *DAY]) == 1 and "exists" in capsys.readouterr().err
    assert terrain.main([str(model), "-o", str(model), *DAY, "--overwrite"]) == 1
    assert "is the model that is read" in capsys.readouterr().err
    _run(model, "sun.tif", "--overwrite")


def test_a_model_without_any_height_is_refused(tmp_path, capsys) -> None:
    path = geotiff(tmp_path / "dem.tif", np.full((20, 20), -1.0, np.float32), nodata=-1.0)
    assert terrain.main([str(path), "-o", str(tmp_path / "sun.tif"), *DAY]) == 1
    assert "dem.tif: heights: there is none" in capsys.readouterr().err


def test_what_is_not_installed_is_said(model, monkeypatch, capsys) -> None:
    monkeypatch.setattr(terrain, "NEEDED", ("rasterio", "no_such_package"))
    assert terrain.main([str(model), "-o", "sun.tif", *DAY]) == 2
    assert capsys.readouterr().err.strip() == "terrain needs no_such_package: pip install 'shadow_tracer[terrain]'"


def test_a_day_on_the_real_model(tmp_path) -> None:
    """No shadow is cast on the summit; the day has 12 hours, of which 2 are in each time."""
    path, codes = data.file("dem/dem_squared.tif"), tmp_path / "codes.tif"
    out = tmp_path / "sun.tif"
    more = ["--beyond", "nothing", "--codes", str(codes)]
    assert terrain.main([str(path), "-o", str(out), *DAY, *more]) == 0
    z = open_model(path, None, "", None, None).source.read((slice(0, 129), slice(0, 129)))
    row, column = np.unravel_index(z.argmax(), z.shape)
    states = _bands(codes)
    assert not (states[:, row, column] == 2).any() and (states == 2).any() and not (states == 3).any()
    assert _bands(out)[0].max() == 12.0 * 3600.0
