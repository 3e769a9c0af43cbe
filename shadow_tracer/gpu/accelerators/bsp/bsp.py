# SPDX-License-Identifier: Apache-2.0
"""A binary space partition (Fuchs, Kedem, Naylor 1980: "On visible surface generation by a priori tree structures") of
the triangles: a reference for structures with planes of any direction, decided in float64 throughout. Slow: a step of a
ray costs two planes' values, and building takes exact signs of three corners of every triangle at every level.

A cell of more than eight triangles is cut by the plane through a random one of them, or by the plane through a corner
of that across an axis, each in turn: by the one that leaves fewer pairs of triangles together, if these are less than
0.95 of all; otherwise another triangle is tried at the next level. A triangle that both halves hold something of is in
both, whole. Where nodes, cells of a level or references would be more than there is room for, leaves are larger, and
never wrong. The tree is built again whenever the scene changes, all cells of a level at once (``references.py``).

Why no triangle can be missed. A plane's value at a point x is det[x - o, r - o, s - o] with the corners o, r, s of its
triangle, or x_k - c; both as real numbers, of the float64 that are given. A triangle is in the upper half if and only
if a corner has a value above 0, and in the lower half if one has a value below 0, or none is above: its sides are exact
(``exact/determinant.py``). Let the ray, from the sample p to the light l, meet a triangle of a node at the point x. If
the value of x is above 0, so is that of a corner; if it is below 0, likewise: the triangle is in the half that x is in.
If it is 0, the triangle is in one half at least, and x belongs to both. So it is enough that the walk goes into each
half whose closed side has a point of the part of the ray that is in the node.

The value along the ray is (1 - s) A + s B for s from 0 to 1, A and B at sample and light. For a light at infinity, in
direction d, B is the slope, and the value times 1 - s is that, at the point p + s/(1 - s) d. With u = 2^-53,
``Walk1::values`` computes a and b within 8 u of the sum of the magnitudes of their terms: differences of 1 u in all
three factors, two products, three sums; PAD is more than ten times that. So (1 - s)(a - off) + s (b - off') is not
above the value, and where it is above 0 there is nothing of the lower half; (1 - s)(-a - off) + s (-b - off') in the
same way for the upper one. Where these are 0 is computed by a difference and a quotient, 2 u relative of a number that
is not below 0, and moved outwards by PAD. So a half's part of the ray holds each of its points; this is so at each node
for itself, and nothing adds up with depth.

There is no unit and no box: samples and lights may be anywhere within the range of the exact decision.
"""

from __future__ import annotations

import math

import warp as wp

from shadow_tracer.gpu.accelerators.bsp import splitting
from shadow_tracer.gpu.accelerators.bsp.splitting import LEVELS, Cell, Level, Structure
from shadow_tracer.gpu.accelerators.references import SplitTree
from shadow_tracer.gpu.accelerators.segment import SceneBox
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.occluders.world import SceneBuffers


class BinarySpacePartition(SplitTree):
    """The ``bsp`` pipeline."""

    walk = Walk("accelerators/bsp/halves.h", Structure)
    kind = Structure
    most_levels = LEVELS
    nodes_per_triangle, triangles_per_cell = 2, 4

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        self.tree.offsets = self.array(self.nodes_for(scene.bounds.max_triangles), wp.float64)

    def levels_for(self, triangles: int) -> int:
        """How many levels a tree may have."""
        return min(LEVELS, int(16.0 + 2.0 * math.log2(triangles)))

    def level(self, cells: int) -> Level:
        """The cells of a level."""
        level = Level()
        level.cells, level.picked = self.array(cells, Cell), self.array(cells, wp.int64)
        level.sides = self.array((cells, 4), int)
        return level

    def begin(self, box: SceneBox, root: Level) -> None:
        """The triangles of the scene, whose planes the tree has."""
        self.tree.vertices, self.tree.triangles = self._scene.vertices, self._scene.triangles
        wp.launch(splitting.begin, dim=1, inputs=[self.growth, root], device=self._scene.device)

    def split(self, level: int, cells: int, references: int, here: Level, there: Level) -> None:
        """Where it helps."""
        device, growth, tree = self._scene.device, self.growth, self.tree
        wp.launch(splitting.pick, dim=references, inputs=[level, growth, here], device=device)
        wp.launch(splitting.make_planes, dim=cells, inputs=[level, tree, growth, here], device=device)
        wp.launch(splitting.count_halves, dim=references, inputs=[level, tree, growth, here], device=device)
        wp.launch(splitting.split_cells, dim=cells, inputs=[level, tree, growth, here, there], device=device)
        wp.launch(splitting.pass_on, dim=references, inputs=[level, tree, growth, here], device=device)
