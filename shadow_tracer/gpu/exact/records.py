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

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.determinant import determinant_sign
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
native.constants(RECORDS_BLOCK=BLOCK)


@native.func_native("exact/records.h", calls="Records::block")
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
