# SPDX-License-Identifier: Apache-2.0
"""Solid shapes made by numpy: the bricks of the demo scene."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Part:
    """A coloured triangle mesh.

    Attributes:
        vertices: (V, 3) float64, metres.
        triangles: (T, 3) int32 vertex indices.
        colours: (T, 3) float32 albedo of each triangle, sRGB in 0..1.
    """

    vertices: Floats
    triangles: NDArray[np.int32]
    colours: NDArray[np.float32]

    def moved(self, matrix: ArrayLike) -> Part:
        """The same part with its vertices transformed by an affine (4, 4) matrix."""
        m = np.asarray(matrix, dtype=np.float64)
        return Part(self.vertices @ m[:3, :3].T + m[:3, 3], self.triangles, self.colours)

    def at(self, x: float, y: float, z: float) -> Part:
        """The same part shifted by (x, y, z) metres."""
        return Part(self.vertices + np.array([x, y, z]), self.triangles, self.colours)


def make(vertices: ArrayLike, triangles: ArrayLike, colour: Colour) -> Part:
    """A part of one colour from (V, 3) vertices and (T, 3) triangles."""
    indices = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    return Part(points, indices, np.tile(np.asarray(colour, dtype=np.float32), (len(indices), 1)))


def join(parts: Iterable[Part]) -> Part:
    """All parts as one, in order."""
    items = list(parts)
    offsets = np.cumsum([0] + [len(p.vertices) for p in items[:-1]])
    return Part(
        np.concatenate([p.vertices for p in items]),
        np.concatenate([p.triangles + np.int32(o) for p, o in zip(items, offsets, strict=True)]).astype(np.int32),
        np.concatenate([p.colours for p in items]),
    )


def translation(x: float, y: float, z: float) -> Floats:
    """(4, 4) matrix of a shift in metres."""
    m = np.eye(4)
    m[:3, 3] = x, y, z
    return m


def rotation(axis: str, angle: float) -> Floats:
    """(4, 4) matrix of a turn by `angle` radians about the axis "x", "y" or "z"."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    m = np.eye(4)
    m[i, i] = m[j, j] = np.cos(angle)
    m[i, j], m[j, i] = -np.sin(angle), np.sin(angle)
    return m


