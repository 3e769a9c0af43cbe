# SPDX-License-Identifier: Apache-2.0
"""Cones around rays: the implicit four-way tree of the paper's variants, in light space.

A node bounds its rays by a cone of directions e = h/|h| (axis and half-angle A, up to pi) and a range of depths t
(``light_space.py``). It is made from its four children, from the bottom up. The shape of the tree depends on the
frame's size only:

- *sorted*: left-balanced over a list, four consecutive rays, then four consecutive nodes (section 3.5 of the paper);
- *unsorted*: 2 x 2 blocks of pixels, then of nodes, like a mip pyramid (section 3.1). Where a level is one pixel wide
  or high, its blocks are four along the other way, so that no shape of image needs more nodes than half its rays.

A list is an image one pixel high, so one code serves both. Rays that do not take part leave holes; nodes without any
ray are *done* from the start, and no triangle enters them.

Angles are never made from the cosine of a dot product, which has no resolution below 3.5e-4 rad: the angle between two
axes is 2 atan2(|a - b|, |a + b|). The half-angle itself is kept, its sine for the tests against planes, and its cosine
only where it is a factor of a length.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.exact.light_frame import SHADOWED
from shadow_tracer.gpu.exact.light_space import LightSpace, ray_depth

# A normalised direction is off by at most 3 u of its own direction and 3 u in length; merging compares two of them.
_LEAF_ANGLE = 3.0e-7
_MERGE_ANGLE = 1.0e-6
_MERGE_FACTOR = 1.0 + 1.0e-5
_PI = 3.1415927410125732  # float32 above pi
# A wider cone may have directions on both sides of every plane: its sine is 2, which no test meets.
_WIDE = 1.57
_NO_SINE = 2.0


@wp.struct
class Leaves:
    """The rays at the bottom. ``ordered``: leaf i is sample order[i], for i < counts[0]; else leaf i is sample i, if
    its group is 1."""

    ordered: int
    rays: wp.array(dtype=wp.vec4)
    group: wp.array(dtype=wp.uint8)
    order: wp.array(dtype=int)
    counts: wp.array(dtype=int)


@wp.struct
class Tree:
    """The nodes, level by level from 1 (parents of rays) to ``top`` (one node)."""

    top: int
    levels: wp.array(dtype=wp.vec4i)  # width, height [nodes], width of a block of children, first node; level 0: rays
    cones: wp.array(dtype=wp.vec4)  # axis, half-angle
    ranges: wp.array(dtype=wp.vec4)  # least t, largest t, sine of the half-angle or 2, cosine
    done: wp.array(dtype=wp.uint8)  # nothing left to find out about any ray of the node


@wp.func
def leaf_sample(leaves: Leaves, leaf: int) -> int:
    """Sample of a leaf, or -1."""
    if leaves.ordered != 0:
        if leaf < leaves.counts[0]:
            return leaves.order[leaf]
        return -1
    if leaves.group[leaf] == wp.uint8(1):
        return leaf
    return -1


@wp.func
def child_of(tree: Tree, level: int, node: int, k: int) -> int:
    """Number, within the level below, of child k (0 to 3) of a node; -1 where the image ends."""
    here = tree.levels[level]
    below = tree.levels[level - 1]
    if here[2] == 4:  # one row; the general form below costs more than a node test
        if 4 * node + k >= below[0]:
            return -1
        return 4 * node + k
    row = node // here[0]
    x = node - row * here[0]
    y = 4 * row + k
    if here[2] == 2:
        x = 2 * x + (k & 1)
        y = 2 * row + (k >> 1)
    if x >= below[0] or y >= below[1]:
        return -1
    return y * below[0] + x


@wp.func
def parent_of(tree: Tree, level: int, node: int) -> int:
    """Number of a node's (or leaf's: level 0) parent within the level above."""
    here = tree.levels[level]
    above = tree.levels[level + 1]
    x = node % here[0]
    y = node // here[0]
    return (y // (4 // above[2])) * above[0] + x // above[2]


@wp.func
def angle_between(a: wp.vec3, b: wp.vec3) -> float:
    """Angle between two unit vectors; keeps its relative precision down to zero."""
    return 2.0 * wp.atan2(wp.length(a - b), wp.length(a + b))


@wp.func
def store_node(tree: Tree, index: int, axis: wp.vec3, angle: float, nearest: float, farthest: float):
    """Write a node; a negative angle means that it has no rays."""
    tree.cones[index] = wp.vec4(axis[0], axis[1], axis[2], angle)
    sine = float(_NO_SINE)
    if angle < _WIDE:
        sine = wp.sin(angle)
    tree.ranges[index] = wp.vec4(nearest, farthest, sine, wp.cos(angle))
    if angle < 0.0:
        tree.done[index] = wp.uint8(1)
    else:
        tree.done[index] = wp.uint8(0)


@wp.func
def merged_angle(widest: float) -> float:
    """Half-angle of a node from the widest child, with room for the roundings of the merge."""
    return wp.min(widest * _MERGE_FACTOR + _MERGE_ANGLE, _PI)


@wp.func
def ray_direction(ray: wp.vec4) -> wp.vec4:
    """(h/|h|, 1/|h|); scaled first, so that squares stay finite."""
    h = wp.vec3(ray[0], ray[1], ray[2])
    size = wp.max(wp.max(wp.abs(h[0]), wp.abs(h[1])), wp.abs(h[2]))
    h = h / size
    length = wp.length(h)
    return wp.vec4(h[0] / length, h[1] / length, h[2] / length, 1.0 / (size * length))


@wp.kernel(enable_backward=False)
def build_parents_of_rays(space: LightSpace, leaves: Leaves, states: wp.array(dtype=wp.uint8), tree: Tree):
    """Level 1: cones around up to four rays; rays already in shadow are left out."""
    node = wp.tid()
    block = tree.levels[1][2]
    children = block * (4 // block)  # four; not a constant, so that the loops stay loops
    total = wp.vec3(0.0, 0.0, 0.0)
    count = int(0)
    nearest = float(wp.inf)
    farthest = -float(wp.inf)
    for k in range(children):
        leaf = child_of(tree, 1, node, k)
        if leaf >= 0:
            sample = leaf_sample(leaves, leaf)
            if sample >= 0:
                if states[sample] != wp.uint8(SHADOWED):
                    ray = leaves.rays[sample]
                    direction = ray_direction(ray)
                    depth = ray_depth(space, ray, direction[3])
                    total += wp.vec3(direction[0], direction[1], direction[2])
                    nearest = wp.min(nearest, depth)
                    farthest = wp.max(farthest, depth)
                    count += 1
    angle = float(-1.0)
    axis = wp.normalize(total)
    if count == 1:
        angle = float(_LEAF_ANGLE)
    if count > 1:
        if wp.length(total) < 1.0e-3:
            angle = float(_PI)
        else:
            for k in range(children):
                leaf = child_of(tree, 1, node, k)
                if leaf >= 0:
                    sample = leaf_sample(leaves, leaf)
                    if sample >= 0:
                        if states[sample] != wp.uint8(SHADOWED):
                            direction = ray_direction(leaves.rays[sample])
                            e = wp.vec3(direction[0], direction[1], direction[2])
                            angle = wp.max(angle, angle_between(axis, e))
            angle = merged_angle(angle)
    store_node(tree, tree.levels[1][3] + node, axis, angle, nearest, farthest)


@wp.kernel(enable_backward=False)
def build_level(level: int, tree: Tree):
    """A level above 1: cones around up to four cones."""
    node = wp.tid()
    block = tree.levels[level][2]
    children = block * (4 // block)
    below = tree.levels[level - 1][3]
    total = wp.vec3(0.0, 0.0, 0.0)
    only = int(-1)
    count = int(0)
    nearest = float(wp.inf)
    farthest = -float(wp.inf)
    for k in range(children):
        child = child_of(tree, level, node, k)
        if child >= 0:
            cone = tree.cones[below + child]
            if cone[3] >= 0.0:
                total += wp.vec3(cone[0], cone[1], cone[2])
                extent = tree.ranges[below + child]
                nearest = wp.min(nearest, extent[0])
                farthest = wp.max(farthest, extent[1])
                only = below + child
                count += 1
    angle = float(-1.0)
    axis = wp.normalize(total)
    if count == 1:
        cone = tree.cones[only]
        axis = wp.vec3(cone[0], cone[1], cone[2])
        angle = cone[3]
    if count > 1:
        if wp.length(total) < 1.0e-3:
            angle = float(_PI)
        else:
            for k in range(children):
                child = child_of(tree, level, node, k)
                if child >= 0:
                    cone = tree.cones[below + child]
                    if cone[3] >= 0.0:
                        between = angle_between(axis, wp.vec3(cone[0], cone[1], cone[2]))
                        angle = wp.max(angle, between + cone[3])
            angle = merged_angle(angle)
    store_node(tree, tree.levels[level][3] + node, axis, angle, nearest, farthest)


@wp.func
def finish(tree: Tree, level: int, node: int):
    """Mark a node as done, and every ancestor all of whose children are."""
    at = int(level)
    index = int(node)
    while index >= 0:
        tree.done[tree.levels[at][3] + index] = wp.uint8(1)
        parent = int(-1)
        if at < tree.top:
            parent = parent_of(tree, at, index)
            block = tree.levels[at + 1][2]
            for k in range(block * (4 // block)):
                child = child_of(tree, at + 1, parent, k)
                if child >= 0:
                    if tree.done[tree.levels[at][3] + child] == wp.uint8(0):
                        parent = int(-1)
                        break
        at += 1
        index = parent


@wp.kernel(enable_backward=False)
def resolve_done(leaves: Leaves, tree: Tree, states: wp.array(dtype=wp.uint8)):
    """Rays below a node that is done are in shadow."""
    leaf = wp.tid()
    sample = leaf_sample(leaves, leaf)
    if sample < 0:
        return
    node = leaf
    for level in range(tree.top):
        node = parent_of(tree, level, node)
        if tree.done[tree.levels[level + 1][3] + node] != wp.uint8(0):
            states[sample] = wp.uint8(SHADOWED)
            return


def tree_shape(width: int, height: int) -> list[tuple[int, int, int, int]]:
    """Rows of ``Tree.levels`` over an image, and a last one whose first node is the number of all nodes."""
    rows = [(width, height, 1, 0)]
    first = 0
    while len(rows) == 1 or width * height > 1:
        block = 4 if height == 1 else 1 if width == 1 else 2
        width, height = -(-width // block), -(-height // (4 // block))
        rows.append((width, height, block, first))
        first += width * height
    rows.append((0, 0, 0, first))
    return rows


class ConeTree:
    """Nodes over the rays of a frame, allocated once."""

    def __init__(self, context: Context) -> None:
        samples = context.samples
        self._samples = samples
        self.capacity_levels = 4 + math.ceil(math.log(max(samples.bounds.max_rays, 2), 4))
        nodes = samples.bounds.max_rays // 2 + 64
        device = samples.device
        self.tree = Tree()
        self.tree.levels = wp.zeros(self.capacity_levels + 1, dtype=wp.vec4i, device=device)
        self.tree.cones = wp.empty(nodes, dtype=wp.vec4, device=device)
        self.tree.ranges = wp.empty(nodes, dtype=wp.vec4, device=device)
        self.tree.done = wp.empty(nodes, dtype=wp.uint8, device=device)
        self._shape: tuple[int, int] = (0, 0)
        self._rows: list[tuple[int, int, int, int]] = []

    def shape(self, as_list: bool) -> None:
        """Lay the levels out for the samples of the frame: as the image they are, or as a list."""
        width = self._samples.count if as_list or self._samples.width == 0 else self._samples.width
        shape = (width, self._samples.count // width)
        if shape != self._shape:
            self._shape = shape
            self._rows = tree_shape(*shape)
            self.tree.top = len(self._rows) - 2
            self._samples.upload(self.tree.levels, np.array(self._rows, dtype=np.int32))

    def build(self, space: LightSpace, leaves: Leaves, states: wp.array) -> None:
        """Make all nodes, over the rays that take part and are not in shadow yet."""
        for level in range(1, self.tree.top + 1):
            nodes = self._rows[level][0] * self._rows[level][1]
            if level == 1:
                inputs = [space, leaves, states, self.tree]
                wp.launch(build_parents_of_rays, dim=nodes, inputs=inputs, device=self._samples.device)
            else:
                wp.launch(build_level, dim=nodes, inputs=[level, self.tree], device=self._samples.device)

    def resolve(self, leaves: Leaves, states: wp.array) -> None:
        """Write SHADOWED to the rays of nodes that are done."""
        inputs = [leaves, self.tree, states]
        wp.launch(resolve_done, dim=self._samples.count, inputs=inputs, device=self._samples.device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        tree = self.tree
        return int(tree.levels.capacity + tree.cones.capacity + tree.ranges.capacity + tree.done.capacity)
