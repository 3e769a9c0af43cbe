# SPDX-License-Identifier: Apache-2.0
"""A grid over the scene whose dense cells hold grids of their own, as may the dense cells of these (Jevans and Wyvill
1989: "Adaptive voxel subdivision for ray tracing"), each walked cell by cell (Amanatides and Woo 1987), with mailboxes.

The grid of the scene has about twice as many cells as there are triangles. A cell with more than eight triangles gets a
grid of about three cells for each, as near to cubes as may be, and so do the cells of that: three depths. A triangle is
a member of every cell without a grid that its padded box touches, if it touches the cells that this one lies in, too.
All grids are built again whenever the scene changes, depth by depth: triangles are counted by cell, dense cells are
found, grids are planned, their memberships, cells and numbers summed up, for the finest grids and, if these do not fit,
for coarser ones; those that fit are made. At last counts are scanned and numbers scattered. Where not even the coarsest
fit, there are none; the grid of the scene always fits, as it does in ``uniform_grid``. Which it is, is decided on the
device.

Why no triangle can be missed. In units of the scene's extent E, u = 2^-24. A grid has cells from low + i size to low +
(i + 1) size, exactly, low and size being what is stored. All memberships are computed in float64 from these and from
boxes padded by 32 u (``segment.py``), and cells at the border of a grid have what lies beyond as well. So it is enough
that, wherever the exact ray meets a triangle, the walk is in a cell that is closer than 32 u, and in one such cell of
each grid above it: the triangle is a member of all these. Let the ray be the one from the stored start along the stored
direction, which is within 5 u of the exact one, up to where that ends or leaves the box; ``longest`` is not before.

*Nothing of the ray is left out.* A walk through a grid knows ``now``, from where on, and ``until``; it is in one cell
between two steps, steps are made at numbers that do not decrease, and it ends when the next one is after ``until``, not
when it comes to the border. ``until`` is ``longest`` for the grid of the scene, otherwise the next step of the grid
above, from which the walk goes on there: the very number, which is kept. So the cells' parts of the ray join without
gaps. There is an end, as each step is to another cell in the same sense.

*A step is near its plane.* The plane between cells is stored low + i size, at most 1.0001: 2 u for the product, which
is up to 2.0002, and 1 u for the sum; the distance to it from the start, at most 2.0002, has three roundings of u
relative each (difference, reciprocal, product), 6.1 u in all: the ray is within 9.1 u of the plane at the step.

*The first cell.* In the grid of the scene ``now`` is 0 and adds nothing: the start is within 1.0001, and the cell's
number has three roundings (difference, ``per_unit``, product) of at most 2.0002 u each, 6.1 u. In another grid, the
point at ``now`` has a product of up to 2.0002 (2 u) and a sum (1 u), and then the same three: 9.1 u. A number beyond
the border becomes the nearest one; then the ray may be as far from that cell as it is from the grid.

*Grids and the cells that hold them.* A stored low is rounded from float64, 1 u; a stored size once, relative, which
the number of cells makes 2.1 u at most: a grid's sides are within 3.1 u of those of its cell.

Together, along each axis: while the walk is in a cell of the scene's grid, the ray is within 9.1 u of it, as it is at
both ends of that time. (Cells at the border have no plane on one side, but there the ray is within the box.) It is then
within 12.2 u of the grid in that cell; in a cell of that grid it is within 9.1 u of a side that it has come through or
will leave through, and within 12.2 u of one at the border: within 12.2 u. In a cell at the third depth it is within
15.3 u in the same way. With the 5 u of the ray that is 20.3 u, less than 32.

Cells within cells are 2^-16 wide at least, unless an axis has only one: narrower ones would tell triangles apart no
better, as each spans 64 u of padding.

A fourth depth was tried and left out. Of nodes and triangles per ray (8 members for each triangle, a light above) it
made no other in Sponza, the conference room and the bunny, 29.4 and 34.2 of 29.4 and 34.4 for the pot in a stadium of
71,000 triangles, whose cells are as narrow as they get, and 48.0 and 34.8 of 45.6 and 57.4 at 305,000: a fifth less in
the one scene that is made for it, for another place of each ray on CUDA and another loop in kernels that build. An
octree, which has sixteen levels, needs 40 triangles there.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.cells import LEVELS, ROWS, cells_along, count_memberships
from shadow_tracer.gpu.accelerators.hierarchical_grid import nesting
from shadow_tracer.gpu.accelerators.hierarchical_grid.nesting import DEPTHS, LEAVES, STEPS, Grid, Plan, Structure
from shadow_tracer.gpu.accelerators.segment import scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk
from shadow_tracer.gpu.occluders.world import SceneBuffers

_OUTER_CELLS_PER_TRIANGLE = 2  # in the grid of the scene
_CELLS_PER_TRIANGLE = 8  # in all grids
_MOST_CELLS = 2**24
_TRIANGLES_PER_GRID = 4
_FEWEST = 64  # cells and grids that a small scene may have


class HierarchicalGrid(Build):
    """The ``hierarchical_grid`` pipeline."""

    walk = Walk("accelerators/hierarchical_grid/nested_cells.h", Structure)

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        bounds, device = scene.bounds, scene.device
        triangles = bounds.max_triangles
        self._lowers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._uppers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._most_cells = self._cells_for(triangles)
        self._begins = wp.empty(self._most_cells + 1, dtype=int, device=device)
        self._needed = wp.zeros((int(ROWS), int(LEVELS)), dtype=wp.int64, device=device)
        self._plan = plan = Plan()
        plan.ends = wp.zeros(DEPTHS + 1, dtype=int, device=device)
        plan.made, plan.step = wp.zeros(1, dtype=int, device=device), wp.zeros(1, dtype=int, device=device)
        plan.total = wp.zeros(1, dtype=wp.int64, device=device)
        plan.needed = wp.zeros((int(ROWS), int(STEPS)), dtype=wp.int64, device=device)
        plan.cells = wp.zeros((int(ROWS), int(STEPS)), dtype=wp.int64, device=device)
        plan.grids = wp.zeros((int(ROWS), int(STEPS)), dtype=wp.int64, device=device)
        plan.dense = wp.zeros((int(ROWS), 1), dtype=wp.int64, device=device)
        self._tree = tree = Structure()
        tree.grids = wp.zeros(triangles // _TRIANGLES_PER_GRID + _FEWEST, dtype=Grid, device=device)
        tree.inside = wp.empty(self._most_cells, dtype=int, device=device)
        tree.start = wp.empty(self._most_cells + 1, dtype=int, device=device)
        tree.members = wp.empty(max(bounds.grid_entries, triangles), dtype=int, device=device)

    @staticmethod
    def _cells_for(triangles: int) -> int:
        """Room for cells of all grids together."""
        return min(_CELLS_PER_TRIANGLE * triangles + _FEWEST, _MOST_CELLS)

    def build(self) -> Structure:
        """Make the grids, and sort the triangles into their cells."""
        scene, device, tree = self._scene, self._scene.device, self._tree
        count = scene.triangle_count
        tree.box = scene_box(*scene.box())
        room, boxes = self._cells_for(count), [self._lowers, self._uppers]
        outer = wp.vec3i(*cells_along(np.array(tree.box.half), min(_OUTER_CELLS_PER_TRIANGLE * count, room)))
        begins, start = self._begins[: room + 1], tree.start[: room + 1]
        self._needed.zero_()
        begins.zero_()
        tree.inside[:room].zero_()
        inputs = [0, count, tree.box, scene.vertices, scene.triangles, *boxes]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        inputs = [tree.box, outer, *boxes, self._needed]
        wp.launch(count_memberships, dim=(int(LEVELS), count), inputs=inputs, device=device)
        inputs = [outer, wp.int64(tree.members.shape[0]), self._needed, self._plan, tree]
        wp.launch(nesting.begin, dim=1, inputs=inputs, device=device)
        wp.launch(nesting.enter_cells, dim=count, inputs=[*boxes, 0, begins, tree], device=device)
        for depth in range(1, DEPTHS):
            self._nest(depth, count, room)
        wp.utils.array_scan(begins, start, inclusive=False)
        wp.copy(begins, start)
        wp.launch(nesting.enter_cells, dim=count, inputs=[*boxes, int(LEAVES), begins, tree], device=device)
        return tree

    def _nest(self, depth: int, count: int, room: int) -> None:
        """Make the grids at a depth, in cells of those above it."""
        device, plan, tree = self._scene.device, self._plan, self._tree
        for sums in (plan.needed, plan.cells, plan.grids, plan.dense):
            sums.zero_()
        wp.launch(nesting.find_dense, dim=room, inputs=[depth, self._begins, plan, tree], device=device)
        boxes = [self._lowers, self._uppers]
        some = room * (depth + 1) // DEPTHS  # what lies deeper is to find room
        for first, last in ((0, 1), (1, 3), (3, int(STEPS))):  # coarser ones are counted where finer ones do not fit
            inputs = [*boxes, depth, first, plan, tree]
            wp.launch(nesting.count_needed, dim=(last - first, count), inputs=inputs, device=device)
            wp.launch(nesting.choose_step, dim=1, inputs=[depth, some, first, last, plan, tree], device=device)
        wp.launch(nesting.make_grids, dim=room, inputs=[depth, self._begins, plan, tree], device=device)
        wp.launch(nesting.enter_cells, dim=count, inputs=[*boxes, depth, self._begins, tree], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        tree, plan = self._tree, self._plan
        arrays = [self._lowers, self._uppers, self._begins, self._needed, plan.needed, plan.cells, plan.grids]
        arrays += [plan.dense, tree.grids, tree.inside, tree.start, tree.members]
        return sum(int(array.capacity) for array in arrays)
