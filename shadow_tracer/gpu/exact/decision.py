# SPDX-License-Identifier: Apache-2.0
"""THE sample/triangle test. Every pipeline calls it, nothing else decides.

Sample p, light l, triangle a, b, c. With D the side of the triangle's plane the light is on, p is in shadow iff

- it lies strictly on the other side of the plane than the light, also after being moved by its bias towards the light,
  and
- it lies on the inner side of, or exactly on, each of the three planes through the light and an edge.

No clipping, no projection and no intersection point is needed, wherever the corners are, beside or behind the light
included.

Two tiers. ``filter_pair`` is float32 on the records of ``records.py``: 12 multiply-adds, 64 bytes a triangle,
with an error bound; it answers no, yes or *maybe*. Pairs it cannot decide are decided from the scene's float64
coordinates with exact signs (``determinant.py``), where they are found or from a queue (``visibility/answers.py``).
A yes or no of the filter is proven to be what the exact decision would say, so a pipeline is right as soon as it shows
every triangle that could matter to this test, in any order.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LIT

NO = wp.constant(0)
YES = wp.constant(1)
MAYBE = wp.constant(2)

# Floor of the magnitude that scales the filter's bounds: keeps float64 frame errors (below 2^-48) covered next to the
# light.
MAGNITUDE_FLOOR = 2.0**-20
native.constants(MAGNITUDE_FLOOR=MAGNITUDE_FLOOR)


@native.func_native("exact/decision.h", calls="Decision::of")
def decide(sample: wp.vec4d, light: wp.vec4d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> int:
    """The decision: bit 0 is set iff the triangle keeps the light from the sample (x, y, z, bias); the other bits
    count the determinants that needed expansion arithmetic. All of it is in scene coordinates as given, float64."""
    ...


@wp.func
def is_ray(state: wp.uint8, ray: wp.vec4) -> bool:
    """Whether there is anything left to find out about a sample."""
    return state == wp.uint8(LIT) and ray[0] == ray[0]


@wp.func
def ray_magnitude(ray: wp.vec4) -> float:
    """What the bounds of ``filter_pair`` scale with: that of the own plane, in (U, V, Z), with this, those of edges
    with |W| more."""
    return wp.abs(ray[0]) + wp.abs(ray[1]) + wp.abs(ray[3]) + MAGNITUDE_FLOOR


@wp.func_native(
    native.snippet(
        "exact/filter_one.h",
        call="return FilterOne::answer((const float*)records.data + 16 * (size_t)triangle, ray, magnitude);",
    )
)
def filter_pair(ray: wp.vec4, magnitude: float, records: wp.array2d(dtype=wp.vec4), triangle: int) -> int:
    """NO, YES or MAYBE from the float32 record of a triangle."""
    ...
