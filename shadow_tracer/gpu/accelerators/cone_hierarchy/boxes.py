# SPDX-License-Identifier: Apache-2.0
"""The ray tree of variant ``linear``: boxes of cubified direction with a range of depth.

Rays are sorted by direction (``ray_keys.py``); 2^log_leaf consecutive ones are a leaf, 2^log_branch consecutive nodes
have one parent: an implicit, left-balanced tree. On the CPU both are 16, so that one go of the vector registers tests
all children of a node, or all rays of a leaf; on CUDA a leaf is a warp's 32 rays and the tree is four-way.

A node bounds r = h/|h|_inf by centre and half extent, and the depth t by its range (``light_space.py``): every test is
linear in it. There is no angle, no wide-angle case and no single-ray case, and a node whose rays lie on several cube
faces is just a large box. Directions are within 3 u of exact (``admission.py`` sees to it); the half extent is
padded by 8 u at each level for that and for its own roundings, depths by 8 u relative.

Boxes lie in groups of siblings, each quantity of all siblings together: [group][cu cv cw eu ev ew tmin tmax][sibling].
A node without live rays has half extents of -1e30, which fails every edge test by far.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.ray_keys import CURVE_BITS, RayOrder
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, LightSpace, space_of

QUANTITIES = 8
GONE = -1.0e30
_PAD = 2.0**-21
_RAY_QUANTITIES = 5
_MOST_TABLE_BITS = 8

# Bits of a node's flags.
DONE = wp.constant(1)
WHOLE = wp.constant(2)

native.constants(NODE_DONE=DONE, NODE_WHOLE=WHOLE)
native.constants(BOX_QUANTITIES=QUANTITIES, BOX_GONE=GONE, BOX_PAD=_PAD, LEAF_QUANTITIES=_RAY_QUANTITIES)


@wp.struct
class RayTree:
    """The tree as kernels see it. Nodes are numbered level by level, leaves first; ``offset`` has the first number of
    each level."""

    log_leaf: int
    log_branch: int
    levels: int
    table_bits: int  # the lookup table has 4^table_bits cells per face
    leaves: wp.array(dtype=float)  # [leaf][U V W Z magnitude][ray]; lanes that are not ``live`` hold anything
    order: wp.array(dtype=int)  # sample of each ray
    boxes: wp.array(dtype=float)
    live: wp.array(dtype=int)  # of a leaf: bits of its live rays; of a node: number of children with live rays
    flags: wp.array(dtype=int)  # DONE and WHOLE, see descent.py
    offset: wp.array(dtype=int)
    table: wp.array(dtype=int)  # first ray of each cell, in key order; one more at the end
    fit: wp.array(dtype=wp.vec4)
    counts: wp.array(dtype=int)
    visits: wp.array(dtype=int)  # times each node was looked at, if it has room for them (``count_visits``)


@native.func_native("accelerators/cone_hierarchy/boxes.h", calls="NodeBox::store")
def store_box(tree: RayTree, node: int, low: wp.vec3, high: wp.vec3, nearest: float, farthest: float):
    """Write the box of node number ``node``; high < low says that it has no rays."""
    ...


@native.func_native("accelerators/cone_hierarchy/leaves.h", calls="Leaf1::make")
def make_leaf(leaf: int, space: LightSpace, rays: wp.array(dtype=wp.vec4), tree: RayTree):
    """Copy the rays of a leaf together and bound them."""
    ...


@native.func_native("accelerators/cone_hierarchy/leaves.h@16", calls="Leaf16::make")
def make_leaf_of_sixteen(leaf: int, space: LightSpace, rays: wp.array(dtype=wp.vec4), tree: RayTree):
    """``make_leaf`` for a leaf of 16 rays, in vector registers."""
    ...


@wp.kernel(enable_backward=False)
def make_leaves(light: wp.array(dtype=LightFrame), rays: wp.array(dtype=wp.vec4), tree: RayTree):
    """One thread per leaf that could be used."""
    make_leaf(wp.tid(), space_of(light[0]), rays, tree)


@wp.kernel(enable_backward=False)
def make_leaves_wide(light: wp.array(dtype=LightFrame), rays: wp.array(dtype=wp.vec4), tree: RayTree):
    make_leaf_of_sixteen(wp.tid(), space_of(light[0]), rays, tree)


@wp.kernel(enable_backward=False)
def make_parents(level: int, count: int, tree: RayTree):
    """The ``count`` nodes of ``level`` from those of the level below, and empty ones to the end of the group."""
    index = wp.tid()
    node = tree.offset[level] + index
    branch = 1 << tree.log_branch
    child = tree.offset[level - 1] + index * branch
    low = wp.vec3(2.0, 2.0, 2.0)
    high = wp.vec3(-2.0, -2.0, -2.0)
    nearest = float(wp.inf)
    farthest = float(-wp.inf)
    live = int(0)
    if index < count:
        base = (child >> tree.log_branch) * QUANTITIES * branch
        for j in range(branch):
            at = base + j
            if tree.boxes[at + 3 * branch] >= 0.0:
                center = wp.vec3(tree.boxes[at], tree.boxes[at + branch], tree.boxes[at + 2 * branch])
                half = wp.vec3(tree.boxes[at + 3 * branch], tree.boxes[at + 4 * branch], tree.boxes[at + 5 * branch])
                low = wp.min(low, center - half)
                high = wp.max(high, center + half)
                nearest = wp.min(nearest, tree.boxes[at + 6 * branch])
                farthest = wp.max(farthest, tree.boxes[at + 7 * branch])
                live += 1
    tree.live[node] = live
    tree.flags[node] = 0
    store_box(tree, node, low, high, nearest, farthest)


@wp.kernel(enable_backward=False)
def find_cells(keys: wp.array(dtype=int), tree: RayTree):
    """The lookup table by binary search. One thread per entry."""
    entry = wp.tid()
    shift = 2 * (CURVE_BITS - tree.table_bits)
    low = int(0)
    high = tree.counts[0]
    while low < high:
        middle = (low + high) // 2
        if (keys[middle] >> shift) < entry:
            low = middle + 1
        else:
            high = middle
    tree.table[entry] = low


@native.func_native("accelerators/cone_hierarchy/cells.h", calls="Cells::sweep")
def sweep(keys: wp.array(dtype=int), tree: RayTree):
    """The lookup table in one sweep over the keys."""
    ...


@wp.kernel(enable_backward=False)
def sweep_cells(keys: wp.array(dtype=int), tree: RayTree):
    """``find_cells`` by one thread: for the CPU."""
    sweep(keys, tree)


class RayTreeBuffers:
    """Owns the tree's memory and builds it."""

    def __init__(self, context: Context, order: RayOrder, admission: Admission, wide: bool) -> None:
        self._context = context
        self._order = order
        self.wide = wide
        device, rays = context.samples.device, context.samples.bounds.max_rays
        log_leaf, log_branch = (4, 4) if wide else (5, 2)
        branch = 1 << log_branch
        # Whole groups at every level; the last level is a single group.
        self._offsets = [0]
        nodes = -(-rays >> log_leaf)
        while True:
            nodes = -(-nodes // branch) * branch
            self._offsets.append(self._offsets[-1] + nodes)
            if nodes == branch:
                break
            nodes //= branch
        total = self._offsets[-1]
        tree = RayTree()
        tree.log_leaf, tree.log_branch = log_leaf, log_branch
        tree.leaves = wp.empty(self._offsets[1] * _RAY_QUANTITIES << log_leaf, dtype=float, device=device)
        tree.order = order.order
        tree.boxes = wp.empty(total * QUANTITIES, dtype=float, device=device)
        tree.live = wp.empty(total, dtype=int, device=device)
        tree.flags = wp.empty(total, dtype=int, device=device)
        tree.offset = wp.array(self._offsets, dtype=int, device=device)
        tree.table = wp.empty((FACES << (2 * _MOST_TABLE_BITS)) + 1, dtype=int, device=device)
        tree.fit = order.fit
        tree.counts = admission.counts
        tree.visits = wp.empty(0, dtype=int, device=device)
        self.tree = tree

    def count_visits(self) -> wp.array:
        """From now on count how often each node is looked at (not in the wide form of the descent): for pictures.
        Returns the counts, which the caller clears."""
        self.tree.visits = wp.zeros(self._offsets[-1], dtype=int, device=self._context.samples.device)
        return self.tree.visits

    def build(self, light: int) -> None:
        """Leaves, boxes and lookup table over the rays in ``order``; the launches depend on the number of samples
        alone."""
        buffers, tree = self._context.samples, self.tree
        device, branch = buffers.device, 1 << tree.log_branch
        # The largest power of four with at least 8 rays per cell of one face.
        tree.table_bits = min(max(((buffers.count >> 3).bit_length() - 1) // 2, 1), _MOST_TABLE_BITS)
        nodes = -(-buffers.count >> tree.log_leaf)
        level = 0
        while True:
            groups = -(-nodes // branch)
            if level == 0:
                kernel = make_leaves_wide if self.wide else make_leaves
                inputs = [buffers.light_frame_of[light], buffers.rays, tree]
            else:
                kernel, inputs = make_parents, [level, nodes, tree]
            wp.launch(kernel, dim=groups * branch, inputs=inputs, device=device)
            level += 1
            if groups <= 1:  # 0 if there are no samples
                break
            nodes = groups
        tree.levels = level
        if forms.wide(device):
            wp.launch(sweep_cells, dim=1, inputs=[self._order.keys, tree], device=device)
        else:
            entries = (FACES << (2 * tree.table_bits)) + 1
            wp.launch(find_cells, dim=entries, inputs=[self._order.keys, tree], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        tree = self.tree
        arrays = (tree.leaves, tree.boxes, tree.live, tree.flags, tree.offset, tree.table)
        return sum(int(array.capacity) for array in arrays)
