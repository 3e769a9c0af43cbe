# SPDX-License-Identifier: Apache-2.0
"""Samples in unpleasant places: exactly where faces of a cube of directions meet, all in one direction, all in one
plane, nearly all in one spot; and the surfaces to go with them."""

from __future__ import annotations

from itertools import product

import geometry
import numpy as np

# What the coordinates of a corner can be in scenes that live around the light: it, a hair beside it, a metre away.
HAIRS = (0.0, 1e-7, -1e-7, 1e-6, 1.0, -1.0)

# The six rotations that turn the optical axis to an axis of the world, by signed permutations: exact in any arithmetic.
TURNS = tuple(
    np.column_stack([right, np.cross(forward, right), forward])
    for forward, right in (
        ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
        ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
        ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    )
)


def cube_directions() -> np.ndarray:
    """(26, 3): the axes, the face diagonals and the corners of a cube."""
    return np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])


def seam_directions(steps: int = 8) -> np.ndarray:
    """(24 * (2 steps + 1), 3): along the twelve edges of the cube from -1 to 1, both neighbours at a time: with
    |x| = |y|, say, exactly, and one ulp on either side of it."""
    along = np.arange(-steps, steps + 1) / steps
    ways = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for signs in product((-1.0, 1.0), repeat=2):
            for shorter in others:
                way = np.zeros((len(along), 3))
                way[:, axis] = along
                way[:, others] = signs
                way[1::2, shorter] = np.nextafter(way[1::2, shorter], 0.0)
                ways.append(way)
    return np.concatenate(ways)


def hairs_beside(rng: np.random.Generator, ways: np.ndarray, count: int) -> np.ndarray:
    """(count, 3): directions of ``ways`` at random, moved by 1e-16 to 1e-3 in one coordinate or more."""
    chosen = ways[rng.integers(0, len(ways), count)]
    moved = rng.choice([-1.0, 0.0, 1.0], (count, 3)) * 10.0 ** rng.uniform(-16, -3, (count, 1))
    return chosen + moved


def fan(axis: int, side: float, spokes: int, width: float, height: float = 1.0) -> geometry.Geometry:
    """Triangles that meet exactly on an axis, ``height`` from the origin: the pole of any grid of two angles."""
    angle = 2.0 * np.pi * np.arange(spokes) / spokes
    rim = np.empty((spokes, 3))
    rim[:, axis] = side * height * 0.9
    rim[:, axis - 2], rim[:, axis - 1] = width * np.cos(angle), width * np.sin(angle)
    pole = np.zeros((1, 3))
    pole[0, axis] = side * height
    k = np.arange(spokes)
    triangles = np.stack([np.zeros(spokes, int), 1 + k, 1 + (k + 1) % spokes], axis=1)
    return np.concatenate([pole, rim]), triangles.astype(np.int32)


def octahedron(subdivisions: int, radius: float = 1.0) -> geometry.Geometry:
    """A closed octahedron of 8 * 4^subdivisions triangles. Its corners are exactly on the axes, its edges exactly in
    the planes between them, and the coordinates of all vertices are multiples of radius / 2^subdivisions."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    triangles = np.array([(sx, sy, sz) for sx in (0, 3) for sy in (1, 4) for sz in (2, 5)])
    for _ in range(subdivisions):
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        corners = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        vertices, inverse = np.unique(corners, axis=0, return_inverse=True)
        triangles = inverse.reshape(-1, 3)
    return vertices * radius, triangles.astype(np.int32)


def lattice_plane(axis: int, cells: int, half: float, at: float = 0.0) -> geometry.Geometry:
    """A square in the plane coordinate[axis] = at, in 2 cells^2 triangles. With an even number of cells a vertex is
    exactly in its middle, with an odd number an edge goes through it."""
    steps = np.linspace(-half, half, cells + 1)
    u, v = (g.reshape(-1) for g in np.meshgrid(steps, steps))
    vertices = np.full((len(u), 3), at)
    vertices[:, axis - 2], vertices[:, axis - 1] = u, v
    row = cells + 1
    k = (np.arange(cells)[:, None] * row + np.arange(cells)).reshape(-1)
    triangles = np.concatenate([np.stack([k, k + 1, k + row + 1], 1), np.stack([k, k + row + 1, k + row], 1)])
    return vertices, triangles.astype(np.int32)


def lattice_box(size: int) -> geometry.Geometry:
    """A closed box from 0 to ``size``, its sides cut into unit squares of two triangles, vertices welded: integers."""
    parts = []
    for axis in range(3):
        for at in (0.0, float(size)):
            vertices, triangles = lattice_plane(axis, size, 0.5 * size, at)
            vertices[:, [axis - 2, axis - 1]] += 0.5 * size
            parts.append((vertices, triangles))
    vertices, triangles = geometry.join(parts)
    welded, inverse = np.unique(vertices, axis=0, return_inverse=True)
    return welded, inverse.reshape(-1)[triangles].astype(np.int32)


def terrain(rng: np.random.Generator, cells: int, spacing: float, height: float) -> geometry.Geometry:
    """A rough height field, 2 cells^2 triangles, from the origin along x and y, z up."""
    vertices, triangles = lattice_plane(2, cells, 0.5 * cells * spacing)
    vertices[:, :2] += 0.5 * cells * spacing
    vertices[:, 2] = height * rng.random(len(vertices))
    return vertices, triangles
