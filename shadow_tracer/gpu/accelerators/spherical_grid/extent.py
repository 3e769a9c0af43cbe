# SPDX-License-Identifier: Apache-2.0
"""The angles a triangle takes up around the light, so that no ray in its shadow is elsewhere.

Exactly, such a ray's direction is a sum of non-negative multiples of h(a), h(b), h(c). Corners are stored in float32:
if |h| >= 2^-18 R (``corners.py``), their directions are within 2^-23 of exact. Let k > 0 be the least cosine between a
corner and their common middle direction, so that a sum of multiples of unit corners with the total 1 has at least the
length k. Then the stored ray, itself within 3 u of exact (``admission.py``), is within eta = 2^-20 / k of some
direction x of the *stored* corners' cone, and

- elevation: V of x is a mean of the unit corners' V, divided by something between k and 1. So sin(elevation) is at
  most max V / k if that is positive, at most max V if not; at least min V, and min V / k if that is negative. Arcs
  that bulge towards a pole and triangles around a pole need no special case;
- azimuth: (U, W) of x is a sum of the corners' (U, W). If these leave a gap of more than pi, x is opposite the gap,
  modulo 2 pi; else it may be anywhere. In a row whose directions are at least q from the V axis, the ray's azimuth is
  within arcsin(eta / q) of that of x; in rows nearer to a pole than 4 eta all azimuths are taken;
- a corner too near the light, corners not within about 86 degrees of a middle, anything not finite: the whole grid.

Angles are padded by 2^-16 rad: four times what atan2, asin, the reduction modulo 2 pi and the grid's own arithmetic
may be off together.
"""

from __future__ import annotations

import warp as wp

TURN = 6.283185307179586
PAD = wp.constant(2.0**-16)
_SINE_PAD = 2.0**-20
_CORNER_ERROR = 2.0**-20
_LEAST_COSINE = 1.0 / 16.0
_NEAR_LIGHT = 2.0**-18
_FAR_OUT = 1.0e18


@wp.struct
class Extent:
    """Angles a triangle may take up."""

    south: float
    north: float
    west: float
    width: float
    around: int  # any azimuth
    eta: float


@wp.func
def everywhere(extent: Extent) -> Extent:
    extent.south = -4.0
    extent.north = 4.0
    extent.around = 1
    return extent


@wp.func
def azimuths_of(extent: Extent, a: wp.vec4, b: wp.vec4, c: wp.vec4) -> Extent:
    """The azimuths opposite the largest gap between those of the corners."""
    one = wp.atan2(a[0], a[2])
    two = wp.atan2(b[0], b[2])
    three = wp.atan2(c[0], c[2])
    low = wp.min(one, wp.min(two, three))
    high = wp.max(one, wp.max(two, three))
    middle = wp.max(wp.min(one, two), wp.min(wp.max(one, two), three))
    first = middle - low
    second = high - middle
    third = TURN - (high - low)
    gap = third
    extent.west = low
    if first > gap:
        gap = first
        extent.west = middle
    if second > gap:
        gap = second
        extent.west = high
    extent.width = TURN - gap
    extent.around = wp.where(gap > 0.5 * TURN + PAD, 0, 1)
    return extent


@wp.func
def elevations_of(a: wp.vec4, b: wp.vec4, c: wp.vec4) -> Extent:
    """Elevations of the triangle with these corners, and whether its azimuths are worth asking for."""
    extent = Extent()
    la = wp.length(wp.vec3(a[0], a[1], a[2]))
    lb = wp.length(wp.vec3(b[0], b[1], b[2]))
    lc = wp.length(wp.vec3(c[0], c[1], c[2]))
    most = wp.max(wp.max(wp.abs(a[3]), wp.abs(b[3])), wp.abs(c[3])) + 1.75 * wp.max(wp.max(la, lb), lc) + 1.0
    if not (most < _FAR_OUT and wp.min(wp.min(la, lb), lc) > _NEAR_LIGHT * most):
        return everywhere(extent)
    ea = wp.vec3(a[0], a[1], a[2]) / la
    eb = wp.vec3(b[0], b[1], b[2]) / lb
    ec = wp.vec3(c[0], c[1], c[2]) / lc
    middle = ea + eb + ec
    cosine = wp.min(wp.min(wp.dot(ea, middle), wp.dot(eb, middle)), wp.dot(ec, middle)) / wp.length(middle) - _SINE_PAD
    if not cosine > _LEAST_COSINE:
        return everywhere(extent)
    extent.eta = _CORNER_ERROR / cosine
    north = wp.max(wp.max(ea[1], eb[1]), ec[1]) + _SINE_PAD
    south = wp.min(wp.min(ea[1], eb[1]), ec[1]) - _SINE_PAD
    if north > 0.0:
        north = north / cosine
    if south < 0.0:
        south = south / cosine
    extent.north = wp.asin(wp.min(north, 1.0)) + extent.eta + PAD
    extent.south = wp.asin(wp.max(south, -1.0)) - extent.eta - PAD
    return extent


@wp.func
def azimuth_pad(extent: Extent, aside: float) -> float:
    """What to add to both ends of the azimuths in a row whose directions are at least ``aside`` from the V axis;
    negative: all azimuths are taken there."""
    if extent.around != 0 or not aside > 4.0 * extent.eta:
        return -1.0
    return PAD + 1.1 * extent.eta / aside
