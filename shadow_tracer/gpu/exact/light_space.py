# SPDX-License-Identifier: Apache-2.0
"""Light space: directions and depths of rays, and what triangles look like there. One linear space for every light.

A ray is (U, V, W, Z) (``light_frame.py``). h = (U, V, W) is its position seen from the light up to a positive scale per
axis, so planes through the light are linear in h, for far and directional lights too. Divided by a norm of h, a ray is
a direction e = h/|h| and a depth t:

- mode *depth* (c = 1: the light is at least a scale away, or infinitely far): t = Z/|h|, and 1/|h| = w + s t;
- mode *inverse* (s = 1: the light is near or among the samples): t = 1/|h|, and Z/|h| = c t - w;

with W = c - s Z, c = ``w_constant`` and s = ``w_slope`` of the frame. In both a larger t is nearer to the light along
the same direction, and the plane of a triangle, N . (U, V, Z) > D behind it, is linear in (e, t)::

    P . (e, t) > 0    P = (Nu, Nv, -D, Nz - s D) or (Nu, Nv, -Nz, c Nz - D)    P[3] <= 0

So a node of a ray hierarchy is a bound on e, and the least and largest t in it.

Bounds. The filter's records promise |n.h - exact| <= s_e m for an edge, with m = |U| + |V| + |W| + |Z| + 2^-20, and s_N
(m - |W|) + s_D for the plane (``docs/exactness.md``). For every ray of a node m/|h| and 1/|h| are at most M = 4 + 2.001
max |t|. Evaluating an edge over a node rounds by less than 24 u <= s_e M (as s_e >= 8 u and M >= 4), so ``2 s_e M`` is
a safe pad; the plane's coefficients and their evaluation round by at most 16 u (1 + |D|) M, which ``7 (s_N + s_D) M``
holds beside the record's own error: s_N >= 5 u and s_D >= 3 u |D|, and 6 times that is 30 u + 18 u |D|. M keeps W here:
it is a coordinate of P.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LightFrame

FACES = wp.constant(6)
native.constants(FACES=FACES)


@wp.struct
class LightSpace:
    """The two constants of W = c - s Z, and the mode."""

    c: float
    s: float
    inverse: int


def make_light_space(frame: LightFrame) -> LightSpace:
    """Light space of a frame."""
    space = LightSpace()
    space.c = float(frame.w_constant)
    space.s = float(frame.w_slope)
    space.inverse = int(float(frame.w_constant) < 1.0)
    return space


@wp.func
def space_of(frame: LightFrame) -> LightSpace:
    """Light space of a frame, on the device."""
    space = LightSpace()
    space.c = float(frame.w_constant)
    space.s = float(frame.w_slope)
    space.inverse = wp.where(space.c < 1.0, 1, 0)
    return space


@wp.func_native(
    native.snippet("exact/light_space.h", call="return LightDepth1::of(ray[3], inverse_norm, space.inverse != 0);")
)
def ray_depth(space: LightSpace, ray: wp.vec4, inverse_norm: float) -> float:
    """t of a ray whose 1/|h| is ``inverse_norm``."""
    ...


@wp.func_native(
    native.snippet(
        "exact/planes.h",
        call="""
    float p[4];
    Planes1::own(plane[0], plane[1], plane[2], plane[3], space, p);
    return wp::vec4(p[0], p[1], p[2], p[3]);""",
    )
)
def plane_of(space: LightSpace, plane: wp.vec4) -> wp.vec4:
    """P of a record's last row (N, D)."""
    ...


@native.func_native("exact/light_space.h", calls="LightDepth1::magnitude")
def magnitude_bound(nearest: float, farthest: float) -> float:
    """M of a node whose depths lie between the two values."""
    ...


@wp.func_native(native.snippet("exact/pads.h", call="return Pads1::edge(edge_error) * magnitude;"))
def edge_pad(edge_error: float, magnitude: float) -> float:
    """How far below zero n.e may be computed for a node although a ray in it is inside the edge; ``edge_error`` is
    s_e of the record."""
    ...


@wp.func_native(native.snippet("exact/pads.h", call="return Pads1::plane(slope_error, offset_error) * magnitude;"))
def plane_pad(slope_error: float, offset_error: float, magnitude: float) -> float:
    """The same for P . (e, t); the errors are s_N and s_D of the record."""
    ...


# A ray's coordinates over the largest of its direction, beyond which the direction is lost in roundings
# (``accelerators/admission.py``).
WILD_RATIO = 2.0**22


@wp.func
def face_of(ray: wp.vec4) -> int:
    """Cube face of a direction: 0 to 5 for +U, -U, +V, -V, +W, -W."""
    x = wp.abs(ray[0])
    y = wp.abs(ray[1])
    z = wp.abs(ray[2])
    if x >= y and x >= z:
        return wp.where(ray[0] < 0.0, 1, 0)
    if y >= z:
        return wp.where(ray[1] < 0.0, 3, 2)
    return wp.where(ray[2] < 0.0, 5, 4)


@wp.func
def face_axes(face: int, ray: wp.vec4) -> wp.vec3:
    """(major, first, second) of ray on ``face``: its size along the face's axis and the other two components."""
    sign = wp.where((face & 1) != 0, -1.0, 1.0)
    if face < 2:
        return wp.vec3(sign * ray[0], ray[1], ray[2])
    if face < 4:
        return wp.vec3(sign * ray[1], ray[2], ray[0])
    return wp.vec3(sign * ray[2], ray[0], ray[1])
