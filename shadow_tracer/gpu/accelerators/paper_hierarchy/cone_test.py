# SPDX-License-Identifier: Apache-2.0
"""Does a triangle touch, or cover, a cone of rays? The node tests of the paper's variants.

Both are conservative: REJECTED means that the exact decision is no for every ray of the node and this triangle, COVERED
that it is yes for every one. Everything else is UNSURE, NaN and infinity included (all comparisons are written so that
they fail then).

*spheres* is the test of the previous work (Roger et al. 2007, the paper's reference [RAH07]): the triangle's bounding
sphere against the cone, by angles, and its nearest point against the farthest ray.

*precise* is the paper's section 3.2 and 3.3, but not its construction. The paper builds a projection from the cone,
takes the triangle into clip space and compares edge distances with the unit circle. A signed clip distance above one
says axis . n < -sin A of the plane n through the light and the edge, so the projection, tan A and the division by depth
can go; and they must go, because

- tangents from projected vertices (the paper's figure 4b) reject triangles wrongly when a vertex is behind the light;
  here the separating planes are half-spaces in three dimensions;
- the nearest and farthest point of the plane (figure 3c) are right only for triangles that face the light; here the
  record's normal always points away from the light;
- near A = pi/2 clip depth, which is distance times cos A, loses all power, and A = 0 gives tan 0 / tan 0; sine and
  cosine of the half-angle have no such places, and at A > pi/2 the same plane test goes on working;
- an axis along the normal has no up direction; no frame is needed here.

All of it happens in light space (``light_space.py``), where a plane is linear in the direction and the depth t, so t
takes the place of ray lengths: the paper's Lmax is the least t of a node, Lmin the largest. Light space is stretched
for far lights; its cones are elliptic in the world then and the tests stay valid, as they are linear.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.exact.light_space import LightSpace, edge_pad, magnitude_bound, plane_of, plane_pad

REJECTED = wp.constant(0)
COVERED = wp.constant(1)
UNSURE = wp.constant(2)

# Room for the roundings of corners (2^-24 relative) and of a few operations on them, relative to their size; and for
# what float64 lost when they were made.
_SLACK = 2.0e-6
_TINY = 2.0**-44
# Chords between unit vectors are off by less than 7 u.
_CHORD = 2.0e-6
# A direction across the axis is not used if it is farther from a right angle than this.
_ACROSS = 5.0e-7


@wp.struct
class Occluder:
    """A triangle as the node tests see it, in light space."""

    edge_ab: wp.vec3  # planes through the light, inside positive, and their lengths
    edge_bc: wp.vec3
    edge_ca: wp.vec3
    edge_lengths: wp.vec3
    edge_error: float
    plane: wp.vec3  # plane . e + slope t > 0 is behind the triangle
    plane_length: float
    slope: float
    slope_error: float
    offset_error: float
    a: wp.vec3  # corners, their distances from the light, and how much a product with a unit vector may be off
    b: wp.vec3
    c: wp.vec3
    distances: wp.vec3
    slacks: wp.vec3
    tiny: float  # what float64 lost when the corners were made
    nearest: float  # no point of the triangle has a larger t
    centre: wp.vec3  # direction to the bounding sphere
    sphere_angle: float  # half-angle of the sphere as seen from the light; 4 (more than pi) if the light is in it


@wp.func
def is_never(records: wp.array2d(dtype=wp.vec4), triangle: int) -> bool:
    """Whether the record says no to everything (``light_frame.never_record``)."""
    plane = records[triangle, 3]
    return plane[0] == 0.0 and plane[1] == 0.0 and plane[2] == 0.0


@wp.func
def sphere_centre(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Centre of the smallest sphere around a triangle, about."""
    bc = wp.length_sq(c - b)
    ca = wp.length_sq(a - c)
    ab = wp.length_sq(b - a)
    if bc >= ab + ca:
        return 0.5 * (b + c)
    if ca >= ab + bc:
        return 0.5 * (c + a)
    if ab >= bc + ca:
        return 0.5 * (a + b)
    # Circumcentre; the sides are scaled by the longest, whose fourth power could overflow.
    longest = wp.max(wp.max(bc, ca), ab)
    x = bc / longest
    y = ca / longest
    z = ab / longest
    wa = x * (y + z - x)
    wb = y * (z + x - y)
    wc = z * (x + y - z)
    return (wa * a + wb * b + wc * c) / (wa + wb + wc)


@wp.func
def axis_gap(a: float, b: float, c: float) -> float:
    """Distance from 0 to the interval that holds three numbers."""
    low = wp.min(wp.min(a, b), c)
    high = wp.max(wp.max(a, b), c)
    return wp.max(wp.max(low, -high), 0.0)


