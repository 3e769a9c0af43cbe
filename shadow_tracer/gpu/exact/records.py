# SPDX-License-Identifier: Apache-2.0
"""Triangles as seen from a light: the four planes of each triangle in the light's frame, and their error bounds.

Set-up is float64, rounded once to the 64-byte record that the filter of ``decision.py`` reads; ``docs/exactness.md``
derives the bounds. A triangle that casts nothing gets a record that says no to every ray: it has a corner that is not
finite, no area, or is seen exactly edge-on (``degenerate``), or its front faces the light and front faces are culled.

CUDA takes one triangle per thread (``prepare_triangles``). On the CPU Warp's loops are scalar, so there a thread takes
a block of triangles and the compiler puts the loops over them into vector registers (``prepare_block``).
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.exact.determinant import DETERMINANT, determinant_sign
from shadow_tracer.gpu.exact.light_frame import LightFrame, frame_coordinates

# Unit roundoff of float32, and the factors in front of it (docs/exactness.md, section 3): an edge is off by 5 u of the
# ray's magnitude at most, the own plane by 4 u of its magnitude and 2 u of its offset; what is more pays for the
# roundings of the bounds.
U32 = 2.0**-24
FILTER_FACTOR = 8.0
SLOPE_FACTOR = 5.0
OFFSET_FACTOR = 3.0
# Bound of the float64 errors of frame coordinates and of products of them, relative to the magnitudes involved.
SETUP_ERROR = 2.0**-46
# A plane's offset beyond this may not fit in float32: its bound is infinite, so that it decides nothing there.
LARGEST_OFFSET = 1.0e38


@wp.func
def largest(v: wp.vec3d) -> wp.float64:
    return wp.max(wp.max(wp.abs(v[0]), wp.abs(v[1])), wp.abs(v[2]))


@wp.func
def edge_plane(a: wp.vec4d, e: wp.vec4d) -> wp.vec4d:
    """Plane through the light and an edge from ``a`` along ``e``: a x e in (U, V, W), scaled to largest component 1,
    and its relative error. ``e`` is a difference taken before rounding: a x (b - a), never a x b."""
    n = wp.cross(wp.vec3d(a[0], a[1], a[2]), wp.vec3d(e[0], e[1], e[2]))
    size = largest(n)
    reach = wp.float64(1.0) + wp.abs(a[0]) + wp.abs(a[1]) + wp.abs(a[2]) + wp.abs(a[3])
    length = wp.abs(e[0]) + wp.abs(e[1]) + wp.abs(e[2]) + wp.abs(e[3])
    n = n / size
    return wp.vec4d(n[0], n[1], n[2], wp.float64(SETUP_ERROR) * reach * length / size)


@wp.func
def edge_difference(frame: LightFrame, e: wp.vec3d) -> wp.vec4d:
    """Difference of the frame coordinates of two points whose difference in the world is ``e``."""
    x = e * frame.inverse_scale
    z = wp.dot(frame.f, x)
    return wp.vec4d(wp.dot(frame.r, x), wp.dot(frame.s, x), -frame.w_slope * z, z)


@wp.func
def own_plane(a: wp.vec4d, ab: wp.vec4d, ac: wp.vec4d, sign: wp.float64, u32: wp.float64):
    """The triangle's plane (N, D) in (U, V, Z), N scaled to largest component 1, the light on its negative side; and
    its bounds s_N and s_D."""
    e1 = wp.vec3d(ab[0], ab[1], ab[3])
    e2 = wp.vec3d(ac[0], ac[1], ac[3])
    n = wp.cross(e1, e2)
    size = largest(n)
    l1 = wp.abs(e1[0]) + wp.abs(e1[1]) + wp.abs(e1[2])
    l2 = wp.abs(e2[0]) + wp.abs(e2[1]) + wp.abs(e2[2])
    n_error = wp.float64(SETUP_ERROR) * l1 * l2 / size
    # The frame (r, s, f) is right-handed, so det[U V Z] keeps the sign; the light's side of the plane becomes negative.
    n = n * (-sign / size)
    d = n[0] * a[0] + n[1] * a[1] + n[2] * a[3]
    extent = wp.float64(1.0) + wp.abs(a[0]) + wp.abs(a[1]) + wp.abs(a[3])
    s_plane = wp.float64(SLOPE_FACTOR) * u32 + wp.float64(2.0) * n_error
    s_offset = wp.float64(OFFSET_FACTOR) * u32 * wp.abs(d)
    s_offset += wp.float64(2.0) * (n_error + wp.float64(SETUP_ERROR)) * extent
    if not wp.abs(d) < wp.float64(LARGEST_OFFSET):
        s_offset = wp.float64(wp.inf)
    return wp.vec4d(n[0], n[1], n[2], d), s_plane, s_offset


@wp.func
def never_record(triangle: int, records: wp.array2d(dtype=wp.vec4)):
    """A record whose plane test is a certain no: g = 0 - 1 < -0."""
    zero = wp.vec4(0.0, 0.0, 0.0, 0.0)
    records[triangle, 0] = zero
    records[triangle, 1] = zero
    records[triangle, 2] = zero
    records[triangle, 3] = wp.vec4(0.0, 0.0, 0.0, 1.0)


@wp.kernel(enable_backward=False)
def prepare_triangles(
    light: wp.array(dtype=LightFrame),
    factor: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    cull: int,
    degenerate: wp.array(dtype=int),
    culled: wp.array(dtype=int),
):
    """Four planes and their error bounds per triangle, float64 rounded once: (n_ab, s_e) (n_bc, s_N) (n_ca, s_D) (N,
    D). With ``cull``, triangles whose front faces the light cast nothing."""
    i = wp.tid()
    frame = light[0]
    corners = triangles[i]
    a = vertices[corners[0]]
    b = vertices[corners[1]]
    c = vertices[corners[2]]
    if not (wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)):
        never_record(i, records)
        wp.atomic_add(degenerate, i & 63, 1)
        return
    side = determinant_sign(frame.light, b, c, a)
    if side == 0:
        # Zero area, or seen exactly edge-on from the light.
        never_record(i, records)
        wp.atomic_add(degenerate, i & 63, 1)
        return
    if cull != 0 and side > 0:
        never_record(i, records)
        wp.atomic_add(culled, i & 63, 1)
        return
    ab = b - a
    ac = c - a
    va = frame_coordinates(frame, a - frame.center)
    vb = frame_coordinates(frame, b - frame.center)
    vc = frame_coordinates(frame, c - frame.center)
    eab = edge_difference(frame, ab)
    eac = edge_difference(frame, ac)
    p0 = edge_plane(va, eab)
    p1 = edge_plane(vb, edge_difference(frame, c - b))
    p2 = edge_plane(vc, edge_difference(frame, a - c))
    sign = wp.float64(1.0)
    if side < 0:
        sign = wp.float64(-1.0)
    u32 = wp.float64(U32)
    edge_error = wp.max(wp.max(p0[3], p1[3]), p2[3])
    s_edge = factor * u32 + wp.float64(2.0) * edge_error

    n, s_plane, s_offset = own_plane(va, eab, eac, sign, u32)
    records[i, 0] = wp.vec4(float(sign * p0[0]), float(sign * p0[1]), float(sign * p0[2]), float(s_edge))
    records[i, 1] = wp.vec4(float(sign * p1[0]), float(sign * p1[1]), float(sign * p1[2]), float(s_plane))
    records[i, 2] = wp.vec4(float(sign * p2[0]), float(sign * p2[1]), float(sign * p2[2]), float(s_offset))
    records[i, 3] = wp.vec4(float(n[0]), float(n[1]), float(n[2]), float(n[3]))


# Triangles per thread of the vectorised loops; their corners and planes stay in the first-level cache.
BLOCK = 128


# First the side the light is on, as tier 1 of exact.py decides it, without contraction; what it leaves open gets the
# exact sign one by one (no permanent is above 1e-15 of NaN, so corners that are not finite are left open, too). Then
# the planes; the filter's bound covers any contraction of them, and one reciprocal in place of several divisions.
@wp.func_native(
    DETERMINANT
    + r"""
