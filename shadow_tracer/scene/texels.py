# SPDX-License-Identifier: Apache-2.0
"""The surface of a mesh, cut into small triangles: texels."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.mesh import IntArray, Mesh

MOST_TEXELS = 20_000_000
SIDES = ("front", "back", "both")


@dataclass(frozen=True)
class Texels:
    """Small triangles that cover a mesh, in its own frame.

    Attributes:
        corners: (N, 3, 3) corner after corner [m], counter-clockwise from the side that is meant.
        area: (N,) [m2].
        normals: (N, 3) unit vectors to that side.
    """

    corners: FloatArray
    area: FloatArray
    normals: FloatArray

    @property
    def centres(self) -> FloatArray:
        """(N, 3) [m]."""
        centres: FloatArray = (self.corners[:, 0] + self.corners[:, 1] + self.corners[:, 2]) / 3.0
        return centres


def mesh_key(vertices: FloatArray, triangles: IntArray) -> str:
    """The same for the same mesh, wherever it stands."""
    digest = hashlib.blake2b(np.ascontiguousarray(vertices, "<f8"), digest_size=16)
    digest.update(np.ascontiguousarray(triangles, "<i4"))
    return digest.hexdigest()


def cut(mesh: Mesh, max_edge: float, side: str = "front") -> Texels:
    """Halve triangles across their longest edge until none is longer than ``max_edge``.

    Halves have exactly half the area, so the areas of all add up to that of the mesh, and no triangle gets thinner than
    it must: halving the longest edge keeps the least angle above half of what it was (Rosenberg and Stenger 1975).
    Triangles without an area, or with a corner that is not finite, have no texels.

    Args:
        mesh: the mesh.
        max_edge: positive [m].
        side: "front", from which corners are seen counter-clockwise, "back", or "both", one after the other.

    Raises:
        ValueError: there would be no texels, or more than 20 million.
    """
    corners = mesh.vertices[mesh.triangles]
    with np.errstate(all="ignore"):
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice = np.sqrt((across * across).sum(axis=1))
        kept = np.isfinite(twice) & (twice > 0.0)
    corners, area = corners[kept], 0.5 * twice[kept]
    normals = across[kept] / twice[kept, None]
    if not len(corners):
        raise ValueError(f"part: expected a mesh with a surface, got {mesh.name!r}, whose triangles have no area")
    most = MOST_TEXELS // (2 if side == "both" else 1)
    # No triangle with such edges has more than an equilateral one's area; so many are needed at least.
    with np.errstate(divide="ignore", over="ignore"):
        least = area.sum() / (0.4331 * max_edge * max_edge)
    while True:
        edges = corners[:, [1, 2, 0]] - corners
        lengths = (edges * edges).sum(axis=2)
        longest = lengths.argmax(axis=1)
        long = lengths.max(axis=1) > max_edge * max_edge
        if not long.any():
            break
        if max(least, len(corners) + int(long.sum())) > most:
            raise ValueError(
                f"max_edge: expected a length at which {mesh.name!r} has at most {MOST_TEXELS} texels, got "
                f"{max_edge:g} m"
            )
        corners, area, normals = _halve(corners, area, normals, longest, long)
    front, back = Texels(corners, area, normals), Texels(corners[:, [0, 2, 1]], area, -normals)
    if side == "both":
        pairs = ((front.corners, back.corners), (area, area), (normals, -normals))
        return Texels(*(np.concatenate(pair) for pair in pairs))
    return front if side == "front" else back


def _halve(
    corners: FloatArray, area: FloatArray, normals: FloatArray, longest: IntArray, long: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The long ones become two, in the place of one."""
    count = 1 + long.astype(np.intp)
    place = np.cumsum(count) - count
    corners, area, normals = (np.repeat(each, count, axis=0) for each in (corners, area, normals))
    first = place[long]
    rows = np.arange(len(first))
    old = corners[first]
    a, b, c = (old[rows, (longest[long] + k) % 3] for k in range(3))  # the longest edge is a to b
    middle = 0.5 * a + 0.5 * b
    corners[first], corners[first + 1] = np.stack([c, a, middle], axis=1), np.stack([b, c, middle], axis=1)
    area[first] *= 0.5
    area[first + 1] *= 0.5
    return corners, area, normals
