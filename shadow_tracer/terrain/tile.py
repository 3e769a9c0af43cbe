# SPDX-License-Identifier: Apache-2.0
"""A tile of an elevation model under some suns: the pure function :func:`solve`.

The surface has a position at the centre of each cell, and between them triangles (``scene/surface.py``); what a cell is
asked about is the point ``above`` metres over its position. At 0 that is the position, which the triangles around it
touch and do not hide, and the ray is one of the exact test without any bias.

What is unknown. Cells without a height, and what lies beyond the block that a tile is given, cast nothing that is
known; they could be as high as ``ceiling``, the highest known height, but are taken to be no higher. A second surface
has that height in all of them: at holes, and on a ring of cells around the block. It is above every surface that the
model could be, as heights in a triangle rise with those of its corners. A second ring, below everything, closes it, so
that a ray which goes under it, begun at a position beside a hole, meets it on its way out. A point that this surface
hides and the known one does not is unknown. Where the block's side is the model's, and nothing is ``beyond``, there is
no ring.

So a block as large as ``plan.py`` makes it gives the same answers as the whole model: a ray is above the ceiling where
it leaves it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.lights import DirectionalLight
from shadow_tracer.terrain.grid import Grid, slopes
from shadow_tracer.terrain.suns import Suns
from shadow_tracer.tracer import ShadowTracer

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
CodeArray = npt.NDArray[np.uint8]

RINGS = 2
_BELOW = 1.0  # the outer ring, under everything [m]


class Code(IntEnum):
    """What the sun is to a cell at a time (the first four numbers are those of HORAYZON)."""

    LIT = 0
    TURNED_AWAY = 1
    """The slope faces away from the sun, or the sun is below the horizon."""
    CAST_SHADOW = 2
    UNKNOWN = 3
    """No height, no slope, or what is not known could hide the sun."""


@dataclass(frozen=True)
class Tile:
    """All that the answer for a tile depends on.

    Attributes:
        grid: of the whole model.
        block: rows and columns of the model that heights are given of.
        heights: (R, C) of the block [m], NaN where there is none.
        answered: rows and columns of the model that are asked about, within the block.
        open_sides: of the block, north (first row), south, west (first column), east: whether nothing is beyond.
        ceiling: what unknown heights do not exceed, after curvature [m].
        suns: when.
        unsure: (K,) whether a ray to this sun may leave the block below the ceiling.
        above: height of the points over the ground [m], at least 0.
    """

    grid: Grid
    block: tuple[slice, slice]
    heights: FloatArray
    answered: tuple[slice, slice]
    open_sides: tuple[bool, bool, bool, bool]
    ceiling: float
    suns: Suns
    unsure: tuple[bool, ...]
    above: float = 0.0


@dataclass(frozen=True)
class TileResult:
    """What :func:`solve` found of R x C cells at K times; where a cell has no height, sums are NaN.

    Attributes:
        codes: (K, R, C) values of :class:`Code`.
        lit: (R, C) for how long the sun reaches [s].
        unknown: (R, C) for how long it is not known [s].
        darkness: (R, C) the longest time on end that is not known to be lit [s], nights among it.
        exposure: (R, C) direct radiant exposure of the slope, or of a level plane ``above`` the ground [J/m2].
    """

    codes: CodeArray
    lit: FloatArray
    unknown: FloatArray
    darkness: FloatArray
    exposure: FloatArray


def bounds_for(cells: int, answered: int) -> Bounds:
    """Of a tracer for blocks of this many cells, rings among them, and tiles of that many."""
    return Bounds(
        max_triangles=max(2 * cells, 64), max_rays=max(answered, 64), max_lights=1, queue_capacity=65_536,
        grid_entries=1024,
    )  # fmt: skip


def tracer_for(cells: int, answered: int, device: str | None = None, threads: int | None = None) -> ShadowTracer:
    """A tracer for blocks of this many cells, rings among them, and tiles of that many.

    Raises:
        ImportError, ValueError: as :class:`ShadowTracer`.
    """
    return ShadowTracer("height_field", device=device, bounds=bounds_for(cells, answered), threads=threads)


def ringed_cells(block: tuple[slice, slice]) -> int:
    """Cells of a block with its rings."""
    rows, columns = (part.stop - part.start + 2 * RINGS for part in block)
    return int(rows * columns)


def solve(tile: Tile, tracer: ShadowTracer | None = None) -> TileResult:
    """The sun in a tile. The result depends on the tile alone, to the bit; the tracer is what it is computed with.

    Args:
        tile: heights, suns and all the rest.
        tracer: its scene is replaced; None makes one.

    Raises:
        BoundsError: the tracer is too small.
    """
    rows, columns = (slice(a.start - b.start, a.stop - b.start) for a, b in zip(tile.answered, tile.block, strict=True))
    z = tile.heights - tile.grid.drop(*tile.block)
    known = ~np.isnan(z[rows, columns])
    facing = _cosines(tile, z, rows, columns)
    codes = np.full((len(tile.suns.stamps), *known.shape), Code.UNKNOWN, np.uint8)
    codes[:, known] = Code.TURNED_AWAY
    up = tile.suns.up()
    if up and known.any():
        answered = int(known.size)
        tracer = tracer or tracer_for(ringed_cells(tile.block), answered)
        points = np.stack([*tile.grid.plane(*tile.answered), z[rows, columns] + tile.above], axis=-1)[known]
        hidden = _hidden(tracer, _ground(tile, z), points, [tile.suns.towards[k] for k in up])
        unsure = [k for k in up if tile.unsure[k] or np.isnan(z).any()]
        covered = dict(zip(unsure, _hidden(
            tracer, _filled(tile, z), points, [tile.suns.towards[k] for k in unsure]), strict=True)
        )  # fmt: skip
        for k, dark in zip(up, hidden, strict=True):
            found = np.where(dark, Code.CAST_SHADOW, Code.LIT).astype(np.uint8)
            if k in covered:
                found[~dark & covered[k]] = Code.UNKNOWN
            codes[k][known] = found
            if tile.above == 0.0:
                cosine = facing[k]
                codes[k][known & (cosine <= 0.0)] = Code.TURNED_AWAY
                codes[k][np.isnan(cosine)] = Code.UNKNOWN
    return _summed(tile.suns, codes, facing, known)


def _cosines(tile: Tile, z: FloatArray, rows: slice, columns: slice) -> dict[int, FloatArray]:
    """Of each sun that is up, of the angle between it and what faces it: slopes, or level planes over the ground."""
    towards = tile.suns.towards
    if tile.above > 0.0:
        shape = z[rows, columns].shape
        return {k: np.full(shape, towards[k, 2]) for k in tile.suns.up()}
    right, up = (each[rows, columns] for each in slopes(tile.grid, z))
    length = np.sqrt(right * right + up * up + 1.0)
    return {k: (towards[k, 2] - right * towards[k, 0] - up * towards[k, 1]) / length for k in tile.suns.up()}


def _ground(tile: Tile, z: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Positions of what is known, and where."""
    return np.stack([*tile.grid.plane(*tile.block), z], axis=-1), ~np.isnan(z)


