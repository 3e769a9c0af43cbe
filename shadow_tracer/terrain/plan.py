# SPDX-License-Identifier: Apache-2.0
"""How an elevation model is cut into tiles, and how much around each tile a sun needs.

A ray rises by tan(elevation) for each metre of its way. It begins no lower than the lowest point of its tile, and what
is above the highest height of the model hides nothing, so what may hide it lies within (highest - lowest) /
tan(elevation), towards the sun. A *block* is a tile with that much around it for all suns, as far as the model goes.
Where that is more cells than can be afforded, suns are left out, the lowest first; for these what lies beyond the block
is unknown (``tile.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.terrain.grid import Grid
from shadow_tracer.terrain.suns import Suns
from shadow_tracer.terrain.tile import Tile

FloatArray = npt.NDArray[np.float64]
Window = tuple[slice, slice]
Around = tuple[float, float, float, float]
Read = Callable[[Window], FloatArray]
"""(R, C) float64 heights of some rows and columns [m], NaN where there is none."""

_SPARE = 2  # cells, around what a sun needs: the cell that it ends in, and the neighbour that a slope needs
BYTES_A_CELL = 400
"""What a cell of a block costs at most, on the host and on the device together: positions twice, their checks, the
scene's copy, 56 bytes of the surface and 12 of a sun (``height_field.py``)."""
BYTES_A_SAMPLE = 400
"""What a cell of a tile costs at most besides, and two bytes for each time."""


@dataclass(frozen=True)
class Planned:
    """A tile before its heights are read: arguments of :class:`Tile`, and how many suns its block is too small for."""

    answered: Window
    block: Window
    open_sides: tuple[bool, bool, bool, bool]
    unsure: tuple[bool, ...]
    short: int


@dataclass(frozen=True)
class Plan:
    """All tiles of a model.

    Attributes:
        grid, suns, above: as in :class:`Tile`.
        floor, ceiling: the lowest and the highest known height, after curvature [m]; NaN where none is known.
        tiles: row by row.
    """

    grid: Grid
    suns: Suns
    above: float
    floor: float
    ceiling: float
    tiles: tuple[Planned, ...]

    @property
    def short(self) -> int:
        """At how many suns, at most, the block of a tile is too small."""
        return max((tile.short for tile in self.tiles), default=0)

    def tile(self, number: int, read: Read) -> Tile:
        """A tile with its heights."""
        which = self.tiles[number]
        ground = self.floor, self.ceiling
        heights, sides = read(which.block), which.open_sides
        return Tile(
            self.grid, which.block, heights, which.answered, sides, *ground, self.suns, which.unsure, self.above
        )

    @property
    def largest(self) -> tuple[int, int]:
        """Cells of the largest block, rings among them, and of the largest tile."""
        from shadow_tracer.terrain.tile import ringed_cells

        blocks = [ringed_cells(tile.block) for tile in self.tiles]
        return max(blocks), max(_count(tile.answered) for tile in self.tiles)


def windows(rows: int, columns: int, size: int) -> Iterator[Window]:
    """Tiles of at most ``size`` x ``size`` cells, row by row."""
    for row in range(0, rows, size):
        for column in range(0, columns, size):
            yield slice(row, min(row + size, rows)), slice(column, min(column + size, columns))


