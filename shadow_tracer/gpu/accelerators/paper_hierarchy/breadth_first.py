# SPDX-License-Identifier: Apache-2.0
"""Triangles through the tree, breadth first with bounded queues: the hybrid scheme of the paper's section 4.2.

Every level has a queue of (triangle, node) pairs whose test did not reject. Work comes in chunks: triangles against the
root, the pairs of a level against the children of their nodes, or, on level 1, against rays. A chunk is one (pair,
child) after the other, no more of them than the queue below has places, and that queue is empty when the chunk starts:
the deepest level with work left always goes first. So nothing ever overflows, at any capacity down to one place, and
with queues that are large enough it is the plain breadth-first traversal.

The device is its own master. On CUDA ``schedule`` (one thread) picks the chunk, ``expand`` (a fixed number of threads)
works on it, and ``wp.capture_while`` repeats both until nothing is left, as part of a graph. On the CPU one thread does
the same in one launch (``traverse``): with queues of one place there are as many chunks as tests.

Early accept (section 3.3): a node that a triangle covers is done, as is one all of whose rays are in shadow or all of
whose children are done. Pairs of a node that is done are dropped when they are expanded (figure 5 of the paper); since
the levels below are empty whenever a node gets done, no ancestors need to be asked. What done means for rays is written
at the end (``cones.resolve_done``), not by the thread that finds out.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.paper_hierarchy.cone_test import (
    COVERED,
    REJECTED,
    Occluder,
    add_planes,
    add_sphere,
    is_never,
    occluder_of,
    test_precise,
    test_sphere,
)
from shadow_tracer.gpu.accelerators.paper_hierarchy.cones import ConeTree, Leaves, Tree, child_of, finish, leaf_sample
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import ACCEPTED, LEAF_TESTS, NODES_VISITED, PASSES, PEAK_QUEUE
from shadow_tracer.gpu.exact.decision import NO, filter_pair, ray_magnitude
from shadow_tracer.gpu.exact.light_frame import LIT, SHADOWED
from shadow_tracer.gpu.exact.light_space import LightSpace
from shadow_tracer.gpu.visibility.answers import Answers, settle

# Places of a level's queue, as a share of the queue of uncertain pairs.
_QUEUE_SHARE = 8
_THREADS_CUDA = 65536


@wp.struct
class Triangles:
    """The triangles, and which of them take part: all (part 0), those whose size is at least ``threshold[0]`` (part 1),
    or the others (part 2)."""

    space: LightSpace
    spheres: int
    part: int
    corners: wp.array(dtype=wp.vec4)
    indices: wp.array(dtype=wp.vec3i)
    records: wp.array2d(dtype=wp.vec4)
    sizes: wp.array(dtype=wp.uint8)
    threshold: wp.array(dtype=int)


@wp.struct
class Work:
    """Queues and what is left to do. The queue of level k is row k."""

    accept: int
    queue: wp.array2d(dtype=wp.vec2i)
    counts: wp.array(dtype=int)  # pairs on each queue
    begun: wp.array(dtype=int)  # (pair, child) of each queue that are done, or belong to the chunk
    chunk: wp.array(dtype=int)  # level, first, last of the chunk; next triangle; level of the root
    running: wp.array(dtype=int)


@wp.struct
class Tally:
    """What one thread counts."""

    nodes: wp.int64
    leaves: wp.int64
    accepted: wp.int64


@wp.kernel(enable_backward=False)
def begin(tree: Tree, leaves: Leaves, work: Work, counters: wp.array2d(dtype=wp.int64)):
    """Nothing done yet. The root of a list is the lowest node that holds all its rays."""
    root = tree.top
    if leaves.ordered != 0:
        root = int(1)
        reach = int(4)
        while reach < leaves.counts[0]:
            reach = reach * 4
            root += 1
    for level in range(work.counts.shape[0]):
        work.counts[level] = 0
        work.begun[level] = 0
    for k in range(work.chunk.shape[0]):
        work.chunk[k] = 0
    work.chunk[4] = root
    work.running[0] = 1
    counters[0, PASSES] = counters[0, PASSES] + wp.int64(1)


@wp.func
def choose_chunk(triangle_count: int, tree: Tree, work: Work, counters: wp.array2d(dtype=wp.int64)):
    """Choose the next chunk: of the deepest level that has work left, at last of the triangles."""
    root = work.chunk[4]
    capacity = work.queue.shape[1]
    level = int(1)
    while level <= root and work.begun[level] >= 4 * work.counts[level]:
        level += 1
    # The queue that the last chunk filled is the deepest with work.
    if level <= root:
        counters[0, PEAK_QUEUE] = wp.max(counters[0, PEAK_QUEUE], wp.int64(work.counts[level]))
    first = int(0)
    last = int(0)
    if level <= root:
        first = work.begun[level]
        last = 4 * work.counts[level]
        if level > 1:
            last = wp.min(last, first + capacity)
        work.begun[level] = last
    elif tree.done[tree.levels[root][3]] == wp.uint8(0):
        first = work.chunk[3]
        last = triangle_count
        if last - first > capacity:
            last = first + capacity
        work.chunk[3] = last
    work.chunk[0] = level
    work.chunk[1] = first
    work.chunk[2] = last
    if first == last:
        work.running[0] = 0
    elif level > 1:
        work.counts[level - 1] = 0
        work.begun[level - 1] = 0


@wp.func
def see(triangles: Triangles, triangle: int) -> Occluder:
    """The triangle for node tests."""
    occluder = occluder_of(triangles.space, triangles.corners, triangles.indices, triangle)
    if triangles.spheres != 0:
        return add_sphere(occluder)
    return add_planes(occluder, triangles.space, triangles.records, triangle)


@wp.func
def enter(
    triangle: int, occluder: Occluder, spheres: int, level: int, node: int, tree: Tree, work: Work, tally: Tally
) -> Tally:
    """Test a triangle against a node and put the pair on the node's queue unless it is settled."""
    index = tree.levels[level][3] + node
    if tree.done[index] != wp.uint8(0):
        return tally
    tally.nodes += wp.int64(1)
    answer = int(0)
    if spheres != 0:
        answer = test_sphere(occluder, tree.cones[index], tree.ranges[index])
    else:
        answer = test_precise(occluder, tree.cones[index], tree.ranges[index])
    if answer == REJECTED:
        return tally
    if answer == COVERED and work.accept != 0:
        tally.accepted += wp.int64(1)
        finish(tree, level, node)
        return tally
    slot = wp.atomic_add(work.counts, level, 1)
    work.queue[level, slot] = wp.vec2i(triangle, node)
    return tally


