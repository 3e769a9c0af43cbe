# SPDX-License-Identifier: Apache-2.0
"""Rays classified by origin and direction (Arvo and Kirk 1987: "Fast ray tracing by ray classification"): cells in five
dimensions, three of the origin and two of the direction, each with a list of the triangles that its rays could meet. A
reference: a ray does little more than look up its list, but making lists takes long, and much memory.

Cells are a tree: at each level a cell is halved along all five axes, six times at most. Its roots are the six faces of
a cube of directions, with all triangles and all origins in the scene's box: rays that begin outside have their origin
where they enter it. A list is made when a ray first asks for it, from the list of the cell around, and kept: for other
lights and other frames, as long as the scene stays as it is. As kernels cannot stop for that, lists are made in rounds
before rays look for occluders: in each round every ray goes down to the smallest cell that has a list, and asks for the
one below, unless that list has eight triangles or fewer; the first one to ask makes it a node; then lists of the new
nodes are made, one thread for each. As many rounds as levels are enough for all. Memory is bounded: where there is no
room for a node or for its list, rays take that of the cell around. Before the next light everything is forgotten then,
unless these rays had found nothing but the roots: what one light asks for may be more than fits, and is kept.

Why no triangle can be missed. In units of the scene's extent E, u = 2^-24; h = 129/128 is half the size of the cell of
all origins. All borders of cells are multiples of h 2^-6 and of 2^-6: exact float32, as are the sums that lead to them.
The origin of the stored ray is compared with them, and so are u and v: its direction's components over the largest of
them, each rounded once, by u/2. So the stored ray is a ray of its cell, but for directions that are up to u/2 beside
it, which displaces a point by 1.1 u, as the largest component of the way to it is less than 2.03. If the exact ray
meets a triangle at x, that is within 5 u of the stored ray (``segment.py``): within 6.1 u of a ray of the cell.

``could_meet`` compares a triangle's box with the cell: from the origin of the cell's ray, the point is in the box
widened by the cell, as seen from its middle; its distance m along the largest component is in the widened box, and not
below 0; and its other two components are between the products of m and the ends of the cell's directions. Each of these
follows from the others, so each alone may say no. Rounded are the differences, by 2 u each as they are below 4, m among
them, and the products, 2 u: 6 u at most in one comparison, 12.1 u together, less than the 32 u that boxes are padded
by. A list holds what could be met of the list of a larger cell, in which all that is so is, too. No product is part of
a sum, so compilers contract nothing, and counting and storing find the same.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.ray_classification import classify
from shadow_tracer.gpu.accelerators.ray_classification.classify import CHILDREN, LEVELS, Beam, Structure
from shadow_tracer.gpu.accelerators.segment import scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.walker import Build, Walk, Walker
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, Query

_FEWEST_NODES, _MOST_NODES = 4096, 65536
_THREADS_CUDA = 8192


class RayClassification(Build):
    """The ``ray_classification`` pipeline."""

    ask = Walk("accelerators/ray_classification/ask.h", Structure)
    walk = Walk("accelerators/ray_classification/lists.h", Structure)

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        bounds, device = scene.bounds, scene.device
        triangles = bounds.max_triangles
        self._nodes = min(max(triangles // 4, _FEWEST_NODES), _MOST_NODES)
        self._lowers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._uppers = wp.empty(triangles, dtype=wp.vec3, device=device)
        self._tree = tree = Structure()
        tree.beams = wp.zeros(self._nodes, dtype=Beam, device=device)
        for name in ("level", "first", "count", "asked"):
            setattr(tree, name, wp.zeros(self._nodes, dtype=int, device=device))
        tree.children = wp.zeros(CHILDREN * self._nodes, dtype=int, device=device)
        tree.members = wp.empty(max(bounds.grid_entries, triangles), dtype=int, device=device)
        tree.made, tree.used = wp.zeros(2, dtype=int, device=device), wp.zeros(4, dtype=int, device=device)

    def build(self) -> Structure:
        """The roots, and nothing else before rays ask for it."""
        scene, tree, device = self._scene, self._tree, self._scene.device
        tree.box = scene_box(*scene.box())
        count, boxes = scene.triangle_count, [self._lowers, self._uppers]
        inputs = [0, count, tree.box, scene.vertices, scene.triangles, *boxes]
        wp.launch(triangle_boxes, dim=count, inputs=inputs, device=device)
        tree.used.zero_()
        wp.launch(classify.list_all, dim=count, inputs=[self._lowers, tree], device=device)
        self.forget_lists(always=True)
        return tree

    def walker(self, context: Context) -> Walker:
        """One that has lists made before its rays look at them."""
        return Asking(self, context)

    def forget_lists(self, always: bool) -> None:
        """Forget all lists if some did not fit, or ``always``."""
        device, inputs = self._scene.device, [int(always), self._tree]
        wp.launch(classify.forget, dim=self._nodes, inputs=inputs, device=device)
        wp.launch(classify.begin, dim=1, inputs=inputs, device=device)

    def make_lists(self) -> bool:
        """Those that have been asked for; false if it is known that there are none."""
        tree, device = self._tree, self._scene.device
        threads = forms.tasks(device, _THREADS_CUDA)
        if forms.wide(device):
            made, listed = tree.made.numpy().tolist()
            if made == listed:
                return False
        inputs = [threads, self._lowers, self._uppers, tree]
        wp.launch(classify.make_lists, dim=threads, inputs=inputs, device=device)
        wp.launch(classify.link, dim=self._nodes, inputs=[tree], device=device)
        wp.launch(classify.end_round, dim=1, inputs=[tree], device=device)
        return True

    def nbytes(self) -> int:
        """Bytes on the device."""
        tree = self._tree
        arrays = [self._lowers, self._uppers, tree.beams, tree.level, tree.first, tree.count, tree.children, tree.asked]
        return sum(int(array.capacity) for array in [*arrays, tree.members])


class Asking(Walker):
    """Sends rays to ask for lists before they go through them."""

    def __init__(self, build: RayClassification, context: Context) -> None:
        super().__init__(build, context)
        self._lists = build

    def show(self, rays: Rays, query: Query) -> None:
        """Make the lists that the rays of the light ask for, and show them these."""
        context, samples, lists = self._context, self._context.samples, self._lists
        with context.stages.stage("build"):
            lists.forget_lists(always=False)
            for _ in range(LEVELS):
                lists.ask.launch(ANY_HIT, samples.count, lists.structure, context.any_hit(rays), samples.device)
                if not lists.make_lists():
                    break
        super().show(rays, query)
