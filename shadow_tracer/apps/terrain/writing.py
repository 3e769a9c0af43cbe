# SPDX-License-Identifier: Apache-2.0
"""Results into GeoTIFF, tile by tile, and NetCDF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from shadow_tracer.apps.terrain.georeference import Georeference
from shadow_tracer.terrain.dataset import CODES, LAYERS, Gathered, dataset, iso, layers_of
from shadow_tracer.terrain.plan import Plan, Window
from shadow_tracer.terrain.tile import TileResult

_BLOCK = 256  # pixels of a GeoTIFF's blocks
MOST_BANDS = 65_535
"""Of a GeoTIFF."""


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """The name of a file while it is written: it gets ``path`` when all is in it, and goes if that fails."""
    new = path.with_name(path.name + ".part")
    try:
        yield new
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


class TiffOutput:
    """A GeoTIFF of the sums, a band for each, and one of the codes, a band for each time.

    Args:
        path: of the sums.
        codes: of the codes, or None.
        plan, where, point: what is written, where it is, and whether pixels are points.
    """

    def __init__(self, path: Path, codes: Path | None, plan: Plan, where: Georeference, point: bool) -> None:
        self._paths = [path, *([codes] if codes else [])]
        self._plan, self._where, self._point = plan, where, point
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
        if self._where.crs is not None:
            found["spatial_ref"] = ((), 0, {"crs_wkt": self._where.crs.to_wkt()})
            for name in ("sun_code", "sunlit", *(layer.name for layer in LAYERS)):
                found[name].attrs["grid_mapping"] = "spatial_ref"
        packed = {name: {"zlib": True} for name, each in found.data_vars.items() if each.ndim >= 2}
        found.to_netcdf(self._path, engine="h5netcdf", encoding=packed)


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
