# SPDX-License-Identifier: Apache-2.0
"""By how much the depth of a hit, as it is computed, may be less than it is: so far behind a hit may one lie that is
counted as closer.

Whether a ray meets a triangle is decided exactly, its depth is rounded (``hit.py``), and where the eye is almost in the
triangle's plane it may be anything between the depths of the corners. With v = 2^-53, sums of magnitudes |.|, A the
product of two edges of the triangle and R the distance of its farthest corner: N = e1 x e2 is computed within 4 v A,
so N . (a - o) within 8.1 v A R and N . d within 7.1 v A |d|, and t = N . (a - o) / N . d. A hit lies between the
corners, t |d| <= R: relative to what they are, both are off by at most r = 8.1 v A R / |N . (a - o)|. For r < 1/4 the
depth is too small by at most (2 r + v) t. That is asked with 64 v for 8.1 v, which also pays for what is computed
here, and for N . (a - o) being the computed one.

In any case depth is kept between those of the corners. These, with the direction of the ray and the inverse of the
camera's rotation, are off by less than 80 v R; 2^-43 R is added for that. The largest over all triangles of

    min(farthest - nearest corner, 2^-47 A R / |N . (a - o)| farthest corner) + 2^-43 R

is therefore enough for any of them.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.exact.camera_records import CameraRays, CameraTriangles

# Columns of a plane (``depth_plane.h``), and where a record says whether a triangle is seen at all
# (``camera_record.h``).
_OFFSET, _NEAREST, _FARTHEST = wp.constant(3), wp.constant(4), wp.constant(5)
_CASTS_ROW, _CASTS_COLUMN = wp.constant(2), wp.constant(3)
_PLANE_ERROR = wp.constant(wp.float64(2.0**-47))
_CORNER_ERROR = wp.constant(wp.float64(2.0**-43))


@wp.func
def size_of(way: wp.vec3d) -> wp.float64:
    """The sum of its magnitudes."""
    return wp.abs(way[0]) + wp.abs(way[1]) + wp.abs(way[2])


@wp.kernel(enable_backward=False)
def measure_slack(rays: CameraRays, seen: CameraTriangles, slack: wp.array(dtype=wp.float64)):
    """``slack[0]``, 0 before, becomes the slack [m]. One thread per triangle."""
    i = wp.tid()
    if seen.records[i, _CASTS_ROW][_CASTS_COLUMN] == 0.0:
        return
    corners = seen.triangles[i]
    a = seen.vertices[corners[0]]
    b = seen.vertices[corners[1]]
    c = seen.vertices[corners[2]]
    edge = wp.max(wp.max(size_of(b - a), size_of(c - b)), size_of(a - c))
    away = wp.max(wp.max(size_of(a - rays.position), size_of(b - rays.position)), size_of(c - rays.position))
    mine = seen.planes[i, _FARTHEST] - seen.planes[i, _NEAREST]
    by_plane = _PLANE_ERROR * edge * edge * away / wp.abs(seen.planes[i, _OFFSET]) * seen.planes[i, _FARTHEST]
    if by_plane < mine:  # not where it is not a number
        mine = by_plane
    mine += _CORNER_ERROR * away
    if mine > slack[0]:
        wp.atomic_max(slack, 0, mine)
