# SPDX-License-Identifier: Apache-2.0
"""Trees over space that are split level by level: which triangle is where meanwhile, and the lists of their leaves.

A *reference* is a triangle in a cell. At a level each is looked at by one thread, and passed on to a child of its cell:
the first child that holds it takes its place, for each other one a reference is appended. Nothing is sorted before the
tree is done; then references are counted by leaf, counts are scanned, and numbers of triangles are scattered.

A tree's nodes are pairs of numbers. Of a leaf they are its first place in ``members`` and its number of triangles; the
second one is times four and LEAF, which inner nodes do not have there. Children lie side by side, node 0 is the root.

How many references, cells and nodes there are at a level is decided on the device. The CPU reads it for the next
level; on CUDA nothing is read, and each level has as many threads as there may be references and cells.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.segment import OUTSIDE
from shadow_tracer.gpu.device import forms, native

# Instead of a cell: that of a triangle that casts nothing.
NOWHERE = wp.constant(-(2**31))
LEAF = wp.constant(3)
native.constants(TREE_LEAF=LEAF)


@wp.struct
class References:
    """Reference r is triangle ``triangle[r]`` in cell ``place[r]`` of the level; in leaf ``~place[r]``, below 0; or
    NOWHERE. There are ``used[k]`` of them when level k begins, and those that are appended count as the next one's.
    ``reserved[0]`` is how many there will be, at most ``room``."""

    triangle: wp.array(dtype=int)
    place: wp.array(dtype=int)
    used: wp.array(dtype=int)
    reserved: wp.array(dtype=int)
    room: int


@wp.kernel(enable_backward=False)
def take_triangles(lowers: wp.array(dtype=wp.vec3), references: References):
    """Those that cast something, into the root. One thread each."""
    i = wp.tid()
    if lowers[i][0] >= OUTSIDE:
        return
    at = wp.atomic_add(references.used, 0, 1)
    references.triangle[at] = i
    references.place[at] = 0


@wp.kernel(enable_backward=False)
def enter_leaves(level: int, references: References, begins: wp.array(dtype=int), members: wp.array(dtype=int)):
    """Count the triangles of each leaf in ``begins``; with ``members``, store them from there on. One thread for each
    reference."""
    r = wp.tid()
    if r >= references.used[level]:
        return
    at = wp.atomic_add(begins, -1 - references.place[r], 1)
    if members.shape[0] > 0:
        members[at] = references.triangle[r]


@wp.kernel(enable_backward=False)
def close_leaves(made: wp.array(dtype=int), start: wp.array(dtype=int), nodes: wp.array(dtype=wp.vec2i)):
    """Write where the triangles of leaves are. One thread for each node."""
    i = wp.tid()
    if i < made[0] and (nodes[i][1] & 3) == LEAF:
        nodes[i] = wp.vec2i(start[i], 4 * (start[i + 1] - start[i]) + LEAF)


@wp.func
def reserve(references: References, more: int) -> bool:
    """Whether there is room for so many references more."""
    before = wp.atomic_add(references.reserved, 0, more)
    fits = before + more <= references.room
    if not fits:
        wp.atomic_sub(references.reserved, 0, more)
    return fits


@wp.func
def append(references: References, level: int, triangle: int, place: int):
    """One more, which has been reserved, for the next level."""
    at = wp.atomic_add(references.used, level + 1, 1)
    references.triangle[at] = triangle
    references.place[at] = place


class Lists:
    """References while a tree is split, and the lists of its leaves.

    Args:
        triangles: the most there may be.
        entries: the most references.
        nodes: the most nodes.
        levels: the most levels.

    Attributes:
        references: where triangles are.
        nodes, members: of the tree.
        made: how many nodes there are; more than fit, if some did not.
    """

    def __init__(self, triangles: int, entries: int, nodes: int, levels: int, device: Any) -> None:
        self._device = device
        entries = max(entries, triangles)
        self.references = References()
        self.references.triangle = wp.empty(entries, dtype=int, device=device)
        self.references.place = wp.empty(entries, dtype=int, device=device)
        self.references.used = wp.zeros(levels + 1, dtype=int, device=device)
        self.references.reserved = wp.zeros(1, dtype=int, device=device)
        self.nodes = wp.zeros(nodes, dtype=wp.vec2i, device=device)
        self.members = wp.empty(entries, dtype=int, device=device)
        self.made = wp.zeros(1, dtype=int, device=device)
        self._begins = wp.empty(nodes + 1, dtype=int, device=device)
        self._start = wp.empty(nodes + 1, dtype=int, device=device)
        self._no_members = wp.empty(0, dtype=int, device=device)

    def begin(self, lowers: wp.array, count: int, room: int) -> None:
        """All of ``count`` triangles in the root; at most ``room`` references, but as many as triangles."""
        self.references.room = max(min(room, self.members.shape[0]), count)
        self.references.used.zero_()
        wp.launch(take_triangles, dim=count, inputs=[lowers, self.references], device=self._device)

    def threads(self, level: int) -> int:
        """One for each reference that there may be when a level begins."""
        if forms.wide(self._device):
            return int(self.references.used.numpy()[level])
        return int(self.references.room)

    def finish(self, level: int, nodes: int) -> None:
        """The lists of all leaves, when ``level`` levels have been made with room for so many nodes; all references
        are in leaves."""
        references, device, threads = self.references, self._device, self.threads(level)
        begins, start = self._begins[: nodes + 1], self._start[: nodes + 1]
        begins.zero_()
        inputs = [level, references, begins]
        wp.launch(enter_leaves, dim=threads, inputs=[*inputs, self._no_members], device=device)
        wp.utils.array_scan(begins, start, inclusive=False)
        wp.copy(begins, start)
        wp.launch(enter_leaves, dim=threads, inputs=[*inputs, self.members], device=device)
        wp.launch(close_leaves, dim=nodes, inputs=[self.made, start, self.nodes], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = [self.references.triangle, self.references.place, self.nodes, self.members, self._begins, self._start]
        return sum(int(array.capacity) for array in arrays)
