# SPDX-License-Identifier: Apache-2.0
"""Where the answers about the rays of a pass go, and what is noted of a pair of a ray and a triangle.

Answers only ever go one way, from lit to in shadow, so triangles may be shown to a ray in any order, by several threads
and more than once. A pair that the filter is sure of is noted at once. One that it is not needs the exact decision
(``exact/decision.py``): in the wide form that is made in place. In the CUDA form, where it would cost the kernels that
search three times their registers, the pair waits on a queue (``queue.py``).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.decision import YES
from shadow_tracer.gpu.exact.light_frame import SHADOWED, LightFrame


@wp.struct
class Answers:
    """Where the answers about the rays of a pass go, and what the exact decision needs to know."""

    samples: int  # per light
    states: wp.array(dtype=wp.uint8)
    counters: wp.array2d(dtype=wp.int64)
    queue: wp.array(dtype=wp.vec2i)  # (ray, triangle); without places: pairs are decided where they are found
    queue_count: wp.array(dtype=int)  # more than there are places: rays have been left OPEN
    lights: wp.array(dtype=LightFrame)  # of the pass
    positions: wp.array(dtype=wp.vec4d)  # of samples, with their bias
    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)


@native.func_native("visibility/answers.h", calls="Settle::pair")
def settle_uncertain(answers: Answers, ray: int, triangle: int) -> bool:
    """A pair waits for the exact decision, or is decided; True if nothing more need be shown to the ray."""
    ...


@native.func_native("visibility/answers.h", calls="Settle::decide")
def decide_pair(answers: Answers, ray: int, triangle: int) -> bool:
    """The exact decision of a pair, noted; True if the ray is in shadow."""
    ...


@wp.func
def settle(ray: int, triangle: int, answer: int, answers: Answers) -> bool:
    """Note what the filter said about a pair, NO excepted; True if nothing more need be shown to the ray."""
    if answer == YES:
        answers.states[ray] = wp.uint8(SHADOWED)
        return True
    return settle_uncertain(answers, ray, triangle)
