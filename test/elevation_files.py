# SPDX-License-Identifier: Apache-2.0
"""Elevation models in files, made for the tests of `shadow_tracer terrain`."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np


def geotiff(
    path: Path,
    z: np.ndarray,
    crs: str | None = "EPSG:32632",
    transform: tuple[float, ...] | None = (10.0, 0.0, 440_000.0, 0.0, -10.0, 5_100_000.0),
    **more: Any,
) -> Path:
    """Write heights by rasterio; ``more`` may have nodata, units, scale, offset, point and what rasterio.open takes."""
    import rasterio

    bands = z if z.ndim == 3 else z[None]
    apart = {name: more.pop(name) for name in ("units", "scale", "offset", "point") if name in more}
    place = {} if transform is None else {"transform": rasterio.Affine(*transform)}
    with rasterio.open(
        path, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2], count=len(bands), dtype=bands.dtype,
        crs=crs, **place, **more,
    ) as file:  # fmt: skip
        file.write(bands)
        if apart.get("units"):
            file.units = (apart["units"],)
        if "scale" in apart:
            file.scales, file.offsets = (apart["scale"],), (apart["offset"],)
        if apart.get("point"):
            file.update_tags(AREA_OR_POINT="Point")
    return path


def by_hand(path: Path, z: np.ndarray, corner: tuple[float, float], step: float, point: bool) -> Path:
    """A GeoTIFF in UTM 32 north whose tags are written one by one, as its specification has them: the tie point is the
    corner of the first pixel, or its centre if pixels are points."""
    from PIL import Image
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    tags = ImageFileDirectory_v2()
    tags[33550], tags.tagtype[33550] = (step, step, 0.0), 12
    tags[33922], tags.tagtype[33922] = (0.0, 0.0, 0.0, corner[0], corner[1], 0.0), 12
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 2 if point else 1, 3072, 0, 1, 32632)
    tags[34735], tags.tagtype[34735] = keys, 3
    Image.fromarray(z.astype(np.float32)).save(path, tiffinfo=tags)
    return path


def tags_of(path: Path) -> dict[int, tuple[Any, ...]]:
    """Tags of a little-endian TIFF whose values are 16-bit integers or doubles, as they stand in the file."""
    raw = path.read_bytes()
    order, magic, first = struct.unpack_from("<2sHI", raw)
    assert (order, magic) == (b"II", 42)
    (entries,) = struct.unpack_from("<H", raw, first)
    found = {}
    for k in range(entries):
        at = first + 2 + 12 * k
        tag, kind, count, value = struct.unpack_from("<HHII", raw, at)
        if kind in (3, 12):
            letter, size = ("H", 2) if kind == 3 else ("d", 8)
            found[tag] = struct.unpack_from(f"<{count}{letter}", raw, value if count * size > 4 else at + 8)
    return found
