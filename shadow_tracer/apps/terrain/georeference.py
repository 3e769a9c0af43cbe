# SPDX-License-Identifier: Apache-2.0
"""From a file's coordinates to metres: the steps of its grid, where it is on the Earth, where its grid north points."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from shadow_tracer.terrain.grid import FARTHEST_FLAT, Grid
from shadow_tracer.terrain.suns import Place

_WGS84 = 6_378_137.0, 298.257223563
_SCALE = 0.005  # how far a metre of a projection may be from a metre on the ground
_PROBE = 100.0  # metres, to measure it
Transform = tuple[float, float, float, float, float, float]


class TerrainError(Exception):
    """A file that cannot be used, or written; the message starts with its name."""


@dataclass(frozen=True)
class Georeference:
    """Where a model is.

    Attributes:
        transform: (a, b, c, d, e, f): the corner of row r, column c is at x = a c + b r + c, y = d c + e r + f, its
            centre half a row and half a column further.
        crs: of rasterio, or None.
        grid: the model, in metres.
        place: of its centre.
    """

    transform: Transform
    crs: Any
    grid: Grid
    place: Place


def locate(
    name: str,
    shape: tuple[int, int],
    transform: Transform,
    crs: Any,
    given: tuple[float, float] | None,
    curved: bool,
) -> Georeference:
    """Find out where a model is.

    Args:
        name: of the file, for messages.
        shape: rows and columns.
        transform, crs: as in :class:`Georeference`; None is metres, with grid north true north.
        given: latitude and longitude of the centre [degrees] by the user, needed where there is no crs.
        curved: whether heights are lowered by the curvature of the Earth.

    Raises:
        TerrainError: what there is does not say where it is, or not well enough; the message names it and a cure.
    """
    a, b, c, d, e, f = transform
    if not all(math.isfinite(each) for each in transform) or a * e - b * d == 0.0:
        raise TerrainError(f"{name}: transform: expected two steps that span a grid, got {transform}")
    if abs(a * b + d * e) > 1e-9 * math.hypot(a, d) * math.hypot(b, e):
        raise TerrainError(
            f"{name}: transform: rows and columns are not at a right angle; make a grid without shear: gdalwarp IN OUT"
        )
    column, row = (shape[1]) / 2, (shape[0]) / 2
    x, y = a * column + b * row + c, d * column + e * row + f
    if crs is None:
        if given is None:
            raise TerrainError(
                f"{name}: crs: there is none, so it is not known where the sun stands; give --latitude and --longitude "
                "of the centre (coordinates are metres then), or set it: gdal_edit.py -a_srs EPSG:..."
            )
        row_step, column_step, place = (b, e), (a, d), Place(*given)
    elif given is not None:
        raise TerrainError(f"{name}: crs: there is one; leave out --latitude and --longitude")
    elif crs.is_geographic:
        row_step, column_step, place = _degrees(name, crs, transform, x, y)
    else:
        row_step, column_step, place = _projected(name, crs, transform, x, y)
    grid = Grid(*shape, row_step, column_step, curved)
    try:
        grid.checked()
    except ValueError as error:
        text = str(error).removeprefix("height_field: ").replace("ask for curvature", "give --curvature")
        raise TerrainError(f"{name}: extent: {text}") from error
    if crs is not None and crs.is_geographic and grid.reach() > FARTHEST_FLAT:
        raise TerrainError(
            f"{name}: extent: corners are {grid.reach() / 1000:.1f} km from the centre, too far for a grid of degrees, "
            f"whose columns come closer towards the pole; expected at most {FARTHEST_FLAT / 1000:.0f} km, or a "
            f"projection: gdalwarp -t_srs {_utm(place)} IN OUT"
        )
    return Georeference(transform, crs, grid, place)


def _ellipsoid(name: str, crs: Any) -> tuple[float, float]:
    """Semi-major axis [m] and inverse flattening (0 is a sphere)."""
    found = re.search(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([0-9.eE+]+),\s*([0-9.eE+]+)', crs.to_wkt())
    axis, inverse = (float(found.group(k)) for k in (1, 2)) if found else _WGS84
    if not 6.3e6 < axis < 6.4e6:
        raise TerrainError(
            f"{name}: crs: its body has a radius of {axis / 1000:.1f} km, and where the sun stands is known for the "
            "Earth alone; other bodies are not supported"
        )
    return axis, inverse


def _metres_a_degree(axis: float, inverse: float, latitude: float) -> tuple[float, float]:
    """Along a parallel, and along a meridian [m]."""
    flat = 1.0 / inverse if inverse else 0.0
    square = flat * (2.0 - flat)
    sine = math.sin(math.radians(latitude))
    normal = axis / math.sqrt(1.0 - square * sine * sine)
    meridian = axis * (1.0 - square) / (1.0 - square * sine * sine) ** 1.5
    return math.radians(1.0) * normal * math.cos(math.radians(latitude)), math.radians(1.0) * meridian


Steps = tuple[tuple[float, float], tuple[float, float], Place]


def _degrees(name: str, crs: Any, transform: Transform, x: float, y: float) -> Steps:
    a, b, _, d, e, _ = transform
    if b != 0.0 or d != 0.0:
        raise TerrainError(f"{name}: transform: a grid of degrees is turned; expected rows along parallels")
    if not (-90.0 < y < 90.0 and -180.0 <= x <= 360.0):
        raise TerrainError(f"{name}: transform: its centre is at longitude {x:g}, latitude {y:g}")
    east, north = _metres_a_degree(*_ellipsoid(name, crs), y)
    return (0.0, e * north), (a * east, 0.0), Place(y, x)


def _projected(name: str, crs: Any, transform: Transform, x: float, y: float) -> Steps:
    from rasterio.warp import transform as to

    _ellipsoid(name, crs)
    if not crs.is_projected:
        raise TerrainError(f"{name}: crs: expected a projected or a geographic one, got {crs.to_string()[:80]}")
    a, b, _, d, e, _ = transform
    try:
        metre = float(crs.linear_units_factor[1])
        probe = _PROBE / metre
        lon, lat = to(crs, "EPSG:4326", [x, x, x, x + probe, x - probe], [y, y + probe, y - probe, y, y])[:2]
    except Exception as error:  # what GDAL raises is of many kinds, not all of rasterio's
        raise TerrainError(f"{name}: crs: cannot be taken to latitude and longitude ({error})") from error
    if not all(math.isfinite(each) for each in (*lon, *lat)):
        raise TerrainError(f"{name}: crs: the centre, x {x:g}, y {y:g}, is nowhere on the Earth")
    place = Place(lat[0], lon[0])
    east, north = _metres_a_degree(*_WGS84, lat[0])

    def ground(k: int) -> tuple[float, float]:
        """East and north from probe k + 1 to probe k [m]."""
        turn = (lon[k] - lon[k + 1] + 180.0) % 360.0 - 180.0
        return turn * east / (2.0 * _PROBE), (lat[k] - lat[k + 1]) * north / (2.0 * _PROBE)

    up, right = ground(1), ground(3)
    scales = math.hypot(*up), math.hypot(*right)
    skew = abs(up[0] * right[0] + up[1] * right[1])
    if max(abs(scales[0] - 1.0), abs(scales[1] - 1.0), skew) > _SCALE:
        raise TerrainError(
            f"{name}: crs: a metre of it is {scales[1]:.3f} m on the ground along x and {scales[0]:.3f} m along y; "
            f"expected {1 - _SCALE} to {1 + _SCALE}, at a right angle: gdalwarp -t_srs {_utm(place)} IN OUT"
        )
    convergence = math.degrees(math.atan2(up[0], up[1]))
    place = Place(place.latitude, place.longitude, convergence)
    return (b * metre, e * metre), (a * metre, d * metre), place


def _utm(place: Place) -> str:
    zone = int(((place.longitude + 180.0) % 360.0) // 6.0) + 1
    return f"EPSG:{(32600 if place.latitude >= 0.0 else 32700) + zone}"
