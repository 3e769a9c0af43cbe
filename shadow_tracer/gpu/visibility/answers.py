# SPDX-License-Identifier: Apache-2.0
"""Where the answers about the rays of a pass go, and what is noted of a pair."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.decision import YES
from shadow_tracer.gpu.exact.light_frame import SHADOWED


@wp.struct
class Answers:
    """Where the answers about the rays of a pass go."""

    samples: int  # per light
    states: wp.array(dtype=wp.uint8)
    resume: wp.array(dtype=int)  # uncertain pairs of a ray in this pass
    queue: wp.array(dtype=wp.vec2i)
    queue_count: wp.array(dtype=int)
    counters: wp.array2d(dtype=wp.int64)


@native.func_native("visibility/answers.h", calls="Settle::pair")
def let_wait(answers: Answers, sample: int, triangle: int):
    """An uncertain pair waits for the exact decision, or its ray for a further pass."""
    ...


@wp.func
def settle(sample: int, triangle: int, answer: int, answers: Answers):
    """Note what the filter said about a pair, NO excepted."""
    if answer == YES:
        answers.states[sample] = wp.uint8(SHADOWED)
    else:
        let_wait(answers, sample, triangle)
