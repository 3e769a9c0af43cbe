# SPDX-License-Identifier: Apache-2.0
"""Triangles over light space, as nodes and tiles of rays see them: four planes, and bounds on each cube face.

If all corners of a triangle are in front of a cube face, it lies within the bounds of their (u, v) there, since each
point of its cone is a convex combination of corners; if none is, it cannot touch the face; if some are, it may touch
anything there.

Corners are float32: within u relative and 2^-46 R of exact, R = 1 + the corner's magnitude. With a distance in front of
the face of at least 2^-18 R, (u, v) is within 2^-27 (1 + |u|) + 3 u of exact; bounds are padded by 2^-20 (1 + |u|).
"""

from __future__ import annotations

import warp as wp


@wp.struct
class Occluders:
    """The triangles of the scene and what is known of them from a light, or from several: then records and corners of
    one lie so many behind those of the one before."""

    count: int
    records_apart: int
    corners_apart: int
    triangles: wp.array(dtype=wp.vec3i)
    corners: wp.array(dtype=wp.vec4)
    records: wp.array2d(dtype=wp.vec4)