def make_plan(
    grid: Grid,
    suns: Suns,
    read: Read,
    size: int = 1024,
    memory: float = 2e9,
    above: float = 0.0,
    beyond: str = "unknown",
) -> Plan:
    """Cut a model into tiles; its heights are read once, tile by tile.

    Args:
        grid: of the whole model, checked.
        suns: when.
        read: gives the heights of some rows and columns.
        size: cells of a tile along an edge.
        memory: what a tile may take [bytes]; blocks are as large as that allows.
        above: height of the points over the ground [m].
        beyond: what is beyond the model, "unknown" (up to its highest height) or "nothing".

    Raises:
        ValueError: ``memory`` is too small for a tile; the message says how much is needed.
    """
    tiles = list(windows(grid.rows, grid.columns, size))
    samples = min(size, grid.rows) * min(size, grid.columns) * (BYTES_A_SAMPLE + 2 * len(suns.stamps))
    most = int((memory - samples) / BYTES_A_CELL)
    least = max(_count(_grown(grid, tile, (-_SPARE, _SPARE, -_SPARE, _SPARE))) for tile in tiles)
    if most < least:
        needed = BYTES_A_CELL * least + samples
        raise ValueError(
            f"memory: expected at least {needed / 1e9:.2g} GB for tiles of {size} x {size} cells and "
            f"{len(suns.stamps)} times, got {memory / 1e9:.2g} GB; smaller tiles need less"
        )
    lowest, highest = [], -math.inf
    for tile in tiles:
        z = read(tile) - grid.drop(*tile)
        known = z[~np.isnan(z)]
        lowest.append(float(known.min()) if known.size else math.nan)
        highest = max(highest, float(known.max())) if known.size else highest
    some = math.isfinite(highest)
    floor, ceiling = (float(np.nanmin(lowest)), highest) if some else (math.nan, math.nan)
    planned = [
        _planned(grid, suns, tile, ceiling - low - above, most, beyond == "nothing")
        for tile, low in zip(tiles, lowest, strict=True)
    ]
    return Plan(grid, suns, above, floor, ceiling, tuple(planned))


def _planned(grid: Grid, suns: Suns, tile: Window, relief: float, most: int, nothing: bool) -> Planned:
    """A tile, its block, and which rays may leave that."""
    needs = {k: _need(grid, suns, k, relief) for k in suns.up()}
    around: Around = (-_SPARE, _SPARE, -_SPARE, _SPARE)
    short = 0
    for k in sorted(needs, key=lambda k: -suns.elevation[k]):
        a, b = around, needs[k]
        wider = min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])
        if short or _count(_grown(grid, tile, wider)) > most:
            short += 1
        else:
            around = wider
    block = _grown(grid, tile, around)
    ends = (block[0].start == 0, block[0].stop == grid.rows, block[1].start == 0, block[1].stop == grid.columns)
    open_sides = (ends[0] and nothing, ends[1] and nothing, ends[2] and nothing, ends[3] and nothing)
    unsure = tuple(k in needs and _leaves(tile, block, needs[k], open_sides) for k in range(len(suns.stamps)))
    return Planned(tile, block, open_sides, unsure, short)


def _need(grid: Grid, suns: Suns, k: int, relief: float) -> Around:
    """Rows before and behind a tile, columns before and behind it, that may hide its cells from a sun."""
    if not relief > 0.0:  # NaN: no cell has a height
        return -_SPARE, _SPARE, -_SPARE, _SPARE
    x, y, up = (float(part) for part in suns.towards[k])
    rows, columns = grid.cells((x, y), relief / up)
    return min(rows, 0.0) - _SPARE, max(rows, 0.0) + _SPARE, min(columns, 0.0) - _SPARE, max(columns, 0.0) + _SPARE


def _grown(grid: Grid, tile: Window, around: Around) -> Window:
    """A tile with so many rows and columns around, as far as the model goes."""
    parts = []
    for part, before, behind, count in zip(tile, around[::2], around[1::2], (grid.rows, grid.columns), strict=True):
        first = max(float(part.start) + before, 0.0)
        last = min(float(part.stop) + behind, float(count))
        parts.append(slice(math.floor(first), math.ceil(last)))
    return parts[0], parts[1]


def _leaves(tile: Window, block: Window, need: Around, open_sides: tuple[bool, ...]) -> bool:
    """Whether what may hide a tile reaches beyond a side of its block that is not open."""
    for k, (part, whole) in enumerate(zip(tile, block, strict=True)):
        before, behind = part.start + need[2 * k] < whole.start, part.stop + need[2 * k + 1] > whole.stop
        if (before and not open_sides[2 * k]) or (behind and not open_sides[2 * k + 1]):
            return True
    return False


def _count(window: Window) -> int:
    rows, columns = (part.stop - part.start for part in window)
    return int(rows * columns)