#if !defined(__CUDA_ARCH__)
    const int n = count - first < 128 ? count - first : 128;
    double ax[128], ay[128], az[128], bx[128], by[128], bz[128], cx[128], cy[128], cz[128], side[128];
    wp::uint8 open[128];
    typedef float Four[4];
    Four record[4][128];
    float corner[12][128];
    for (int j = 0; j < n; ++j) {
        const wp::vec3i corners = triangles.data[first + j];
        const wp::vec3d &a = vertices.data[corners[0]], &b = vertices.data[corners[1]], &c = vertices.data[corners[2]];
        ax[j] = a[0]; ay[j] = a[1]; az[j] = a[2];
        bx[j] = b[0]; by[j] = b[1]; bz[j] = b[2];
        cx[j] = c[0]; cy[j] = c[1]; cz[j] = c[2];
    }
    const double lx = frame.light[0], ly = frame.light[1], lz = frame.light[2], lw = frame.light[3];
    int any_open = 0;
    for (int j = 0; j < n; ++j) {
        const double qx = sub(lx, mul(lw, ax[j])), qy = sub(ly, mul(lw, ay[j])), qz = sub(lz, mul(lw, az[j]));
        const double rx = sub(bx[j], ax[j]), ry = sub(by[j], ay[j]), rz = sub(bz[j], az[j]);
        const double sx = sub(cx[j], ax[j]), sy = sub(cy[j], ay[j]), sz = sub(cz[j], az[j]);
        const double x0 = mul(ry, sz), x1 = mul(rz, sy), y0 = mul(rz, sx), y1 = mul(rx, sz);
        const double z0 = mul(rx, sy), z1 = mul(ry, sx);
        const double value = add(add(mul(qx, sub(x0, x1)), mul(qy, sub(y0, y1))), mul(qz, sub(z0, z1)));
        const double permanent = add(
            add(mul(fabs(qx), add(fabs(x0), fabs(x1))), mul(fabs(qy), add(fabs(y0), fabs(y1)))),
            mul(fabs(qz), add(fabs(z0), fabs(z1))));
        const int sure = fabs(value) > 1.0e-15 * permanent;
        side[j] = sure ? (value > 0.0 ? 1.0 : -1.0) : 0.0;
        open[j] = !sure & !(permanent == 0.0);
        any_open |= open[j];
    }
    if (any_open) {
        for (int j = 0; j < n; ++j) {
            const wp::vec3d a(ax[j], ay[j], az[j]), b(bx[j], by[j], bz[j]), c(cx[j], cy[j], cz[j]);
            double value;
            if (open[j] && wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c))
                side[j] = determinant(frame.light, b, c, a, value);
        }
    }
    int nothing = 0, front = 0;  // front: turned towards the light and culled
    for (int j = 0; j < n; ++j) {
        nothing += side[j] == 0.0;
        const int off = (cull != 0) & (side[j] > 0.0);
        front += off;
        side[j] = off ? 0.0 : side[j];
    }
    const int row = first_row + ((first / 128) & 63);
    // Several threads may make records of one light.
    if (nothing)
        __atomic_fetch_add(&degenerate.data[row], nothing, __ATOMIC_RELAXED);
    if (front)
        __atomic_fetch_add(&culled.data[row], front, __ATOMIC_RELAXED);
    {
#pragma clang fp contract(fast)
        const double scale = frame.inverse_scale, w_constant = frame.w_constant, w_slope = frame.w_slope;
        const double ux = frame.r[0] * scale, uy = frame.r[1] * scale, uz = frame.r[2] * scale;
        const double vx = frame.s[0] * scale, vy = frame.s[1] * scale, vz = frame.s[2] * scale;
        const double zx = frame.f[0] * scale, zy = frame.f[1] * scale, zz = frame.f[2] * scale;
        const double ox = frame.center[0], oy = frame.center[1], oz = frame.center[2];
        const double rounding = factor * u32;
        struct Place { double u, v, w, z; };
        struct Plane { double x, y, z, error; };
        auto turned = [&](double x, double y, double z, double constant) {
            const double depth = zx * x + zy * y + zz * z;
            return Place{ ux * x + uy * y + uz * z, vx * x + vy * y + vz * z, constant - w_slope * depth, depth };
        };
        auto length = [](const Place& e) { return fabs(e.u) + fabs(e.v) + fabs(e.w) + fabs(e.z); };
        auto larger = [](double x, double y) { return x > y ? x : y; };
        auto edge = [&](const Place& a, const Place& e, double sign) {
            const double x = a.v * e.w - a.w * e.v, y = a.w * e.u - a.u * e.w, z = a.u * e.v - a.v * e.u;
            const double inverse = 1.0 / larger(larger(fabs(x), fabs(y)), fabs(z)), unit = sign * inverse;
            return Plane{ x * unit, y * unit, z * unit, setup * (1.0 + length(a)) * length(e) * inverse };
        };
        for (int j = 0; j < n; ++j) {
            const double sign = side[j];
            const Place a = turned(ax[j] - ox, ay[j] - oy, az[j] - oz, w_constant);
            const Place b = turned(bx[j] - ox, by[j] - oy, bz[j] - oz, w_constant);
            const Place c = turned(cx[j] - ox, cy[j] - oy, cz[j] - oz, w_constant);
            corner[0][j] = a.u; corner[1][j] = a.v; corner[2][j] = a.w; corner[3][j] = a.z;
            corner[4][j] = b.u; corner[5][j] = b.v; corner[6][j] = b.w; corner[7][j] = b.z;
            corner[8][j] = c.u; corner[9][j] = c.v; corner[10][j] = c.w; corner[11][j] = c.z;
            const Place ab = turned(bx[j] - ax[j], by[j] - ay[j], bz[j] - az[j], 0.0);
            const Place bc = turned(cx[j] - bx[j], cy[j] - by[j], cz[j] - bz[j], 0.0);
            const Place ca = turned(ax[j] - cx[j], ay[j] - cy[j], az[j] - cz[j], 0.0);
            const Plane p0 = edge(a, ab, sign), p1 = edge(b, bc, sign), p2 = edge(c, ca, sign);
            // (b - a) x (c - a) = (a - c) x (b - a) in (U, V, Z)
            double x = ca.v * ab.z - ca.z * ab.v, y = ca.z * ab.u - ca.u * ab.z, z = ca.u * ab.v - ca.v * ab.u;
            const double inverse = 1.0 / larger(larger(fabs(x), fabs(y)), fabs(z)), flip = -sign * inverse;
            x *= flip; y *= flip; z *= flip;
            const double d = x * a.u + y * a.v + z * a.z;
            const double error = setup * (fabs(ab.u) + fabs(ab.v) + fabs(ab.z))
                                 * (fabs(ca.u) + fabs(ca.v) + fabs(ca.z)) * inverse;
            const double extent = 1.0 + fabs(a.u) + fabs(a.v) + fabs(a.z);
            record[0][j][0] = p0.x; record[0][j][1] = p0.y; record[0][j][2] = p0.z;
            record[0][j][3] = rounding + 2.0 * larger(larger(p0.error, p1.error), p2.error);
            record[1][j][0] = p1.x; record[1][j][1] = p1.y; record[1][j][2] = p1.z;
            record[1][j][3] = slope_factor * u32 + 2.0 * error;
            record[2][j][0] = p2.x; record[2][j][1] = p2.y; record[2][j][2] = p2.z;
            const double bound = offset_factor * u32 * fabs(d) + 2.0 * (error + setup) * extent;
            record[2][j][3] = fabs(d) < largest_offset ? bound : HUGE_VAL;
            record[3][j][0] = x; record[3][j][1] = y; record[3][j][2] = z; record[3][j][3] = d;
        }
    }
    if (corners.shape[0] > 0) {
        // Lanes behind the last triangle repeat it.
        for (int j = n; j % 16; ++j)
            for (int k = 0; k < 12; ++k)
                corner[k][j] = corner[k][n - 1];
        for (int j = 0; j < n; j += 16)
            for (int k = 0; k < 12; ++k)
                memcpy(corners.data + 12 * (size_t)(first_corner + j) + 16 * k, corner[k] + j, 64);
    }
    wp::vec4* __restrict__ out = records.data + 4 * (size_t)first_record;
    for (int j = 0; j < n; ++j)
        for (int k = 0; k < 4; ++k)
            memcpy(out + 4 * j + k, record[k][j], 16);
    if (nothing + front > 0)
        for (int j = 0; j < n; ++j)
            if (side[j] == 0.0)
                for (int k = 0; k < 4; ++k)
                    out[4 * j + k] = wp::vec4(0.0f, 0.0f, 0.0f, k == 3 ? 1.0f : 0.0f);
