# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over the triangles (``wp.Bvh``), rays walk through it.

Warp's own mesh query is not exact, for two reasons: its box test rounds (rays aimed at vertices and edges of a closed mesh leak), and its
triangle test is float32 from the sample's side. Here the tree only proposes triangles, the shadow test decides, and the boxes are
padded so that no rounding can hide a triangle:

Let E be the largest coordinate of the scene's box around its centre O. Boxes are made in float64 relative to O, padded by 2^-19 E and
rounded outwards. A ray is clipped to the (padded) box of the scene in float64 first, so that its float32 start lies within E and
its length within 2 sqrt(3) E. With u = 2^-24, start and direction then displace a point of the ray by at most 5 u E per axis, and the slab
test's three roundings displace a slab by at most 3 u * 2 E; together 11 u E, and the padding is 32 u E. Direction components below 1e-20
are replaced by 1e-20, so 1/0 and 0 * infinity cannot occur; that displaces a point by less than 1e-19 E. Clipping rounds by 2^-50 of
the sample's distance from O; a sample farther away than 2^26 E, where that would eat the padding, is shown every triangle instead.

The tree is refitted while only positions change and rebuilt when the topology does. A refitted tree grows worse as things move, so it
is rebuilt as well once rays test twice as many triangles as they did right after the last build. Variant ``rebuild`` rebuilds always.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from shadow_tracer.gpu.buffers import LEAF_TESTS, Change
from shadow_tracer.gpu.light_frame import LIT, PENDING, SHADOWED, LightFrame, towards_light
from shadow_tracer.gpu.shadow_test import MAYBE, YES, enqueue, filter_pair, is_ray, ray_magnitude
from shadow_tracer.gpu.triangles import Context

_PADDING = 2.0**-19
# Samples farther from the scene's centre than this many scene sizes do not use the tree.
_FAR = 2.0**26
# A refitted tree whose rays test this many times the triangles they tested after the last build is built again.
_WORN_OUT = 2.0


@wp.struct
class SceneBox:
    """Centre and padded half size of the box that holds every triangle, the padding, and what counts as far away [m]."""

    center: wp.vec3d
    half: wp.vec3d
    padding: wp.float64
    far: wp.float64


@wp.kernel(enable_backward=False)
def triangle_boxes(
    box: SceneBox,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array2d(dtype=wp.int32),
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """Padded boxes relative to the scene's centre, rounded outwards."""
    i = wp.tid()
    a = vertices[triangles[i, 0]] - box.center
    b = vertices[triangles[i, 1]] - box.center
    c = vertices[triangles[i, 2]] - box.center
    if not (wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)):
        lowers[i] = wp.vec3(0.0, 0.0, 0.0)
        uppers[i] = wp.vec3(0.0, 0.0, 0.0)
        return
    low = wp.min(wp.min(a, b), c)
    high = wp.max(wp.max(a, b), c)
    # The padding is 32 ulps of the largest coordinate, rounding to float32 half an ulp: outward by far.
    lowers[i] = wp.vec3(
        float(low[0] - box.padding), float(low[1] - box.padding), float(low[2] - box.padding)
    )
    uppers[i] = wp.vec3(
        float(high[0] + box.padding), float(high[1] + box.padding), float(high[2] + box.padding)
    )


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


