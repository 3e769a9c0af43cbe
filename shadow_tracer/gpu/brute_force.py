# SPDX-License-Identifier: Apache-2.0
"""Every sample against every triangle: the in-house oracle.

Variant ``filtered`` uses the float32 filter and the queue as every pipeline does; ``float64`` asks the exact decision
for every single pair and uses neither. Both must give the same bits, which tests the filter's bound on any scene at
hand.

Cost: samples x triangles pairs, 12 multiply-adds each, 64 bytes of record per triangle read by all samples.

``attempt`` of ``trace``: 0 looks at every ray; 1 looks again, from the start, at rays that found the queue full
(PENDING); 2 goes on with them where the attempt before stopped (``resume`` counts the pairs of a sample that have been
queued).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.buffers import EXACT, LEAF_TESTS, RETESTED, Change
from shadow_tracer.gpu.light_frame import LIT, PENDING, SHADOWED, LightFrame
from shadow_tracer.gpu.shadow_test import MAYBE, YES, decide, enqueue, filter_pair, is_ray, ray_magnitude
from shadow_tracer.gpu.triangles import Context


@wp.kernel(enable_backward=False)
def test_all_filtered(
    attempt: int,
    triangle_count: int,
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
    resume: wp.array(dtype=int),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    i = wp.tid()
    state = states[i]
    ray = rays[i]
    if not is_ray(state, ray) or (attempt > 0 and state != wp.uint8(PENDING)):
        return
    skip = int(0)
    if attempt == 2:
        skip = resume[i]
    magnitude = ray_magnitude(ray)
    queued = int(0)
    tests = int(0)
    result = int(LIT)
    for t in range(triangle_count):
        tests += 1
        answer = filter_pair(ray, magnitude, records, t)
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


@wp.kernel(enable_backward=False)
def test_all_float64(
    light: wp.vec4d,
    triangle_count: int,
    samples: wp.array(dtype=wp.vec4d),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    i = wp.tid()
    if not is_ray(states[i], rays[i]):
        return
    tests = int(0)
    exact = int(0)
    for t in range(triangle_count):
        corners = triangles[t]
        a = vertices[corners[0]]
        b = vertices[corners[1]]
        c = vertices[corners[2]]
        if wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c):
            tests += 1
            answer = decide(samples[i], light, a, b, c)
            exact += answer >> 1
            if (answer & 1) != 0:
                states[i] = wp.uint8(SHADOWED)
                break
    wp.atomic_add(counters, i & 63, RETESTED, wp.int64(tests))
    wp.atomic_add(counters, i & 63, EXACT, wp.int64(exact))


class BruteForce:
    """The ``brute_force`` pipeline."""

    def __init__(self, variant: str, context: Context) -> None:
        self._variant = variant
        self._context = context

    def update(self, change: Change) -> None:
        """Nothing is kept between frames."""

    def trace(self, frame: LightFrame, light: int, attempt: int) -> None:
        """Test every ray of the light against every triangle."""
        buffers, scene, stages = self._context.frame, self._context.scene, self._context.stages
        if self._variant == "float64":
            with stages.stage("trace"):
                wp.launch(
                    test_all_float64,
                    dim=buffers.count,
                    inputs=[
                        frame.light,
                        scene.triangle_count,
                        buffers.samples,
                        scene.vertices,
                        scene.triangles,
                        buffers.rays,
                        buffers.states[light],
                        buffers.counters,
                    ],
                    device=buffers.device,
                )
            return
        with stages.stage("setup"):
            self._context.records.prepare(frame)
        with stages.stage("trace"):
            wp.launch(
                test_all_filtered,
                dim=buffers.count,
                inputs=[
                    attempt,
                    scene.triangle_count,
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
        """Nothing to adapt."""

    def nbytes(self) -> int:
        """No buffers of its own."""
        return 0