@wp.func
def nearest_depth(
    space: LightSpace, least_distance: float, most_distance: float, highest: float, slack: float
) -> float:
    """A t that no point of the triangle exceeds: its distances |h| and Z lie within these bounds."""
    if not (least_distance > 0.0):
        return float(wp.inf)
    depth = 1.0 / least_distance
    if space.inverse == 0:
        top = highest + _SLACK * wp.abs(highest) + slack
        depth = top / least_distance
        if top < 0.0:
            depth = top / most_distance
    return depth + _SLACK * (1.0 + wp.abs(depth))


@wp.func
def occluder_of(
    space: LightSpace, corners: wp.array(dtype=wp.vec4), triangles: wp.array(dtype=wp.vec3i), triangle: int
) -> Occluder:
    """What both tests need: the corners and the nearest depth. The distance to the corners' bounding box in light space
    is a better bound for it than the sphere's, and cheaper."""
    out = Occluder()
    index = triangles[triangle]
    va = corners[index[0]]
    vb = corners[index[1]]
    vc = corners[index[2]]
    a = wp.vec3(va[0], va[1], va[2])
    b = wp.vec3(vb[0], vb[1], vb[2])
    c = wp.vec3(vc[0], vc[1], vc[2])
    out.a = a
    out.b = b
    out.c = c
    la = wp.length(a)
    lb = wp.length(b)
    lc = wp.length(c)
    out.distances = wp.vec3(la, lb, lc)
    tiny_a = _TINY * (1.0 + la + wp.abs(va[3]))
    tiny_b = _TINY * (1.0 + lb + wp.abs(vb[3]))
    tiny_c = _TINY * (1.0 + lc + wp.abs(vc[3]))
    tiny = tiny_a + tiny_b + tiny_c  # a sum, not the largest: it is NaN if any is
    out.slacks = wp.vec3(_SLACK * la + tiny_a, _SLACK * lb + tiny_b, _SLACK * lc + tiny_c)

    out.tiny = tiny
    gap = wp.length(wp.vec3(axis_gap(a[0], b[0], c[0]), axis_gap(a[1], b[1], c[1]), axis_gap(a[2], b[2], c[2])))
    least = gap - _SLACK * gap - tiny
    most = (wp.max(wp.max(la, lb), lc) + tiny) * (1.0 + _SLACK)
    out.nearest = nearest_depth(space, least, most, wp.max(wp.max(va[3], vb[3]), vc[3]), tiny)
    if not (tiny < 1.0e18):
        # Squares may have overflowed, and minima and maxima have dropped what is not a number.
        out.nearest = float(wp.inf)
        out.slacks = wp.vec3(float(wp.inf), float(wp.inf), float(wp.inf))
    return out


@wp.func
def add_sphere(out: Occluder) -> Occluder:
    """The bounding sphere, which only the test with spheres needs."""
    centre = sphere_centre(out.a, out.b, out.c)
    distance = wp.length(centre)
    radius = wp.max(wp.max(wp.length(out.a - centre), wp.length(out.b - centre)), wp.length(out.c - centre))
    radius += _SLACK * (distance + radius) + out.tiny
    out.centre = centre / distance
    out.sphere_angle = float(4.0)
    if radius < distance and out.tiny < 1.0e18:
        out.sphere_angle = wp.asin(wp.min(radius / distance * (1.0 + _SLACK), 1.0))
    return out


@wp.func
def add_planes(out: Occluder, space: LightSpace, records: wp.array2d(dtype=wp.vec4), triangle: int) -> Occluder:
    """The record's planes, which only the precise test needs."""
    ab = records[triangle, 0]
    bc = records[triangle, 1]
    ca = records[triangle, 2]
    out.edge_ab = wp.vec3(ab[0], ab[1], ab[2])
    out.edge_bc = wp.vec3(bc[0], bc[1], bc[2])
    out.edge_ca = wp.vec3(ca[0], ca[1], ca[2])
    out.edge_lengths = wp.vec3(wp.length(out.edge_ab), wp.length(out.edge_bc), wp.length(out.edge_ca))
    out.edge_error = ab[3]
    out.slope_error = bc[3]
    out.offset_error = ca[3]
    plane = plane_of(space, records[triangle, 3])
    out.plane = wp.vec3(plane[0], plane[1], plane[2])
    out.plane_length = wp.length(out.plane)
    out.slope = plane[3]
    if not (out.plane_length < 1.0e18 and wp.abs(out.slope) < 1.0e18):
        out.offset_error = float(wp.inf)  # squares may have overflowed: the plane decides nothing
    return out


