# SPDX-License-Identifier: Apache-2.0
"""The tree of a ``wp.Bvh`` with up to eight children per node, for the CPU: eight boxes are tested in one go of the
vector registers, and a ray visits a third of the nodes.

It is made from the binary tree after every build and refit, top down: a node takes a subtree's root and opens its
largest inner node until it has eight children (Wald, Benthin, Boulos 2008: multi-branching trees). One node takes 256
bytes: six times eight bounds, and eight children (a node's number, or a range of triangles).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native

WIDTH = 8
BOUNDS_PER_NODE = 6 * WIDTH
# Per child: first triangle and number of triangles of a leaf; node number and 0 of an inner node; 0 and -1 of none.
LINKS_PER_NODE = 2 * WIDTH
native.constants(TREE_WIDTH=WIDTH)


@native.func_native("accelerators/bvh/collapse.h", calls="Collapse::make")
def collapse_tree(bvh: wp.uint64, bounds: wp.array(dtype=float), links: wp.array(dtype=int)) -> int:
    """Fill the wide tree; returns the number of its nodes, or -1 if they do not fit."""
    ...


@wp.kernel(enable_backward=False)
def collapse(bvh: wp.uint64, bounds: wp.array(dtype=float), links: wp.array(dtype=int), count: wp.array(dtype=int)):
    """One thread: ``count[0]`` becomes the number of nodes, or -1 if they do not fit."""
    count[0] = collapse_tree(bvh, bounds, links)
