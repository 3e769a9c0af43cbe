# SPDX-License-Identifier: Apache-2.0
"""Triangles as a camera sees them: edge planes, inverse depth and exact plane of each.

The camera is a point light at the optical centre: a ``LightFrame`` with its anchor there, axes from the inverse of the
camera's rotation (which need not be exactly orthonormal) and the scale below. A pixel's ray is d = R (x, y, 1) with x =
(column - cx) / fx and y = (row - cy) / fy, or x and y of the camera's table of rays, in the frame h = (x, -y, 1) for
the edges and (x, -y, -1) for the plane, whatever its depth. So ``records.py`` and its bounds serve as they are,
with m = |x| + |y| + 2.

Every quantity of the frame is relative to the camera, so its scale S only has to keep the "1 +" of the bounds small
against the distance of triangles, and float32 from overflowing: 2^-20 m serves from 2^-42 m to 1e24 m.

Packed record, 16 floats in the place of the light's: (n_ab, s_e) (n_bc, s_q) (n_ca, casts) (Q, 0). The plane N . x' =
D becomes S / z = Q . (x, -y, 1) with Q = (Nu, Nv, -Nz) / D. With the record's promises |N.h - exact| <= s_N m and |D -
exact| <= s_D, delta = s_D / D <= 1/4 and |N| <= 1, N.h / D is off by at most m / D (s_N + 1.4 delta); rounding Q and
evaluating it adds 5 u m / D. s_q = 2 (s_N + delta) / D covers both, as s_N >= 5 u and 0.6 delta >= 1.8 u are left for
roundings of s_q itself, and the float64 depth's own error, which is of the size of the set-up terms in s_N over 16, as
they are there twice. Where that cannot be said s_q is infinite: float64 decides.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.scene.camera import Camera

SCALE = 2.0**-20
PLANE_COLUMNS = 6
"""Float64 numbers of a triangle's plane: N, D, the least and the largest depth of its corners."""
native.constants(PLANE_COLUMNS=PLANE_COLUMNS)


@wp.struct
class CameraRays:
    """The rays of a camera's pixels, as kernels see them."""

    width: int
    height: int
    position: wp.vec3d
    right: wp.vec3d  # columns of the rotation
    down: wp.vec3d
    forward: wp.vec3d
    depth_row: wp.vec3d  # third row of its inverse
    columns: wp.array(dtype=wp.float64)  # x of each column and y of each row of a pinhole
    rows: wp.array(dtype=wp.float64)
    tabled: int
    table: wp.array(dtype=wp.vec2)  # x and y of each pixel of a camera with a table, NaN where there is no ray


@wp.struct
class CameraTriangles:
    """The triangles of the scene as a camera sees them."""

    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)
    records: wp.array2d(dtype=wp.vec4)
    planes: wp.array2d(dtype=wp.float64)


def make_camera_frame(camera: Camera) -> LightFrame:
    """Frame of a light at the optical centre that sees the pixels where the camera does."""
    inverse = np.linalg.inv(camera.camera_to_world[:3, :3])
    frame = LightFrame()
    frame.number = 0
    frame.light = wp.vec4d(*camera.position, 1.0)
    frame.center = wp.vec3d(*camera.position)
    frame.r = wp.vec3d(*inverse[0])
    frame.s = wp.vec3d(*-inverse[1])
    frame.f = wp.vec3d(*-inverse[2])
    frame.inverse_scale = 1.0 / SCALE
    frame.w_constant, frame.w_slope = 0.0, 1.0
    frame.axis = wp.vec3d(*inverse[2])
    frame.cosine, frame.reach = -2.0, float("inf")
    return frame


@native.func_native("exact/camera_setup.h", calls="CameraSetUp::of")
def pack_triangle(
    i: int,
    rays: CameraRays,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    planes: wp.array2d(dtype=wp.float64),
):
    """Turns the light's record of triangle ``i`` into the camera's, in place, and makes its plane."""
    ...


@wp.kernel(enable_backward=False)
def pack_triangles(
    rays: CameraRays,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    planes: wp.array2d(dtype=wp.float64),
):
    pack_triangle(wp.tid(), rays, vertices, triangles, records, planes)
