# SPDX-License-Identifier: Apache-2.0
"""Where the answers about the rays of a pass go, and what is noted of a pair."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.exact.decision import YES
from shadow_tracer.gpu.exact.light_frame import PENDING, SHADOWED
from shadow_tracer.gpu.visibility.queue import enqueue


@wp.struct
class Answers:
    """Where the answers about the rays of a pass go."""

    samples: int  # per light
    states: wp.array(dtype=wp.uint8)
    resume: wp.array(dtype=int)  # uncertain pairs of a ray in this pass
    queue: wp.array(dtype=wp.vec2i)
    queue_count: wp.array(dtype=int)
    counters: wp.array2d(dtype=wp.int64)


@wp.func
def settle(sample: int, triangle: int, answer: int, answers: Answers):
    """Note what the filter said about a pair, NO excepted."""
    if answer == YES:
        answers.states[sample] = wp.uint8(SHADOWED)
    elif answers.states[sample] != wp.uint8(SHADOWED):
        wp.atomic_add(answers.resume, sample, 1)
        if not enqueue(sample, triangle, answers.queue, answers.queue_count):
            answers.states[sample] = wp.uint8(PENDING)
