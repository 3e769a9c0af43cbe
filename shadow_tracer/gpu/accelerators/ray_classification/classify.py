# SPDX-License-Identifier: Apache-2.0
"""Cells of origins and directions, and the kernels that make the lists of those that rays have asked for."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.segment import OUTSIDE, SceneBox, along
from shadow_tracer.gpu.device import native

LEVELS = 6  # each halves a cell along all five axes
CHILDREN = 32
ROOTS = 6  # the faces of directions
HALF = 129.0 / 128.0  # of the cell of all origins, in units of the scene's extent
FEW = 8  # triangles of a cell that needs no smaller ones
native.constants(RAYS_LEVELS=LEVELS, ORIGIN_HALF=HALF, RAY_CHILDREN=CHILDREN, FEW_CANDIDATES=FEW)
_HALF, _LEVELS = wp.constant(HALF), wp.constant(LEVELS)
_CHILDREN, _ROOTS = wp.constant(CHILDREN), wp.constant(ROOTS)


@wp.struct
class Beam:
    """The cell of a node: the middles of its origins, and of its directions' coordinates on their face, and the face:
    0 to 5 for +x, -x, +y, -y, +z, -z."""

    middle: wp.vec3
    u: float
    v: float
    face: int


@wp.struct
class Structure:
    """A tree whose roots are nodes 0 to 5. The triangles that rays of node k could meet are ``members[first[k]]`` and
    the next ones, ``count[k]`` of them; its children are ``children[32 k + code]``, where it has any: 0 is none, less
    is one that has been asked for. A node at level LEVELS has none. ``asked``: where in ``children`` each node belongs.

    ``made``: how many nodes there are, while they are asked for more than fit, and how many of these have lists.
    ``used``: how many members, how many of these the roots have, whether some did not fit, and whether there were no
    lists but those of the roots before these rays."""

    box: SceneBox
    beams: wp.array(dtype=Beam)
    level: wp.array(dtype=int)
    first: wp.array(dtype=int)
    count: wp.array(dtype=int)
    children: wp.array(dtype=int)
    asked: wp.array(dtype=int)
    members: wp.array(dtype=int)
    made: wp.array(dtype=int)
    used: wp.array(dtype=int)


@wp.kernel(enable_backward=False)
def list_all(lowers: wp.array(dtype=wp.vec3), tree: Structure):
    """Triangles that cast something: the list of all roots, whose number of members ``used[1]`` keeps. One thread
    each."""
    i = wp.tid()
    if lowers[i][0] < OUTSIDE:
        tree.members[wp.atomic_add(tree.used, 1, 1)] = i


@wp.func
def forgets(always: int, tree: Structure) -> bool:
    """Whether lists are to be forgotten: if some did not fit, unless they had just been forgotten."""
    return always != 0 or (tree.used[2] != 0 and tree.used[3] == 0)


@wp.kernel(enable_backward=False)
def forget(always: int, tree: Structure):
    """Nothing has been asked for, if lists are forgotten. One thread per node."""
    k = wp.tid()
    if forgets(always, tree):
        for code in range(_CHILDREN):
            tree.children[_CHILDREN * k + code] = 0


@wp.kernel(enable_backward=False)
def begin(always: int, tree: Structure):
    """The roots, after ``forget``. One thread."""
    forgotten = forgets(always, tree)
    tree.used[2] = 0
    tree.used[3] = wp.where(forgotten or tree.made[0] == _ROOTS, 1, 0)
    if not forgotten:
        return
    for k in range(_ROOTS):
        beam = Beam()
        beam.face = k
        tree.beams[k] = beam
        tree.level[k] = 0
        tree.first[k] = 0
        tree.count[k] = tree.used[1]
    tree.used[0] = tree.used[1]
    tree.made[0] = _ROOTS
    tree.made[1] = _ROOTS


@wp.func
def spans(low: float, high: float, u: float, half: float, nearest: float, farthest: float) -> bool:
    """Whether directions between u - half and u + half get between low and high, at distances along the major axis
    between these two."""
    least = u - half
    most = u + half
    return least * wp.where(least < 0.0, farthest, nearest) <= high and (
        most * wp.where(most < 0.0, nearest, farthest) >= low
    )


@wp.func
def could_meet(beam: Beam, half_origin: float, half: float, lower: wp.vec3, upper: wp.vec3) -> bool:
    """Whether a ray of a cell could meet a box: from an origin in the cell, it is within the box less the cell."""
    size = wp.vec3(half_origin, half_origin, half_origin)
    low = lower - (beam.middle + size)
    high = upper - (beam.middle - size)
    axis = beam.face / 2
    back = beam.face % 2 == 1
    nearest = wp.max(wp.where(back, -along(high, axis), along(low, axis)), 0.0)
    farthest = wp.where(back, -along(low, axis), along(high, axis))
    if farthest < 0.0:
        return False
    one = wp.where(axis < 2, axis + 1, 0)
    two = wp.where(axis > 0, axis - 1, 2)
    return spans(along(low, one), along(high, one), beam.u, half, nearest, farthest) and spans(
        along(low, two), along(high, two), beam.v, half, nearest, farthest
    )


@wp.func
def halved(code: int, bit: int, half: float) -> float:
    """From the middle of a cell to that of one of its halves."""
    return wp.where((code >> bit) & 1 != 0, half, -half)


@wp.func
def reserve(tree: Structure, count: int) -> int:
    """The first of so many new members, -1 if there is no room. No thread takes what does not fit to give it back: what
    another took in between would be taken again."""
    at = int(tree.used[0])
    found = int(-1)
    while found < 0 and at + count <= tree.members.shape[0]:
        before = wp.atomic_cas(tree.used, 0, at, at + count)
        if before == at:
            found = at
        at = before
    return found


@wp.kernel(enable_backward=False)
def make_lists(stride: int, lowers: wp.array(dtype=wp.vec3), uppers: wp.array(dtype=wp.vec3), tree: Structure):
    """Lists of the nodes that have been asked for, from those of their parents. Each thread takes some nodes."""
    node = tree.made[1] + wp.tid()
    while node < wp.min(tree.made[0], tree.level.shape[0]):
        slot = tree.asked[node]
        parent = slot / _CHILDREN
        code = slot % _CHILDREN
        level = tree.level[parent] + 1
        half = 1.0 / float(1 << level)
        half_origin = _HALF * half
        beam = tree.beams[parent]
        beam.middle = beam.middle + wp.vec3(
            halved(code, 0, half_origin), halved(code, 1, half_origin), halved(code, 2, half_origin)
        )
        beam.u += halved(code, 3, half)
        beam.v += halved(code, 4, half)
        first = tree.first[parent]
        count = tree.count[parent]
        few = int(0)
        for k in range(first, first + count):
            if could_meet(beam, half_origin, half, lowers[tree.members[k]], uppers[tree.members[k]]):
                few += 1
        at = first
        if few < count:
            at = reserve(tree, few)
            if at < 0:
                tree.used[2] = 1
                at = first  # the parent's list, which holds more
                few = count
                level = _LEVELS
            else:
                next = at
                for k in range(first, first + count):
                    triangle = tree.members[k]
                    if could_meet(beam, half_origin, half, lowers[triangle], uppers[triangle]):
                        tree.members[next] = triangle
                        next += 1
        tree.beams[node] = beam
        tree.level[node] = level
        tree.first[node] = at
        tree.count[node] = few
        node += stride


@wp.kernel(enable_backward=False)
def link(tree: Structure):
    """Nodes that have got lists are their parents' children. One thread per node."""
    k = wp.tid()
    if k >= tree.made[1] and k < tree.made[0]:
        tree.children[tree.asked[k]] = k


@wp.kernel(enable_backward=False)
def end_round(tree: Structure):
    """All nodes have lists. One thread."""
    if tree.made[0] > tree.level.shape[0]:
        tree.made[0] = tree.level.shape[0]
        tree.used[2] = 1
    tree.made[1] = tree.made[0]