def box(size: Sequence[float], colour: Colour, bevel: float = 0.0, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Part:
    """An axis-aligned box of `size` metres, with bevelled edges when `bevel` > 0."""
    half = np.asarray(size, dtype=np.float64) / 2
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    if bevel <= 0:
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        return _outwards(make(signs * half, quads_to_triangles(sides), colour)).at(*centre)
    # corner c has three vertices 3c + a: full extent along axis a, drawn in by the bevel along the others
    inset = half - min(bevel, float(half.min()) * 0.98)
    vertices = np.repeat(signs * inset, 3, axis=0)
    for axis in range(3):
        vertices[axis::3, axis] = signs[:, axis] * half[axis]
    triangles = [(3 * c, 3 * c + 1, 3 * c + 2) for c in range(8)]
    quads: list[tuple[int, ...]] = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        bit = [4 >> a for a in range(3)]
        for side in (0, bit[axis]):
            corners = [side, side | bit[u], side | bit[u] | bit[v], side | bit[v]]
            quads.append(tuple(3 * c + axis for c in corners))
        for low in (0, bit[u], bit[v], bit[u] | bit[v]):  # the edges along this axis
            high = low | bit[axis]
            quads.append((3 * low + u, 3 * high + u, 3 * high + v, 3 * low + v))
    return _outwards(make(vertices, np.concatenate([quads_to_triangles(quads), triangles]), colour)).at(*centre)


def _outwards(part: Part) -> Part:
    """A convex part around the origin, with corners counter-clockwise as seen from without."""
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    inwards = (np.cross(b - a, c - a) * a).sum(axis=1) < 0.0
    triangles = np.where(inwards[:, None], part.triangles[:, ::-1], part.triangles)
    return Part(part.vertices, triangles, part.colours)


def quads_to_triangles(quads: ArrayLike) -> NDArray[np.int32]:
    """(Q, 4) quads to (2Q, 3) triangles."""
    q = np.asarray(quads, dtype=np.int32).reshape(-1, 4)
    return np.stack([q[:, [0, 1, 2]], q[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


def bands(rings: int, around: int, closed_rings: bool = False) -> NDArray[np.int32]:
    """Triangles of `rings` rings of `around` vertices each, joined one to the next (and last to first)."""
    i = np.arange(rings if closed_rings else rings - 1)[:, None]
    j = np.arange(around)[None, :]
    k, n = (i + 1) % rings, (j + 1) % around
    quads = np.stack(np.broadcast_arrays(i * around + j, i * around + n, k * around + n, k * around + j), axis=-1)
    return quads_to_triangles(quads)


def lathe(profile: Sequence[tuple[float, float]], colour: Colour, segments: int = 24, closed: bool = False) -> Part:
    """A profile of (radius, height) points turned about z; a zero radius at an end closes it there.

    Args:
        closed: the profile is a closed curve (a ring with a hole).
    """
    points = np.asarray(profile, dtype=np.float64)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    vertices = np.empty((len(points), segments, 3))
    vertices[..., :2] = points[:, None, :1] * circle
    vertices[..., 2] = points[:, None, 1]
    triangles = bands(len(points), segments, closed)
    flat = vertices.reshape(-1, 3)
    corners = flat[triangles]
    same = [(corners[:, a] == corners[:, b]).all(axis=1) for a, b in ((0, 1), (1, 2), (2, 0))]
    return make(flat, triangles[~np.logical_or.reduce(same)], colour)


def cylinder(radius: float, height: float, colour: Colour, segments: int = 24, bevel: float = 0.0) -> Part:
    """An upright cylinder standing on z = 0."""
    b = min(bevel, radius / 2, height / 2)
    side = [(radius - b, 0.0), (radius, b), (radius, height - b), (radius - b, height)] if b > 0 else [
        (radius, 0.0), (radius, height)]  # fmt: skip
    return lathe([(0.0, 0.0), *side, (0.0, height)], colour, segments)


def tube(path: ArrayLike, radius: float, colour: Colour, segments: int = 10, closed: bool = False) -> Part:
    """A round bar along a (P, 3) path of points, with flat ends (or closed to a loop)."""
    points = np.asarray(path, dtype=np.float64)
    ahead = np.roll(points, -1, axis=0) - points
    behind = points - np.roll(points, 1, axis=0)
    if not closed:
        ahead[-1], behind[0] = behind[-1], ahead[0]
    tangent = ahead / np.linalg.norm(ahead, axis=1, keepdims=True) + behind / np.linalg.norm(
        behind, axis=1, keepdims=True
    )
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    up = np.eye(3)[np.argmin(np.abs(tangent).max(axis=0))]
    side = np.cross(tangent, up)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(tangent, side)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)[None, :, None]
    rings = points[:, None] + radius * (np.cos(angle) * side[:, None] + np.sin(angle) * other[:, None])
    triangles = bands(len(points), segments, closed)
    vertices = rings.reshape(-1, 3)
    if not closed:
        first, last = len(vertices), len(vertices) + 1
        vertices = np.concatenate([vertices, points[[0, -1]]])
        j = np.arange(segments)
        n = (j + 1) % segments
        start = np.stack([np.full_like(j, first), n, j], axis=-1)
        end = np.stack([np.full_like(j, last), j, n], axis=-1) + np.array([0, 1, 1]) * (len(points) - 1) * segments
        triangles = np.concatenate([triangles, start, end]).astype(np.int32)
    return make(vertices, triangles, colour)


def extrude(outline: ArrayLike, thickness: float, colour: Colour, bevel: float = 0.0, hole: float = 0.0) -> Part:
    """A (P, 2) outline, star-shaped about its mean, raised along z and centred on z = 0.

    Args:
        bevel: width of the slanted rim, metres.
        hole: radius of a round hole about the origin, 0 for none (then the ends are closed).
    """
    points = np.asarray(outline, dtype=np.float64)
    centre = np.zeros(2) if hole > 0 else points.mean(axis=0)
    away = points - centre
    reach = np.linalg.norm(away, axis=1, keepdims=True)
    small = centre + away * np.maximum(1 - bevel / reach, 0.05)
    if hole > 0:
        inner = hole * away / reach
    else:
        inner = np.broadcast_to(centre, points.shape)
    half = thickness / 2
    layers = [(inner, -half), (small, -half), (points, bevel - half), (points, half - bevel), (small, half),
              (inner, half)]  # fmt: skip
    rings = [np.column_stack([xy, np.full(len(xy), z)]) for xy, z in layers]
    triangles = bands(len(rings), len(points), closed_rings=hole > 0)
    flat = np.concatenate(rings)
    corners = flat[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return make(flat, triangles[area > 1e-12], colour)


def gear(radius: float, thickness: float, teeth: int, colour: Colour, hole: float = 0.0) -> Part:
    """A spur gear about z with trapezoid teeth; `radius` reaches the tips."""
    depth = 2.2 * radius / (teeth + 2)
    steps = np.array([0.0, 0.22, 0.36, 0.64, 0.78]) / teeth
    radii = np.array([radius - depth, radius - depth, radius, radius, radius - depth])
    angle = 2 * np.pi * (np.arange(teeth)[:, None] / teeth + steps).ravel()
    outline = np.tile(radii, teeth)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return extrude(outline, thickness, colour, bevel=0.08 * depth, hole=hole or 0.2 * radius)


def capsule_outline(length: float, start: float, end: float, steps: int = 14) -> Floats:
    """(P, 2) hull of a circle of radius `start` at the origin and one of radius `end` at (length, 0)."""
    lean = np.arccos(np.clip((start - end) / length, -1, 1))
    back = np.linspace(lean, 2 * np.pi - lean, steps)
    front = np.linspace(-lean, lean, steps)
    first = start * np.stack([np.cos(back), np.sin(back)], axis=-1)
    second = end * np.stack([np.cos(front), np.sin(front)], axis=-1) + np.array([length, 0.0])
    return np.concatenate([first, second])


def grid(rows: int, columns: int) -> NDArray[np.int32]:
    """Triangles of a (rows, columns) lattice of vertices, in row-major order."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    corner = i * columns + j
    quads = np.stack([corner, corner + 1, corner + columns + 1, corner + columns], axis=-1)
    return quads_to_triangles(quads)


def pierced_wall(
    width: float,
    height: float,
    thickness: float,
    openings: Sequence[tuple[float, float, float, float]],
    colours: Sequence[tuple[float, Colour]],
) -> Part:
    """A wall in the x-z plane (y from 0 to -thickness) with rectangular openings.

    Args:
        openings: (x0, x1, z0, z1) metres each.
        colours: (up to this height, colour) bands from below; the last one reaches the top.
    """
    xs = sorted({0.0, width, *(v for o in openings for v in o[:2])})
    zs = sorted({0.0, height, *(v for o in openings for v in o[2:]), *(z for z, _ in colours if z < height)})
    cells = []
    for x0, x1 in zip(xs, xs[1:], strict=False):
        for z0, z1 in zip(zs, zs[1:], strict=False):
            x, z = (x0 + x1) / 2, (z0 + z1) / 2
            if any(o[0] < x < o[1] and o[2] < z < o[3] for o in openings):
                continue
            colour = next((c for top, c in colours if z < top), colours[-1][1])
            cells.append(box((x1 - x0, thickness, z1 - z0), colour, centre=(x, -thickness / 2, z)))
    return join(cells)
