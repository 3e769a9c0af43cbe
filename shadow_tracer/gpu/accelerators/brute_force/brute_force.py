# SPDX-License-Identifier: Apache-2.0
"""Every sample against every triangle: the in-house oracle.

Variant ``filtered`` uses the float32 filter and the queue as every pipeline does; ``float64`` asks the exact decision
for every single pair and uses neither. Both must give the same bits, which tests the filter's bound on any scene at
hand.

Cost: samples x triangles pairs, 12 multiply-adds each, 64 bytes of record per triangle read by all samples. On the CPU
a thread takes a block of samples and the filter runs over them in vector registers (Warp's own loops are scalar there:
ten times slower); on CUDA a thread takes one sample.

``attempt`` of ``trace``: 0 looks at every ray; 1 looks again, from the start, at rays that found the queue full
(PENDING); 2 goes on with them where the attempt before stopped (``resume`` counts the pairs of a sample that have been
queued).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.counters import EXACT, LEAF_TESTS, RETESTED
from shadow_tracer.gpu.exact.decision import MAGNITUDE_FLOOR, decide, is_ray, ray_magnitude
from shadow_tracer.gpu.exact.determinant import determinant_sign
from shadow_tracer.gpu.exact.light_frame import PENDING, SHADOWED
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.visibility.queue import test_everything


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
    queued = int(0)
    if attempt == 2:
        queued = resume[i]
    found = test_everything(i, ray, ray_magnitude(ray), queued, 0, triangle_count, records, queue, queue_count)
    if found[0] == PENDING:
        resume[i] = found[1]
    states[i] = wp.uint8(found[0])
    wp.atomic_add(counters, i & 63, LEAF_TESTS, wp.int64(found[2]))


# Samples per thread of the vectorised loop; their coordinates stay in the first-level cache.
_BLOCK = 256
native.constants(BRUTE_FORCE_BLOCK=_BLOCK)


@native.func_native("accelerators/brute_force/block.h", calls="BruteForce::block")
def test_block(
    first: int,
    count: int,
    attempt: int,
    triangle_count: int,
    floor_: float,
    leaf_tests: int,
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
    resume: wp.array(dtype=int),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """``test_all_filtered`` for the samples from ``first`` on, up to 256 of them, vectorised over samples."""
    ...


@wp.kernel(enable_backward=False)
def test_all_blocks(
    count: int,
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
    first = wp.tid() * _BLOCK
    test_block(
        first,
        count,
        attempt,
        triangle_count,
        MAGNITUDE_FLOOR,
        LEAF_TESTS,
        rays,
        records,
        queue,
        queue_count,
        resume,
        states,
        counters,
    )


@wp.kernel(enable_backward=False)
def test_all_float64(
    light: wp.vec4d,
    cull: int,
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
        casts = wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)
        if casts and cull != 0:
            casts = determinant_sign(light, b, c, a) < 0  # else its front faces the light
        if casts:
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

    recordable = False
    lights_together = 1
    keeps_rays = False

    def __init__(self, variant: str, context: Context) -> None:
        self._variant = variant
        self._context = context

    def follow(self) -> None:
        """Nothing is kept between frames."""

    def prepare(self, work: Pass) -> None:
        """Records of the light; for float64 only to count the degenerate triangles."""
        with self._context.stages.stage("setup"):
            self._context.records.prepare(work.light)

    def trace(self, work: Pass) -> None:
        """Test every ray of the light against every triangle."""
        frame, light, attempt = work.light, work.first, work.attempt
        buffers, scene, stages = self._context.frame, self._context.scene, self._context.stages
        if self._variant == "float64":
            with stages.stage("trace"):
                wp.launch(
                    test_all_float64,
                    dim=buffers.count,
                    inputs=[
                        frame.light,
                        int(self._context.records.front_face_culling),
                        scene.triangle_count,
                        buffers.samples,
                        scene.vertices,
                        scene.triangles,
                        buffers.rays,
                        buffers.states_of(light),
                        buffers.counters,
                    ],
                    device=buffers.device,
                )
            return
        arrays = [
            buffers.rays,
            self._context.records.of(light),
            buffers.queue,
            buffers.queue_count_of[light],
            buffers.resume,
            buffers.states_of(light),
            buffers.counters,
        ]
        with stages.stage("trace"):
            if forms.wide(buffers.device):
                blocks = -(-buffers.count // _BLOCK)
                inputs = [buffers.count, attempt, scene.triangle_count, *arrays]
                wp.launch(test_all_blocks, dim=blocks, inputs=inputs, device=buffers.device)
            else:
                inputs = [attempt, scene.triangle_count, *arrays]
                wp.launch(test_all_filtered, dim=buffers.count, inputs=inputs, device=buffers.device)

    def learn(self, counters: dict[str, int]) -> None:
        """Nothing to adapt."""

    def nbytes(self) -> int:
        """No buffers of its own."""
        return 0
