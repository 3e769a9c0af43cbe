# SPDX-License-Identifier: Apache-2.0
"""Elevation models in files: what GDAL reads as a raster, such as GeoTIFF; `.npy`; `.nc` and `.zarr` by xarray."""

from __future__ import annotations

import importlib.util
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from tokenize import TokenError
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from shadow_tracer.apps.terrain.georeference import TerrainError, Transform
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.terrain.plan import Window

FloatArray = npt.NDArray[np.float64]
NO_ZARR = "a Zarr store needs zarr: pip install 'shadow_tracer[terrain]', with Python 3.11 or later"
_METRES = ("", "m", "metre", "metres", "meter", "meters")


class Source(Protocol):
    """Heights of a model; can be sent to another process."""

    def read(self, window: Window) -> FloatArray:
        """(R, C) float64 heights of some rows and columns [m], NaN where there is none."""


@dataclass(frozen=True)
class Model:
    """What a file holds.

    Attributes:
        source: its heights.
        shape: rows and columns.
        transform, crs: as in :class:`Georeference`; ``crs`` is None where there is none.
        point: whether its tag AREA_OR_POINT is Point.
    """

    source: Source
    shape: tuple[int, int]
    transform: Transform
    crs: Any
    point: bool = False


@dataclass
class GeoTiff:
    """A band of a raster file. NaN, what the band's nodata value says and what its mask leaves out have no height."""

    path: Path
    band: int
    _open: Any = field(default=None, repr=False, compare=False)

    def read(self, window: Window) -> FloatArray:
        import rasterio
        from rasterio.errors import RasterioError

        try:
            if self._open is None:
                self._open = rasterio.open(self.path)
            rows, columns = window
            found = self._open.read(
                self.band, window=((rows.start, rows.stop), (columns.start, columns.stop)), masked=True
            )
            scale, offset = self._open.scales[self.band - 1], self._open.offsets[self.band - 1]
        except (RasterioError, OSError, ValueError) as error:
            raise TerrainError(
                f"{self.path.name}: band {self.band}: cannot be read, it is damaged ({error})"
            ) from error
        heights = np.ma.getdata(found).astype(np.float64) * scale + offset
        heights[np.ma.getmaskarray(found)] = np.nan
        return _checked(self.path.name, heights, window)

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "band": self.band, "_open": None}


@dataclass
class Zarr:
    """A variable of a Zarr store, of which no more is read than is asked for."""

    path: Path
    variable: str
    _open: Any = field(default=None, repr=False, compare=False)

    def read(self, window: Window) -> FloatArray:
        try:
            if self._open is None:
                self._open = _open_store(self.path)[self.variable]
            heights = np.array(self._open[window].values, np.float64)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise TerrainError(f"{self.path.name}: {self.variable}: cannot be read, it is damaged ({error})") from error
        return _checked(self.path.name, heights, window)

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "variable": self.variable, "_open": None}


def _open_store(path: Path) -> Any:
    """The Dataset in a Zarr store; its arrays are read when they are looked at."""
    import xarray

    return xarray.open_dataset(path, engine="zarr", chunks=None)


@dataclass(frozen=True)
class InMemory:
    """An array."""

    name: str
    z: FloatArray

    def read(self, window: Window) -> FloatArray:
        return _checked(self.name, np.array(self.z[window], np.float64), window)


def _checked(name: str, heights: FloatArray, window: Window) -> FloatArray:
    wrong = np.argwhere(np.abs(heights) > min(LARGEST, 1e5))
    if len(wrong):
        row, column = (int(k) for k in wrong[0])
        raise TerrainError(
            f"{name}: heights: expected metres, at most 100000, got {heights[row, column]:g} at row "
            f"{row + window[0].start}, column {column + window[1].start}; if that says that there is none, set it: "
            "gdal_edit.py -a_nodata VALUE, or --nodata"
        )
    return heights


def open_model(path: Path, band: int | None, variable: str, resolution: float | None, nodata: float | None) -> Model:
    """Open a file.

    Args:
        path: what to read.
        band: of a raster, from 1 on; None is the only one.
        variable: of a `.nc` file or `.zarr` store; "" is the only one with two dimensions.
        resolution: of a `.npy` file [m].
        nodata: of a `.npy` file, the height that says that there is none.

    Raises:
        TerrainError: it is not there, damaged, or does not fit; the message names the field and a cure.
    """
    if not path.exists():
        raise TerrainError(f"{path}: no such file")
    if path.suffix == ".npy":
        return _open_npy(path, resolution, nodata)
    if resolution is not None or nodata is not None:
        raise TerrainError(f"{path.name}: --resolution and --nodata are for .npy files; this one has its own")
    if path.suffix == ".zarr":
        if importlib.util.find_spec("zarr") is None:
            raise TerrainError(f"{path.name}: {NO_ZARR}")
        return _open_zarr(path, variable)
    return _open_nc(path, variable) if path.suffix == ".nc" else _open_raster(path, band)


