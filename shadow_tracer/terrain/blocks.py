# SPDX-License-Identifier: Apache-2.0
"""A Dataset that is computed when it is looked at, tile by tile, by whichever scheduler of Dask is in use: the tiles of
a plan are the blocks of ``xarray.map_blocks``, and each reads what is around it."""

from __future__ import annotations

import importlib
import threading
from typing import Any

import numpy as np

from shadow_tracer.terrain.dataset import Gathered, dataset, layers_of, xarray
from shadow_tracer.terrain.plan import Plan, Read
from shadow_tracer.terrain.tile import Code, solve, tracer_for
from shadow_tracer.tracer import ShadowTracer

_ROW, _COLUMN = "_row", "_column"  # coordinates by which a block knows where it is


def lazy_dataset(
    plan: Plan, read: Read, coordinates: dict[str, Any], dims: tuple[str, str], device: str | None = None
) -> Any:
    """The Dataset of a plan, in chunks of a tile and all times.

    Args:
        plan: what is answered.
        read: gives the heights of some rows and columns; a function or method that can be sent to the workers.
        coordinates: variables of xarray for the two dimensions.
        dims: their names.
        device: as for :class:`ShadowTracer`.

    Raises:
        ImportError: xarray or Dask is not installed.
    """
    modules = xarray()
    try:
        lazy: Any = importlib.import_module("dask.array")
    except ImportError as error:
        raise ImportError("a lazy Dataset needs Dask: pip install 'shadow_tracer[fleet]'") from error
    empty = dataset(Gathered(plan, (0, 0)), plan, {}, dims)
    big = [name for name, each in empty.data_vars.items() if set(dims) <= set(each.dims)]
    shape, chunks = (plan.grid.rows, plan.grid.columns), _chunks(plan)
    times = len(plan.suns.stamps)
    made = {}
    for name in big:
        each = empty[name]
        extent, parts = ((times,), ((times,),)) if each.ndim == 3 else ((), ())
        cells = lazy.zeros((*extent, *shape), dtype=each.dtype, chunks=(*parts, *chunks))
        made[name] = (each.dims, cells, each.attrs)
    places = {_ROW: (dims[0], np.arange(shape[0])), _COLUMN: (dims[1], np.arange(shape[1]))}
    where = modules.DataArray(lazy.zeros(shape, dtype=np.uint8, chunks=chunks), dims=dims, coords=places)
    template = modules.Dataset(made, coords=places)
    found = modules.map_blocks(sun_of_block, where, kwargs={"plan": plan, "read": read, "device": device},
                               template=template)  # fmt: skip
    rest = empty.drop_vars(big)
    return rest.assign(found.drop_vars([_ROW, _COLUMN]).data_vars).assign_coords(coordinates)


def _chunks(plan: Plan) -> tuple[tuple[int, ...], ...]:
    """Edges of all tiles, down and to the right."""
    edges = []
    for axis in (0, 1):
        parts = sorted({(tile.answered[axis].start, tile.answered[axis].stop) for tile in plan.tiles})
        edges.append(tuple(stop - start for start, stop in parts))
    return tuple(edges)


def sun_of_block(block: Any, plan: Plan, read: Read, device: str | None = None) -> Any:
    """The part of the Dataset for a block of ``xarray.map_blocks``, which is a tile of a plan."""
    start = int(block[_ROW].values[0]), int(block[_COLUMN].values[0])
    number = next(k for k, tile in enumerate(plan.tiles) if tuple(part.start for part in tile.answered) == start)
    tile = plan.tile(number, read)
    with _turn:
        result = solve(tile, _tracers.get(plan.largest, device))
    dims = block.dims
    made: dict[str, Any] = {
        "sun_code": (("time", *dims), result.codes),
        "sunlit": (("time", *dims), (result.codes == Code.LIT).astype(np.uint8)),
    }
    for name, values in layers_of(result, plan.suns.daylight).items():
        made[name] = (dims, values.astype(np.float32))
    return xarray().Dataset(made, coords={name: block[name] for name in (_ROW, _COLUMN)})


class _Tracers:
    """The tracer that was used last; mostly the next block is of the same plan."""

    def __init__(self) -> None:
        self._known: tuple[object, ShadowTracer] | None = None

    def get(self, largest: tuple[int, int], device: str | None) -> ShadowTracer:
        """A tracer for a plan."""
        if self._known is None or self._known[0] != (largest, device):
            self._known = None  # its memory goes first
            self._known = (largest, device), tracer_for(*largest, device=device)
        return self._known[1]


_turn = threading.Lock()  # threads of one worker take turns
_tracers = _Tracers()
