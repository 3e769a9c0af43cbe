# SPDX-License-Identifier: Apache-2.0
"""What can be asked about rays that walk through a structure.

A query is a C++ header whose struct ``Query`` takes some rays, is shown triangles, and notes the answers; and the type
of what it needs for that, a struct of Warp named for it. Walks know neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact import mask_filter, mask_range
from shadow_tracer.gpu.exact.camera_records import CameraRays, CameraTriangles
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.visibility.answers import Answers
from shadow_tracer.gpu.visibility.depth_image import Image


@dataclass(frozen=True)
class Query:
    """One of the questions.

    Attributes:
        header: its C++ header.
        asked: the type of what it needs.
    """

    header: str
    asked: Any

    @property
    def name(self) -> str:
        """The header's, without folder and ending."""
        return PurePath(self.header).stem


@wp.struct
class AnyHit:
    """Whether anything hides the rays of one light: in the frame of that light, with the triangles as it sees them."""

    width: int  # of the image that the samples come from; 0 if they are a list of points
    rays: wp.array(dtype=wp.vec4)
    occluders: Occluders
    answers: Answers


ANY_HIT = Query("visibility/any_hit.h", AnyHit)

# Points of a light that a mask has bits for.
MASK_POINTS = mask_filter.POINTS
# Bins along each side of a flat light, and what is behind the last.
MASK_BINS = mask_range.BINS + 1
# In units of the sum of the magnitudes that a determinant's terms are products of. Coordinates relative to the sample
# are within u of exact, u = 2^-53, and so each of the six products of three is within 3 u, and the three sums and
# products that make the determinant of them round five times more: 8 u and second orders, 9e-16. For the plane of the
# triangle it is the sum of two determinants, each with a pad.
MASK_PAD = 1e-14
# By how much more than their pads determinants in place are away from zero where they are to be sure of something: so
# that nothing that they are made of is lost below the least numbers of float64.
IN_PLACE_LEAST = 1e-290
native.constants(MASK_PAD=MASK_PAD, IN_PLACE_LEAST=IN_PLACE_LEAST)


@wp.struct
class Mask:
    """Which of some points of a light samples do not see: in the coordinates of the scene."""

    count: int  # of points, at most MASK_POINTS
    points: wp.array(dtype=wp.vec4d)
    middle: wp.vec4d  # of a box that holds them, and its half size along each axis [m]
    extent: wp.vec3d
    offsets: wp.array(dtype=float)  # of the points from the middle, along x, y and z; for the CPU
    ranges: int  # whether they are in a plane, or in a tube, and there are, also for the CPU:
    radius: wp.float64  # of the tube, else 0
    u: wp.vec3d  # half sides of a rectangle that holds them; half of the tube's axis, and nothing
    v: wp.vec3d
    beyond: wp.array(dtype=wp.uint64)  # of each bin along u, then v, those from there on (``exact/mask_range.py``)
    positions: wp.array(dtype=wp.vec4d)  # of samples, with their bias
    states: wp.array(dtype=wp.uint8)  # those that are LIT or SHADOWED ask
    samples: int  # how many there are
    width: int  # of the image that they come from; 0 if they are a list of points
    every: int  # and of them one in so many
    seen: wp.array(dtype=wp.uint64)  # the answers: a bit for each point that is seen
    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)
    triangle_count: int
    cull: int
    counters: wp.array2d(dtype=wp.int64)


MASK = Query("visibility/mask.h", Mask)


@wp.struct
class InPlace:
    """Whether anything hides the rays of one light, decided where it is shown, from the coordinates of the scene: for
    walks that show a ray a few triangles, of which records would cost more than they save."""

    width: int  # of the image that the samples come from; 0 if they are a list of points
    light: wp.vec4d
    cull: int
    triangle_count: int
    positions: wp.array(dtype=wp.vec4d)  # of samples, with their bias
    rays: wp.array(dtype=wp.vec4)  # empty if all samples that are LIT have one
    states: wp.array(dtype=wp.uint8)
    passed: wp.array(dtype=wp.uint8)  # rays that a part of the structure is known not to hide: 1; or all of it: 2
    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)
    counters: wp.array2d(dtype=wp.int64)


IN_PLACE = Query("visibility/in_place.h", InPlace)


@wp.struct
class Closest:
    """Which triangle each pixel of a camera sees, and how far away."""

    rays: CameraRays
    seen: CameraTriangles
    count: int  # of triangles
    slack: wp.array(dtype=wp.float64)  # one number, see exact/depth_slack.py
    image: Image
    nodes: wp.array(dtype=wp.int64)  # visited, one sum for each row of the counters
    counters: wp.array2d(dtype=wp.int64)


CLOSEST = Query("visibility/closest.h", Closest)
ALL = (ANY_HIT, MASK, IN_PLACE, CLOSEST)
