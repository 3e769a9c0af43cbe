# SPDX-License-Identifier: Apache-2.0
"""An octree over the triangles (Glassner 1984: "Space subdivision for fast ray tracing"), which rays walk through from
child to child by the planes through the middle of each cell (Revelles, Urena, Lastra 2000: "An efficient parametric
algorithm for octree traversal"), with mailboxes.

The root is a cube around the scene. A cell of more than eight triangles is split into eight equal ones, down to cells
of 2^-15 of the scene; a triangle is a member of every child that its padded box reaches into. Where nodes, cells of a
level or references would be more than there is room for, leaves are larger, and never wrong. What more than doubles the
references of a cell may take two thirds of the room: otherwise a crowd in one place, a teapot in a stadium, may find
none left when cells have become as small as it is, and stay in one leaf. The tree is built again whenever the scene
changes, all cells of a level at once (``references.py``).

Why no triangle can be missed. In units of the scene's extent E, u = 2^-24. Let h = 129/128 be half the size of the
root, which is more than the padded scene's. A plane through the middle of a cell at level k is an odd multiple of h
2^-k between -h and h, or 0: up to level 15 it has 24 bits at most, and both build and walk reach it by sums that are
such numbers, too. So it is the same float32 in both, without a rounding. Members are found by comparing it with the
stored boxes of triangles, which reach at least 32 u beyond these along each axis (``segment.py``).

*Nothing of the ray is left out.* The walk knows which part of the ray it is in, from ``now`` to ``until``. In a cell,
the ray meets each of the three planes at a number, the same one whenever it is computed. A child gets the part from
where the walk is up to the next plane that has not been crossed, or to the end of the cell's part; the next child is
the one behind that plane, from there on. So the children's parts join without gaps, in at most four steps. On its way
up from a leaf, the walk is at the end of the cell's part, which is where it goes on: at the next plane of the innermost
cell that has one.

*The part that a child gets is in it.* A plane counts as crossed from where it is met, and in the first child from
before: a point there is behind the plane or no more than 6.1 u before it, and one before the plane is met no more than
that behind it: the distance to the plane, less than 2.02, over the direction's component has roundings of 3.01 u
relative. The exact ray is within 5 u of the stored one: 11.1 u, along each axis. If it meets a triangle at the point,
the box reaches 32 u to either side of it, and so into the child. This is so at each cell that holds the point, each for
itself: nothing adds up with depth.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.octree import splitting
from shadow_tracer.gpu.accelerators.octree.splitting import LEVELS, Cell, Level, Structure
from shadow_tracer.gpu.accelerators.references import SplitTree
from shadow_tracer.gpu.accelerators.segment import SceneBox
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST


class Octree(SplitTree):
    """The ``octree`` pipeline."""

    walk = Walk("accelerators/octree/octants.h", Structure, queries=(ANY_HIT, CLOSEST))
    kind = Structure
    most_levels = LEVELS
    children = 8
    nodes_per_triangle, triangles_per_cell = 4, 4

    def level(self, cells: int) -> Level:
        """The cells of a level."""
        level = Level()
        level.cells, level.octants = self.array(cells, Cell), self.array((cells, 8), int)
        return level

    def begin(self, box: SceneBox, root: Level) -> None:
        """The box of the scene; the root is a cube around it."""
        self.tree.box = box
        wp.launch(splitting.begin, dim=1, inputs=[self.growth, root], device=self._scene.device)

    def split(self, level: int, cells: int, references: int, here: Level, there: Level) -> None:
        """Where a child has fewer triangles."""
        device, growth = self._scene.device, self.growth
        wp.launch(splitting.count_octants, dim=references, inputs=[level, growth, here], device=device)
        wp.launch(splitting.split_cells, dim=cells, inputs=[level, growth, here, there], device=device)
        wp.launch(splitting.pass_on, dim=references, inputs=[level, growth, here], device=device)
