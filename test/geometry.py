# SPDX-License-Identifier: Apache-2.0
"""Meshes made by code for the tests. Every function returns (vertices (V,3) float64, triangles (T,3) int32); all
are deterministic.

A sphere has the same bits on every machine: it is made with + - * / and sqrt alone, which IEEE 754 rounds correctly.
``np.linalg.norm``, ``@`` and ``einsum`` add in an order that BLAS and the processor choose, and sines, exponentials
and normal deviates are only as good as the library that makes them: a test that depends on a last bit must not use
them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

Geometry = tuple[np.ndarray, np.ndarray]


def join(parts: Iterable[Geometry]) -> Geometry:
    """All parts as one mesh."""
    vertices, triangles, count = [], [], 0
    for part_vertices, part_triangles in parts:
        vertices.append(np.asarray(part_vertices, np.float64))
        triangles.append(np.asarray(part_triangles, np.int32) + count)
        count += len(part_vertices)
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)


def split(vertices: np.ndarray, triangles: np.ndarray) -> Geometry:
    """The same triangles with no shared vertices."""
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)


def quad(a: Iterable[float], b: Iterable[float], c: Iterable[float], d: Iterable[float]) -> Geometry:
    """Two triangles a b c, a c d."""
    return np.array([list(a), list(b), list(c), list(d)], np.float64), np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def square(axis: int, at: float, half: float, centre: Sequence[float] = (0.0, 0.0)) -> Geometry:
    """A square with sides along the other two axes, in the plane coordinate[axis] = at."""
    corners = np.full((4, 3), float(at))
    others = [k for k in range(3) if k != axis]
    corners[:, others[0]] = centre[0] + half * np.array([-1.0, 1.0, 1.0, -1.0])
    corners[:, others[1]] = centre[1] + half * np.array([-1.0, -1.0, 1.0, 1.0])
    return quad(*corners)


def box(low: Iterable[float], high: Iterable[float]) -> Geometry:
    """A closed box, 12 triangles, outside seen counter-clockwise."""
    low, high = np.asarray(list(low), np.float64), np.asarray(list(high), np.float64)
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    sides = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    return corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], np.int32)


def unit(vector: Iterable[float]) -> np.ndarray:
    """(3,) ``vector`` divided by its length; the same bits on every machine."""
    x, y, z = (float(component) for component in vector)
    return np.array([x, y, z]) / math.sqrt(x * x + y * y + z * z)


def icosphere(subdivisions: int, radius: float = 1.0, centre: Iterable[float] = (0.0, 0.0, 0.0)) -> Geometry:
    """A closed, welded sphere: 20 * 4^subdivisions triangles."""
    g = (1.0 + math.sqrt(5.0)) / 2.0
    # the twelve corners lie on three golden rectangles; the triangles are written four a row
    points = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0)]
    points += [(z, x, y) for x, y, z in points] + [(y, z, x) for x, y, z in points]
    rows = "0 11 5 0 5 1 0 1 7 0 7 10 0 10 11 1 5 9 5 11 4 11 10 2 10 7 6 7 1 8"
    rows += " 3 9 4 3 4 2 3 2 6 3 6 8 3 8 9 4 9 5 2 4 11 6 2 10 8 6 7 9 8 1"
    faces = [tuple(row) for row in np.array(rows.split(), int).reshape(-1, 3).tolist()]
    vertices = [unit(p) for p in points]
    for _ in range(subdivisions):
        middles: dict[tuple[int, int], int] = {}

        def middle(i: int, j: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(i, j), max(i, j))
            if key not in middles:
                middles[key] = len(vertices)
                vertices.append(unit(vertices[i] + vertices[j]))
            return middles[key]

        finer = []
        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return np.array(vertices) * radius + np.asarray(list(centre), np.float64), np.array(faces, np.int32)


def spiky_sphere(rings: int = 16, seed: int = 0) -> Geometry:
    """A closed latitude/longitude sphere with random radii from 0.5 to 1.5 (the watertightness test of pbrt)."""
    rng = np.random.default_rng(seed)
    theta = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    phi = np.linspace(0.0, 2.0 * np.pi, rings + 1)[:-1]
    grid = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(rings)),
        ],
        axis=-1,
    )
    vertices = np.concatenate([grid.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    vertices *= rng.uniform(0.5, 1.5, (len(vertices), 1))
    top, bottom, triangles = len(vertices) - 2, len(vertices) - 1, []
    for j in range(rings):
        k = (j + 1) % rings
        triangles += [(top, j, k), (bottom, (rings - 2) * rings + k, (rings - 2) * rings + j)]
        for i in range(rings - 2):
            a, b, c, d = i * rings + j, i * rings + k, (i + 1) * rings + k, (i + 1) * rings + j
            triangles += [(a, d, c), (a, c, b)]
    return vertices, np.array(triangles, np.int32)


def edge_points(vertices: np.ndarray, triangles: np.ndarray, fractions: Iterable[float] = (0.5,)) -> np.ndarray:
    """Points on every edge, (E * fractions, 3), rounded to float64."""
    edges = np.unique(
        np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1), axis=0
    )
    a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
    return np.concatenate([a + f * (b - a) for f in fractions])


def soup(rng: np.random.Generator, count: int, size: float, spread: float) -> Geometry:
    """Independent random triangles of about `size`, centres in a cube of half side `spread`."""
    centres = rng.uniform(-spread, spread, (count, 1, 3))
    return split((centres + rng.normal(size=(count, 3, 3)) * size).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def slivers(
    rng: np.random.Generator, count: int, length: float = 5.0, ratio: float = 5000.0, spread: float = 3.0
) -> Geometry:
    """Needles `length` long and `ratio` times thinner, anywhere."""
    base = rng.uniform(-spread, spread, (count, 3))
    along = rng.normal(size=(count, 3))
    along *= length / np.linalg.norm(along, axis=1, keepdims=True)
    side = rng.normal(size=(count, 3)) * length / ratio
    return split(
        np.stack([base, base + along, base + along * 0.4 + side], axis=1).reshape(-1, 3),
        np.arange(3 * count).reshape(-1, 3),
    )


def integer_soup(rng: np.random.Generator, count: int, reach: int = 3) -> Geometry:
    """Random triangles with integer corners: full of exact ties, shared corners and degenerate triangles."""
    return rng.integers(-reach, reach + 1, (3 * count, 3)).astype(np.float64), np.arange(
        3 * count, dtype=np.int32
    ).reshape(-1, 3)


def street(rng: np.random.Generator, clutter: int = 400) -> Geometry:
    """Robots-like: ground and walls of a few very large triangles, thin poles, clusters of small triangles. z is
    up, metres."""
    parts = [square(2, 0.0, 40.0)]
    for side in (-1.0, 1.0):
        for k in range(6):
            x = -30.0 + 12.0 * k
            parts.append(box((x, side * 8.0 - 2.0, 0.0), (x + 9.0, side * 8.0 + 2.0, 6.0 + 3.0 * rng.random())))
            parts.append(box((x + 10.0, side * 5.0, 0.0), (x + 10.06, side * 5.0 + 0.06, 5.0)))
    for _ in range(5):
        at = rng.uniform((-20.0, -3.0, 0.8), (20.0, 3.0, 1.6))
        ball = icosphere(2, 0.7, at)
        small = soup(rng, clutter // 5, 0.05, 0.9)
        parts += [ball, (small[0] + at, small[1])]
    return join(parts)


def museum(rng: np.random.Generator, count: int = 1500) -> Geometry:
    """Museum-like: a closed room 10 x 8 x 4 m full of small independent triangles."""
    small = soup(rng, count, 0.08, 1.0)
    corners = small[0].reshape(-1, 3, 3)
    centres = corners.mean(axis=1, keepdims=True)
    corners = corners - centres + np.clip(centres, -1.0, 1.0) * [4.5, 3.5, 1.7]
    return join([box((-5.0, -4.0, -2.0), (5.0, 4.0, 2.0)), (corners.reshape(-1, 3), small[1])])


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) unit vectors, uniform on the sphere."""
    out = rng.normal(size=(count, 3))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def rotation(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def pose_of(turn: np.ndarray, shift: Iterable[float]) -> np.ndarray:
    """(4, 4) rigid transform."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, list(shift)
    return pose


def look_at(eye: Iterable[float], target: Iterable[float], up: Iterable[float]) -> np.ndarray:
    """(4, 4) camera_to_world of an optical frame (x right, y down, z forward)."""
    eye, target, up = (np.asarray(list(v), np.float64) for v in (eye, target, up))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return pose_of(np.stack([right, np.cross(forward, right), forward], axis=1), eye)
