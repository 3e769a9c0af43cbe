# SPDX-License-Identifier: Apache-2.0
"""Every sample against every triangle: the in-house oracle.

Variant ``filtered`` uses the float32 filter and the queue as every pipeline does; ``scalar`` is the same with one
sample per thread on every device; ``float64`` asks the exact decision for every single pair and uses neither. All must
give the same bits, which tests the filter's bound on any scene at hand.

Cost: samples x triangles pairs, 12 multiply-adds each, 64 bytes of record per triangle read by all samples. On the CPU
a thread takes a block of samples and the filter runs over them in vector registers (Warp's own loops are scalar there:
ten times slower); on CUDA, and in variant ``scalar``, a thread takes one sample.

``attempt`` of ``trace``: 0 looks at every ray; 1 looks again, from the start, at rays that found the queue full
(PENDING); 2 goes on with them where the attempt before stopped (``resume`` counts the pairs of a sample that have been
queued).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import EXACT, LEAF_TESTS, RETESTED
from shadow_tracer.gpu.exact.decision import FILTER_BLOCK, MAGNITUDE_FLOOR, decide, is_ray, ray_magnitude
from shadow_tracer.gpu.exact.determinant import determinant_sign
from shadow_tracer.gpu.exact.light_frame import PENDING, SHADOWED
from shadow_tracer.gpu.occluders.world import Change
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


@wp.func_native(
    FILTER_BLOCK
    + r"""
    float U[256], V[256], W[256], Z[256], M[256];
    int index[256], queued[256], already[256], answer[256];
    int n = 0;
    for (int i = first; i < first + 256 && i < count; ++i) {
        const wp::vec4 ray = rays.data[i];
        const wp::uint8 state = states.data[i];
        if (ray[0] != ray[0] || !(attempt > 0 ? state == 4 : state == 0))
            continue;
        U[n] = ray[0]; V[n] = ray[1]; W[n] = ray[2]; Z[n] = ray[3];
        M[n] = fabsf(ray[0]) + fabsf(ray[1]) + fabsf(ray[3]) + floor_;
        index[n] = i;
        already[n] = attempt == 2 ? resume.data[i] : 0;
        queued[n] = 0;
        states.data[i] = 0;
        ++n;
    }
    const float* record = (const float*)records.data;
    wp::int64 tests = 0;
    for (int t = 0; t < triangle_count && n > 0; ++t, record += 16) {
        const int any = filter_block(record, n, U, V, W, Z, M, answer);
        tests += n;
        if (any == 0)
            continue;
        for (int j = n - 1; j >= 0; --j) {
            if (answer[j] == 0)
                continue;
            wp::uint8 state = 1;
            if (answer[j] == 2) {
                if (queued[j]++ < already[j])
                    continue;
                const int slot = wp::atomic_add(&queue_count.data[0], 1);
                if (slot < queue.shape[0]) {
                    queue.data[slot] = wp::vec2i(index[j], t);
                    continue;
                }
                state = 4;
                resume.data[index[j]] = queued[j] - 1;
            }
            states.data[index[j]] = state;
            --n;  // the last sample takes the place of the one that is done; its answer has been looked at
            U[j] = U[n]; V[j] = V[n]; W[j] = W[n]; Z[j] = Z[n]; M[j] = M[n];
            index[j] = index[n]; already[j] = already[n]; queued[j] = queued[n];
        }
    }
    wp::atomic_add(&counters.data[((first / 256) & 63) * counters.shape[1] + leaf_tests], tests);
    """
)
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

    def update(self, change: Change) -> None:
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
            if self._variant == "filtered" and forms.wide(buffers.device):
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
