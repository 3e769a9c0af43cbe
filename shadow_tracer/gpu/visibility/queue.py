# SPDX-License-Identifier: Apache-2.0
"""Pairs that the filter cannot decide wait in a bounded queue for the exact decision."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device.counters import EXACT, PEAK_QUEUE, RETESTED
from shadow_tracer.gpu.exact.decision import MAYBE, YES, decide, filter_pair
from shadow_tracer.gpu.exact.light_frame import LIT, PENDING, SHADOWED, LightFrame


@wp.func
def enqueue(sample: int, triangle: int, queue: wp.array(dtype=wp.vec2i), queue_count: wp.array(dtype=int)) -> bool:
    """Put a pair on the queue; False when it is full. ``queue_count[0]`` then is past the capacity: the overflow is
    seen. It stops there (a thread may be late by one): with more uncertain pairs than integers it would come round."""
    if queue_count[0] > queue.shape[0]:
        return False
    slot = wp.atomic_add(queue_count, 0, 1)
    if slot >= queue.shape[0]:
        return False
    queue[slot] = wp.vec2i(sample, triangle)
    return True


@wp.func
def test_everything(
    sample: int,
    ray: wp.vec4,
    magnitude: float,
    queued: int,
    first: int,
    triangle_count: int,
    records: wp.array2d(dtype=wp.vec4),
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
) -> wp.vec3i:
    """One ray against all triangles, whose records begin at ``first``: (state, pairs queued so far, tests); its first
    ``queued`` uncertain pairs are skipped, they have been on the queue before."""
    uncertain = int(0)
    for t in range(triangle_count):
        answer = filter_pair(ray, magnitude, records, first + t)
        if answer == YES:
            return wp.vec3i(SHADOWED, queued, t + 1)
        if answer == MAYBE:
            if uncertain >= queued:
                if not enqueue(sample, t, queue, queue_count):
                    return wp.vec3i(PENDING, queued, t + 1)
                queued += 1
            uncertain += 1
    return wp.vec3i(LIT, queued, triangle_count)


@wp.kernel(enable_backward=False)
def resolve_queue(
    lights: wp.array(dtype=LightFrame),
    count_of_samples: int,
    stride: int,
    queue: wp.array(dtype=wp.vec2i),
    queue_count: wp.array(dtype=int),
    samples: wp.array(dtype=wp.vec4d),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """Decide every queued pair of a pass. Shadowing is idempotent, so pairs of one ray may be decided in any order."""
    thread = wp.tid()
    count = wp.min(queue_count[0], queue.shape[0])
    if thread == 0:
        wp.atomic_max(counters, 0, PEAK_QUEUE, wp.int64(count))
    decided = int(0)
    exact = int(0)
    for k in range(thread, count, stride):
        pair = queue[k]
        if states[pair[0]] != wp.uint8(SHADOWED):
            place = pair[0] // count_of_samples
            sample = pair[0] - place * count_of_samples
            t = pair[1]
            corners = triangles[t]
            a = vertices[corners[0]]
            b = vertices[corners[1]]
            c = vertices[corners[2]]
            answer = decide(samples[sample], lights[place].light, a, b, c)
            decided += 1
            exact += answer >> 1
            if (answer & 1) != 0:
                states[pair[0]] = wp.uint8(SHADOWED)
    if decided > 0:
        wp.atomic_add(counters, thread & 63, RETESTED, wp.int64(decided))
    if exact > 0:
        wp.atomic_add(counters, thread & 63, EXACT, wp.int64(exact))
