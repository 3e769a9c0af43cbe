# SPDX-License-Identifier: Apache-2.0
"""Depth image to samples: one sample per pixel, in the world, float64, in image order.

A pixel is valid iff its depth is finite and positive (REP 117, REP 118) and its sample no farther from the origin than
coordinates may be: NaN, infinity, zero and negative values, and 0 in millimetre images, never become samples. The
operations are those of ``Camera.unproject`` in the same order without contraction, so a point computed there is the
sample traced here, bit for bit.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.exact import ARITHMETIC, transform_point
from shadow_tracer.scene.checks import LARGEST


@wp.struct
class Pinhole:
    """Camera and bias as the kernel sees them."""

    width: wp.int32
    fx: wp.float64
    fy: wp.float64
    cx: wp.float64
    cy: wp.float64
    row0: wp.vec4d  # camera_to_world, by rows
    row1: wp.vec4d
    row2: wp.vec4d
    bias_constant: wp.float64
    bias_quadratic: wp.float64


# (x, y, z) in the optical frame, and the bias; uncontracted.
@wp.func_native(
    ARITHMETIC
    + r"""
    double x = mul((column - camera.cx) / camera.fx, z);
    double y = mul((row - camera.cy) / camera.fy, z);
    return wp::vec4d(x, y, z, add(camera.bias_constant, mul(camera.bias_quadratic, mul(z, z))));
    """
)
def pixel_sample(camera: Pinhole, column: wp.float64, row: wp.float64, z: wp.float64) -> wp.vec4d:
    """Sample of the pixel at ``column``, ``row`` with depth ``z`` [m], in the optical frame."""
    ...


@wp.kernel(enable_backward=False)
def unproject(
    camera: Pinhole,
    units_per_metre: wp.float64,
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    """Samples and validity of all pixels; ``units_per_metre`` is 1 for metres, 1000 for millimetres."""
    i = wp.tid()
    raw = wp.float64(depth[i])
    if not (raw > wp.float64(0.0)) or not wp.isfinite(raw):
        valid[i] = wp.uint8(0)
        return
    row = i // camera.width
    local = pixel_sample(camera, wp.float64(i - row * camera.width), wp.float64(row), raw / units_per_metre)
    p = transform_point(camera.row0, camera.row1, camera.row2, wp.vec3d(local[0], local[1], local[2]))
    samples[i] = wp.vec4d(p[0], p[1], p[2], wp.min(local[3], wp.float64(LARGEST)))
    valid[i] = wp.uint8(0)
    if wp.max(wp.max(wp.abs(p[0]), wp.abs(p[1])), wp.abs(p[2])) <= wp.float64(LARGEST):
        valid[i] = wp.uint8(1)


wp.overload(unproject, {"depth": wp.array(dtype=wp.float32)})
wp.overload(unproject, {"depth": wp.array(dtype=wp.uint16)})
