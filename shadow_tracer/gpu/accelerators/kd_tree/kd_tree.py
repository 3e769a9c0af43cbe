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
"""

from __future__ import annotations

import math

import warp as wp

from shadow_tracer.gpu.accelerators.kd_tree import splitting
from shadow_tracer.gpu.accelerators.kd_tree.splitting import LEVELS, MOST_BINS, Cell, Level, Structure
from shadow_tracer.gpu.accelerators.references import Lists
from shadow_tracer.gpu.accelerators.segment import scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST

_REFERENCES_PER_TRIANGLE = 8
_NODES_PER_TRIANGLE = 3
_TRIANGLES_PER_CELL = 3  # of a level
_FEWEST = 64  # nodes, cells and references that a small scene may have
_BINS = 8  # of a cell, where a level has many


class KdTree(Build):
    """The ``kd_tree`` pipeline."""

    walk = Walk("accelerators/kd_tree/planes.h", Structure, queries=(ANY_HIT, CLOSEST))

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        bounds, device = scene.bounds, scene.device
        triangles = bounds.max_triangles
        self._lowers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._uppers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._lists = Lists(triangles, bounds.grid_entries, self._nodes_for(triangles), LEVELS, device)
        self._active = wp.zeros(LEVELS + 1, dtype=int, device=device)
        self._bins = wp.empty(6 * _BINS * self._cells_for(triangles), dtype=int, device=device)
        self._levels = [self._level(self._cells_for(triangles)) for _ in range(2)]
        self._tree = Structure()
        self._tree.nodes, self._tree.members = self._lists.nodes, self._lists.members

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
        level.bins, level.cells = self._bins, wp.zeros(cells, dtype=Cell, device=device)
        level.lowers = wp.empty(cells, dtype=wp.vec3, device=device)
        level.uppers = wp.empty(cells, dtype=wp.vec3, device=device)
        level.sides = wp.zeros((cells, 2), dtype=int, device=device)
        return level

    def build(self) -> Structure:
        """Split the scene, level by level."""
        scene, device, tree, lists = self._scene, self._scene.device, self._tree, self._lists
        count, boxes = scene.triangle_count, [self._lowers, self._uppers]
        tree.box = scene_box(*scene.box())
        inputs = [0, count, tree.box, scene.vertices, scene.triangles, *boxes]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        lists.begin(self._lowers, count, _REFERENCES_PER_TRIANGLE * count + _FEWEST)
        self._bins[: 6 * _BINS * self._cells_for(count)].zero_()
        inputs = [lists.references, tree, lists.made, self._active, self._levels[0]]
        wp.launch(splitting.begin, dim=1, inputs=inputs, device=device)
        for each in self._levels:
            each.room = self._cells_for(count)
        levels = min(LEVELS, int(8.0 + 1.3 * math.log2(count)))
        for level in range(levels):
            self._split(level, levels, count)
        lists.finish(levels, self._nodes_for(count))
        return tree

    def _split(self, level: int, levels: int, count: int) -> None:
        """Split the cells of a level."""
        device, lists, boxes = self._scene.device, self._lists, [self._lowers, self._uppers]
        here, there = self._levels[level % 2], self._levels[1 - level % 2]
        room = here.room
        bins = min(MOST_BINS, _BINS * room // min(2**level, room))
        cells = min(int(self._active.numpy()[level]), room) if forms.wide(device) else min(2**level, room)
        threads = lists.threads(level)
        inputs = [level, bins, *boxes, lists.references, here]
        wp.launch(splitting.count_bins, dim=threads, inputs=inputs, device=device)
        inputs = [level, bins, lists.references, self._active, here]
        wp.launch(splitting.choose_planes, dim=max(cells, 1), inputs=inputs, device=device)
        inputs = [level, *boxes, lists.references, here]
        wp.launch(splitting.count_sides, dim=threads, inputs=inputs, device=device)
        inputs = [
            level,
            levels,
            self._nodes_for(count),
            lists.references,
            lists.nodes,
            lists.made,
            self._active,
            here,
            there,
        ]
        wp.launch(splitting.make_children, dim=cells, inputs=inputs, device=device)
        inputs = [level, *boxes, lists.references, here, there]
        wp.launch(splitting.pass_on, dim=threads, inputs=inputs, device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = [self._lowers, self._uppers, self._active, self._bins]
        for level in self._levels:
            arrays += [level.cells, level.lowers, level.uppers, level.sides]
        return sum(int(array.capacity) for array in arrays) + self._lists.nbytes()
