# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over blocks of sixteen triangles: ``build.py`` makes it, ``scene_tree.py`` keeps it.

On the CPU a ray tests sixteen boxes at a time, and sixteen triangles; where rays ask for any hit, sixteen of them go
together as long as they are close (after Wald et al. 2001: "Interactive Rendering with Coherent Ray Tracing", and
Reshetov et al. 2005: "Multi-Level Ray Tracing Algorithm", which sends a bundle for its rays), and every triangle that
one of them may meet is shown to all. On CUDA a thread takes a ray through the tree with two children per node.

- ``sah``: split by the surface area heuristic; ``median``: into halves; ``lbvh``: where Morton codes differ;
- ``threaded``: the tree of ``sah`` with links past all below a node (Smits 1998: "Efficiency Issues for Ray Tracing"),
  and so without a stack, in either form; children come in the tree's order, not nearest first.

Why no triangle is missed. E is the scene's extent, its unit here, u = 2^-24; see ``segment.py`` for what is said there.

*Boxes.* A node's box holds the boxes of all its triangles, which are padded by 32 u and rounded outwards. A walk loses
5 u to the ray's start and direction, and 6 u to the roundings of a slab. Boxes of triangles that are no numbers, and
of those behind the scene's last, hold nothing and make no other larger: no ray need be shown them.

*Bundles.* Rays are cut to the scene's box, and a bundle is the middle of all their beginnings and ends, and R, the most
that one of either is from its middle. The point of a ray at a share of its way is within R of that of the middle one at
the same share. So every box that a ray meets is met by the middle one within R along each axis, no farther off than
its length. R is taken 1e-5 larger. Bundles from a sample to the points of a light meet sixteen boxes at a time, as
pyramids (``bundle.h``, ``segment.py``), and blocks by a filter of four planes for each triangle (``mask_filter.py``).

*Blocks.* A triangle is a, b = a + e, c = a + f: a, e and f rounded once to float32, so that these corners are within
3 u of the real ones along each axis. If a real ray meets the triangle at shares x, y, z of a, b and c, the middle ray
o + t d has a point within 9 u along each axis and R of the same point of these corners (5 u as above, 1 u of cutting a
ray that comes from far away): t d = k + y e + z f + h with k = a - o and |h| <= 15.6 u + R. With n = e x f, D = d.n,
U = (k x d).f, V = -(k x d).e, W = D - U - V, products with d x f and d x e give y D = U + h.(d x f),
z D = V - h.(d x e), x D = W - h.(d x f) + h.(d x e). So U, V and W are all at least -B, or all at most B, if
B >= |h| |d| S, S being the longest edge: which of both is D's sign, and need not be known. Likewise n.k = t D - n.h is
between 0 and D times the longest t, give or take |h| S^2. That is what is tested.

Roundings: |k| <= 2.0001 per axis, |d| <= 1.0001. U and V are off by 6.1 u times the sum of the magnitudes of their
terms, at most 2.83 S: 17.3 u S. D is off by 31 u S, as |e| <= 2 sqrt(3); S is a sum of three magnitudes. W is off by
all of these and 10.5 u S of two differences: 84 u S. With h it is 100 u S + 1.0001 R S; B is S (128 u + 1.001 R). n.k
is off by 37 u S^2, D times the longest t by 35 u S^2, their comparison by 7 u S^2, with h by 95 u S^2 + R S^2; the
bound is S B + 1e-30. S is taken 1e-6 larger, and at least 1e-20, so that B is never less than 7e-26: that and 1e-30 are
more than underflow takes away. Lanes without a triangle have S = -1: with it all comparisons fail.

