# SPDX-License-Identifier: Apache-2.0
"""An octree over the triangles (Glassner 1984: "Space subdivision for fast ray tracing"), which rays walk through from
child to child by the planes through the middle of each cell (Revelles, Urena, Lastra 2000: "An efficient parametric
algorithm for octree traversal"), with mailboxes.

The root is a cube around the scene. A cell of more than eight triangles is split into eight equal ones, down to cells
of 2^-15 of the scene; a triangle is a member of every child that its padded box reaches into. Where nodes, cells of a
level or references would be more than there is room for, leaves are larger, and never wrong. The tree is built again
whenever the scene changes, all cells of a level at once (``references.py``).

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
from shadow_tracer.gpu.accelerators.references import Lists
from shadow_tracer.gpu.accelerators.segment import scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST

_REFERENCES_PER_TRIANGLE = 8
_NODES_PER_TRIANGLE = 4
_TRIANGLES_PER_CELL = 4  # of a level
_FEWEST = 64  # nodes, cells and references that a small scene may have


class Octree(Build):
    """The ``octree`` pipeline."""

    walk = Walk("accelerators/octree/octants.h", Structure, queries=(ANY_HIT, CLOSEST))

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
        level.octants = wp.zeros((cells, 8), dtype=int, device=device)
        return level

    def build(self) -> Structure:
        """Split the scene, level by level."""
        scene, device, tree, lists = self._scene, self._scene.device, self._tree, self._lists
        count, boxes = scene.triangle_count, [self._lowers, self._uppers]
        tree.box = scene_box(*scene.box())
        for each in self._levels:
            each.room = self._cells_for(count)
        inputs = [0, count, tree.box, scene.vertices, scene.triangles, *boxes]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        lists.begin(self._lowers, count, _REFERENCES_PER_TRIANGLE * count + _FEWEST)
        inputs = [lists.references, tree, lists.made, self._active, self._levels[0]]
        wp.launch(splitting.begin, dim=1, inputs=inputs, device=device)
        for level in range(LEVELS):
            self._split(level, count)
        lists.finish(LEVELS, self._nodes_for(count))
        return tree

    def _split(self, level: int, count: int) -> None:
        """Split the cells of a level."""
        device, lists, boxes = self._scene.device, self._lists, [self._lowers, self._uppers]
        here, there = self._levels[level % 2], self._levels[1 - level % 2]
        most = min(8**level, here.room)
        cells = min(int(self._active.numpy()[level]), most) if forms.wide(device) else most
        threads = lists.threads(level)
        inputs = [level, *boxes, lists.references, here]
        wp.launch(splitting.begin_level, dim=1, inputs=[level, lists.references, self._active], device=device)
        wp.launch(splitting.count_octants, dim=threads, inputs=inputs, device=device)
        inputs = [level, self._nodes_for(count), lists.references, lists.nodes, lists.made, self._active, here, there]
        wp.launch(splitting.make_children, dim=cells, inputs=inputs, device=device)
        wp.launch(splitting.pass_on, dim=threads, inputs=[level, *boxes, lists.references, here], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = [self._lowers, self._uppers, self._active]
        for level in self._levels:
            arrays += [level.cells, level.octants]
        return sum(int(array.capacity) for array in arrays) + self._lists.nbytes()
