# SPDX-License-Identifier: Apache-2.0
"""Boxes of triangles for a tree, in units of a box around all of them; ``mesh_bvh.py`` says how exact they are."""

from __future__ import annotations

import numpy as np
import warp as wp

# Padding of boxes in units of the scene's extent.
PADDING = 2.0**-19
# Boxes without a triangle lie here, along y; the scene's reach to 1 and their padding.
_OUTSIDE = 1.02


@wp.struct
class SceneBox:
    """The box that holds every triangle: its centre [m], one over its largest half size, and its half size in units of
    that, padded."""

    center: wp.vec3d
    inverse_extent: wp.float64
    half: wp.vec3d


@wp.func
def outside(i: int, boxes: int) -> wp.vec3:
    """Where box number ``i`` of so many lies if it holds nothing."""
    return wp.vec3(_OUTSIDE, 2.0 * float(i) / float(boxes) - 1.0, 0.0)


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
    """Padded boxes relative to the scene's centre, rounded outwards, from ``first`` on; of triangles that cast nothing,
    those of gaps among them, boxes that hold nothing."""
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


def holds(held: tuple[np.ndarray, np.ndarray], low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a box that holds ``held`` serves: it holds all there is, and is not twice as large."""
    inside = np.all(held[0] <= low) and np.all(high <= held[1])
    return bool(inside and (held[1] - held[0]).max() <= 2.0 * (high - low).max())


def scene_box(low: np.ndarray, high: np.ndarray) -> SceneBox:
    center = 0.5 * low + 0.5 * high
    half = np.maximum(high - center, center - low)
    extent = max(float(half.max()), 1e-60)
    box = SceneBox()
    box.center = wp.vec3d(*center)
    box.inverse_extent = 1.0 / extent
    box.half = wp.vec3d(*(half / extent + 2.0 * PADDING))
    return box
