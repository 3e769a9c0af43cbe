# SPDX-License-Identifier: Apache-2.0
"""The ray tree of variant ``linear``: boxes of cubified direction with a range of depth.

Rays are sorted by direction (``ray_keys.py``); 2^log_leaf consecutive ones are a leaf, 2^log_branch consecutive nodes
have one parent: an implicit, left-balanced tree. On the CPU both are 16, so that one go of the vector registers tests
all children of a node, or all rays of a leaf; on CUDA a leaf is a warp's 32 rays and the tree is four-way.

A node bounds r = h/|h|_inf by centre and half extent, and the depth t by its range (``light_space.py``): every test is
linear in it. There is no angle, no wide-angle case and no single-ray case, and a node whose rays lie on several cube
faces is just a large box. Directions are within 3 u of exact (``light_space.is_wild`` sees to it); the half extent is
padded by 8 u at each level for that and for its own roundings, depths by 8 u relative.

Boxes lie in groups of siblings, each quantity of all siblings together: [group][cu cv cw eu ev ew tmin tmax][sibling].
A node without live rays has half extents of -1e30, which fails every edge test by far.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.participants import Participants
from shadow_tracer.gpu.accelerators.ray_keys import CURVE_BITS, RayOrder
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.decision import ray_magnitude
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, LightSpace, ray_depth, space_of

QUANTITIES = 8
GONE = -1.0e30
_PAD = 2.0**-21
_MOST_TABLE_BITS = 8


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
    flags: wp.array(dtype=int)  # DONE and ACCEPTED, see descent.py
    offset: wp.array(dtype=int)
    table: wp.array(dtype=int)  # first ray of each cell, in key order; one more at the end
    fit: wp.array(dtype=wp.vec4)
    counts: wp.array(dtype=int)
    visits: wp.array(dtype=int)  # times each node was looked at, if it has room for them (``count_visits``)


@wp.func
def store_box(tree: RayTree, node: int, low: wp.vec3, high: wp.vec3, nearest: float, farthest: float):
    """Write the box of node number ``node``; high < low says that it has no rays."""
    branch = 1 << tree.log_branch
    base = (node >> tree.log_branch) * QUANTITIES * branch + (node & (branch - 1))
    if high[0] < low[0]:
        for k in range(QUANTITIES):
            tree.boxes[base + k * branch] = wp.where(k >= 3 and k < 6, GONE, 0.0)
        return
    for k in range(3):
        tree.boxes[base + k * branch] = 0.5 * (low[k] + high[k])
        tree.boxes[base + (3 + k) * branch] = 0.5 * (high[k] - low[k]) + _PAD
    tree.boxes[base + 6 * branch] = nearest
    tree.boxes[base + 7 * branch] = farthest


@wp.kernel(enable_backward=False)
def make_leaves(light: wp.array(dtype=LightFrame), rays: wp.array(dtype=wp.vec4), tree: RayTree):
    """Copy the rays of a leaf together and bound them. One thread per leaf that could be used."""
    leaf = wp.tid()
    space = space_of(light[0])
    size = 1 << tree.log_leaf
    first = leaf << tree.log_leaf
    low = wp.vec3(2.0, 2.0, 2.0)
    high = wp.vec3(-2.0, -2.0, -2.0)
    nearest = float(wp.inf)
    farthest = float(-wp.inf)
    live = int(0)
    for j in range(size):
        to = leaf * 5 * size + j
        if first + j < tree.counts[0]:
            ray = rays[tree.order[first + j]]
            inverse = 1.0 / wp.max(wp.max(wp.abs(ray[0]), wp.abs(ray[1])), wp.abs(ray[2]))
            direction = wp.vec3(ray[0] * inverse, ray[1] * inverse, ray[2] * inverse)
            depth = ray_depth(space, ray, inverse)
            low = wp.min(low, direction)
            high = wp.max(high, direction)
            nearest = wp.min(nearest, depth)
            farthest = wp.max(farthest, depth)
            live = live | (1 << j)
            for k in range(4):
                tree.leaves[to + k * size] = ray[k]
            tree.leaves[to + 4 * size] = ray_magnitude(ray)
    nearest -= _PAD * wp.abs(nearest)
    farthest += _PAD * wp.abs(farthest)
    tree.live[leaf] = live
    tree.flags[leaf] = 0
    store_box(tree, leaf, low, high, nearest, farthest)


# make_leaves for 16 rays a leaf, in the CPU's vector registers. Minima are found by halving: a running minimum would
# have to be taken in order.
@wp.func_native(
    r"""
