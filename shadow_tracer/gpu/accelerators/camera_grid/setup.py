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

from shadow_tracer.gpu.exact.determinant import ARITHMETIC
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.scene.camera import Camera

SCALE = 2.0**-20


@wp.struct
class Grid:
    """The camera and its perspective grid, as kernels see them."""

    width: int
    height: int
    tile: int  # pixels along a side of a sorting tile
    group: int  # sorting tiles along a side of a coarse tile
    tiles_x: int
    tiles_y: int
    coarse_x: int
    coarse_y: int
    fx: float
    fy: float
    cx: float
    cy: float
    position: wp.vec3d
    right: wp.vec3d  # columns of the rotation
    down: wp.vec3d
    forward: wp.vec3d
    depth_row: wp.vec3d  # third row of its inverse
    columns: wp.array(dtype=float)  # x of each column and -y of each row, up to the end of the last tile
    rows: wp.array(dtype=float)
    columns64: wp.array(dtype=wp.float64)  # x and y
    rows64: wp.array(dtype=wp.float64)
    # Of a camera with a table of rays the axes are the grid's alone (``primary_rays.py``).
    tabled: int
    table: wp.array(dtype=wp.vec2)  # x and y of each pixel's ray
    tile_of: wp.array(dtype=int)  # the sorting tile that it lies in, -1 where there is none


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


# The plane's float64 form in the world, t = D / (N . d), and the depths of the corners, between which t is kept: so it
# is sane where the triangle is seen nearly edge-on. Corners in canonical order, no contraction: the same bits for
# every order, winding and device.
_PLANE = (
    ARITHMETIC
    + r"""
    auto make_plane = [&](const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c, double* out) {
        const wp::vec3d* v[3] = { &a, &b, &c };
        auto order = [&](int i, int j) {
            const wp::vec3d &x = *v[j], &y = *v[i];
            if (x[0] != y[0] ? x[0] < y[0] : x[1] != y[1] ? x[1] < y[1] : x[2] < y[2]) {
                const wp::vec3d* t = v[i];
                v[i] = v[j];
                v[j] = t;
            }
        };
        order(0, 1);
        order(1, 2);
        order(0, 1);
        double e[2][3], n[3], z[3];
        for (int k = 0; k < 3; ++k) {
            e[0][k] = sub((*v[1])[k], (*v[0])[k]);
            e[1][k] = sub((*v[2])[k], (*v[0])[k]);
        }
        n[0] = sub(mul(e[0][1], e[1][2]), mul(e[0][2], e[1][1]));
        n[1] = sub(mul(e[0][2], e[1][0]), mul(e[0][0], e[1][2]));
        n[2] = sub(mul(e[0][0], e[1][1]), mul(e[0][1], e[1][0]));
        for (int k = 0; k < 3; ++k) {
            const double x = sub((*v[k])[0], grid.position[0]), y = sub((*v[k])[1], grid.position[1]);
            const double w = sub((*v[k])[2], grid.position[2]);
            z[k] = add(add(mul(grid.depth_row[0], x), mul(grid.depth_row[1], y)), mul(grid.depth_row[2], w));
            if (k == 0)
                out[3] = add(add(mul(n[0], x), mul(n[1], y)), mul(n[2], w));
            out[k] = n[k];
        }
        const double low = z[0] < z[1] ? z[0] : z[1], high = z[0] < z[1] ? z[1] : z[0];
        out[4] = low < z[2] ? low : z[2];
        out[4] = out[4] > 0.0 ? out[4] : 0.0;
        out[5] = high > z[2] ? high : z[2];
    };
    auto pack = [](float* record) {
        const float infinity = 3.402823466e38f * 2.0f;
        float n[3] = { record[12], record[13], -record[14] };
        const float d = record[15], s_plane = record[7], s_offset = record[11];
        if (n[0] == 0.0f && n[1] == 0.0f && n[2] == 0.0f) {
            for (int k = 0; k < 16; ++k)
                record[k] = 0.0f;
            return;
        }
        // Comparisons with NaN fail, and what fails is left to float64.
        float sum = record[3];
        for (int k = 0; k < 11; ++k)
            sum += (k & 3) == 3 ? 0.0f : (record[k] < 0.0f ? -record[k] : record[k]);
        if (!(sum < 1.0e30f)) {
            for (int k = 0; k < 11; ++k)
                record[k] = 0.0f;
            record[3] = infinity;
        }
        const float inverse = 1.0f / d;
        const bool sure = d > 0.0f && s_offset <= 0.25f * d && s_plane <= 0.25f && inverse > 1.0e-30f
                          && inverse < 1.0e30f;
        for (int k = 0; k < 3; ++k)
            record[12 + k] = sure ? n[k] * inverse : 0.0f;
        record[7] = sure ? 2.0f * (s_plane + s_offset * inverse) * inverse : infinity;
        record[11] = 1.0f;
        record[15] = 0.0f;
    };
"""
)


@wp.func_native(
    _PLANE
    + r"""
    const wp::vec3i corners = triangles.data[i];
    pack((float*)records.data + 16 * (size_t)i);
    double plane[6];
    make_plane(vertices.data[corners[0]], vertices.data[corners[1]], vertices.data[corners[2]], plane);
    for (int k = 0; k < 6; ++k)
        planes.data[6 * (size_t)i + k] = plane[k];
    """
)
def pack_triangle(
    i: int,
    grid: Grid,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    planes: wp.array2d(dtype=wp.float64),
):
    """Turns the light's record of triangle ``i`` into the camera's, in place, and makes its plane."""
    ...


@wp.kernel(enable_backward=False)
def pack_triangles(
    grid: Grid,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    planes: wp.array2d(dtype=wp.float64),
):
    pack_triangle(wp.tid(), grid, vertices, triangles, records, planes)
