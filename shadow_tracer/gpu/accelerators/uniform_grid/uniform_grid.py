# SPDX-License-Identifier: Apache-2.0
"""A grid of equal cells over the scene, walked cell by cell (Fujimoto, Tanaka, Iwata 1986: "ARTS: Accelerated
Ray-Tracing System"; Amanatides and Woo 1987: "A Fast Voxel Traversal Algorithm for Ray Tracing"), with mailboxes.

There are about twice as many cells as triangles. A triangle is a member of every cell that its padded box touches. It
is built again whenever the scene changes: triangles are counted by cell, counts are scanned, numbers are scattered. If
the list is too short for all memberships, the grid gets half as many cells along each axis, as often as it takes: with
one cell there are as many as triangles. Which it is, is decided on the device.

Why no triangle can be missed. In units of the scene's extent E, u = 2^-24: cell i of an axis lies between low + i size
and low + (i + 1) size, exactly; memberships are computed in float64 from boxes padded by 32 u (``segment.py``). A walk
computes where a ray leaves a cell from the cell's number: the plane within 3 u, its distance from the start, at most
2.0002, within 3 u relative, so that a ray is within 9.1 u of the cell it is said to be in when it leaves it, and after.
In the first cell it is within 6.1 u. Whatever the walk calls a cell is therefore a cell that the ray, which is within
5 u of the exact one, passes through or passes by closer than 15 u; a triangle that the exact ray meets there has that
cell among its own. A ray that has left the grid is farther than 40 u from all triangles. A walk ends in
a cell that the ray is said to leave behind its end, so it has been in whatever it calls the cell of a point before.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.cells import (
    LEVELS,
    ROWS,
    Shape,
    cells_along,
    cells_of,
    count_memberships,
    level_that_fits,
    shape_of,
)
from shadow_tracer.gpu.accelerators.segment import SceneBox, scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST

_CELLS_PER_TRIANGLE = 2
_MOST_CELLS = 2**22


@wp.struct
class Structure:
    """The grid: ``members[start[k]]`` to ``members[start[k + 1]]`` are the triangles of cell k."""

    box: SceneBox
    shape: wp.array(dtype=Shape)
    start: wp.array(dtype=int)
    members: wp.array(dtype=int)


@wp.kernel(enable_backward=False)
def choose_shape(
    box: SceneBox,
    finest: wp.vec3i,
    capacity: wp.int64,
    needed: wp.array2d(dtype=wp.int64),
    shape: wp.array(dtype=Shape),
):
    """The finest one whose memberships fit. One thread."""
    shape[0] = shape_of(box, finest, level_that_fits(needed, capacity))


@wp.kernel(enable_backward=False)
def enter_cells(
    shape: wp.array(dtype=Shape),
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    begins: wp.array(dtype=int),
    members: wp.array(dtype=int),
):
    """Count the triangles of each cell in ``begins``; with ``members``, store them from there on. One thread each."""
    i = wp.tid()
    cells = cells_of(shape[0], lowers[i], uppers[i])
    count = shape[0].count
    for z in range(cells.first[2], cells.last[2] + 1):
        for y in range(cells.first[1], cells.last[1] + 1):
            for x in range(cells.first[0], cells.last[0] + 1):
                at = wp.atomic_add(begins, (z * count[1] + y) * count[0] + x, 1)
                if members.shape[0] > 0:
                    members[at] = i


class UniformGrid(Build):
    """The ``uniform_grid`` pipeline."""

    walk = Walk("accelerators/uniform_grid/cells.h", Structure, queries=(ANY_HIT, CLOSEST))

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        bounds, device = scene.bounds, scene.device
        triangles = bounds.max_triangles
        self._lowers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._uppers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._most_cells = min(_CELLS_PER_TRIANGLE * triangles, _MOST_CELLS)
        self._needed = wp.zeros((int(ROWS), int(LEVELS)), dtype=wp.int64, device=device)
        self._begins = wp.empty(self._most_cells + 1, dtype=int, device=device)
        self._no_members = wp.empty(0, dtype=int, device=device)
        self._grid = Structure()
        self._grid.shape = wp.zeros(1, dtype=Shape, device=device)
        self._grid.start = wp.empty(self._most_cells + 1, dtype=int, device=device)
        self._grid.members = wp.empty(max(bounds.grid_entries, triangles), dtype=int, device=device)

    def build(self) -> Structure:
        """Sort the triangles into cells."""
        scene, device, grid = self._scene, self._scene.device, self._grid
        count = scene.triangle_count
        grid.box = scene_box(*scene.box())
        along = cells_along(np.array(grid.box.half), min(_CELLS_PER_TRIANGLE * count, self._most_cells))
        finest, boxes = wp.vec3i(*along), [self._lowers, self._uppers]
        used = int(np.prod(along)) + 1
        begins, start = self._begins[:used], grid.start[:used]
        self._needed.zero_()
        begins.zero_()
        inputs = [0, count, grid.box, scene.vertices, scene.triangles, *boxes]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        inputs = [grid.box, finest, *boxes, self._needed]
        wp.launch(count_memberships, dim=(int(LEVELS), count), inputs=inputs, device=device)
        capacity = wp.int64(grid.members.shape[0])
        wp.launch(choose_shape, dim=1, inputs=[grid.box, finest, capacity, self._needed, grid.shape], device=device)
        inputs = [grid.shape, *boxes, begins]
        wp.launch(enter_cells, dim=count, inputs=[*inputs, self._no_members], device=device)
        wp.utils.array_scan(begins, start, inclusive=False)
        wp.copy(begins, start)
        wp.launch(enter_cells, dim=count, inputs=[*inputs, grid.members], device=device)
        return grid

    def nbytes(self) -> int:
        """Bytes on the device."""
        grid = self._grid
        arrays = (self._lowers, self._uppers, self._needed, self._begins, grid.shape, grid.start, grid.members)
        return sum(int(array.capacity) for array in arrays)