#if !defined(__CUDA_ARCH__)
    const int n = tree.counts.data[0];
    float* out = tree.leaves.data + 80 * (size_t)leaf;
    float *U = out, *V = out + 16, *W = out + 32, *Z = out + 48, *M = out + 64;
    const int first = 16 * leaf;
    const int used = n - first < 16 ? n - first : 16;
    float* box = tree.boxes.data + 128 * (size_t)(leaf / 16) + leaf % 16;
    tree.flags.data[leaf] = 0;
    tree.live.data[leaf] = used > 0 ? (1 << used) - 1 : 0;
    if (used <= 0) {
        for (int k = 0; k < 8; ++k)
            box[16 * k] = k >= 3 && k < 6 ? -1.0e30f : 0.0f;
        return;
    }
    for (int j = 0; j < 16 && first + 64 + j < n; ++j)
        __builtin_prefetch(rays.data + tree.order.data[first + 64 + j]);
    for (int j = 0; j < 16; ++j) {
        // Lanes without a ray repeat the first one, and are not live.
        const wp::vec4 ray = rays.data[tree.order.data[first + (j < used ? j : 0)]];
        U[j] = ray[0]; V[j] = ray[1]; W[j] = ray[2]; Z[j] = ray[3];
    }
    float least[4][16], most[4][16];
    const float inverse_mode = space.inverse ? 1.0f : 0.0f;
    for (int j = 0; j < 16; ++j) {
        const float u = fabsf(U[j]), v = fabsf(V[j]), w = fabsf(W[j]);
        M[j] = u + v + fabsf(Z[j]) + 0x1p-20f;
        float size = u > v ? u : v;
        size = size > w ? size : w;
        const float inverse = 1.0f / size;
        least[0][j] = most[0][j] = U[j] * inverse;
        least[1][j] = most[1][j] = V[j] * inverse;
        least[2][j] = most[2][j] = W[j] * inverse;
        least[3][j] = most[3][j] = (inverse_mode * 1.0f + (1.0f - inverse_mode) * Z[j]) * inverse;
    }
    for (int k = 0; k < 4; ++k) {
        for (int half = 8; half > 0; half /= 2)
            for (int j = 0; j < half; ++j) {
                least[k][j] = least[k][j] < least[k][j + half] ? least[k][j] : least[k][j + half];
                most[k][j] = most[k][j] > most[k][j + half] ? most[k][j] : most[k][j + half];
            }
        if (k < 3) {
            box[16 * k] = 0.5f * (least[k][0] + most[k][0]);
            box[16 * (3 + k)] = 0.5f * (most[k][0] - least[k][0]) + 0x1p-21f;
        }
    }
    box[16 * 6] = least[3][0] - 0x1p-21f * fabsf(least[3][0]);
    box[16 * 7] = most[3][0] + 0x1p-21f * fabsf(most[3][0]);
#endif
    """
)
def make_leaf(leaf: int, space: LightSpace, rays: wp.array(dtype=wp.vec4), tree: RayTree):
    """``make_leaves`` for one leaf of 16 rays."""
    ...


@wp.kernel(enable_backward=False)
def make_leaves_wide(light: wp.array(dtype=LightFrame), rays: wp.array(dtype=wp.vec4), tree: RayTree):
    make_leaf(wp.tid(), space_of(light[0]), rays, tree)


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


@wp.func_native(
    r"""
    const int count = tree.counts.data[0], shift = 2 * (14 - tree.table_bits), last = 6 << (2 * tree.table_bits);
    int entry = 0;
    for (int i = 0; i < count; ++i)
        for (const int cell = keys.data[i] >> shift; entry <= cell; ++entry)
            tree.table.data[entry] = i;
    for (; entry <= last; ++entry)
        tree.table.data[entry] = count;
    """
)
def sweep(keys: wp.array(dtype=int), tree: RayTree):
    """The lookup table in one sweep over the keys."""
    ...


@wp.kernel(enable_backward=False)
def sweep_cells(keys: wp.array(dtype=int), tree: RayTree):
    """``find_cells`` by one thread: for the CPU."""
    sweep(keys, tree)


class RayTreeBuffers:
    """Owns the tree's memory and builds it."""

    def __init__(self, context: Context, order: RayOrder, participants: Participants, wide: bool) -> None:
        self._context = context
        self._order = order
        self.wide = wide
        device, rays = context.frame.device, context.frame.bounds.max_rays
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
        tree.leaves = wp.empty(self._offsets[1] * 5 << log_leaf, dtype=float, device=device)
        tree.order = order.order
        tree.boxes = wp.empty(total * QUANTITIES, dtype=float, device=device)
        tree.live = wp.empty(total, dtype=int, device=device)
        tree.flags = wp.empty(total, dtype=int, device=device)
        tree.offset = wp.array(self._offsets, dtype=int, device=device)
        tree.table = wp.empty((FACES << (2 * _MOST_TABLE_BITS)) + 1, dtype=int, device=device)
        tree.fit = order.fit
        tree.counts = participants.counts
        tree.visits = wp.empty(0, dtype=int, device=device)
        self.tree = tree

    def count_visits(self) -> wp.array:
        """From now on count how often each node is looked at (not in the wide form of the descent): for pictures.
        Returns the counts, which the caller clears."""
        self.tree.visits = wp.zeros(self._offsets[-1], dtype=int, device=self._context.frame.device)
        return self.tree.visits

    def build(self, light: int) -> None:
        """Leaves, boxes and lookup table over the rays in ``order``; the launches depend on the number of samples
        alone."""
        buffers, tree = self._context.frame, self.tree
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
