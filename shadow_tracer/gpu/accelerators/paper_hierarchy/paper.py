# SPDX-License-Identifier: Apache-2.0
"""The seven variants of Table 1 of "Improved Ray Hierarchy Alias Free Shadows".

======================  ================  ======  ============  ========
variant                 node test         sorted  early accept  two-pass
======================  ================  ======  ============  ========
``precise``             precise
``precise_sorted``      precise           yes
``spheres``             bounding spheres
``spheres_sorted``      bounding spheres  yes
``precise_sea``         precise           yes     yes
``precise_eatp``        precise                   yes           yes
``precise_seatp``       precise           yes     yes           yes
======================  ================  ======  ============  ========

``cones.py`` has the tree, ``cone_test.py`` the node tests and where they differ from the paper's, ``breadth_first.py``
the traversal, ``largest.py`` the choice of triangles for the first of two passes. All give the bits of
``brute_force``: a node test only ever leaves out pairs that the shadow test would say no to, or accepts rays that it
would say yes to.

Two-pass (section 3.4): the largest 2 % of the triangles are traced first; then the tree is made again over the rays
that are still lit, and the other triangles are traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import warp as wp

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays
from shadow_tracer.gpu.accelerators.paper_hierarchy.breadth_first import BreadthFirst, Triangles
from shadow_tracer.gpu.accelerators.paper_hierarchy.cones import ConeTree, Leaves
from shadow_tracer.gpu.accelerators.paper_hierarchy.largest import LargeOccluders
from shadow_tracer.gpu.accelerators.ray_keys import RayOrder
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import make_light_space
from shadow_tracer.gpu.occluders.corners import Corners
from shadow_tracer.gpu.visibility.queries import Query


class _Recipe(NamedTuple):
    spheres: bool = False
    ordered: bool = False
    accept: bool = False
    two_pass: bool = False


_RECIPES = {
    "precise": _Recipe(),
    "precise_sorted": _Recipe(ordered=True),
    "spheres": _Recipe(spheres=True),
    "spheres_sorted": _Recipe(spheres=True, ordered=True),
    "precise_sea": _Recipe(ordered=True, accept=True),
    "precise_eatp": _Recipe(accept=True, two_pass=True),
    "precise_seatp": _Recipe(ordered=True, accept=True, two_pass=True),
}
VARIANTS = tuple(_RECIPES)

# Parts of the triangles, see breadth_first.Triangles.
_ALL, _LARGE, _OTHERS = 0, 1, 2


class PaperHierarchy(Accelerator):
    """One of the paper's variants of the ``cone_hierarchy`` pipeline."""

    def __init__(self, variant: str, context: Context) -> None:
        self._recipe = recipe = _RECIPES[variant]
        self._context = context
        samples, scene = context.samples, context.scene
        device = samples.device
        self._admission = Admission(context)
        self._order = RayOrder(context, self._admission, hilbert=True) if recipe.ordered else None
        self._corners = context.shared.take(Corners, lambda: Corners(context.records))
        self._cones = ConeTree(context)
        self._traversal = BreadthFirst(context, self._cones.capacity_levels, recipe.accept)
        self._large = LargeOccluders(samples.bounds.max_triangles if recipe.two_pass else 1, device)
        self._leaves = Leaves()
        self._leaves.ordered = int(recipe.ordered)
        self._leaves.rays = samples.rays
        self._leaves.group = self._admission.groups
        self._leaves.order = self._order.order if self._order else self._admission.counts
        self._leaves.counts = self._admission.counts
        self._triangles = Triangles()
        self._triangles.spheres = int(recipe.spheres)
        self._triangles.indices = scene.triangles
        self._triangles.sizes = self._large.sizes
        self._triangles.threshold = self._large.threshold

    def follow(self) -> None:
        """Nothing is kept between frames."""

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records and corners of the light."""
        with self._context.stages.stage("setup"):
            self._corners.make(lights[0], self._context.records.prepare(lights[0]))

    def show(self, rays: Rays, query: Query) -> None:
        """Make the tree over the rays of the light and send the triangles through it."""
        frame, light = rays.light, rays.first
        context, recipe = self._context, self._recipe
        scene, stages = context.scene, context.stages
        with stages.stage("setup"):
            self._triangles.space = make_light_space(frame)
            self._triangles.corners = self._corners.of(light)
            self._triangles.records = context.records.of(light)
            if recipe.two_pass:
                inputs = (self._triangles.corners, scene.triangles, self._triangles.records)
                self._large.choose(scene.triangle_count, *inputs)
        with stages.stage("choose"):
            self._admission.admit(rays)
            self._cones.shape(recipe.ordered)
        for part in (_LARGE, _OTHERS) if recipe.two_pass else (_ALL,):
            self._pass(rays, part)
        with stages.stage("rest"):
            self._admission.test_wild(rays)

    def nbytes(self) -> int:
        """Bytes on the device."""
        parts = (self._admission, self._cones, self._traversal, self._large)
        return sum(part.nbytes() for part in parts) + (self._order.nbytes() if self._order else 0)

    def _pass(self, rays: Rays, part: int) -> None:
        """Tree over the rays that are still lit, and one part of the triangles through it."""
        context, stages = self._context, self._context.stages
        states: wp.array = context.samples.states_of(rays.first)
        if self._order:
            with stages.stage("sort"):
                self._order.sort(rays.first)
        with stages.stage("build"):
            self._cones.build(self._triangles.space, self._leaves, states)
        with stages.stage("traverse"):
            self._triangles.part = part
            answers = self._context.answers(rays)
            self._traversal.run(self._triangles, context.scene.triangle_count, self._cones, self._leaves, answers)
        if self._recipe.accept:
            with stages.stage("output"):
                self._cones.resolve(self._leaves, states)