A closest hit is looked for with the t that is left; a node that waits is left out when the ray enters it later than
that. A packet one of whose samples is too far for ``segment.py``, or whose light is beyond 1e100, is shown everything.
A bundle that is too wide, or has visited too much, is left and cut in two, or into its rays: triangles may be shown
again.
"""

from __future__ import annotations

from shadow_tracer.gpu.accelerators.bvh.scene_tree import KINDS
from shadow_tracer.gpu.accelerators.bvh.tree import Tree
from shadow_tracer.gpu.accelerators.cone_kernels import ConeKernels, cone_scene
from shadow_tracer.gpu.accelerators.interface import Context, Traits
from shadow_tracer.gpu.accelerators.walker import Build, Walk, Walker
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST, MASK

# What roundings do to the planes of a triangle of size 1, at most, and what underflow does.
native.constants(BLOCK_BAND=2.0**-17, BLOCK_FLOOR=1e-30)
# Rays of a bundle are no farther than that from its middle, in units of the scene's extent, and it visits no more nodes
# and blocks for each of them. The last is how long rays of a packet may be before they are cut.
native.constants(WIDEST=2.0**-6, PATIENCE=4, LONGEST=1e100)
# Samples that are looked at together are no farther from the scene's centre, in units of its extent. And what is close
# to a sample, in parts of its way to the light.
native.constants(SHAFT_PLACE=2.0, MASK_CLOSE=2.0**-6)
# Where sixteen triangles are judged in float32: within a third of what was measured where there are 10 to 120 nodes and
# blocks, and 4 to 70 triangles (BART robots, conference, two recorded rooms; panels of 5 to 20 % of the view).
_IN_BLOCKS = 50.0, 3.0, 0.5

_QUERIES = (ANY_HIT, MASK, CLOSEST)
# On the CPU: rays one by one, and in packets of sixteen; and a sample with all points of a light.
SINGLE = Walk("accelerators/bvh/sixteen.h", Tree, queries=(ANY_HIT, CLOSEST))
SINGLE |= Walk("accelerators/bvh/mask_walk.h", Tree, queries=(MASK,))
PACKETS = SINGLE | Walk("accelerators/bvh/packets.h", Tree, lanes=16)
_PAIRS = Walk("accelerators/bvh/pairs.h", Tree, queries=_QUERIES)
_THREADED = Walk("accelerators/bvh/threaded.h", Tree, queries=_QUERIES)
ConeScene = cone_scene(Tree)


class Bvh(Build):
    """The ``bvh`` pipeline.

    Attributes:
        tree: that of the scene.
    """

    queries = (ANY_HIT, MASK)
    cones = ConeKernels("accelerators/bvh/cone_walk.h", ConeScene)

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        self.tree = KINDS[variant](scene)
        self.walk = _THREADED if self.tree.threaded else PACKETS if forms.wide(scene.device) else _PAIRS
        self.bundle_costs = _IN_BLOCKS if self.walk is PACKETS else Traits.bundle_costs

    def follow(self, stages: Stages) -> None:
        """As others do, and know what the scene leaves out."""
        super().follow(stages)
        if self.structure is not None:
            self.tree.leave_out()

    def build(self) -> Tree:
        """Refit or build the tree."""
        return self.tree.follow()

    def forget(self) -> None:
        """Build the tree again."""
        super().forget()
        self.tree.forget()

    def walker(self, context: Context) -> Walker:
        """One that says how bad the tree is."""
        return Judge(self, context)

    def cones_asked(self) -> None:
        """Let the tree know how bad it is, as frames do: it may only ever be asked about cones."""
        self.tree.judge(self.tree.areas.numpy())

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self.tree.nbytes()


class Judge(Walker):
    """Sends rays through a tree, and tells it how bad it is: a frame's counters come to the host with its answers."""

    def __init__(self, build: Bvh, context: Context) -> None:
        super().__init__(build, context)
        self._tree, self._host = build.tree, context.samples.host
        self._host.add(self._tree.areas)

    def learn(self, counters: dict[str, int]) -> None:
        """How many nodes a ray was expected to visit."""
        self._tree.judge(self._host.read(self._tree.areas))
