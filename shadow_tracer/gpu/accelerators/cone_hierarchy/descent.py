# SPDX-License-Identifier: Apache-2.0
"""How a triangle goes through the ray tree of variant ``linear``.

A node is rejected when one of the triangle's four planes has all of its box on the wrong side, when the box lies beside
the triangle's own bounds on a cube face, or when even its least depth is beyond the triangle's largest (nothing of the
triangle is nearer to the light). It is accepted whole when all four planes have all of it on the right side. The pads
are derived in ``light_space.py``. What is left in the leaves goes through the filter of ``decision.py``.

Nodes without live rays are done: their boxes fail every test. When the last live ray of a leaf, or the last live child
of a node, is done, so is the leaf or the node: a wall of many triangles ends the search under it as one triangle would.

What judges boxes (``triangle.h``) and rays is one text; the walk has two forms. ``descent16.h`` is for the CPU: sixteen
boxes or rays at a time, masks of survivors on a small stack, and nodes that are accepted are finished at once, down to
their rays. ``descent.h`` is what a CUDA thread does: one box at a time, no stack, only a position and a level. A node
that is accepted gets a flag that the output stage reads. A triangle that may touch more than ``SMALL_RUN`` leaves in a
row is left to a second kernel, which gives each chunk of 64 leaves to another thread, so that no thread walks a wall
alone. Bits and flags only ever go one way, and a stale read of one, or of a box, costs a test, never an answer.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.cone_hierarchy.boxes import WHOLE, RayTree
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.counters import PASSES
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import SHADOWED, LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, space_of
from shadow_tracer.gpu.visibility.answers import Answers

# Leaves per run that one thread walks, and leaves per chunk of a larger triangle: 4^3.
SMALL_RUN = wp.constant(64)
CHUNK_LEVEL = wp.constant(3)


@native.func_native("accelerators/cone_hierarchy/descent.h", calls="Descent::small")
def descend_small(
    thread: int,
    small_run: int,
    space: LightSpace,
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
) -> bool:
    """Triangle number ``thread`` from its own cells; True if nothing was done because it is too large."""
    ...


@native.func_native("accelerators/cone_hierarchy/descent.h", calls="Descent::large")
def descend_chunk(
    thread: int,
    triangle: int,
    chunk: int,
    chunk_level: int,
    space: LightSpace,
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
):
    """A triangle through chunk number ``chunk`` of the leaves."""
    ...


@wp.kernel(enable_backward=False)
def descend_triangles(
    light: wp.array(dtype=LightFrame),
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
    big: wp.array(dtype=int),
    big_count: wp.array(dtype=int),
):
    """One thread per triangle; the large ones go to the list ``big``."""
    t = wp.tid()
    if t == 0:
        wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    if descend_small(t, SMALL_RUN, space_of(light[0]), tree, occluders, answers):
        big[wp.atomic_add(big_count, 0, 1)] = t


@wp.kernel(enable_backward=False)
def descend_big(
    stride: int,
    light: wp.array(dtype=LightFrame),
    tree: RayTree,
    occluders: Occluders,
    answers: Answers,
    big: wp.array(dtype=int),
    big_count: wp.array(dtype=int),
):
    """Large triangles, one (chunk, triangle) after the other; neighbouring threads share a chunk."""
    thread = wp.tid()
    space = space_of(light[0])
    rays_per_chunk = 1 << (tree.log_leaf + CHUNK_LEVEL * tree.log_branch)
    chunks = (tree.counts[0] + rays_per_chunk - 1) // rays_per_chunk
    count = wp.int64(big_count[0])
    k = wp.int64(thread)
    while k < count * wp.int64(chunks):
        triangle = big[int(k % count)]
        descend_chunk(
            thread,
            triangle,
            int(k // count),
            CHUNK_LEVEL,
            space,
            tree,
            occluders,
            answers,
        )
        k += wp.int64(stride)


@wp.kernel(enable_backward=False)
def write_accepted(tree: RayTree, states: wp.array(dtype=wp.uint8)):
    """The output stage: rays under an accepted node are in shadow. One thread per ray."""
    i = wp.tid()
    if i >= tree.counts[0]:
        return
    node = i >> tree.log_leaf
    for level in range(tree.levels):
        if (tree.flags[tree.offset[level] + node] & WHOLE) != 0:
            states[tree.order[i]] = wp.uint8(SHADOWED)
            return
        node = node >> tree.log_branch


# For CUDA the body is left out: no kernel launches it there.
@native.func_native("accelerators/cone_hierarchy/descent16.h", calls="Descent::all")
def descend_all(space: LightSpace, tree: RayTree, occluders: Occluders, answers: Answers):
    """All triangles, one after the other."""
    ...


@wp.kernel(enable_backward=False)
def descend_wide(light: wp.array(dtype=LightFrame), tree: RayTree, occluders: Occluders, answers: Answers):
    """One thread."""
    wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    descend_all(space_of(light[0]), tree, occluders, answers)