#endif
    """
)
def prepare_block(
    first: int,
    count: int,
    frame: LightFrame,
    factor: wp.float64,
    slope_factor: wp.float64,
    offset_factor: wp.float64,
    u32: wp.float64,
    setup: wp.float64,
    largest_offset: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    first_record: int,
    records: wp.array2d(dtype=wp.vec4),
    first_corner: int,
    corners: wp.array(dtype=float),
    cull: int,
    first_row: int,
    degenerate: wp.array(dtype=int),
    culled: wp.array(dtype=int),
):
    """``prepare_triangles`` for up to 128 triangles from ``first`` on, vectorised over triangles. Records go to
    ``first_record`` on and, if there are any ``corners``, theirs to ``first_corner`` on (counted in triangles, a
    multiple of 16): [sixteen][corner][U V W Z][16], each within 2^-24 relative and 2^-46 (1 + its distance from the
    anchor) of exact. Those that cast nothing are counted in rows from ``first_row`` on."""
    ...


@wp.kernel(enable_backward=False)
def prepare_blocks(
    count: int,
    light: wp.array(dtype=LightFrame),
    factor: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    cull: int,
    degenerate: wp.array(dtype=int),
    culled: wp.array(dtype=int),
):
    first = wp.tid() * BLOCK
    no_corners = wp.array(ptr=wp.uint64(0), shape=(0,), dtype=float)
    prepare_block(
        first,
        count,
        light[0],
        factor,
        wp.float64(SLOPE_FACTOR),
        wp.float64(OFFSET_FACTOR),
        wp.float64(U32),
        wp.float64(SETUP_ERROR),
        wp.float64(LARGEST_OFFSET),
        vertices,
        triangles,
        first,
        records,
        0,
        no_corners,
        cull,
        0,
        degenerate,
        culled,
    )
