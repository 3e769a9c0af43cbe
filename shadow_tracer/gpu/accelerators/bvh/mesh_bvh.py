# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over the triangles (``wp.Bvh``), rays walk through it.

Warp's own mesh query is not exact, for two reasons: its box test rounds (rays aimed at vertices and edges of a closed
mesh leak), and its triangle test is float32 from the sample's side. Here the tree only proposes triangles, the shadow
test decides, and the boxes are padded so that no rounding can hide a triangle:

Let E be the largest coordinate of the scene's box around its centre O. Boxes are made in float64 relative to O in units
of E, padded by 2^-19 and rounded outwards. A ray is clipped to the (padded) box of the scene in float64 first, so that
its float32 start lies within E and its length within 2 sqrt(3) E. With u = 2^-24, start and direction then displace a
point of the ray by at most 5 u E per axis, and the slab test's three roundings displace a slab by at most 3 u * 2 E;
together 11 u E, and the padding is 32 u E. Direction components below 1e-20 are replaced by 1e-20, so 1/0 and 0 *
infinity cannot occur; that displaces a point by less than 1e-19 E. Clipping rounds by 2^-50 of the sample's distance
from O; a sample farther away than 2^26 E, where that would eat the padding, is shown every triangle instead.

The tree is refitted while only positions change. A mesh that comes or goes leaves the triangles of others where they
are, so the tree is refitted then, too, as long as no more than an eighth of the triangles have been replaced since it
was built and there are boxes for all: where there are several meshes, a tree has some to spare. Boxes without a
triangle lie apart from each other outside of the scene, where no ray meets them. A refitted tree grows worse as things
move, so it is rebuilt as well once rays test twice as many triangles as they did right after the last build. Variant
``rebuild`` rebuilds always; ``binary`` is ``refit`` without the wide form of the tree that the CPU uses.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.bvh.binary_tree import FOUND, Candidates, search
from shadow_tracer.gpu.accelerators.bvh.boxes import PADDING, SceneBox, empty_boxes, holds, scene_box, triangle_boxes
from shadow_tracer.gpu.accelerators.bvh.wide_tree import BOUNDS_PER_NODE, LINKS_PER_NODE, collapse, search_wide
from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import LEAF_TESTS, NODES_VISITED
from shadow_tracer.gpu.exact.decision import YES, filter_pair, is_ray, ray_magnitude
from shadow_tracer.gpu.exact.light_frame import LIT, PENDING, SHADOWED, towards_light
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.occluders.slots import Ranges
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.visibility.queue import enqueue, test_everything

# Samples farther from the scene's centre than this many scene sizes do not use the tree.
_FAR = 2.0**26
# Boxes to spare: one for so many triangles, and these; and the share of triangles that may be replaced, or boxes that
# may hold nothing, before the tree is built again.
_TRIANGLES_PER_SPARE, _SPARES = 64, 32
_REPLACED = 1 / 8
# A refitted tree whose rays test this many times the triangles they tested after the last build is built again.
_WORN_OUT = 2.0


# State, pairs queued so far, triangles tested, nodes visited, and the occluder or -1.
Outcome = wp.types.vector(length=5, dtype=wp.int32)


@wp.struct
class Tree:
    """The tree, its box, and the wide form of it (if ``wide`` is not 0)."""

    bvh: wp.uint64
    wide: int
    bounds: wp.array(dtype=float)
    links: wp.array(dtype=int)
    box: SceneBox


@wp.func
def clip_axis(span: wp.vec2d, start: wp.float64, way: wp.float64, half: wp.float64) -> wp.vec2d:
    """Part of the parameter interval ``span`` in which start + t * way lies within +-half."""
    if wp.abs(way) < wp.float64(1.0e-20):
        if wp.abs(start) > half:
            return wp.vec2d(wp.float64(1.0), wp.float64(-1.0))
        return span
    t0 = (-half - start) / way
    t1 = (half - start) / way
    return wp.vec2d(wp.max(span[0], wp.min(t0, t1)), wp.min(span[1], wp.max(t0, t1)))


