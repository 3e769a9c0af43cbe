# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over blocks of sixteen triangles, built per topology and refitted."""

from __future__ import annotations

from shadow_tracer.gpu.accelerators.bvh.build import MEDIAN, MORTON, SAH, Builder
from shadow_tracer.gpu.accelerators.bvh.tree import Tree, most_blocks
from shadow_tracer.gpu.accelerators.interface import Context, Traits
from shadow_tracer.gpu.accelerators.segment import holds, scene_box
from shadow_tracer.gpu.accelerators.walker import Walk, Walker
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST, MASK
from shadow_tracer.scene.checks import FloatArray

Structure = Tree
# Bounds of what roundings do to the planes of a triangle of size 1, and the least bound.
native.constants(BLOCK_BAND=2.0**-17, BLOCK_FLOOR=1e-30)

_RULES = {"sah": SAH, "median": MEDIAN, "lbvh": MORTON, "threaded": SAH}
_QUERIES = (ANY_HIT, MASK, CLOSEST)
_SIXTEEN = Walk("accelerators/bvh/sixteen.h", Tree, queries=_QUERIES)
_PAIRS = Walk("accelerators/bvh/pairs.h", Tree, queries=_QUERIES)
_THREADED = Walk("accelerators/bvh/threaded.h", Tree, queries=_QUERIES)

# The share of triangles that may be replaced before the tree is built again.
_REPLACED = 1 / 8
# A refitted tree whose rays visit this many times the nodes they visited after the last build is built again.
_WORN_OUT = 2.0


class Bvh(Walker):
    """The ``bvh`` pipeline."""

    traits = Traits(masks=True)

    def __init__(self, variant: str, context: Context) -> None:
        super().__init__(context)
        device, threaded = context.frame.device, variant == "threaded"
        self._builder = Builder(context.frame.bounds.max_triangles, _RULES[variant], threaded, device)
        self.walk = _THREADED if threaded else _SIXTEEN if forms.wide(device) else _PAIRS
        self._built_for: Revision | None = None
        self._built_count = 0
        self._held: tuple[FloatArray, FloatArray] | None = None  # what the scene's box was made to hold
        self._refits = 0  # since the last build
        self._fresh_nodes: float | None = None  # nodes per ray of the first frame after a build
        self._worn_out = False

    def build(self) -> Tree:
        """Refit or build the tree."""
        scene, tree = self._context.scene, self._builder.tree
        low, high = scene.box()
        if self._held is None or not holds(self._held, low, high):
            tree.box, self._held = scene_box(low, high), (low, high)
        built_for = self._built_for
        if built_for is None or built_for.topology != scene.revision.topology or self._worn_out:
            self._builder.build(scene)
            self._fresh_nodes, self._worn_out, self._refits = None, False, 0
        else:
            self._builder.refit(scene)
            self._refits += 1
        self._built_for = scene.revision
        return tree

    def learn(self, counters: dict[str, int]) -> None:
        """Judge the tree by the nodes visited per ray in the frame that just ended."""
        if counters["rays"] == 0:
            return
        nodes = counters["nodes_visited"] / counters["rays"]
        if self._fresh_nodes is None:
            self._fresh_nodes = nodes
        self._worn_out = self._refits > 0 and nodes > _WORN_OUT * max(self._fresh_nodes, 1.0)

    def nbytes(self) -> int:
        """The tree, and what it is built with."""
        return self._builder.nbytes()
