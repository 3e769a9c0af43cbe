# SPDX-License-Identifier: Apache-2.0
"""The tree over a scene, one for all that send rays through it.

It is built when the scene has other triangles, and refitted when they are elsewhere. A refitted tree grows worse as
things move. How bad it is, is counted: a ray that crosses the scene is expected to visit as many nodes as the surfaces
of all boxes are together, in parts of the root's (Goldsmith and Salmon 1987: "Automatic Creation of Object Hierarchies
for Ray Tracing"). When that is ``WORN_OUT`` times what it was after the build, the tree is built again the next time
that something moves. Where parts of a mesh drift apart, rays take 1.3 times as long at 1.15 times the surface, 2.6
times at 1.4 and nine times at 2.3 (``docs/performance.md``), and a build takes as long as five to nine refits. Where
everything bends, surfaces grow that a new tree has, too: then one build is for nothing.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.accelerators.bvh.build import MEDIAN, MORTON, SAH, Builder
from shadow_tracer.gpu.accelerators.bvh.tree import Tree
from shadow_tracer.gpu.accelerators.segment import holds, scene_box
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.occluders.slots import Ranges
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.checks import FloatArray

WORN_OUT = 1.25


class SceneTree:
    """A tree that follows the scene.

    Attributes:
        rule: where nodes are split.
        threaded: whether rays go through it without a stack.
        builds: how often it has been built.
        areas: the surfaces of all boxes together, and that of the root, on the device.
    """

    rule: ClassVar[int] = SAH
    threaded: ClassVar[bool] = False

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        self._builder = Builder(scene.bounds.max_triangles, self.rule, self.threaded, scene.device)
        self.areas = self._builder.areas
        self._made_for: Revision | None = None
        self._marked: tuple[Revision, Ranges] | None = None
        self._held: tuple[FloatArray, FloatArray] | None = None  # what the scene's box was made to hold
        # Nodes that a ray was expected to visit after the build, and is now; None until a frame has ended.
        self._fresh: float | None = None
        self._expected: float | None = None
        self.builds = 0

    def follow(self) -> Tree:
        """The tree of the scene as it is, which has triangles."""
        scene, tree, made_for = self._scene, self._builder.tree, self._made_for
        if made_for == scene.revision:
            return tree
        self._made_for = None  # what cannot be made is built the next time
        fits = made_for is not None and made_for.topology == scene.revision.topology
        build = not fits or self._worn_out()
        low, high = scene.box()
        if build or self._held is None or not holds(self._held, low, high):
            tree.box, self._held = scene_box(low, high), (low, high)
        if build:
            self._builder.build(scene)
            self._fresh = self._expected = None
            self.builds += 1
        else:
            self._builder.refit(scene)
        self._made_for = scene.revision
        return tree

    def leave_out(self) -> None:
        """Let walks know of the meshes that the scene leaves out, which the tree holds all the same."""
        scene, tree = self._scene, self._builder.tree
        tree.left_out = int(len(scene.left_out) > 0)
        marked = scene.revision, scene.left_out
        if tree.left_out and self._marked != marked:
            self._marked = None
            self._builder.mark(scene)
            self._marked = marked

    def forget(self) -> None:
        """Build it again."""
        self._made_for = self._held = self._marked = None

    def judge(self, areas: npt.NDArray[np.floating]) -> None:
        """What a frame has found in ``areas``."""
        every, root = (float(area) for area in areas)
        self._expected = every / root if root > 0.0 else 0.0
        if self._fresh is None:
            self._fresh = self._expected

    def _worn_out(self) -> bool:
        """Whether a ray is expected to visit too many nodes, as the host knows it from the frames before."""
        return self._expected is not None and self._fresh is not None and self._expected > WORN_OUT * self._fresh

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self._builder.nbytes()


class Sah(SceneTree):
    """Split by the surface area heuristic."""


class Median(SceneTree):
    """Split into halves of the same number of blocks."""

    rule = MEDIAN


class Lbvh(SceneTree):
    """Split where Morton codes differ."""

    rule = MORTON


class Threaded(SceneTree):
    """Split by the surface area heuristic, with links instead of a stack."""

    threaded = True


KINDS: dict[str, type[SceneTree]] = {"sah": Sah, "median": Median, "lbvh": Lbvh, "threaded": Threaded}
