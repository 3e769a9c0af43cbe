# SPDX-License-Identifier: Apache-2.0
"""Shapes of the demo scene: closed where they should be, of the right size."""

from __future__ import annotations

import numpy as np
import pytest

from shadow_tracer.apps.demo import parts
from shadow_tracer.apps.demo.parts import Part

GREY = (0.5, 0.5, 0.5)


def edges_with_odd_use(part: Part) -> int:
    """Edges, by position, that are not shared by an even number of triangles: a closed surface has none."""
    _, welded = np.unique(part.vertices.round(9), axis=0, return_inverse=True)
    t = welded.reshape(-1)[part.triangles]
    edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts % 2).sum())


def extent(part: Part) -> np.ndarray:
    return np.ptp(part.vertices, axis=0)


SOLIDS = {
    "box": parts.box((1, 2, 3), GREY),
    "bevelled box": parts.box((1, 2, 3), GREY, 0.1),
    "cylinder": parts.cylinder(1, 2, GREY, 12),
    "bevelled cylinder": parts.cylinder(1, 2, GREY, 12, 0.1),
    "ring": parts.lathe([(1, 0), (2, 0), (2, 1), (1, 1)], GREY, 12, closed=True),
    "tube": parts.tube([(0, 0, 0), (0, 0, 1), (0, 1, 2)], 0.1, GREY),
    "loop": parts.tube([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)], 0.1, GREY, closed=True),
    "prism": parts.extrude(parts.capsule_outline(2, 1, 0.5), 0.4, GREY, 0.05),
    "gear": parts.gear(1, 0.3, 12, GREY),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_closed_and_not_degenerate(name: str) -> None:
    part = SOLIDS[name]
    assert edges_with_odd_use(part) == 0
    a, b, c = np.moveaxis(part.vertices[part.triangles], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-12


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("box", (1, 2, 3)),
        ("bevelled box", (1, 2, 3)),
        ("cylinder", (2, 2, 2)),
        ("bevelled cylinder", (2, 2, 2)),
        ("ring", (4, 4, 1)),
        ("gear", (2, 2, 0.3)),
    ],
)
def test_solids_have_their_size(name: str, size: tuple[float, ...]) -> None:
    assert extent(SOLIDS[name]) == pytest.approx(size, rel=0.03)


def test_joined_parts_keep_their_triangles_and_colours() -> None:
    one, two = parts.box((1, 1, 1), GREY), parts.cylinder(1, 1, (1, 0, 0), 8).at(5, 0, 0)
    both = parts.join([one, two])
    n = len(one.triangles)
    assert np.array_equal(both.vertices[both.triangles[:n]], one.vertices[one.triangles])
    assert np.array_equal(both.vertices[both.triangles[n:]], two.vertices[two.triangles])
    assert np.array_equal(np.unique(both.colours[n:], axis=0), [[1, 0, 0]])


@pytest.mark.parametrize("axis", "xyz")
def test_rotation_is_right_handed(axis: str) -> None:
    i = "xyz".index(axis)
    turned = parts.rotation(axis, np.pi / 2)[:3, :3] @ np.eye(3)[(i + 1) % 3]
    assert turned == pytest.approx(np.eye(3)[(i + 2) % 3])


def test_pierced_wall_is_open_where_it_should_be() -> None:
    wall = parts.pierced_wall(4, 3, 0.2, [(1, 2, 1, 2)], [(1.5, GREY), (3, (1, 1, 1))])
    a, b, c = np.moveaxis(wall.vertices[wall.triangles], 1, 0)
    front = np.isclose(np.stack([a, b, c])[..., 1], 0).all(axis=0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)[front].sum()
    assert area == pytest.approx(4 * 3 - 1)
    assert len(np.unique(wall.colours, axis=0)) == 2
