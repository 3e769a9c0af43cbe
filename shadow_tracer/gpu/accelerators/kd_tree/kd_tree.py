# SPDX-License-Identifier: Apache-2.0
"""A k-d tree over the triangles (Bentley 1975), split where the surface area heuristic says that rays cost least
(MacDonald and Booth 1990: "Heuristics for ray tracing using space subdivision"), rays walk through it from cell to cell
(Havran 2000: "Heuristic Ray Shooting Algorithms"), with mailboxes.

A plane of a cell lies where the box around what triangles have in the cell begins or ends, so that empty space is cut
off, or at one of up to 31 places between; triangles are counted by these (Popov, Guenther, Seidel, Slusallek 2006:
"Experiences with streaming construction of SAH kd-trees"). A triangle is a member of every child that its padded box
reaches into. A cell is a leaf where no plane makes it cheaper, at 3 triangles, at level 8 + 1.3 log2(triangles), and
where nodes, cells of a level or references would be more than there is room for: then leaves are larger, and never
wrong. Nodes have 8 bytes. The tree is built again whenever the scene changes, all cells of a level at once
(``references.py``).

Why no triangle can be missed. In units of the scene's extent E, u = 2^-24. A triangle's box, stored as float32, reaches
at least 32 u beyond it along each axis (``segment.py``), and it is a member of the lower child if and only if the box
begins below the plane, of the upper one if it ends above: these compare stored numbers, and round nothing. The walk
knows which part of the ray it is in, from ``now`` to ``until``.

*Nothing of the ray is left out.* The root has all of it. A plane is met at a number ``at``, and the child that the ray
comes from gets the part up to there, the other one the part from there on, as far as these are not empty; together they
are what the node has, whatever ``at`` is. A node's part ends where the last leaf in it ends, and the first part that
waits begins there: by that alone ``now`` is known. The stack has a place for each level, and a node waits at each at
most.

*The part that a child gets is in it.* ``at`` is the distance of the plane, less than 2.0002, over the direction's
component: a difference, a reciprocal and a product, of 3.01 u relative together. So a point of the stored ray before
``at`` is no more than 6.1 u behind the plane, and one after it no more than that before the plane; the exact ray is
within 5 u of the stored one: 11.1 u. If that ray meets a triangle at the point, the box reaches 32 u to either side of
it, and so beyond the plane: the triangle is a member of that child. This is so at each node that the walk passes for
the point, each for itself: nothing adds up with depth.

*Cones* (Wiche and Kuri 2020: "Performance Evaluation of Acceleration Structures for Cone-Tracing Traversal") go through
by the distances of planes, nearer child first (``cone_walk.h``). Of the part of a cone that is in a node, from one
distance along the axis to another, the lower child gets where t (v - w) <= d and the upper one where t (v + w) >= d,
with d from the apex to the plane and w >= 0 as in ``cones.py``: half-lines of t, whichever way the mantle leans, so
that cones around an axis are no case for themselves. Triangles in several leaves are shown again where mailboxes have
forgotten them; lists keep them once. In float64, every difference, reciprocal and product is rounded by itself.

What matters of a triangle is its own box, padded by half as much as the stored one (``cone_hits.h``): there are 15
u for roundings of its six half-lines, which are less than 1 u. Let t be any distance at which they hold, as computed.
The whole scene's hold, too: it is a larger box, and all roundings are monotone. So do those of one child that has the
triangle wherever the node's hold. If one child alone has it, the stored box ends at the plane or before it, so the
plane's half-line holds where that of the box's side does. If both have it, suppose that neither holds. Where v - w and
v + w are above 0, d / (v - w) < t < d / (v + w), as computed; but 1 / (v - w) is not the lesser one, so d is below 0,
and t would be, too. Where both are below 0, it is the same with signs turned; and where v + w alone is above 0, t < d /
(v - w) needs d below 0, and t < d / (v + w) needs it above. So some leaf has the triangle and t. Nothing is padded for
that, and nothing adds up with depth. The distance in a list is such a t: what is left out behind the last one found,
or before the one after which is asked, leaves it in. Outcomes and lists are those of every triangle.
"""

from __future__ import annotations

import math

import warp as wp

from shadow_tracer.gpu.accelerators.cone_kernels import ConeKernels, cone_scene
from shadow_tracer.gpu.accelerators.kd_tree import splitting
from shadow_tracer.gpu.accelerators.kd_tree.splitting import LEVELS, MOST_BINS, Cell, Level, Structure
from shadow_tracer.gpu.accelerators.references import SplitTree
from shadow_tracer.gpu.accelerators.segment import SceneBox
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST

ConeScene = cone_scene(Structure)
_BINS = 8  # of a cell, where a level has many


class KdTree(SplitTree):
    """The ``kd_tree`` pipeline."""

    walk = Walk("accelerators/kd_tree/planes.h", Structure, queries=(ANY_HIT, CLOSEST))
    cones = ConeKernels("accelerators/kd_tree/cone_walk.h", ConeScene)
    kind = Structure
    most_levels = LEVELS
    nodes_per_triangle, triangles_per_cell = 3, 3

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        self._ends = self.array(6 * _BINS * self.cells_for(scene.bounds.max_triangles), int)

    def levels_for(self, triangles: int) -> int:
        """How many levels a tree may have."""
        return min(LEVELS, int(8.0 + 1.3 * math.log2(triangles)))

    def level(self, cells: int) -> Level:
        """The cells of a level."""
        level = Level()
        level.cells, level.sides = self.array(cells, Cell), self.array((cells, 2), int)
        level.lowers, level.uppers = self.array(cells, wp.vec3), self.array(cells, wp.vec3)
        return level

    def begin(self, box: SceneBox, root: Level) -> None:
        """The box of the scene."""
        self.tree.box = box
        self._ends[: 6 * _BINS * root.room].zero_()
        wp.launch(splitting.begin, dim=1, inputs=[self.growth, box, root], device=self._scene.device)

    def split(self, level: int, cells: int, references: int, here: Level, there: Level) -> None:
        """Where it makes rays cheaper."""
        device, growth = self._scene.device, self.growth
        bins = min(MOST_BINS, _BINS * here.room // min(2**level, here.room))
        inputs = [level, bins, growth, here, self._ends]
        wp.launch(splitting.count_bins, dim=references, inputs=inputs, device=device)
        wp.launch(splitting.choose_planes, dim=cells, inputs=inputs, device=device)
        wp.launch(splitting.count_sides, dim=references, inputs=[level, growth, here], device=device)
        wp.launch(splitting.split_cells, dim=cells, inputs=[level, growth, here, there], device=device)
        wp.launch(splitting.pass_on, dim=references, inputs=[level, growth, here, there], device=device)