@wp.func
def meet_rays(
    triangle: int, node: int, triangles: Triangles, tree: Tree, leaves: Leaves, work: Work, answers: Answers
) -> int:
    """Show a triangle to the rays of a node of level 1; returns the number of tests."""
    tests = int(0)
    open = int(0)
    block = tree.levels[1][2]
    for k in range(block * (4 // block)):
        leaf = child_of(tree, 1, node, k)
        sample = int(-1)
        if leaf >= 0:
            sample = leaf_sample(leaves, leaf)
        if sample >= 0:
            if answers.states[sample] == wp.uint8(LIT):
                ray = leaves.rays[sample]
                answer = filter_pair(ray, ray_magnitude(ray), triangles.records, triangle)
                tests += 1
                if answer != NO:
                    settle(sample, triangle, answer, answers)
            if answers.states[sample] != wp.uint8(SHADOWED):
                open += 1
    if open == 0 and work.accept != 0:
        finish(tree, 1, node)
    return tests


@wp.func
def enter_root(t: int, root: int, triangles: Triangles, tree: Tree, work: Work, tally: Tally) -> Tally:
    """A triangle of the part that is traced, against the root."""
    if is_never(triangles.records, t):
        return tally
    if triangles.part != 0:
        large = int(triangles.sizes[t]) >= triangles.threshold[0]
        if large != (triangles.part == 1):
            return tally
    return enter(t, see(triangles, t), triangles.spheres, root, 0, tree, work, tally)


@wp.func
def expand_chunk(
    thread: int,
    stride: int,
    triangles: Triangles,
    tree: Tree,
    leaves: Leaves,
    work: Work,
    answers: Answers,
    tally: Tally,
) -> Tally:
    """Work on the chunk, as one of ``stride`` threads."""
    level = work.chunk[0]
    first = work.chunk[1]
    last = work.chunk[2]
    root = work.chunk[4]
    if level > root:
        for t in range(first + thread, last, stride):
            tally = enter_root(t, root, triangles, tree, work, tally)
    else:
        for k in range(first // 4 + thread, (last + 3) // 4, stride):
            pair = work.queue[level, k]
            if tree.done[tree.levels[level][3] + pair[1]] == wp.uint8(0):
                if level == 1:
                    tests = meet_rays(pair[0], pair[1], triangles, tree, leaves, work, answers)
                    tally.leaves += wp.int64(tests)
                else:
                    occluder = see(triangles, pair[0])
                    for unit in range(wp.max(first, 4 * k), wp.min(last, 4 * k + 4)):
                        child = child_of(tree, level, pair[1], unit - 4 * k)
                        if child >= 0:
                            tally = enter(pair[0], occluder, triangles.spheres, level - 1, child, tree, work, tally)
    return tally


@wp.func
def report(thread: int, tally: Tally, counters: wp.array2d(dtype=wp.int64)):
    """Add a thread's counts to the frame's."""
    row = thread & 63
    if tally.nodes > wp.int64(0):
        wp.atomic_add(counters, row, NODES_VISITED, tally.nodes)
    if tally.leaves > wp.int64(0):
        wp.atomic_add(counters, row, LEAF_TESTS, tally.leaves)
    if tally.accepted > wp.int64(0):
        wp.atomic_add(counters, row, ACCEPTED, tally.accepted)


@wp.kernel(enable_backward=False)
def schedule(triangle_count: int, tree: Tree, work: Work, counters: wp.array2d(dtype=wp.int64)):
    choose_chunk(triangle_count, tree, work, counters)


@wp.kernel(enable_backward=False)
def expand(stride: int, triangles: Triangles, tree: Tree, leaves: Leaves, work: Work, answers: Answers):
    thread = wp.tid()
    tally = expand_chunk(thread, stride, triangles, tree, leaves, work, answers, Tally())
    report(thread, tally, answers.counters)


@wp.kernel(enable_backward=False)
def traverse(triangle_count: int, triangles: Triangles, tree: Tree, leaves: Leaves, work: Work, answers: Answers):
    """``schedule`` and ``expand``, one thread, until nothing is left."""
    tally = Tally()
    while work.running[0] != 0:
        choose_chunk(triangle_count, tree, work, answers.counters)
        tally = expand_chunk(0, 1, triangles, tree, leaves, work, answers, tally)
    report(0, tally, answers.counters)


class BreadthFirst:
    """Queues and the loop over them, allocated once for trees of up to ``levels`` levels."""

    def __init__(self, context: Context, levels: int, accept: bool) -> None:
        samples = context.samples
        self._device = samples.device
        capacity = max(1, samples.bounds.queue_capacity // _QUEUE_SHARE)
        self._work = Work()
        self._work.accept = int(accept)
        self._work.queue = wp.empty((levels, capacity), dtype=wp.vec2i, device=samples.device)
        self._work.counts = wp.zeros(levels, dtype=int, device=samples.device)
        self._work.begun = wp.zeros(levels, dtype=int, device=samples.device)
        self._work.chunk = wp.zeros(5, dtype=int, device=samples.device)
        self._work.running = wp.zeros(1, dtype=int, device=samples.device)

    def run(self, triangles: Triangles, count: int, cones: ConeTree, leaves: Leaves, answers: Answers) -> None:
        """Show the first ``count`` triangles, as far as they take part, to the rays of the tree."""
        tree, work, device = cones.tree, self._work, self._device
        wp.launch(begin, dim=1, inputs=[tree, leaves, work, answers.counters], device=device)
        if forms.wide(device):
            wp.launch(traverse, dim=1, inputs=[count, triangles, tree, leaves, work, answers], device=device)
            return
        inputs = [count, tree, work, answers.counters]
        choose = wp.launch(schedule, dim=1, inputs=inputs, device=device, record_cmd=True)
        threads = forms.tasks(device, _THREADS_CUDA)
        inputs = [threads, triangles, tree, leaves, work, answers]
        go = wp.launch(expand, dim=threads, inputs=inputs, device=device, record_cmd=True)

        def body() -> None:
            choose.launch()
            go.launch()

        wp.capture_while(work.running, body)

    def nbytes(self) -> int:
        """Bytes on the device."""
        work = self._work
        arrays = (work.queue, work.counts, work.begun, work.chunk, work.running)
        return sum(int(array.capacity) for array in arrays)