def _filled(tile: Tile, z: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Positions of the highest that the model could be, and which of them there are."""
    north, south, west, east = (0 if side else RINGS for side in tile.open_sides)
    height = np.where(np.isnan(z), tile.ceiling, z)
    for ring in (tile.ceiling, float(np.min(height, initial=tile.ceiling)) - _BELOW):
        sides = [(int(north > 0), int(south > 0)), (int(west > 0), int(east > 0))]
        height = np.pad(height, sides, constant_values=ring)
    rows, columns = tile.block
    rows = slice(rows.start - north, rows.stop + south)
    columns = slice(columns.start - west, columns.stop + east)
    return np.stack([*tile.grid.plane(rows, columns), height], axis=-1), np.ones(height.shape, np.bool_)


def _hidden(
    tracer: ShadowTracer, surface: tuple[FloatArray, BoolArray], points: FloatArray, suns: list[FloatArray]
) -> list[BoolArray]:
    """Which points a surface hides from each sun."""
    if not suns:
        return []
    positions, valid = surface
    tracer.scene.clear()
    if min(positions.shape[:2]) > 1:
        tracer.scene.put_surface("terrain", positions, valid)
    return [tracer.occluded(points, DirectionalLight("sun", -towards)) for towards in suns]


def _summed(suns: Suns, codes: CodeArray, facing: dict[int, FloatArray], known: BoolArray) -> TileResult:
    """Sums over the times, one after the other."""
    lit, unknown, longest, exposure, dark = (np.where(known, 0.0, np.nan) for _ in range(5))
    for k, found in enumerate(codes):
        seconds = float(suns.seconds[k])
        reached = found == Code.LIT
        lit[reached] += seconds
        unknown[known & (found == Code.UNKNOWN)] += seconds
        dark = np.where(reached, 0.0, dark + seconds)
        np.maximum(longest, dark, out=longest)
        if k in facing:
            exposure[reached] += facing[k][reached] * (float(suns.irradiance[k]) * seconds)
    return TileResult(codes, lit, unknown, np.where(known, longest, np.nan), exposure)
