# SPDX-License-Identifier: Apache-2.0
"""A binary space partition (Fuchs, Kedem, Naylor 1980: "On visible surface generation by a priori tree structures") of
the triangles: a reference for structures whose planes lie anyhow, decided in float64 throughout. Slow: a step of a ray
costs two planes' values, and building takes exact signs of three corners of every triangle at every level.

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
from shadow_tracer.gpu.accelerators.references import Lists
from shadow_tracer.gpu.accelerators.segment import scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.occluders.world import SceneBuffers

_REFERENCES_PER_TRIANGLE = 8
_NODES_PER_TRIANGLE = 2
_TRIANGLES_PER_CELL = 4  # of a level
_FEWEST = 64  # nodes, cells and references that a small scene may have


class BinarySpacePartition(Build):
    """The ``bsp`` pipeline."""

    walk = Walk("accelerators/bsp/halves.h", Structure)

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        bounds, device = scene.bounds, scene.device
        triangles = bounds.max_triangles
        self._lowers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._uppers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._lists = Lists(triangles, bounds.grid_entries, self._nodes_for(triangles), LEVELS, device)
        self._active = wp.zeros(LEVELS + 1, dtype=int, device=device)
        self._levels = [self._level(self._cells_for(triangles)) for _ in range(2)]
        self._tree = Structure()
        self._tree.nodes, self._tree.members = self._lists.nodes, self._lists.members
        self._tree.offsets = wp.zeros(self._nodes_for(triangles), dtype=wp.float64, device=device)

    @staticmethod
    def _nodes_for(triangles: int) -> int:
        """Room for nodes."""
        return _NODES_PER_TRIANGLE * triangles + _FEWEST

    @staticmethod
    def _cells_for(triangles: int) -> int:
        """Room for the cells of a level."""
        return triangles // _TRIANGLES_PER_CELL + _FEWEST

    def _level(self, cells: int) -> Level:
        device, level = self._scene.device, Level()
        level.cells = wp.zeros(cells, dtype=Cell, device=device)
        level.picked = wp.zeros(cells, dtype=wp.int64, device=device)
        level.sides = wp.zeros((cells, 4), dtype=int, device=device)
        return level

    def build(self) -> Structure:
        """Split the scene, level by level."""
        scene, device, tree, lists = self._scene, self._scene.device, self._tree, self._lists
        count, boxes = scene.triangle_count, [self._lowers, self._uppers]
        tree.vertices, tree.triangles = scene.vertices, scene.triangles
        for each in self._levels:
            each.room = self._cells_for(count)
        inputs = [0, count, scene_box(*scene.box()), scene.vertices, scene.triangles, *boxes]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        lists.begin(self._lowers, count, _REFERENCES_PER_TRIANGLE * count + _FEWEST)
        inputs = [lists.references, tree, lists.made, self._active, self._levels[0]]
        wp.launch(splitting.begin, dim=1, inputs=inputs, device=device)
        levels = min(LEVELS, int(16.0 + 2.0 * math.log2(count)))
        for level in range(levels):
            self._split(level, levels, count)
        lists.finish(levels, self._nodes_for(count))
        return tree

    def _split(self, level: int, levels: int, count: int) -> None:
        """Split the cells of a level."""
        device, lists, tree = self._scene.device, self._lists, self._tree
        here, there = self._levels[level % 2], self._levels[1 - level % 2]
        most = min(2**level, here.room)
        cells = min(int(self._active.numpy()[level]), most) if forms.wide(device) else most
        threads = lists.threads(level)
        wp.launch(splitting.begin_level, dim=1, inputs=[level, lists.references, self._active], device=device)
        wp.launch(splitting.pick, dim=threads, inputs=[level, lists.references, here], device=device)
        wp.launch(splitting.make_planes, dim=cells, inputs=[level, tree, self._active, here], device=device)
        inputs = [level, tree, lists.references, here]
        wp.launch(splitting.count_halves, dim=threads, inputs=inputs, device=device)
        inputs = [level, levels, self._nodes_for(count), lists.references, tree, lists.made, self._active, here, there]
        wp.launch(splitting.make_halves, dim=cells, inputs=inputs, device=device)
        wp.launch(splitting.pass_on, dim=threads, inputs=[level, tree, lists.references, here], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = [self._lowers, self._uppers, self._active, self._tree.offsets]
        for level in self._levels:
            arrays += [level.cells, level.picked, level.sides]
        return sum(int(array.capacity) for array in arrays) + self._lists.nbytes()