@wp.func
def away_from_zero(x: wp.float64) -> float:
    """``x`` as float32, but never so small that its reciprocal is infinite."""
    y = float(x)
    if wp.abs(y) < 1.0e-20:
        y = 1.0e-20
    return y


@wp.func
def look(
    origin: wp.vec3,
    direction: wp.vec3,
    longest: float,
    count: int,
    tree: Tree,
    records: wp.array2d(dtype=wp.vec4),
    ray: wp.vec4,
    magnitude: float,
    skip: int,
) -> Candidates:
    """``search`` in the form of the tree that there is."""
    if tree.wide != 0:
        return search_wide(
            tree.bvh, tree.bounds, tree.links, origin, direction, longest, records, ray, magnitude, count, skip
        )
    return search(tree.bvh, origin, direction, longest, records, ray, magnitude, count, skip)


@wp.func
def walk_ray(
    sample: int,
    start: wp.vec3d,
    way: wp.vec4d,
    ray: wp.vec4,
    magnitude: float,
    queued: int,
    triangle_count: int,
    tree: Tree,
    records: wp.array2d(dtype=wp.vec4),
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
) -> Outcome:
    """(state, pairs queued so far, tests, nodes, occluder or -1) of a ray that starts at ``start`` (from the box's
    centre, in units of its extent) and goes ``way`` (unit direction, length [m]); its first ``queued`` uncertain pairs
    are skipped."""
    span = wp.vec2d(wp.float64(0.0), way[3] * tree.box.inverse_extent)
    span = clip_axis(span, start[0], way[0], tree.box.half[0])
    span = clip_axis(span, start[1], way[1], tree.box.half[1])
    span = clip_axis(span, start[2], way[2], tree.box.half[2])
    result = int(LIT)
    tests = int(0)
    nodes = int(0)
    occluder = int(-1)
    if span[0] <= span[1]:
        entry = start + wp.vec3d(way[0], way[1], way[2]) * span[0]
        origin = wp.vec3(float(entry[0]), float(entry[1]), float(entry[2]))
        direction = wp.vec3(away_from_zero(way[0]), away_from_zero(way[1]), away_from_zero(way[2]))
        longest = float((span[1] - span[0]) * wp.float64(1.0001) + wp.float64(PADDING))
        more = bool(True)
        while more:
            found = look(origin, direction, longest, triangle_count, tree, records, ray, magnitude, queued)
            tests += found[1]
            nodes += found[2]
            more = False
            if found[0] < 0:
                all = test_everything(sample, ray, magnitude, queued, 0, triangle_count, records, queue, queue_count)
                return Outcome(all[0], all[1], tests + all[2], nodes, -1)
            if found[0] > 0:
                result = SHADOWED
                occluder = found[4]
            else:
                for k in range(wp.min(found[3] - queued, FOUND)):
                    if result == LIT:
                        if enqueue(sample, found[4 + k], queue, queue_count):
                            queued += 1
                        else:
                            result = PENDING
                more = result == LIT and queued < found[3]
    return Outcome(result, queued, tests, nodes, occluder)


