# SPDX-License-Identifier: Apache-2.0
"""The tree of pipeline ``bvh``: two children per node, over blocks of up to sixteen triangles; and for the CPU the same
tree with up to sixteen children per node (Wald, Benthin, Boulos 2008: "Getting Rid of Packets"; there four).

A node with two children takes 40 bytes: low and high corner, each in four floats, and its children, or its block.
Children have greater numbers than their parent. What rays walk through on the CPU is laid out for loads of sixteen
floats:

- a node is six rows of sixteen bounds and a row of sixteen links, 448 bytes;
- a block is ten rows of sixteen floats and the numbers of its triangles, 704 bytes: a corner, the two edges from there,
  and the size of the longest edge (``block.h``).

Blocks have at least ``FEWEST`` triangles where there are so many, so there are at most an eighth as many of them as
triangles, and twice as many nodes. A wide node with inner children has all sixteen, and so is made of fifteen inner
nodes; one with blocks alone is made of one at least. The most that n inner nodes make is 17 n / 31 wide ones: sixteen
of the latter below each of the former.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.segment import SceneBox
from shadow_tracer.gpu.device import native

LANES = 16
FEWEST = 8
CORNERS = 8  # floats of a node with two children
ROWS = 10  # of a block
NONE = -(2**31)  # no child
# Levels on which a rule decides where to split; below, nodes are halved. So no tree is deeper than LEVELS.
RULED = 32
LEVELS = 60
native.constants(TREE_LANES=LANES, FEWEST=FEWEST, CORNERS=CORNERS, BLOCK_ROWS=ROWS, TREE_NONE=NONE)
native.constants(RULED=RULED, LEVELS=LEVELS)
# Elements of ``Tree.counts``.
NODES, BLOCKS, WIDE_NODES = 0, 1, 2
native.constants(COUNT_OF_NODES=NODES, COUNT_OF_BLOCKS=BLOCKS, COUNT_OF_WIDE_NODES=WIDE_NODES)


@wp.struct
class Tree:
    """What is built, and what rays walk through."""

    box: SceneBox
    counts: wp.array(dtype=int)  # nodes, blocks, nodes with sixteen children
    corners: wp.array(dtype=float)  # of nodes: low x y z and nothing, high x y z and nothing
    children: wp.array(dtype=int)  # of nodes, two each: nodes, or a block as its complement and 0
    leaves: wp.array(dtype=int)  # the node of each block
    members: wp.array(dtype=int)  # of blocks: triangles, -1 where there is none
    # For the CPU; empty elsewhere.
    rows: wp.array(dtype=float)  # of blocks
    bounds: wp.array(dtype=float)  # of nodes with sixteen children: low x, y, z, high x, y, z
    links: wp.array(dtype=int)  # their children: nodes, blocks as their complements, or NONE
    sources: wp.array(dtype=int)  # the node of the small tree that each of these children is
    # While meshes are ``left_out``, which children, and which triangles of blocks, cast something, as bits.
    left_out: int
    casting_nodes: wp.array(dtype=int)
    casting_blocks: wp.array(dtype=int)
    # For variant ``threaded``; empty elsewhere.
    escapes: wp.array(dtype=int)  # where to go on after each node and all below it, -1 at the end


def most_blocks(triangles: int) -> int:
    """The most blocks that so many triangles can be in."""
    return triangles // FEWEST + 1


def make_tree(triangles: int, wide: bool, threaded: bool, device: Any) -> Tree:
    """Room for the tree of so many triangles."""
    blocks = most_blocks(triangles)
    nodes = 2 * blocks
    wide_nodes = 17 * blocks // 31 + 2 if wide and not threaded else 0
    tree = Tree()
    tree.counts = wp.zeros(4, dtype=int, device=device)
    tree.corners = wp.empty(nodes * CORNERS, dtype=float, device=device)
    tree.children = wp.empty(2 * nodes, dtype=int, device=device)
    tree.leaves = wp.empty(blocks, dtype=int, device=device)
    tree.members = wp.empty(blocks * LANES, dtype=int, device=device)
    tree.rows = wp.empty(blocks * ROWS * LANES if wide_nodes else 0, dtype=float, device=device)
    tree.bounds = wp.empty(wide_nodes * 6 * LANES, dtype=float, device=device)
    tree.links = wp.empty(wide_nodes * LANES, dtype=int, device=device)
    tree.sources = wp.empty(wide_nodes * LANES, dtype=int, device=device)
    tree.casting_nodes = wp.empty(wide_nodes, dtype=int, device=device)
    tree.casting_blocks = wp.empty(blocks if wide_nodes else 0, dtype=int, device=device)
    tree.escapes = wp.empty(nodes if threaded else 0, dtype=int, device=device)
    return tree


def tree_bytes(tree: Tree) -> int:
    """Bytes of its arrays."""
    arrays = (tree.counts, tree.corners, tree.children, tree.leaves, tree.members, tree.rows)
    arrays += (tree.bounds, tree.links, tree.sources, tree.casting_nodes, tree.casting_blocks, tree.escapes)
    return sum(int(array.capacity) for array in arrays)
