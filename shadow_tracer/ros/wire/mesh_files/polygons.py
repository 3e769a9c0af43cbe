# SPDX-License-Identifier: Apache-2.0
"""Triangles of polygons, concave ones too.

A polygon is cut in its projection along the axis that its normal is closest to. Dropping a coordinate rounds nothing,
and a polygon that is not quite plane is still covered between its own corners. Every cut has n - 2 triangles for n
corners and uses each edge of the polygon, so that no light gets through between neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import FloatArray, IntArray, ReadError
from shadow_tracer.scene.checks import LARGEST

_DIGITS = 2e-5  # of the largest coordinate: what six digits leave open, twice the area of a sliver of that width
_FAR = 10.0  # extents of a polygon from the origin, beyond which files have more digits
_CURE = "triangulate the mesh in the program that wrote it"


def triangulate(vertices: FloatArray, corners: IntArray, counts: IntArray) -> IntArray:
    """Cut polygons into triangles.

    Args:
        vertices: (V, 3) positions.
        corners: the corners of all polygons, one after the other, from 0 to V - 1.
        counts: (P,) corners of each polygon, 3 or more.

    Returns:
        (sum of counts - 2 P, 3) triangles in the order of the polygons.

    Raises:
        ReadError: a polygon crosses itself, or is concave and mapbox_earcut is missing.
    """
    firsts = np.cumsum(counts) - counts
    starts = np.cumsum(counts - 2) - (counts - 2)
    triangles = np.empty((int((counts - 2).sum()), 3), np.int64)
    for count in np.unique(counts):
        chosen = np.flatnonzero(counts == count)
        polygons = corners[firsts[chosen, None] + np.arange(count)]
        cut = _fans(polygons)
        if count > 3:
            with np.errstate(over="ignore", invalid="ignore"):
                flat = _projected(vertices[polygons])
                bent = ~_convex(flat) if count > 4 else _cut_quads(polygons, flat, cut, chosen)
            for k in np.flatnonzero(bent):
                found = polygons[k][_clip(flat[k], (count,), f"polygon {chosen[k]} (counted from 0)")]
                cut[k] = polygons[k, 0]  # corners that stand twice leave triangles without area
                cut[k, : len(found)] = found
        triangles[starts[chosen, None] + np.arange(count - 2)] = cut
    return triangles


def triangulate_rings(vertices: FloatArray, rings: Sequence[IntArray], what: str) -> IntArray:
    """Triangles of one polygon with holes: the corners of the outline, then those of each hole.

    Raises:
        ReadError: rings cross, a ring has fewer than three corners, or mapbox_earcut is missing; it names ``what``.
    """
    if min(map(len, rings)) < 3:
        raise ReadError(f"{what} has a hole or an outline with fewer than 3 corners")
    corners = np.concatenate(rings)
    points = vertices[corners]
    axis = _axis(points[None, : len(rings[0])])[0]
    flat = points[:, [(axis + 1) % 3, (axis + 2) % 3]]
    ends = tuple(int(end) for end in np.cumsum([len(ring) for ring in rings]))
    return corners[_clip(flat, ends, what)]


def _fans(polygons: IntArray) -> IntArray:
    """(P, n - 2, 3) fans from the first corners of (P, n) polygons."""
    first = np.broadcast_to(polygons[:, :1], (len(polygons), polygons.shape[1] - 2))
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)


def _axis(points: FloatArray) -> IntArray:
    """(P,) the axis that the normal of each of (P, n, 3) polygons is closest to."""
    away = points - points[:, :1]
    normals = np.cross(away[:, 1:-1], away[:, 2:])
    # The second part decides where the first is nothing: the halves of a figure of eight.
    return np.asarray((np.abs(normals.sum(axis=1)) + 1e-6 * np.abs(normals).sum(axis=1)).argmax(axis=1))


def _projected(points: FloatArray) -> FloatArray:
    """(P, n, 2) polygons without the coordinate along that axis; corners that are not finite become 0, as their
    polygons are refused later, with the vertex."""
    points = np.where(np.abs(points) <= LARGEST, points, 0.0)
    axis = _axis(points)
    pair = np.stack([(axis + 1) % 3, (axis + 2) % 3], axis=1)
    return np.take_along_axis(points, np.broadcast_to(pair[:, None, :], (*points.shape[:2], 2)), axis=2)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _convex(flat: FloatArray) -> Any:
    """(P,) whether each of (P, n, 2) polygons turns to one side only, and only once around."""
    ahead = np.roll(flat, -1, axis=1) - flat
    behind = np.roll(ahead, 1, axis=1)
    turn = _cross(behind, ahead)
    angle = np.arctan2(turn, (behind * ahead).sum(axis=2)).sum(axis=1)
    return ((turn >= 0.0).all(axis=1) | (turn <= 0.0).all(axis=1)) & (np.abs(np.abs(angle) - 2.0 * np.pi) < 1.0)


def _cut_quads(quads: IntArray, flat: FloatArray, cut: IntArray, numbers: IntArray) -> Any:
    """Cut (P, 4) quads along the diagonal that lies inside, into ``cut``; none is left for the clipping."""
    a, b, c, d = (flat[:, k] for k in range(4))
    first, second = _cross(b - a, c - a), _cross(c - a, d - a)
    third, fourth = _cross(c - b, d - b), _cross(d - b, a - b)
    # The part that is wound the other way: none is best, and one that comes of rounding in slivers does not matter.
    here = np.where(first * second >= 0.0, 0.0, np.minimum(abs(first), abs(second)))
    there = np.where(third * fourth >= 0.0, 0.0, np.minimum(abs(third), abs(fourth)))
    other = there < here
    crossing = np.minimum(here, there) > _negligible(flat)
    if crossing.any():
        raise _crossing(f"polygon {numbers[np.flatnonzero(crossing)[0]]} (counted from 0)")
    cut[other] = quads[other][:, [[1, 2, 3], [1, 3, 0]]]
    return np.zeros(len(quads), bool)


def _negligible(flat: FloatArray) -> FloatArray:
    """(...) twice the areas that rounding of coordinates adds or takes in polygons, (..., n, 2)."""
    extent = np.ptp(flat, axis=-2).max(axis=-1)
    return np.asarray(_DIGITS * extent * np.minimum(np.abs(flat).max(axis=(-2, -1)), _FAR * extent))


def _crossing(what: str) -> ReadError:
    return ReadError(f"{what} crosses itself, so that its surface is not defined; {_CURE}")


def _clip(flat: FloatArray, ends: tuple[int, ...], what: str) -> IntArray:
    """(T, 3) numbers of corners: the triangles that earcut makes of rings, (n, 2), which end before ``ends``."""
    extent = np.ptp(flat, axis=0)
    fan = _fans(np.arange(len(flat))[None])[0]
    if len(ends) == 1 and not _areas(flat, fan).any():
        return fan  # no area whichever way it is cut
    try:
        from mapbox_earcut import triangulate_float64
    except ImportError as error:
        raise ReadError(
            f"{what} is concave or has holes, which needs mapbox_earcut: pip install 'shadow_tracer[mesh]'"
        ) from error
    # Towards the origin and to one size: products neither overflow nor vanish.
    scaled = np.ascontiguousarray((flat - flat.min(axis=0)) / max(extent.max(), np.finfo(np.float64).tiny))
    triangles = triangulate_float64(scaled, np.array(ends, np.uint32)).reshape(-1, 3).astype(np.int64)
    rings = [np.arange(first, end) for first, end in zip((0, *ends[:-1]), ends, strict=True)]
    outline, *holes = (abs(_areas(scaled, _fans(ring[None])[0]).sum()) for ring in rings)
    areas = _areas(scaled, triangles)
    if abs(np.abs(areas).sum() - (outline - sum(holes))) > 0.5 * _negligible(flat) / extent.max() ** 2:
        raise _crossing(what)
    if len(triangles) < len(flat) - 2 + 2 * len(holes):
        triangles = _with_all_corners(scaled, triangles, rings)
    # Wound as the polygon, which earcut does not keep.
    ahead = _areas(scaled, _fans(rings[0][None])[0]).sum()
    turned = np.sign(_areas(scaled, triangles).sum()) * np.sign(ahead) < 0.0
    return np.ascontiguousarray(triangles[:, ::-1]) if turned else triangles


def _areas(flat: FloatArray, triangles: IntArray) -> FloatArray:
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    return 0.5 * _cross(b - a, c - a)


def _with_all_corners(flat: FloatArray, triangles: IntArray, rings: Sequence[IntArray]) -> IntArray:
    """Put back corners that earcut has left out because they lie on a line between others: the edge that passes one
    by is split there, or a gap of rounding could open beside a neighbour that has this corner."""
    edges = {(int(a), int(b)) for ring in rings for a, b in zip(ring, np.roll(ring, -1), strict=True)}
    edges |= {(b, a) for a, b in edges}
    open_ = [tuple(map(int, triangle)) for triangle in triangles]
    done: list[tuple[int, ...]] = []
    wanted = len(flat) - 2 + 2 * (len(rings) - 1)
    while open_:
        if len(open_) + len(done) > wanted:
            return triangles  # folded onto itself within rounding: no corner of it has a place on one edge only
        triangle = open_.pop()
        others = {(t[k], t[k - 1]) for t in (*open_, *done) for k in range(3)}
        for k in range(3):
            a, b, c = triangle[k - 1], triangle[k], triangle[k - 2]
            between = [] if (a, b) in edges or (a, b) in others else _between(flat, a, b, c)
            if between:
                open_ += [(a, between[0], c), (between[0], b, c)]
                break
        else:
            done.append(triangle)
    return np.array(done, np.int64).reshape(-1, 3)


def _between(flat: FloatArray, a: int, b: int, c: int) -> list[int]:
    """Corners on the line from a to b, without its ends and c."""
    along, off = flat[b] - flat[a], flat - flat[a]
    share = off @ along
    near = np.abs(_cross(along, off)) <= 1e-14
    return [int(k) for k in np.flatnonzero(near & (share > 0.0) & (share < along @ along)) if k not in (a, b, c)]
