# SPDX-License-Identifier: Apache-2.0
"""A tile of an elevation model under some suns: the pure function :func:`solve`.

The surface has a position at the centre of each cell, and between them triangles (``scene/surface.py``); what a cell is
asked about is the point ``above`` metres over its position. At 0 that is the position, which the triangles around it
touch and do not hide, and the ray is one of the exact test without any bias.

What is unknown. Heights that are missing, in the model and beyond it, are taken to lie between ``floor`` and
``ceiling``, the lowest and the highest that are known. Two surfaces have all of them at the one, or at the other;
heights in a triangle rise with those of its corners, so every surface that the model could be lies between them. A
point that the lower one hides is in shadow; one that the upper one alone hides is unknown; all others are lit. Two
rings of cells around the block stand for what is beyond: at the floor below, above at the ceiling and then at the
floor, or both at the floor where the side is the model's and nothing is beyond.

Points on the ground. A ray that begins at a position may go under a triangle that touches it, which does not hide it.
Then it meets the surface where it comes out again, at the latest where that falls to the floor of the outer ring, for
the ray is above that. So a point is hidden if and only if the surface is anywhere above its ray, which is the rule of
the horizon.

A block as large as ``plan.py`` makes it gives the same answers as the whole model: a ray is above the ceiling where it
leaves it.
"""

from __future__ import annotations

from collections.abc import Iterator
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
        floor, ceiling: the lowest and the highest known height of the model, after curvature [m].
        suns: when.
        unsure: (K,) whether a ray to this sun may leave the block below the ceiling.
        above: height of the points over the ground [m], at least 0.
    """

    grid: Grid
    block: tuple[slice, slice]
    heights: FloatArray
    answered: tuple[slice, slice]
    open_sides: tuple[bool, bool, bool, bool]
    floor: float
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
    facing = _Facing(tile, z, rows, columns)
    codes = np.full((len(tile.suns.stamps), *known.shape), Code.UNKNOWN, np.uint8)
    codes[:, known] = Code.TURNED_AWAY
    up = tile.suns.up()
    if up and known.any():
        tracer = tracer or tracer_for(ringed_cells(tile.block), int(known.size))
        points = np.stack([*tile.grid.plane(*tile.answered), z[rows, columns] + tile.above], axis=-1)[known]
        unsure = [k for k in up if tile.unsure[k] or np.isnan(z).any()]
        for k, dark in _hidden(tracer, _surface(tile, z, tile.floor), points, tile.suns, up):
            codes[k][known] = np.where(dark, Code.CAST_SHADOW, Code.LIT)
        for k, dark in _hidden(tracer, _surface(tile, z, tile.ceiling), points, tile.suns, unsure):
            found = codes[k][known]
            codes[k][known] = np.where(dark & (found == Code.LIT), Code.UNKNOWN, found)
        if tile.above == 0.0:
            for k in up:
                cosine = facing.cosine(k)
                codes[k][known & (cosine <= 0.0)] = Code.TURNED_AWAY
                codes[k][np.isnan(cosine)] = Code.UNKNOWN
    return _summed(tile.suns, codes, facing, known)


class _Facing:
    """What faces the suns: the slopes of a tile, or level planes over its ground."""

    def __init__(self, tile: Tile, z: FloatArray, rows: slice, columns: slice) -> None:
        self._towards = tile.suns.towards
        if tile.above > 0.0:
            level = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
            self._right, self._up = level, level
        else:
            self._right, self._up = (each[rows, columns] for each in slopes(tile.grid, z))
        self._length = np.sqrt(self._right * self._right + self._up * self._up + 1.0)

    def cosine(self, k: int) -> FloatArray:
        """(R, C) of the angle to a sun, NaN where there is no slope."""
        x, y, z = self._towards[k]
        return np.asarray((z - self._right * x - self._up * y) / self._length)


def _surface(tile: Tile, z: FloatArray, unknown: float) -> FloatArray:
    """(R, C, 3) positions of the block and its rings, with all heights that are missing at one height."""
    height = np.full([count + 2 * RINGS for count in z.shape], tile.floor)
    inner = slice(RINGS - 1, 1 - RINGS)
    north, south, west, east = (tile.floor if side else unknown for side in tile.open_sides)
    height[RINGS - 1, inner], height[-RINGS, inner] = north, south
    for column, value in ((RINGS - 1, west), (-RINGS, east)):
        height[inner, column] = np.maximum(height[inner, column], value)
    height[RINGS:-RINGS, RINGS:-RINGS] = np.where(np.isnan(z), unknown, z)
    rows, columns = (slice(part.start - RINGS, part.stop + RINGS) for part in tile.block)
    return np.stack([*tile.grid.plane(rows, columns), height], axis=-1)


def _hidden(
    tracer: ShadowTracer, surface: FloatArray, points: FloatArray, suns: Suns, which: list[int]
) -> Iterator[tuple[int, BoolArray]]:
    """Which points a surface hides from some suns, one after the other."""
    if which:
        tracer.scene.clear()
        tracer.scene.put_surface("terrain", surface)
    for k in which:
        yield k, tracer.occluded(points, DirectionalLight("sun", -suns.towards[k]))


def _summed(suns: Suns, codes: CodeArray, facing: _Facing, known: BoolArray) -> TileResult:
    """Sums over the times, one after the other."""
    lit, unknown, longest, exposure, dark = (np.where(known, 0.0, np.nan) for _ in range(5))
    for k, found in enumerate(codes):
        seconds = float(suns.seconds[k])
        reached = found == Code.LIT
        lit[reached] += seconds
        unknown[known & (found == Code.UNKNOWN)] += seconds
        dark = np.where(reached, 0.0, dark + seconds)
        np.maximum(longest, dark, out=longest)
        if reached.any():
            exposure[reached] += facing.cosine(k)[reached] * (float(suns.irradiance[k]) * seconds)
    return TileResult(codes, lit, unknown, np.where(known, longest, np.nan), exposure)