def _open_raster(path: Path, band: int | None) -> Model:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # what has no place is refused below
            file = rasterio.open(path)
        with file:
            count, dtypes, units = file.count, file.dtypes, file.units
            transform, crs, shape = file.transform, file.crs, (file.height, file.width)
            point = file.tags().get("AREA_OR_POINT", "Area").lower() == "point"
    except (RasterioError, OSError) as error:
        raise TerrainError(f"{path.name}: not a raster that GDAL can read, or damaged ({error})") from error
    if band is None and count != 1:
        raise TerrainError(f"{path.name}: bands: expected one, got {count}; choose with --band 1 to {count}")
    number = band or 1
    if not 1 <= number <= count:
        raise TerrainError(f"{path.name}: --band: expected 1 to {count}, got {number}")
    if np.dtype(dtypes[number - 1]).kind not in "iuf":
        raise TerrainError(f"{path.name}: band {number}: expected real numbers, got {dtypes[number - 1]}")
    unit = (units[number - 1] or "").strip().lower()
    if unit not in _METRES:
        raise TerrainError(
            f"{path.name}: band {number}: its unit is {unit!r}, expected metres; make them: gdal_calc.py, gdal_edit.py "
            "-units m"
        )
    if transform.is_identity:
        raise TerrainError(
            f"{path.name}: transform: there is none, so the size of a cell is not known; set it: gdal_edit.py -a_ullr "
            "X_WEST Y_NORTH X_EAST Y_SOUTH -a_srs EPSG:..."
        )
    a, b, c, d, e, f = (float(each) for each in transform[:6])
    return Model(GeoTiff(path, number), shape, (a, b, c, d, e, f), crs or None, point)


def _open_npy(path: Path, resolution: float | None, nodata: float | None) -> Model:
    if resolution is None or not 1e-3 <= resolution <= 1e6:
        raise TerrainError(f"{path.name}: --resolution: expected 0.001 to 1000000 m, got {resolution}")
    try:
        z = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError, TokenError) as error:
        raise TerrainError(f"{path.name}: not an array, or damaged ({error})") from error
    heights = _heights(path.name, z)
    if nodata is not None:
        heights = np.where(heights == nodata, np.nan, heights)
    transform = (resolution, 0.0, 0.0, 0.0, -resolution, resolution * heights.shape[0])
    return Model(InMemory(path.name, heights), (heights.shape[0], heights.shape[1]), transform, None)


def _heights(name: str, z: Any) -> FloatArray:
    if not isinstance(z, np.ndarray) or z.ndim != 2 or 0 in z.shape or z.dtype.kind not in "iuf":
        kind = f"{z.dtype} {z.shape}" if isinstance(z, np.ndarray) else type(z).__name__
        raise TerrainError(f"{name}: heights: expected real numbers of shape (rows, columns), got {kind}")
    return z.astype(np.float64)


def _open_nc(path: Path, variable: str) -> Model:
    import xarray

    try:
        with xarray.open_dataset(path, engine="h5netcdf") as file:
            found = _chosen(path.name, file, variable)
            heights = _heights(path.name, found.values)
            transform, crs = _described(path.name, file, found)
    except (OSError, ValueError, KeyError) as error:
        raise TerrainError(f"{path.name}: not a NetCDF 4 file, or damaged ({error})") from error
    return Model(InMemory(path.name, heights), (heights.shape[0], heights.shape[1]), transform, crs)


def _open_zarr(path: Path, variable: str) -> Model:
    try:
        with _open_store(path) as file:
            found = _chosen(path.name, file, variable)
            if found.dtype.kind not in "iuf" or 0 in found.shape:
                raise TerrainError(
                    f"{path.name}: heights: expected real numbers of shape (rows, columns), got {found.dtype} "
                    f"{found.shape}"
                )
            transform, crs = _described(path.name, file, found)
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise TerrainError(f"{path.name}: not a Zarr store, or damaged ({error})") from error
    return Model(Zarr(path, str(found.name)), (found.shape[0], found.shape[1]), transform, crs)


def _chosen(name: str, file: Any, variable: str) -> Any:
    """The variable with the heights."""
    names = [str(each) for each, found in file.data_vars.items() if found.ndim == 2]
    if (variable and variable not in names) or (not variable and len(names) != 1):
        raise TerrainError(
            f"{name}: --variable: expected one of {', '.join(names) or 'none with two dimensions'}, got {variable!r}"
        )
    return file[variable or names[0]]


def _described(name: str, file: Any, found: Any) -> tuple[Transform, Any]:
    """Where the cells of a variable are, and the coordinate system."""
    unit = str(found.attrs.get("units", "")).lower()
    if unit not in _METRES:
        raise TerrainError(f"{name}: units: expected m, got {unit!r}")
    axes = [file.coords.get(dim) for dim in found.dims]
    steps = [_axis(name, str(dim), axis) for dim, axis in zip(found.dims, axes, strict=True)]
    crs = _crs(file, found, [str(axis.attrs.get("units", "")) for axis in axes if axis is not None])
    (y, down), (x, right) = steps
    return (right, 0.0, x - right / 2, 0.0, down, y - down / 2), crs


def _axis(name: str, dim: str, axis: Any) -> tuple[float, float]:
    """First value and step of a coordinate."""
    values = None if axis is None else np.asarray(axis.values, np.float64)
    if values is None or len(values) < 2:
        raise TerrainError(f"{name}: {dim}: expected a coordinate of at least two values, at centres of cells")
    step = (values[-1] - values[0]) / (len(values) - 1)
    if not np.isfinite(step) or step == 0.0 or np.abs(np.diff(values) - step).max() > 1e-3 * abs(step):
        raise TerrainError(f"{name}: {dim}: expected equal steps, got {values[:4]} and so on")
    return float(values[0]), float(step)


def _crs(file: Any, found: Any, units: list[str]) -> Any:
    from rasterio.crs import CRS

    mapping = found.attrs.get("grid_mapping") or found.encoding.get("grid_mapping")
    if mapping in file.variables:
        attributes = file[mapping].attrs
        wkt = attributes.get("crs_wkt") or attributes.get("spatial_ref")
        if wkt:
            return CRS.from_wkt(str(wkt))
    return CRS.from_epsg(4326) if all(unit.startswith("degree") for unit in units) and units else None