@wp.kernel(enable_backward=False)
def walk(
    attempt: int,
    triangle_count: int,
    bvh: wp.uint64,
    box: SceneBox,
    light: wp.vec4d,
    samples: wp.array(dtype=wp.vec4d),
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
    resume: wp.array(dtype=int),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """One ray per thread; ``attempt`` as in ``brute_force.py``."""
    i = wp.tid()
    state = states[i]
    ray = rays[i]
    if not is_ray(state, ray) or (attempt > 0 and state != wp.uint8(PENDING)):
        return
    sample = samples[i]
    p = wp.vec3d(sample[0], sample[1], sample[2])
    way = towards_light(p, light)
    start = p - box.center
    everything = wp.max(wp.max(wp.abs(start[0]), wp.abs(start[1])), wp.abs(start[2])) > box.far
    span = wp.vec2d(wp.float64(0.0), way[3])
    if not everything:
        span = clip_axis(span, start[0], way[0], box.half[0])
        span = clip_axis(span, start[1], way[1], box.half[1])
        span = clip_axis(span, start[2], way[2], box.half[2])
    result = int(LIT)
    tests = int(0)
    if span[0] <= span[1]:
        origin = wp.vec3(
            float(start[0] + span[0] * way[0]), float(start[1] + span[0] * way[1]), float(start[2] + span[0] * way[2])
        )
        direction = wp.vec3(away_from_zero(way[0]), away_from_zero(way[1]), away_from_zero(way[2]))
        longest = float((span[1] - span[0]) * wp.float64(1.0001) + box.padding)
        skip = int(0)
        if attempt == 2:
            skip = resume[i]
        magnitude = ray_magnitude(ray)
        queued = int(0)
        query = wp.bvh_query_ray(bvh, origin, direction)
        t = int(-1)
        while True:
            if everything:
                t += 1
                if t >= triangle_count:
                    break
            elif not wp.bvh_query_next(query, t, longest):
                break
            tests += 1
            answer = filter_pair(ray, magnitude, records[t, 0], records[t, 1], records[t, 2], records[t, 3])
            if answer == YES:
                result = SHADOWED
                break
            if answer == MAYBE:
                if queued >= skip:
                    if not enqueue(i, t, queue, queue_count):
                        result = PENDING
                        resume[i] = queued
                        break
                queued += 1
    states[i] = wp.uint8(result)
    wp.atomic_add(counters, i & 63, LEAF_TESTS, wp.int64(tests))


class MeshBvh:
    """The ``mesh_bvh`` pipeline."""

    def __init__(self, variant: str, context: Context) -> None:
        self._variant = variant
        self._context = context
        self._lowers = wp.empty(context.frame.bounds.max_triangles, dtype=wp.vec3, device=context.frame.device)
        self._uppers = wp.empty(context.frame.bounds.max_triangles, dtype=wp.vec3, device=context.frame.device)
        self._bvh: wp.Bvh | None = None
        self._box = SceneBox()
        self._version = -1
        self._built_count = 0
        self._fresh_tests: float | None = None  # tests per ray of the first frame after a build
        self._worn_out = False

    def update(self, change: Change) -> None:
        """Refit or build the tree if the scene has changed since this pipeline last saw it."""
        scene, device = self._context.scene, self._context.frame.device
        if self._version == scene.version:
            return
        seen_all = self._version == scene.version - 1
        self._version = scene.version
        count = scene.triangle_count
        if count == 0:
            self._bvh = None
            return
        rebuild = self._variant == "rebuild" or not seen_all or change == Change.TOPOLOGY or self._worn_out
        with self._context.stages.stage("build"):
            self._box = _scene_box(scene.low, scene.high)
            wp.launch(
                triangle_boxes,
                dim=count,
                inputs=[self._box, scene.vertices, scene.triangles, self._lowers, self._uppers],
                device=device,
            )
            if self._bvh is None or count != self._built_count:
                # In place is impossible with another number of boxes; the old tree is freed with its object.
                self._bvh = wp.Bvh(self._lowers[:count], self._uppers[:count])
                self._built_count = count
                rebuild = True
            elif rebuild:
                self._bvh.rebuild()
            else:
                self._bvh.refit()
        if rebuild:
            self._fresh_tests = None
            self._worn_out = False

    def trace(self, frame: LightFrame, light: int, attempt: int) -> None:
        """Walk every ray of the light through the tree."""
        if self._bvh is None:
            return
        buffers, stages = self._context.frame, self._context.stages
        with stages.stage("setup"):
            self._context.records.prepare(frame)
        with stages.stage("trace"):
            wp.launch(
                walk,
                dim=buffers.count,
                inputs=[
                    attempt,
                    self._context.scene.triangle_count,
                    self._bvh.id,
                    self._box,
                    frame.light,
                    buffers.samples,
                    buffers.rays,
                    buffers.records,
                    buffers.queue,
                    buffers.queue_count_of[light],
                    buffers.resume,
                    buffers.states[light],
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
        """Boxes and tree; Warp does not tell the size of a tree, which is two 32-byte nodes per triangle at most."""
        return int(self._lowers.capacity + self._uppers.capacity) + 64 * self._built_count


def _scene_box(low: np.ndarray, high: np.ndarray) -> SceneBox:
    center = 0.5 * low + 0.5 * high
    half = np.maximum(high - center, center - low)
    extent = max(float(half.max()), 1e-30)
    box = SceneBox()
    box.center = wp.vec3d(*center)
    box.padding = _PADDING * extent
    box.half = wp.vec3d(*(half + 2.0 * box.padding))
    box.far = _FAR * extent
    return box
