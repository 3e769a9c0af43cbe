# SPDX-License-Identifier: Apache-2.0
"""Walking a ray through a ``wp.Bvh`` with the shadow test's filter at the leaves: the search that CUDA uses.

Why no triangle can be missed is in ``mesh_bvh.py``.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native

# What a walk through the tree found: whether an occluder is certain, triangles tested, nodes visited, uncertain
# triangles found, and the first of them.
FOUND = 5
Candidates = wp.types.vector(length=4 + FOUND, dtype=wp.int32)
native.constants(TREE_FOUND=FOUND)


# Warp's own query iterator pushes both children untested and hands out boxes one by one; walking its nodes here,
# nearer child first, with the filter inline, takes a third of the time.
@native.func_native("accelerators/bvh/binary_tree.h", calls="BinaryTree::search")
def search(
    bvh: wp.uint64,
    origin: wp.vec3,
    direction: wp.vec3,
    longest: float,
    records: wp.array2d(dtype=wp.vec4),
    ray: wp.vec4,
    magnitude: float,
    count: int,
    skip: int,
) -> Candidates:
    """(1 if certain, -1 if the tree is too deep; tests; nodes; uncertain triangles; five of them from ``skip`` on, or
    the occluder if it is certain). ``count``: triangles; the tree may have boxes beyond them."""
    ...