@wp.kernel(enable_backward=False)
def walk(
    attempt: int,
    triangle_count: int,
    tree: Tree,
    light: wp.vec4d,
    samples: wp.array(dtype=wp.vec4d),
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
    resume: wp.array(dtype=int),
    occluders: wp.array(dtype=int),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """One ray per thread; ``attempt`` as in ``brute_force.py``."""
    i = wp.tid()
    state = states[i]
    ray = rays[i]
    if not is_ray(state, ray) or (attempt > 0 and state != wp.uint8(PENDING)):
        return
    queued = int(0)
    if attempt == 2:
        queued = resume[i]
    magnitude = ray_magnitude(ray)
    sample = samples[i]
    p = wp.vec3d(sample[0], sample[1], sample[2])
    # What hid the neighbour mostly hides this sample too. Any triangle may be tried: a stale hint costs a test, no bit.
    hint = occluders[wp.max(i - 1, 0)]
    start = (p - tree.box.center) * tree.box.inverse_extent
    if wp.max(wp.max(wp.abs(start[0]), wp.abs(start[1])), wp.abs(start[2])) > wp.float64(_FAR):
        all = test_everything(i, ray, magnitude, queued, 0, triangle_count, records, queue, queue_count)
        found = Outcome(all[0], all[1], all[2], 0, -1)
    elif hint < triangle_count and filter_pair(ray, magnitude, records, hint) == YES:
        found = Outcome(SHADOWED, queued, 1, 0, hint)
    else:
        way = towards_light(p, light)
        found = walk_ray(i, start, way, ray, magnitude, queued, triangle_count, tree, records, queue, queue_count)
    occluders[i] = hint
    if found[4] >= 0:
        occluders[i] = found[4]
    if found[0] == PENDING:
        resume[i] = found[1]
    states[i] = wp.uint8(found[0])
    wp.atomic_add(counters, i & 63, LEAF_TESTS, wp.int64(found[2]))
    wp.atomic_add(counters, i & 63, NODES_VISITED, wp.int64(found[3]))


class MeshBvh:
    """The ``mesh_bvh`` pipeline."""

    recordable = False
    lights_together = 1
    keeps_rays = False

    def __init__(self, variant: str, context: Context) -> None:
        self._variant = variant
        self._context = context
        self._lowers = wp.empty(context.frame.bounds.max_triangles, dtype=wp.vec3, device=context.frame.device)
        self._uppers = wp.empty(context.frame.bounds.max_triangles, dtype=wp.vec3, device=context.frame.device)
        self._occluders = wp.zeros(context.frame.bounds.max_rays, dtype=int, device=context.frame.device)
        # Of the builders Warp offers on the CPU, cuBQL's is the fastest and its trees are as good as SAH's; on CUDA
        # only LBVH can be rebuilt on the device.
        self._constructor = "cubql" if context.frame.device.is_cpu else "lbvh"
        self._bvh: wp.Bvh | None = None
        # Vector registers make eight boxes as cheap as one on the CPU; CUDA threads walk the binary tree.
        self._widens = forms.wide(context.frame.device) and variant != "binary"
        nodes = max(1024, context.frame.bounds.max_triangles // 4) if self._widens else 1
        self._tree = Tree()
        self._tree.bounds = wp.empty(nodes * BOUNDS_PER_NODE, dtype=float, device=context.frame.device)
        self._tree.links = wp.empty(nodes * LINKS_PER_NODE, dtype=int, device=context.frame.device)
        self._wide_nodes = wp.zeros(1, dtype=int, device=context.frame.device)
        self._made_for: Revision | None = None
        self._built_count = 0  # boxes
        self._replaced = 0  # triangles since the last build
        self._held: tuple[np.ndarray, np.ndarray] | None = None  # what the tree's box was made to hold
        self._fresh_tests: float | None = None  # tests per ray of the first frame after a build
        self._worn_out = False

    def follow(self) -> None:
        """Refit or build the tree if the scene is not the one that it was made for."""
        scene, made_for = self._context.scene, self._made_for
        if made_for == scene.revision:
            return
        if scene.triangle_count == 0:
            self._bvh, self._made_for = None, scene.revision
            return
        changed = scene.changed_since(made_for)
        if made_for is None or made_for.topology != scene.revision.topology:
            self._replaced += sum(last - first for first, last in changed.triangles)
        spare = self._built_count - scene.triangle_count
        fits = self._bvh is not None and 0 <= spare <= _REPLACED * scene.triangle_count + _SPARES
        rebuild = self._variant == "rebuild" or self._worn_out or not fits
        rebuild |= self._replaced > _REPLACED * scene.triangle_count
        with self._context.stages.stage("build"):
            if not fits or (rebuild and scene.parts == 1 and spare > 0):
                self._bvh = None  # in place is impossible with another number of boxes
            self._make_boxes(rebuild, changed.triangles)
            self._make_tree(rebuild)
        if rebuild:
            self._fresh_tests = None
            self._worn_out, self._replaced = False, 0
        self._made_for = scene.revision  # last: a tree that could not be made is made again

    def _make_boxes(self, rebuild: bool, changed: Ranges) -> None:
        """Boxes of triangles, where they have ``changed``, in units of a box around all."""
        scene = self._context.scene
        low, high = scene.box()
        if self._bvh is None:
            spare = scene.triangle_count // _TRIANGLES_PER_SPARE + _SPARES if scene.parts > 1 else 0
            self._built_count = min(scene.triangle_count + spare, len(self._lowers))
        count, boxes, arrays = scene.triangle_count, self._built_count, [self._lowers, self._uppers]
        many = sum(last - first for first, last in changed) > count // 2
        if rebuild or many or self._held is None or not holds(self._held, low, high):
            self._tree.box, self._held, changed = scene_box(low, high), (low, high), ((0, boxes),)
        for first, last in changed:
            if first < count:
                inputs = [first, boxes, self._tree.box, scene.vertices, scene.triangles, *arrays]
                wp.launch(triangle_boxes, dim=min(last, count) - first, inputs=inputs, device=scene.device)
            first = max(first, count)
            if first < min(last, boxes):
                wp.launch(
                    empty_boxes, dim=min(last, boxes) - first, inputs=[first, boxes, *arrays], device=scene.device
                )

    def _make_tree(self, rebuild: bool) -> None:
        """Build the tree around the boxes, or refit it."""
        if self._bvh is None:
            some = self._lowers[: self._built_count], self._uppers[: self._built_count]
            self._bvh = wp.Bvh(*some, constructor=self._constructor, leaf_size=4)
        elif rebuild:
            self._bvh.rebuild()
        else:
            self._bvh.refit()
        self._tree.bvh = self._bvh.id
        self._tree.wide = 0
        if self._widens:
            inputs = [self._bvh.id, self._tree.bounds, self._tree.links, self._wide_nodes]
            wp.launch(collapse, dim=1, inputs=inputs, device=self._context.frame.device)
            self._tree.wide = int(self._wide_nodes.numpy()[0] > 0)

    def prepare(self, work: Pass) -> None:
        """Records of the light."""
        with self._context.stages.stage("setup"):
            self._context.records.prepare(work.light)

    def trace(self, work: Pass) -> None:
        """Walk every ray of the light through the tree."""
        frame, light, attempt = work.light, work.first, work.attempt
        if self._bvh is None:
            return
        buffers, stages = self._context.frame, self._context.stages
        with stages.stage("trace"):
            wp.launch(
                walk,
                dim=buffers.count,
                inputs=[
                    attempt,
                    self._context.scene.triangle_count,
                    self._tree,
                    frame.light,
                    buffers.samples,
                    buffers.rays,
                    self._context.records.of(light),
                    buffers.queue,
                    buffers.queue_count_of[light],
                    buffers.resume,
                    self._occluders,
                    buffers.states_of(light),
                    buffers.counters,
                ],
                device=buffers.device,
            )

    def learn(self, counters: dict[str, int]) -> None:
        """Judge the tree by the triangles tested per ray in the frame that just ended."""
        if counters["rays"] == 0:
            return
        tests = counters["leaf_tests"] / counters["rays"]
        if self._fresh_tests is None:
            self._fresh_tests = tests
        self._worn_out = tests > _WORN_OUT * max(self._fresh_tests, 1.0)

    def nbytes(self) -> int:
        """Boxes and trees; Warp does not tell the size of its own, which is two 32-byte nodes per triangle at most."""
        arrays = (self._lowers, self._uppers, self._occluders, self._tree.bounds, self._tree.links)
        return sum(int(array.capacity) for array in arrays) + 64 * self._built_count