@wp.func
def is_beyond(occluder: Occluder, farthest: float) -> bool:
    """Whether every point of the triangle is farther from the light than the farthest ray (the one of least t)."""
    return occluder.nearest < farthest - _SLACK * (1.0 + wp.abs(farthest))


@wp.func
def test_sphere(occluder: Occluder, cone: wp.vec4, extent: wp.vec4) -> int:
    """The triangle's bounding sphere against a node."""
    if is_beyond(occluder, extent[0]):
        return REJECTED
    reach = cone[3] + occluder.sphere_angle
    if reach < 3.14:
        chord = wp.length(wp.vec3(cone[0], cone[1], cone[2]) - occluder.centre)
        if chord > 2.0 * wp.sin(0.5 * reach) + _CHORD:
            return REJECTED
    return UNSURE


@wp.func
def separates(axis: wp.vec3, sine: float, cosine: float, corner: wp.vec3, occluder: Occluder) -> bool:
    """Whether the plane that touches the cone on the side of ``corner`` has the whole triangle on its other side. With
    sine = 1 and cosine = 0 it is the plane across the axis."""
    w = wp.normalize(corner - axis * wp.dot(axis, corner))
    w = wp.normalize(w - axis * wp.dot(axis, w))  # the first difference cancels for a corner near the axis
    if wp.abs(wp.dot(axis, w)) > _ACROSS:
        return False
    s = w * cosine - axis * sine
    x = wp.dot(s, occluder.a) - occluder.slacks[0]
    y = wp.dot(s, occluder.b) - occluder.slacks[1]
    z = wp.dot(s, occluder.c) - occluder.slacks[2]
    # A corner on the axis makes w a zero vector; s is then shorter, and still has no ray of the cone on its side.
    return x > 0.0 and y > 0.0 and z > 0.0


@wp.func
def is_outside(axis: wp.vec3, cosine: float, occluder: Occluder) -> bool:
    """For half-angles above pi/2: whether the triangle lies in the complementary cone, which is convex."""
    d = occluder.distances
    x = wp.dot(axis, occluder.a) - d[0] * cosine + occluder.slacks[0]
    y = wp.dot(axis, occluder.b) - d[1] * cosine + occluder.slacks[1]
    z = wp.dot(axis, occluder.c) - d[2] * cosine + occluder.slacks[2]
    return x < 0.0 and y < 0.0 and z < 0.0


@wp.func
def test_precise(occluder: Occluder, cone: wp.vec4, extent: wp.vec4) -> int:
    """The triangle itself against a node: edges, plane, depth, then the triangle's shadow (section 3.2)."""
    if is_beyond(occluder, extent[0]):
        return REJECTED
    axis = wp.vec3(cone[0], cone[1], cone[2])
    sine = extent[2]
    cosine = extent[3]
    magnitude = magnitude_bound(extent[0], extent[1])

    # Edges: over the cone, n.e runs from n.a cos A - |n_perp| sin A up; |n| for |n_perp| loses nothing that decides.
    pad = edge_pad(occluder.edge_error, magnitude)
    x = wp.dot(axis, occluder.edge_ab)
    y = wp.dot(axis, occluder.edge_bc)
    z = wp.dot(axis, occluder.edge_ca)
    rx = occluder.edge_lengths[0] * sine + pad
    ry = occluder.edge_lengths[1] * sine + pad
    rz = occluder.edge_lengths[2] * sine + pad
    if x < -rx or y < -ry or z < -rz:
        return REJECTED

    # Plane: with the angle between axis and normal, the largest and smallest of plane.e over the cone.
    pad = plane_pad(occluder.slope_error, occluder.offset_error, magnitude)
    true_sine = sine
    if sine > 1.0:
        true_sine = wp.sqrt(wp.max(1.0 - cosine * cosine, 0.0))
    along = wp.dot(axis, occluder.plane)
    across = wp.length(occluder.plane - axis * along) * true_sine
    highest = occluder.plane_length
    if along < highest * cosine:
        highest = along * cosine + across
    if highest + occluder.slope * extent[0] < -pad:
        return REJECTED
    if x > rx and y > ry and z > rz:
        lowest = -occluder.plane_length
        if along > lowest * cosine:
            lowest = along * cosine - across
        if lowest + occluder.slope * extent[1] > pad:
            return COVERED
        return UNSURE

    if cosine <= 0.0:
        if is_outside(axis, cosine, occluder):
            return REJECTED
        return UNSURE
    if sine <= 1.0:
        if separates(axis, sine, cosine, occluder.a, occluder):
            return REJECTED
        if separates(axis, sine, cosine, occluder.b, occluder):
            return REJECTED
        if separates(axis, sine, cosine, occluder.c, occluder):
            return REJECTED
    return UNSURE
