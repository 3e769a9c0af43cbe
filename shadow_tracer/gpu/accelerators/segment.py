# SPDX-License-Identifier: Apache-2.0
"""Rays as segments in the box of the scene, for structures over space.

Let E be the largest coordinate of the scene's box around its centre O. A ray is clipped to the (padded) box in float64,
relative to O in units of E, so that its float32 start lies within E and its length within 2 sqrt(3) E. With u = 2^-24,
start and direction then displace a point of the ray by at most 5 u E per axis. A structure that pads its boxes by
``PADDING`` (32 u), relative to O and rounded outwards from float64, may spend the other 27 u E on roundings of its
walk. Direction components below 1e-20 are replaced by 1e-20, so 1/0 and 0 * infinity cannot occur; that displaces a
point by less than 1e-19 E. Clipping rounds by 2^-50 of the sample's distance from O; a sample farther away than 2^26 E,
where that would eat the padding, is shown every triangle instead.

A query may be about a bundle of rays from a sample to points in a box around the light, of half size e along each
axis (``query.spread()``). A point of such a ray with share s of the way is within s e of the point of the middle ray
with that share. So it is clipped to the box of the scene made larger by e, which holds the middle ray's points with
those shares. Of a light at infinity, the rays are p + s w with |w - m| <= e along each axis and w - m across m, the
unit way of the middle ray: what a ray meets at s is at least s away from p, along m, so s is at most the distance to
the farthest corner of the scene's box, and e times that takes the place of e.

``above`` and ``below`` are the origin moved by the most that rays may be beside it anywhere, for walks that take a
bundle for a beam of one width. ``upper`` and ``lower`` (``bvh/bundle_sides.h``) begin where the bundle does, moved by
what it is wide there, and go along each axis by ``1 / upper_inverse`` and ``1 / lower_inverse``, so a bundle gets wider
with the way, a pyramid. At t along it rays are between lower + t / lower_inverse and upper + t / upper_inverse; a box
is met if there is a t for which that range meets the box's along each axis: six inequalities in t (exact for the union
of the boxes that the points with share s lie in). A pyramid is taken 1e-5 wider than it is (``WIDER``). Let a be how
wide it is where it enters the box of the scene, b how much wider it gets in a unit of t: roundings of ``upper`` are u
(1 + a) at most, those of a slope u (1 + b), those of the quotient 3 u (2 + a + b t) as a displacement of the box's
face. What scales with a and b t is less than 1e-5 of it; the rest is 1 u + 4 u + 6 u, of the 27 u E that there are.
Where b is 1e6 or more, the sample is in the middle of the light, and the pyramid is replaced by the beam.

A shaft (``bvh/shaft.h``) is around the ways from a box of samples, low p to high P, to a box of points, m - e to
m + e. A point with share s of any of these ways is between p + s (m - e - p) and P + s (m + e - P) along each axis, so
``lower`` and ``upper`` begin at p and P, and s takes the place of t, up to 1; of a light at infinity they are between
p + s (m - e) and P + s (m + e), with m and e as above and s without end. Samples are within 2 E of O along each axis,
and nothing is clipped. Faces lie within E, so ``upper`` rounds by 2 u E, its difference from a face by 3 u E, and the
slope, its reciprocal and the product of both by 3 u E each, taken as displacements of the face: s times the slope is
that difference. These are 14 of the 27 u E. p and P are differences from O as a sample alone has them, and e is taken
1e-5 larger.

A query may find out on the way that nothing matters beyond some length (``query.shortened()``). The segment then ends
there (``shorten``), or a little behind: the length in units of E, less where the box begins, is off by what clipping
rounds, which the padding holds, and is taken 1e-4 longer. A point of the exact ray before that length is before the
end, and padding is enough for a walk to find it in its box or cell: however it rounds, it finds that the ray enters a
padded box no later than any point that the exact ray has in the box without padding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.scene.checks import FloatArray

# Of boxes, in units of the scene's extent.
PADDING = 2.0**-19
# Where boxes lie that hold nothing: here in x, beyond the scene's reach to 1 and all padding, each elsewhere in y.
OUTSIDE = 1.02
_FAR_AWAY = 2.0**26
# Of bundles of rays: what they are taken to be, in parts of their width; and from which slope on they are beams.
_WIDER, _STEEPEST = 1.00001, 1.0e6
native.constants(BOX_OUTSIDE=OUTSIDE, BOX_PADDING=PADDING, FAR_AWAY=_FAR_AWAY, WIDER=_WIDER, STEEPEST=_STEEPEST)


@wp.struct
class SceneBox:
    """The box that holds every triangle: its centre [m], one over its largest half size, and its half size in units of
    that, padded."""

    center: wp.vec3d
    inverse_extent: wp.float64
    half: wp.vec3d


def scene_box(low: FloatArray, high: FloatArray) -> SceneBox:
    """Of the low and the high corner of a box around all finite vertices."""
    center = 0.5 * low + 0.5 * high
    half = np.maximum(high - center, center - low)
    extent = max(float(half.max()), 1e-60)
    box = SceneBox()
    box.center = wp.vec3d(*center)
    box.inverse_extent = 1.0 / extent
    box.half = wp.vec3d(*(half / extent + 2.0 * PADDING))
    return box


def holds(held: tuple[FloatArray, FloatArray], low: FloatArray, high: FloatArray) -> bool:
    """Whether a box around ``held`` serves for another: it holds that, and is not twice as large."""
    inside = np.all(held[0] <= low) and np.all(high <= held[1])
    return bool(inside and (held[1] - held[0]).max() <= 2.0 * (high - low).max())


@wp.func
def along(v: Any, axis: int) -> Any:
    """A component. Not by an index: on CUDA it would put the vector into local memory."""
    return wp.where(axis == 0, v[0], wp.where(axis == 1, v[1], v[2]))


@wp.func
def outside(i: int, boxes: int) -> wp.vec3:
    """Where box number ``i`` of so many lies if it holds nothing."""
    return wp.vec3(OUTSIDE, 2.0 * float(i) / float(boxes) - 1.0, 0.0)


@wp.kernel(enable_backward=False)
def empty_boxes(first: int, boxes: int, lowers: wp.array(dtype=wp.vec3), uppers: wp.array(dtype=wp.vec3)):
    """Boxes without a triangle, from ``first`` on."""
    i = first + wp.tid()
    lowers[i] = outside(i, boxes)
    uppers[i] = lowers[i]


@wp.kernel(enable_backward=False)
def triangle_boxes(
    first: int,
    boxes: int,
    box: SceneBox,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """Padded boxes of triangles from ``first`` on, relative to the scene's centre, rounded outwards; of those that cast
    nothing, those of gaps among them, boxes that hold nothing."""
    i = first + wp.tid()
    corners = triangles[i]
    a = (vertices[corners[0]] - box.center) * box.inverse_extent
    b = (vertices[corners[1]] - box.center) * box.inverse_extent
    c = (vertices[corners[2]] - box.center) * box.inverse_extent
    if not (wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)):
        lowers[i] = outside(i, boxes)
        uppers[i] = lowers[i]
        return
    padding = wp.float64(PADDING)
    low = wp.min(wp.min(a, b), c)
    high = wp.max(wp.max(a, b), c)
    # The padding is 32 ulps of the largest coordinate, rounding to float32 half an ulp: outward by far.
    lowers[i] = wp.vec3(float(low[0] - padding), float(low[1] - padding), float(low[2] - padding))
    uppers[i] = wp.vec3(float(high[0] + padding), float(high[1] + padding), float(high[2] + padding))
