# SPDX-License-Identifier: Apache-2.0
"""Equal cells in a box: their shape, and which of them a box touches; for grids over space."""

from __future__ import annotations

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.segment import OUTSIDE, SceneBox
from shadow_tracer.scene.checks import FloatArray

MOST_ALONG = 256  # an axis
LEVELS = wp.constant(9)  # 256 to 1 cells along an axis
ROWS = wp.constant(64)  # that threads spread their sums over


@wp.struct
class Shape:
    """Cells along each axis, the low corner of the first, their size, and how many there are per unit."""

    count: wp.vec3i
    low: wp.vec3
    size: wp.vec3
    per_unit: wp.vec3


@wp.struct
class Cells:
    """From the first to the last along each axis; none if a last one is before the first."""

    first: wp.vec3i
    last: wp.vec3i


@wp.func
def shape_of(box: SceneBox, finest: wp.vec3i, level: int) -> Shape:
    """The shape of a grid over the scene, with the cells along each axis halved ``level`` times."""
    shape = Shape()
    for k in range(3):
        shape.count[k] = wp.max(finest[k] >> level, 1)
        shape.low[k] = -float(box.half[k])
        shape.size[k] = 2.0 * float(box.half[k]) / float(shape.count[k])
        shape.per_unit[k] = 1.0 / shape.size[k]
    return shape


@wp.func
def cells_of(shape: Shape, lower: wp.vec3, upper: wp.vec3) -> Cells:
    """The cells that a box touches; none if it is one that holds nothing. Cells at the border reach to infinity."""
    cells = Cells()
    for k in range(3):
        low = wp.float64(shape.low[k])
        size = wp.float64(shape.size[k])
        last = wp.float64(shape.count[k] - 1)
        cells.first[k] = int(wp.clamp(wp.floor((wp.float64(lower[k]) - low) / size), wp.float64(0.0), last))
        cells.last[k] = int(wp.clamp(wp.floor((wp.float64(upper[k]) - low) / size), wp.float64(0.0), last))
    if lower[0] >= OUTSIDE:
        cells.last[0] = cells.first[0] - 1
    return cells


@wp.func
def number_of(cells: Cells) -> wp.int64:
    """How many they are."""
    count = wp.int64(1)
    for k in range(3):
        count *= wp.int64(cells.last[k] - cells.first[k] + 1)
    return count


@wp.func
def sum_of_rows(sums: wp.array2d(dtype=wp.int64), column: int) -> wp.int64:
    """What threads have added up."""
    total = wp.int64(0)
    for row in range(ROWS):
        total += sums[row, column]
    return total


@wp.kernel(enable_backward=False)
def count_memberships(
    box: SceneBox,
    finest: wp.vec3i,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    needed: wp.array2d(dtype=wp.int64),
):
    """How many there are at each level. One thread per level and triangle."""
    level, i = wp.tid()
    cells = cells_of(shape_of(box, finest, level), lowers[i], uppers[i])
    wp.atomic_add(needed, i & (ROWS - 1), level, number_of(cells))


@wp.func
def level_that_fits(needed: wp.array2d(dtype=wp.int64), capacity: wp.int64) -> int:
    """The finest one whose memberships fit, the last one if none does."""
    level = int(0)
    while level + 1 < LEVELS and sum_of_rows(needed, level) > capacity:
        level += 1
    return level


def cells_along(half: FloatArray, most: int) -> tuple[int, int, int]:
    """Cells along each axis of a box of this half size: as near to cubes as may be, at most ``most``."""
    low, high = 0.0, 4.0 * float(half.max())  # a size that makes too many of them, and one that does not
    for _ in range(60):
        size = 0.5 * (low + high)
        enough = np.clip(2.0 * half / max(size, 1e-300), 1, MOST_ALONG).astype(int).prod() > most
        low, high = (size, high) if enough else (low, size)
    x, y, z = (int(n) for n in np.clip(2.0 * half / max(high, 1e-300), 1, MOST_ALONG))
    return x, y, z
