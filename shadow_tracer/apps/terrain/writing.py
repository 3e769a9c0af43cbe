# SPDX-License-Identifier: Apache-2.0
"""Results into GeoTIFF, plain or cloud-optimised, and Zarr, tile by tile, and into NetCDF."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from shadow_tracer.apps.terrain.georeference import Georeference, TerrainError
from shadow_tracer.terrain.dataset import CODES, LAYERS, Gathered, dataset, iso, layers_of
from shadow_tracer.terrain.plan import Plan, Window
from shadow_tracer.terrain.tile import Code, TileResult

_CHUNK = 1024  # cells along an edge of a Zarr chunk, at most
_BLOCK = 256  # pixels of a GeoTIFF's blocks
MOST_BANDS = 65_535
"""Of a GeoTIFF."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """The name of a file or folder while it is written: it gets ``path`` when all is in it, and goes if that fails."""
    new = path.with_name(path.name + ".part")
    try:
        yield new
        if path.is_dir():
            shutil.rmtree(path)
        new.replace(path)
    except BaseException:
        if new.is_dir():
            shutil.rmtree(new)
        new.unlink(missing_ok=True)
        raise


class TiffOutput:
    """A GeoTIFF of the sums, a band for each, and one of the codes, a band for each time.

    Args:
        path: of the sums.
        codes: of the codes, or None.
        plan, where, point: what is written, where it is, and whether pixels are points.
        cloud: make them cloud-optimised at the end, with overviews; for a while there are two of each.
    """

    def __init__(
        self, path: Path, codes: Path | None, plan: Plan, where: Georeference, point: bool, cloud: bool = False
    ) -> None:
        self._final = [path, *([codes] if codes else [])]
        self._paths = [each.with_name(f"{each.name}.plain") for each in self._final] if cloud else self._final
        self._plan, self._where, self._point = plan, where, point
        self._cloud = cloud
        self._stack = ExitStack()
        self._files: list[Any] = []

    def __enter__(self) -> TiffOutput:
        sums = [f"{layer.name} [{layer.units}]" for layer in LAYERS]
        self._open(self._paths[0], "float32", sums, nodata=float("nan"), predictor=3)
        file = self._files[0]
        for number, layer in enumerate(LAYERS, 1):
            file.set_band_unit(number, layer.units)
            file.update_tags(number, long_name=layer.long_name, standard_name=layer.standard_name)
        if len(self._paths) > 1:
            stamps = [iso(stamp) for stamp in self._plan.suns.stamps]
            self._open(self._paths[1], "uint8", stamps, nodata=None, predictor=2)
            suns = self._plan.suns
            for number, (azimuth, elevation) in enumerate(zip(suns.azimuth, suns.elevation, strict=True), 1):
                self._files[1].update_tags(number, sun_azimuth=f"{azimuth:.4f}", sun_elevation=f"{elevation:.4f}")
        return self

    def _open(self, path: Path, dtype: str, bands: list[str], nodata: float | None, predictor: int) -> None:
        import rasterio

        grid = self._plan.grid
        tiled = {"tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK} if min(grid.rows, grid.columns) > 64 else {}
        file = self._stack.enter_context(
            rasterio.open(
                path, "w", driver="GTiff", height=grid.rows, width=grid.columns, count=len(bands), dtype=dtype,
                crs=self._where.crs, transform=rasterio.Affine(*self._where.transform), nodata=nodata,
                compress="deflate", predictor=predictor, BIGTIFF="IF_SAFER", **tiled,
            )
        )  # fmt: skip
        file.update_tags(AREA_OR_POINT="Point" if self._point else "Area", codes=CODES, software="shadow_tracer")
        for number, text in enumerate(bands, 1):
            file.set_band_description(number, text)
        self._files.append(file)

    def put(self, window: Window, result: TileResult) -> None:
        """Write a tile."""
        where = tuple((part.start, part.stop) for part in window)
        layers = layers_of(result, self._plan.suns.daylight)
        sums = np.stack([layers[layer.name] for layer in LAYERS]).astype(np.float32)
        self._files[0].write(sums, window=where)
        if len(self._files) > 1:
            self._files[1].write(result.codes, window=where)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stack.close()
        if not self._cloud:
            return
        try:
            # Of codes no mean can be made.
            for plain, final, how in zip(self._paths, self._final, ("AVERAGE", "NEAREST"), strict=False):
                if kind is None:
                    _cloud_optimised(plain, final, how)
        finally:
            for plain in self._paths:
                plain.unlink(missing_ok=True)


def _cloud_optimised(plain: Path, final: Path, resampling: str) -> None:
    from rasterio import shutil as copies
    from rasterio.errors import RasterioError

    try:
        copies.copy(
            plain, final, driver="COG", compress="deflate", predictor="yes", blocksize=512, bigtiff="if_safer",
            overview_resampling=resampling, overview_predictor="yes",
        )  # fmt: skip
    except RasterioError as error:
        final.unlink(missing_ok=True)
        raise TerrainError(f"{final.name.removesuffix('.part')}: --cog: cannot be made ({error})") from error


class NetCdfOutput:
    """A NetCDF file of it all, which is put together in memory."""

    def __init__(self, path: Path, plan: Plan, where: Georeference) -> None:
        self._path, self._plan, self._where = path, plan, where

    def __enter__(self) -> NetCdfOutput:
        self._gathered = Gathered(self._plan)
        return self

    def put(self, window: Window, result: TileResult) -> None:
        """Take a tile."""
        self._gathered.put(window, result)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is not None:
            return
        found = dataset(self._gathered, self._plan, *coordinates(self._where))
        _placed(found, self._where)
        packed = {name: {"zlib": True} for name, each in found.data_vars.items() if each.ndim >= 2}
        found.to_netcdf(self._path, engine="h5netcdf", encoding=packed)


def _placed(found: Any, where: Georeference) -> None:
    """Name the coordinate system in a Dataset."""
    if where.crs is not None:
        found["spatial_ref"] = ((), 0, {"crs_wkt": where.crs.to_wkt()})
        for name in ("sun_code", "sunlit", *(layer.name for layer in LAYERS)):
            found[name].attrs["grid_mapping"] = "spatial_ref"


class ZarrOutput:
    """A Zarr store of it all, with the variables of the NetCDF file, tile by tile.

    Args:
        path: of the folder.
        tile: cells along an edge of a tile, which is that of a chunk.
    """

    def __init__(self, path: Path, plan: Plan, where: Georeference, tile: int) -> None:
        self._path, self._plan, self._where = path, plan, where
        grid = plan.grid
        self._chunk = min(tile, grid.rows, _CHUNK), min(tile, grid.columns, _CHUNK)

    def __enter__(self) -> ZarrOutput:
        import zarr

        grid, (where, dims) = self._plan.grid, coordinates(self._where)
        about = dataset(Gathered(self._plan, (0, 0)), self._plan, {}, dims)  # what each variable is, without cells
        _placed(about, self._where)
        big = {str(name): each for name, each in about.data_vars.items() if set(dims) <= set(each.dims)}
        small = about.drop_vars(list(big)).drop_dims(list(dims), errors="ignore").assign_coords(where)
        small.to_zarr(self._path, mode="w", zarr_format=2, consolidated=False)
        self._group: Any = zarr.open_group(self._path, mode="r+", zarr_format=2)
        times = len(self._plan.suns.stamps)
        for name, each in big.items():
            extent = (times,) if each.ndim == 3 else ()
            made = self._group.create_array(
                name, shape=(*extent, grid.rows, grid.columns), chunks=(*([1] if extent else []), *self._chunk),
                dtype=each.dtype, fill_value=float("nan") if each.dtype.kind == "f" else None,
            )  # fmt: skip
            attributes = {key: _plain(value) for key, value in each.attrs.items()}
            made.attrs.update({**attributes, "_ARRAY_DIMENSIONS": list(each.dims)})
        return self

    def put(self, window: Window, result: TileResult) -> None:
        """Write a tile."""
        for k, codes in enumerate(result.codes):
            self._group["sun_code"][(k, *window)] = codes
            self._group["sunlit"][(k, *window)] = (codes == Code.LIT).astype(np.uint8)
        for name, values in layers_of(result, self._plan.suns.daylight).items():
            self._group[name][window] = values.astype(np.float32)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        import zarr

        if kind is None:
            zarr.consolidate_metadata(self._path, zarr_format=2)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def coordinates(where: Georeference) -> tuple[dict[str, Any], tuple[str, str]]:
    """Variables of xarray for the centres of cells, and the names of the dimensions."""
    a, b, c, d, e, f = where.transform
    rows, columns = np.arange(where.grid.rows) + 0.5, np.arange(where.grid.columns) + 0.5
    if where.crs is not None and where.crs.is_geographic:
        meta = [("longitude", "degrees_east"), ("latitude", "degrees_north")]
    else:
        units = "m" if where.crs is None else where.crs.linear_units
        meta = [(f"projection_{axis}_coordinate", "m" if units.lower().startswith("metre") else units) for axis in "xy"]
    about = [{"standard_name": name, "units": units, "comment": "of centres of cells"} for name, units in meta]
    if b == 0.0 and d == 0.0:
        return {"y": ("y", e * rows + f, about[1]), "x": ("x", a * columns + c, about[0])}, ("y", "x")
    x, y = a * columns + b * rows[:, None] + c, d * columns + e * rows[:, None] + f
    dims = ("row", "column")
    return {"y": (dims, y, about[1]), "x": (dims, x, about[0])}, dims
