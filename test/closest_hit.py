# SPDX-License-Identifier: Apache-2.0
"""What a pixel sees, in numpy and independently of the package: float64 that knows where it is not sure, and rational
numbers.

The ray of a pixel is taken as defined: o the camera's position, d = (R0 x + R1 y) + R2 in float64. Everything else is
other arithmetic than the package's: shares of the corners in d, and their sum.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from culling import candidate_pairs

from shadow_tracer import Camera

_PAIRS_AT_ONCE = 400_000
# Of |d| |v| |w| for det[d, v, w] of camera-relative corners: many times its rounding error.
_UNSURE = 1e-13
# Pairs that miss an edge by more are not looked at: ten times as much, so that no possible hit is left out.
_LEFT_OUT = 1e-12
# Sine of the angle at which the eye may see a triangle's plane so edge-on that its depth is not known to 1e-6.
_FLAT = 1e-8


@dataclass(frozen=True)
class Closest:
    """(H, W) closest hits: depth, infinite where nothing is hit; triangle, -1 there; where float64 is sure of the hit;
    and where no other triangle is so near behind that the order is open."""

    depth: np.ndarray
    triangle: np.ndarray
    sure: np.ndarray
    alone: np.ndarray


def directions(camera: Camera) -> np.ndarray:
    """(H, W, 3) directions of the pixels' rays in the world."""
    rays, turn = camera.pixel_rays(), camera.camera_to_world[:3, :3]
    return np.stack([(turn[k, 0] * rays[..., 0] + turn[k, 1] * rays[..., 1]) + turn[k, 2] for k in range(3)], axis=-1)


def closest(camera: Camera, vertices: np.ndarray, triangles: np.ndarray) -> Closest:
    """Closest hits in float64. A hit is sure if the ray is inside all edges by more than rounding; a pixel is if the
    closest of its sure hits and the closest of its possible hits are the same."""
    vertices = vertices.astype(np.float64)
    ways = directions(camera).reshape(-1, 3)
    kept = np.isfinite(vertices[triangles]).all(axis=(1, 2))
    numbers = np.flatnonzero(kept)
    corners = vertices[triangles[numbers]]
    n = len(ways)
    sure_depth, may_depth, second = np.full(n, np.inf), np.full(n, np.inf), np.full(n, np.inf)
    triangle = np.full(n, -1)
    for rays, which in _pairs(camera, ways, corners):
        depth, sure, may = _hits(ways[rays], corners[which] - camera.position)
        np.minimum.at(may_depth, rays[may], depth[may])
        rays, which, depth = rays[sure], which[sure], depth[sure]
        # in order of rays, then depth, then triangle
        order = np.lexsort((numbers[which], depth, rays))
        rays, which, depth = rays[order], which[order], depth[order]
        first = np.ones(len(rays), bool)
        first[1:] = rays[1:] != rays[:-1]
        follows = np.zeros(len(rays), bool)
        follows[1:] = first[:-1] & ~first[1:]
        # blocks hold all pairs of their rays
        triangle[rays[first]] = numbers[which[first]]
        sure_depth[rays[first]] = depth[first]
        second[rays[follows]] = depth[follows]
    sure = sure_depth == may_depth
    with np.errstate(invalid="ignore"):
        sure |= sure_depth - may_depth <= 1e-9 * may_depth
        alone = ~(second - sure_depth <= 1e-9 * second)
    shape = (camera.height, camera.width)
    return Closest(sure_depth.reshape(shape), triangle.reshape(shape), sure.reshape(shape), alone.reshape(shape))


def _pairs(camera: Camera, ways: np.ndarray, corners: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    if len(corners) <= 3000:
        block = max(1, _PAIRS_AT_ONCE // max(1, len(corners)))
        a, b, c = (corners - camera.position).transpose(1, 0, 2)
        sides = [(v, w, np.linalg.norm(v, axis=1) * np.linalg.norm(w, axis=1)) for v, w in ((b, c), (c, a), (a, b))]
        crosses = [(np.cross(v, w).T, _LEFT_OUT * size) for v, w, size in sides]
        for first in range(0, len(ways), block):
            some = ways[first : first + block]
            lengths = np.linalg.norm(some, axis=1)[:, None]
            shares = [(some @ cross, lengths * slack) for cross, slack in crosses]
            with np.errstate(invalid="ignore"):
                within = np.logical_and.reduce([s >= -e for s, e in shares])
                within |= np.logical_and.reduce([s <= e for s, e in shares])
            rays, which = np.nonzero(within)
            yield first + rays, which
        return
    reach = 2.0 * np.linalg.norm(corners - camera.position, axis=2).max()
    yield from candidate_pairs(camera.position + reach * ways, camera.position, 1.0, corners, _PAIRS_AT_ONCE)


def _hits(ways: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(depth, surely hit, possibly hit) of pairs; corners relative to the camera."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    crosses = (np.cross(b, c), np.cross(c, a), np.cross(a, b))
    volume = (a * np.cross(b - a, c - a)).sum(axis=1)
    sign = np.where(volume < 0.0, -1.0, 1.0)
    shares = [(ways * cross).sum(axis=1) * sign for cross in crosses]
    length, la, lb, lc = (np.linalg.norm(v, axis=1) for v in (ways, a, b, c))
    slack = [_UNSURE * length * s for s in (lb * lc, lc * la, la * lb)]
    flat = np.abs(volume) <= _FLAT * la * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    may = np.logical_and.reduce([s >= -e for s, e in zip(shares, slack, strict=True)])
    may |= flat & np.logical_and.reduce([s <= e for s, e in zip(shares, slack, strict=True)])
    sure = ~flat & np.logical_and.reduce([s > e for s, e in zip(shares, slack, strict=True)])
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.abs(volume) / sum(shares)
    depth = np.where(np.isfinite(depth) & ~flat, depth, 0.0)
    return depth, sure, may


def exact_hits(
    camera: Camera, row: int, column: int, vertices: np.ndarray, triangles: np.ndarray
) -> dict[int, Fraction]:
    """Exact depth of every triangle that the ray of a pixel meets."""
    way = [Fraction(float(v)) for v in directions(camera)[row, column]]
    eye = [Fraction(float(v)) for v in camera.position]
    found = {}
    for number, corner in enumerate(vertices[triangles]):
        if not np.isfinite(corner).all():
            continue
        a, b, c = ([Fraction(float(v)) - e for v, e in zip(p, eye, strict=True)] for p in corner)
        volume = _det(a, b, c)
        if volume == 0:
            continue
        shares = [_det(way, b, c) / volume, _det(a, way, c) / volume, _det(a, b, way) / volume]
        if min(shares) >= 0:
            found[number] = 1 / sum(shares)
    return found


def _det(a: list[Fraction], b: list[Fraction], c: list[Fraction]) -> Fraction:
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
