# SPDX-License-Identifier: Apache-2.0
"""The sun on terrain, from Python."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from shadow_tracer.scene.checks import finite
from shadow_tracer.scene.surface import HeightField
from shadow_tracer.terrain.blocks import lazy_dataset
from shadow_tracer.terrain.dataset import Gathered, dataset, xarray
from shadow_tracer.terrain.grid import Grid
from shadow_tracer.terrain.plan import Plan, Read, make_plan
from shadow_tracer.terrain.suns import SOLAR_CONSTANT, Place, suns
from shadow_tracer.terrain.tile import solve, tracer_for

BEYOND = ("unknown", "nothing")


def sunlight(
    height_field: HeightField,
    times: Iterable[Any],
    place: Place,
    *,
    above: float = 0.0,
    interval: float | None = None,
    irradiance: Any = SOLAR_CONSTANT,
    beyond: str = "unknown",
    curvature: bool = False,
    tile: int = 1024,
    memory: float = 2e9,
    device: str | None = None,
    lazy: bool = False,
) -> Any:
    """When and how long the sun reaches each cell of a terrain, exactly.

    Args:
        height_field: heights at the centres of cells, x along grid east and y along grid north.
        times: rising; datetimes or texts in ISO 8601 (without a zone they are UTC), numpy's datetime64, or nanoseconds
            since 1970 UTC.
        place: where the centre of the terrain is, and where grid north points.
        above: height of the points that are asked about over the ground [m]. At 0 it is the ground with its slope;
            above that a level plane, which has no slope that could be turned away.
        interval: for how long each time stands [s], centred on it; None is to half way to the times beside it.
        irradiance: direct, at a right angle to the rays [W/m2]: one number, or one for each time, of pvlib's clear sky
            for example. The default is the solar constant, without an atmosphere.
        beyond: what is beyond the terrain: "unknown", up to its highest height, or "nothing".
        curvature: lower heights by d^2 / 2R, for terrain of more than 10 km around its centre.
        tile, memory: cells of a tile along an edge, and what one may take [bytes].
        device: as for :class:`ShadowTracer`.
        lazy: cells are computed when they are looked at, tile by tile, by Dask (``xarray.map_blocks``); else now.

    Returns:
        An xarray.Dataset: ``sun_code`` (0 lit, 1 turned away, 2 cast shadow, 3 unknown) and ``sunlit`` for each time;
        ``sunshine_duration``, ``unknown_duration``, ``longest_darkness`` [s], ``sunlit_fraction``, ``direct_exposure``
        [J m-2]; where the sun stands. What is unknown counts as not lit. Dimensions are time, y and x, or time, row and
        column with x and y for each cell where rows and columns do not go along the axes. Its attribute
        ``suns_beyond_memory`` counts times for which ``memory`` was too small to look far enough: more is unknown then.

    Raises:
        ValueError: an argument is malformed, or the terrain is too large to be flat; the message names it.
        ImportError: xarray, ephem or Warp is not installed, or Dask for ``lazy``.
    """
    xarray()
    if not isinstance(height_field, HeightField):
        raise ValueError(f"height_field: expected a HeightField, got {type(height_field).__name__}")
    if not isinstance(place, Place):
        raise ValueError(f"place: expected a Place, got {type(place).__name__}")
    check_options(above, beyond, tile, memory)
    grid = Grid.of(height_field, curvature).checked()

    read = height_field.z.__getitem__
    plan = make_plan(grid, suns(times, place, interval, irradiance), read, tile, memory, above, beyond)
    made = lazy_dataset if lazy else _now
    return made(plan, read, *_coordinates(height_field), device).assign_attrs(suns_beyond_memory=plan.short)


def _now(plan: Plan, read: Read, coordinates: dict[str, Any], dims: tuple[str, str], device: str | None) -> Any:
    """The Dataset of a plan."""
    gathered = Gathered(plan)
    tracer = tracer_for(*plan.largest, device=device)
    for number, which in enumerate(plan.tiles):
        gathered.put(which.answered, solve(plan.tile(number, read), tracer))
    return dataset(gathered, plan, coordinates, dims)


def check_options(above: float, beyond: str, tile: int, memory: float) -> None:
    """Raises:
    ValueError: one of them is malformed.
    """
    if finite(above, "above") < 0.0:
        raise ValueError(f"above: expected at least 0 m, got {above!r}")
    if beyond not in BEYOND:
        raise ValueError(f"beyond: expected one of {', '.join(BEYOND)}, got {beyond!r}")
    if isinstance(tile, bool) or not isinstance(tile, (int, np.integer)) or not 16 <= tile <= 16_384:
        raise ValueError(f"tile: expected an integer from 16 to 16384, got {tile!r}")
    finite(memory, "memory")  # how much is enough depends on the model, see make_plan


def _coordinates(field: HeightField) -> tuple[dict[str, Any], tuple[str, str]]:
    """Variables of xarray for x and y, and the names of the dimensions."""
    rows, columns = field.shape
    down = [np.arange(rows) * field.resolution[0] * part for part in field.axes[0]]
    right = [np.arange(columns) * field.resolution[1] * part for part in field.axes[1]]
    meta = {
        k: {"standard_name": f"projection_{k}_coordinate", "units": "m", "comment": "of centres of cells"}
        for k in ("x", "y")
    }
    if field.axes[0, 0] == 0.0 and field.axes[1, 1] == 0.0:
        x, y = field.origin[0] + right[0], field.origin[1] + down[1]
        return {"y": ("y", y, meta["y"]), "x": ("x", x, meta["x"])}, ("y", "x")
    x, y = (field.origin[k] + down[k][:, None] + right[k] for k in (0, 1))
    dims = ("row", "column")
    return {"y": (dims, y, meta["y"]), "x": (dims, x, meta["x"])}, dims
